//! Where the circles are, roughly: with no hint but the picture, good to a pixel or two of the reduced picture.
//!
//! 1. [`Look`]: a reduced picture and its gradients at a few scales.
//! 2. `votes`: every gradient votes along its line; circles, concentric ones above all, pile up at their centres.
//! 3. `rays`: rays from each peak tell the radii at which most directions see an edge of the same sense.

mod look;
mod rays;
mod standing;
mod votes;

pub use look::Look;
pub(crate) use look::blur;
pub use standing::{Sides, stands_out};
pub(crate) use votes::vote;

use nalgebra::Vector2;

use crate::fit::Circle;
use crate::frame::Frame;

/// What to look for.
#[derive(Debug, Clone, Copy)]
pub struct Options {
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
    let mut hints: Vec<rays::Hint> = votes::centers(look, options)
        .into_iter()
        .flat_map(|center| rays::hints(look, center, options))
        .collect();
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
