//! Where the circles are, roughly: with no hint but the picture, good to a pixel or two of the reduced picture.
//!
//! 1. [`Look`]: a reduced picture and its gradients at a few scales.
//! 2. `votes`: every gradient votes along its line; circles, concentric ones above all, pile up at their centres.
//! 3. `rays`: rays from each peak tell the radii at which most directions see an edge of the same sense.
//! 4. `refine`: each of those is led to the circle through the edges near it.

mod crests;
mod folds;
mod light;
mod line;
mod look;
mod rays;
mod refine;
mod slopes;
mod standing;
mod swings;
mod teeth;
mod votes;
mod waves;

pub(crate) use folds::is_folded;
pub use light::Light;
pub(crate) use line::is_line;
pub use look::Look;
pub(crate) use look::blur;
pub(crate) use slopes::is_fall_off;
pub use standing::{Sides, stands_out};
pub(crate) use swings::swings_beyond;
pub(crate) use teeth::is_toothed;
pub(crate) use votes::vote;

use nalgebra::Vector2;

use crate::fit::Circle;
use crate::frame::{Frame, MOST_JOINED};

/// What to look for.
#[derive(Debug, Clone, Copy)]
pub struct Options<'a> {
    /// Smallest radius of interest, px of the full picture.
    pub least_radius_px: f64,
    /// Largest radius of interest, px of the full picture.
    pub most_radius_px: f64,
    /// Where the centre may be: everywhere, or within a distance of a place (px of the full picture).
    pub near: Option<(Vector2<f64>, f64)>,
    /// Least share of the circle that must show an edge of the same sense.
    pub least_coverage: f64,
    /// How many centres are looked into.
    pub centers: usize,
    /// Edges that are no news: circles are looked for with and without them, as beside strong edges faint ones have no vote.
    pub known: &'a [Candidate],
}

/// A circle seen in the picture, px of the full picture.
#[derive(Debug, Clone, Copy)]
pub struct Candidate {
    /// Centre and radius.
    pub circle: Circle,
    /// Median step across the edge, outside minus inside, counts.
    pub step: f64,
    /// Share of all directions that show the edge.
    pub coverage: f64,
    /// Softness of the edge (standard deviation), px; no better than the reduced picture allows.
    pub softness_px: f64,
    /// Scatter of the edge about the circle, px.
    pub scatter_px: f64,
    /// Coverage times the root of the step's size over noise: what candidates are ranked by.
    pub score: f64,
}

/// Hints that are followed to a circle, best first: a busy picture has hundreds.
const MOST_FOLLOWED: usize = 48;
/// Hints that are tried, most of which lead nowhere.
const MOST_TRIED: usize = 128;

/// Softnesses within which a circle seen beside an edge, of the same sense, is that edge.
pub(crate) const ITSELF: f64 = 1.5;

/// Circles in the picture, best first.
pub fn circles(look: &Look, options: Options) -> Vec<Candidate> {
    let centers = votes::centers(look, options);
    let mut hints: Vec<rays::Hint> =
        centers.into_iter().flat_map(|center| rays::hints(look, center, options)).collect();
    hints.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
    let mut found: Vec<Candidate> = Vec::new();
    let mut followed = 0;
    for hint in hints.iter().take(MOST_TRIED) {
        let Some(candidate) = rays::follow(look, hint, options, &found) else { continue };
        match found.iter_mut().find(|c| same(c, &candidate)) {
            Some(old) if better(&candidate, old) => *old = candidate,
            Some(_) => {}
            None => found.push(candidate),
        }
        followed += 1;
        if followed == MOST_FOLLOWED {
            break;
        }
    }
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    found
}

/// Circles about a centre that is known, px of the full picture, seen from as near as their size allows: edges that lie too
/// close to each other for [`circles`] among them.
pub fn about(frame: &Frame, center: Vector2<f64>, options: Options) -> Vec<Candidate> {
    /// Reduced pixels, radius and centre together, within which two are one.
    const APART: f64 = 1.5;
    let Some(look) = Look::part(frame, center, 1.05 * options.most_radius_px, 1) else {
        return Vec::new();
    };
    let mut found: Vec<Candidate> = Vec::new();
    for hint in rays::hints_about(&look, look.reduced(center), options) {
        let Some(seen) = rays::nearby(&look, &hint, options) else { continue };
        let near = APART * look.factor as f64;
        if !found.iter().any(|c| c.circle.apart(&seen.circle) < near) {
            found.push(seen);
        }
    }
    found
}

