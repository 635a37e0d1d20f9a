//! The screws: slope of the position error at each temperature, and the law `tan β(T) = Tk_max (T - T0) / (T_max - T0)`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::fit::robust::range;
use crate::repeats;
use crate::table::Table;
use crate::thermal::law::{Law, Misfit};
use crate::thermal::lines::{Line, Lines, Point, fail};
use crate::uncertainty::k95;
use crate::units;

/// How the screws are fitted.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Reference position of an axis, where its screw does not move the position; otherwise taken from the data.
    pub p0_mm: Vec<(String, f64)>,
    /// Temperature at which an axis' slope is zero; otherwise taken from the data.
    pub t0_c: Vec<(String, f64)>,
}

/// All rows, by axis in the order of the file.
#[derive(Debug, Clone)]
pub struct Data {
    axes: Vec<(String, Vec<Point>)>,
    /// Where they are from.
    path: PathBuf,
    /// What a user should know of the file.
    warnings: Vec<String>,
}

impl Data {
    /// Reads `axis,screw_c,position_mm,error_mm`.
    pub fn read(path: impl AsRef<std::path::Path>) -> Result<Self> {
        let mut table = Table::read(path, &["axis", "screw_c", "position_mm", "error_mm"], &[])?;
        let mut warnings = Vec::new();
        repeats::measured_once(&mut table, &["error_mm"], &mut warnings);
        let mut axes: Vec<(String, Vec<Point>)> = Vec::new();
        for row in 0..table.rows() {
            let name = table.text(row, "axis").to_ascii_lowercase();
            if name.is_empty() {
                return Err(table.error(row, "axis", "is empty", "write the axis' name"));
            }
            let point = Point {
                screw_c: table.number(row, "screw_c")?,
                position_mm: table.number(row, "position_mm")?,
                error_mm: table.number(row, "error_mm")?,
            };
            match axes.iter_mut().find(|(n, _)| *n == name) {
                Some((_, points)) => points.push(point),
                None => axes.push((name, vec![point])),
            }
        }
        let told = [
            units::celsius("screw_c", &table.column("screw_c")?),
            units::travel("position_mm", &table.column("position_mm")?),
            units::errors("error_mm", &table.column("error_mm")?),
        ];
        warnings.extend(told.into_iter().flatten());
        Ok(Self { axes, path: table.path().to_owned(), warnings })
    }
}

/// The slope at one temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Slope {
    /// Mean screw temperature of the run.
    pub screw_c: f64,
    /// Slope of the error line, µm for each metre.
    pub slope_um_per_m: f64,
    /// Half-width of its 95 % interval.
    pub slope_u95_um_per_m: f64,
    /// The line's value at position 0.
    pub intercept_mm: f64,
}

/// One axis' screw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Screw {
    /// The axis.
    pub axis: String,
    /// Temperature at which the slope is zero.
    pub t0_c: f64,
    /// Half-width of its 95 % interval; 0 if it was given.
    pub t0_u95_c: f64,
    /// Highest calibrated temperature.
    pub t_max_c: f64,
    /// Slope there, µm for each metre (the source's `Tk_max`).
    pub tk_max_um_per_m: f64,
    /// Half-width of its 95 % interval.
    pub tk_max_u95_um_per_m: f64,
    /// Reference position.
    pub p0_mm: f64,
    /// Half-width of its 95 % interval; 0 if it was given.
    pub p0_u95_mm: f64,
    /// Smallest and largest calibrated position.
    pub range_mm: [f64; 2],
    /// Scatter of the readings around their lines.
    pub noise_mm: f64,
    /// Root mean square of the error, and of what the law leaves.
    pub before_rms_mm: f64,
    /// See `before_rms_mm`.
    pub after_rms_mm: f64,
    /// Covariance of (slope for each degree in 1/°C, t0_c, p0_mm).
    pub covariance: [[f64; 3]; 3],
    /// Degrees of freedom behind it.
    pub dof: f64,
    /// The slopes measured.
    pub slopes: Vec<Slope>,
}

