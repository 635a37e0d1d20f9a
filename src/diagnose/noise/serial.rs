//! Errors that follow one another: each reading's error shares a part with that of the reading before it (a first-order
//! autoregression in the file's order, of each output). What wanders so is no function of anything, and counts as noise.

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::Layout;

/// Correlations that are tried, in twentieths: nearer to one it is a random walk, which drifts.
const TWENTIETHS: std::ops::RangeInclusive<u32> = 1..=18;

/// Correlation of each reading with the one before it.
#[derive(Debug, Clone)]
pub(super) struct Serial {
    /// Correlation of neighbours.
    pub(super) neighbours: f64,
    /// For each observation the one before it of the same output, and its correlation with that.
    before: Vec<Option<(usize, f64)>>,
}

impl Serial {
    /// Of the observations that are kept.
    pub(super) fn new(layout: &Layout, keep: &[bool], neighbours: f64) -> Self {
        let mut last = vec![None; layout.classes.iter().max().map_or(1, |c| c + 1)];
        let before = (0..keep.len()).map(|i| {
            if !keep[i] {
                return None;
            }
            let previous: Option<usize> = last[layout.classes[i]].replace(i);
            previous.map(|j| {
                let steps = layout.groups[i].abs_diff(layout.groups[j]).max(1);
                (j, neighbours.powi(steps.min(1000) as i32))
            })
        });
        Self { before: before.collect(), neighbours }
    }

    /// What each observation has beyond the one before it, as large as its own error.
    pub(super) fn apply(&self, columns: &mut DMatrix<f64>) {
        for mut column in columns.column_iter_mut() {
            for (i, before) in self.before.iter().enumerate().rev() {
                if let Some((j, c)) = before {
                    column[i] = (column[i] - c * column[*j]) / (1.0 - c * c).sqrt();
                }
            }
        }
    }

    /// ln of the determinant of the correlations.
    pub(super) fn ln_det(&self) -> f64 {
        self.before.iter().flatten().map(|(_, c)| (-c * c).ln_1p()).sum()
    }
}

/// The likeliest correlation of neighbours in what a fit leaves (`tangent` are the fit's columns), and what it gains against none, nats.
pub(super) fn likeliest(
    layout: &Layout,
    keep: &[bool],
    residual: &DMatrix<f64>,
    tangent: &DMatrix<f64>,
) -> (f64, f64) {
    let n = keep.iter().filter(|k| **k).count() as f64;
    let ln_likelihood = |neighbours: f64| {
        let serial = Serial::new(layout, keep, neighbours);
        let filtered = |columns: &DMatrix<f64>| {
            let mut out = columns.clone();
            for mut column in out.column_iter_mut() {
                column.iter_mut().zip(keep).filter(|(_, k)| !**k).for_each(|(v, _)| *v = 0.0);
            }
            serial.apply(&mut out);
            out
        };
        let basis = orthonormal(&filtered(tangent), 1e-9);
        let mut e = filtered(residual);
        e -= &basis * basis.tr_mul(&e);
        -0.5 * (n * e.norm_squared().max(1e-300).ln() + serial.ln_det())
    };
    let none = ln_likelihood(0.0);
    let all = TWENTIETHS.map(|k| f64::from(k) / 20.0).map(|c| (c, ln_likelihood(c) - none));
    all.fold((0.0, 0.0), |best, next| if next.1 > best.1 { next } else { best })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Two outputs of errors with this correlation, in turn.
    fn wandering(rows: usize, neighbours: f64) -> (Layout, DMatrix<f64>) {
        let layout = Layout {
            values: vec![0.0; 2 * rows],
            groups: (0..2 * rows).map(|i| i / 2).collect(),
            sites: (0..rows).collect(),
            classes: (0..2 * rows).map(|i| i % 2).collect(),
            ..Layout::default()
        };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut e = DMatrix::from_fn(2 * rows, 1, |_, _| StandardNormal.sample(&mut rng));
        for i in 2..2 * rows {
            e[i] = neighbours * e[i - 2] + (1.0 - neighbours * neighbours).sqrt() * e[i];
        }
        (layout, e)
    }

    #[test]
    fn a_correlation_is_found_and_taken_out_and_none_is_found_where_there_is_none() {
        let keep = vec![true; 600];
        let none = DMatrix::zeros(600, 0);
        let (layout, e) = wandering(300, 0.6);
        let (found, gain) = likeliest(&layout, &keep, &e, &none);
        assert!((found - 0.6_f64).abs() < 0.11 && gain > 50.0, "{found} by {gain} nats");
        let mut white = e.clone();
        Serial::new(&layout, &keep, found).apply(&mut white);
        assert!(likeliest(&layout, &keep, &white, &none).1 < 3.0);
        // A reading that is not kept is stepped over.
        let mut some = keep.clone();
        some[100] = false;
        let serial = Serial::new(&layout, &some, 0.5);
        assert_eq!(serial.before[100], None);
        assert_eq!(serial.before[102], Some((98, 0.25)));
        assert_eq!(serial.before[101], Some((99, 0.5)));

        let (layout, e) = wandering(300, 0.0);
        assert!(likeliest(&layout, &keep, &e, &none).1 < 3.0);
    }
}
