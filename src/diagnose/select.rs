//! Which effects are in the data: forward selection with backward checks and swaps, joint exact refits, and generic
//! shapes in competition with the library.

use nalgebra::DMatrix;

use crate::diagnose::experiment::Active;
use crate::diagnose::fit::{Extra, ExtraTerm, Fitted, Fitter, Model};
use crate::diagnose::generic::legendre;
use crate::diagnose::score::{Part, Pool, Score, Standing, Who, contribution, effective_tests};

/// Chance of any false name where nothing is hidden.
const ALPHA_LIBRARY: f64 = 0.005;
/// Chance of any false generic term where nothing is hidden.
const ALPHA_GENERIC: f64 = 0.002;
/// A generic shape must be this much more likely than a library effect to be preferred, nats.
pub const LIBRARY_BONUS: f64 = 4.6;
/// Share of the explained variance that a further effect must have (a tenth of the gap).
const LEAST_SHARE: f64 = 0.01;
/// χ² a further effect must have: below it, a wrong functional form of the first is as likely a cause.
const LEAST_CHI2: f64 = 30.0;
/// A remainder under this share of a named effect's own χ², in its own variable, is put down to its form.
const FORM_SHARE: f64 = 0.1;
/// What a second part must gain beyond its parameters to stand beside a single name, nats.
const SECOND_NAME: f64 = 3.0;
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
}

/// Runs the selection.
pub fn select(fitter: &Fitter) -> Selection {
    let baseline = fitter.fit(fitter.baseline(), None);
    let library = Pool::library(fitter, &baseline.model.nuisances);
    let generic = Pool::generic(fitter);
    let standing = Standing::new(fitter, &baseline, &[]);
    let library_tests = effective_tests(fitter, &baseline, &standing, &library);
    let generic_tests = (0.6 * generic.candidates.len() as f64).max(1.0);
    let fitted = baseline.clone();
    let mut s = Selection { baseline, fitted, library, generic, library_tests, generic_tests };
    for _ in 0..MOST_PARTS {
        let Some(next) = s.next(fitter) else { break };
        s.fitted = fitter.fit(next, Some(&s.fitted.noise));
        s.swap(fitter);
        s.merge(fitter);
        s.split(fitter);
        s.drop_weak(fitter);
    }
    s
}

impl Selection {
    /// The model with the most convincing addition, if there is one.
    fn next(&self, fitter: &Fitter) -> Option<Model> {
        let f = &self.fitted;
        let effects = fitter.experiment.effects();
        let standing = Standing::new(fitter, f, &[]);
        let taken = |s: &Score| match &self.library.candidates[s.candidate].who {
            Who::Effect(a) => f.model.active.iter().any(|b| b.effect == a.effect),
            Who::Extra(_) => false,
        };
        let library = best(
            standing
                .scores(fitter, f, &self.library)
                .into_iter()
                .filter(|s| !taken(s) && s.ln_p + self.library_tests.ln() < ALPHA_LIBRARY.ln()),
        );
        let generic = best(
            standing
                .scores(fitter, f, &self.generic)
                .into_iter()
                .filter(|s| s.ln_p + self.generic_tests.ln() < ALPHA_GENERIC.ln()),
        );
        if f.model.active.is_empty() && f.model.extras.is_empty() {
            return match (library, generic) {
                (Some(l), g)
                    if g.as_ref().is_none_or(|g| l.evidence >= g.evidence - LIBRARY_BONUS) =>
                {
                    Some(self.with_library(&l))
                }
                (_, Some(g)) => Some(with_extra(fitter, &f.model, &[], &self.generic, &g)),
                _ => None,
            };
        }
        let form_columns = self.form_terms(fitter);
        let forms = Pool::of_terms(fitter, form_columns.clone());
        let form_tests = (forms.candidates.len() as f64).max(1.0).ln();
        let form = best(
            standing
                .scores(fitter, f, &forms)
                .into_iter()
                .filter(|s| s.ln_p + form_tests < 1e-3_f64.ln()),
        );
        let named = self.strongest_named(fitter);
        let explained = self.explained(fitter);
        // Exact geometry has no form to be wrong: what remains beside it is something else, whatever its size.
        let loose = f.model.active.iter().any(|a| !effects[a.effect].varies_with.is_empty());
        let least = if loose { LEAST_CHI2 } else { 0.0 };
        let big = |s: &Score| s.excess() > least && s.excess() > LEAST_SHARE * explained;
        let library = library.filter(|l| big(l));
        let shapes = f.model.extras.iter().filter(|e| matches!(e.kind, Extra::Generic(_))).count();
        let generic = generic.filter(|g| big(g) && shapes < MOST_SHAPES);
        let rival = library.iter().chain(&generic).map(|s| s.evidence).fold(f64::MIN, f64::max);
        let rival_chi2 = library.iter().chain(&generic).map(Score::excess).fold(0.0, f64::max);
        if let Some(x) = &form {
            let small = rival_chi2 < FORM_SHARE * named;
            if x.evidence >= rival - LIBRARY_BONUS || (small && x.evidence > 0.6 * rival) {
                return Some(with_extra(fitter, &f.model, &form_columns, &forms, x));
            }
        }
        match (library, generic) {
            (Some(l), g) if g.as_ref().is_none_or(|g| l.evidence >= g.evidence - LIBRARY_BONUS) => {
                Some(self.with_library(&l))
            }
            (_, Some(g)) => Some(with_extra(fitter, &f.model, &[], &self.generic, &g)),
            _ => None,
        }
    }

