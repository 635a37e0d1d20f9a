//! A burn painted on a plain plate, and what `burn` makes of such pictures.

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::Result;
use pivotsight::frame::Picture;
use pivotsight::measure::burn::{self, Measured, Options};

use super::picture;

pub const PLATE: f64 = 170.0;
pub const BURNT: f64 = 60.0;

/// A burnt annulus about the picture's middle with a spot beside its centre, radii in pixels of 0.02 mm; no spot where its radius is 0.
pub fn burn(
    outer_px: f64,
    inner_px: f64,
    spot_px: f64,
    offset_px: Vector2<f64>,
) -> Result<Measured> {
    let center = Vector2::new(318.3, 241.6);
    let seen = picture(|p| {
        let r = (p - center).norm();
        let spot = (p - center - offset_px).norm() < spot_px;
        if spot || (inner_px..outer_px).contains(&r) { BURNT } else { PLATE }
    });
    measure(&seen)
}

pub fn measure(seen: &Picture) -> Result<Measured> {
    let mapping = Mapping::Scale { mm_per_px: 0.02, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    burn::measure(seen, &calibration, &Options::default(), "painted")
}

pub fn off_mm(found: &Measured, offset_px: Vector2<f64>) -> f64 {
    let [dx, dy] = found.report.offset.offset_mm;
    // Y of the plane points up.
    (Vector2::new(dx, -dy) - 0.02 * offset_px).norm()
}
