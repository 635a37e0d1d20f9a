//! Two library effects at once: a pair may explain what no single effect shows.

use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::pool::{Pool, Who};
use crate::diagnose::score::{Score, Standing};

/// The pair of different library effects with the most evidence together, every effect that `allowed` admits in each of its
/// forms, and the one with the most of those that `is_it` of itself: their scores together and the two candidates.
pub fn best_pairs(
    fitter: &Fitter,
    fitted: &Fitted,
    standing: &Standing,
    library: &Pool,
    allowed: &dyn Fn(usize) -> bool,
    is_it: &dyn Fn(&Score) -> bool,
) -> Vec<(Score, [Who; 2])> {
    let scores = standing.scores(fitter, fitted, library);
    // One grid point of each form: where it does best alone.
    let mut forms: Vec<((usize, usize), usize, f64)> = Vec::new();
    for s in &scores {
        let Who::Effect(a) = &library.candidates[s.candidate].who else { continue };
        if !allowed(a.effect) {
            continue;
        }
        match forms.iter_mut().find(|(of, ..)| *of == (a.effect, a.form)) {
            Some((_, _, chi2)) if *chi2 >= s.chi2 => {}
            Some(old) => *old = ((a.effect, a.form), s.candidate, s.chi2),
            None => forms.push(((a.effect, a.form), s.candidate, s.chi2)),
        }
    }
    let pairs = forms
        .iter()
        .enumerate()
        .flat_map(|(i, a)| forms[i + 1..].iter().filter(|b| b.0.0 != a.0.0).map(|b| (a.1, b.1)));
    let scored = standing.pair_scores(fitter, fitted, library, pairs);
    let best = |of: &dyn Fn(&Score) -> bool| {
        let those = scored.iter().filter(|(s, _)| of(s));
        those.max_by(|a, b| a.0.evidence.total_cmp(&b.0.evidence))
    };
    let named = |(score, second): &(Score, usize)| {
        let pair = [score.candidate, *second].map(|k| library.candidates[k].who.clone());
        (score.clone(), pair)
    };
    [best(&|_| true), best(is_it)].into_iter().flatten().map(named).collect()
}