impl Screw {
    /// Slope for each degree, 1/°C.
    fn per_degree(&self) -> f64 {
        self.tk_max_um_per_m * 1e-6 / (self.t_max_c - self.t0_c)
    }

    /// The lowest temperature that was calibrated, or that of no slope.
    pub fn lowest_c(&self) -> f64 {
        self.slopes.iter().map(|s| s.screw_c).fold(self.t0_c, f64::min)
    }

    /// Deviation `tan β(T) (P - P0)` and the half-width of the 95 % interval for what correcting it leaves.
    pub fn deviation(&self, screw_c: f64, position_mm: f64) -> (f64, f64) {
        let (k, t, p) = (self.per_degree(), screw_c - self.t0_c, position_mm - self.p0_mm);
        let gradient = [t * p, -k * p, -k * t];
        let mut variance = self.noise_mm.powi(2);
        for i in 0..3 {
            for j in 0..3 {
                variance += gradient[i] * self.covariance[i][j] * gradient[j];
            }
        }
        (k * t * p, k95(self.dof) * variance.max(0.0).sqrt())
    }
}

/// Fits every axis; warnings go to `warnings`.
pub fn fit(data: &Data, options: &Options, warnings: &mut Vec<String>) -> Result<Vec<Screw>> {
    warnings.extend(data.warnings.iter().cloned());
    for (option, pairs) in [("--p0-mm", &options.p0_mm), ("--t0-c", &options.t0_c)] {
        if let Some((name, _)) = (1..pairs.len())
            .map(|i| &pairs[i])
            .find(|p| pairs.iter().filter(|q| q.0 == p.0).count() > 1)
        {
            return Err(Error::option(
                option,
                format!("is given twice for axis '{name}'"),
                "keep one",
            ));
        }
        if let Some((name, _)) = pairs.iter().find(|(n, _)| !data.axes.iter().any(|(a, _)| a == n))
        {
            return Err(Error::option(
                option,
                format!("there is no axis '{name}' in the data"),
                "correct the name",
            ));
        }
    }
    data.axes
        .iter()
        .map(|(axis, points)| fit_axis(axis, points, options, warnings))
        .collect::<Result<_>>()
        .map_err(|e| e.in_file(&data.path, None))
}

