//! Which effects are in the data: forward selection with backward checks and swaps, joint exact refits, and generic
//! shapes in competition with the library.

use nalgebra::DMatrix;

use crate::diagnose::basis::legendre;
use crate::diagnose::experiment::Active;
use crate::diagnose::fit::{Extra, Fitted, Fitter, Model};
use crate::diagnose::pairs::best_pairs;
use crate::diagnose::parts::{Part, add, contribution, part_chi2, with_extra};
use crate::diagnose::pool::{Pool, Who, choice};
use crate::diagnose::resolution::rounded_to_mm;
use crate::diagnose::scan::found;
use crate::diagnose::score::{Score, Standing, effective_tests, gain_of_free};
use crate::fit::tails::ln_f_tail;

/// Chance of any false name where nothing is hidden.
const ALPHA_LIBRARY: f64 = 0.005;
/// Chance of two false names at once where nothing is hidden.
const ALPHA_PAIR: f64 = 0.001;
/// How much likelier a name is than a shape beforehand, nats.
const NAME_BEFOREHAND: f64 = 2.6;
/// Share of the explained variance that a further effect must have (a tenth of the gap).
const LEAST_SHARE: f64 = 0.01;
/// The same of a name that no wrong form of the others could be.
const LEAST_SHARE_APART: f64 = 4e-4;
/// χ² a further effect must have: below it, a wrong functional form of the first is as likely a cause.
pub(super) const LEAST_CHI2: f64 = 30.0;
/// A remainder under this share of a named effect's own χ², in its own variable, is put down to its form.
const FORM_SHARE: f64 = 0.1;
/// p-value of a name, by itself, that is worth a fit.
const WORTH_A_TRIAL: f64 = 0.2;
/// Names this much less likely than the first by their scores are not tried, nats.
const CLEARLY_BETTER: f64 = 10.0;
/// Names whose fits differ by no more are as likely, nats.
const AS_LIKELY: f64 = 2.0;
/// Names tried by a fit.
const MOST_TRIALS: usize = 3;
/// Most parts a model may get.
const MOST_PARTS: usize = 8;

/// Most generic shapes a model may get: that something is unknown is said by then.
const MOST_SHAPES: usize = 3;

/// The outcome of the selection.
pub struct Selection {
    /// The baseline alone, fitted.
    pub baseline: Fitted,
    /// The selected model, fitted.
    pub fitted: Fitted,
    /// Library candidates.
    pub library: Pool,
    /// Generic candidates.
    pub generic: Pool,
    /// Independent tests the library amounts to.
    pub library_tests: f64,
    /// Independent tests the dictionary amounts to.
    pub generic_tests: f64,
    /// Whether shapes without a name may be added.
    pub(super) shapes: bool,
}

/// What may be added: a name, and a shape without one.
struct Rivals {
    library: Option<Score>,
    generic: Option<(Who, Score)>,
}

/// Runs the selection.
pub fn select(fitter: &Fitter) -> Selection {
    let baseline = fitter.fit(fitter.baseline(), None);
    let generic = Pool::generic(fitter);
    let standing = Standing::new(fitter, &baseline, &[]);
    let found = found(fitter, &baseline, &standing);
    let library = Pool::library(fitter, &baseline.model.nuisances, &found);
    let library_tests = effective_tests(fitter, &baseline, &standing, &library);
    let generic_tests = (0.6 * generic.candidates.len() as f64).max(1.0);
    let fitted = baseline.clone();
    let mut s = Selection {
        baseline,
        fitted,
        library,
        generic,
        library_tests,
        generic_tests,
        shapes: true,
    };
    s.grow(fitter);
    s.grow_again(fitter);
    s.take_for_terms(fitter);
    s
}

impl Selection {
    /// Adds part after part, each time with second thoughts about all.
    pub(super) fn grow(&mut self, fitter: &Fitter) {
        let mut tried: Vec<Model> = Vec::new();
        for _ in 0..MOST_PARTS {
            if rounded_to_mm(fitter, &self.fitted).is_some() {
                break;
            }
            let next = self.next(fitter).or_else(|| self.two_in_hiding(fitter));
            let Some(next) = next else { break };
            if tried.iter().any(|t| t.has_same_parts(&next)) {
                // What it added was dropped again after the joint fit, and would be for ever.
                break;
            }
            tried.push(next.clone());
            self.fitted = fitter.fit(next, Some(&self.fitted.noise));
            self.exchange(fitter);
            self.uncover(fitter);
            self.name_the_constant(fitter);
            self.drop_weak(fitter);
        }
    }

