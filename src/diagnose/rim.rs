//! Form of the artefact's rim: a random part that every capture shares, because it turns with the artefact.
//!
//! Tool marks, texture and roughness move the edge by the same amount whenever the same piece of the rim is seen. Such a form
//! is a random walk with a short memory (exponential correlation), linear between the ends of short pieces. Its variance
//! is found by restricted maximum likelihood like those of the captures' own parts:
//! `V' = I + τ F Fᵀ` after those have been whitened, and `V'^(-1/2) = I - F K Fᵀ` (Woodbury).

use nalgebra::{DMatrix, DVector};

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::fit::{Extra, Fitter};
use crate::diagnose::generic::Term;
use crate::diagnose::parts::with_extra;
use crate::diagnose::score::Standing;
use crate::diagnose::shape::Shape;
use crate::fit::least_squares::transposed_times;

/// Pieces of a turn: 3° each.
const PIECES: usize = 120;
/// Angle over which the form forgets itself, to 1/e. Smooth shapes and named effects vary over far more.
pub(super) const MEMORY_DEG: f64 = 3.0;
/// Memories of a form that is more than roughness: something turns with the rod that wants telling.
const LONG_MEMORIES_DEG: [f64; 3] = [6.0, 12.0, 24.0];

/// Lobes that a rim is turned with: no part of its roughness.
const LOBES: u32 = 4;
/// A rough rim must be this much more likely than none, nats.
const SHOWS: f64 = 7.0;

/// Whether the rim has a rough form that should count as noise: one that is likelier than none, and whose
/// memory is short: a longer one is of something that should be told, a wave, a burr, a flat.
pub(super) fn is_rough(fitter: &Fitter) -> bool {
    let layout = fitter.experiment.layout();
    let variable = layout.variables.iter().position(|v| v.values == layout.rim_deg);
    let direction = layout.directions.iter().position(|d| d.name == "radius");
    let (Some(variable), Some(direction)) = (variable, direction) else { return false };
    let mut model = fitter.baseline();
    for lobes in 1..=LOBES {
        let term = Term { direction, variable, shape: Shape::Harmonic(lobes) };
        model = with_extra(&model, &Extra::Generic(term), term.columns(layout));
    }
    let fitted = fitter.fit(model, None);
    let standing = Standing::new(fitter, &fitted, &[]);
    let evidence = |columns: &DMatrix<f64>| {
        let mut x = fitter.whiten(columns, &fitted.noise);
        x -= &standing.basis * transposed_times(&standing.basis, &x);
        random_evidence(&x, &standing.residual)
    };
    let rough = evidence(&Rim::columns(&layout.rim_deg, MEMORY_DEG));
    let long = LONG_MEMORIES_DEG.map(|m| evidence(&Rim::columns(&layout.rim_deg, m)));
    rough > long.into_iter().fold(SHOWS, f64::max)
}

/// ln likelihood gained by columns with random coefficients of one variance τ, the likeliest (both whitened, the model
/// projected out): ½ Σ (τ β² / (1 + τ λ) - ln(1 + τ λ)) over the eigenvectors of `XᵀX`.
fn random_evidence(x: &DMatrix<f64>, residual: &DVector<f64>) -> f64 {
    let eigen = transposed_times(x, x).symmetric_eigen();
    let along = eigen.eigenvectors.tr_mul(&x.tr_mul(residual));
    let gain = |tau: f64| -> f64 {
        let each = eigen.eigenvalues.iter().zip(along.iter()).map(|(l, b)| {
            let v = 1.0 + tau * l.max(0.0);
            0.5 * (tau * b * b / v - v.ln())
        });
        each.sum()
    };
    let largest = eigen.eigenvalues.max().max(1e-300);
    (-16..=40).map(|k| gain(2.0_f64.powf(0.5 * f64::from(k)) / largest)).fold(0.0, f64::max)
}

/// The rim's columns in the rotated space.
#[derive(Debug, Clone)]
pub(super) struct Rim {
    /// Orthonormal basis of what the captures' own parts leave of the columns.
    q: DMatrix<f64>,
    /// The columns: capture-level rows, then their components along `q`.
    r: DMatrix<f64>,
    /// Square of each observation's row.
    pub(super) squares: Vec<f64>,
}

