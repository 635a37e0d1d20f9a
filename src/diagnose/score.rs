//! Score tests: how much of the gap each candidate explains after the model so far has been projected out.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use crate::diagnose::experiment::{Active, Parameter};
use crate::diagnose::fit::{Extra, Fitted, Fitter, Model};
use crate::diagnose::generic::{Shape, Term, dictionary};
use crate::diagnose::noise::orthonormal;
use crate::diagnose::tails::{ln_chi2_tail, ln_f_tail};

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
}

/// What it costs to be one of several, nats.
pub fn choice(fitter: &Fitter, who: &Who) -> f64 {
    match who {
        Who::Effect(a) => {
            let forms = &fitter.experiment.effects()[a.effect].forms;
            let switches = forms[a.form].iter().filter(|p| p.is_switch()).count();
            // Of two exact aliases the one in its plain form is named first.
            (forms.len() as f64).ln() + 0.2 * switches as f64
        }
        Who::Extra(Extra::Generic(_)) => {
            let layout = fitter.experiment.layout();
            ((layout.directions.len() * layout.variables.len()) as f64).ln()
        }
        Who::Extra(Extra::Form { .. }) => 0.0,
    }
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
}

/// A pool's columns, whitened, with what a model explains of them.
struct Projected {
    top: DMatrix<f64>,
    rest: DMatrix<f64>,
    rest_from: usize,
    /// Components along the model's basis.
    along: DMatrix<f64>,
}

impl Projected {
    /// Inner product of two columns after the projection.
    fn dot(&self, i: usize, j: usize) -> f64 {
        self.whole(i, j) - self.along.column(i).dot(&self.along.column(j))
    }

    /// Inner products of all columns after the projection, over their lengths before it; then those lengths.
    fn gram(&self) -> (DMatrix<f64>, DVector<f64>) {
        let mut gram = self.top.tr_mul(&self.top);
        let rest = self.rest.tr_mul(&self.rest);
        let mut later = gram.view_mut((self.rest_from, self.rest_from), rest.shape());
        later += rest;
        let length = gram.diagonal().map(|v| if v > 0.0 { v.sqrt() } else { 1.0 });
        gram -= self.along.tr_mul(&self.along);
        let scaled = DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, j| {
            gram[(i, j)] / (length[i] * length[j])
        });
        (scaled, length)
    }

    /// Inner product of two columns before the projection.
    fn whole(&self, i: usize, j: usize) -> f64 {
        let top = self.top.column(i).dot(&self.top.column(j));
        match (i.checked_sub(self.rest_from), j.checked_sub(self.rest_from)) {
            (Some(i), Some(j)) => top + self.rest.column(i).dot(&self.rest.column(j)),
            _ => top,
        }
    }
}

/// A candidate's score.
#[derive(Debug, Clone)]
pub struct Score {
    /// Index into the pool.
    pub candidate: usize,
    /// Drop of χ² in units of the current noise.
    pub chi2: f64,
    /// Columns that survive the projection.
    pub rank: usize,
    /// ln of the p-value, before any correction for the number of candidates.
    pub ln_p: f64,
    /// Log evidence: likelihood gain less the price of the parameters, nats.
    pub evidence: f64,
    /// Root mean square of what it explains, mm.
    pub rms_mm: f64,
}

impl Score {
    /// χ² beyond what noise gives as many columns.
    pub fn excess(&self) -> f64 {
        self.chi2 - self.rank as f64
    }
}

