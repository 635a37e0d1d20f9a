//! Where the captures of a rod's rim are taken.

use nalgebra::Vector2;
use serde::Deserialize;

use super::draw::{Dice, Draw};
use crate::error::Result;

/// `[captures]`: the pictures taken of one rod.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Captures {
    /// C angles at which the rim is photographed (default just 0).
    pub c_deg: Vec<f64>,
    /// Pictures at each of them (default 6).
    pub per_angle: Draw,
    /// Part of the rim over which they are spread (default 360).
    pub span_deg: Draw,
    /// How far from the rim the frame's middle may stray (default 0.3).
    pub stray_mm: Draw,
    /// Standard deviation of the machine's true position about the one it shows (default 0).
    pub position_noise_mm: Draw,
}

impl Default for Captures {
    fn default() -> Self {
        Self {
            c_deg: vec![0.0],
            per_angle: 6.0.into(),
            span_deg: 360.0.into(),
            stray_mm: 0.3.into(),
            position_noise_mm: 0.0.into(),
        }
    }
}

/// One planned capture.
pub(super) struct Shot {
    /// C angle.
    pub c_deg: f64,
    /// What the control shows.
    pub shown: Vector2<f64>,
    /// Where the camera axis really is.
    pub camera: Vector2<f64>,
}

/// Spreads the captures along the rim, anew at each C angle.
pub(super) fn plan(
    wish: &Captures,
    axis: Vector2<f64>,
    radius_mm: f64,
    dice: &mut Dice,
) -> Result<Vec<Shot>> {
    if wish.c_deg.is_empty() || !wish.c_deg.iter().all(|c| c.is_finite()) {
        return Err(dice.fault(
            "captures.c_deg",
            "has no finite angle",
            "give at least one, as [0.0]",
        ));
    }
    let count = dice.roll("captures.per_angle", &wish.per_angle, 1.0..=1000.0)?.round();
    let span = dice.roll("captures.span_deg", &wish.span_deg, 0.0..=360.0)?.to_radians();
    let stray = dice.roll("captures.stray_mm", &wish.stray_mm, 0.0..=100.0)?;
    let noise = dice.roll("captures.position_noise_mm", &wish.position_noise_mm, 0.0..=1.0)?;
    let mut shots = Vec::new();
    for &c_deg in &wish.c_deg {
        let start = dice.direction();
        for i in 0..count as usize {
            let angle = start + span * (i as f64 + dice.between(-0.15, 0.15)) / count;
            let (sin, cos) = angle.sin_cos();
            let stray = Vector2::new(dice.between(-stray, stray), dice.between(-stray, stray));
            let wanted = axis + Vector2::new(cos, sin) * radius_mm + stray;
            let shown = wanted.map(|x| (x * 1000.0).round() / 1000.0);
            let camera = shown + Vector2::new(dice.normal(), dice.normal()) * noise;
            shots.push(Shot { c_deg, shown, camera });
        }
    }
    Ok(shots)
}
