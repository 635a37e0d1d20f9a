//! Is a circle one of many about its centre, as ripples, the grooves of a turned face and fingerprints have? A burn has few.

use crate::find::look::Look;
use crate::find::waves;
use crate::fit::Circle;

/// Directions over which the level is averaged.
const RAYS: usize = 96;
/// How far beyond the circle is looked, in radii.
const BEYOND: f64 = 6.0;

/// How often the mean level about a circle's centre (px of the full picture) swings up or down by `size` counts, from the circle outward.
pub(crate) fn swings_beyond(look: &Look, circle: Circle, size: f64) -> usize {
    let (center, radius) = (look.reduced(circle.center), circle.radius / look.factor as f64);
    let (mut lowest, mut highest) = (0.0f64, 0.0f64);
    let (mut swings, mut up) = (0, None);
    let radii = (0..=(BEYOND * radius) as usize).map(|k| radius + k as f64);
    for level in waves::outward::<RAYS>(look, center, radii) {
        (lowest, highest) = (lowest.min(level), highest.max(level));
        let turned = match up {
            Some(true) => level < highest - size,
            Some(false) => level > lowest + size,
            None => highest - lowest > size,
        };
        if turned {
            swings += 1;
            up = Some(level > 0.5 * (lowest + highest));
            (lowest, highest) = (level, level);
        }
    }
    swings
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::frame::{Frame, Gray};

    fn swings(level: impl Fn(f64) -> f64, radius: f64) -> usize {
        let (width, height) = (400usize, 300usize);
        let center = Vector2::new(210.0, 140.0);
        let at = |i: usize| {
            let p = Vector2::new((i % width) as f64, (i / width) as f64);
            level((p - center).norm()).round() as u8
        };
        let data = (0..width * height).map(at).collect();
        let look = Look::new(&Frame::Eight(Gray { width, height, data }), 1);
        swings_beyond(&look, Circle { center, radius }, 25.0)
    }

    #[test]
    fn ripples_swing_often_and_a_burn_does_not() {
        assert!(swings(|r| 120.0 + 30.0 * (0.5 * r).cos(), 30.0) > 8);
        // A spot, an annulus and a band of tint about it.
        let burn = |r: f64| match r {
            r if r < 20.0 => 30.0,
            r if r < 60.0 => 180.0,
            r if r < 80.0 => 90.0,
            r if r < 95.0 => 150.0,
            _ => 180.0,
        };
        assert!(swings(burn, 20.0) <= 3);
        assert!(swings(burn, 80.0) <= 1);
    }
}
