//! Taking parts out of a model, and what they explain given all others.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::Active;
use crate::diagnose::fit::{Extra, ExtraTerm, Fitted, Fitter, Model};
use crate::diagnose::pool::{Pool, Who, choice, searched};
use crate::diagnose::score::{Score, Standing};

/// A removable part of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    /// A named effect by its place in the model.
    Effect(usize),
    /// An extra term by its place in the model.
    Extra(usize),
}

/// What an effect or term adds to the prediction, mm.
pub fn contribution(fitter: &Fitter, model: &Model, part: Part) -> Vec<f64> {
    let mut without = model.clone();
    match part {
        Part::Effect(i) => {
            without.active.remove(i);
        }
        Part::Extra(i) => {
            without.extras.remove(i);
        }
    }
    let with = fitter.predict(model);
    with.iter().zip(fitter.predict(&without)).map(|(a, b)| a - b).collect()
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

/// The model with one more part, not yet fitted.
pub fn add(fitter: &Fitter, model: &Model, who: &Who) -> Model {
    match who {
        Who::Effect(active) => {
            let mut next = model.clone();
            next.active.push(active.clone());
            next
        }
        Who::Extra(kind @ Extra::Generic(term)) => {
            let mut columns = term.columns(fitter.experiment.layout());
            let own = term.own_columns(columns.ncols());
            for mut constant in columns.column_iter_mut().skip(own) {
                // Two of it would drift apart without end.
                if fitter.baseline_has(model, &constant.clone_owned()) {
                    constant.fill(0.0);
                }
            }
            with_extra(model, kind, columns)
        }
        Who::Extra(Extra::Form { .. }) => model.clone(),
    }
}

/// The model with an extra term, not yet fitted.
pub fn with_extra(model: &Model, kind: &Extra, columns: DMatrix<f64>) -> Model {
    let mut next = model.clone();
    let values = vec![0.0; columns.ncols()];
    next.extras.push(ExtraTerm { kind: kind.clone(), columns, values });
    next
}

/// The model without several parts.
pub fn remove_all(model: &Model, gone: &[Part]) -> Model {
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
    let put_back: Vec<_> = all.iter().map(|&p| (range(p), along(fitter, f, p, range(p)))).collect();
    let standing = Standing::new(fitter, f, &put_back);
    let (mut linear, mut shape_parameters, mut free) = (Vec::new(), 0, false);
    let (mut choices, mut searches) = (0.0, 0.0);
    for &part in &all {
        match part {
            Part::Effect(i) => {
                let who = Who::Effect(f.model.active[i].clone());
                choices += choice(fitter, &who);
                searches += searched(fitter, &who);
                let (columns, shapes) = linear_columns(fitter, &f.model.active[i], range(part));
                linear.extend(columns);
                shape_parameters += shapes;
            }
            Part::Extra(i) => {
                linear.extend(range(part));
                choices += choice(fitter, &Who::Extra(f.model.extras[i].kind.clone()));
                if let Extra::Generic(t) = &f.model.extras[i].kind {
                    shape_parameters += t.shape.places();
                    free |= t.shape.is_free();
                }
            }
        }
    }
    let block = f.tangent.select_columns(&linear);
    // A single generic term is judged as what it is; several parts together by their parameters.
    let kind = match all[..] {
        [Part::Extra(i)] => f.model.extras[i].kind.clone(),
        _ => Extra::Form { effect: usize::MAX, variable: 0 },
    };
    let mut pool = Pool::of_extras(fitter, vec![(kind, block)]);
    pool.candidates[0].shape_parameters = shape_parameters;
    pool.candidates[0].free = free;
    pool.candidates[0].choice = choices;
    pool.candidates[0].searched = searches;
    let score = standing.scores(fitter, f, &pool).into_iter().next();
    (standing, score)
}

/// What a part adds, in the tangent of the fit: a scale far from its zero moves a rod by more than its curvature allows, and the
/// baseline takes that up again.
fn along(fitter: &Fitter, f: &Fitted, part: Part, range: std::ops::Range<usize>) -> Vec<f64> {
    let linear = match part {
        Part::Effect(i) => linear_columns(fitter, &f.model.active[i], range).0,
        Part::Extra(_) => range.collect(),
    };
    if linear.is_empty() {
        return contribution(fitter, &f.model, part);
    }
    let free = fitter.free(&f.model);
    let mut sum = vec![0.0; f.residual.len()];
    for c in linear {
        sum.iter_mut().zip(f.tangent.column(c).iter()).for_each(|(s, t)| *s += free[c] * t);
    }
    sum
}

/// What a part adds that the rest of the model could not, whitened.
pub fn beside_the_rest(fitter: &Fitter, f: &Fitted, part: Part) -> DVector<f64> {
    let offsets = fitter.offsets(&f.model);
    let at = match part {
        Part::Effect(i) => i,
        Part::Extra(i) => f.model.active.len() + i,
    };
    let own = offsets[at]..offsets[at + 1];
    let white = fitter.whiten(&f.tangent, &f.noise);
    let others: Vec<usize> = (0..white.ncols()).filter(|c| !own.contains(c)).collect();
    let basis = orthonormal(&white.select_columns(&others), 1e-7);
    let sum = along(fitter, f, part, own);
    let shape = fitter.whiten(&DMatrix::from_column_slice(sum.len(), 1, &sum), &f.noise);
    let shape = shape.column(0);
    shape - &basis * basis.tr_mul(&shape)
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
