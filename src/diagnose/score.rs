//! Score tests: how much of the gap each candidate explains after the model so far has been projected out.

use std::cell::OnceCell;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use crate::diagnose::algebra::{orthonormal, root};
use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::pool::{Candidate, Pool, Projected};
use crate::diagnose::resolution::rounding_share;
use crate::fit::tails::{ln_chi2_tail, ln_f_tail};

/// A candidate's score.
#[derive(Debug, Clone)]
pub struct Score {
    /// Index into the pool.
    pub candidate: usize,
    /// Drop of χ² in units of the current noise.
    pub chi2: f64,
    /// The same in units of the noise that it would leave: what it explains is part of the current one.
    pub cleared: f64,
    /// Columns that survive the projection.
    pub rank: usize,
    /// ln of the p-value, before any correction for the number of candidates.
    pub ln_p: f64,
    /// Log evidence: likelihood gain less the price of the parameters, nats.
    pub evidence: f64,
    /// Root mean square of what it explains, mm.
    pub rms_mm: f64,
    /// Its coefficient, where it has one alone.
    pub coefficient: Option<f64>,
}

/// A name that explains as much as a shape within this χ², with no more coefficients, is what the shape is; in units of the noise
/// that the shape would leave, as what both explain is no noise.
pub(super) const AS_MUCH: f64 = 4.0;

impl Score {
    /// Whether a name's score leaves a shape's nothing to say.
    pub fn explains_as_much(&self, shape: &Self) -> bool {
        let cleared = shape.cleared / shape.chi2.max(1e-12);
        self.rank <= shape.rank && cleared * (shape.excess() - self.excess()) < AS_MUCH
    }

    /// χ² beyond what noise gives as many columns.
    pub fn excess(&self) -> f64 {
        self.chi2 - self.rank as f64
    }

