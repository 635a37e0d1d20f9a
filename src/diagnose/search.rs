//! The likeliest shape without a name: the dictionary's best, with its place searched between those of the dictionary.

use crate::diagnose::fit::{Extra, Fitted, Fitter};
use crate::diagnose::generic::Term;
use crate::diagnose::pool::{Pool, Who};
use crate::diagnose::score::{Score, Standing};
use crate::diagnose::select::{Selection, best};
use crate::diagnose::shape::Shape;

/// Chance of any false generic term where nothing is hidden.
const ALPHA_GENERIC: f64 = 0.001;
/// Steps, bumps and waves of the dictionary, the best of each in a variable and output, whose place is searched more finely; beyond
/// these, steps between captures alone.
const PLACES_REFINED: usize = 8;

impl Selection {
    /// The best shape that is there beyond the chance of a false one.
    pub(super) fn sure_generic(
        &self,
        fitter: &Fitter,
        standing: &Standing,
        f: &Fitted,
    ) -> Option<(Who, Score)> {
        self.best_generic(fitter, standing, f)
            .filter(|(_, s)| s.ln_p + self.generic_tests.ln() < ALPHA_GENERIC.ln())
    }

    /// The most convincing generic shape; a step or bump with its place (and width) searched around the dictionary's.
    pub(super) fn best_generic(
        &self,
        fitter: &Fitter,
        standing: &Standing,
        f: &Fitted,
    ) -> Option<(Who, Score)> {
        if !self.shapes {
            return None;
        }
        let layout = fitter.experiment.layout();
        let mut scores = standing.scores(fitter, f, &self.generic);
        scores.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let who = |s: &Score| &self.generic.candidates[s.candidate].who;
        let placed = |s: &Score| match who(s) {
            Who::Extra(Extra::Generic(t)) if t.shape.is_placed() => Some(*t),
            _ => None,
        };
        // A step beside its place looks poorer than many a bump: between two captures no other place will do.
        let is_sharp =
            |t: &Term| matches!(t.shape, Shape::Step(_)) && !layout.variables[t.variable].within;
        let mut seen = std::collections::HashSet::new();
        let kind = |t: &Term| (t.direction, t.variable, std::mem::discriminant(&t.shape));
        let kinds = scores
            .iter()
            .filter_map(|s| Some((placed(s)?, s.ln_p)))
            .filter(|(t, _)| seen.insert(kind(t)))
            .enumerate()
            .filter(|(i, (t, _))| *i < PLACES_REFINED || is_sharp(t))
            .map(|(_, placed)| placed);
        // One kind after the other: long sweeps have many places.
        let refined = kinds.filter_map(|(t, ln_p)| {
            let finer = Pool::of_terms(fitter, t.around(layout));
            let s = best(standing.scores(fitter, f, &finer))?;
            // A better place says where, not whether: p is that of the dictionary's own place, one of the tests counted.
            Some((finer.candidates[s.candidate].who.clone(), Score { ln_p, ..s }))
        });
        let refined: Vec<_> = refined.collect();
        let coarse = scores.into_iter().next().map(|s| (who(&s).clone(), s));
        let likeliest = coarse
            .into_iter()
            .chain(refined)
            .max_by(|a, b| a.1.evidence.total_cmp(&b.1.evidence))?;
        let hill = best_hill(fitter, standing, f, &likeliest);
        Some(hill.filter(|h| h.1.evidence > likeliest.1.evidence).unwrap_or(likeliest))
    }
}

/// The likeliest bump over two variables of what a shape may stand for: searched coarsely, then twice more finely.
fn best_hill(
    fitter: &Fitter,
    standing: &Standing,
    f: &Fitted,
    shape: &(Who, Score),
) -> Option<(Who, Score)> {
    let (Who::Extra(Extra::Generic(term)), Score { ln_p, .. }) = shape else { return None };
    let layout = fitter.experiment.layout();
    let of = |terms: Vec<Term>| {
        let pool = Pool::of_terms(fitter, terms);
        let s = best(standing.scores(fitter, f, &pool))?;
        Some((pool.candidates[s.candidate].who.clone(), Score { ln_p: *ln_p, ..s }))
    };
    let mut hill = of(term.hills(layout))?;
    for step in [1.0, 0.5] {
        let Who::Extra(Extra::Generic(term)) = &hill.0 else { break };
        hill = of(term.hills_around(layout, step))?;
    }
    Some(hill)
}
