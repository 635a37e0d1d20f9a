//! What lies on and around the part: light, bare metal, dirt.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::draw::{Dice, Draw};
use super::mark::Dot;
use super::noise::{Grain, grain_seed};
use crate::error::Result;

/// `[light]`: how the scene is lit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Light {
    /// Relative change of brightness from one side of the frame to the other, in a direction of chance
    /// (default 0).
    pub shading: Draw,
    /// Relative loss of brightness in the frame's corners (default 0).
    pub vignetting: Draw,
    /// Number of glaring reflections on the metal (default 0).
    pub glare_count: Draw,
    /// Radiance that a reflection adds in its middle (default 0.5).
    pub glare: Draw,
    /// Size of a reflection, as a Gaussian's standard deviation (default 0.6).
    pub glare_mm: Draw,
}

impl Default for Light {
    fn default() -> Self {
        Self {
            shading: 0.0.into(),
            vignetting: 0.0.into(),
            glare_count: 0.0.into(),
            glare: 0.5.into(),
            glare_mm: 0.6.into(),
        }
    }
}

/// Brightness over the frame.
#[derive(Debug, Clone)]
pub struct Shade {
    slope: Vector2<f64>,
    middle: Vector2<f64>,
    loss: f64,
    corner2: f64,
}

impl Shade {
    /// The factor at a pixel.
    pub fn at(&self, u: usize, v: usize) -> f64 {
        let d = Vector2::new(u as f64, v as f64) - self.middle;
        1.0 + self.slope.dot(&d) - self.loss * d.norm_squared() / self.corner2
    }
}

/// Soft bright reflections.
#[derive(Debug, Clone)]
pub struct Glare {
    spots: Vec<(Vector2<f64>, f64, f64)>,
}

impl Glare {
    /// Radiance added at a point.
    pub fn at(&self, point_mm: Vector2<f64>) -> f64 {
        self.spots
            .iter()
            .map(|(middle, radiance, inverse_square)| {
                radiance * (-0.5 * (point_mm - middle).norm_squared() * inverse_square).exp()
            })
            .sum()
    }
}

impl Light {
    /// Draws the fall-off over a frame of this size.
    pub(super) fn shade(&self, dice: &mut Dice, width_px: u32, height_px: u32) -> Result<Shade> {
        let shading = dice.roll("light.shading", &self.shading, 0.0..=1.5)?;
        let loss = dice.roll("light.vignetting", &self.vignetting, 0.0..=0.9)?;
        let middle = Vector2::new(f64::from(width_px) - 1.0, f64::from(height_px) - 1.0) / 2.0;
        let slope = dice.heading() * shading / f64::from(width_px);
        Ok(Shade { slope, middle, loss, corner2: middle.norm_squared() })
    }

    /// Draws reflections within half the frame (half its size is `half_mm`) of a place.
    pub(super) fn glare(
        &self,
        dice: &mut Dice,
        around: Vector2<f64>,
        half_mm: f64,
    ) -> Result<Glare> {
        let count = dice.roll("light.glare_count", &self.glare_count, 0.0..=100.0)?.round();
        let mut spots = Vec::new();
        for _ in 0..count as usize {
            let radiance = dice.roll("light.glare", &self.glare, 0.0..=100.0)?;
            let size = dice.roll("light.glare_mm", &self.glare_mm, 1e-3..=100.0)?;
            let d = Vector2::new(dice.between(-1.0, 1.0), dice.between(-1.0, 1.0)) * half_mm;
            spots.push((around + d, radiance, 1.0 / (size * size)));
        }
        Ok(Glare { spots })
    }
}

/// `[surface]`: bare metal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Surface {
    /// Radiance, white being 1 (default 0.65).
    pub level: Draw,
    /// Relative standard deviation of its brushed texture (default 0).
    pub texture: Draw,
    /// Length of the brush lines (default 1.5).
    pub along_mm: Draw,
    /// Width of the brush lines (default 0.015).
    pub across_mm: Draw,
    /// Direction of the brush lines (default any).
    pub direction_deg: Draw,
}

