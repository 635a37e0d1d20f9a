//! Contours and the ellipses through them.

use nalgebra::Vector2;
use opencv::core::{Mat, Point, Point2f, Size, Vec3f, Vector};
use opencv::imgproc;

use super::{failed, mat};
use crate::cv::Ellipse;
use crate::error::Result;
use crate::frame::Gray;

/// Points of the shortest contour that is kept.
const SHORTEST: usize = 20;

/// Edge pixels in order along every contour of the picture: Canny's edges after a Gaussian blur, where the gradient reaches
/// `share` of Otsu's threshold.
pub fn contours(gray: &Gray<u8>, blur_px: f64, share: f64) -> Result<Vec<Vec<Vector2<f64>>>> {
    find(gray, blur_px, share).map_err(failed)
}

fn find(gray: &Gray<u8>, blur_px: f64, share: f64) -> opencv::Result<Vec<Vec<Vector2<f64>>>> {
    let image = mat(gray).map_err(|e| opencv::Error::new(0, e.to_string()))?;
    let (mut smooth, mut binary, mut edges) = (Mat::default(), Mat::default(), Mat::default());
    imgproc::gaussian_blur_def(&image, &mut smooth, Size::new(0, 0), blur_px)?;
    let otsu = imgproc::threshold(&smooth, &mut binary, 0.0, 255.0, imgproc::THRESH_OTSU)?;
    let high = (share * otsu).max(10.0);
    imgproc::canny(&smooth, &mut edges, 0.4 * high, high, 3, true)?;
    let mut list = Vector::<Vector<Point>>::new();
    let (mode, chain) = (imgproc::RETR_LIST, imgproc::CHAIN_APPROX_NONE);
    imgproc::find_contours_def(&edges, &mut list, mode, chain)?;
    Ok(list
        .iter()
        .filter(|c| c.len() >= SHORTEST)
        .map(|c| c.iter().map(|p| Vector2::new(f64::from(p.x), f64::from(p.y))).collect())
        .collect())
}

/// Circles of radii between two limits by `HoughCircles` (gradient method) after a Gaussian blur, strongest first: what
/// measurements are compared with, not what they rest on. `edge` is Canny's upper threshold.
pub fn hough_circles(
    gray: &Gray<u8>,
    blur_px: f64,
    edge: f64,
    radii: [f64; 2],
) -> Result<Vec<Ellipse>> {
    hough(gray, blur_px, edge, radii).map_err(failed)
}

fn hough(
    gray: &Gray<u8>,
    blur_px: f64,
    edge: f64,
    [least, most]: [f64; 2],
) -> opencv::Result<Vec<Ellipse>> {
    let image = mat(gray).map_err(|e| opencv::Error::new(0, e.to_string()))?;
    let (mut smooth, mut circles) = (Mat::default(), Vector::<Vec3f>::new());
    imgproc::gaussian_blur_def(&image, &mut smooth, Size::new(0, 0), blur_px)?;
    // The accumulator's threshold of OpenCV's own tutorial.
    let votes = 30.0;
    let (least_px, most_px) = (least as i32, most.ceil() as i32);
    imgproc::hough_circles(
        &smooth,
        &mut circles,
        imgproc::HOUGH_GRADIENT,
        1.0,
        least,
        edge,
        votes,
        least_px,
        most_px,
    )?;
    let ellipse = |c: Vec3f| Ellipse {
        center: Vector2::new(f64::from(c[0]), f64::from(c[1])),
        axes: [f64::from(c[2]); 2],
    };
    Ok(circles.iter().map(ellipse).collect())
}

/// Keeps OpenCV to one thread, for comparisons thread by thread.
pub fn one_thread() -> Result<()> {
    opencv::core::set_num_threads(1).map_err(failed)
}

/// The ellipse through points (approximate mean square; Taubin 1991); `None` where there is none.
pub fn fit_ellipse(points: &[Vector2<f64>]) -> Result<Option<Ellipse>> {
    if points.len() < 6 {
        return Ok(None);
    }
    // Single precision: the points' mean is taken off first.
    let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let list: Vector<Point2f> =
        points.iter().map(|p| Point2f::new((p.x - mean.x) as f32, (p.y - mean.y) as f32)).collect();
    let Ok(fit) = imgproc::fit_ellipse_ams(&list) else { return Ok(None) };
    let center = mean + Vector2::new(f64::from(fit.center.x), f64::from(fit.center.y));
    let axes = [f64::from(fit.size.width) / 2.0, f64::from(fit.size.height) / 2.0];
    let good = center.iter().chain(&axes).all(|v| v.is_finite()) && axes.iter().all(|a| *a > 0.0);
    Ok(good.then_some(Ellipse { center, axes }))
}
