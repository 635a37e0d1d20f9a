//! The common profile with its tail, tabulated: every bin of every sector looks both up many times.

use crate::edge::Template;
use crate::edge::template::Step;

/// Profile and tail between two nodes, over the fraction of the way.
struct Piece {
    profile: [f64; 4],
    tail: [f64; 2],
}

/// What a place of the common profile holds.
pub(super) struct Value {
    /// The profile.
    pub(super) profile: f64,
    /// Its slope per pixel.
    pub(super) slope: f64,
    /// The tail.
    pub(super) tail: f64,
}

/// A common profile with its edge and the tail beside it; constant beyond the ends.
pub(super) struct Shape {
    /// The profile's edge.
    pub(super) edge: Step,
    start_px: f64,
    per_px: f64,
    pieces: Vec<Piece>,
}

impl Shape {
    /// Tabulates a profile (Catmull-Rom: continuous slope).
    pub(super) fn of(template: &Template) -> Self {
        let edge = template.edge();
        let (v, n) = (&template.values, template.values.len());
        let tail_at = |i: usize| edge.tail(template.place_px(i));
        let pieces = (0..n.saturating_sub(1))
            .map(|i| {
                let (p1, p2) = (v[i], v[i + 1]);
                let p0 = if i > 0 { v[i - 1] } else { 2.0 * p1 - p2 };
                let p3 = if i + 2 < n { v[i + 2] } else { 2.0 * p2 - p1 };
                let profile = [
                    p1,
                    0.5 * (p2 - p0),
                    p0 - 2.5 * p1 + 2.0 * p2 - 0.5 * p3,
                    0.5 * (3.0 * (p1 - p2) + p3 - p0),
                ];
                let tail = tail_at(i);
                Piece { profile, tail: [tail, tail_at(i + 1) - tail] }
            })
            .collect();
        Self { edge, start_px: template.start_px, per_px: 1.0 / template.step_px, pieces }
    }

    /// Profile, slope and tail at a distance.
    #[inline]
    pub(super) fn at(&self, distance_px: f64) -> Value {
        let x = (distance_px - self.start_px) * self.per_px;
        let last = self.pieces.len() - 1;
        let i = (x.max(0.0) as usize).min(last);
        let f = (x - i as f64).clamp(0.0, 1.0);
        let Piece { profile: [d, c, b, a], tail } = &self.pieces[i];
        let slope = if f == x - i as f64 { self.per_px } else { 0.0 };
        Value {
            profile: d + f * (c + f * (b + f * a)),
            slope: slope * (c + f * (2.0 * b + f * 3.0 * a)),
            tail: tail[0] + f * tail[1],
        }
    }
}
