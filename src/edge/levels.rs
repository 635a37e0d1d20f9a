//! Slowly varying quantities along a contour: smooth curves through noisy sector values, robustly.

use nalgebra::{SMatrix, SVector};

use crate::fit::circle::tukey;
use crate::fit::robust;

/// Low-order curves over the contour: harmonics when it is closed, polynomials when it is an arc.
///
/// A level that is allowed to vary once round the contour costs half of what is known of the centre, so
/// higher orders are used only where the values ask for them.
pub(super) struct Curve {
    /// The curves at each sector: constant; once round (or linear); twice round (or quadratic).
    basis: Vec<SVector<f64, MOST>>,
    /// How many of them each order has.
    widths: [usize; 3],
}

/// Columns of the highest order.
const MOST: usize = 5;

impl Curve {
    /// For sectors 0..n evenly spread.
    pub(super) fn new(sectors: usize, closed: bool) -> Self {
        let column = |s: usize, c: usize| {
            let x = (s as f64 + 0.5) / sectors as f64;
            if closed {
                let wave = std::f64::consts::TAU * x * c.div_ceil(2) as f64;
                if c % 2 == 1 { wave.cos() } else { wave.sin() + f64::from(u8::from(c == 0)) }
            } else {
                (2.0 * x - 1.0).powi(c as i32)
            }
        };
        let widths = if closed { [1, 3, 5] } else { [1, 2, 3] };
        let basis = (0..sectors).map(|s| SVector::from_fn(|c, _| column(s, c))).collect();
        Self { basis, widths }
    }

    /// The curves' values at a sector, but for the constant.
    pub(super) fn slow(&self, sector: usize) -> &[f64] {
        &self.basis[sector].as_slice()[1..self.widths[self.widths.len() - 1]]
    }

    /// The robust curve through `values` (weight 0: no value), and the standard deviation about it.
    pub(super) fn fit(&self, values: &[f64], weights: &[f64]) -> (Vec<f64>, f64) {
        let (mut best, mut sd, mut sum) = self.fit_order(0, values, weights);
        let used = weights.iter().filter(|w| **w > 0.0).count() as f64;
        for order in 1..self.widths.len() {
            let columns = self.widths[order] as f64;
            if used < 3.0 * columns {
                break;
            }
            let (fitted, spread, left) = self.fit_order(order, values, weights);
            // The added terms must explain clearly more than noise would (an F-test at about 1 %).
            let added = columns - 1.0;
            let f = (sum - left) / added / (left / (used - columns)).max(1e-300);
            if f > 1.0 + 4.0 / added.sqrt() {
                (best, sd, sum) = (fitted, spread, left);
            }
        }
        (best, sd)
    }

    /// The curve of one order (in full, robust), the standard deviation and the robust sum of squares about it.
    pub(super) fn fit_order(
        &self,
        order: usize,
        values: &[f64],
        weights: &[f64],
    ) -> (Vec<f64>, f64, f64) {
        let (fitted, sd) = match self.widths[order] {
            1 => self.robust::<1>(values, weights),
            2 => self.robust::<2>(values, weights),
            3 => self.robust::<3>(values, weights),
            _ => self.robust::<MOST>(values, weights),
        };
        let cap = (3.0 * sd).powi(2);
        let sum = (0..values.len())
            .filter(|&s| weights[s] > 0.0)
            .map(|s| (values[s] - fitted[s]).powi(2).min(cap))
            .sum();
        (fitted, sd, sum)
    }

    /// The robust curve of the first `P` columns and the standard deviation about it.
    fn robust<const P: usize>(&self, values: &[f64], weights: &[f64]) -> (Vec<f64>, f64) {
        /// A curve that moves by less than this part of the standard deviation has been found.
        const SETTLED: f64 = 0.01;
        let mut fitted = vec![median(values, weights); self.basis.len()];
        let mut sd = spread(values, &fitted, weights);
        for _ in 0..6 {
            let mut normal = SMatrix::<f64, P, P>::zeros();
            let mut right = SVector::<f64, P>::zeros();
            for (s, row) in self.basis.iter().enumerate() {
                let off = if sd > 0.0 { tukey((values[s] - fitted[s]) / sd) } else { 1.0 };
                let w = weights[s] * off;
                if w > 0.0 {
                    let row = row.fixed_rows::<P>(0);
                    normal += row * (row * w).transpose();
                    right += row * (w * values[s]);
                }
            }
            // A little ridge keeps long gaps from swinging.
            let ridge = 1e-6 * normal.trace() / P as f64;
            for c in 1..P {
                normal[(c, c)] += ridge;
            }
            let Some(cholesky) = normal.cholesky() else { break };
            let coefficients = cholesky.solve(&right);
            let mut moved = 0.0f64;
            for (f, row) in fitted.iter_mut().zip(&self.basis) {
                let next = row.fixed_rows::<P>(0).dot(&coefficients);
                moved = moved.max((next - *f).abs());
                *f = next;
            }
            sd = spread(values, &fitted, weights);
            if moved < SETTLED * sd {
                break;
            }
        }
        (fitted, sd)
    }
}

/// Median of the values that carry weight.
pub(super) fn median(values: &[f64], weights: &[f64]) -> f64 {
    let mut list: Vec<f64> =
        values.iter().zip(weights).filter(|(_, w)| **w > 0.0).map(|(v, _)| *v).collect();
    if list.is_empty() {
        return 0.0;
    }
    robust::median(&mut list)
}

/// Robust standard deviation about the curve.
fn spread(values: &[f64], fitted: &[f64], weights: &[f64]) -> f64 {
    let sizes: Vec<f64> = values.iter().zip(fitted).map(|(v, f)| (v - f).abs()).collect();
    1.4826 * median(&sizes, weights)
}
