//! Whether a model leaves more between sites than captures of the same site differ by.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::fit::{Fitted, Fitter};
use crate::fit::tails::ln_f_tail;

/// p-value under which two outputs are said to repeat unlike well.
const UNLIKE_NOISE_P: f64 = 0.01;
/// How much likelier, in nats, an output's own repeats must be under the scatter of all outputs' repeats than under what it scatters by
/// between sites, before it is held against those of all: else it may merely be noisier than the others.
const LIKELIER: f64 = 4.0;
/// Least degrees of freedom of repeats worth a test.
const LEAST_REPEATS: f64 = 6.0;

/// Sums of squares of one kind of value (an output, a random part): between sites, and within them, with the degrees of freedom that a
/// model left of each.
#[derive(Default)]
pub(super) struct Spread {
    pub between: f64,
    pub between_dof: f64,
    within: f64,
    within_dof: f64,
    /// Degrees of freedom that each counts for: fewer than one where kinds of unlike variance are put together.
    worth: f64,
}

impl Spread {
    /// By how many nats its repeats are likelier under the variance of `all` repeats than under its own between sites.
    fn likelier_than_between(&self, all: &Self) -> f64 {
        let ln_likelihood =
            |variance: f64| -0.5 * (self.within_dof * variance.ln() + self.within / variance);
        let between = self.between / self.between_dof.max(1.0);
        ln_likelihood(all.within / all.within_dof) - ln_likelihood(between)
    }
}

/// ln p-values of the spread of sites against the spread of captures of the same site: of each kind of value, which is told, and of
/// all together where they share one noise.
pub(super) fn repeats_ln_p(
    fitter: &Fitter,
    f: &Fitted,
    white: &DMatrix<f64>,
) -> Vec<(Option<usize>, f64)> {
    let layout = fitter.experiment.layout();
    // In mm where outputs are alike: an effect in one output must not pass for that output's noise.
    let in_mm = layout.random.is_empty();
    let scale = |kind: usize| if in_mm { f.noise.sigma_mm[kind] } else { 1.0 };
    let spreads = spreads(fitter, f, white, &scale);
    let unlike = |a: &Spread, b: &Spread| {
        let ratio = (a.within / a.within_dof) / (b.within / b.within_dof);
        ln_f_tail(ratio, a.within_dof, b.within_dof) < UNLIKE_NOISE_P.ln()
    };
    let shared_noise =
        layout.random.is_empty() && !spreads.iter().any(|a| spreads.iter().any(|b| unlike(a, b)));
    let total = together(&spreads);
    let tested = |between: &Spread, within: &Spread| {
        let dof = between.between_dof;
        let dofs = (dof * between.worth, within.within_dof * within.worth);
        let enough = within.within_dof >= LEAST_REPEATS && dof >= 3.0 && within.within > 0.0;
        let ratio = (between.between / dof) / (within.within / within.within_dof);
        enough.then(|| ln_f_tail(ratio, dofs.0, dofs.1))
    };
    let each = spreads.iter().enumerate().filter_map(|(kind, s)| {
        // Few repeats cannot tell that an output is noisier than the others: its own ones must speak against it too.
        let may_share = shared_noise && s.likelier_than_between(&total) > LIKELIER;
        let ln_p = if may_share { tested(s, &total) } else { tested(s, s) };
        Some((Some(kind), ln_p?))
    });
    let mut list: Vec<_> = each.collect();
    if shared_noise && spreads.len() > 1 {
        list.extend(tested(&total, &total).map(|ln_p| (None, ln_p)));
    }
    list
}

/// Sums of squares of each kind of value in what a fit leaves, whitened and scaled, with the degrees of freedom that its parameters left:
/// those that follow the sites are taken from what sites have in common.
pub(super) fn spreads(
    fitter: &Fitter,
    f: &Fitted,
    white: &DMatrix<f64>,
    scale: &dyn Fn(usize) -> f64,
) -> Vec<Spread> {
    let sites = &fitter.experiment.layout().sites;
    let basis = orthonormal(&fitter.whiten(&f.tangent, &f.noise), 1e-7);
    let mut parts = fitter.space.capture_parts(white.column(0));
    parts.iter_mut().flatten().for_each(|(kind, v)| *v *= scale(*kind));
    let mut spreads = sums(sites, &parts);
    for column in basis.column_iter() {
        let used = sums(sites, &fitter.space.capture_parts(column));
        for (spread, used) in spreads.iter_mut().zip(used) {
            spread.between_dof -= used.between;
            spread.within_dof -= used.within;
        }
    }
    spreads
}

/// Sums of squares of each kind of value, from what every capture shows of it and the captures' sites.
fn sums(sites: &[usize], parts: &[Vec<(usize, f64)>]) -> Vec<Spread> {
    let kinds = parts.iter().flatten().map(|(k, _)| k + 1).max().unwrap_or(0);
    let mut spreads: Vec<Spread> =
        (0..kinds).map(|_| Spread { worth: 1.0, ..Spread::default() }).collect();
    let mut by_site: BTreeMap<usize, Vec<&[(usize, f64)]>> = BTreeMap::new();
    for (part, site) in parts.iter().zip(sites) {
        by_site.entry(*site).or_default().push(part);
    }
    for set in by_site.values() {
        let width = set.iter().map(|v| v.len()).max().unwrap_or(0);
        let same: Vec<_> = set.iter().filter(|v| v.len() == width).collect();
        let count = same.len() as f64;
        for k in 0..width {
            let spread = &mut spreads[same[0][k].0];
            let mean = same.iter().map(|v| v[k].1).sum::<f64>() / count;
            spread.within += same.iter().map(|v| (v[k].1 - mean).powi(2)).sum::<f64>();
            spread.within_dof += count - 1.0;
            spread.between += count * mean * mean;
            spread.between_dof += 1.0;
        }
    }
    spreads
}

/// All kinds together. Sums of squares of unlike variances vary more than their degrees of freedom say (Welch and Satterthwaite): the
/// noisiest output's are most of them.
fn together(spreads: &[Spread]) -> Spread {
    let sum = |of: &dyn Fn(&Spread) -> f64| spreads.iter().map(of).sum::<f64>();
    let variance = |s: &Spread| if s.within_dof > 0.0 { s.within / s.within_dof } else { 0.0 };
    let squares = sum(&|s| s.within_dof * variance(s).powi(2));
    let (within, within_dof) = (sum(&|s| s.within), sum(&|s| s.within_dof));
    Spread {
        between: sum(&|s| s.between),
        between_dof: sum(&|s| s.between_dof),
        within,
        within_dof,
        worth: if squares > 0.0 { within * within / (squares * within_dof) } else { 1.0 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_of_unlike_noise_are_worth_fewer_degrees_of_freedom_together() {
        let of = |variance: f64| Spread {
            between: 60.0 * variance,
            between_dof: 60.0,
            within: 15.0 * variance,
            within_dof: 15.0,
            worth: 1.0,
        };
        assert!((together(&[of(1.0), of(1.0), of(1.0)]).worth - 1.0).abs() < 1e-12);
        // One output four times the others' variance: 36 / (3 * 18).
        let unlike = together(&[of(4.0), of(1.0), of(1.0)]);
        assert!((unlike.worth - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!((unlike.within, unlike.within_dof), (90.0, 45.0));
    }
}
