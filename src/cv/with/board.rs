//! Points of calibration targets, by OpenCV's detectors.

use nalgebra::Vector2;
use opencv::core::ToInputArray;
use opencv::core::{Mat, Point2f, Ptr, Size, TermCriteria, TermCriteria_Type, Vector, no_array};
use opencv::{aruco, calib3d, features2d, imgproc, prelude::*};

use super::{failed, mat};
use crate::calib::target::{Kind, MARKER_SHARE, Target};
use crate::cv::Detection;
use crate::error::Result;
use crate::fit::robust::median;
use crate::frame::Gray;

/// Finds the target's points; `None` where the picture does not show it.
pub fn detect(gray: &Gray<u8>, target: &Target) -> Result<Option<Detection>> {
    let image = mat(gray)?;
    let (across, down) = target.grid();
    let size = Size::new(across as i32, down as i32);
    let found = match target.kind {
        Kind::Charuco => return charuco(&image, target).map_err(failed),
        Kind::Chessboard => chessboard(&image, size),
        Kind::Dots => return dots(&image, size).map_err(failed),
    };
    Ok(found.map_err(failed)?.map(|pixels| Detection { ids: (0..pixels.len()).collect(), pixels }))
}

type Found<T> = opencv::Result<Option<T>>;

/// Longer side of a picture that is looked over quickly.
const SMALL_PX: f64 = 640.0;

/// The sector-based detector (Duda and Frese 2018) first, the classic one with sub-pixel corners where it fails.
fn chessboard(image: &(impl ToInputArray + MatTraitConst), size: Size) -> Found<Vec<Vector2<f64>>> {
    let mut corners = Vector::<Point2f>::new();
    let flags = calib3d::CALIB_CB_EXHAUSTIVE | calib3d::CALIB_CB_ACCURACY;
    if calib3d::find_chessboard_corners_sb(image, size, &mut corners, flags)? {
        return Ok(Some(plain(&corners)));
    }
    // It takes many seconds at full size where there is no such board, and finds it in a small picture, too.
    let small = (SMALL_PX / f64::from(image.cols().max(image.rows()))).min(1.0);
    let mut reduced = Mat::default();
    imgproc::resize(image, &mut reduced, Size::new(0, 0), small, small, imgproc::INTER_AREA)?;
    let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH
        | calib3d::CALIB_CB_NORMALIZE_IMAGE
        | calib3d::CALIB_CB_FAST_CHECK;
    if !calib3d::find_chessboard_corners(&reduced, size, &mut corners, flags)? {
        return Ok(None);
    }
    let full = |p: f32| ((f64::from(p) + 0.5) / small - 0.5) as f32;
    let mut corners: Vector<Point2f> =
        corners.iter().map(|c| Point2f::new(full(c.x), full(c.y))).collect();
    let step =
        plain(&corners).windows(2).map(|w| (w[1] - w[0]).norm()).fold(f64::INFINITY, f64::min);
    refine(image, &mut corners, step)?;
    Ok(Some(plain(&corners)))
}

/// Sub-pixel corners in windows that stay clear of the neighbours.
fn refine(
    image: &impl ToInputArray,
    corners: &mut Vector<Point2f>,
    step_px: f64,
) -> opencv::Result<()> {
    let half = (0.35 * step_px).clamp(2.0, 11.0) as i32;
    let kind = TermCriteria_Type::COUNT as i32 | TermCriteria_Type::EPS as i32;
    let until = TermCriteria::new(kind, 50, 1e-3)?;
    imgproc::corner_sub_pix(image, corners, Size::new(half, half), Size::new(-1, -1), until)
}

fn dots(image: &impl ToInputArray, size: Size) -> Found<Detection> {
    let mut params = features2d::SimpleBlobDetector_Params::default()?;
    // Dots of any size that the frame can hold.
    params.min_area = 20.0;
    params.max_area = 1e6;
    let detector = features2d::SimpleBlobDetector::create(params)?;
    let detector: Ptr<features2d::Feature2D> = detector.into();
    for flags in [
        calib3d::CALIB_CB_SYMMETRIC_GRID,
        calib3d::CALIB_CB_SYMMETRIC_GRID | calib3d::CALIB_CB_CLUSTERING,
    ] {
        let mut centers = Vector::<Point2f>::new();
        if calib3d::find_circles_grid(image, size, &mut centers, flags, Some(&detector))? {
            let found = on_a_plane(&centers, size)?;
            if 5 * found.ids.len() >= 4 * centers.len() {
                return Ok(Some(found));
            }
        }
    }
    Ok(None)
}

/// Those of a grid's points that lie where a flat grid has them: OpenCV takes a neighbour for a dot that it missed.
fn on_a_plane(centers: &Vector<Point2f>, size: Size) -> opencv::Result<Detection> {
    let place = |i: i32| Point2f::new((i % size.width) as f32, (i / size.width) as f32);
    let grid: Vector<Point2f> = (0..size.area()).map(place).collect();
    let places = plain(centers);
    let mut steps: Vec<f64> = places.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
    // Distortion bends a grid by less, a neighbour is a whole step away.
    let near = 0.3 * median(&mut steps);
    let mut mask = Mat::default();
    calib3d::find_homography(&grid, centers, &mut mask, calib3d::RANSAC, near)?;
    let kept = mask.data_bytes()?;
    let ids: Vec<usize> = (0..places.len()).filter(|&i| kept.get(i) == Some(&1)).collect();
    Ok(Detection { pixels: ids.iter().map(|&i| places[i]).collect(), ids })
}

fn charuco(image: &(impl ToInputArray + MatTraitConst), target: &Target) -> Found<Detection> {
    let dictionary =
        aruco::get_predefined_dictionary(aruco::PREDEFINED_DICTIONARY_NAME::DICT_4X4_100)?;
    let board = aruco::CharucoBoard::create(
        target.columns as i32,
        target.rows as i32,
        target.pitch_mm as f32,
        (target.pitch_mm * MARKER_SHARE) as f32,
        &dictionary,
    )?;
    let mut corners = Vector::<Vector<Point2f>>::new();
    let mut ids = Vector::<i32>::new();
    let parameters = aruco::DetectorParameters::create()?;
    let mut rejected = no_array();
    aruco::detect_markers(image, &dictionary, &mut corners, &mut ids, &parameters, &mut rejected)?;
    if ids.len() < 2 {
        return Ok(None);
    }
    let (mut points, mut point_ids) = (Mat::default(), Mat::default());
    let count = aruco::interpolate_corners_charuco_def(
        &corners,
        &ids,
        image,
        &board,
        &mut points,
        &mut point_ids,
    )?;
    if count < 4 {
        return Ok(None);
    }
    let mut points = Vector::<Point2f>::from_iter(points.data_typed::<Point2f>()?.iter().copied());
    let side =
        |c: &Vector<Point2f>| plain(c).windows(2).map(|w| (w[1] - w[0]).norm()).sum::<f64>() / 3.0;
    let smallest = corners.iter().map(|c| side(&c)).fold(f64::INFINITY, f64::min);
    // A window reaches at most to the next marker's corner.
    refine(image, &mut points, 0.5 * smallest)?;
    // Counted as Target::points_mm counts (OpenCV before 4.6 began at the bottom row).
    let ids = point_ids.data_typed::<i32>()?.iter().map(|&id| id as usize).collect();
    Ok(Some(Detection { ids, pixels: plain(&points) }))
}

fn plain(points: &Vector<Point2f>) -> Vec<Vector2<f64>> {
    points.iter().map(|p| Vector2::new(f64::from(p.x), f64::from(p.y))).collect()
}
