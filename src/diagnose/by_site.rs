//! Names beside something unknown that repeats show: captures of one site share what the unknown leaves there, so a site is one witness
//! however often it was measured.

use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::parts::{Part, beside_the_rest, remove};
use crate::diagnose::repeats::{Spread, spreads};
use crate::diagnose::select::Selection;
use crate::fit::tails::ln_f_tail;

/// p-value, all names counted, above which one is not believed against the scatter between sites.
const BELIEVED_P: f64 = 0.01;
/// Degrees of freedom between sites worth a judgement.
const LEAST_SITES: f64 = 3.0;

/// Takes back names that the scatter between sites may have made, weakest first.
pub(super) fn take_back(fitter: &Fitter, selection: &mut Selection) {
    while !selection.fitted.model.active.is_empty() {
        let f = &selection.fitted;
        let scatter = between_sites(fitter, f);
        let names = (0..f.model.active.len()).map(|i| (i, ln_p(fitter, f, i, &scatter)));
        let Some((weakest, p)) = names.max_by(|a, b| a.1.total_cmp(&b.1)) else { return };
        if p + selection.library_tests.max(1.0).ln() < BELIEVED_P.ln() {
            return;
        }
        selection.fitted = fitter.fit(remove(&f.model, Part::Effect(weakest)), Some(&f.noise));
    }
}

/// Of each kind of value, how much sites scatter in units of the noise's variance (1 at least), and with what degrees of freedom.
fn between_sites(fitter: &Fitter, f: &Fitted) -> Vec<(f64, f64)> {
    let spreads = spreads(fitter, f, &fitter.whiten_residual(f, &f.noise), &|_| 1.0);
    let of = |s: &Spread| ((s.between / s.between_dof.max(1.0)).max(1.0), s.between_dof);
    spreads.iter().map(of).collect()
}

/// ln of a name's p-value against the scatter between sites, in the outputs in which it shows.
fn ln_p(fitter: &Fitter, f: &Fitted, name: usize, scatter: &[(f64, f64)]) -> f64 {
    let shape = beside_the_rest(fitter, f, Part::Effect(name));
    let offsets = fitter.offsets(&f.model);
    let rank = (offsets[name + 1] - offsets[name]).max(1) as f64;
    let (mut chi2, mut dof, mut all) = (0.0, 0.0, 0.0);
    let mut add = |square: f64, (variance, sites): (f64, f64)| {
        chi2 += square / variance;
        dof += square * sites;
        all += square;
    };
    let parts = fitter.space.capture_parts(shape.column(0));
    let by_capture: f64 = parts.iter().flatten().map(|(_, v)| v * v).sum();
    parts.iter().flatten().for_each(|(kind, v)| add(v * v, scatter[*kind]));
    // What shows within captures stands against their own noise.
    let within = (shape.norm_squared() - by_capture).max(0.0);
    add(within, (1.0, fitter.space.observations() as f64));
    let dof = if all > 0.0 { dof / all } else { 0.0 };
    let active = &f.model.active[name];
    let form = &fitter.experiment.effects()[active.effect].forms[active.form];
    // What something unknown leaves has a peak at a usual value as easily as at any other that was looked through.
    let searched: f64 = form.iter().map(|p| p.scan.nats).sum();
    if dof < LEAST_SITES { f64::NEG_INFINITY } else { ln_f_tail(chi2 / rank, rank, dof) + searched }
}
