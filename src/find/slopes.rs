//! Does the light fall off across a circle rather than end there? Then there is a circle at any radius, and none of them is an edge.

use nalgebra::Vector2;

use crate::find::look::{Look, directions};
use crate::find::waves;
use crate::fit::Circle;

/// Directions over which the level is averaged.
const RAYS: usize = 96;
/// Between which radii, as parts of the circle's, an edge lies, in steps fine enough for a narrow ring's, and those either side of it.
const AT: [f64; 2] = [0.94, 1.06];
const STEPS: usize = 6;
const INSIDE: [f64; 2] = [0.7, 0.85];
const OUTSIDE: [f64; 2] = [1.15, 1.3];
/// By such a part of the slope either side of it that of an edge is another.
const OTHER: f64 = 0.3;

/// Whether the mean level goes on across a circle (px of the full picture) as it does either side of it.
pub(crate) fn is_fall_off(look: &Look, circle: Circle) -> bool {
    let around: [Vector2<f64>; RAYS] = directions();
    let (center, radius) = (look.reduced(circle.center), circle.radius / look.factor as f64);
    let slope = |[from, to]: [f64; 2]| {
        let [near, far] = [from, to].map(|r| waves::levels(look, center, r * radius, &around));
        waves::mean_step(&near, &far).0 / (to - from)
    };
    // Beyond the picture nothing is seen.
    let beside: Vec<f64> =
        [INSIDE, OUTSIDE].map(slope).into_iter().filter(|s| s.is_finite()).collect();
    let mean = beside.iter().sum::<f64>() / beside.len() as f64;
    let step = (AT[1] - AT[0]) / STEPS as f64;
    let steps = (0..STEPS).map(|i| AT[0] + step * i as f64);
    let edge = steps.map(|from| (slope([from, from + step]) - mean).abs()).fold(0.0, f64::max);
    beside.iter().all(|s| s * mean > 0.0) && edge < OTHER * mean.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, Gray};

    fn falls_off(level: impl Fn(f64) -> f64) -> bool {
        let (width, height) = (480usize, 400usize);
        let center = Vector2::new(240.0, 200.0);
        let at = |i: usize| {
            let d = Vector2::new((i % width) as f64, (i / width) as f64) - center;
            level(d.norm() / 150.0).round() as u8
        };
        let data = (0..width * height).map(at).collect();
        let look = Look::new(&Frame::Eight(Gray { width, height, data }), 1);
        is_fall_off(&look, Circle { center, radius: 150.0 })
    }

    #[test]
    fn light_falls_off_and_burns_end_however_soft_they_are() {
        let light = |r: f64| 200.0 * (-0.5 * r * r).exp();
        assert!(falls_off(light));
        for softness in [0.01, 0.05, 0.14] {
            let burn = |r: f64| 1.0 / (1.0 + (-1.7 * (r - 1.0) / softness).exp());
            assert!(!falls_off(|r| 60.0 + 100.0 * burn(r)), "{softness}");
            // A pale one under that light.
            if softness < 0.1 {
                assert!(!falls_off(|r| light(r) * (1.0 - 0.06 * (1.0 - burn(r)))), "{softness}");
            }
        }
    }
}
