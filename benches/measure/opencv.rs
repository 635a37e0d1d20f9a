//! What OpenCV makes of a burn, helped by the truth where its ways find too many circles.

use nalgebra::Vector2;
use pivotsight::camera::View;
use pivotsight::cv::{self, Ellipse};
use pivotsight::fit::Circle;
use pivotsight::frame::{Channel, Gray, Picture};

use crate::work::Burn;

/// Blur before edges are looked for: about that of the optics.
const BLUR_PX: f64 = 3.0;

/// Error of the offset by Canny's edges, contours, and the ellipse through each circle's longest one.
pub fn contours(burn: &Burn, picture: &Picture) -> Option<f64> {
    let (gray, view) = frame(burn, picture)?;
    let contours = cv::contours(&gray, BLUR_PX, 0.5).ok()?;
    let ellipses: Vec<(usize, Ellipse)> =
        contours.iter().filter_map(|c| Some((c.len(), cv::fit_ellipse(c).ok()??))).collect();
    error(burn, &view, |place, radius| {
        let near = ellipses.iter().filter(|(n, e)| {
            *n as f64 > 3.0 * radius
                && (e.center - place).norm() < 0.2 * radius
                && (e.radius() / radius - 1.0).abs() < 0.1
        });
        near.max_by_key(|(n, _)| *n).map(|(_, e)| e.center)
    })
}

/// Error of the offset by Hough's transform, told each radius to 10 %.
pub fn hough(burn: &Burn, picture: &Picture) -> Option<f64> {
    let (gray, view) = frame(burn, picture)?;
    error(burn, &view, |_, radius| {
        let found = cv::hough_circles(&gray, BLUR_PX, [0.9 * radius, 1.1 * radius]).ok()?;
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
