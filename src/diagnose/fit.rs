//! The joint exact fit: baseline, named effects and extra terms together, with the noise re-estimated.

use std::cell::RefCell;

use nalgebra::{DMatrix, DVector};

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::{Active, Experiment};
use crate::diagnose::generic::Term;
use crate::diagnose::noise::{Noise, Space};
use crate::diagnose::resolution::steps_mm;
use crate::fit::least_squares;

/// What an extra linear term stands for.
#[derive(Debug, Clone, PartialEq)]
pub enum Extra {
    /// A generic shape: something without a name.
    Generic(Term),
    /// A correction to the functional form of a named effect, in one variable.
    Form {
        /// Index of the effect.
        effect: usize,
        /// Index of the variable.
        variable: usize,
    },
}

/// An extra linear term in the model.
#[derive(Debug, Clone)]
pub struct ExtraTerm {
    /// What it stands for.
    pub kind: Extra,
    /// Its columns, mm per unit.
    pub columns: DMatrix<f64>,
    /// Its coefficients.
    pub values: Vec<f64>,
}

impl ExtraTerm {
    /// Whether it is a shape without a name.
    pub fn is_shape(&self) -> bool {
        matches!(self.kind, Extra::Generic(_))
    }
}

/// The model as far as it has been built up.
#[derive(Debug, Clone)]
pub struct Model {
    /// Baseline parameters.
    pub nuisances: Vec<f64>,
    /// Named effects.
    pub active: Vec<Active>,
    /// Extra terms.
    pub extras: Vec<ExtraTerm>,
}

impl Model {
    /// Whether both models have the same effects in the same forms and the same extra terms.
    pub fn has_same_parts(&self, other: &Self) -> bool {
        let effects = |m: &Self| m.active.iter().map(|a| (a.effect, a.form)).collect::<Vec<_>>();
        let extras = self.extras.iter().map(|e| &e.kind);
        effects(self) == effects(other) && extras.eq(other.extras.iter().map(|e| &e.kind))
    }
}

/// A fitted model.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// The model with its fitted values.
    pub model: Model,
    /// Measured minus predicted, mm.
    pub residual: Vec<f64>,
    /// d(prediction)/d(free parameter), mm per unit.
    pub tangent: DMatrix<f64>,
    /// Noise.
    pub noise: Noise,
    /// Covariance of the free parameters.
    pub covariance: DMatrix<f64>,
    /// Number of free parameters the data determine.
    pub rank: usize,
}

/// A model with what it leaves and d(prediction)/d(free parameter).
struct Linear {
    model: Model,
    residual: Vec<f64>,
    tangent: DMatrix<f64>,
}

/// A step that lowers χ² by less moves no parameter by more than a thousandth of its standard error.
const LEAST_DROP: f64 = 1e-6;
/// Steps to the minimum: a few, but where a large effect is nearly what the baseline does the valley is narrow and bent.
const MOST_STEPS: usize = 200;
/// After so many steps, where parameters hardly matter, what is left moves none by more than a tenth of its standard error a step.
const PATIENCE: usize = 20;
const LATE_DROP: f64 = 1e-2;
/// Steps after new weights.
const MORE_STEPS: usize = 4;

/// Fits models to one experiment.
pub struct Fitter<'a> {
    /// The experiment.
    pub experiment: &'a dyn Experiment,
    /// The rotated space.
    pub space: Space,
    /// Independent noise where it is given, mm.
    pub given_mm: Option<f64>,
    /// Steps to which the readings of each class are rounded, mm; 0 where they are not.
    pub steps_mm: Vec<f64>,
}

impl<'a> Fitter<'a> {
    /// Of an experiment's observations in their space.
    pub fn new(experiment: &'a dyn Experiment, space: Space, given_mm: Option<f64>) -> Self {
        let steps_mm = steps_mm(experiment.layout());
        Self { experiment, space, given_mm, steps_mm }
    }

    /// The baseline alone.
    pub fn baseline(&self) -> Model {
        let nuisances = self.experiment.nuisances().iter().map(|p| p.start).collect();
        Model { nuisances, active: Vec::new(), extras: Vec::new() }
    }

    /// The prediction of every observation.
    pub fn predict(&self, model: &Model) -> Vec<f64> {
        let mut out = self.experiment.predict(&model.nuisances, &model.active);
        for extra in &model.extras {
            for (c, value) in extra.values.iter().enumerate() {
                for (o, x) in out.iter_mut().zip(extra.columns.column(c).iter()) {
                    *o += value * x;
                }
            }
        }
        out
    }

