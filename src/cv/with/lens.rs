//! `calibrateCamera`: Zhang, "A flexible new technique for camera calibration" (2000), as OpenCV has it.

use nalgebra::{Rotation3, Vector3};
use opencv::calib3d;
use opencv::core::{Mat, Point2f, Point3f, Size, TermCriteria, TermCriteria_Type, Vector};
use opencv::prelude::*;

use super::failed;
use crate::camera::Lens;
use crate::cv::{BoardView, Distortion, LensFit, Pose};
use crate::error::Result;

/// Finds the lens on which all views agree.
pub fn calibrate(views: &[BoardView], size: (u32, u32), distortion: Distortion) -> Result<LensFit> {
    run(views, size, distortion).map_err(failed)
}

fn run(
    views: &[BoardView],
    (width, height): (u32, u32),
    distortion: Distortion,
) -> opencv::Result<LensFit> {
    let mut objects = Vector::<Vector<Point3f>>::new();
    let mut images = Vector::<Vector<Point2f>>::new();
    for view in views {
        objects.push(
            view.board_mm
                .iter()
                .map(|p| Point3f::new(p.x as f32, p.y as f32, p.z as f32))
                .collect(),
        );
        images.push(view.pixels.iter().map(|p| Point2f::new(p.x as f32, p.y as f32)).collect());
    }
    let (mut matrix, mut coefficients) = (Mat::default(), Mat::default());
    let (mut turns, mut shifts) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    let k3 = calib3d::CALIB_FIX_K3;
    let tangential = calib3d::CALIB_ZERO_TANGENT_DIST;
    let flags = match distortion {
        Distortion::Full => 0,
        Distortion::Decentred => k3,
        Distortion::K1k2 => k3 | tangential,
        Distortion::K1 => k3 | tangential | calib3d::CALIB_FIX_K2,
        Distortion::None => k3 | tangential | calib3d::CALIB_FIX_K2 | calib3d::CALIB_FIX_K1,
    };
    let kind = TermCriteria_Type::COUNT as i32 | TermCriteria_Type::EPS as i32;
    calib3d::calibrate_camera(
        &objects,
        &images,
        Size::new(width as i32, height as i32),
        &mut matrix,
        &mut coefficients,
        &mut turns,
        &mut shifts,
        flags,
        TermCriteria::new(kind, 200, 1e-12)?,
    )?;
    let at = |r: i32, c: i32| matrix.at_2d::<f64>(r, c).copied();
    let k = coefficients.data_typed::<f64>()?;
    let lens = Lens {
        width_px: width,
        height_px: height,
        fx_px: at(0, 0)?,
        fy_px: at(1, 1)?,
        cx_px: at(0, 2)?,
        cy_px: at(1, 2)?,
        distortion: std::array::from_fn(|i| k.get(i).copied().unwrap_or(0.0)),
    };
    let vector = |m: &Mat| -> opencv::Result<Vector3<f64>> {
        let d = m.data_typed::<f64>()?;
        Ok(Vector3::new(d[0], d[1], d[2]))
    };
    let poses = turns
        .iter()
        .zip(shifts.iter())
        .map(|(turn, shift)| {
            Ok(Pose { turn: Rotation3::new(vector(&turn)?), shift_mm: vector(&shift)? })
        })
        .collect::<opencv::Result<Vec<_>>>()?;
    Ok(LensFit { lens, poses })
}
