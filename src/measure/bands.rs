//! Bands of heat tint about a mark: the first of them may lie within its edge.

use crate::find::Candidate;

/// Step of the strongest band beyond a ring, about its centre, as a part of its own.
pub(super) fn strongest_beyond(ring: &Candidate, edges: &[Candidate]) -> f64 {
    /// In radii: what a burn's heat tints.
    const BEYOND: std::ops::Range<f64> = 1.02..1.6;
    edges
        .iter()
        .filter(|o| is_concentric(o, ring) && is_as_clear(o, ring))
        .filter(|o| BEYOND.contains(&(o.circle.radius / ring.circle.radius)))
        .map(|o| (o.step / ring.step).abs())
        .fold(0.0, f64::max)
}

/// Whether another edge is about as well seen as a candidate.
pub(super) fn is_as_clear(o: &Candidate, c: &Candidate) -> bool {
    o.coverage > 0.6 * c.coverage && o.scatter_px < 2.0 * c.scatter_px + 3.0
}

/// Whether two circles are about one centre.
pub(super) fn is_concentric(a: &Candidate, b: &Candidate) -> bool {
    (a.circle.center - b.circle.center).norm() < 0.12 * a.circle.radius.max(b.circle.radius)
}
