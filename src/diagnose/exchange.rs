//! Second thoughts of the selection: parts that others could stand in for, one by one and two by two.

use crate::diagnose::classes::shows_in_several;
use crate::diagnose::fit::{Extra, ExtraTerm, Fitted, Fitter, Model};
use crate::diagnose::pairs::best_pairs;
use crate::diagnose::parts::{Part, add, parts, remove_all, without};
use crate::diagnose::pool::{Who, choice};
use crate::diagnose::score::{AS_MUCH, Score, Standing};
use crate::diagnose::select::{LEAST_CHI2, Selection, library_bonus};
use crate::diagnose::shape::Shape;

/// What a second part must gain beyond its parameters to stand beside a single name, nats.
const SECOND_NAME: f64 = 3.0;
/// An exchange of like for like must gain this much, nats, so that aliases do not take turns.
const LEAST_GAIN: f64 = 1.0;
/// What leaves this much more noise than what it replaced fits worse, whatever the linearised score said: unless it is likelier
/// at the price of free functions, as names are than a shape that fitted the first output too well and left the others as they were.
const MORE_NOISE: f64 = 1.03;
/// How much likelier it is beforehand that a shape without a name has another term than that a name lies in its variable and output, nats.
const MORE_OF_A_SHAPE: f64 = 2.0;
/// A name that takes a shape's constant explains this much of both at least.
const CONSTANT_SHARE: f64 = 0.95;
/// Names tried beneath a free function.
const NAMES_UNCOVERED: usize = 3;
/// Exchanges after each addition.
const MOST_EXCHANGES: usize = 3;

impl Selection {
    /// Replaces parts by better ones while that helps: a part by a name or a shape, two parts by one name or by two
    /// others, a shape without a name by two names.
    pub(super) fn exchange(&mut self, fitter: &Fitter) {
        for _ in 0..MOST_EXCHANGES {
            let Some((_, model)) = self.better(fitter) else { return };
            let next = fitter.fit(model, Some(&self.fitted.noise));
            let f = &self.fitted;
            // The noise that captures share may have moved too far for the scores: Akaike's price, corrected for few captures.
            let gain = fitter.ln_likelihood(&next) - fitter.ln_likelihood(f);
            let layout = fitter.experiment.layout();
            let (more, captures) = (next.rank as f64 - f.rank as f64, layout.group_count() as f64);
            let price = more * captures / (captures - more - 1.0).max(1.0);
            // A name that explains as much as a shape is what it is.
            let shapes = |f: &Fitted| f.model.extras.iter().filter(|e| e.is_shape()).count();
            // So is a shape that is more of one that is there.
            let named = |f: &Fitted| f.model.active.len();
            let goes_on = named(&next) < named(f) && goes_on(&next.model);
            let slack = match shapes(&next) < shapes(f) || goes_on {
                true => 0.5 * AS_MUCH,
                false => 0.0,
            };
            let noisier = next.noise.sigma_mm[0] > MORE_NOISE * f.noise.sigma_mm[0];
            let spared = free_price(fitter, f) - free_price(fitter, &next);
            if (noisier && gain + spared < 0.0)
                || (!layout.random.is_empty() && gain + slack < price)
            {
                return;
            }
            self.fitted = next;
        }
    }

