//! The light that all captures are seen in. It does not turn with the table: where its slope moves one arc it moves all, along the
//! light, and the axis with them, however many table angles there are.
//!
//! An arc bends too little to show how light goes on across it, and what lies beside it may look like light: a chamfer lit from one side. Arcs all
//! round, seen in the same light, tell its slope both ways, and what its slope is must show inside the rim as well as outside.

use nalgebra::{Matrix2, Vector2};

use super::joint::Arc;
use crate::camera::View;
use crate::edge::Slope;

/// Light hardly changes by more than this part of itself across a picture (standard deviation).
const ACROSS: f64 = 0.3;
/// A slope g that is not divided out moves an edge of softness σ by about this times g σ²: what a blurred step with even levels, fitted to
/// eight softnesses either side, makes of it.
const REACTS: f64 = 8.0;

/// Lenses and lamps leave the corners darker than the middle by about this part (standard deviation).
const CORNERS: f64 = 0.1;

/// The slope of the light in all captures.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    seen: Slope,
}

/// How far the light moves all centres.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shift {
    /// To be added to each centre.
    pub mm: Vector2<f64>,
    /// Covariance of that, mm²: the same error in all centres.
    pub covariance: Matrix2<f64>,
}

/// Light that fades towards the corners slopes one way at one end of an arc and the other way at the other: all arcs look more bent, or less.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bow {
    middle_mm: Vector2<f64>,
    /// Slope (standard deviation) over the distance from the middle, 1/px².
    per_px2: f64,
}

impl Bow {
    /// Of a camera.
    pub fn of(view: &View) -> Self {
        let corner = Vector2::new(view.width_px() as f64, view.height_px() as f64) * 0.5;
        let middle_mm = view.to_plane(corner - Vector2::repeat(0.5));
        Self { middle_mm, per_px2: 2.0 * CORNERS / corner.norm_squared() }
    }

    /// How far from the frame's middle an edge lies, outwards of it.
    pub fn outwards_mm(&self, place_mm: Vector2<f64>, out: Vector2<f64>) -> f64 {
        (place_mm - self.middle_mm).dot(&out)
    }

    /// How far it moves an edge of some softness outwards, mm (standard deviation; the same light in all captures).
    pub fn moves_mm(&self, place_mm: Vector2<f64>, out: Vector2<f64>, softness_px: f64) -> f64 {
        REACTS * softness_px * softness_px * self.per_px2 * self.outwards_mm(place_mm, out)
    }
}

impl Light {
    /// The slope that the arcs have in common. `None` where none of them tells one.
    pub fn of(arcs: &[Arc], view: &View) -> Option<Self> {
        let [inside, outside] =
            [0, 1].map(|side| mean(arcs.iter().filter_map(|a| a.points.light[side])));
        let mut seen = mean([inside, outside].into_iter().flatten())?;
        if let (Some(inside), Some(outside)) = (inside, outside) {
            let apart = inside.per_px - outside.per_px;
            let covariance = inside.covariance + outside.covariance;
            if (Slope { per_px: apart, covariance }).is_sure() {
                // One side has more than the light's slope. Where the other has none the light has none either.
                let steeper = inside.per_px.norm() > outside.per_px.norm();
                let flatter = if steeper { outside } else { inside };
                if flatter.is_sure() {
                    seen.covariance += 0.25 * apart * apart.transpose();
                } else {
                    seen = flatter;
                }
            }
        }
        let expected = Slope {
            per_px: Vector2::zeros(),
            covariance: Matrix2::identity() * (ACROSS / view.width_px() as f64).powi(2),
        };
        weighted([seen, expected].into_iter()).map(|(seen, _)| Self { seen })
    }

    /// The slope to divide out: none that is not sure.
    pub fn divided_per_px(&self) -> Vector2<f64> {
        if self.seen.is_sure() { self.seen.per_px } else { Vector2::zeros() }
    }

    /// What the light does to the arcs' centres all the same.
    pub fn shift(&self, arcs: &[Arc], view: &View) -> Shift {
        let variance_px2 = arcs.iter().map(|a| a.points.located.step.softness_px.powi(2));
        let variance_px2 = variance_px2.sum::<f64>() / arcs.len().max(1) as f64;
        let divided = self.divided_per_px();
        let left = self.seen.per_px - divided;
        let unknown = (self.seen.covariance + left * left.transpose()) * REACTS.powi(2);
        // Light that slopes on the rod is blurred with it, which moves the edge by σ² times its slope; what the lens makes slope is not. Either
        // may be: midway, evenly spread.
        let blurred = divided * divided.transpose() / 12.0;
        let middle =
            0.5 * Vector2::new(view.width_px() as f64 - 1.0, view.height_px() as f64 - 1.0);
        let mm_per_px = view.mm_per_px(middle);
        Shift {
            mm: mm_per_px * divided * (0.5 * variance_px2),
            covariance: mm_per_px
                * (unknown + blurred)
                * mm_per_px.transpose()
                * variance_px2.powi(2),
        }
    }
}

/// The mean of several slopes by what is known of each, as unsure as they scatter.
fn mean(slopes: impl Iterator<Item = Slope> + Clone) -> Option<Slope> {
    let (mut mean, count) = weighted(slopes.clone())?;
    let misses = slopes.filter_map(|s| {
        let off = s.per_px - mean.per_px;
        Some(off.dot(&(s.covariance.try_inverse()? * off)))
    });
    let dof = 2.0 * (count as f64 - 1.0).max(1.0);
    mean.covariance *= (misses.sum::<f64>() / dof).max(1.0);
    Some(mean)
}

/// The mean by what is known of each, and how many there are.
fn weighted(slopes: impl Iterator<Item = Slope>) -> Option<(Slope, usize)> {
    let (mut information, mut sum, mut count) = (Matrix2::zeros(), Vector2::zeros(), 0);
    for slope in slopes {
        if let Some(known) = slope.covariance.try_inverse() {
            information += known;
            sum += known * slope.per_px;
            count += 1;
        }
    }
    let covariance = information.try_inverse().filter(|_| count > 0)?;
    Some((Slope { per_px: covariance * sum, covariance }, count))
}
