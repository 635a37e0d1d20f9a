//! Whether what was taken for a ring or spot is a polygon: a screw's socket is one, and a nut; a burn never is.

use crate::measure::ring::Ring;

/// Numbers of corners.
const CORNERS: std::ops::RangeInclusive<u32> = 4..=8;
/// A polygon's form as a part of its radius, rms: an octagon's is 0.024, and 0.015 where its corners are taken for dirt.
const FORM: f64 = 0.012;
/// What a polygon's sides and corners make of its form, with dirt in its corners; a ragged edge's is spread over many waves.
const SHARE: f64 = 0.65;

/// Whether the form of a measured edge is that of a regular polygon.
pub(super) fn is_polygon(ring: &Ring) -> bool {
    has_corners(&ring.residuals, ring.circle.radius)
}

/// The same of residuals by angle (rad, mm).
fn has_corners(residuals: &[(f64, f64)], radius_mm: f64) -> bool {
    let n = residuals.len() as f64;
    let variance = residuals.iter().map(|(_, r)| r * r).sum::<f64>() / n;
    // In its first two waves.
    let share = |corners: u32| {
        let power = |wave: u32| {
            let (s, c) = residuals.iter().fold((0.0, 0.0), |(s, c), (angle, r)| {
                let (sin, cos) = (f64::from(wave) * angle).sin_cos();
                (s + r * sin, c + r * cos)
            });
            2.0 * (s * s + c * c) / (n * n)
        };
        (power(corners) + power(2 * corners)) / variance
    };
    variance.sqrt() > FORM * radius_mm && CORNERS.into_iter().any(|k| share(k) > SHARE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    fn around(radius: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        let all: Vec<(f64, f64)> =
            (0..72).map(|i| f64::from(i) * TAU / 72.0).map(|a| (a, radius(a))).collect();
        let mean = all.iter().map(|(_, r)| r).sum::<f64>() / 72.0;
        all.into_iter().map(|(a, r)| (a, r - mean)).collect()
    }

    #[test]
    fn squares_to_octagons_are_polygons_and_ragged_marks_are_not() {
        for corners in [4.0, 5.0, 6.0, 8.0] {
            let side = move |a: f64| {
                let half = PI / corners;
                half.cos() / ((a + 0.3).rem_euclid(2.0 * half) - half).cos()
            };
            assert!(has_corners(&around(side), 1.0), "{corners}");
        }
        // An astigmatic beam's ellipse, and one with lobes of all sizes.
        assert!(!has_corners(&around(|a| 1.0 + 0.06 * (2.0 * a).cos()), 1.0));
        let lobe = |k: i32, a: f64| 0.03 * (f64::from(k * k) + f64::from(k) * a).cos();
        assert!(!has_corners(&around(|a| 1.0 + (2..9).map(|k| lobe(k, a)).sum::<f64>()), 1.0));
        // Six corners so small that a ragged edge has them too.
        assert!(!has_corners(&around(|a| 1.0 + 0.01 * (6.0 * a).cos()), 1.0));
    }
}
