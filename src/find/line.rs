//! Is a circle a line? One that is scribed or drawn is darker or lighter than both its sides; a burn's zone is wider.

use crate::find::look::Look;
use crate::find::waves;
use crate::fit::Circle;

/// Directions over which levels are averaged.
const RAYS: usize = 48;
/// How far to both sides is looked, in steps and reduced pixels.
const STEPS: usize = 40;
const SIDES_PX: f64 = 8.0;
/// How far a line's level lies beyond that between its sides, as a part of their difference: an edge's own is half of it at most.
const BEYOND: f64 = 1.0;

/// Whether a circle is a line, no wider than a part of its radius: half of its depth on both sides.
pub(crate) fn is_line(look: &Look, circle: Circle, widest: f64) -> bool {
    let (center, radius) = (look.reduced(circle.center), circle.radius / look.factor as f64);
    let widest_px = (widest * radius).min(SIDES_PX);
    let at = |k: usize| radius + SIDES_PX * (2.0 * k as f64 / STEPS as f64 - 1.0);
    let mut levels = vec![0.0];
    levels.extend(waves::outward::<RAYS>(look, center, (0..=STEPS).map(at)));
    if levels.len() <= STEPS {
        return false;
    }
    let across = levels[STEPS];
    let beyond = |k: usize| (levels[k] - across * k as f64 / STEPS as f64).abs();
    let depth = (0..=STEPS).map(beyond).fold(0.0, f64::max);
    let wide = (0..=STEPS).filter(|k| beyond(*k) > 0.5 * depth).count();
    depth > BEYOND * across.abs() && wide as f64 * 2.0 * SIDES_PX / (STEPS as f64) < widest_px
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::frame::{Frame, Gray};

    fn is_line_at(radius: f64, level: impl Fn(f64) -> f64) -> bool {
        let (width, height) = (800usize, 600usize);
        let center = Vector2::new(410.0, 290.0);
        let at = |i: usize| {
            let p = Vector2::new((i % width) as f64, (i / width) as f64);
            level((p - center).norm()).round() as u8
        };
        let data = (0..width * height).map(at).collect();
        let look = Look::new(&Frame::Eight(Gray { width, height, data }), 1);
        is_line(&look, Circle { center, radius }, 0.04)
    }

    #[test]
    fn a_scribed_circle_is_a_line_and_a_burns_edges_are_none() {
        // On a plate whose level slopes, as within a soft zone's edge.
        let slope = |r: f64| 150.0 + 0.1 * r;
        assert!(is_line_at(200.0, |r| slope(r) - if (r - 199.0).abs() < 1.5 { 60.0 } else { 0.0 }));
        assert!(!is_line_at(200.0, |r| if r < 200.0 { 60.0 } else { slope(r) }));
        let annulus = |r: f64| if (160.0..200.0).contains(&r) { 90.0 } else { slope(r) };
        assert!(!is_line_at(200.0, annulus) && !is_line_at(160.0, annulus));
    }
}
