//! Captures all round a rod that turns beside the C axis, painted.

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping, View};
use pivotsight::frame::Frame;
use pivotsight::measure::rod::{Capture, Options};

use crate::painter;

/// Where the axis of an eccentric rod is.
pub const AXIS_MM: [f64; 2] = [100.013, 49.992];

/// Captures all round a rod 0.05 mm beside the axis at three table angles; `level` is told how far from the rod's centre a pixel is and
/// where in the picture.
pub fn eccentric(
    mm_per_px: f64,
    radius_px: f64,
    level: impl Fn(Vector2<f64>, Vector2<f64>) -> f64,
) -> (Vec<Capture>, Vec<(Frame, View)>) {
    let ways = (0..12).map(|k| (120.0 * f64::from(k % 3), 17.0 + 30.0 * f64::from(k)));
    turning(&ways.collect::<Vec<_>>(), mm_per_px, radius_px, level)
}

/// The same with a capture for each table angle and way to look, both in degrees.
pub fn turning(
    ways: &[(f64, f64)],
    mm_per_px: f64,
    radius_px: f64,
    level: impl Fn(Vector2<f64>, Vector2<f64>) -> f64,
) -> (Vec<Capture>, Vec<(Frame, View)>) {
    turning_off(0.05, ways, mm_per_px, radius_px, level)
}

/// The same of a rod so far off the axis, mm.
pub fn turning_off(
    off_mm: f64,
    ways: &[(f64, f64)],
    mm_per_px: f64,
    radius_px: f64,
    level: impl Fn(Vector2<f64>, Vector2<f64>) -> f64,
) -> (Vec<Capture>, Vec<(Frame, View)>) {
    let mapping = Mapping::Scale { mm_per_px, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let captures = ways.iter().enumerate().map(|(k, &(c_deg, way_deg))| {
        let turned = |deg: f64| Vector2::new(deg.to_radians().cos(), deg.to_radians().sin());
        let center_mm = Vector2::from(AXIS_MM) + off_mm * turned(c_deg);
        let at_mm = Vector2::new(100.0, 50.0) + radius_px * mm_per_px * turned(way_deg);
        let seen = painter::picture(|p| {
            let plane_mm = mm_per_px * Vector2::new(p.x - 319.5, 239.5 - p.y);
            level((plane_mm + at_mm - center_mm) / mm_per_px, p)
        });
        let frame = seen.into_frame(Options::default().channel);
        let view = calibration.view(640, 480).unwrap();
        (Capture::in_memory(format!("capture {k}"), at_mm, c_deg), (frame, view))
    });
    captures.unzip()
}
