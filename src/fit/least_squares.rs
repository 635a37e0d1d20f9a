//! Nonlinear least squares: Levenberg-Marquardt with column scaling, rank and covariance.
//!
//! Moré, "The Levenberg-Marquardt algorithm: implementation and theory" (1978), in its plain form: the
//! problems here have few parameters and good starts, so the damping is a single factor on the scaled
//! normal equations. Ranks and covariances come from a singular value decomposition.

use nalgebra::{DMatrix, DVector};

/// When to stop, and what counts as rank.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Most steps taken. Well-posed problems here need under 20.
    pub max_steps: usize,
    /// A step smaller than this part of each parameter's scale ends the search.
    pub relative_step: f64,
    /// A step expected to lower the sum of squares by less than this is not taken: it ends the search.
    pub least_drop: f64,
    /// Steps after which only those are taken that are expected to lower the sum of squares by `late_drop`: a valley may be very long and
    /// nearly flat.
    pub patience: usize,
    /// See `patience`.
    pub late_drop: f64,
    /// A singular value (of the column-scaled Jacobian) under this part of the largest counts as zero.
    pub rank_tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_steps: 100,
            relative_step: 1e-12,
            least_drop: 0.0,
            patience: usize::MAX,
            late_drop: 0.0,
            rank_tolerance: 1e-10,
        }
    }
}

/// The solution and what is known of it.
#[derive(Debug, Clone)]
pub struct Solution {
    /// The parameters at the minimum.
    pub parameters: DVector<f64>,
    /// The residuals there.
    pub residuals: DVector<f64>,
    /// The Jacobian there.
    pub jacobian: DMatrix<f64>,
    /// (JᵀJ)⁻¹ on the visible part (pseudo-inverse): the covariance for residuals of unit variance.
    pub covariance: DMatrix<f64>,
    /// Number of parameter combinations the residuals determine.
    pub rank: usize,
    /// Whether the search ended at a minimum rather than at `max_steps`.
    pub converged: bool,
}

impl Solution {
    /// Sum of squared residuals.
    pub fn chi2(&self) -> f64 {
        self.residuals.norm_squared()
    }

    /// Residuals minus rank.
    pub fn dof(&self) -> usize {
        self.residuals.len().saturating_sub(self.rank)
    }
}

/// aᵀ b; a large product goes through the blocked kernel, which nalgebra's `tr_mul` does not use, and its products of few rows neither.
pub fn transposed_times(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    /// From so many rows and columns on nalgebra's products are blocked.
    const BLOCKED: usize = 6;
    /// So many columns are worth rows of zeros.
    const MANY: usize = 32;
    let few = a.ncols();
    if few.min(b.ncols()) >= BLOCKED {
        a.transpose() * b
    } else if few > 1 && b.ncols() >= MANY {
        let product = a.transpose().resize_vertically(BLOCKED, 0.0) * b;
        product.rows(0, few).into_owned()
    } else {
        a.tr_mul(b)
    }
}

/// Minimises |r(p)|² from `start`. `model` returns residuals and what makes their Jacobian, both already divided by the
/// standard deviations; the Jacobian is asked for only where a step is taken. Non-finite values end the search at the last good point.
pub fn solve<J: FnOnce() -> DMatrix<f64>>(
    start: DVector<f64>,
    options: Options,
    mut model: impl FnMut(&DVector<f64>) -> (DVector<f64>, J),
) -> Solution {
    let mut parameters = start;
    let (mut residuals, at_start) = model(&parameters);
    let mut jacobian = at_start();
    let mut damping = 1e-6;
    let mut converged = false;
    for taken in 0..options.max_steps {
        let least_drop = match taken < options.patience {
            true => options.least_drop,
            false => options.late_drop,
        };
        let scale = column_norms(&jacobian);
        let scaled = scale_columns(&jacobian, &scale);
        let normal = transposed_times(&scaled, &scaled);
        let gradient = scaled.tr_mul(&residuals);
        let mut accepted = false;
        for _ in 0..30 {
            let mut damped = normal.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] += damping;
            }
            let Some(cholesky) = damped.cholesky() else {
                damping *= 10.0;
                continue;
            };
            let scaled_step = -cholesky.solve(&gradient);
            // |r|² - |r + J s|²
            let drop = -scaled_step.dot(&(2.0 * &gradient + &normal * &scaled_step));
            if drop < least_drop {
                break;
            }
            let step = scaled_step.component_div(&scale);
            let trial = &parameters + &step;
            let (trial_residuals, at_trial) = model(&trial);
            let before = residuals.norm_squared();
            let after = trial_residuals.norm_squared();
            let lower = after.is_finite() && after <= before;
            let trial_jacobian = lower.then(at_trial).filter(|j| j.iter().all(|v| v.is_finite()));
            if let Some(trial_jacobian) = trial_jacobian {
                let small = step.iter().zip(trial.iter()).all(|(s, p)| {
                    s.abs() <= options.relative_step * (p.abs() + options.relative_step)
                });
                let flat = before - after <= 1e-15 * before && damping < 1.0;
                parameters = trial;
                residuals = trial_residuals;
                jacobian = trial_jacobian;
                damping = (damping * 0.1).max(1e-15);
                accepted = true;
                converged = small || flat;
                break;
            }
            damping *= 10.0;
        }
        if !accepted {
            // No step lowers the sum any more, or enough: a minimum, if there is a sum.
            converged = residuals.iter().all(|r| r.is_finite());
        }
        if converged || !accepted {
            break;
        }
    }
    let (covariance, rank) = covariance(&jacobian, options.rank_tolerance);
    Solution { parameters, residuals, jacobian, covariance, rank, converged }
}

