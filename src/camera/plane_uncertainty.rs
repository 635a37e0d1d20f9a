//! How surely a calibration's lens and plane are known, and how far that moves places in the plane.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, SMatrix, SVector, Vector2, Vector6};

use crate::camera::{Lens, Mapping, View};

/// The lens' numbers: fx, fy, cx, cy, k1, k2, p1, p2, k3.
pub const LENS_NUMBERS: usize = 9;
/// Their covariance, 1.96 standard deviations being half a 95 % interval.
pub type LensCovariance = SMatrix<f64, LENS_NUMBERS, LENS_NUMBERS>;

/// What is not known of a calibration's lens and plane.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneCovariance {
    /// Of h11, h12, h21, h22, h31, h32 for the lens as it is, 1.96 standard deviations being half a 95 % interval.
    pub homography: Matrix6<f64>,
    /// The lens', and how the six numbers, fitted through another lens, change with its numbers. `None` where it is taken as exact.
    pub lens: Option<(LensCovariance, SMatrix<f64, 6, LENS_NUMBERS>)>,
}

/// Independent errors, each as large as one standard deviation. None where lens and plane are taken as exact.
#[derive(Debug, Clone, Default)]
pub(super) struct PlaneUncertainty {
    /// Of the homography's first two rows and columns and its last row's first two.
    homography: Vec<Vector6<f64>>,
    /// The view through another lens, and where it sees this one's camera axis.
    lens: Vec<(View, Vector2<f64>)>,
}

/// The independent errors of a covariance, each as large as one standard deviation. `None` where it is none: not symmetric, or with a
/// negative variance.
pub(crate) fn independent<const N: usize>(
    covariance: &SMatrix<f64, N, N>,
) -> Option<Vec<SVector<f64, N>>> {
    /// What rounding leaves.
    const ROUNDING: f64 = 1e-9;
    // The numbers differ in size by their units: scaled to a unit diagonal first.
    let sd = DVector::from_fn(N, |i, _| covariance[(i, i)].max(0.0).sqrt());
    let scaled = DMatrix::from_fn(N, N, |r, c| {
        let size = sd[r] * sd[c];
        if size > 0.0 { covariance[(r, c)] / size } else { covariance[(r, c)] }
    });
    let uneven = (&scaled - scaled.transpose()).amax();
    let eigen = scaled.symmetric_eigen();
    let sound = covariance.iter().all(|v| v.is_finite())
        && (0..N).all(|i| covariance[(i, i)] >= 0.0)
        && uneven < 1e-6
        && eigen.eigenvalues.min() > -1e-6;
    let errors = (0..N).filter(|i| eigen.eigenvalues[*i] > ROUNDING).map(|i| {
        let size = eigen.eigenvalues[i].sqrt();
        SVector::from_fn(|k, _| eigen.eigenvectors[(k, i)] * sd[k] * size)
    });
    sound.then(|| errors.collect())
}

impl PlaneUncertainty {
    /// Of a view with this lens and homography. `None` where a covariance is none.
    pub fn of(covariance: &PlaneCovariance, lens: &Lens, to_plane: &Matrix3<f64>) -> Option<Self> {
        let homography = independent(&covariance.homography)?;
        let mut bent = Vec::new();
        if let Some((of_lens, by_lens)) = &covariance.lens {
            for error in independent(of_lens)? {
                let view = bent_view(lens, to_plane, &error, &(by_lens * error));
                // The camera axis is where this lens says it is.
                let axis_mm = view.to_plane(Vector2::new(lens.cx_px, lens.cy_px));
                bent.push((view, axis_mm));
            }
        }
        Some(Self { homography, lens: bent })
    }

    /// How far each of them moves the place `plane_mm`, where the homography maps `ideal` with the last coordinate `w`, and which is seen
    /// at the pixel that `seen` tells.
    pub fn moves_mm(
        &self,
        ideal: Vector2<f64>,
        w: f64,
        plane_mm: Vector2<f64>,
        seen: impl FnOnce() -> Vector2<f64>,
    ) -> impl Iterator<Item = Vector2<f64>> {
        let pixel = if self.lens.is_empty() { Vector2::zeros() } else { seen() };
        let ideal = ideal / w;
        let of_homography = self.homography.iter().map(move |h| {
            let [x, y, last] = [0, 2, 4].map(|i| h[i] * ideal.x + h[i + 1] * ideal.y);
            Vector2::new(x, y) - plane_mm * last
        });
        let of_lens =
            self.lens.iter().map(move |(view, axis_mm)| view.to_plane(pixel) - plane_mm - axis_mm);
        of_homography.chain(of_lens)
    }
}

/// The view through a lens that is another by `error`, the plane fitted through it.
fn bent_view(
    lens: &Lens,
    to_plane: &Matrix3<f64>,
    error: &SVector<f64, LENS_NUMBERS>,
    h: &Vector6<f64>,
) -> View {
    let homography_mm = to_plane + Matrix3::new(h[0], h[1], 0.0, h[2], h[3], 0.0, h[4], h[5], 0.0);
    let mapping = Mapping::Pinhole {
        lens: lens.plus(error),
        homography_mm,
        covariance: None,
        mirrored: false,
    };
    View::new(&mapping, lens.width_px as usize, lens.height_px as usize)
}
