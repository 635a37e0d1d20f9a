//! Circles inside a ring that may be a burn test's spot.

use std::ops::Range;

use crate::find::{self, Candidate, Look};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::dirt::{DOT_RADIUS, DOTS, SPOTS, is_beside, is_dirt_on, is_like};
use crate::measure::limits::{glow, is_steady};
use crate::measure::spot::WHOLE;

/// Where a spot is looked for, and how large, in the ring's radii.
pub(super) struct Place {
    /// Farthest from the ring's centre.
    reach: f64,
    /// Radii of circles that are looked for.
    radii: Range<f64>,
    /// Radii of spots as measured: beyond is the inner edge of an annulus, or a ripple.
    pub(super) measured: Range<f64>,
    /// Whether it takes a nearer look than the whole picture's.
    pub(super) near: bool,
}

/// Places in turn: where there is no spot, one is looked for farther out, as on an annulus' inner edge, a large one, a tiny one in
/// the middle, and at last one anywhere.
pub(super) const PLACES: [Place; 5] = [
    Place { reach: 0.7, radii: 0.05..0.45, measured: 0.0..0.36, near: false },
    Place { reach: 0.9, radii: 0.05..0.45, measured: 0.0..0.36, near: false },
    Place { reach: 0.5, radii: 0.3..0.75, measured: 0.3..0.7, near: false },
    Place { reach: 0.3, radii: 0.02..0.07, measured: 0.0..0.1, near: true },
    Place { reach: 0.9, radii: 0.03..0.1, measured: 0.0..0.13, near: true },
];
/// Radius from which a circle of the other sense may be the annulus' inner edge, in the ring's radii.
const OWN_RADIUS: f64 = 0.3;
/// How far off the ring's centre that may be, in the ring's radii.
const OWN_OFF: f64 = 0.03;
/// What is as small as a dot, and so far off the ring's centre or farther (in its radii), may be spatter or dirt.
const DOT_OFF: f64 = 0.3;
/// But not where it is whole and its step is such a part of the ring's, and there is no other.
const DOT_STEP: f64 = 0.5;
/// Nor where nothing else in the ring is seen so clearly (score as a part of its own).
const NEXT_CLEAREST: f64 = 0.55;
/// A spot's step as a part of the ring's: a glow about the ring is fainter.
const LEAST_STEP: f64 = 0.05;
/// As soft as this part of its radius a circle may well be a glare instead of a spot.
const GLARE: f64 = 0.3;
/// How many softnesses edges of ring and spot end apart.
const CLEAR: f64 = 2.5;
/// Score of what may stand for a spot that cannot be measured, as a part of that spot's.
const AS_CLEAR: f64 = 0.2;

impl Place {
    /// A nearer look at it, where that is what it takes.
    pub(super) fn look_near(&self, frame: &Frame, outer: &Candidate) -> Option<Look> {
        /// A spot's surroundings, in its largest radii.
        const AROUND: f64 = 3.0;
        let reach_px = (self.reach + AROUND * self.radii.end) * outer.circle.radius;
        self.near.then(|| find::look_near(frame, outer.circle.center, reach_px)).flatten()
    }
}

