//! How surely a calibration's plane is known, and how far that moves places in it.

use nalgebra::{Matrix6, Vector2, Vector6};

/// Independent errors of a homography's first two rows and columns and its last row's first two (h11, h12, h21, h22, h31, h32),
/// each as large as one standard deviation. None where the plane is taken as exact.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlaneUncertainty {
    errors: Vec<Vector6<f64>>,
}

impl PlaneUncertainty {
    /// Of a covariance. `None` where it is none: not symmetric, or with a negative variance.
    pub fn of(covariance: &Matrix6<f64>) -> Option<Self> {
        /// What rounding leaves.
        const ROUNDING: f64 = 1e-9;
        // The numbers differ in size by their units: scaled to a unit diagonal first.
        let sd = covariance.diagonal().map(|v| v.max(0.0).sqrt());
        let scaled = Matrix6::from_fn(|r, c| {
            let size = sd[r] * sd[c];
            if size > 0.0 { covariance[(r, c)] / size } else { covariance[(r, c)] }
        });
        let eigen = scaled.symmetric_eigen();
        let sound = covariance.iter().all(|v| v.is_finite())
            && covariance.diagonal().min() >= 0.0
            && (scaled - scaled.transpose()).amax() < 1e-6
            && eigen.eigenvalues.min() > -1e-6;
        let errors = (0..6)
            .filter(|i| eigen.eigenvalues[*i] > ROUNDING)
            .map(|i| eigen.eigenvectors.column(i).component_mul(&sd) * eigen.eigenvalues[i].sqrt());
        sound.then(|| Self { errors: errors.collect() })
    }

    /// How far each of them moves the place `plane_mm`, where the homography maps `ideal` with the last coordinate `w`.
    pub(super) fn moves_mm(
        &self,
        ideal: Vector2<f64>,
        w: f64,
        plane_mm: Vector2<f64>,
    ) -> impl Iterator<Item = Vector2<f64>> {
        let seen = ideal / w;
        self.errors.iter().map(move |h| {
            let [x, y, last] = [0, 2, 4].map(|i| h[i] * seen.x + h[i + 1] * seen.y);
            Vector2::new(x, y) - plane_mm * last
        })
    }
}
