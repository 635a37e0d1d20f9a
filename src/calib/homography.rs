//! The mapping from a camera's undistorted picture to machine mm and a mark's place, fitted to where the mark is seen.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Vector2};

use crate::calib::plane::LEAST_POSITIONS;
use crate::error::{Error, Result};
use crate::fit::least_squares;
use crate::uncertainty::{K95, k95};

/// H's first two rows and columns, its last row's first two, and M.
pub(super) struct Fit {
    pub(super) p: DVector<f64>,
    /// For residuals of unit variance.
    pub(super) covariance: DMatrix<f64>,
    pub(super) variance: f64,
    pub(super) dof: f64,
}

impl Fit {
    pub(super) fn homography(&self) -> Matrix3<f64> {
        homography(&self.p)
    }

    /// Covariance of the homography's six numbers, so large that 1.96 standard deviations are half a 95 % interval.
    pub(super) fn homography_covariance(&self) -> Matrix6<f64> {
        let factor = self.variance * (k95(self.dof) / K95).powi(2);
        self.covariance.fixed_view::<6, 6>(0, 0) * factor
    }

    /// Value and half-width of the 95 % interval of a function of the parameters, the lens being exact.
    pub(super) fn value(&self, f: impl Fn(&DVector<f64>) -> f64) -> (f64, f64) {
        let at = f(&self.p);
        let gradient = DVector::from_fn(self.p.len(), |i, _| {
            let step = 1e-3 * self.covariance[(i, i)].sqrt().max(1e-12);
            let moved = |by: f64| {
                let mut p = self.p.clone();
                p[i] += by;
                f(&p)
            };
            (moved(step) - moved(-step)) / (2.0 * step)
        });
        let variance = self.variance * gradient.dot(&(&self.covariance * &gradient));
        (at, k95(self.dof) * variance.max(0.0).sqrt())
    }
}

pub(super) fn homography(p: &DVector<f64>) -> Matrix3<f64> {
    Matrix3::new(p[0], p[1], 0.0, p[2], p[3], 0.0, p[4], p[5], 1.0)
}

pub(super) fn map(p: &DVector<f64>, q: Vector2<f64>) -> Vector2<f64> {
    let w = p[4] * q.x + p[5] * q.y + 1.0;
    Vector2::new(p[0] * q.x + p[1] * q.y, p[2] * q.x + p[3] * q.y) / w
}

pub(super) fn solve(
    used: &[usize],
    place: &impl Fn(usize) -> (Vector2<f64>, Vector2<f64>),
) -> Result<Fit> {
    if used.len() < LEAST_POSITIONS {
        return Err(Error::measure(
            "captures",
            format!("the mark was found consistently in only {} pictures", used.len()),
            format!(
                "give {LEAST_POSITIONS} or more that show one clear mark; check x_mm and y_mm against the pictures"
            ),
        ));
    }
    let places: Vec<_> = used.iter().map(|&i| place(i)).collect();
    // Affine start: H·q - M = -P is linear without the last row.
    let rows = 2 * places.len();
    let design = DMatrix::from_fn(rows, 6, |r, c| {
        let q = places[r / 2].0;
        let own = [[q.x, q.y, 0.0, 0.0, -1.0, 0.0], [0.0, 0.0, q.x, q.y, 0.0, -1.0]];
        own[r % 2][c]
    });
    let y = DVector::from_fn(rows, |r, _| -places[r / 2].1[r % 2]);
    let (inverse, rank) = least_squares::covariance(&design, 1e-6);
    if rank < 6 {
        return Err(undetermined());
    }
    let a = &inverse * design.tr_mul(&y);
    let start = DVector::from_vec(vec![a[0], a[1], a[2], a[3], 0.0, 0.0, a[4], a[5]]);
    let model = |p: &DVector<f64>| {
        let mut r = DVector::zeros(rows);
        let mut j = DMatrix::zeros(rows, 8);
        for (i, (q, at)) in places.iter().enumerate() {
            let w = p[4] * q.x + p[5] * q.y + 1.0;
            let h = map(p, *q);
            for k in 0..2 {
                let row = 2 * i + k;
                r[row] = h[k] + at[k] - p[6 + k];
                j[(row, 2 * k)] = q.x / w;
                j[(row, 2 * k + 1)] = q.y / w;
                j[(row, 4)] = -h[k] * q.x / w;
                j[(row, 5)] = -h[k] * q.y / w;
                j[(row, 6 + k)] = -1.0;
            }
        }
        (r, || j)
    };
    let options = least_squares::Options { rank_tolerance: 1e-7, ..Default::default() };
    let solution = least_squares::solve(start, options, model);
    if solution.rank < 8 || homography(&solution.parameters).determinant() == 0.0 {
        return Err(undetermined());
    }
    let dof = solution.dof() as f64;
    Ok(Fit {
        variance: solution.chi2() / dof,
        p: solution.parameters,
        covariance: solution.covariance,
        dof,
    })
}

/// Positions that leave the mapping open.
pub(super) fn undetermined() -> Error {
    Error::measure(
        "captures",
        "the machine positions do not determine the mapping",
        "move the mark over the frame in X and in Y, not along one line",
    )
}