impl Pool {
    fn new(fitter: &Fitter, entries: Vec<(Who, usize, DMatrix<f64>)>) -> Self {
        let top_rows = fitter.space.top();
        let mut sides: [Vec<(Who, usize, DMatrix<f64>)>; 2] = [Vec::new(), Vec::new()];
        for (who, shapes, block) in entries {
            let split = fitter.space.split(&block);
            let rest = split.rows(top_rows, block.nrows()).norm();
            let within = top_rows == 0 || rest > 1e-9 * split.norm();
            sides[usize::from(within)].push((who, shapes, split));
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
                who,
                first,
                count: n,
                shape_parameters,
                free: shape.is_some_and(Shape::is_free),
                placed: shape.is_some_and(Shape::is_placed),
            });
            first += n;
        }
        Self { candidates, top, rest, rest_from }
    }

    /// Every testable form of every library effect, linearised about the baseline.
    pub fn library(fitter: &Fitter, nuisances: &[f64]) -> Self {
        let experiment = fitter.experiment;
        let base = experiment.predict(nuisances, &[]);
        let mut entries = Vec::new();
        for (effect, info) in experiment.effects().iter().enumerate() {
            if info.untestable.is_some() {
                continue;
            }
            for (form, parameters) in info.forms.iter().enumerate() {
                for values in grid_points(parameters) {
                    let linear: Vec<usize> =
                        (0..values.len()).filter(|&i| parameters[i].grid.is_empty()).collect();
                    let mut block = DMatrix::zeros(base.len(), linear.len());
                    for (c, &i) in linear.iter().enumerate() {
                        let step = 1e-3 * parameters[i].typical;
                        let mut moved = values.clone();
                        moved[i] += step;
                        let active = [Active { effect, form, values: moved }];
                        let forward = experiment.predict(nuisances, &active);
                        for (r, (f, b)) in forward.iter().zip(&base).enumerate() {
                            block[(r, c)] = (f - b) / step;
                        }
                    }
                    let shape_parameters =
                        parameters.iter().filter(|p| !p.grid.is_empty() && !p.is_switch()).count();
                    let who = Who::Effect(Active { effect, form, values });
                    entries.push((who, shape_parameters, block));
                }
            }
        }
        Self::new(fitter, entries)
    }

    /// The generic dictionary.
    pub fn generic(fitter: &Fitter) -> Self {
        let layout = fitter.experiment.layout();
        let terms = dictionary(layout);
        Self::of_terms(
            fitter,
            terms.into_iter().map(|t| (Extra::Generic(t), t.columns(layout))).collect(),
        )
    }

    /// A pool of extra terms.
    pub fn of_terms(fitter: &Fitter, terms: Vec<(Extra, DMatrix<f64>)>) -> Self {
        let entries = terms
            .into_iter()
            .map(|(kind, block)| {
                // A step or bump is chosen from many places: its place counts as fitted.
                let shape_parameters = match kind {
                    Extra::Generic(Term { shape, .. }) => shape.places(),
                    Extra::Form { .. } => 0,
                };
                (Who::Extra(kind), shape_parameters, block)
            })
            .collect();
        Self::new(fitter, entries)
    }

    fn project(&self, fitter: &Fitter, fitted: &Fitted, basis: &DMatrix<f64>) -> Projected {
        let (top_rows, n) = (self.top.nrows(), self.rest.nrows());
        let top = fitter.space.whiten_top(&self.top, &fitted.noise);
        let rest = fitter.space.whiten_rest(self.rest.clone(), &fitted.noise);
        let mut along = basis.rows(0, top_rows).tr_mul(&top);
        let more = basis.rows(top_rows, n).tr_mul(&rest);
        let mut later = along.columns_mut(self.rest_from, rest.ncols());
        later += more;
        Projected { top, rest, rest_from: self.rest_from, along }
    }
}

/// All combinations of the grid values; linear parameters at zero.
fn grid_points(parameters: &[Parameter]) -> Vec<Vec<f64>> {
    let mut points = vec![Vec::new()];
    for p in parameters {
        let choices: &[f64] = if p.grid.is_empty() { &[0.0] } else { &p.grid };
        points = points
            .into_iter()
            .flat_map(|point: Vec<f64>| {
                choices.iter().map(move |v| [point.clone(), vec![*v]].concat())
            })
            .collect();
    }
    points
}

/// Where a model stands for scoring: whitened residual, projection, degrees of freedom.
pub struct Standing {
    /// Orthonormal basis of the model's tangent, whitened.
    pub basis: DMatrix<f64>,
    /// Whitened residual with the tangent projected out.
    pub residual: DVector<f64>,
    /// Degrees of freedom of each random component, then of the complement of each class.
    dof: Vec<f64>,
    /// How far the squares exceed the degrees of freedom: what has been put back by `without`.
    excess: f64,
    fixed: bool,
}