impl Default for Surface {
    fn default() -> Self {
        Self {
            level: 0.65.into(),
            texture: 0.0.into(),
            along_mm: 1.5.into(),
            across_mm: 0.015.into(),
            direction_deg: [0.0, 180.0].into(),
        }
    }
}

/// Brushed metal with its numbers drawn: fine lines and broader bands.
#[derive(Debug, Clone)]
pub struct Metal {
    /// Mean radiance.
    pub level: f64,
    texture: f64,
    fine: Grain,
    broad: Grain,
}

impl Surface {
    /// Draws the metal.
    pub(super) fn metal(&self, dice: &mut Dice) -> Result<Metal> {
        let level = dice.roll("surface.level", &self.level, 0.0..=2.0)?;
        let texture = dice.roll("surface.texture", &self.texture, 0.0..=1.0)?;
        let along = dice.roll("surface.along_mm", &self.along_mm, 1e-3..=1e3)?;
        let across = dice.roll("surface.across_mm", &self.across_mm, 1e-3..=1e3)?;
        let direction =
            dice.roll("surface.direction_deg", &self.direction_deg, -360.0..=360.0)?.to_radians();
        Ok(Metal {
            level,
            texture,
            fine: Grain::new(grain_seed(&mut dice.rng), along, across, direction),
            broad: Grain::new(grain_seed(&mut dice.rng), 2.0 * along, 6.0 * across, direction),
        })
    }
}

impl Metal {
    /// The texture's factor at a point.
    pub fn texture(&self, p: Vector2<f64>) -> f64 {
        if self.texture == 0.0 {
            return 1.0;
        }
        (1.0 + self.texture * (0.8 * self.fine.at(p.x, p.y) + 0.6 * self.broad.at(p.x, p.y)))
            .max(0.05)
    }

    /// The same lines, turned on a lathe: they run around the origin.
    pub fn turned(&self, r_mm: f64, angle: f64) -> f64 {
        if self.texture == 0.0 {
            return 1.0;
        }
        let s = angle * r_mm;
        (1.0 + self.texture
            * (0.8 * self.fine.along_across(s, r_mm) + 0.6 * self.broad.along_across(s, r_mm)))
        .max(0.05)
    }
}

/// `[dirt]` or `[spatter]`: specks strewn about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Specks {
    /// How many (default 0).
    pub count: Draw,
    /// Radius of a speck (default 0.01 to 0.06).
    pub radius_mm: Draw,
    /// Radiance of a speck (default 0.05 or 0.95).
    pub level: Draw,
}

impl Default for Specks {
    fn default() -> Self {
        Self {
            count: 0.0.into(),
            radius_mm: [0.01, 0.06].into(),
            level: Draw::Any { any: vec![0.05, 0.05, 0.95] },
        }
    }
}

impl Specks {
    /// Strews specks at places that `place` gives.
    pub(super) fn strew(
        &self,
        dice: &mut Dice,
        table: &str,
        mut place: impl FnMut(&mut Dice) -> Vector2<f64>,
    ) -> Result<Vec<Dot>> {
        let count = dice.roll(&format!("{table}.count"), &self.count, 0.0..=10_000.0)?.round();
        let mut dots = Vec::new();
        for _ in 0..count as usize {
            let radius_mm =
                dice.roll(&format!("{table}.radius_mm"), &self.radius_mm, 1e-4..=10.0)?;
            let level = dice.roll(&format!("{table}.level"), &self.level, 0.0..=5.0)?;
            let direction = dice.heading();
            let slimness = dice.between(0.4, 1.0);
            let center_mm = place(dice);
            dots.push(Dot { center_mm, radius_mm, slimness, direction, level });
        }
        Ok(dots)
    }
}