/// (JᵀJ)⁺ and the rank, from the singular values of the column-scaled Jacobian.
pub fn covariance(jacobian: &DMatrix<f64>, rank_tolerance: f64) -> (DMatrix<f64>, usize) {
    let n = jacobian.ncols();
    if n == 0 || !jacobian.iter().all(|v| v.is_finite()) {
        return (DMatrix::zeros(n, n), 0);
    }
    let scale = column_norms(jacobian);
    // The triangular factor has the same singular values and is small.
    let r = if jacobian.nrows() > n {
        scale_columns(jacobian, &scale).qr().r()
    } else {
        scale_columns(jacobian, &scale)
    };
    let svd = r.svd(false, true);
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    let mut covariance = DMatrix::zeros(n, n);
    let mut rank = 0;
    if let Some(v_t) = svd.v_t {
        for (k, &s) in svd.singular_values.iter().enumerate() {
            if s > rank_tolerance * largest {
                rank += 1;
                let v = v_t.row(k).transpose().component_div(&scale);
                covariance += &v * v.transpose() / (s * s);
            }
        }
    }
    (covariance, rank)
}

fn column_norms(jacobian: &DMatrix<f64>) -> DVector<f64> {
    DVector::from_iterator(
        jacobian.ncols(),
        jacobian.column_iter().map(|c| {
            let norm = c.norm();
            if norm > 0.0 { norm } else { 1.0 }
        }),
    )
}

fn scale_columns(jacobian: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |r, c| jacobian[(r, c)] / scale[c])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// NIST StRD Misra1a: y = b1 (1 - exp(-b2 x)), certified b1 = 238.94212918, b2 = 5.5015643181e-4.
    #[test]
    fn misra1a_to_certified_digits() {
        let x = [
            77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1,
            689.1, 760.0,
        ];
        let y = [
            10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40,
            75.47, 81.78,
        ];
        let model = |p: &DVector<f64>| {
            let r = DVector::from_fn(x.len(), |i, _| p[0] * (1.0 - (-p[1] * x[i]).exp()) - y[i]);
            let j = DMatrix::from_fn(x.len(), 2, |i, c| {
                let e = (-p[1] * x[i]).exp();
                if c == 0 { 1.0 - e } else { p[0] * x[i] * e }
            });
            (r, || j)
        };
        for start in [[500.0, 1e-4], [250.0, 5e-4]] {
            let s = solve(DVector::from_row_slice(&start), Options::default(), model);
            assert!(s.converged);
            assert!((s.parameters[0] / 2.3894212918e2 - 1.0).abs() < 1e-8);
            assert!((s.parameters[1] / 5.5015643181e-4 - 1.0).abs() < 1e-8);
            let sd = (s.chi2() / s.dof() as f64 * s.covariance[(0, 0)]).sqrt();
            assert!(
                (sd / 2.7070075241 - 1.0).abs() < 1e-6,
                "certified standard deviation, got {sd}"
            );
        }
    }

    #[test]
    fn an_undetermined_direction_lowers_the_rank() {
        let model = |p: &DVector<f64>| {
            let r = DVector::from_fn(3, |i, _| p[0] + p[1] - i as f64);
            (r, || DMatrix::from_element(3, 2, 1.0))
        };
        let s = solve(DVector::zeros(2), Options::default(), model);
        assert_eq!(s.rank, 1);
        assert!((s.parameters.sum() - 1.0).abs() < 1e-9);
    }
}
