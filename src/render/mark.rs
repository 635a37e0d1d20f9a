//! Contours: circles with a ragged, soft edge, and round dots.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::noise::Around;

/// How an edge fades across its width.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// The integral of a Gaussian.
    #[default]
    Gaussian,
    /// A logistic function: longer tails.
    Logistic,
    /// A straight ramp.
    Ramp,
}

/// Values in a fade's table, over ±[`REACH`] softnesses.
const STEPS: usize = 2048;
/// Beyond this many 10-90 % widths on either side an edge is over.
const REACH: f64 = 1.8;

/// An edge's fade from 1 inside to 0 outside, half on the contour.
#[derive(Debug, Clone)]
pub struct Fade {
    softness_mm: f64,
    table: Vec<f32>,
}

impl Fade {
    /// A fade whose value falls from 90 % to 10 % over `softness_mm`.
    pub fn new(softness_mm: f64, profile: Profile) -> Self {
        let value = |t: f64| match profile {
            Profile::Gaussian => 1.0 - normal_cdf(t * 2.563_103),
            Profile::Logistic => 1.0 / (1.0 + (t * 4.394_449).exp()),
            Profile::Ramp => (0.5 - 0.8 * t).clamp(0.0, 1.0),
        };
        let (low, high) = (value(REACH), value(-REACH));
        let table = (0..=STEPS)
            .map(|i| REACH * (2.0 * i as f64 / STEPS as f64 - 1.0))
            .map(|t| ((value(t) - low) / (high - low)) as f32)
            .collect();
        Self { softness_mm, table }
    }

    /// Distance from the contour beyond which the fade is over, for samples of this size.
    pub fn reach_mm(&self, sample_mm: f64) -> f64 {
        (REACH * self.softness_mm).max(sample_mm)
    }

    /// How often a pixel must be sampled along a side.
    pub fn samples(&self, pixel_mm: f64) -> usize {
        match self.softness_mm / pixel_mm {
            s if s >= 4.0 => 1,
            s if s >= 2.0 => 2,
            _ => 4,
        }
    }

    /// The fade over a sample of this size at a distance outside (+) or inside (-) the contour.
    pub fn at(&self, distance_mm: f64, sample_mm: f64) -> f64 {
        if self.softness_mm < sample_mm {
            return (0.5 - distance_mm / sample_mm).clamp(0.0, 1.0);
        }
        let place = (distance_mm / (REACH * self.softness_mm) + 1.0) * (STEPS as f64 / 2.0);
        if place <= 0.0 {
            return 1.0;
        }
        let i = place as usize;
        if i >= STEPS {
            return 0.0;
        }
        let f = (place - i as f64) as f32;
        f64::from(self.table[i] * (1.0 - f) + self.table[i + 1] * f)
    }
}

/// The normal distribution's integral, by Simpson's rule; only used to fill a table.
fn normal_cdf(x: f64) -> f64 {
    let steps = 200;
    let h = x / f64::from(steps);
    let density = |t: f64| (-0.5 * t * t).exp();
    let sum: f64 = (0..=steps)
        .map(|i| {
            let weight = if i == 0 || i == steps { 1.0 } else { 2.0 + 2.0 * f64::from(i % 2) };
            weight * density(f64::from(i) * h)
        })
        .sum();
    0.5 + sum * h / 3.0 / std::f64::consts::TAU.sqrt()
}

/// A nominally round contour.
#[derive(Debug, Clone)]
pub struct Contour {
    /// Nominal radius.
    pub radius_mm: f64,
    /// Deviation of the contour from its nominal circle, outwards.
    pub form_mm: Around,
    /// How the edge fades.
    pub fade: Fade,
}

impl Contour {
    /// How much of a sample at polar place (`r_mm`, `angle`) lies inside.
    pub fn inside(&self, r_mm: f64, angle: impl FnOnce() -> f64, sample_mm: f64) -> f64 {
        let reach = self.fade.reach_mm(sample_mm) + self.form_mm.largest();
        if r_mm <= self.radius_mm - reach {
            return 1.0;
        }
        if r_mm >= self.radius_mm + reach {
            return 0.0;
        }
        self.fade.at(r_mm - self.radius_mm - self.form_mm.at(angle()), sample_mm)
    }

    /// Samples a pixel needs where a disc of `radius_mm` around a point at `r_mm` from the contour's
    /// centre is drawn.
    pub fn samples(&self, r_mm: f64, radius_mm: f64, pixel_mm: f64) -> usize {
        let reach = self.fade.reach_mm(pixel_mm) + self.form_mm.largest() + radius_mm;
        if (r_mm - self.radius_mm).abs() > reach { 1 } else { self.fade.samples(pixel_mm) }
    }
}

/// A round or oval speck.
#[derive(Debug, Clone, Copy)]
pub struct Dot {
    /// Its middle.
    pub center_mm: Vector2<f64>,
    /// Half its greater length.
    pub radius_mm: f64,
    /// Smaller over greater length.
    pub slimness: f64,
    /// Direction of its greater length.
    pub direction: Vector2<f64>,
    /// Its radiance.
    pub level: f64,
}

impl Dot {
    /// Whether any of it lies in the disc.
    pub fn touches(&self, middle_mm: Vector2<f64>, radius_mm: f64) -> bool {
        (self.center_mm - middle_mm).norm() < 1.2 * self.radius_mm + radius_mm
    }

    /// How much of a point it covers; its rim is a little soft.
    pub fn cover(&self, point_mm: Vector2<f64>) -> f64 {
        let d = point_mm - self.center_mm;
        let along = d.dot(&self.direction);
        let across = (d.y * self.direction.x - d.x * self.direction.y) / self.slimness;
        let r = (along * along + across * across).sqrt() / self.radius_mm;
        (5.0 * (1.1 - r)).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fades_are_half_on_the_contour_and_keep_their_width() {
        for profile in [Profile::Gaussian, Profile::Logistic, Profile::Ramp] {
            let fade = Fade::new(0.1, profile);
            assert!((fade.at(0.0, 0.002) - 0.5).abs() < 1e-4);
            assert!((fade.at(0.05, 0.002) - 0.1).abs() < 2e-3, "{profile:?}");
            assert!((fade.at(-0.05, 0.002) - 0.9).abs() < 2e-3, "{profile:?}");
        }
        let sharp = Fade::new(0.0, Profile::Gaussian);
        assert_eq!([sharp.at(0.001, 0.004), sharp.at(-0.002, 0.004)], [0.25, 1.0]);
    }
}