impl Rim {
    /// Radius at each observation per independent draw of unit variance.
    pub(super) fn columns(angles_deg: &[f64], memory_deg: f64) -> DMatrix<f64> {
        let turn = PIECES as f64;
        let mut ends = DMatrix::zeros(angles_deg.len(), PIECES);
        for (i, angle) in angles_deg.iter().enumerate() {
            let at = angle.rem_euclid(360.0) / 360.0 * turn;
            let piece = at as usize % PIECES;
            ends[(i, piece)] = 1.0 - at.fract();
            ends[(i, (piece + 1) % PIECES)] = at.fract();
        }
        let correlation = DMatrix::from_fn(PIECES, PIECES, |i, j| {
            let pieces = i.abs_diff(j).min(PIECES - i.abs_diff(j)) as f64;
            (-pieces * 360.0 / turn / memory_deg).exp()
        });
        // Positive definite on a circle, so that the factor exists.
        correlation.cholesky().map_or_else(|| ends.clone(), |c| &ends * c.l())
    }

    /// From the columns and their split, of which the first `top` rows are the captures' own parts.
    pub(super) fn new(columns: &DMatrix<f64>, split: &DMatrix<f64>, top: usize) -> Self {
        let rest = split.rows(top, columns.nrows()).into_owned();
        let q = orthonormal(&rest, 1e-6);
        let mut r = DMatrix::zeros(top + q.ncols(), columns.ncols());
        r.rows_mut(0, top).copy_from(&split.rows(0, top));
        r.rows_mut(top, q.ncols()).copy_from(&transposed_times(&q, &rest));
        Self { q, r, squares: columns.row_iter().map(|row| row.norm_squared()).collect() }
    }

    /// Number of rows that the rim adds to those of the captures.
    pub(super) fn rows(&self) -> usize {
        self.q.ncols()
    }

    /// Takes the components along the rim out of the remainders.
    pub(super) fn take(&self, rest: &mut DMatrix<f64>) -> DMatrix<f64> {
        let along = transposed_times(&self.q, rest);
        *rest -= &self.q * &along;
        along
    }

    /// The columns before whitening.
    pub(super) fn raw(&self) -> &DMatrix<f64> {
        &self.r
    }
}

/// The whitening of the rim's part at one variance.
#[derive(Debug, Clone)]
pub(super) struct Whitener {
    /// The columns, the captures' own parts whitened.
    f: DMatrix<f64>,
    /// K of `I - F K Fᵀ`, the inverse root of `I + τ F Fᵀ`.
    root: DMatrix<f64>,
    /// The same of the inverse itself.
    inverse: DMatrix<f64>,
    /// tr(Fᵀ V'⁻¹ F).
    information: f64,
    /// ln det V'.
    pub(super) ln_det: f64,
}

impl Whitener {
    pub(super) fn new(f: DMatrix<f64>, ratio: f64) -> Self {
        let eigen = transposed_times(&f, &f).symmetric_eigen();
        let lambda: Vec<f64> = eigen.eigenvalues.iter().map(|l| l.max(0.0)).collect();
        let v = &eigen.eigenvectors;
        let of = |g: &dyn Fn(f64) -> f64| {
            let mut scaled = v.clone();
            scaled.column_iter_mut().zip(&lambda).for_each(|(mut c, l)| c *= g(*l));
            scaled * v.transpose()
        };
        // (1 - s)/λ with s = 1/√(1 + τλ), written so that small λ lose nothing.
        let root = of(&|l| {
            let s = 1.0 / (1.0 + ratio * l).sqrt();
            ratio * s * s / (1.0 + s)
        });
        let inverse = of(&|l| ratio / (1.0 + ratio * l));
        let information = lambda.iter().map(|l| l / (1.0 + ratio * l)).sum();
        let ln_det = lambda.iter().map(|l| (ratio * l).ln_1p()).sum();
        Self { f, root, inverse, information, ln_det }
    }

    /// Whitens columns.
    pub(super) fn apply(&self, columns: &mut DMatrix<f64>) {
        let along = transposed_times(&self.f, columns);
        *columns -= &self.f * (&self.root * along);
    }

    /// What the whitening takes of the square of a vector that has only these rows, from the first given on.
    pub(super) fn taken(&self, vector: &DMatrix<f64>, first: usize) -> f64 {
        let along = self.f.rows(first, vector.nrows()).tr_mul(vector);
        (along.tr_mul(&(&self.inverse * &along)))[(0, 0)]
    }

    /// Σ (Fᵀ e)² and tr(Fᵀ P F), where `e` and the model's basis have been whitened twice.
    pub(super) fn score(&self, e: &DMatrix<f64>, basis: &DMatrix<f64>) -> (f64, f64) {
        let seen = self.f.tr_mul(e).norm_squared();
        (seen, self.information - transposed_times(&self.f, basis).norm_squared())
    }
}