/// Circles inside a ring, at a place, that may be its spot, best first.
pub(super) fn candidates(
    look: &Look,
    outer: &Candidate,
    edges: &[Candidate],
    place: &Place,
) -> Vec<Candidate> {
    let ring = outer.circle;
    let (least, most) = (place.radii.start, place.radii.end);
    let most_radius_px = most * ring.radius;
    let is_rings_own = |c: &Candidate| {
        let slack_px = c.scatter_px + outer.scatter_px;
        c.step * outer.step < 0.0
            && may_end(&c.circle, &ring, slack_px)
            && !ends_farther_out(edges, &ring, outer.step, c.circle.radius)
    };
    // A faint spot is not seen beside a ring whose every edge asks for circles.
    let known: Vec<Candidate> = edges
        .iter()
        .filter(|e| e.circle.radius > most_radius_px || is_rings_own(e))
        .copied()
        .collect();
    let inside = find::circles(
        look,
        find::Options {
            least_radius_px: (least * ring.radius).max(4.0),
            most_radius_px,
            near: Some((ring.center, place.reach * ring.radius)),
            least_coverage: 0.55,
            centers: 6,
            known: &known,
        },
    );
    let off = |c: &Candidate| (c.circle.center - ring.center).norm() / ring.radius;
    let rank = |c: &Candidate| {
        // Beside the centre what is lighter than a dark burn may well be a glare, too.
        let doubt = if c.step < 0.0 && outer.step > 0.0 { 3.0 } else { 1.0 };
        let toward_center = 1.0 + doubt * (off(c) / 0.5).powi(2);
        let strength = c.score * (c.step.abs() * c.circle.radius).sqrt() * c.coverage;
        strength / toward_center / glow(c, GLARE)
    };
    // A dot that small, away from where the spot should be, is believed to be it only where it is burnt and alone.
    let is_dot = |c: &Candidate| c.circle.radius < DOT_RADIUS * ring.radius && off(c) > DOT_OFF;
    let dots: Vec<Candidate> = inside.iter().filter(|c| is_dot(c)).copied().collect();
    let spatter = |c: &Candidate| {
        let burnt = c.step.abs() > DOT_STEP * outer.step.abs()
            && dots.iter().all(|o| !is_like(o, c, &DOTS));
        let beside = |o: &&Candidate| is_steady(o) && is_beside(o, c);
        let next = inside.iter().filter(beside).map(|o| o.score).fold(0.0, f64::max);
        is_dot(c) && !(c.coverage > WHOLE && (burnt || next < NEXT_CLEAREST * c.score))
    };
    // What small thing touches a larger mark, or lies in it off its middle, is dirt on it.
    let is_on_mark = |c: &Candidate| {
        c.circle.radius < DOT_RADIUS * ring.radius
            && inside.iter().chain(edges).any(|o| is_dirt_on(c, o, outer))
    };
    let is_usual = |c: &Candidate| {
        off(c) <= PLACES[0].reach && c.circle.radius <= PLACES[0].radii.end * ring.radius
    };
    let mut spots: Vec<Candidate> = inside
        .iter()
        .copied()
        .filter(|c| {
            is_steady(c)
                && !spatter(c)
                && !is_on_mark(c)
                && (is_usual(c) && !place.near || c.coverage > WHOLE)
                && !is_rings_own(c)
                && off(c) + 0.5 * c.circle.radius / ring.radius < 0.95
                && c.step.abs() > LEAST_STEP * outer.step.abs()
        })
        .collect();
    spots.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
    spots
}

/// Whether others look like the likeliest spot: spatter, balls and strands are many, the spot is one.
pub(super) fn has_rivals(place: &Place, spots: &[Candidate]) -> bool {
    let Some((spot, others)) = spots.split_first() else { return false };
    // Two may be glares or dirt; of dots any other says that they are many.
    let most = if place.near { 0 } else { 2 };
    let alike = if place.near { &DOTS } else { &SPOTS };
    others.iter().filter(|c| is_like(c, spot, alike)).count() > most
}

/// Whether a spot may be the one meant where the likeliest cannot be measured: one farther out is spatter, as is one far less clear.
pub(super) fn may_stand_for(likeliest: &Candidate, c: &Candidate, ring: &Candidate) -> bool {
    let off = |c: &Candidate| (c.circle.center - ring.circle.center).norm();
    let apart = (c.circle.center - likeliest.circle.center).norm();
    let instead = off(c) <= off(likeliest) && c.score > AS_CLEAR * likeliest.score;
    instead || apart < likeliest.circle.radius
}

/// How far a small circle lies inside a large one, where their outlines are nearest, clear of an edge as soft as `softness_px`.
pub(super) fn clear_px(large: &Circle, small: &Circle, softness_px: f64) -> f64 {
    large.radius - (large.center - small.center).norm() - small.radius - CLEAR * softness_px
}

/// Whether a circle of the other sense may be the inner edge of the ring's own annulus: as large as a large spot, but it shares the ring's
/// centre.
pub(super) fn may_end(inner: &Circle, ring: &Circle, slack: f64) -> bool {
    inner.radius > OWN_RADIUS * ring.radius
        && (inner.center - ring.center).norm() < OWN_OFF * ring.radius + slack
}

/// Whether an annulus of that step ends at another of the `edges`, clear of a radius (px): the bare plate is seen within.
pub(super) fn ends_farther_out(
    edges: &[Candidate],
    ring: &Circle,
    step: f64,
    radius_px: f64,
) -> bool {
    /// In the radius, in the ring's, and in its step.
    const CLEAR: f64 = 1.2;
    const INSIDE: f64 = 0.97;
    const BARE: f64 = 0.35;
    let ends = |e: &Candidate| {
        e.step / step < -BARE
            && (CLEAR * radius_px..INSIDE * ring.radius).contains(&e.circle.radius)
            && (e.circle.center - ring.center).norm() < OWN_OFF * ring.radius + e.scatter_px
    };
    edges.iter().any(ends)
}