    /// The model with the most convincing addition, if there is one.
    fn next(&self, fitter: &Fitter) -> Option<Model> {
        let f = &self.fitted;
        let standing = Standing::new(fitter, f, &[]);
        let rivals = self.rivals(fitter, &standing);
        if f.model.active.is_empty() && f.model.extras.is_empty() {
            return self.addition(fitter, rivals);
        }
        let terms = self.form_terms(fitter);
        let forms = Pool::of_extras(fitter, terms.clone());
        let form_tests = (forms.candidates.len() as f64).max(1.0).ln();
        let form = best(
            standing
                .scores(fitter, f, &forms)
                .into_iter()
                .filter(|s| s.ln_p + form_tests < 1e-3_f64.ln())
                .filter(|s| self.bends(fitter, &terms[s.candidate].0, s)),
        );
        let rivals = self.worth_adding(fitter, rivals, &terms);
        if let Some(form) = form.filter(|form| self.is_form(fitter, form, &rivals)) {
            let (kind, columns) = &terms[form.candidate];
            return Some(with_extra(&f.model, kind, columns.clone()));
        }
        self.addition(fitter, rivals)
    }

    /// The model with two names at once that undo each other, so that neither shows by itself; beside parts without a wrong form.
    fn two_in_hiding(&self, fitter: &Fitter) -> Option<Model> {
        let f = &self.fitted;
        let effects = fitter.experiment.effects();
        let exact = |a: &Active| effects[a.effect].varies_with.is_empty();
        if !f.model.extras.is_empty() || !f.model.active.iter().all(exact) {
            return None;
        }
        let free = |effect: usize| !f.model.active.iter().any(|a| a.effect == effect);
        let standing = Standing::new(fitter, f, &[]);
        let pairs = best_pairs(fitter, f, &standing, &self.library, &free, &|_| false);
        let (score, pair) = pairs.into_iter().next()?;
        let tests = 0.5 * self.library_tests.powi(2);
        let sure = score.ln_p + tests.max(1.0).ln() < ALPHA_PAIR.ln();
        let big = score.cleared_excess() > LEAST_SHARE * self.explained(fitter);
        let all = || pair.iter().fold(f.model.clone(), |model, who| add(fitter, &model, who));
        (sure && big && score.evidence > 0.0).then(all)
    }

    /// Whether a name is there beyond the chance of a false one.
    fn is_sure(&self, name: &Score) -> bool {
        name.ln_p + self.library_tests.ln() < ALPHA_LIBRARY.ln()
    }

    /// The best name and the best shape beside what the model has; a fit decides where their scores are no clear answer.
    fn rivals(&self, fitter: &Fitter, standing: &Standing) -> Rivals {
        let f = &self.fitted;
        let taken = |s: &Score| match &self.library.candidates[s.candidate].who {
            Who::Effect(a) => f.model.active.iter().any(|b| b.effect == a.effect),
            Who::Extra(_) => false,
        };
        let mut generic = self.sure_generic(fitter, standing, f);
        let scores: Vec<Score> =
            standing.scores(fitter, f, &self.library).into_iter().filter(|s| !taken(s)).collect();
        let mut library = best(scores.iter().filter(|s| self.is_sure(s)).cloned());
        if let Some((_, shape)) = &generic {
            let it = |s: &&Score| self.is_sure(s) && s.explains_as_much(shape);
            if let Some(name) = best(scores.iter().filter(it).cloned()) {
                (library, generic) = (Some(name), None);
            }
        }
        let shape = generic.as_ref().map_or(0.0, |(_, g)| g.evidence);
        let tried = self.worth_a_trial(fitter, scores);
        let clear = library.as_ref().is_some_and(|l| l.evidence >= shape) && tried.len() < 2;
        if !clear && !tried.is_empty() {
            let who = |s: &Score| &self.library.candidates[s.candidate].who;
            let mut trials: Vec<Score> =
                tried.iter().map(|s| self.on_trial(fitter, who(s), s)).collect();
            // Of names that fit as well the first by its score stays the first.
            trials[0].evidence += AS_LIKELY;
            library = best(trials.into_iter().filter(|s| self.is_sure(s)));
            generic = generic.map(|(who, s)| (who.clone(), self.on_trial(fitter, &who, &s)));
        }
        Rivals { library, generic }
    }

