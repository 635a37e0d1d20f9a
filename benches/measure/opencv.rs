//! What OpenCV makes of a burn, helped by the truth where its ways find too many circles.

use nalgebra::Vector2;
use pivotsight::camera::View;
use pivotsight::cv;
use pivotsight::fit::Circle;
use pivotsight::frame::{Channel, Gray, Picture};

use crate::work::Burn;

/// Blur before edges are looked for, less than the edges' own.
const BLUR_PX: f64 = 4.0;
/// Canny's upper threshold as a part of Otsu's, and in counts: soft edges are not steep.
const SHARE: f64 = 0.15;
const EDGE: f64 = 20.0;

/// Error of the offset by Canny's edges, contours, and an ellipse through those near each circle: soft edges make no
/// whole contours, so it is told where to look, to 10 %.
pub fn contours(burn: &Burn, picture: &Picture) -> Option<f64> {
    let (gray, view) = frame(burn, picture)?;
    let contours = cv::contours(&gray, BLUR_PX, SHARE).ok()?;
    error(burn, &view, |place, radius| {
        let near = |p: &Vector2<f64>| ((p - place).norm() / radius - 1.0).abs() < 0.1;
        let points: Vec<Vector2<f64>> = contours.iter().flatten().copied().filter(near).collect();
        cv::fit_ellipse(&points).ok()?.map(|e| e.center)
    })
}

/// Error of the offset by Hough's transform, told each radius to 10 %.
pub fn hough(burn: &Burn, picture: &Picture) -> Option<f64> {
    let (gray, view) = frame(burn, picture)?;
    error(burn, &view, |_, radius| {
        let found = cv::hough_circles(&gray, BLUR_PX, EDGE, [0.9 * radius, 1.1 * radius]).ok()?;
        found.first().map(|e| e.center)
    })
}

fn frame(burn: &Burn, picture: &Picture) -> Option<(Gray<u8>, View)> {
    let gray = picture.frame(Channel::Luminance).to_eight();
    let view = burn.calibration.view(gray.width, gray.height).ok()?;
    Some((gray, view))
}

fn error(
    burn: &Burn,
    view: &View,
    find: impl Fn(Vector2<f64>, f64) -> Option<Vector2<f64>>,
) -> Option<f64> {
    let center = |c: &Circle| {
        let place = view.to_pixel(c.center);
        find(place, c.radius / view.pixel_mm()).map(|p| view.to_plane(p))
    };
    let [ring, spot] = &burn.circles;
    Some((center(spot)? - center(ring)? - burn.offset_mm).norm())
}
