//! Does a screw warm up or cool down? At a turn, and where readings are rounded or noisy, that is told by those nearest.

use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::in_time;
use crate::diagnose::effects::thermal_columns::{Readings, heating, of_each_screw};
use crate::fit::robust::{median, range};

/// Whether each row's screw last went up (1) or down (-1).
pub fn went(data: &Columns) -> Vec<f64> {
    of_each_screw(data, |times_s, screw_c| {
        let read = Readings::new(times_s, screw_c);
        let changes = || read.values.windows(2).map(|pair| pair[1] - pair[0]);
        let mut way = changes().find(|c| *c != 0.0).unwrap_or(0.0).signum();
        let mut ways = vec![way];
        for change in changes() {
            way = if change == 0.0 { way } else { change.signum() };
            ways.push(way);
        }
        read.by_row(&ways)
    })
}

/// Whether each row's screw warms up (1) or cools down (-1): as the readings about it show, or where those are too few or too much alike,
/// as it comes from those before or goes to those after, whichever are much nearer; else from the ones to the others.
pub fn goes(data: &Columns) -> Vec<f64> {
    let ways = of_each_screw(data, ways).into_iter().zip(heating(data));
    ways.map(|(way, rate)| way.unwrap_or(rate.signum())).collect()
}

/// The way each of some values goes (1 or -1); `None` where neither the readings about it tell, less than a sixtieth of the run away,
/// nor those about the next one before or after, one of which is much nearer.
fn ways(times_s: &[f64], values: &[f64]) -> Vec<Option<f64>> {
    /// Times as far away as the nearer ones.
    const MUCH: f64 = 2.0;
    /// Standard deviations by which readings must differ.
    const CLEAR: f64 = 2.0;
    let order = in_time(times_s);
    let sorted: Vec<[f64; 2]> = order.iter().map(|i| [times_s[*i], values[*i]]).collect();
    let (first, last) = range(times_s);
    let apart = (last - first) / 60.0;
    let least_sd = least_step(values) / 12.0f64.sqrt();
    let abouts: Vec<About> = sorted.iter().map(|p| About::of(&sorted, p[0], apart)).collect();
    let lines: Vec<Option<Line>> = abouts.iter().map(About::line).collect();
    let mut spreads: Vec<f64> = lines.iter().flatten().map(|line| line.left_sd).collect();
    let sd = if spreads.is_empty() { 0.0 } else { median(&mut spreads) };
    let sd_of_mean = |about: &About| least_sd.max(sd / (about.readings().len() as f64).sqrt());
    let by_sides = |at: usize, own: &About| {
        let (before, after) = (own.from.checked_sub(1), Some(own.to).filter(|i| *i < sorted.len()));
        let gap = |side: Option<usize>| {
            side.map_or(f64::INFINITY, |i| (sorted[i][0] - sorted[at][0]).abs())
        };
        let (other, sense) = if MUCH * gap(before) < gap(after) {
            (&abouts[before?], 1.0)
        } else if MUCH * gap(after) < gap(before) {
            (&abouts[after?], -1.0)
        } else {
            return None;
        };
        let change = sense * (own.mean()[1] - other.mean()[1]);
        let clear = change.abs() > CLEAR * sd_of_mean(own).hypot(sd_of_mean(other));
        clear.then_some(change.signum())
    };
    let mut ways = vec![None; values.len()];
    for (at, (own, line)) in abouts.iter().zip(&lines).enumerate() {
        let by_line = line.as_ref().and_then(|line| line.way(sd.max(least_sd)));
        ways[order[at]] = by_line.or_else(|| by_sides(at, own));
    }
    ways
}

/// Readings near a time.
struct About<'a> {
    /// Time and value of all readings, in the order of time.
    sorted: &'a [[f64; 2]],
    /// Which of them are near.
    from: usize,
    to: usize,
}

/// A line through readings.
struct Line {
    slope: f64,
    /// Its standard error over that of a reading.
    error_per_sd: f64,
    /// Standard deviation of a reading, by what the line leaves: as often more as less.
    left_sd: f64,
}