    fn with_library(&self, score: &Score) -> Model {
        let mut model = self.fitted.model.clone();
        if let Who::Effect(active) = &self.library.candidates[score.candidate].who {
            model.active.push(active.clone());
        }
        model
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
                let (low, high) = crate::diagnose::generic::range(&v.values);
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

    /// Replaces parts by better ones while that helps.
    fn swap(&mut self, fitter: &Fitter) {
        for _ in 0..3 {
            let Some(model) = self.better_swap(fitter) else { return };
            self.fitted = fitter.fit(model, Some(&self.fitted.noise));
        }
    }

    fn better_swap(&self, fitter: &Fitter) -> Option<Model> {
        let f = &self.fitted;
        let mut found: Option<(f64, Model)> = None;
        for part in parts(&f.model) {
            let (standing, own) = without(fitter, f, &[part]);
            let own_bonus = if matches!(part, Part::Effect(_)) { LIBRARY_BONUS } else { 0.0 };
            let own = own.map_or(0.0, |s| s.evidence) + own_bonus;
            let other_effects: Vec<usize> = f
                .model
                .active
                .iter()
                .enumerate()
                .filter(|(i, _)| part != Part::Effect(*i))
                .map(|(_, a)| a.effect)
                .collect();
            let mut consider = |score: &Score, bonus: f64, model: &dyn Fn() -> Model| {
                let gain = score.evidence + bonus - own;
                if gain > 1.0 && found.as_ref().is_none_or(|(g, _)| gain > *g) {
                    found = Some((gain, model()));
                }
            };
            for s in standing.scores(fitter, f, &self.library) {
                if let Who::Effect(a) = &self.library.candidates[s.candidate].who {
                    if other_effects.contains(&a.effect) {
                        continue;
                    }
                    consider(&s, LIBRARY_BONUS, &|| {
                        let mut model = remove(&f.model, part);
                        model.active.push(a.clone());
                        model
                    });
                }
            }
            for s in standing.scores(fitter, f, &self.generic) {
                consider(&s, 0.0, &|| {
                    with_extra(fitter, &remove(&f.model, part), &[], &self.generic, &s)
                });
            }
        }
        found.map(|(_, model)| model)
    }

    /// Replaces two parts by one name where that one explains (nearly) as much.
    fn merge(&mut self, fitter: &Fitter) {
        let Some(model) = self.better_merge(fitter) else { return };
        self.fitted = fitter.fit(model, Some(&self.fitted.noise));
    }

    fn better_merge(&self, fitter: &Fitter) -> Option<Model> {
        let f = &self.fitted;
        let all = parts(&f.model);
        let mut found: Option<(f64, Model)> = None;
        for (i, &a) in all.iter().enumerate() {
            for &b in &all[i + 1..] {
                let (standing, own) = without(fitter, f, &[a, b]);
                // A name costs more than its parameters: two must beat one clearly.
                let own = own.map_or(0.0, |s| s.evidence) - SECOND_NAME;
                let rest = remove_all(&f.model, &[a, b]);
                for s in standing.scores(fitter, f, &self.library) {
                    let Who::Effect(c) = &self.library.candidates[s.candidate].who else {
                        continue;
                    };
                    let gain = s.evidence - own;
                    if rest.active.iter().any(|r| r.effect == c.effect)
                        || gain < 0.0
                        || found.as_ref().is_some_and(|(g, _)| gain <= *g)
                    {
                        continue;
                    }
                    let mut model = rest.clone();
                    model.active.push(c.clone());
                    found = Some((gain, model));
                }
            }
        }
        found.map(|(_, model)| model)
    }

    /// Replaces a generic term by two library effects where those explain as much together.
    fn split(&mut self, fitter: &Fitter) {
        let f = &self.fitted;
        let generic = |e: &ExtraTerm| matches!(e.kind, Extra::Generic(_));
        let Some(at) = f.model.extras.iter().position(generic) else { return };
        let (standing, own) = without(fitter, f, &[Part::Extra(at)]);
        let own = own.map_or(0.0, |s| s.evidence) - LIBRARY_BONUS + SECOND_NAME;
        let rest = remove(&f.model, Part::Extra(at));
        let mut firsts = standing.scores(fitter, f, &self.library);
        firsts.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let mut tried: Vec<usize> = rest.active.iter().map(|a| a.effect).collect();
        let mut found: Option<(f64, Fitted)> = None;
        for first in firsts {
            let Who::Effect(a) = &self.library.candidates[first.candidate].who else { continue };
            if tried.contains(&a.effect) {
                continue;
            }
            if tried.len() >= rest.active.len() + 3 {
                break;
            }
            tried.push(a.effect);
            let mut model = rest.clone();
            model.active.push(a.clone());
            let with_first = fitter.fit(model.clone(), Some(&f.noise));
            let standing = Standing::new(fitter, &with_first, &[]);
            let taken: Vec<usize> = model.active.iter().map(|a| a.effect).collect();
            let second =
                best(standing.scores(fitter, &with_first, &self.library).into_iter().filter(|s| {
                    match &self.library.candidates[s.candidate].who {
                        Who::Effect(b) => !taken.contains(&b.effect),
                        Who::Extra(_) => false,
                    }
                }));
            let Some(second) = second else { continue };
            let Who::Effect(b) = &self.library.candidates[second.candidate].who else { continue };
            model.active.push(b.clone());
            let both = fitter.fit(model, Some(&f.noise));
            let n = both.model.active.len();
            let pair = without(fitter, &both, &[Part::Effect(n - 2), Part::Effect(n - 1)]).1;
            // The two are judged with the generic term's noise, or a poorer fit would look better.
            let ratio = (both.noise.sigma_mm[0] / f.noise.sigma_mm[0]).powi(2);
            let gain = pair.map_or(f64::MIN, |s| s.evidence * ratio) - own;
            if ratio < 1.1 && gain > 0.0 && found.as_ref().is_none_or(|(g, _)| gain > *g) {
                found = Some((gain, both));
            }
        }
        if let Some((_, both)) = found {
            self.fitted = both;
        }
    }

    /// Removes parts that later additions have made needless.
    fn drop_weak(&mut self, fitter: &Fitter) {
        for _ in 0..4 {
            let f = &self.fitted;
            let weakest = parts(&f.model)
                .into_iter()
                .filter_map(|p| {
                    let ln_p = without(fitter, f, &[p]).1.map_or(0.0, |s| s.ln_p);
                    let tests = match p {
                        Part::Effect(_) => self.library_tests,
                        Part::Extra(i) => match f.model.extras[i].kind {
                            Extra::Generic(_) => self.generic_tests,
                            Extra::Form { .. } => 1.0,
                        },
                    };
                    let weak = ln_p + tests.ln() > 0.02_f64.ln();
                    weak.then_some((ln_p, p))
                })
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, part)) = weakest else { return };
            let model = remove(&f.model, part);
            self.fitted = fitter.fit(model, Some(&f.noise));
        }
    }
}

