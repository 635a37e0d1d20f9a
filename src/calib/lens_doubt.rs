//! How well a lens's numbers are known from the views they were fitted to.

use nalgebra::{Rotation3, SMatrix, SVector, Vector2, Vector3};

use crate::camera::Lens;
use crate::cv::{self, BoardView, LensFit};
use crate::uncertainty::k95;

/// What one view says of the lens, its own pose being unknown too.
struct Say {
    normal: SMatrix<f64, 9, 9>,
    /// Its points' pull on the lens that all views agree on.
    pull: SVector<f64, 9>,
}

/// Half-widths of the 95 % intervals of the free numbers of the lens.
///
/// By the jackknife over views: each view in turn is left out (one linear step from the fit), and the lenses so found
/// scatter as the lens does. The errors of a view's points have causes in common (its blur and tilt, a print that is
/// not flat, the detector's windows), so a view counts as one witness, however many its points.
pub(super) fn intervals(
    found: &[(usize, BoardView)],
    fit: &LensFit,
    residuals: &[Vec<Vector2<f64>>],
    free: [bool; 9],
) -> [Option<f64>; 9] {
    let says: Vec<Say> = found
        .iter()
        .zip(&fit.poses)
        .zip(residuals)
        .filter_map(|(((_, view), pose), seen)| say(view, &fit.lens, pose, seen, free))
        .collect();
    let normal: SMatrix<f64, 9, 9> = says.iter().map(|s| s.normal).sum();
    // Scaled to a unit diagonal before it is inverted; numbers held at zero stand alone.
    let scale: [f64; 9] =
        std::array::from_fn(|i| if free[i] { normal[(i, i)].max(0.0).sqrt() } else { 0.0 });
    let known = (0..9).all(|i| !free[i] || scale[i] > 0.0);
    let without = |s: &Say| -> Option<SVector<f64, 9>> {
        let rest = normal - s.normal;
        let scaled = SMatrix::<f64, 9, 9>::from_fn(|i, j| match (free[i] && free[j], i == j) {
            (true, _) => rest[(i, j)] / (scale[i] * scale[j]),
            (false, same) => f64::from(u8::from(same)),
        });
        let pull = SVector::from_fn(|i, _| if free[i] { s.pull[i] / scale[i] } else { 0.0 });
        let step = scaled.cholesky()?.solve(&pull);
        Some(SVector::from_fn(|i, _| if free[i] { step[i] / scale[i] } else { 0.0 }))
    };
    let steps: Option<Vec<SVector<f64, 9>>> =
        if known { says.iter().map(without).collect() } else { None };
    let dof = says.len() as f64 - 1.0;
    std::array::from_fn(|i| {
        free[i].then(|| {
            steps.as_ref().filter(|_| dof > 0.0).map_or(f64::INFINITY, |steps| {
                let squares: f64 = steps.iter().map(|s| s[i].powi(2)).sum();
                k95(dof) * (squares * dof / (dof + 1.0)).sqrt()
            })
        })
    })
}

/// `None` where the view's pose is undetermined.
fn say(
    view: &BoardView,
    at: &Lens,
    pose: &cv::Pose,
    residuals: &[Vector2<f64>],
    free: [bool; 9],
) -> Option<Say> {
    let lens: Vec<Vec<Vector2<f64>>> =
        (0..9).map(|i| slope(|by| view.residuals(&nudged(at, i, by), pose), 1e-5)).collect();
    let own: Vec<Vec<Vector2<f64>>> =
        (0..6).map(|i| slope(|by| view.residuals(at, &moved(pose, i, by)), 1e-5)).collect();
    let mut ll = SMatrix::<f64, 9, 9>::zeros();
    let mut lo = SMatrix::<f64, 9, 6>::zeros();
    let mut oo = SMatrix::<f64, 6, 6>::zeros();
    let (mut le, mut oe) = (SVector::<f64, 9>::zeros(), SVector::<f64, 6>::zeros());
    for (k, e) in residuals.iter().enumerate() {
        let a = SMatrix::<f64, 9, 2>::from_fn(|i, c| if free[i] { lens[i][k][c] } else { 0.0 });
        let b = SMatrix::<f64, 6, 2>::from_fn(|i, c| own[i][k][c]);
        ll += a * a.transpose();
        lo += a * b.transpose();
        oo += b * b.transpose();
        le += a * e;
        oe += b * e;
    }
    let share = lo * oo.try_inverse()?;
    Some(Say { normal: ll - share * lo.transpose(), pull: le - share * oe })
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
