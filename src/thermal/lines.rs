//! The straight lines of a screw's runs: what slopes they have, and where they meet.

use crate::error::{Error, Result};
use crate::fit::robust::scatter;
use crate::fit::serial;
use crate::fit::tails::ln_f_tail;

/// Rows whose screw temperatures are closer than this belong to one calibration run.
const SAME_RUN_C: f64 = 0.5;
/// A screw that goes on warming while it is measured is a run for each so much.
const WARMS_C: f64 = 1.0;
/// p-value under which lines are said not to meet.
const APART_P: f64 = 1e-4;

/// One calibration row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) screw_c: f64,
    pub(super) position_mm: f64,
    pub(super) error_mm: f64,
}

/// The straight line of one run.
pub(super) struct Line {
    pub(super) screw_c: f64,
    pub(super) slope: f64,
    pub(super) intercept: f64,
    /// Standard error of the slope for readings of unit noise.
    pub(super) slope_factor: f64,
    pub(super) mean_mm: f64,
    pub(super) count: f64,
    pub(super) left: f64,
}

impl Line {
    pub(super) fn fit(run: &[Point]) -> Option<Self> {
        let count = run.len() as f64;
        let mean = |f: fn(&Point) -> f64| run.iter().map(f).sum::<f64>() / count;
        let (mp, me) = (mean(|p| p.position_mm), mean(|p| p.error_mm));
        let pp: f64 = run.iter().map(|p| (p.position_mm - mp).powi(2)).sum();
        if pp <= 1e-12 {
            return None;
        }
        let slope = run.iter().map(|p| (p.position_mm - mp) * (p.error_mm - me)).sum::<f64>() / pp;
        let left =
            run.iter().map(|p| (p.error_mm - me - slope * (p.position_mm - mp)).powi(2)).sum();
        Some(Self {
            screw_c: mean(|p| p.screw_c),
            slope,
            intercept: me - slope * mp,
            slope_factor: pp.sqrt().recip(),
            mean_mm: mp,
            count,
            left,
        })
    }

    /// Standard error of the line's value at a position, for readings of unit noise.
    pub(super) fn value_factor(&self, position_mm: f64) -> f64 {
        (1.0 / self.count + ((position_mm - self.mean_mm) * self.slope_factor).powi(2)).sqrt()
    }
}

/// The lines of all runs of an axis.
pub(super) struct Lines {
    /// Rows of one temperature each, by rising temperature.
    pub(super) runs: Vec<Vec<Point>>,
    /// One a run.
    pub(super) lines: Vec<Line>,
    /// Scatter of the readings around them, mm.
    pub(super) noise: f64,
    /// Degrees of freedom behind it.
    pub(super) dof: f64,
}

impl Lines {
    /// Fits them; several runs are needed unless the temperature without slope is given.
    pub(super) fn fit(axis: &str, points: &[Point], given_t0: Option<f64>) -> Result<Self> {
        Self::of_runs(axis, runs(points), given_t0)
    }

    /// The same with every row moved to its run's mean temperature, as the law moves it: a screw warms while it is measured.
    pub(super) fn levelled(
        &self,
        axis: &str,
        per_degree: f64,
        given_t0: Option<f64>,
    ) -> Result<Self> {
        let p0_mm = self.crossing_mm();
        let level = |(run, line): (&Vec<Point>, &Line)| -> Vec<Point> {
            let screw_c = line.screw_c;
            let moved = |p: &Point| {
                let added_mm = per_degree * (screw_c - p.screw_c) * (p.position_mm - p0_mm);
                Point { screw_c, error_mm: p.error_mm + added_mm, ..*p }
            };
            run.iter().map(moved).collect()
        };
        Self::of_runs(axis, self.runs.iter().zip(&self.lines).map(level).collect(), given_t0)
    }

    fn of_runs(axis: &str, runs: Vec<Vec<Point>>, given_t0: Option<f64>) -> Result<Self> {
        if runs.len() < 2 && given_t0.is_none() {
            return Err(fail(
                axis,
                format!("all rows are at one screw temperature ({:.1} °C)", runs[0][0].screw_c),
                "measure at two or more temperatures, or give --t0-c AXIS=TEMPERATURE of the cold screw",
            ));
        }
        let fit = |run: &Vec<Point>| {
            Line::fit(run).ok_or_else(|| {
                fail(
                    axis,
                    format!("the run at {:.1} °C has fewer than two positions", run[0].screw_c),
                    "measure several positions at each temperature",
                )
            })
        };
        let lines: Vec<Line> = runs.iter().map(fit).collect::<Result<_>>()?;
        let left: f64 = lines.iter().map(|l| l.left).sum();
        let dof: f64 = runs.iter().map(|run| run.len() as f64 - 2.0).sum();
        if dof < 1.0 {
            return Err(fail(
                axis,
                "two positions at each temperature leave nothing to tell the noise",
                "measure three or more",
            ));
        }
        // A floor well under any interferometer keeps weights finite on noise-free data.
        Ok(Self { runs, lines, noise: (left / dof).sqrt().max(1e-9), dof })
    }