    /// Free parameters in order: baseline, effects (without switches), extra terms.
    pub fn free(&self, model: &Model) -> Vec<f64> {
        let mut free = model.nuisances.clone();
        for a in &model.active {
            let form = &self.experiment.effects()[a.effect].forms[a.form];
            free.extend(a.values.iter().zip(form).filter(|(_, p)| !p.is_switch()).map(|(v, _)| *v));
        }
        free.extend(model.extras.iter().flat_map(|e| e.values.iter().copied()));
        free
    }

    /// Index of the first free parameter of each effect, then of each extra term, then the count.
    pub fn offsets(&self, model: &Model) -> Vec<usize> {
        let mut at = model.nuisances.len();
        let mut offsets = vec![at];
        for a in &model.active {
            let form = &self.experiment.effects()[a.effect].forms[a.form];
            at += form.iter().filter(|p| !p.is_switch()).count();
            offsets.push(at);
        }
        for e in &model.extras {
            at += e.values.len();
            offsets.push(at);
        }
        offsets
    }

    fn with_free(&self, model: &Model, free: &[f64]) -> Model {
        let mut next = model.clone();
        let mut values = free.iter().copied();
        let mut take = |slot: &mut f64| {
            if let Some(v) = values.next() {
                *slot = v;
            }
        };
        next.nuisances.iter_mut().for_each(&mut take);
        for a in &mut next.active {
            let form = &self.experiment.effects()[a.effect].forms[a.form];
            for (v, p) in a.values.iter_mut().zip(form).filter(|(_, p)| !p.is_switch()) {
                take(v);
                if let Some((low, high)) = p.limits() {
                    *v = v.clamp(low, high);
                }
            }
        }
        next.extras.iter_mut().flat_map(|e| &mut e.values).for_each(&mut take);
        next
    }

    /// Steps for numeric derivatives, in the order of [`Fitter::free`].
    fn steps(&self, model: &Model) -> Vec<f64> {
        let mut steps: Vec<f64> =
            self.experiment.nuisances().iter().map(|p| 1e-3 * p.typical).collect();
        for a in &model.active {
            let form = &self.experiment.effects()[a.effect].forms[a.form];
            for (v, p) in a.values.iter().zip(form).filter(|(_, p)| !p.is_switch()) {
                steps.push(if p.grid.is_empty() { 1e-3 * p.typical } else { 1e-4 * v.abs() });
            }
        }
        steps
    }

    /// d(prediction)/d(free parameter).
    pub fn tangent(&self, model: &Model, at: &[f64]) -> DMatrix<f64> {
        let free = self.free(model);
        let steps = self.steps(model);
        let bare = Model { extras: Vec::new(), ..model.clone() };
        let base = if model.extras.is_empty() { at.to_vec() } else { self.predict(&bare) };
        let mut tangent = DMatrix::zeros(at.len(), free.len());
        for (c, &step) in steps.iter().enumerate() {
            let step = if step > 0.0 { step } else { 1e-9 };
            let mut moved = free[..steps.len()].to_vec();
            moved[c] += step;
            let forward = self.predict(&self.with_free(&bare, &moved));
            for (i, (f, b)) in forward.iter().zip(&base).enumerate() {
                tangent[(i, c)] = (f - b) / step;
            }
        }
        let mut c = steps.len();
        for e in &model.extras {
            tangent.view_mut((0, c), (at.len(), e.values.len())).copy_from(&e.columns);
            c += e.values.len();
        }
        tangent
    }

    /// Whether the baseline does by itself what a column does.
    pub fn baseline_has(&self, model: &Model, column: &DVector<f64>) -> bool {
        let bare = Model { nuisances: model.nuisances.clone(), ..self.baseline() };
        let basis = orthonormal(&self.tangent(&bare, &self.predict(&bare)), 1e-9);
        let left = column - &basis * basis.tr_mul(column);
        left.norm() < 1e-3 * column.norm()
    }

