//! Candidates for the model: their columns, whitened and projected.

use std::cell::OnceCell;

use nalgebra::{DMatrix, DVector};

use crate::diagnose::experiment::{Active, Parameter, size_columns};
use crate::diagnose::fit::{Extra, Fitted, Fitter};
use crate::diagnose::generic::{Term, dictionary};
use crate::diagnose::noise::NO_REMAINDER;
use crate::diagnose::shape::Shape;
use crate::fit::least_squares::transposed_times;

/// What a candidate would add.
#[derive(Debug, Clone, PartialEq)]
pub enum Who {
    /// A library effect in one form, with its form parameters at a grid point.
    Effect(Active),
    /// A generic shape or a correction of a named effect's form.
    Extra(Extra),
}

/// A candidate and where its columns stand in the pool.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// What it would add.
    pub who: Who,
    /// First column.
    pub first: usize,
    /// Number of columns.
    pub count: usize,
    /// Form parameters chosen from a grid, which count as fitted.
    pub shape_parameters: usize,
    /// A function of no set form: its coefficients share one prior variance, itself found from the data.
    pub free: bool,
    /// A step or bump: its last column, a constant, may not be needed.
    pub placed: bool,
    /// What being one of several costs: an effect of many forms, a shape of many variables and outputs, nats.
    pub choice: f64,
    /// The part of that which no other count of tests holds.
    pub searched: f64,
}

/// Forms that fit alike are taken in their order, simplest first, nats.
const IN_ORDER: f64 = 1e-3;

/// What it costs to be one of several, nats.
pub fn choice(fitter: &Fitter, who: &Who) -> f64 {
    match who {
        Who::Effect(a) => {
            let info = &fitter.experiment.effects()[a.effect];
            let forms = &info.forms;
            let switches = forms[a.form].iter().filter(|p| p.is_switch()).count();
            // Of two exact aliases the one in its plain form is named first.
            let order = IN_ORDER * a.form as f64;
            let one_of = (forms.len() as f64).ln() + 0.2 * switches as f64 + order;
            one_of + searched(fitter, who) - info.beforehand
        }
        Who::Extra(Extra::Generic(term)) => {
            let layout = fitter.experiment.layout();
            let is_part = layout.directions[term.direction].is_part;
            let alike = layout.directions.iter().filter(|d| d.is_part == is_part).count() as f64;
            alike.ln() + term.shape.among(layout.variables.len()).ln()
        }
        Who::Extra(Extra::Form { .. }) => 0.0,
    }
}

/// What it costs that the values of its form were found among many, nats.
pub fn searched(fitter: &Fitter, who: &Who) -> f64 {
    let Who::Effect(a) = who else { return 0.0 };
    let form = &fitter.experiment.effects()[a.effect].forms[a.form];
    form.iter().zip(&a.values).map(|(p, value)| p.price_of(*value)).sum()
}

/// Candidates with their columns, split but not yet whitened. Those that live in the capture-level rows alone come first.
pub struct Pool {
    /// The candidates.
    pub candidates: Vec<Candidate>,
    /// Capture-level rows of all columns.
    top: DMatrix<f64>,
    /// Remainders of the columns from `rest_from` on.
    rest: DMatrix<f64>,
    rest_from: usize,
    /// Gram matrix of each candidate's remainders, class by class: the noise only weighs them.
    squares: Vec<Vec<DMatrix<f64>>>,
    /// The same of all remainders together, where it is asked for.
    cross: OnceCell<Vec<DMatrix<f64>>>,
}

/// A pool's columns, whitened, with what a model explains of them.
pub(super) struct Projected<'a> {
    pool: &'a Pool,
    classes: &'a [usize],
    /// Capture-level rows, whitened.
    pub(super) top: DMatrix<f64>,
    /// Components along the model's basis.
    along: DMatrix<f64>,
    /// 1/σ² of each class.
    weights: Vec<f64>,
}