/// Whether two candidates are one circle seen twice.
fn same(a: &Candidate, b: &Candidate) -> bool {
    let clearer = if a.score > b.score { a } else { b };
    let near = 0.04 * a.circle.radius.min(b.circle.radius) + 4.0;
    (a.circle.center - b.circle.center).norm() < 2.0 * near
        && (a.circle.radius - b.circle.radius).abs() < near.max(ITSELF * clearer.softness_px)
        && a.step.signum() == b.step.signum()
}

/// Whether a circle seen again is seen better: with the higher score, unless the blur at which it was seen has eaten into
/// its step, as it does where the circle is a narrow line, and moved it.
fn better(new: &Candidate, old: &Candidate) -> bool {
    const EATEN: f64 = 0.7;
    let eaten = |a: &Candidate, b: &Candidate| {
        a.step.abs() < EATEN * b.step.abs() && a.coverage < 1.1 * b.coverage
    };
    !eaten(new, old) && (eaten(old, new) || new.score > old.score)
}

/// A reduced picture of `frame` for finding circles.
pub fn look(frame: &Frame) -> Look {
    Look::new(frame, look::BLURS.len())
}

/// The same in even light: without its smooth fall-off over the picture.
pub fn look_evenly(frame: &Frame) -> Look {
    Look::evenly(frame, look::BLURS.len())
}

/// A reduced picture of what lies within `reach_px` of a place, for circles that are too small in the whole; `None` where hardly any
/// of it is in the picture.
pub fn look_near(frame: &Frame, middle: Vector2<f64>, reach_px: f64) -> Option<Look> {
    Look::part(frame, middle, reach_px, look::BLURS.len())
}

/// The whole reduced by about a given factor, for circles that are too small in the other.
pub fn look_reduced(frame: &Frame, factor: usize) -> Look {
    /// Reduced pixels at most: memory is a few times as many numbers.
    const MOST_PX: f64 = 2e6;
    let least = ((frame.width() * frame.height()) as f64 / MOST_PX).sqrt().ceil() as usize;
    Look::reduced_by(factor.max(least).clamp(1, MOST_JOINED), frame, look::BLURS.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Gray;

    #[test]
    fn a_faint_spot_is_seen_beside_a_strong_ring_that_is_known() {
        let (width, height) = (640usize, 480usize);
        let middle = Vector2::new(320.0, 240.0);
        let spot = Circle { center: Vector2::new(345.0, 228.0), radius: 24.0 };
        let mut state = 1u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            16.0 * (f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5)
        };
        // An annulus of 100 counts, a spot of 14, both soft over some pixels.
        let inside = |distance: f64| 1.0 / (1.0 + (distance / 3.0).exp());
        let value = |x: usize, y: usize| {
            let p = Vector2::new(x as f64, y as f64);
            let r = (p - middle).norm();
            let ring = inside(r - 200.0) - inside(r - 150.0);
            180.0 - 100.0 * ring - 14.0 * inside(spot.distance(p))
        };
        let at = |i: usize| (value(i % width, i / width) + noise()).clamp(0.0, 255.0) as u8;
        let data = (0..width * height).map(at).collect();
        let look = look(&Frame::Eight(Gray { width, height, data }));
        let options = |known| Options {
            least_radius_px: 10.0,
            most_radius_px: 90.0,
            near: Some((middle, 140.0)),
            least_coverage: 0.55,
            centers: 1,
            known,
        };
        let edge = |radius: f64, step: f64| Candidate {
            circle: Circle { center: middle, radius },
            step,
            coverage: 1.0,
            softness_px: 5.0,
            scatter_px: 0.5,
            score: 10.0,
        };
        let known = [edge(200.0, 100.0), edge(150.0, -100.0)];
        let is_spot = |c: &Candidate| {
            (c.circle.center - spot.center).norm() < 3.0 && (c.circle.radius - 24.0).abs() < 3.0
        };
        assert!(circles(&look, options(&known)).iter().any(is_spot));
        assert!(!circles(&look, options(&[])).iter().any(is_spot));
    }
}
