//! Confusable effects: every library name that could stand in a named effect's place on this design.

use crate::diagnose::experiment::Active;
use crate::diagnose::fit::{Fitter, Model};
use crate::diagnose::pairs::best_pairs;
use crate::diagnose::parts::{Part, add, remove, without};
use crate::diagnose::pool::Who;
use crate::diagnose::score::{Score, Standing};
use crate::diagnose::select::Selection;

/// Whether names show in several outputs at once, as no form that is not quite the machine's does.
pub fn shows_in_several(fitter: &Fitter) -> bool {
    fitter.experiment.layout().outputs().count() > 2
}

/// A rival must be this much less likely to be ruled out, nats: odds of 10 to 1 where names show in several outputs at once, of 100 to
/// 1 where a form that is not quite the machine's can make as much of a difference.
fn ruled_out(fitter: &Fitter) -> f64 {
    if shows_in_several(fitter) { 2.3 } else { 4.6 }
}

/// Sizes beyond so many typical ones no machine shows: an alias that would have to be as large is none.
const ABSURD: f64 = 50.0;

/// What is ruled out on the grid of its lags and about its size zero by no more than this may not be between them or at its full size:
/// nats, and a share of what the named effect explains.
const BETWEEN: f64 = 4.0;
const CURVED: f64 = 0.05;

/// How many times what an effect is likelier beforehand is needed to rule it out: a cause that is seen in the data is there, and only
/// its form is not known.
const SEEN: f64 = 3.0;

/// Two names instead of one are as likely if they are less so by no more, nats.
const LESS_LIKELY: f64 = 1.0;

/// A name that fits as well.
#[derive(Debug, Clone)]
pub struct Rival {
    /// Index of the effect.
    pub effect: usize,
    /// Index of its form.
    pub form: usize,
    /// Index of the candidate in the library pool.
    pub candidate: usize,
    /// How much less likely than the named one, nats.
    pub deficit: f64,
}

/// The rivals of each named effect, every form of theirs, likeliest first, of what could stand in its place.
pub fn rivals(selection: &Selection, mut all: Vec<Vec<Rival>>) -> Vec<Vec<Rival>> {
    for (class, own) in all.iter_mut().zip(&selection.fitted.model.active) {
        class.retain(|r| r.effect != own.effect);
    }
    all
}

/// What could stand in each named effect's place: its rivals, and its own other forms.
pub fn stand_ins(fitter: &Fitter, selection: &Selection) -> Vec<Vec<Rival>> {
    let f = &selection.fitted;
    (0..f.model.active.len())
        .map(|i| {
            let (standing, own) = without(fitter, f, &[Part::Effect(i)]);
            let Some(own) = own else { return Vec::new() };
            let named = &f.model.active[i];
            let sane = !absurd(fitter, named, None);
            let taken = |effect: usize| {
                effect != named.effect && f.model.active.iter().any(|a| a.effect == effect)
            };
            let mut best: Vec<Rival> = Vec::new();
            for s in standing.scores(fitter, f, &selection.library) {
                let Who::Effect(a) = &selection.library.candidates[s.candidate].who else {
                    continue;
                };
                let here = (a.effect, a.form) == (named.effect, named.form);
                let too_large = sane && absurd(fitter, a, s.coefficient);
                if here || too_large || taken(a.effect) || s.evidence <= 0.0 {
                    continue;
                }
                let beforehand = fitter.experiment.effects()[a.effect].beforehand;
                let most = ruled_out(fitter) + SEEN * beforehand;
                let mut deficit = own.evidence - s.evidence;
                let far = f64::max(BETWEEN, CURVED * own.evidence);
                if (most..most + far).contains(&deficit) {
                    deficit -= refined(fitter, selection, i, &standing, &s);
                }
                if deficit > most {
                    continue;
                }
                let rival =
                    Rival { effect: a.effect, form: a.form, candidate: s.candidate, deficit };
                match best.iter_mut().find(|r| (r.effect, r.form) == (a.effect, a.form)) {
                    Some(r) if r.deficit <= deficit => {}
                    Some(r) => *r = rival,
                    None => best.push(rival),
                }
            }
            best.sort_by(|a, b| a.deficit.total_cmp(&b.deficit));
            best
        })
        .collect()
}

/// Two names that could be there instead of one.
pub struct PairInstead {
    /// The two.
    pub effects: [usize; 2],
    /// All that is named with them instead.
    pub model: Model,
}

/// Two other names that together explain a named effect as well, with no more coefficients: one name for what may be two is not the
/// plainer answer then.
pub fn pair_instead(fitter: &Fitter, selection: &Selection, i: usize) -> Option<PairInstead> {
    let f = &selection.fitted;
    let (standing, own) = without(fitter, f, &[Part::Effect(i)]);
    let own = own.filter(|own| own.rank >= 2)?;
    // Where a curved form is easily taken for what is two, itself in a plainer form may be one of them.
    let itself = !shows_in_several(fitter);
    let others = f.model.active.iter().enumerate().filter(|(k, _)| !itself || *k != i);
    let free = |effect: usize| !others.clone().any(|(_, a)| a.effect == effect);
    let pairs = best_pairs(fitter, f, &standing, &selection.library, &free, &|_| false);
    let as_good = |pair: &Score| pair.rank <= own.rank && pair.evidence >= own.evidence;
    let (_, pair) = pairs.into_iter().find(|(pair, _)| as_good(pair))?;
    let rest = remove(&f.model, Part::Effect(i));
    let model = pair.iter().fold(rest, |model, who| add(fitter, &model, who));
    let other = fitter.fit(model, Some(&f.noise));
    let two = &other.model.active[other.model.active.len() - 2..];
    let as_likely = fitter.ln_likelihood(&other) > fitter.ln_likelihood(f) - LESS_LIKELY;
    let sane = two.iter().all(|a| !absurd(fitter, a, None));
    let effects = [two[0].effect, two[1].effect];
    (as_likely && sane).then_some(PairInstead { effects, model: other.model })
}

/// What an exact fit gains over the score of a form's columns in place of the effect `i`, nats: its lag between those of the grid, its
/// full size.
fn refined(fitter: &Fitter, s: &Selection, i: usize, standing: &Standing, score: &Score) -> f64 {
    let candidate = &s.library.candidates[score.candidate];
    let f = &s.fitted;
    let rest = remove(&f.model, Part::Effect(i));
    let other = fitter.fit(add(fitter, &rest, &candidate.who), Some(&f.noise));
    let left = fitter.whiten_residual(&other, &f.noise).norm_squared();
    0.5 * (standing.residual.norm_squared() - left - score.chi2).max(0.0)
}

/// Whether an effect is larger than machines show; with the coefficient of its one linear parameter where that is known.
fn absurd(fitter: &Fitter, a: &Active, coefficient: Option<f64>) -> bool {
    let form = &fitter.experiment.effects()[a.effect].forms[a.form];
    let linear = form.iter().zip(&a.values).filter(|(p, _)| p.grid.is_empty() && !p.is_switch());
    let mut sizes = linear.map(|(p, v)| coefficient.unwrap_or(*v).abs() / p.typical);
    sizes.any(|size| size > ABSURD)
}

/// The best form of each rival effect.
pub fn by_name(rivals: &[Rival]) -> impl Iterator<Item = &Rival> {
    let first = |(i, r): &(usize, &Rival)| !rivals[..*i].iter().any(|o| o.effect == r.effect);
    rivals.iter().enumerate().filter(first).map(|(_, r)| r)
}
