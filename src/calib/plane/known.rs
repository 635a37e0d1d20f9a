//! What is known of a plane through a lens that is itself not quite known.

use nalgebra::{DVector, SMatrix, Vector2};

use crate::calib::homography::{Fit, map};
use crate::calib::unseen_lens::corners_px;
use crate::camera::{LENS_NUMBERS, Lens, LensCovariance, independent};
use crate::uncertainty::K95;

/// A fitted plane, its lens, and the lenses that may as well be the camera's, each with the plane that is fitted through it.
pub(super) struct Known<'f> {
    pub fit: &'f Fit,
    pub lens: &'f Lens,
    others: Vec<(Lens, DVector<f64>)>,
}

impl<'f> Known<'f> {
    /// `by_lens` is the lens' covariance and how the homography changes with its numbers.
    pub fn new(
        fit: &'f Fit,
        lens: &'f Lens,
        by_lens: Option<&(LensCovariance, SMatrix<f64, 6, LENS_NUMBERS>)>,
    ) -> Self {
        let errors = by_lens.and_then(|(covariance, slopes)| {
            let other = |error| {
                let mut p = fit.p.clone();
                let mut six = p.fixed_rows_mut::<6>(0);
                six += slopes * error;
                (lens.plus(&error), p)
            };
            Some(independent(covariance)?.into_iter().map(other).collect())
        });
        Self { fit, lens, others: errors.unwrap_or_default() }
    }

    /// Value and half-width of the 95 % interval of a function of the lens and the plane's numbers.
    pub fn value(&self, f: impl Fn(&Lens, &DVector<f64>) -> f64) -> (f64, f64) {
        let (at, u95) = self.fit.value(|p| f(self.lens, p));
        let by_lens: f64 = self.others.iter().map(|(l, p)| (f(l, p) - at).powi(2)).sum();
        (at, u95.hypot(K95 * by_lens.sqrt()))
    }
}

/// Largest half-width of the 95 % interval of a corner seen from the camera axis, which is where the lens says it is.
pub(super) fn field_u95_mm(known: &Known) -> f64 {
    let axis = Vector2::new(known.lens.cx_px, known.lens.cy_px);
    corners_px(known.lens)
        .into_iter()
        .map(|px| {
            let place = |lens: &Lens, p: &DVector<f64>| {
                let view = lens.normalised();
                map(p, view.to_plane(px)) - map(p, view.to_plane(axis))
            };
            [0, 1].map(|k| known.value(|l, p| place(l, p)[k]).1)
        })
        .map(|[x, y]| x.hypot(y))
        .fold(0.0, f64::max)
}
