//! Where the base cup of each ball bar path is, about: from the lengths themselves, as files name paths as they please.
//!
//! The squared length is |t|² - 2 t·c + |c|² over the tool's places t in the plane of motion, linear in the cup's x, z and |c|²: the
//! rest of |c|² is how far the cup lies beside the plane. On which side, no length tells.

use nalgebra::{Matrix3, Vector3};

/// A cup nearer to the plane of motion than this part of the bar may as well lie in it.
const BESIDE: f64 = 0.05;
/// Lengths that differ by less from those of a cup straight below leave it there.
const NEAR_MM: f64 = 1.0;
/// Errors of a machine change lengths by less than this.
const ERRORS_MM: f64 = 0.1;

/// A path's base cup, in the tool's coordinates.
#[derive(Debug, Clone, Copy)]
pub struct Cup {
    /// Its place.
    pub place_mm: Vector3<f64>,
    /// Mean length of the bar.
    pub bar_mm: f64,
    /// Which of the bars it is: paths that differ in length have bars of their own.
    pub bar: usize,
    /// Whether the side of the plane of motion is only assumed.
    pub side_assumed: bool,
    /// Whether how far it lies beside that plane is told by the lengths, or shall be.
    pub y_is_free: bool,
}

impl Cup {
    /// Whether it lies beside the plane of motion, so that sideways errors change the length.
    pub fn is_beside(&self) -> bool {
        self.place_mm.y != 0.0
    }

    /// Distance of a tool place from the cup.
    pub fn distance(&self, tool: &Vector3<f64>) -> f64 {
        (tool - self.place_mm).norm()
    }

    /// Root mean square of the distances' misses.
    pub fn miss_mm(&self, tools: &[Vector3<f64>], lengths_mm: &[f64]) -> f64 {
        let squares: f64 =
            tools.iter().zip(lengths_mm).map(|(t, l)| (self.distance(t) - l).powi(2)).sum();
        (squares / tools.len().max(1) as f64).sqrt()
    }
}

/// The cup straight below the tool's first place, or so far beside the plane of motion.
pub fn straight_below(beside_mm: f64, tool0: &Vector3<f64>, bar_mm: f64) -> Cup {
    let below_mm = (bar_mm * bar_mm - beside_mm * beside_mm).max(0.0).sqrt();
    let place_mm = Vector3::new(tool0.x, beside_mm, tool0.z - below_mm);
    Cup { place_mm, bar_mm, bar: 0, side_assumed: false, y_is_free: false }
}

/// The cup of one path: straight below where that is about right, otherwise where its name says how far beside the plane of motion, or
/// where the lengths put it. With it, the root mean square of what the lengths miss by if all is fitted to them, the bar's own too: a
/// short arc about a cup beside the plane is one about a cup within it, seen with a longer bar.
pub fn find(below: Cup, tools: &[Vector3<f64>], lengths_mm: &[f64]) -> (Cup, f64) {
    let with_bar = with_its_bar(below, tools, lengths_mm);
    let at_best = |cup: Cup| (cup, cup.miss_mm(tools, lengths_mm).min(with_bar));
    if below.miss_mm(tools, lengths_mm) < NEAR_MM {
        return at_best(below);
    }
    let Some(beside) = from_lengths(below, tools, lengths_mm) else { return at_best(below) };
    let at = |y_mm: f64| {
        let place_mm = Vector3::new(beside.place_mm.x, y_mm, beside.place_mm.z);
        beside_by(Cup { place_mm, ..beside }, tools, lengths_mm)
    };
    let enough = (3.0 * beside.miss_mm(tools, lengths_mm)).max(ERRORS_MM);
    let told = at(below.place_mm.y);
    if told.miss_mm(tools, lengths_mm) < enough {
        return at_best(told);
    }
    let plane = at(0.0);
    if beside.place_mm.y < BESIDE * below.bar_mm || plane.miss_mm(tools, lengths_mm) < enough {
        return at_best(plane);
    }
    let side = if below.place_mm.y < 0.0 { -1.0 } else { 1.0 };
    let place_mm = beside.place_mm.component_mul(&Vector3::new(1.0, side, 1.0));
    at_best(Cup { place_mm, side_assumed: below.place_mm.y == 0.0, ..beside })
}

/// The cup that fits the squared lengths best, on the side of positive y.
fn from_lengths(below: Cup, tools: &[Vector3<f64>], lengths_mm: &[f64]) -> Option<Cup> {
    let about = below.place_mm.component_mul(&Vector3::new(1.0, 0.0, 1.0));
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (tool, length) in tools.iter().zip(lengths_mm) {
        let t = (tool - about) / below.bar_mm;
        let row = Vector3::new(-2.0 * t.x, -2.0 * t.z, 1.0);
        normal += row * row.transpose();
        right += row * ((length / below.bar_mm).powi(2) - t.norm_squared());
    }
    let c = normal.try_inverse()? * right;
    let beside = (c.z - c.x * c.x - c.y * c.y).max(0.0).sqrt();
    let place_mm = about + Vector3::new(c.x, beside, c.y) * below.bar_mm;
    place_mm.iter().all(|v| v.is_finite()).then_some(Cup { place_mm, ..below })
}

/// The best cup near `cup`, as far beside the plane of motion as that (Gauss-Newton).
fn beside_by(mut cup: Cup, tools: &[Vector3<f64>], lengths_mm: &[f64]) -> Cup {
    for _ in 0..20 {
        let (mut normal, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
        for (tool, length) in tools.iter().zip(lengths_mm) {
            let away = cup.place_mm - tool;
            let distance = away.norm().max(1e-9);
            let row = Vector3::new(away.x, 0.0, away.z) / distance;
            normal += row * row.transpose();
            right += row * (length - distance);
        }
        let Some(inverse) = normal.try_inverse() else { break };
        cup.place_mm += inverse * right;
    }
    cup
}

/// What the lengths miss by, root mean square, about the best cup near `cup` with a bar of the best length (Gauss-Newton).
fn with_its_bar(mut cup: Cup, tools: &[Vector3<f64>], lengths_mm: &[f64]) -> f64 {
    let (mut bar_mm, mut least) = (0.0, f64::INFINITY);
    for _ in 0..20 {
        let (mut normal, mut right, mut squares) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for (tool, length) in tools.iter().zip(lengths_mm) {
            let away = cup.place_mm - tool;
            let distance = away.norm().max(1e-9);
            let row = Vector3::new(away.x / distance, 1.0, away.z / distance);
            let missed = length - distance - bar_mm;
            normal += row * row.transpose();
            right += row * missed;
            squares += missed * missed;
        }
        least = f64::min(least, (squares / tools.len().max(1) as f64).sqrt());
        let Some(step) = normal.try_inverse().map(|inverse| inverse * right) else { break };
        cup.place_mm += Vector3::new(step.x, 0.0, step.z);
        bar_mm += step.y;
    }
    least
}
