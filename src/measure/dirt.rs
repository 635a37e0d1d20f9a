//! What is dirt rather than a spot: dots far off the middle, dots among others like them, and small things on marks.

use nalgebra::Vector2;

use crate::find::{self, Candidate};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::limits::is_steady;
use crate::measure::spot::{PARTLY, WHOLE};
use crate::measure::spots::may_end;

/// Radius of a dot in the ring's radii, at most: what is round and as small may be spatter or dirt.
pub(super) const DOT_RADIUS: f64 = 0.1;
/// Radius of a mark with dirt on it, in the dirt's, at least.
const LARGER: f64 = 2.0;
/// But not so near to the ring's middle, in its radii.
pub(super) const MIDDLE: f64 = 0.15;

/// Whether a spot is so small and far off its ring's centre that it may be a chip in a hole, or dirt.
pub(super) fn is_dot(spot: &Circle, ring: &Circle) -> bool {
    let apart = (spot.center - ring.center).norm();
    spot.radius < DOT_RADIUS * ring.radius && apart > MIDDLE * ring.radius
}

/// Whether a small circle is dirt on a spot that is seen otherwise.
pub(super) fn is_within(small: &Circle, spot: &Circle) -> bool {
    (small.center - spot.center).norm() + small.radius < spot.radius
        && LARGER * small.radius < spot.radius
}

/// Whether a small circle is dirt on a mark inside the ring `outer`.
pub(super) fn is_dirt_on(c: &Candidate, mark: &Candidate, outer: &Candidate) -> bool {
    /// Radius of such a mark as a part of the ring's, at most.
    const INSIDE: f64 = 0.6;
    /// Radius of a spot's own halo, in the spot's, at most: within what is larger, and not the ring's own inner edge, it is dirt anywhere.
    const HALO: f64 = 8.0;
    /// Its step as a part of the ring's, at least.
    const BURNT: f64 = 0.3;
    /// A spot in its own halo shares its centre: so far off it in the mark's radii dirt is.
    const OFF: f64 = 0.4;
    let apart = (c.circle.center - mark.circle.center).norm();
    let is_halo = mark.circle.radius < HALO * c.circle.radius
        || may_end(&mark.circle, &outer.circle, mark.scatter_px + outer.scatter_px);
    mark.circle.radius < INSIDE * outer.circle.radius
        && mark.circle.radius > LARGER * c.circle.radius
        && mark.coverage > WHOLE
        && mark.step.abs() > BURNT * outer.step.abs()
        && (apart > OFF * mark.circle.radius || !is_halo)
        && apart < mark.circle.radius + c.circle.radius
}

/// Whether dots like this one lie about the ring too: then the one inside is one of them.
pub(super) fn is_strewn(frame: &Frame, dot: &Candidate, ring: &Circle) -> bool {
    /// How far apart and how far off the ring's centre such places are looked at, and how far about each, in its radii.
    const APART: f64 = 1.6;
    const AROUND: f64 = 0.9;
    let reach_px = AROUND * ring.radius;
    let places = [-1.0, 0.0, 1.0].map(|x| [-1.0, 0.0, 1.0].map(|y| Vector2::new(x, y)));
    let about = places.into_iter().flatten().filter(|way| *way != Vector2::zeros());
    about.map(|way| ring.center + way * APART * ring.radius).any(|middle| {
        let options = find::Options {
            least_radius_px: (DOTS.size * dot.circle.radius).max(2.0),
            most_radius_px: dot.circle.radius / DOTS.size,
            near: Some((middle, reach_px)),
            least_coverage: PARTLY,
            centers: 12,
            known: &[],
        };
        let outside =
            |c: &Candidate| (c.circle.center - ring.center).norm() > ring.radius + c.circle.radius;
        let is_another = |c: &Candidate| outside(c) && is_steady(c) && is_like(c, dot, &DOTS);
        find::look_near(frame, middle, reach_px)
            .is_some_and(|look| find::circles(&look, options).iter().any(is_another))
    })
}

/// How much two circles beside each other are alike: score of the other, at least, and how much smaller, fainter or the other way round
/// it may be, as parts of the one's; whether one lighter than its surroundings is like a darker one.
pub(super) struct Alike {
    score: f64,
    size: f64,
    step: f64,
    either: bool,
}

/// Marks like a spot, and dots like a dot.
pub(super) const SPOTS: Alike = Alike { score: 0.6, size: 0.75, step: 0.6, either: false };
pub(super) const DOTS: Alike = Alike { score: 0.35, size: 0.5, step: 0.4, either: true };

/// Whether two circles lie beside each other.
pub(super) fn is_beside(other: &Candidate, c: &Candidate) -> bool {
    (other.circle.center - c.circle.center).norm() > c.circle.radius + other.circle.radius
}

/// Whether a circle beside another is like it.
pub(super) fn is_like(other: &Candidate, c: &Candidate, alike: &Alike) -> bool {
    let within = |ratio: f64, least: f64| (least..1.0 / least).contains(&ratio);
    is_beside(other, c)
        && other.score > alike.score * c.score
        && within(other.circle.radius / c.circle.radius, alike.size)
        && (alike.either || other.step * c.step > 0.0)
        && within((other.step / c.step).abs(), alike.step)
}
