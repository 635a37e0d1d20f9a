//! How well a lens's numbers are known from the views they were fitted to.

use nalgebra::{Rotation3, SMatrix, Vector2, Vector3};

use crate::camera::Lens;
use crate::cv::{self, BoardView, LensFit};

/// Standard uncertainties of the free numbers of the lens, the views' poses being unknown too. (OpenCV's own divide the
/// sum of squares by the number of points, not by that of coordinates, and are about 1.4 times too large.)
pub(super) fn uncertainties(
    found: &[(usize, BoardView)],
    fit: &LensFit,
    residuals: &[Vec<Vector2<f64>>],
    free: [bool; 9],
) -> [Option<f64>; 9] {
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    let (mut squares, mut dof) = (0.0, -(free.iter().filter(|f| **f).count() as f64));
    for (((_, view), pose), residuals) in found.iter().zip(&fit.poses).zip(residuals) {
        squares += residuals.iter().map(Vector2::norm_squared).sum::<f64>();
        dof += 2.0 * residuals.len() as f64 - 6.0;
        let lens: Vec<Vec<Vector2<f64>>> = (0..9)
            .map(|i| slope(|by| view.residuals(&nudged(&fit.lens, i, by), pose), 1e-5))
            .collect();
        let own: Vec<Vec<Vector2<f64>>> = (0..6)
            .map(|i| slope(|by| view.residuals(&fit.lens, &moved(pose, i, by)), 1e-5))
            .collect();
        let mut ll = SMatrix::<f64, 9, 9>::zeros();
        let mut lo = SMatrix::<f64, 9, 6>::zeros();
        let mut oo = SMatrix::<f64, 6, 6>::zeros();
        for k in 0..residuals.len() {
            let a = SMatrix::<f64, 9, 2>::from_fn(|i, c| if free[i] { lens[i][k][c] } else { 0.0 });
            let b = SMatrix::<f64, 6, 2>::from_fn(|i, c| own[i][k][c]);
            ll += a * a.transpose();
            lo += a * b.transpose();
            oo += b * b.transpose();
        }
        let Some(inverse) = oo.try_inverse() else { continue };
        normal += ll - lo * inverse * lo.transpose();
    }
    // Scaled to a unit diagonal before it is inverted; numbers held at zero stand alone.
    let scale: [f64; 9] =
        std::array::from_fn(|i| if free[i] { normal[(i, i)].max(0.0).sqrt() } else { 0.0 });
    let mut scaled = SMatrix::<f64, 9, 9>::identity();
    for i in (0..9).filter(|&i| scale[i] > 0.0) {
        for j in (0..9).filter(|&j| scale[j] > 0.0) {
            scaled[(i, j)] = normal[(i, j)] / (scale[i] * scale[j]);
        }
    }
    let inverse = scaled.try_inverse();
    std::array::from_fn(|i| {
        let known = inverse.filter(|_| scale[i] > 0.0 && dof > 0.0);
        let variance = known.map(|c| c[(i, i)].max(0.0) / scale[i].powi(2) * squares / dof);
        free[i].then(|| variance.map_or(f64::INFINITY, f64::sqrt))
    })
}

/// Central differences.
fn slope(f: impl Fn(f64) -> Vec<Vector2<f64>>, step: f64) -> Vec<Vector2<f64>> {
    f(step).iter().zip(f(-step)).map(|(a, b)| (a - b) / (2.0 * step)).collect()
}

/// The lens with one of its nine numbers changed.
fn nudged(lens: &Lens, which: usize, by: f64) -> Lens {
    let mut lens = lens.clone();
    match which {
        0 => lens.fx_px += by,
        1 => lens.fy_px += by,
        2 => lens.cx_px += by,
        3 => lens.cy_px += by,
        k => lens.distortion[k - 4] += by,
    }
    lens
}

/// The pose turned or shifted a little.
fn moved(pose: &cv::Pose, which: usize, by: f64) -> cv::Pose {
    let mut step = Vector3::zeros();
    step[which % 3] = by;
    if which < 3 {
        cv::Pose { turn: Rotation3::new(step) * pose.turn, ..*pose }
    } else {
        cv::Pose { shift_mm: pose.shift_mm + step, ..*pose }
    }
}