impl Standing {
    /// Of a fitted model; `without` leaves out these free parameters and puts their contribution back.
    pub fn new(
        fitter: &Fitter,
        fitted: &Fitted,
        without: &[(std::ops::Range<usize>, Vec<f64>)],
    ) -> Self {
        let kept: Vec<usize> = (0..fitted.tangent.ncols())
            .filter(|c| !without.iter().any(|(range, _)| range.contains(c)))
            .collect();
        let tangent = fitted.tangent.select_columns(&kept);
        let basis = orthonormal(&fitter.whiten(&tangent, &fitted.noise), 1e-7);
        let mut raw = fitted.residual.clone();
        for (_, contribution) in without {
            raw.iter_mut().zip(contribution).for_each(|(r, c)| *r += c);
        }
        let column = DMatrix::from_column_slice(raw.len(), 1, &raw);
        let mut white = fitter.whiten(&column, &fitted.noise);
        white -= &basis * basis.tr_mul(&white);
        let used = basis.ncols() as f64;
        let dimensions = fitter.space.dimensions(&fitted.noise);
        let total = fitter.space.observations() as f64;
        let dof: Vec<f64> = dimensions.iter().map(|d| d * (1.0 - used / total.max(1.0))).collect();
        let excess = (white.norm_squared() - (total - used)).max(0.0);
        let fixed = fitter.given_mm.is_some() && fitted.noise.ratios.is_empty();
        Self { basis, residual: white.column(0).into_owned(), dof, excess, fixed }
    }

    /// Inner products of a pool's columns with the residual.
    fn along(&self, x: &Projected) -> DVector<f64> {
        let top_rows = x.top.nrows();
        let mut along = x.top.tr_mul(&self.residual.rows(0, top_rows));
        let more = x.rest.tr_mul(&self.residual.rows(top_rows, x.rest.nrows()));
        let mut later = along.rows_mut(x.rest_from, more.len());
        later += more;
        along
    }

    /// Scores every candidate of a pool.
    pub fn scores(&self, fitter: &Fitter, fitted: &Fitted, pool: &Pool) -> Vec<Score> {
        let x = pool.project(fitter, fitted, &self.basis);
        let along = self.along(&x);
        let groups = fitter.experiment.layout().group_count().max(2) as f64;
        let n = fitter.space.observations().max(1) as f64;
        (0..pool.candidates.len())
            .filter_map(|index| {
                let c = &pool.candidates[index];
                let (chi2, rank) = block_chi2(&x, &along, c);
                if rank == 0 {
                    return None;
                }
                let dof = self.dof_of(fitter, &x, c).max(rank as f64 + 1.0);
                let ln_p = self.ln_p(dof, chi2, rank as f64);
                let rms_mm = fitted.noise.sigma_mm[0] * (chi2 / n).sqrt();
                let gain2 = self.likelihood_gain2(dof, chi2);
                let evidence = match c.free {
                    true => gain_of_free(gain2, rank as f64, groups.ln()),
                    false => {
                        let price = 0.5 * (rank + c.shape_parameters) as f64 * groups.ln();
                        let whole = 0.5 * gain2 - price;
                        let lean = if c.placed { lean_chi2(&x, &along, c) } else { 0.0 };
                        let lean = 0.5 * self.likelihood_gain2(dof, lean) - price;
                        whole.max(lean + 0.5 * groups.ln())
                    }
                };
                let evidence = evidence - c.choice;
                Some(Score { candidate: index, chi2, rank, ln_p, evidence, rms_mm })
            })
            .collect()
    }