impl Projected<'_> {
    /// Inner product of two columns of a candidate after the projection.
    pub(super) fn dot(&self, candidate: usize, i: usize, j: usize) -> f64 {
        let first = self.pool.candidates[candidate].first;
        let taken = self.along.column(first + i).dot(&self.along.column(first + j));
        self.whole(candidate, i, j) - taken
    }

    /// Inner product of two columns of a candidate before the projection.
    pub(super) fn whole(&self, candidate: usize, i: usize, j: usize) -> f64 {
        let first = self.pool.candidates[candidate].first;
        let top = self.top.column(first + i).dot(&self.top.column(first + j));
        let rest = self.pool.squares[candidate].iter().zip(&self.weights);
        top + rest.map(|(square, w)| w * square[(i, j)]).sum::<f64>()
    }

    /// Squares of a candidate's column in each class of observations, whitened.
    pub(super) fn rest_squares(&self, candidate: usize, i: usize) -> Vec<f64> {
        let rest = self.pool.squares[candidate].iter().zip(&self.weights);
        rest.map(|(square, w)| w * square[(i, i)]).collect()
    }

    /// Inner products of all columns after the projection, over their lengths before it; then those lengths.
    pub(super) fn gram(&self) -> (DMatrix<f64>, DVector<f64>) {
        let mut gram = transposed_times(&self.top, &self.top);
        let pool = self.pool;
        let cross = pool.cross.get_or_init(|| class_squares(&pool.rest, self.classes));
        for (square, w) in cross.iter().zip(&self.weights) {
            let mut later = gram.view_mut((pool.rest_from, pool.rest_from), square.shape());
            later += square * *w;
        }
        let length = gram.diagonal().map(|v| if v > 0.0 { v.sqrt() } else { 1.0 });
        gram -= transposed_times(&self.along, &self.along);
        let scaled = DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, j| {
            gram[(i, j)] / (length[i] * length[j])
        });
        (scaled, length)
    }

    /// Inner products of all columns with a whitened vector.
    pub(super) fn inner(&self, vector: &DVector<f64>) -> DVector<f64> {
        let all = DMatrix::from_column_slice(vector.len(), 1, vector.as_slice());
        self.pool.inner(&self.top, &all, self.classes, &self.weights).row(0).transpose()
    }
}

/// Gram matrix of columns, class by class of the observations.
fn class_squares(columns: &DMatrix<f64>, classes: &[usize]) -> Vec<DMatrix<f64>> {
    let count = classes.iter().max().map_or(1, |c| c + 1);
    if count == 1 {
        return vec![transposed_times(columns, columns)];
    }
    (0..count)
        .map(|class| {
            let rows: Vec<usize> = (0..classes.len()).filter(|i| classes[*i] == class).collect();
            let own = columns.select_rows(&rows);
            transposed_times(&own, &own)
        })
        .collect()
}

/// A candidate with the number of places of its shape and its columns.
type Entry = (Who, usize, DMatrix<f64>);

/// Candidates whose columns are rotated together.
const BATCH: usize = 64;

/// Splits columns; of those without a remainder only what captures share is kept.
fn split(fitter: &Fitter, entries: Vec<Entry>) -> Vec<Entry> {
    let top = fitter.space.top();
    let mut all = Vec::new();
    let mut entries = entries.into_iter().peekable();
    while entries.peek().is_some() {
        // Many columns at a time: matrix products are faster by far than as many products with vectors.
        let batch: Vec<Entry> = entries.by_ref().take(BATCH).collect();
        let columns: Vec<_> = batch.iter().flat_map(|(_, _, b)| b.column_iter()).collect();
        if columns.is_empty() {
            continue;
        }
        let split = fitter.space.split(&DMatrix::from_columns(&columns));
        let mut at = 0;
        for (who, shapes, block) in batch {
            let own = split.columns(at, block.ncols());
            at += block.ncols();
            let rest = own.rows(top, block.nrows()).norm();
            let within = top == 0 || rest > NO_REMAINDER * own.norm();
            let rows = if within { own.nrows() } else { top };
            all.push((who, shapes, own.rows(0, rows).into_owned()));
        }
    }
    all
}

impl Pool {
    /// Of split columns: those of the capture-level rows alone have no others.
    fn of_split(fitter: &Fitter, entries: Vec<Entry>) -> Self {
        let top_rows = fitter.space.top();
        let mut sides: [Vec<Entry>; 2] = [Vec::new(), Vec::new()];
        for entry in entries {
            sides[usize::from(entry.2.nrows() > top_rows)].push(entry);
        }
        let rest_from = sides[0].iter().map(|(_, _, s)| s.ncols()).sum();
        let count: usize = sides.iter().flatten().map(|(_, _, s)| s.ncols()).sum();
        let rows = fitter.experiment.layout().values.len();
        let mut top = DMatrix::zeros(top_rows, count);
        let mut rest = DMatrix::zeros(rows, count - rest_from);
        let (mut candidates, mut first) = (Vec::new(), 0);
        for (who, shape_parameters, split) in sides.into_iter().flatten() {
            let n = split.ncols();
            top.columns_mut(first, n).copy_from(&split.rows(0, top_rows));
            if first >= rest_from {
                rest.columns_mut(first - rest_from, n).copy_from(&split.rows(top_rows, rows));
            }
            let shape = match &who {
                Who::Extra(Extra::Generic(t)) => Some(t.shape),
                _ => None,
            };
            candidates.push(Candidate {
                choice: choice(fitter, &who),
                searched: searched(fitter, &who),
                who,
                first,
                count: n,
                shape_parameters,
                free: shape.is_some_and(Shape::is_free),
                placed: shape.is_some_and(Shape::is_placed),
            });
            first += n;
        }
        let classes = &fitter.experiment.layout().classes;
        let squares = candidates
            .iter()
            .map(|c: &Candidate| match c.first.checked_sub(rest_from) {
                Some(at) => class_squares(&rest.columns(at, c.count).into_owned(), classes),
                None => Vec::new(),
            })
            .collect();
        Self { candidates, top, rest, rest_from, squares, cross: OnceCell::new() }
    }