    /// The reading that lies far from the line of its run's others, in words: one that was mistyped, as readings go.
    pub(super) fn slip(&self) -> Option<String> {
        /// How many times as far as readings usually lie, and at least, mm.
        const FAR: f64 = 10.0;
        const LEAST_MM: f64 = 0.005;
        /// Readings of a run of which one can be told from the others.
        const SEVERAL: usize = 4;
        let mut off: Vec<(f64, Point)> = Vec::new();
        for run in self.runs.iter().filter(|run| run.len() >= SEVERAL) {
            for (i, point) in run.iter().enumerate() {
                let others = run.iter().enumerate().filter(|(k, _)| *k != i).map(|(_, p)| *p);
                let Some(line) = Line::fit(&others.collect::<Vec<_>>()) else { continue };
                let there = line.intercept + line.slope * point.position_mm;
                off.push((point.error_mm - there, *point));
            }
        }
        let mut sizes: Vec<f64> = off.iter().map(|(off, _)| off.abs()).collect();
        let usual = if sizes.is_empty() { 0.0 } else { scatter(&mut sizes) };
        let (off, point) = off.into_iter().max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
        (off.abs() > LEAST_MM.max(FAR * usual)).then(|| {
            format!(
                "the reading at {} °C, {} mm lies {off:+.4} mm from the line of its run's others, {:.0} times as far as is usual",
                point.screw_c,
                point.position_mm,
                off.abs() / usual.max(1e-9)
            )
        })
    }

    /// Slope for each degree and temperature without slope, from the slopes against temperature.
    pub(super) fn slopes_law(&self, axis: &str, given_t0: Option<f64>) -> Result<(f64, f64)> {
        let count = self.lines.len() as f64;
        let mean = |f: fn(&Line) -> f64| self.lines.iter().map(f).sum::<f64>() / count;
        let (mt, ms) = (mean(|l| l.screw_c), mean(|l| l.slope));
        // About the mean, or through the given temperature.
        let (t, s) = given_t0.map_or((mt, ms), |t0| (t0, 0.0));
        let tt: f64 = self.lines.iter().map(|l| (l.screw_c - t).powi(2)).sum();
        let ts: f64 = self.lines.iter().map(|l| (l.screw_c - t) * (l.slope - s)).sum();
        let per_degree = ts / tt;
        let slope_u =
            self.lines.iter().map(|l| self.noise * l.slope_factor).fold(f64::INFINITY, f64::min);
        let span = self.lines.iter().map(|l| (l.screw_c - t).abs()).fold(0.0, f64::max);
        if !per_degree.is_finite() || per_degree.abs() * span < 3.0 * slope_u {
            return Err(fail(
                axis,
                "the slope of the error does not change with the screw's temperature",
                "measure over a wider range of temperature, or leave this axis out: it needs no correction",
            ));
        }
        Ok((per_degree, given_t0.unwrap_or(mt - ms / per_degree)))
    }

    /// Position at which they come nearest to meeting in no error.
    pub(super) fn crossing_mm(&self) -> f64 {
        let ss: f64 = self.lines.iter().map(|l| l.slope * l.slope).sum();
        -self.lines.iter().map(|l| l.slope * l.intercept).sum::<f64>() / ss
    }

    /// Whether they meet in no error; they do not if the interferometer was zeroed anew for each run.
    pub(super) fn meet(&self) -> bool {
        let joints = self.lines.len() as f64 - 1.0;
        joints < 1.0 || self.pass(self.crossing_mm(), joints)
    }

    /// Whether they meet in no error at a position.
    pub(super) fn meet_at(&self, position_mm: f64) -> bool {
        self.pass(position_mm, self.lines.len() as f64)
    }

    fn pass(&self, position_mm: f64, free: f64) -> bool {
        let miss = |l: &Line| {
            (l.intercept + l.slope * position_mm) / (self.noise * l.value_factor(position_mm))
        };
        let spread: f64 = self.lines.iter().map(|l| miss(l).powi(2)).sum();
        ln_f_tail(spread / free, free, self.dof) > APART_P.ln()
    }

    /// The factor on variances where errors repeat along the axis or from run to run, as those of the screw's pitch do.
    pub(super) fn repeats(&self) -> f64 {
        let mut left: Vec<(f64, f64)> = Vec::new();
        for (run, l) in self.runs.iter().zip(&self.lines) {
            let from = left.len();
            left.extend(
                run.iter()
                    .map(|p| (p.position_mm, p.error_mm - l.intercept - l.slope * p.position_mm)),
            );
            left[from..].sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        let values = |left: &[(f64, f64)]| left.iter().map(|l| l.1).collect::<Vec<_>>();
        let by_run = values(&left);
        left.sort_by(|a, b| a.0.total_cmp(&b.0));
        [by_run, values(&left)].map(|r| serial::widening(&r, 1).0).into_iter().fold(1.0, f64::max)
    }
}

/// What keeps an axis from being fitted.
pub(super) fn fail(axis: &str, reason: impl Into<String>, fix: &str) -> Error {
    Error::measure(format!("axis {axis}"), reason, fix)
}

/// Rows of about one temperature each, by rising temperature.
fn runs(points: &[Point]) -> Vec<Vec<Point>> {
    /// Rows that tell a line and their noise.
    const LEAST: usize = 3;
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.screw_c.total_cmp(&b.screw_c));
    let follows = |a: &Point, b: &Point| b.screw_c - a.screw_c <= SAME_RUN_C;
    let mut runs: Vec<Vec<Point>> = Vec::new();
    for stretch in sorted.chunk_by(follows) {
        let from = runs.len();
        for point in stretch {
            match runs[from..].last_mut() {
                Some(run) if point.screw_c - run[0].screw_c <= WARMS_C => run.push(*point),
                _ => runs.push(vec![*point]),
            }
        }
        // What is left over at the end goes with what was before it.
        if runs.len() > from + 1
            && let Some(short) = runs.pop_if(|run| run.len() < LEAST)
            && let Some(run) = runs.last_mut()
        {
            run.extend(short);
        }
    }
    runs
}