    /// Log evidence (nats) of pairs of candidates together.
    pub fn pair_evidence(
        &self,
        fitter: &Fitter,
        fitted: &Fitted,
        pool: &Pool,
        pairs: impl Iterator<Item = (usize, usize)>,
    ) -> Vec<(f64, usize, usize)> {
        let x = pool.project(fitter, fitted, &self.basis);
        let along = self.along(&x);
        let gram = x.gram();
        let groups = fitter.experiment.layout().group_count().max(2) as f64;
        let columns = |c: &Candidate| c.first..c.first + c.count;
        pairs
            .filter_map(|(i, j)| {
                let (a, b) = (&pool.candidates[i], &pool.candidates[j]);
                let both: Vec<usize> = columns(a).chain(columns(b)).collect();
                let (chi2, rank) = gram_chi2(&gram, &along, &both);
                let price = 0.5 * (rank + a.shape_parameters + b.shape_parameters) as f64;
                let dof = self.dof_of(fitter, &x, a).min(self.dof_of(fitter, &x, b));
                let dof = dof.max(rank as f64 + 1.0);
                let gain = 0.5 * self.likelihood_gain2(dof, chi2) - price * groups.ln();
                (rank > 0).then_some((gain - a.choice - b.choice, i, j))
            })
            .collect()
    }

    /// Degrees of freedom of the noise that a candidate's columns are seen against.
    fn dof_of(&self, fitter: &Fitter, x: &Projected, c: &Candidate) -> f64 {
        let mut inverse = 0.0;
        for k in c.first..c.first + c.count {
            let rest = k.checked_sub(x.rest_from).map(|r| x.rest.column(r));
            let shares = fitter.space.shares(x.top.column(k), rest);
            inverse += shares.iter().zip(&self.dof).map(|(s, d)| s * s / d.max(1.0)).sum::<f64>();
        }
        c.count as f64 / inverse.max(1e-9)
    }

    /// ln p, with the noise's own uncertainty.
    fn ln_p(&self, dof: f64, chi2: f64, rank: f64) -> f64 {
        // The noise was estimated with this effect in it: F from what is left without it.
        let all = dof + self.excess;
        let left = (all - chi2).max(0.02 * dof);
        let f = (all - left) / rank / (left / (dof - rank));
        let ln_p = ln_f_tail(f, rank, dof - rank);
        // Given noise holds unless more than it is left: what else is wrong is noise to this candidate.
        if self.fixed { ln_p.max(ln_chi2_tail(chi2, rank)) } else { ln_p }
    }

    /// Twice the gain of log likelihood. χ² is in units of a noise that holds what the candidate explains, but for what
    /// `without` put back: that much of the gain is of the noise's variance, n ln(n / (n - χ²)).
    fn likelihood_gain2(&self, dof: f64, chi2: f64) -> f64 {
        let inside = (chi2 - self.excess).clamp(0.0, 0.9 * dof);
        let noise = if self.fixed { 0.0 } else { -dof * (1.0 - inside / dof).ln() - inside };
        chi2 + noise
    }
}

/// Log evidence of a free function, nats. Schwarz's price (half of ln(captures) a parameter) would rule out every function of
/// many levels; its coefficients are taken from one normal distribution instead, whose likeliest variance is the one parameter:
/// ½ rank (m - 1 - ln m) with m = χ² / rank.
fn gain_of_free(chi2: f64, rank: f64, ln_captures: f64) -> f64 {
    let m = (chi2 / rank).max(1.0);
    0.5 * rank * (m - 1.0 - m.ln()) - 0.5 * ln_captures
}

/// A column that keeps less than this part of its length after the projection is an alias of the model.
const ALIAS: f64 = 3e-3;

/// χ² explained by a block and the number of its columns that survive the projection.
fn block_chi2(x: &Projected, along: &DVector<f64>, c: &Candidate) -> (f64, usize) {
    if c.count == 1 {
        let (left, before) = (x.dot(c.first, c.first), x.whole(c.first, c.first));
        let seen = left > ALIAS * ALIAS * before && left > 0.0;
        return if seen { (along[c.first].powi(2) / left, 1) } else { (0.0, 0) };
    }
    let at = |k: usize| c.first + k;
    let length = DVector::from_fn(c.count, |i, _| match x.whole(at(i), at(i)).sqrt() {
        v if v > 0.0 => v,
        _ => 1.0,
    });
    let mut gram = DMatrix::zeros(c.count, c.count);
    for i in 0..c.count {
        for j in 0..=i {
            let value = x.dot(at(i), at(j)) / (length[i] * length[j]);
            gram[(i, j)] = value;
            gram[(j, i)] = value;
        }
    }
    let along = along.rows(c.first, c.count).into_owned();
    gram_chi2(&(gram, length), &along, &(0..c.count).collect::<Vec<_>>())
}

