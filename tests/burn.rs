//! Which circles `burn` takes for ring and spot, and what it refuses to take for them.

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::Result;
use pivotsight::measure::burn::{self, Measured, Options};

mod painter;
use painter::picture;

const PLATE: f64 = 170.0;
const BURNT: f64 = 60.0;

/// A burnt annulus about the picture's middle with a spot beside its centre, radii in pixels of 0.02 mm; no spot where its radius is 0.
fn burn(outer_px: f64, inner_px: f64, spot_px: f64, offset_px: Vector2<f64>) -> Result<Measured> {
    let center = Vector2::new(318.3, 241.6);
    let seen = picture(|p| {
        let r = (p - center).norm();
        let spot = (p - center - offset_px).norm() < spot_px;
        if spot || (inner_px..outer_px).contains(&r) { BURNT } else { PLATE }
    });
    let mapping = Mapping::Scale { mm_per_px: 0.02, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    burn::measure(&seen, &calibration, &Options::default(), "painted")
}

fn off_mm(found: &Measured, offset_px: Vector2<f64>) -> f64 {
    let [dx, dy] = found.report.offset.offset_mm;
    // Y of the plane points up.
    (Vector2::new(dx, -dy) - 0.02 * offset_px).norm()
}

/// Circles that touch ring and spot in turn are as many as one likes: they are no marks beside which the spot has no surface left.
#[test]
fn a_clear_spot_in_a_fine_ring_is_measured() {
    for (outer_px, inner_px, spot_px) in
        [(154.6, 128.8, 40.45), (152.9, 125.7, 23.4), (140.0, 112.0, 33.0), (168.0, 138.0, 41.0)]
    {
        for offset_px in [Vector2::new(0.4, -0.3), Vector2::new(-2.1, 0.7), Vector2::new(3.3, 2.2)]
        {
            let found = burn(outer_px, inner_px, spot_px, offset_px).unwrap();
            let off_mm = off_mm(&found, offset_px);
            assert!(off_mm < 0.0005, "{outer_px} {inner_px} {spot_px}: off by {off_mm}");
        }
    }
}

#[test]
fn the_inner_edge_of_a_wide_annulus_is_no_spot() {
    for part in [0.34, 0.4, 0.45] {
        let offset_px = Vector2::new(2.3, -1.4);
        let found = burn(150.0, part * 150.0, 18.0, offset_px).unwrap();
        let off_mm = off_mm(&found, offset_px);
        assert!(off_mm < 0.0005, "{part}: off by {off_mm}");
        let error = burn(150.0, part * 150.0, 0.0, offset_px).map(|m| m.report.spot.diameter_mm);
        assert!(error.is_err(), "{part}: {error:?}");
    }
}
