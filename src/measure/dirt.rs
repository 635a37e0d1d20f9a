//! What is dirt rather than a spot: dots far off the middle, dots among others like them, and small things on marks.

use crate::find::Candidate;
use crate::fit::Circle;
use crate::measure::spot::WHOLE;

/// Radius of a dot in the ring's radii, at most: what is round and as small may be spatter or dirt.
pub(super) const DOT_RADIUS: f64 = 0.1;
/// But not so near to the ring's middle, in its radii.
pub(super) const MIDDLE: f64 = 0.15;

/// Whether a spot is so small and far off its ring's centre that it may be a chip in a hole, or dirt.
pub(super) fn is_dot(spot: &Circle, ring: &Circle) -> bool {
    let apart = (spot.center - ring.center).norm();
    spot.radius < DOT_RADIUS * ring.radius && apart > MIDDLE * ring.radius
}

/// Whether a small circle is dirt on a mark inside the ring `outer`.
pub(super) fn is_dirt_on(c: &Candidate, mark: &Candidate, outer: &Candidate) -> bool {
    /// Radius of such a mark as a part of the ring's, at most, and in the dirt's, at least.
    const INSIDE: f64 = 0.5;
    const LARGER: f64 = 2.0;
    /// Its step as a part of the ring's, at least.
    const BURNT: f64 = 0.3;
    /// A spot in its own halo shares its centre: so far off it in the mark's radii dirt is.
    const OFF: f64 = 0.4;
    let apart = (c.circle.center - mark.circle.center).norm();
    mark.circle.radius < INSIDE * outer.circle.radius
        && mark.circle.radius > LARGER * c.circle.radius
        && mark.coverage > WHOLE
        && mark.step.abs() > BURNT * outer.step.abs()
        && apart > OFF * mark.circle.radius
        && apart < mark.circle.radius + c.circle.radius
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