    /// The exchange that gains most, with its gain in nats.
    fn better(&self, fitter: &Fitter) -> Option<(f64, Model)> {
        let all = parts(&self.fitted.model);
        let singles = all.iter().map(|p| vec![*p]);
        let pairs =
            all.iter().enumerate().flat_map(|(i, a)| all[i + 1..].iter().map(|b| vec![*a, *b]));
        singles
            .chain(pairs)
            .filter_map(|gone| self.instead(fitter, &gone))
            .max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The best that could stand in for one or two parts, if it is better.
    fn instead(&self, fitter: &Fitter, gone: &[Part]) -> Option<(f64, Model)> {
        let f = &self.fitted;
        let (standing, score) = without(fitter, f, gone);
        let own = score.as_ref().map_or(0.0, |s| s.evidence);
        let rest = remove_all(&f.model, gone);
        let is_form = |p: &Part| matches!(p, Part::Extra(i) if matches!(f.model.extras[*i].kind, Extra::Form { .. }));
        let single = gone.len() == 1;
        let named = matches!(gone[0], Part::Effect(_));
        let is_it =
            |s: &Score| single && !named && score.as_ref().is_some_and(|g| s.explains_as_much(g));
        // A generic shape competes at a handicap; two parts must beat one name clearly.
        let own = match (single, named) {
            (true, true) => own + LEAST_GAIN,
            (true, false) => own - library_bonus(fitter) + LEAST_GAIN,
            (false, _) => own - SECOND_NAME,
        };
        let free = |effect: usize| !rest.active.iter().any(|a| a.effect == effect);
        let mut found: Option<(f64, Model)> = None;
        let mut consider = |gain: f64, names: &[&Who]| {
            if gain > 0.0 && found.as_ref().is_none_or(|(g, _)| gain > *g) {
                found =
                    Some((gain, names.iter().fold(rest.clone(), |m, who| add(fitter, &m, who))));
            }
        };
        for s in standing.scores(fitter, f, &self.library) {
            let who = &self.library.candidates[s.candidate].who;
            if matches!(who, Who::Effect(a) if free(a.effect)) {
                let least = if is_it(&s) { LEAST_GAIN } else { f64::MIN };
                consider((s.evidence - own).max(least), &[who]);
            }
        }
        // A free function is as good as any other; the dictionary is long.
        let free_goes = matches!(gone[0], Part::Extra(i) if is_free(&f.model.extras[i]));
        if single
            && !free_goes
            && let Some((who, s)) = self.best_generic(fitter, &standing, f)
        {
            let gain = s.evidence - library_bonus(fitter) - own;
            if named && goes_on(&add(fitter, &rest, &who)) {
                // A cubic is a straight line and more: no name beside a curve. It is no other choice than that curve.
                consider(gain + choice(fitter, &who) + MORE_OF_A_SHAPE, &[&who]);
            } else if !(named && score.as_ref().is_some_and(|own| own.explains_as_much(&s))) {
                consider(gain, &[&who]);
            }
        }
        if !gone.iter().any(is_form) {
            let own = match (single, named) {
                (true, true) => own,
                (true, false) => own - LEAST_GAIN,
                (false, _) => own + LEAST_GAIN,
            };
            for (s, pair) in best_pairs(fitter, f, &standing, &self.library, &free, &is_it) {
                // That a single name stays, beside a second one, is for the next addition to say; but a curved form of it may have
                // been taken for two, where names do not show in several outputs at once, and a form of many coefficients hides
                // a second name wherever fewer explain as much.
                let one = match gone {
                    [Part::Effect(i)] => Some(&f.model.active[*i]),
                    _ => None,
                };
                let fewer = score.as_ref().is_some_and(|own| s.rank < own.rank);
                let any_form = shows_in_several(fitter) && !fewer;
                let stays = |who: &Who| match (who, one) {
                    (Who::Effect(a), Some(one)) => {
                        a.effect == one.effect && (any_form || a.form == one.form)
                    }
                    _ => false,
                };
                if !pair.iter().any(stays) {
                    let least = if is_it(&s) { LEAST_GAIN } else { f64::MIN };
                    consider((s.evidence - SECOND_NAME - own).max(least), &pair.each_ref());
                }
            }
        }
        found
    }

    /// A free function or surface may hide a name: replaces it by a name and another shape where those explain more.
    pub(super) fn uncover(&mut self, fitter: &Fitter) {
        let f = &self.fitted;
        let Some(at) = f.model.extras.iter().position(is_free) else { return };
        if f.model.extras.len() > 1 {
            return;
        }
        let (standing, own) = without(fitter, f, &[Part::Extra(at)]);
        let own = own.map_or(0.0, |s| s.evidence) + SECOND_NAME;
        let rest = remove_all(&f.model, &[Part::Extra(at)]);
        let mut names = standing.scores(fitter, f, &self.library);
        names.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let mut tried: Vec<usize> = rest.active.iter().map(|a| a.effect).collect();
        let mut found: Option<(f64, Fitted)> = None;
        for name in names {
            let who = &self.library.candidates[name.candidate].who;
            let Who::Effect(a) = who else { continue };
            if tried.contains(&a.effect) {
                continue;
            }
            if tried.len() >= rest.active.len() + NAMES_UNCOVERED {
                break;
            }
            tried.push(a.effect);
            let named = fitter.fit(add(fitter, &rest, who), Some(&f.noise));
            let standing = Standing::new(fitter, &named, &[]);
            let Some((shape, _)) = self.best_generic(fitter, &standing, &named) else { continue };
            let both = fitter.fit(add(fitter, &named.model, &shape), Some(&f.noise));
            let pair = [
                Part::Effect(both.model.active.len() - 1),
                Part::Extra(both.model.extras.len() - 1),
            ];
            // Both are judged with the noise of the one, or a poorer fit would look better.
            let ratio = (both.noise.sigma_mm[0] / f.noise.sigma_mm[0]).powi(2);
            let gain =
                without(fitter, &both, &pair).1.map_or(f64::MIN, |s| s.evidence * ratio) - own;
            if ratio < MORE_NOISE.powi(2)
                && gain > 0.0
                && found.as_ref().is_none_or(|(g, _)| gain > *g)
            {
                found = Some((gain, both));
            }
        }
        if let Some((_, both)) = found {
            self.fitted = both;
            // The shape beside the name may be another name's.
            self.exchange(fitter);
        }
    }

    /// Of a shape and the constant that goes with it the constant may be all there is: a name that takes it replaces both where no shape
    /// would be added beside it.
    pub(super) fn name_the_constant(&mut self, fitter: &Fitter) {
        let extras = &self.fitted.model.extras;
        let has_constant = |e: &ExtraTerm| matches!(e.kind, Extra::Generic(t) if t.shape.has_constant() && !t.shape.is_free());
        let Some(at) = extras.iter().position(has_constant) else { return };
        let f = &self.fitted;
        let (standing, own) = without(fitter, f, &[Part::Extra(at)]);
        let Some(own) = own else { return };
        let rest = remove_all(&f.model, &[Part::Extra(at)]);
        let free = |s: &Score| match &self.library.candidates[s.candidate].who {
            Who::Effect(a) => !rest.active.iter().any(|b| b.effect == a.effect),
            Who::Extra(_) => false,
        };
        let names = standing.scores(fitter, f, &self.library).into_iter();
        let most = names
            .filter(|s| s.rank <= own.rank && s.chi2 > CONSTANT_SHARE * own.chi2 && free(s))
            .max_by(|a, b| a.evidence.total_cmp(&b.evidence));
        let Some(name) = most else { return };
        let who = &self.library.candidates[name.candidate].who;
        let named = fitter.fit(add(fitter, &rest, who), Some(&f.noise));
        let standing = Standing::new(fitter, &named, &[]);
        if self.sure_generic(fitter, &standing, &named).is_none() {
            self.fitted = named;
        }
    }

    /// Several shapes in one output and variable are terms of one function that nobody knows: a name that is no more than another
    /// term of it is none.
    pub(super) fn take_for_terms(&mut self, fitter: &Fitter) {
        let places = |m: &Model| m.extras.iter().filter_map(|e| place(&e.kind)).count();
        for i in (0..self.fitted.model.active.len()).rev() {
            let f = &self.fitted;
            if places(&f.model) < 2 {
                return;
            }
            let (standing, own) = without(fitter, f, &[Part::Effect(i)]);
            let Some(own) = own else { continue };
            let rest = remove_all(&f.model, &[Part::Effect(i)]);
            let is_term = |who: &Who| match who {
                Who::Extra(shape) => {
                    let at = place(shape);
                    at.is_some() && rest.extras.iter().filter(|e| place(&e.kind) == at).count() > 1
                }
                Who::Effect(_) => false,
            };
            let scores = standing.scores(fitter, f, &self.generic).into_iter();
            let terms = scores
                .filter(|s| s.explains_as_much(&own))
                .map(|s| (&self.generic.candidates[s.candidate].who, s.evidence))
                .filter(|(who, _)| is_term(who));
            let best = terms.max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((who, _)) = best {
                let next = add(fitter, &rest, who);
                self.fitted = fitter.fit(next, Some(&self.fitted.noise));
            }
        }
    }

    /// Removes parts that later additions have made needless.
    pub(super) fn drop_weak(&mut self, fitter: &Fitter) {
        for _ in 0..4 {
            let f = &self.fitted;
            let shapes = f.model.extras.iter().any(|e| e.is_shape());
            let weakest = parts(&f.model)
                .into_iter()
                .filter_map(|p| {
                    let score = without(fitter, f, &[p]).1;
                    let ln_p = score.as_ref().map_or(0.0, |s| s.ln_p);
                    let tests = match p {
                        Part::Effect(_) => self.library_tests,
                        Part::Extra(i) => match f.model.extras[i].kind {
                            Extra::Generic(_) => self.generic_tests,
                            Extra::Form { .. } => 1.0,
                        },
                    };
                    // Beside a shape a name must be as much as one that would be added to it.
                    let small = shapes
                        && matches!(p, Part::Effect(_))
                        && score.is_some_and(|s| s.cleared_excess() < LEAST_CHI2);
                    let weak = small || ln_p + tests.ln() > 0.02_f64.ln();
                    weak.then_some((ln_p, p))
                })
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, part)) = weakest else { return };
            let model = remove_all(&f.model, &[part]);
            self.fitted = fitter.fit(model, Some(&f.noise));
        }
    }
}

