//! Does a mark stand out from its surface? Lines of texture meet in something like a circle somewhere in every picture.

use nalgebra::Vector2;

use crate::find::Candidate;
use crate::find::look::{Look, directions, value_at};
use crate::fit::Circle;
use crate::fit::robust::scatter;

/// Directions in which both sides of a circle are read.
const RAYS: usize = 32;
/// Places of the bare surface that say what it does by itself.
const LEAST_PLACES: usize = 12;
/// Places of the whole picture that are looked at, about.
const MOST_PLACES: f64 = 600.0;
/// Radii from a circle's own down to an eighth that may say it where its own finds no room: small circles differ more.
const SMALLER: [f64; 4] = [1.0, 0.5, 0.25, 0.125];

/// Where they are read: well inside and well outside of a disc, or close by a ring's edge.
#[derive(Clone, Copy)]
pub enum Sides {
    /// Of a spot, which is a disc.
    Disc,
    /// Of an edge that may be one of two close to each other.
    Edge,
}

/// How far from the edge they are read, in radii.
type Depths = [f64; 3];

impl Sides {
    /// By a ring's edge no farther than most of the way to the next of `marks` about the same centre: a ring may be a line.
    fn depths(self, circle: Circle, marks: &[Circle]) -> Depths {
        const MOST: f64 = 0.12;
        const TO_NEXT: f64 = 0.75;
        const SAME_CENTER: f64 = 0.05;
        let gap = |m: &Circle| {
            let apart = (m.center - circle.center).norm() / circle.radius;
            let gap = (m.radius / circle.radius - 1.0).abs() - apart;
            (apart < SAME_CENTER && gap > 0.0).then_some(TO_NEXT * gap)
        };
        match self {
            Sides::Disc => [0.1, 0.25, 0.4],
            Sides::Edge => {
                let deepest = marks.iter().filter_map(gap).fold(MOST, f64::min);
                [deepest / 3.0, 2.0 * deepest / 3.0, deepest]
            }
        }
    }
}

/// A mark must differ from its surroundings by this many times what the bare surface does by itself, and more where less of it
/// is seen: of the circles that may be drawn into texture some always differ by three or so, and parts of them by ten.
const STANDING: f64 = 4.0;

/// Whether a circle stands out from its surface, clear of `marks`; `None` where there is too little bare surface to tell.
pub fn stands_out(look: &Look, c: &Candidate, sides: Sides, marks: &[Circle]) -> Option<bool> {
    standing(look, c.circle, sides, marks).map(|z| z * c.coverage.powi(2) > STANDING)
}

/// How many times the usual difference between inside and outside a circle shows, where usual is what circles of its size have
/// elsewhere on the surface, clear of `marks`; smaller circles where there is no room for such. `None` where there is too little
/// bare surface to tell. Full-picture pixels.
fn standing(look: &Look, circle: Circle, sides: Sides, marks: &[Circle]) -> Option<f64> {
    let radius = circle.radius / look.factor as f64;
    let depths = sides.depths(circle, marks);
    let around: [Vector2<f64>; RAYS] = directions();
    let here = difference(look, &around, look.reduced(circle.center), radius, depths, marks)?;
    // Within a ring's edge there is bare surface too, within a spot there is not.
    let inside = matches!(sides, Sides::Edge);
    let usual = |part: &f64| usual(look, &around, circle, part * radius, depths, inside, marks);
    let usual = SMALLER.iter().find_map(usual)?;
    Some(here.abs() / usual.max(1e-9))
}