/// The strongest evidence of a list.
fn best(scores: impl Iterator<Item = Score>) -> Option<Score> {
    scores.max_by(|a, b| a.evidence.total_cmp(&b.evidence))
}

/// All removable parts.
pub fn parts(model: &Model) -> Vec<Part> {
    let effects = (0..model.active.len()).map(Part::Effect);
    effects.chain((0..model.extras.len()).map(Part::Extra)).collect()
}

/// The model without one part; a named effect takes the corrections of its form with it.
pub fn remove(model: &Model, part: Part) -> Model {
    let mut next = model.clone();
    match part {
        Part::Effect(i) => {
            let gone = next.active.remove(i).effect;
            next.extras.retain(|e| !matches!(e.kind, Extra::Form { effect, .. } if effect == gone));
        }
        Part::Extra(i) => {
            next.extras.remove(i);
        }
    }
    next
}

fn with_extra(
    fitter: &Fitter,
    model: &Model,
    forms: &[(Extra, DMatrix<f64>)],
    pool: &Pool,
    score: &Score,
) -> Model {
    let mut next = model.clone();
    if let Who::Extra(kind) = &pool.candidates[score.candidate].who {
        let columns = match kind {
            Extra::Generic(term) => Some(term.columns(fitter.experiment.layout())),
            Extra::Form { .. } => forms.iter().find(|(k, _)| k == kind).map(|(_, c)| c.clone()),
        };
        if let Some(columns) = columns {
            let values = vec![0.0; columns.ncols()];
            next.extras.push(ExtraTerm { kind: kind.clone(), columns, values });
        }
    }
    next
}