    /// Every testable form of every library effect at the values of its grids, and `found` beside them; linearised about the baseline.
    pub fn library(fitter: &Fitter, nuisances: &[f64], found: &[Active]) -> Self {
        let mut all = Vec::new();
        for (effect, info) in fitter.experiment.effects().iter().enumerate() {
            if info.untestable.is_some() {
                continue;
            }
            for (form, parameters) in info.forms.iter().enumerate() {
                let grid = Parameter::grid_points(parameters).into_iter();
                all.extend(grid.map(|values| Active { effect, form, values }));
                let same = |a: &&Active| (a.effect, a.form) == (effect, form);
                all.extend(found.iter().filter(same).cloned());
            }
        }
        Self::of_effects(fitter, nuisances, all)
    }

    /// A pool of library effects, linearised about the baseline.
    pub fn of_effects(fitter: &Fitter, nuisances: &[f64], all: Vec<Active>) -> Self {
        let experiment = fitter.experiment;
        let base = experiment.predict(nuisances, &[]);
        let entry = |active: Active| {
            let block = size_columns(experiment, nuisances, &base, &active);
            let form = &experiment.effects()[active.effect].forms[active.form];
            let shapes = form.iter().filter(|p| !p.grid.is_empty() && !p.is_switch()).count();
            (Who::Effect(active), shapes, block)
        };
        Self::of_split(fitter, split(fitter, all.into_iter().map(entry).collect()))
    }

    /// The generic dictionary; without free functions and steps of the rim's
    /// angle where the noise holds the rim's form: they would be of the same.
    pub fn generic(fitter: &Fitter) -> Self {
        let layout = fitter.experiment.layout();
        let mut terms = dictionary(layout);
        if fitter.space.has_rim() {
            let of_rim = |t: &Term| layout.variables[t.variable].values == layout.rim_deg;
            let sharp = |s: Shape| s.is_free() || matches!(s, Shape::Step(_));
            terms.retain(|t| !(sharp(t.shape) && of_rim(t)));
        }
        Self::of_terms(fitter, terms)
    }

    /// A pool of shapes.
    pub fn of_terms(fitter: &Fitter, terms: Vec<Term>) -> Self {
        let layout = fitter.experiment.layout();
        let (mut shared, mut others) = (Vec::new(), Vec::new());
        for term in terms {
            // A step or bump is chosen from many places: its place counts as fitted.
            let (who, places) = (Who::Extra(Extra::Generic(term)), term.shape.places());
            match fitter.space.split_shared(&term, layout) {
                Some(top) => shared.push((who, places, top)),
                None => others.push((who, places, term.columns(layout))),
            }
        }
        shared.extend(split(fitter, others));
        Self::of_split(fitter, shared)
    }

    /// A pool of extra terms by their columns.
    pub fn of_extras(fitter: &Fitter, extras: Vec<(Extra, DMatrix<f64>)>) -> Self {
        let places = |kind: &Extra| match kind {
            Extra::Generic(term) => term.shape.places(),
            Extra::Form { .. } => 0,
        };
        let entry = |(kind, block)| {
            let places = places(&kind);
            (Who::Extra(kind), places, block)
        };
        Self::of_split(fitter, split(fitter, extras.into_iter().map(entry).collect()))
    }

    pub(super) fn project<'a>(
        &'a self,
        fitter: &'a Fitter,
        fitted: &Fitted,
        basis: &DMatrix<f64>,
    ) -> Projected<'a> {
        let top = fitter.space.whiten_top(&self.top, &fitted.noise);
        let classes = &fitter.experiment.layout().classes;
        let weights: Vec<f64> = fitted.noise.sigma_mm.iter().map(|s| 1.0 / (s * s)).collect();
        let along = self.inner(&top, basis, classes, &weights);
        Projected { pool: self, classes, top, along, weights }
    }

    /// Inner products of whitened vectors with all columns: the vectors carry the columns' weights.
    fn inner(
        &self,
        top: &DMatrix<f64>,
        vectors: &DMatrix<f64>,
        classes: &[usize],
        weights: &[f64],
    ) -> DMatrix<f64> {
        let mut inner = transposed_times(&vectors.rows(0, top.nrows()).into_owned(), top);
        if self.rest.ncols() > 0 {
            let mut rest = vectors.rows(top.nrows(), self.rest.nrows()).into_owned();
            for mut vector in rest.column_iter_mut() {
                for (v, class) in vector.iter_mut().zip(classes) {
                    *v *= weights[*class].sqrt();
                }
            }
            let mut later = inner.columns_mut(self.rest_from, self.rest.ncols());
            later += transposed_times(&rest, &self.rest);
        }
        inner
    }
}