/// Standard deviation of the difference that circles of a radius show on the bare surface, reduced pixels.
fn usual(
    look: &Look,
    around: &[Vector2<f64>],
    circle: Circle,
    radius: f64,
    depths: Depths,
    inside: bool,
    marks: &[Circle],
) -> Option<f64> {
    let (w, h) = look.size();
    let reach = (1.1 + depths[2]) * radius;
    let reach_px = reach * look.factor as f64;
    let clear = |p: Vector2<f64>| {
        let full = look.full(p);
        let apart = |c: &Circle| (full - c.center).norm();
        // Beside a mark, or within it where it is a ring's inner edge and the place is clear of the circle in question.
        marks.iter().all(|m| (apart(m) - m.radius).abs() > reach_px)
            && (apart(&circle) - circle.radius).abs() > reach_px
            && (inside || apart(&circle) > circle.radius)
    };
    let step = (0.5 * radius).max(3.0).max(((w * h) as f64 / MOST_PLACES).sqrt());
    let count = |size: usize| ((size as f64 - 2.0 * reach) / step).max(0.0) as usize;
    let (columns, rows) = (count(w), count(h));
    let mut differences: Vec<f64> = (0..=rows)
        .flat_map(|j| (0..=columns).map(move |i| (i, j)))
        .map(|(i, j)| Vector2::new(reach + i as f64 * step, reach + j as f64 * step))
        .filter(|p| clear(*p))
        .filter_map(|p| difference(look, around, p, radius, depths, &[]))
        .map(f64::abs)
        .collect();
    if differences.len() < LEAST_PLACES {
        return None;
    }
    Some(scatter(&mut differences))
}

/// Mean level outside a circle minus that inside, reduced pixels, of the directions in which both lie in the picture and on one
/// side of all `marks`; `None` where few do.
fn difference(
    look: &Look,
    around: &[Vector2<f64>],
    center: Vector2<f64>,
    radius: f64,
    depths: Depths,
    marks: &[Circle],
) -> Option<f64> {
    let image = &look.scales[0].1;
    let (mut sum, mut count) = (0.0f64, 0usize);
    for along in around {
        let at = |r: f64| center + along * (r * radius);
        let within = |p: Vector2<f64>, m: &Circle| (look.full(p) - m.center).norm() < m.radius;
        for depth in depths {
            let (inner, outer) = (at(1.0 - depth), at(1.0 + depth));
            if marks.iter().all(|m| within(inner, m) == within(outer, m)) {
                let value = |p: Vector2<f64>| f64::from(value_at(image, p.x, p.y));
                let step = value(outer) - value(inner);
                if step.is_finite() {
                    sum += step;
                    count += 1;
                }
            }
        }
    }
    (count >= RAYS / 2).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, Gray};

    /// Brushed metal, and a disc darker by `depth` counts.
    fn plate(disc: Circle, depth: f64) -> Look {
        let (width, height) = (640, 480);
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5
        };
        let mut data = vec![0u8; width * height];
        for (y, row) in data.chunks_mut(width).enumerate() {
            let mut streak = 0.0;
            for (x, value) in row.iter_mut().enumerate() {
                if x % 120 == 0 {
                    streak = 40.0 * random();
                }
                let inside = disc.distance(Vector2::new(x as f64, y as f64)) < 0.0;
                let level = 120.0 + streak + 6.0 * random() - if inside { depth } else { 0.0 };
                *value = level.clamp(0.0, 255.0) as u8;
            }
        }
        Look::new(&Frame::Eight(Gray { width, height, data }), 1)
    }

    #[test]
    fn a_pale_disc_stands_out_of_brushed_metal_and_bare_metal_does_not() {
        let disc = Circle { center: Vector2::new(320.0, 240.0), radius: 40.0 };
        let look = plate(disc, 30.0);
        let z = |c: Circle, sides| standing(&look, c, sides, &[disc]).unwrap();
        assert!(standing(&look, disc, Sides::Disc, &[]).unwrap() > 20.0);
        assert!(standing(&look, disc, Sides::Edge, &[]).unwrap() > 10.0);
        for i in 0..40 {
            let (x, y) = (60.0 + 13.0 * f64::from(i), if i % 2 == 0 { 90.0 } else { 390.0 });
            let bare = Circle { center: Vector2::new(x, y), radius: 40.0 };
            assert!(z(bare, Sides::Disc) < 4.5, "{x} {y} {}", z(bare, Sides::Disc));
        }
    }

    #[test]
    fn where_no_bare_surface_is_left_nothing_is_said() {
        let disc = Circle { center: Vector2::new(320.0, 240.0), radius: 390.0 };
        assert!(standing(&plate(disc, 30.0), disc, Sides::Disc, &[]).is_none());
    }
}