    /// The same in units of the noise that it would leave. Two effects in outputs of their own cannot be compared in the current
    /// noise: that of the one not yet named is all noise.
    pub fn cleared_excess(&self) -> f64 {
        self.cleared - self.rank as f64
    }
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
    /// The part of the noise's variance that the readings' rounding is, which nothing explains.
    rounding: f64,
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
        let mut raw = fitted.residual.clone();
        for (_, contribution) in without {
            raw.iter_mut().zip(contribution).for_each(|(r, c)| *r += c);
        }
        Self::of(fitter, fitted, &tangent, raw)
    }

    /// Of a fitted model with these columns beside it.
    pub fn beside(fitter: &Fitter, fitted: &Fitted, columns: &DMatrix<f64>) -> Self {
        let (own, more) = (fitted.tangent.ncols(), columns.ncols());
        let mut tangent = fitted.tangent.clone().resize_horizontally(own + more, 0.0);
        tangent.columns_mut(own, more).copy_from(columns);
        Self::of(fitter, fitted, &tangent, fitted.residual.clone())
    }

    fn of(fitter: &Fitter, fitted: &Fitted, tangent: &DMatrix<f64>, raw: Vec<f64>) -> Self {
        let basis = orthonormal(&fitter.whiten(tangent, &fitted.noise), 1e-7);
        let column = DMatrix::from_column_slice(raw.len(), 1, &raw);
        let mut white = fitter.whiten(&column, &fitted.noise);
        white -= &basis * basis.tr_mul(&white);
        let used = basis.ncols() as f64;
        let dimensions = fitter.space.dimensions(&fitted.noise);
        let total = fitter.space.observations() as f64;
        let dof: Vec<f64> = dimensions.iter().map(|d| d * (1.0 - used / total.max(1.0))).collect();
        let excess = (white.norm_squared() - (total - used)).max(0.0);
        let fixed = fitter.given_mm.is_some() && fitted.noise.ratios.is_empty();
        let rounding = rounding_share(fitter, fitted);
        Self { basis, residual: white.column(0).into_owned(), dof, excess, fixed, rounding }
    }

    /// χ² without what only the readings' rounding can be.
    fn beyond_rounding(&self, dof: f64, chi2: f64) -> f64 {
        let most = self.excess + (1.0 - self.rounding) * dof;
        if self.rounding > 0.0 { chi2.min(most) } else { chi2 }
    }

    /// Scores every candidate of a pool.
    pub fn scores(&self, fitter: &Fitter, fitted: &Fitted, pool: &Pool) -> Vec<Score> {
        let x = pool.project(fitter, fitted, &self.basis);
        let along = x.inner(&self.residual);
        let groups = fitter.experiment.layout().group_count().max(2) as f64;
        (0..pool.candidates.len())
            .filter_map(|index| {
                let c = &pool.candidates[index];
                let (chi2, rank) = block_chi2(&x, &along, index, c);
                if rank == 0 {
                    return None;
                }
                let dof = self.dof_of(fitter, &x, index, c).max(rank as f64 + 1.0);
                let chi2 = self.beyond_rounding(dof, chi2);
                let gain2 = self.likelihood_gain2(dof, chi2);
                let evidence = match c.free {
                    true => gain_of_free(gain2, rank as f64, groups.ln()),
                    false => {
                        let price = 0.5 * (rank + c.shape_parameters) as f64 * groups.ln();
                        let whole = 0.5 * gain2 - price;
                        let lean = if c.placed { lean_chi2(&x, &along, index, c) } else { 0.0 };
                        let lean = 0.5 * self.likelihood_gain2(dof, lean) - price;
                        whole.max(lean + 0.5 * groups.ln())
                    }
                };
                let coefficient = (c.count == 1).then(|| chi2 / along[c.first]);
                let score = self.score(fitter, fitted, index, dof, (chi2, rank));
                let ln_p = (score.ln_p + c.searched).min(0.0);
                Some(Score { evidence: evidence - c.choice, coefficient, ln_p, ..score })
            })
            .collect()
    }

    /// Scores of pairs of candidates together, each under its first, with its second.
    pub fn pair_scores(
        &self,
        fitter: &Fitter,
        fitted: &Fitted,
        pool: &Pool,
        pairs: impl Iterator<Item = (usize, usize)>,
    ) -> Vec<(Score, usize)> {
        let x = pool.project(fitter, fitted, &self.basis);
        let along = x.inner(&self.residual);
        let gram = x.gram();
        let groups = fitter.experiment.layout().group_count().max(2) as f64;
        let columns = |c: &Candidate| c.first..c.first + c.count;
        let dof_of = |i: usize| self.dof_of(fitter, &x, i, &pool.candidates[i]);
        let known = vec![OnceCell::new(); pool.candidates.len()];
        let dof = |i: usize| *known[i].get_or_init(|| dof_of(i));
        pairs
            .filter_map(|(i, j)| {
                let (a, b) = (&pool.candidates[i], &pool.candidates[j]);
                let both: Vec<usize> = columns(a).chain(columns(b)).collect();
                let (chi2, rank) = gram_chi2(&gram, &along, &both);
                let price = 0.5 * (rank + a.shape_parameters + b.shape_parameters) as f64;
                let dof = dof(i).min(dof(j)).max(rank as f64 + 1.0);
                let chi2 = self.beyond_rounding(dof, chi2);
                let gain = 0.5 * self.likelihood_gain2(dof, chi2) - price * groups.ln();
                let score = self.score(fitter, fitted, i, dof, (chi2, rank));
                let score = Score { evidence: gain - a.choice - b.choice, ..score };
                (rank > 0).then_some((score, j))
            })
            .collect()
    }

    /// What χ² and rank alone make of a score: its evidence is still to come.
    fn score(
        &self,
        fitter: &Fitter,
        fitted: &Fitted,
        candidate: usize,
        dof: f64,
        (chi2, rank): (f64, usize),
    ) -> Score {
        let n = fitter.space.observations().max(1) as f64;
        Score {
            candidate,
            chi2,
            cleared: self.cleared(dof, chi2),
            rank,
            ln_p: self.ln_p(dof, chi2, rank as f64),
            evidence: 0.0,
            rms_mm: fitted.noise.sigma_mm[0] * (chi2 / n).sqrt(),
            coefficient: None,
        }
    }

    /// Degrees of freedom of the noise that a candidate's columns are seen against.
    fn dof_of(&self, fitter: &Fitter, x: &Projected, index: usize, c: &Candidate) -> f64 {
        let mut inverse = 0.0;
        for k in 0..c.count {
            let shares = fitter.space.shares(x.top.column(c.first + k), &x.rest_squares(index, k));
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

    /// χ² in units of the noise that is left once it is explained.
    fn cleared(&self, dof: f64, chi2: f64) -> f64 {
        let inside = (chi2 - self.excess).clamp(0.0, 0.99 * dof);
        if self.fixed { chi2 } else { chi2 * dof / (dof - inside) }
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
pub fn gain_of_free(chi2: f64, rank: f64, ln_captures: f64) -> f64 {
    let m = (chi2 / rank).max(1.0);
    0.5 * rank * (m - 1.0 - m.ln()) - 0.5 * ln_captures
}

/// A column that keeps less than this part of its length after the projection is an alias of the model.
const ALIAS: f64 = 3e-3;

/// χ² explained by a block and the number of its columns that survive the projection.
fn block_chi2(x: &Projected, along: &DVector<f64>, index: usize, c: &Candidate) -> (f64, usize) {
    if c.count == 1 {
        let (left, before) = (x.dot(index, 0, 0), x.whole(index, 0, 0));
        let seen = left > ALIAS * ALIAS * before && left > 0.0;
        return if seen { (along[c.first].powi(2) / left, 1) } else { (0.0, 0) };
    }
    let length = DVector::from_fn(c.count, |i, _| match x.whole(index, i, i).sqrt() {
        v if v > 0.0 => v,
        _ => 1.0,
    });
    let mut gram = DMatrix::zeros(c.count, c.count);
    for i in 0..c.count {
        for j in 0..=i {
            let value = x.dot(index, i, j) / (length[i] * length[j]);
            gram[(i, j)] = value;
            gram[(j, i)] = value;
        }
    }
    let along = along.rows(c.first, c.count).into_owned();
    gram_chi2(&(gram, length), &along, &(0..c.count).collect::<Vec<_>>())
}

/// χ² of a step or bump that is zero to one side of its place: with one column in place of two.
fn lean_chi2(x: &Projected, along: &DVector<f64>, index: usize, c: &Candidate) -> f64 {
    if c.count != 2 {
        return 0.0;
    }
    // Of shape - w constant.
    let of = |w: f64| {
        let rhs = along[c.first] - w * along[c.first + 1];
        let square =
            |dot: &dyn Fn(usize, usize) -> f64| dot(0, 0) + w * (w * dot(1, 1) - 2.0 * dot(0, 1));
        let left = square(&|i, j| x.dot(index, i, j));
        let whole = square(&|i, j| x.whole(index, i, j));
        if left > ALIAS * ALIAS * whole && left > 0.0 { rhs * rhs / left } else { 0.0 }
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
    // The scores depend on the columns only through their Gram matrix: its root is small, without what no score counts.
    let root = root(&pool.project(fitter, fitted, &standing.basis).gram().0, 1e-3 * ALIAS * ALIAS);
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
                DVector::from_fn(root.nrows(), |_, _| StandardNormal.sample(&mut rng));
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
