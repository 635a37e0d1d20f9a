//! Errors that follow one another: each value's error shares a part with that of the value before it (a first-order
//! autoregression along the layout's chains). What wanders so is no function of anything, and counts as noise.

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::Layout;
use crate::diagnose::noise::Space;

/// Correlations that are tried, in twentieths: nearer to one it is a random walk, which drifts.
const TWENTIETHS: std::ops::RangeInclusive<u32> = 1..=18;

/// Correlation of each value with the one before it.
#[derive(Debug, Clone)]
pub(super) struct Serial {
    /// Correlation of neighbours.
    pub(super) neighbours: f64,
    /// An observation, the one before it, and its correlation with that; later ones of a chain come first.
    links: Vec<(usize, usize, f64)>,
}

impl Serial {
    /// Of the observations that are kept.
    pub(super) fn new(layout: &Layout, keep: &[bool], neighbours: f64) -> Self {
        /// Values that are so many steps apart have nothing in common.
        const FAR: f64 = 1000.0;
        let mut links = Vec::new();
        for chain in &layout.chains {
            let kept: Vec<&(usize, f64)> = chain.iter().filter(|(i, _)| keep[*i]).collect();
            let pairs = kept.windows(2).rev();
            links.extend(pairs.map(|w| {
                // An edge that goes round more than once has nearer neighbours, which have less in common.
                let steps = (w[1].1 - w[0].1).clamp(1.0, FAR);
                (w[1].0, w[0].0, neighbours.powf(steps))
            }));
        }
        Self { links, neighbours }
    }

    /// What each observation has beyond the one before it, as large as its own error.
    pub(super) fn apply(&self, columns: &mut DMatrix<f64>) {
        for mut column in columns.column_iter_mut() {
            for &(i, j, c) in &self.links {
                column[i] = (column[i] - c * column[j]) / (1.0 - c * c).sqrt();
            }
        }
    }

    /// ln of the determinant of the correlations.
    pub(super) fn ln_det(&self) -> f64 {
        self.links.iter().map(|(_, _, c)| (-c * c).ln_1p()).sum()
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
    let all = tried().map(|c| (c, ln_likelihood(c) - none));
    all.fold((0.0, 0.0), |best, next| if next.1 > best.1 { next } else { best })
}

/// The correlations that are tried, rising.
fn tried() -> impl Iterator<Item = f64> {
    TWENTIETHS.map(|k| f64::from(k) / 20.0)
}

/// The same beside what captures share, whatever that is: from what each of them leaves within it, by restricted likelihood.
pub(super) fn likeliest_within(layout: &Layout, keep: &[bool], residual: &[f64]) -> (f64, f64) {
    let residual = DMatrix::from_column_slice(residual.len(), 1, residual);
    let ln_likelihood = |neighbours: f64| {
        let space = Space::with_serial(layout, keep, neighbours);
        let split = space.split(&residual);
        let within = split.rows(space.top(), residual.nrows()).norm_squared();
        let shared: f64 = space.groups.iter().map(|g| g.q.ncols() as f64).sum();
        let used = space.groups.iter().filter(|g| !g.q.is_empty());
        let ln_shared: f64 = used.map(|g| ln_det(&g.r)).sum();
        let dof = space.observations() as f64 - shared;
        let ln_serial = space.serial.as_ref().map_or(0.0, Serial::ln_det);
        -0.5 * (dof * within.max(1e-300).ln() + ln_serial + ln_shared)
    };
    // Up to its one peak: thousands of points are split anew for each.
    let none = ln_likelihood(0.0);
    let mut best = (0.0, 0.0);
    for c in tried() {
        let gain = ln_likelihood(c) - none;
        if gain <= best.1 {
            break;
        }
        best = (c, gain);
    }
    best
}

/// ln of the determinant of RᵀR, as far as it has a rank.
fn ln_det(r: &DMatrix<f64>) -> f64 {
    2.0 * r.singular_values().iter().map(|s| s.max(1e-12).ln()).sum::<f64>()
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
            chains: (0..2).map(|o| (0..rows).map(|r| (2 * r + o, r as f64)).collect()).collect(),
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
        assert!(!serial.links.iter().any(|(i, j, _)| *i == 100 || *j == 100));
        assert!(serial.links.contains(&(102, 98, 0.25)));
        assert!(serial.links.contains(&(101, 99, 0.5)));

        let (layout, e) = wandering(300, 0.0);
        assert!(likeliest(&layout, &keep, &e, &none).1 < 3.0);
    }
}