    /// Measured minus predicted.
    pub fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        self.experiment.layout().values.iter().zip(predicted).map(|(m, p)| m - p).collect()
    }

    /// Whitened columns.
    pub fn whiten(&self, columns: &DMatrix<f64>, noise: &Noise) -> DMatrix<f64> {
        self.space.whiten(&self.space.split(columns), noise)
    }

    /// Exact joint fit with the noise re-estimated; `noise` is where the search starts.
    pub fn fit(&self, model: Model, noise: Option<&Noise>) -> Fitted {
        let first = self.linearise(model);
        let start = noise.cloned().unwrap_or_else(|| self.first_noise(&first));
        let (found, noise) = self.fit_once(first, &start, MOST_STEPS);
        // Where the weights were those of this noise, once is enough.
        let (found, noise) = match noise.weighs_as(&start) {
            true => (found, noise),
            false => self.fit_once(found, &noise, MORE_STEPS),
        };
        self.finish(found, noise)
    }

    /// The model fitted with this noise, and the noise that it shows.
    fn fit_once(&self, start: Linear, noise: &Noise, steps: usize) -> (Linear, Noise) {
        let found = self.minimise(start, noise, steps);
        let column = DMatrix::from_column_slice(found.residual.len(), 1, &found.residual);
        let [tangents, column] = [&found.tangent, &column].map(|c| self.space.split(c));
        let seen = self.space.estimate(&tangents, &column, self.given_mm, Some(noise));
        (found, seen)
    }

    /// ln likelihood of a fitted model with its noise, but for a constant.
    pub fn ln_likelihood(&self, f: &Fitted) -> f64 {
        let left = self.whiten_residual(f, &f.noise).norm_squared();
        -0.5 * (left + self.space.ln_det(&f.noise))
    }

    /// What a model leaves, in units of a noise; the captures' random parts first.
    pub fn whiten_residual(&self, f: &Fitted, noise: &Noise) -> DMatrix<f64> {
        self.whiten(&DMatrix::from_column_slice(f.residual.len(), 1, &f.residual), noise)
    }

    fn linearise(&self, model: Model) -> Linear {
        let predicted = self.predict(&model);
        let tangent = self.tangent(&model, &predicted);
        Linear { residual: self.residual(&predicted), tangent, model }
    }

    fn finish(&self, found: Linear, noise: Noise) -> Fitted {
        let Linear { model, residual, tangent } = found;
        let white = self.whiten(&tangent, &noise);
        let (covariance, rank) = least_squares::covariance(&white, 1e-9);
        Fitted { model, residual, tangent, noise, covariance, rank }
    }

    /// Noise about a model that has not been fitted yet.
    fn first_noise(&self, first: &Linear) -> Noise {
        let column = DMatrix::from_column_slice(first.residual.len(), 1, &first.residual);
        let tangent = self.space.split(&first.tangent);
        let mut y = self.space.split(&column);
        // The start is taken out linearly: it may be far from the data.
        let basis = orthonormal(&tangent, 1e-9);
        y -= &basis * basis.tr_mul(&y);
        self.space.estimate(&tangent, &y, self.given_mm, None)
    }

    fn minimise(&self, first: Linear, noise: &Noise, max_steps: usize) -> Linear {
        let start = DVector::from_vec(self.free(&first.model));
        if start.is_empty() {
            return first;
        }
        let options = least_squares::Options {
            max_steps,
            least_drop: LEAST_DROP,
            patience: PATIENCE,
            late_drop: LATE_DROP,
            ..Default::default()
        };
        let white = |residual: &[f64]| {
            let column = DMatrix::from_column_slice(residual.len(), 1, residual);
            self.whiten(&column, noise).column(0).into_owned()
        };
        let template = first.model.clone();
        // The columns of extra terms stay what they are.
        let extras: usize = template.extras.iter().map(|e| e.values.len()).sum();
        let varying = start.len() - extras;
        let constant = first.tangent.columns(varying, extras).into_owned();
        let constant = -self.whiten(&constant, noise);
        // A tangent costs a prediction a parameter: the last one asked for, which is the solution's, is kept with its place.
        let last = RefCell::new((start.clone(), first));
        let (kept, constant) = (&last, &constant);
        let solution = least_squares::solve(start, options, |p| {
            let place = p.clone();
            let trial = (kept.borrow().0 != place).then(|| {
                let model = self.with_free(&template, place.as_slice());
                let predicted = self.predict(&model);
                (self.residual(&predicted), predicted, model)
            });
            let white = match &trial {
                Some((residual, ..)) => white(residual),
                None => white(&kept.borrow().1.residual),
            };
            let jacobian = move || {
                if let Some((residual, predicted, model)) = trial {
                    let tangent = self.tangent(&model, &predicted);
                    kept.replace((place, Linear { model, residual, tangent }));
                }
                let varies = kept.borrow().1.tangent.columns(0, varying).into_owned();
                let mut jacobian =
                    -self.whiten(&varies, noise).resize_horizontally(varying + extras, 0.0);
                jacobian.columns_mut(varying, extras).copy_from(constant);
                jacobian
            };
            (white, jacobian)
        });
        let (place, found) = last.into_inner();
        if place == solution.parameters {
            return found;
        }
        // The last tangent was no number, and its step not taken.
        self.linearise(self.with_free(&template, solution.parameters.as_slice()))
    }
}