/// The model without several parts.
fn remove_all(model: &Model, gone: &[Part]) -> Model {
    let mut sorted = gone.to_vec();
    // Extra terms first, from the back, so that the places of the others stay.
    sorted.sort_by_key(|p| match p {
        Part::Extra(i) => (0, usize::MAX - i),
        Part::Effect(i) => (1, usize::MAX - i),
    });
    sorted.into_iter().fold(model.clone(), |m, p| remove(&m, p))
}

/// The standing of a fitted model without some parts (named effects take the corrections of their form along), and
/// the parts' own joint score on it.
pub fn without(fitter: &Fitter, f: &Fitted, gone: &[Part]) -> (Standing, Option<Score>) {
    let offsets = fitter.offsets(&f.model);
    let range = |part: Part| {
        let i = match part {
            Part::Effect(i) => i,
            Part::Extra(i) => f.model.active.len() + i,
        };
        offsets[i]..offsets[i + 1]
    };
    let mut all = gone.to_vec();
    for (k, e) in f.model.extras.iter().enumerate() {
        let follows = |p: &Part| {
            matches!((p, &e.kind), (Part::Effect(i), Extra::Form { effect, .. })
                if f.model.active[*i].effect == *effect)
        };
        if gone.iter().any(follows) && !gone.contains(&Part::Extra(k)) {
            all.push(Part::Extra(k));
        }
    }
    let put_back: Vec<_> =
        all.iter().map(|&p| (range(p), contribution(fitter, &f.model, p))).collect();
    let standing = Standing::new(fitter, f, &put_back);
    let (mut linear, mut shape_parameters, mut free) = (Vec::new(), 0, false);
    for &part in &all {
        match part {
            Part::Effect(i) => {
                let (columns, shapes) = linear_columns(fitter, &f.model.active[i], range(part));
                linear.extend(columns);
                shape_parameters += shapes;
            }
            Part::Extra(i) => {
                linear.extend(range(part));
                if let Extra::Generic(t) = &f.model.extras[i].kind {
                    shape_parameters += t.shape.places();
                    free |= t.shape.is_free();
                }
            }
        }
    }
    let block = f.tangent.select_columns(&linear);
    let kind = Extra::Form { effect: usize::MAX, variable: 0 };
    let mut pool = Pool::of_terms(fitter, vec![(kind, block)]);
    pool.candidates[0].shape_parameters = shape_parameters;
    pool.candidates[0].free = free;
    let score = standing.scores(fitter, f, &pool).into_iter().next();
    (standing, score)
}

/// Tangent columns of an effect's linear parameters, and the number of its form parameters.
fn linear_columns(
    fitter: &Fitter,
    active: &Active,
    range: std::ops::Range<usize>,
) -> (Vec<usize>, usize) {
    let form = &fitter.experiment.effects()[active.effect].forms[active.form];
    let free: Vec<bool> =
        form.iter().filter(|p| !p.is_switch()).map(|p| p.grid.is_empty()).collect();
    let linear = range.zip(&free).filter(|(_, linear)| **linear).map(|(c, _)| c).collect();
    (linear, free.iter().filter(|linear| !**linear).count())
}

/// χ² that one part explains given all others.
pub fn part_chi2(fitter: &Fitter, f: &Fitted, part: Part) -> f64 {
    without(fitter, f, &[part]).1.map_or(0.0, |s| s.chi2)
}
