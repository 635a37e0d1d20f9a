//! The burning head's beam: where its marks lie when B's zero and the flange are off.

use nalgebra::{Rotation3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::draw::Draw;

/// `[machine]`: what the burning head does wrong.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Machine {
    /// True B angle when the control says zero (default 0).
    pub b_error_deg: Draw,
    /// Turn of the cutting head about +X at its flange, right-handed (default 0).
    pub flange_tilt_deg: Draw,
    /// Nozzle height for the ring (default 50).
    pub ring_height_mm: Draw,
    /// Nozzle height for the spot (default 3).
    pub spot_height_mm: Draw,
}

impl Default for Machine {
    fn default() -> Self {
        Self {
            b_error_deg: 0.0.into(),
            flange_tilt_deg: 0.0.into(),
            ring_height_mm: 50.0.into(),
            spot_height_mm: 3.0.into(),
        }
    }
}

/// The beam of a head whose B axis and flange are off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Beam {
    /// True B angle when the control says zero.
    pub b_error_deg: f64,
    /// Turn of the cutting head about +X at its flange, right-handed.
    pub flange_tilt_deg: f64,
}

impl Beam {
    /// Where the beam meets the work, seen from below the nozzle, with the nozzle `height_mm` above it.
    ///
    /// The beam points along `Ry(B error) · Rx(flange tilt) · (0, 0, -1)` (frames and `Ry` as in
    /// `docs/conventions.md`): a positive B error sends it to -X, a positive flange tilt to +Y.
    pub fn mark_mm(&self, height_mm: f64) -> Vector2<f64> {
        let about_y = Rotation3::from_axis_angle(&Vector3::y_axis(), self.b_error_deg.to_radians());
        let about_x =
            Rotation3::from_axis_angle(&Vector3::x_axis(), self.flange_tilt_deg.to_radians());
        let beam = about_y * about_x * -Vector3::z();
        Vector2::new(beam.x, beam.y) * (height_mm / -beam.z)
    }

    /// Spot minus ring, burnt from these heights.
    pub fn offset_mm(&self, ring_height_mm: f64, spot_height_mm: f64) -> Vector2<f64> {
        self.mark_mm(spot_height_mm) - self.mark_mm(ring_height_mm)
    }
}