/// χ² of a step or bump that is zero to one side of its place: with one column in place of two.
fn lean_chi2(x: &Projected, along: &DVector<f64>, c: &Candidate) -> f64 {
    let (shape, constant) = (c.first, c.first + c.count - 1);
    if c.count != 2 {
        return 0.0;
    }
    let of = |w: f64| {
        let rhs = along[shape] - w * along[constant];
        let square = x.dot(shape, shape)
            + w * (w * x.dot(constant, constant) - 2.0 * x.dot(shape, constant));
        let whole = x.whole(shape, shape)
            + w * (w * x.whole(constant, constant) - 2.0 * x.whole(shape, constant));
        if square > ALIAS * ALIAS * whole && square > 0.0 { rhs * rhs / square } else { 0.0 }
    };
    of(0.0).max(of(1.0))
}

/// χ² explained by some columns together, from the Gram matrix of all, and the number of directions among them that survive
/// the projection.
fn gram_chi2(
    (gram, length): &(DMatrix<f64>, DVector<f64>),
    along: &DVector<f64>,
    columns: &[usize],
) -> (f64, usize) {
    let own = DMatrix::from_fn(columns.len(), columns.len(), |i, j| gram[(columns[i], columns[j])]);
    let rhs = DVector::from_fn(columns.len(), |i, _| along[columns[i]] / length[columns[i]]);
    let eigen = own.symmetric_eigen();
    let (mut chi2, mut rank) = (0.0, 0);
    for (k, &value) in eigen.eigenvalues.iter().enumerate() {
        if value > ALIAS * ALIAS {
            chi2 += eigen.eigenvectors.column(k).dot(&rhs).powi(2) / value;
            rank += 1;
        }
    }
    (chi2, rank)
}

/// The number of independent tests that a pool amounts to: the smallest p-value of noise alone is simulated, and its
/// 2 % point matched (Westfall and Young's idea, in one number).
pub fn effective_tests(fitter: &Fitter, fitted: &Fitted, standing: &Standing, pool: &Pool) -> f64 {
    const DRAWS: usize = 2000;
    if pool.candidates.is_empty() {
        return 1.0;
    }
    let x = pool.project(fitter, fitted, &standing.basis);
    let total = x.along.ncols();
    // The scores depend on the columns only through their Gram matrix: its root is small.
    let eigen = x.gram().0.symmetric_eigen();
    let root = DMatrix::from_fn(total, total, |k, i| {
        eigen.eigenvalues[k].max(0.0).sqrt() * eigen.eigenvectors[(i, k)]
    });
    let mut bases: Vec<(usize, DMatrix<f64>)> = Vec::new();
    for c in &pool.candidates {
        let block = root.columns(c.first, c.count).into_owned();
        let seen: Vec<usize> = (0..c.count).filter(|&k| block.column(k).norm() > ALIAS).collect();
        let basis = orthonormal(&block.select_columns(&seen), ALIAS);
        if basis.ncols() > 0 {
            bases.push((basis.ncols(), basis));
        }
    }
    let most = bases.iter().map(|(rank, _)| *rank).max().unwrap_or(1);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let mut smallest: Vec<f64> = (0..DRAWS)
        .map(|_| {
            let noise: DVector<f64> =
                DVector::from_fn(total, |_, _| StandardNormal.sample(&mut rng));
            let mut largest = vec![0.0_f64; most + 1];
            for (rank, basis) in &bases {
                let chi2 = basis.tr_mul(&noise).norm_squared();
                largest[*rank] = largest[*rank].max(chi2);
            }
            largest.iter().enumerate().map(|(k, c)| ln_chi2_tail(*c, k as f64)).fold(0.0, f64::min)
        })
        .collect();
    smallest.sort_by(f64::total_cmp);
    let at = smallest[DRAWS / 50].exp();
    (-(1.0_f64 - 0.02).ln() / at.max(1e-12)).max(1.0)
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

/// A removable part of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    /// A named effect by its place in the model.
    Effect(usize),
    /// An extra term by its place in the model.
    Extra(usize),
}