    /// The model with the name, or with the shape where that is clearly likelier.
    fn addition(&self, fitter: &Fitter, rivals: Rivals) -> Option<Model> {
        let model = &self.fitted.model;
        let strongest = rivals.generic.as_ref().map_or(f64::MIN, |(_, g)| g.evidence);
        match (rivals.library, rivals.generic) {
            (Some(l), _) if l.evidence >= strongest - library_bonus(fitter) => {
                Some(add(fitter, model, &self.library.candidates[l.candidate].who))
            }
            (_, Some((who, _))) => Some(add(fitter, model, &who)),
            _ => None,
        }
    }

    /// Those of the rivals that are more than what a wrong form of the model's parts, `terms`, leaves.
    fn worth_adding(
        &self,
        fitter: &Fitter,
        rivals: Rivals,
        terms: &[(Extra, DMatrix<f64>)],
    ) -> Rivals {
        let f = &self.fitted;
        let effects = fitter.experiment.effects();
        let explained = self.explained(fitter);
        let shapes = f.model.extras.iter().filter(|e| e.is_shape()).count();
        // Exact geometry has no form to be wrong: what remains beside it is something else, whatever its size. A shape without a
        // name is only like what it stands for, and leaves some of it.
        let named_loosely =
            f.model.active.iter().any(|a| !effects[a.effect].varies_with.is_empty());
        let loose = named_loosely || shapes > 0;
        let least = if loose { LEAST_CHI2 } else { 0.0 };
        // Few values are never much above a noise that holds the effect itself: it counts in the noise that it would leave.
        let big = |s: &Score| s.cleared_excess() > least.max(LEAST_SHARE * explained);
        // A name that shows beside all that a wrong form could be is no part of it.
        let of_form = |l: &Score| {
            let columns: Vec<_> = terms.iter().flat_map(|(_, c)| c.column_iter()).collect();
            let beside = Standing::beside(fitter, f, &DMatrix::from_columns(&columns));
            let scores = beside.scores(fitter, f, &self.library);
            !scores.iter().any(|s| s.candidate == l.candidate && self.is_sure(s))
        };
        let small = |s: &Score| s.cleared_excess() > LEAST_SHARE_APART * explained;
        let apart = |l: &Score| !loose || (shapes == 0 && !terms.is_empty() && !of_form(l));
        let library = rivals.library.filter(|l| big(l) || (small(l) && apart(l)));
        let generic = rivals
            .generic
            .filter(|(_, g)| (big(g) || (!loose && small(g))) && shapes < MOST_SHAPES);
        Rivals { library, generic }
    }

    /// Whether a correction is no more than the effect that it corrects.
    fn bends(&self, fitter: &Fitter, correction: &Extra, score: &Score) -> bool {
        let model = &self.fitted.model;
        let mut own = (0..model.active.len()).filter(
            |i| matches!(correction, Extra::Form { effect, .. } if *effect == model.active[*i].effect),
        );
        own.all(|i| score.chi2 <= part_chi2(fitter, &self.fitted, Part::Effect(i)))
    }

    /// Whether what is left is likelier a wrong form of a part than another one.
    fn is_form(&self, fitter: &Fitter, form: &Score, rivals: &Rivals) -> bool {
        let Rivals { library, generic } = rivals;
        let scores = || library.iter().chain(generic.iter().map(|(_, g)| g));
        let rival = scores().map(|s| s.evidence).fold(f64::MIN, f64::max);
        let rival_chi2 = scores().map(Score::cleared_excess).fold(0.0, f64::max);
        // A second name needs no handicap against a bent form of the first; a shape without a name has its own.
        let shape = generic.as_ref().map_or(f64::MIN, |(_, g)| g.evidence - library_bonus(fitter));
        let other = library.as_ref().map_or(shape, |l| l.evidence.max(shape));
        let small = rival_chi2 < FORM_SHARE * self.strongest_named(fitter);
        form.evidence >= other || (small && form.evidence > 0.6 * rival)
    }

    /// The likeliest names, best first, that a fit should decide between. Where captures have random parts of their own, a large
    /// effect passes for those in the noise without it, and its score says too little.
    fn worth_a_trial(&self, fitter: &Fitter, mut scores: Vec<Score>) -> Vec<Score> {
        if fitter.experiment.layout().random.is_empty() {
            return Vec::new();
        }
        scores.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let effect = |s: &Score| match &self.library.candidates[s.candidate].who {
            Who::Effect(a) => Some(a.effect),
            Who::Extra(_) => None,
        };
        let mut tried: Vec<Score> = Vec::new();
        for s in scores.into_iter().filter(|s| s.ln_p < WORTH_A_TRIAL.ln()) {
            let new = !tried.iter().any(|t| effect(t) == effect(&s));
            let near = tried.first().is_none_or(|t| s.evidence > t.evidence - CLEARLY_BETTER);
            if new && near && tried.len() < MOST_TRIALS {
                tried.push(s);
            }
        }
        tried
    }