fn fit_axis(
    axis: &str,
    points: &[Point],
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Screw> {
    let given = |pairs: &[(String, f64)]| pairs.iter().find(|(n, _)| n == axis).map(|p| p.1);
    let (given_p0, given_t0) = (given(&options.p0_mm), given(&options.t0_c));
    let rough = Lines::fit(axis, points, given_t0)?;
    let slip = rough.slip();
    warnings.extend(slip.iter().map(|slip| format!("axis {axis}: {slip}: check that row")));
    // A reading that was mistyped may hide what the others show.
    let blamed = |e| slip.map_or(e, |slip| fail(axis, slip, "correct that row, or leave it out"));
    let rough_law = rough.slopes_law(axis, given_t0).map_err(blamed)?;
    let lines = rough.levelled(axis, rough_law.0, given_t0)?;
    let (per_degree, t0) = lines.slopes_law(axis, given_t0)?;
    let meet = lines.meet();
    let p0 = reference_mm(axis, &lines, meet, given_p0, warnings);
    let law = Law {
        points,
        runs: &lines.runs,
        noise: lines.noise,
        t0: given_t0,
        p0,
        free_offsets: given_p0.is_some() || !meet,
    };
    let solved = law.solve([per_degree, t0, p0.unwrap_or(lines.crossing_mm())]);
    let [per_degree, t0_c, p0_mm] = solved.parameters;
    let dof = (points.len() as f64 - solved.rank as f64).max(1.0);
    let k = k95(dof);
    let slope_at = |l: &Line| per_degree * (l.screw_c - t0_c);
    let off = Misfit::of(&lines.lines, slope_at, lines.noise, given_t0.is_some(), dof);
    if off.significant {
        warnings.push(format!(
            "axis {axis}: the slopes are not proportional to T - T0 (they lie {:.1} times their uncertainty off); \
             intervals are widened",
            off.ratio
        ));
    }
    let serial = lines.repeats().sqrt();
    // Slopes off the law make T0 and the slope for each degree uncertain, not where the lines meet.
    let slope = serial * off.ratio * k95(off.dof) / k;
    let mut covariance = widened(solved.covariance, [slope, slope, serial]);
    let range_mm: [f64; 2] =
        range(&points.iter().map(|p| p.position_mm).collect::<Vec<_>>()).into();
    if given_p0.is_none() && !meet {
        // Anywhere on the axis, and 0 need not be on it.
        let far = range_mm.map(f64::abs).into_iter().fold(range_mm[1] - range_mm[0], f64::max);
        covariance[2][2] = far * far / 3.0;
    }
    let t_max_c = lines.lines.iter().map(|l| l.screw_c).fold(f64::NEG_INFINITY, f64::max);
    let rise = t_max_c - t0_c;
    if rise <= 0.0 {
        return Err(fail(
            axis,
            format!("the slope is zero at {t0_c:.1} °C, above all calibrated temperatures"),
            "check the sign of error_mm, or give --t0-c",
        ));
    }
    let tk_variance = rise * rise * covariance[0][0] - 2.0 * rise * per_degree * covariance[0][1]
        + per_degree.powi(2) * covariance[1][1];
    let rms = |f: &dyn Fn(&Point) -> f64| {
        (points.iter().map(|p| f(p).powi(2)).sum::<f64>() / points.len() as f64).sqrt()
    };
    Ok(Screw {
        axis: axis.to_owned(),
        t0_c,
        t0_u95_c: k * covariance[1][1].sqrt(),
        t_max_c,
        tk_max_um_per_m: 1e6 * per_degree * rise,
        tk_max_u95_um_per_m: 1e6 * k * tk_variance.max(0.0).sqrt(),
        p0_mm,
        p0_u95_mm: k * covariance[2][2].sqrt(),
        range_mm,
        noise_mm: lines.noise * (solved.chi2 / dof).sqrt().max(1.0),
        before_rms_mm: rms(&|p| p.error_mm),
        after_rms_mm: rms(&|p| {
            p.error_mm - per_degree * (p.screw_c - t0_c) * (p.position_mm - p0_mm)
        }),
        covariance,
        dof,
        slopes: slopes(&lines, serial),
    })
}

/// A covariance whose standard deviations are so many times larger.
fn widened(mut covariance: [[f64; 3]; 3], by: [f64; 3]) -> [[f64; 3]; 3] {
    for (i, row) in covariance.iter_mut().enumerate() {
        row.iter_mut().zip(by).for_each(|(v, w)| *v *= by[i] * w);
    }
    covariance
}

/// The slopes measured; `serial` is how much more uncertain they are than readings of their own each would make them.
fn slopes(lines: &Lines, serial: f64) -> Vec<Slope> {
    let k = k95(lines.dof);
    let slope = |l: &Line| Slope {
        screw_c: l.screw_c,
        slope_um_per_m: 1e6 * l.slope,
        slope_u95_um_per_m: 1e6 * k * (lines.noise * l.slope_factor) * serial,
        intercept_mm: l.intercept,
    };
    lines.lines.iter().map(slope).collect()
}

/// The reference position where the law does not tell it: as given, or 0 where the lines do not meet.
fn reference_mm(
    axis: &str,
    lines: &Lines,
    meet: bool,
    given: Option<f64>,
    warnings: &mut Vec<String>,
) -> Option<f64> {
    match (given, meet) {
        (Some(p0), true) if !lines.meet_at(p0) => {
            let crossing = lines.crossing_mm();
            warnings.push(format!(
                "axis {axis}: the error lines meet at {crossing:.1} mm, not at the {p0} mm given with --p0-mm"
            ));
            given
        }
        (Some(_), _) => given,
        (None, true) => None,
        (None, false) => {
            warnings.push(format!(
                "axis {axis}: the error lines do not meet at one position (the reading was zeroed anew for each run); \
                 the reference position is taken as 0 and may be anywhere, which makes intervals wide: give --p0-mm {axis}=POSITION"
            ));
            Some(0.0)
        }
    }
}