impl<'a> About<'a> {
    /// Those less than `apart` away.
    fn of(sorted: &'a [[f64; 2]], t: f64, apart: f64) -> Self {
        let from = sorted.partition_point(|p| p[0] <= t - apart);
        let to = sorted.partition_point(|p| p[0] < t + apart).max(from);
        Self { sorted, from, to }
    }

    /// The readings, evenly picked where they are many.
    fn readings(&self) -> impl ExactSizeIterator<Item = &[f64; 2]> {
        const ENOUGH: usize = 64;
        let every = (self.to - self.from).div_ceil(ENOUGH).max(1);
        self.sorted[self.from..self.to].iter().step_by(every)
    }

    fn mean(&self) -> [f64; 2] {
        let n = self.readings().len().max(1) as f64;
        [0, 1].map(|axis| self.readings().map(|p| p[axis]).sum::<f64>() / n)
    }

    /// The line through them; `None` where they are too few.
    fn line(&self) -> Option<Line> {
        const FEWEST: usize = 4;
        let middle = self.mean();
        let product = |a: usize, b: usize| -> f64 {
            self.readings().map(|p| (p[a] - middle[a]) * (p[b] - middle[b])).sum()
        };
        let (tt, tv, dof) = (product(0, 0), product(0, 1), self.readings().len() as f64 - 2.0);
        let enough = self.readings().len() >= FEWEST && tt > 0.0;
        enough.then(|| Line {
            slope: tv / tt,
            error_per_sd: 1.0 / tt.sqrt(),
            // The middle of χ² over its degrees of freedom (Wilson and Hilferty).
            left_sd: {
                let middle = (1.0 - 2.0 / (9.0 * dof)).powi(3);
                ((product(1, 1) - tv * tv / tt).max(0.0) / (dof * middle)).sqrt()
            },
        })
    }
}

impl Line {
    /// The sign of its slope, where one in a thousand by chance alone is no steeper; `sd` is that of a reading.
    fn way(&self, sd: f64) -> Option<f64> {
        const CLEAR: f64 = 3.3;
        let clear = self.slope.abs() > CLEAR * self.error_per_sd * sd;
        clear.then_some(self.slope.signum())
    }
}

/// The least difference of values: what they are rounded to at most.
fn least_step(values: &[f64]) -> f64 {
    /// Of printed numbers, what is left of a difference of none.
    const NONE: f64 = 1e-9;
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let steps = sorted.windows(2).map(|w| w[1] - w[0]).filter(|step| *step > NONE);
    steps.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Sweeps of four readings, 8 s apart, of a screw that goes up and down; and how many ways are told, and how many of them wrongly.
    fn told(read: impl Fn(f64, f64) -> f64) -> [usize; 2] {
        let screw = |t: f64| 5.0 * (t / 3000.0).sin();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let times: Vec<f64> = (0..200).map(|i| f64::from(i / 4 * 400 + i % 4 * 8)).collect();
        let values: Vec<f64> =
            times.iter().map(|t| read(screw(*t), StandardNormal.sample(&mut rng))).collect();
        let ways = ways(&times, &values);
        let wrong = |(t, way): &(&f64, &Option<f64>)| {
            way.is_some_and(|way| way != (*t / 3000.0).cos().signum())
        };
        let told = ways.iter().flatten().count();
        [told, times.iter().zip(&ways).filter(wrong).count()]
    }

    #[test]
    fn a_sweep_tells_its_way_where_readings_are_fine_and_noise_tells_none() {
        let [told_fine, wrong] = told(|c, _| (100.0 * c).round() / 100.0);
        assert!(told_fine > 150 && wrong <= 4, "{told_fine} told, {wrong} wrongly");
        let [_, wrong] = told(|c, noise| c + 0.05 * noise);
        assert!(wrong <= 4, "{wrong} wrongly");
    }

    #[test]
    fn beside_a_plateau_the_nearer_sweep_tells() {
        // Up to a plateau long before, and down soon after.
        let times = [0.0, 8.0, 16.0, 6000.0, 6008.0, 6016.0, 6300.0, 6308.0, 6316.0];
        let values = [20.0, 20.1, 20.2, 26.0, 26.0, 26.0, 25.5, 25.4, 25.3];
        assert!(ways(&times, &values)[3..].iter().all(|way| *way == Some(-1.0)));
    }
}