/// Output and variable of a shape in one variable.
fn place(shape: &Extra) -> Option<(usize, usize)> {
    match shape {
        Extra::Generic(t) => match t.shape {
            Shape::Product(..) | Shape::Surface(_) | Shape::Hill(..) => None,
            _ => Some((t.direction, t.variable)),
        },
        Extra::Form { .. } => None,
    }
}

/// Whether the last of a model's shapes is more of another one: a bump, a step and a harmonic of a turn are whole by themselves, two of
/// them or one and something else are not.
fn goes_on(model: &Model) -> bool {
    let Some((last, others)) = model.extras.split_last() else { return false };
    let Some(at) = place(&last.kind) else { return false };
    let mut there = others.iter().filter(|e| place(&e.kind) == Some(at));
    let first = there.next();
    let whole = |e: &ExtraTerm| matches!(&e.kind, Extra::Generic(t) if t.shape.is_whole());
    first.is_some_and(|e| !whole(e)) || there.next().is_some()
}

fn is_free(e: &ExtraTerm) -> bool {
    matches!(&e.kind, Extra::Generic(t) if t.shape.is_free())
}

/// What the coefficients of a model's free functions cost, nats. Their likelihood alone would hold them against any name.
fn free_price(fitter: &Fitter, f: &Fitted) -> f64 {
    let free = (0..f.model.extras.len()).filter(|i| is_free(&f.model.extras[*i]));
    free.map(|i| price(fitter, f, Part::Extra(i))).sum()
}

/// What a part's parameters and its choice cost, nats.
pub(super) fn price(fitter: &Fitter, f: &Fitted, part: Part) -> f64 {
    without(fitter, f, &[part]).1.map_or(0.0, |s| 0.5 * s.chi2 - s.evidence)
}