    /// A score by the likelihood of a fit.
    fn on_trial(&self, fitter: &Fitter, who: &Who, score: &Score) -> Score {
        let f = &self.fitted;
        let trial = fitter.fit(add(fitter, &f.model, who), Some(&f.noise));
        let gain2 = 2.0 * (fitter.ln_likelihood(&trial) - fitter.ln_likelihood(f)).max(0.0);
        let (rank, captures) = (score.rank as f64, fitter.experiment.layout().group_count() as f64);
        let (free, places) = match who {
            Who::Effect(_) => (false, self.library.candidates[score.candidate].shape_parameters),
            Who::Extra(Extra::Generic(t)) => (t.shape.is_free(), t.shape.places()),
            Who::Extra(Extra::Form { .. }) => (false, 0),
        };
        let price = 0.5 * (rank + places as f64) * captures.ln();
        let gain =
            if free { gain_of_free(gain2, rank, captures.ln()) } else { 0.5 * gain2 - price };
        // The F of a likelihood ratio with a noise as uncertain as that of one value a capture.
        let dof = (captures - rank - places as f64).max(1.0);
        let ratio = ((gain2 / captures).exp_m1() * dof / rank).min(1e12);
        let ln_p = ln_f_tail(ratio, rank, dof);
        Score {
            ln_p,
            evidence: gain - choice(fitter, who),
            chi2: gain2,
            cleared: gain2.max(score.cleared),
            ..score.clone()
        }
    }

    /// χ² of everything found so far, in units of the present noise.
    fn explained(&self, fitter: &Fitter) -> f64 {
        let noise = &self.fitted.noise;
        let mut lean = self.baseline.clone();
        lean.noise = noise.clone();
        let before = Standing::new(fitter, &lean, &[]).residual.norm_squared();
        let after = Standing::new(fitter, &self.fitted, &[]).residual.norm_squared();
        (before - after).max(0.0)
    }

    /// χ² of the strongest named effect.
    fn strongest_named(&self, fitter: &Fitter) -> f64 {
        (0..self.fitted.model.active.len())
            .map(|i| part_chi2(fitter, &self.fitted, Part::Effect(i)))
            .fold(0.0, f64::max)
    }

    /// Corrections to the forms of the named effects: their signature times a slow function of a variable.
    fn form_terms(&self, fitter: &Fitter) -> Vec<(Extra, DMatrix<f64>)> {
        let layout = fitter.experiment.layout();
        let model = &self.fitted.model;
        let mut terms = Vec::new();
        for (i, a) in model.active.iter().enumerate() {
            let c = contribution(fitter, model, Part::Effect(i));
            let rms = (c.iter().map(|v| v * v).sum::<f64>() / c.len().max(1) as f64).sqrt();
            for (variable, v) in layout.variables.iter().enumerate() {
                let kind = Extra::Form { effect: a.effect, variable };
                let used = model.extras.iter().any(|e| e.kind == kind);
                let varies = fitter.experiment.effects()[a.effect].varies_with.contains(&v.name);
                if rms == 0.0 || used || !varies {
                    continue;
                }
                let (low, high) = crate::fit::robust::range(&v.values);
                let half = ((high - low) / 2.0).max(1e-12);
                let columns = DMatrix::from_fn(c.len(), 3, |r, k| {
                    let x = (v.values[r] - (low + high) / 2.0) / half;
                    c[r] / rms * legendre(k as u32 + 1, x)
                });
                terms.push((kind, columns));
            }
        }
        terms
    }
}

/// A generic shape must be this much more likely than a library effect to be preferred, nats. A shape has paid for its choice of
/// output and variable, a name not yet for being one of its library. A shape in the only output can be all that a name is; among
/// three outputs a name shows in several at once, which no shape does.
pub(super) fn library_bonus(fitter: &Fitter) -> f64 {
    let names = fitter.experiment.effects().iter().filter(|e| e.untestable.is_none()).count();
    let outputs = fitter.experiment.layout().outputs().count();
    NAME_BEFOREHAND + (3.0 / outputs.max(1) as f64).ln().max(0.0) - (names.max(1) as f64).ln()
}

/// The strongest evidence of a list.
pub(super) fn best(scores: impl IntoIterator<Item = Score>) -> Option<Score> {
    scores.into_iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence))
}
