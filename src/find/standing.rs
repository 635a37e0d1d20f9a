//! Does a mark stand out from its surface? Lines of texture meet in something like a circle somewhere in every picture.

use nalgebra::Vector2;

use crate::find::look::{Look, value_at};
use crate::fit::Circle;

/// Directions in which both sides of a circle are read.
const RAYS: usize = 32;
/// Where they are read, in radii: well inside and well outside.
const INSIDE: [f64; 3] = [0.5, 0.65, 0.8];
const OUTSIDE: [f64; 3] = [1.2, 1.35, 1.5];
/// Places of the bare surface that say what it does by itself.
const LEAST_PLACES: usize = 12;

/// How many times the usual difference between inside and outside a circle shows, where usual is what circles of its size have
/// elsewhere on the surface, clear of `marks`. `None` where there is too little bare surface to tell. Full-picture pixels.
pub fn standing(look: &Look, circle: Circle, marks: &[Circle]) -> Option<f64> {
    let (w, h) = look.size();
    let k = look.factor as f64;
    let radius = circle.radius / k;
    let reach = OUTSIDE[2] * radius;
    let clear = |p: Vector2<f64>| {
        let full = look.full(p);
        let apart = |c: &Circle| (full - c.center).norm();
        // Beside a mark, or within it where it is a ring's inner edge and the place is clear of the circle in question.
        marks.iter().all(|m| (apart(m) - m.radius).abs() > 1.1 * reach * k)
            && apart(&circle) > circle.radius + reach * k
    };
    let here = difference(look, look.reduced(circle.center), radius)?;
    let step = (0.5 * radius).max(3.0);
    let count = |size: usize| ((size as f64 - 2.0 * reach) / step).max(0.0) as usize;
    let (columns, rows) = (count(w), count(h));
    let mut usual: Vec<f64> = (0..=rows)
        .flat_map(|j| (0..=columns).map(move |i| (i, j)))
        .map(|(i, j)| Vector2::new(reach + i as f64 * step, reach + j as f64 * step))
        .filter(|p| clear(*p))
        .filter_map(|p| difference(look, p, radius))
        .map(f64::abs)
        .collect();
    if usual.len() < LEAST_PLACES {
        return None;
    }
    let middle = usual.len() / 2;
    let median = *usual.select_nth_unstable_by(middle, f64::total_cmp).1;
    Some(here.abs() / (1.4826 * median).max(1e-9))
}

/// Mean level outside a circle minus that inside, reduced pixels; `None` where the picture ends.
fn difference(look: &Look, center: Vector2<f64>, radius: f64) -> Option<f64> {
    let image = &look.scales[0].1;
    let mut sum = 0.0f64;
    for i in 0..RAYS {
        let (s, c) = (std::f64::consts::TAU * i as f64 / RAYS as f64).sin_cos();
        let at = |r: &f64| {
            f64::from(value_at(image, center.x + r * radius * c, center.y + r * radius * s))
        };
        sum += OUTSIDE.iter().map(at).sum::<f64>() - INSIDE.iter().map(at).sum::<f64>();
    }
    let mean = sum / (RAYS * INSIDE.len()) as f64;
    mean.is_finite().then_some(mean)
}
