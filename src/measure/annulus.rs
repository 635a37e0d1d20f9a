//! The ring of a burn test: circles that may be it, and the one that is measured.

use crate::camera::View;
use crate::find::{self, Candidate, Look};
use crate::frame::Frame;
use crate::measure::bands::{self, is_as_clear, is_concentric};
use crate::measure::concentric;
use crate::measure::dirt;
use crate::measure::expected::around;
use crate::measure::limits::{Limits, glow};
use crate::measure::points::SHARP_PX;
use crate::measure::polygon::is_polygon;
use crate::measure::ring::{self, Ring};
use crate::measure::{spot, spots};

/// A halo's step as a part of that of the ring that it surrounds, at most.
pub(super) const HALO: f64 = 0.5;
/// Radius of an annulus' inner edge as a part of the outer one's.
const INNER: std::ops::Range<f64> = 0.5..0.97;
/// What a ring must keep to, and one that is seen all round, to this part: what is ragged all round is a burn, while of texture and of
/// letters arcs are round.
const RING: Limits = Limits { coverage: 0.35, form: 0.05, doubt: 0.02, in_all: 0.1 };
const WHOLE: f64 = 0.9;
const RAGGED: Limits = Limits { doubt: 0.06, ..RING };

fn limits(ring: &Ring) -> &'static Limits {
    if ring.arc_coverage > WHOLE { &RAGGED } else { &RING }
}

/// How much of a mark an edge is: strong, well covered, long; a burn's is as good as a sharper one's unless it is as soft as
/// the border of a lamp's light.
fn strength(c: &Candidate) -> f64 {
    let radius = c.circle.radius;
    (c.step.abs() * radius).sqrt() * c.coverage / (1.0 + 0.1 * c.scatter_px) / glow(c, 0.1)
}

/// Circles that may be rings, best first, and which of them are lines.
pub(super) struct Rings {
    /// All of them, lines last.
    pub all: Vec<Candidate>,
    /// How many are none.
    pub zones: usize,
}

/// Likely rings; of concentric edges the outermost strong one, and no line unless the edge is one itself.
pub(super) fn candidates(look: &Look, all: &[Candidate], least_radius_px: f64) -> Rings {
    let mut list: Vec<Candidate> =
        all.iter().filter(|c| c.circle.radius > least_radius_px).copied().collect();
    list.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    let (mut rings, mut lines): (Vec<Candidate>, Vec<Candidate>) = Default::default();
    for c in list.iter().take(16) {
        let shares_center = |o: &&Candidate| shares_center(o, c);
        // A halo is much fainter than the ring it surrounds.
        let strongest = (all.iter().filter(shares_center))
            .filter(|o| o.step * c.step > 0.0 && o.circle.radius > 0.6 * c.circle.radius)
            .map(|o| o.step.abs())
            .fold(0.0, f64::max);
        let is_line = self::is_line(look, c);
        let outermost = (all.iter().filter(shares_center))
            .filter(|o| o.circle.radius > 0.6 * c.circle.radius)
            .filter(|o| o.step.abs() > HALO * strongest)
            .filter(|o| is_line || !self::is_line(look, o))
            .max_by(|a, b| a.circle.radius.total_cmp(&b.circle.radius))
            .unwrap_or(c);
        let known = |r: &Candidate| {
            is_concentric(r, outermost)
                && (r.circle.radius / outermost.circle.radius - 1.0).abs() < 0.05
        };
        let list = if is_line { &mut lines } else { &mut rings };
        if !list.iter().any(known) {
            list.push(*outermost);
        }
    }
    let zones = rings.len();
    rings.extend(lines);
    Rings { all: rings, zones }
}

/// Whether a circle is no burn's ring but scribed or drawn.
fn is_line(look: &Look, c: &Candidate) -> bool {
    /// Width in radii: a burn's zones are wider.
    const WIDEST: f64 = 0.04;
    find::is_line(look, c.circle, WIDEST)
}

/// Whether another edge has a candidate's centre, and is about as well seen.
fn shares_center(o: &Candidate, c: &Candidate) -> bool {
    is_concentric(o, c)
        && (o.circle.center - c.circle.center).norm()
            < 0.02 * c.circle.radius + c.scatter_px + o.scatter_px
        && is_as_clear(o, c)
}

/// Edges about one centre, a ring's own included: a burn's ring and spot have two each.
const MOST_EDGES: usize = 6;
/// What counts as such an edge has this part of the ring's step.
const EDGE_STEP: f64 = 0.3;

/// Whether a spot stands out from the bands about a ring's centre, where there are many.
pub(super) fn beats_bands(spot: &Candidate, ring: &Candidate, all: &[Candidate]) -> bool {
    /// Step of a band as a part of the spot's, at most.
    const FAINTER: f64 = 0.8;
    let is_itself = |o: &Candidate| {
        o.step * spot.step > 0.0 && (o.circle.radius / spot.circle.radius - 1.0).abs() < 0.3
    };
    let bands: Vec<f64> = (all.iter())
        .filter(|o| shares_center(o, ring) && o.circle.radius < 0.97 * ring.circle.radius)
        .filter(|o| !is_itself(o))
        .map(|o| o.step.abs())
        .collect();
    let strong = |step: &&f64| **step > EDGE_STEP * ring.step.abs();
    bands.iter().filter(strong).count() < MOST_EDGES - 1
        || bands.iter().all(|step| *step < FAINTER * spot.step.abs())
}

/// Whether a ring is one of many bands about its centre, as ripples and strong tints have.
pub(super) fn is_rippled(look: &Look, ring: &Candidate, all: &[Candidate]) -> bool {
    /// Edges within a burn's zones do not make it ripples where its own is so much clearer, as a part of its step, and the last.
    const CLEAREST: f64 = 0.75;
    const LAST: f64 = 0.15;
    /// The same beyond the ring.
    const MOST_BEYOND: usize = 1;
    const BEYOND_STEP: f64 = 0.4;
    /// Swings of the mean level beyond it, by such a part of its step: a halo has two.
    const MOST_SWINGS: usize = 4;
    const SWING: f64 = 0.6;
    let rivals = |part: f64, least_radius_px: f64| {
        let counts = |o: &&Candidate| {
            shares_center(o, ring)
                && o.step.abs() > part * ring.step.abs()
                && o.circle.radius > least_radius_px
        };
        all.iter().filter(counts).count()
    };
    let ends = || rivals(CLEAREST, 0.0) <= 1 && rivals(LAST, 1.02 * ring.circle.radius) == 0;
    (rivals(EDGE_STEP, 0.0) > MOST_EDGES && !ends())
        || rivals(BEYOND_STEP, 1.02 * ring.circle.radius) > MOST_BEYOND
        || find::swings_beyond(look, ring.circle, SWING * ring.step.abs()) > MOST_SWINGS
}

/// Another ring beside this one, of nearly the same standing or with a spot of its own.
pub(super) fn second_burn<'a>(
    look: &Look,
    rings: &'a [Candidate],
    first: &Candidate,
) -> Option<&'a Candidate> {
    /// Step of a second burn as a part of the first one's, at least.
    const LEAST_STEP: f64 = 0.2;
    // Both are burnt into one plate: a glare is bright where a burn is dark, the grooves of a turned plate are fainter.
    let burnt = |r: &&Candidate| r.step / first.step > LEAST_STEP;
    rings.iter().filter(burnt).find(|r| {
        let apart = (r.circle.center - first.circle.center).norm();
        let other = apart > 0.9 * (r.circle.radius + first.circle.radius)
            && (0.6..1.7).contains(&(r.circle.radius / first.circle.radius))
            && r.scatter_px < 2.0 * first.scatter_px + 2.0;
        let rivals = r.score > 0.6 * first.score && r.coverage > 0.8;
        let has_spot = || {
            let is_dot = |c: &Candidate| dirt::is_dot(&c.circle, &r.circle);
            let spot = |c: &Candidate| c.coverage > 0.75 && c.score > 0.15 * r.score && !is_dot(c);
            r.score > 0.2 * first.score
                && r.coverage > 0.7
                && spots::candidates(look, r, &[**r], &spots::PLACES[0]).first().is_some_and(spot)
        };
        other && (rivals || has_spot())
    })
}

/// Whether an arc's step drowns in what its surface does by itself: texture has such arcs.
fn is_texture(ring: &Ring) -> bool {
    /// Of the noise of a pixel, texture included.
    const DROWNED: f64 = 0.4;
    ring.arc_coverage < spot::PARTLY && ring.contrast.abs() < DROWNED * ring.noise
}

/// Why a circle is not a burn's ring that can be used.
pub(super) enum Flaw {
    /// Its edge does not tell where it is.
    Unsure,
    /// It is a lamp's reflection.
    Lamp,
    /// It is one of many bands.
    Ripples,
    /// It is something else.
    Other,
}

/// Measures a ring with the edges about it and its likeliest spot.
pub(super) fn measure(
    (frame, look): (&Frame, &Look),
    view: &View,
    outer: &Candidate,
    edges: &[Candidate],
    spot: Candidate,
) -> Result<Ring, Flaw> {
    let mut others = edges.to_vec();
    others.push(spot);
    let light = look.light.filter(|light| light.is_sure);
    let is_round = |ring: &Ring| RING.allow(ring, view) && !is_polygon(ring) && !is_texture(ring);
    let (rough, search) = around(view, outer, &others);
    let found = ring::measure(frame, view, rough, search.burnt(light), None).filter(is_round);
    let ring = found.filter(|ring| !strayed(ring, outer, view)).ok_or(Flaw::Other)?;
    if !limits(&ring).trust(&ring) {
        return Err(Flaw::Unsure);
    }
    let measure_inner = |c: Candidate| {
        let (rough, mut search) = around(view, &c, &others);
        // Inside an annulus the spot's edge may be the stronger one.
        let clear_px = spots::clear_px(&c.circle, &spot.circle, spot.softness_px);
        search.inside_limit_px = search.inside_limit_px.min(clear_px.max(3.0));
        ring::measure(frame, view, rough, search.burnt(light), None)
    };
    let inner = inner_edge(outer, edges).and_then(measure_inner).filter(|inner| {
        let is_inner = (INNER.start..0.98).contains(&(inner.circle.radius / ring.circle.radius));
        is_round(inner)
            && limits(inner).trust(inner)
            && is_inner
            && inner.contrast * ring.contrast < 0.0
    });
    let is_annulus = inner.is_some();
    let ring = match inner {
        Some(inner) => concentric::join(ring, &inner, view),
        None => ring,
    };
    let ring = ring.banded(bands::strongest_beyond(outer, edges), view.pixel_mm());
    if is_lamp(&ring, is_annulus, view) {
        Err(Flaw::Lamp)
    } else if limits(&ring).trust(&ring) {
        Ok(ring)
    } else {
        Err(Flaw::Unsure)
    }
}

/// The inner edge of an annulus: of the opposite sense, steady, and as clear as the outer one.
fn inner_edge(outer: &Candidate, edges: &[Candidate]) -> Option<Candidate> {
    edges
        .iter()
        .filter(|c| {
            c.step * outer.step < 0.0
                && INNER.contains(&(c.circle.radius / outer.circle.radius))
                && c.score > 0.4 * outer.score
                && (c.circle.center - outer.circle.center).norm()
                    < 0.02 * outer.circle.radius + c.scatter_px + outer.scatter_px
        })
        .max_by(|a, b| a.score.total_cmp(&b.score))
        .copied()
}

/// Whether another edge was followed in part than the one that was found: where light falls off there is one at any radius.
fn strayed(ring: &Ring, outer: &Candidate, view: &View) -> bool {
    /// Of the radius.
    const FAR: f64 = 0.12;
    const WHOLE: f64 = 0.85;
    (ring.circle.radius / ring::in_plane(view, outer.circle).radius - 1.0).abs() > FAR
        && ring.arc_coverage < WHOLE
}

/// Whether a ring is a lamp's reflection: it lies far behind the plate, so it is soft where the plate is in focus, and clips. A light
/// annulus that is overexposed is about as sharp as burns are.
fn is_lamp(ring: &Ring, is_annulus: bool, view: &View) -> bool {
    /// Softness over the radius.
    const SHARP: f64 = 0.05;
    let softness = ring.softness_px * view.pixel_mm() / ring.circle.radius;
    ring.clipped_inside && ring.softness_px > SHARP_PX && !(is_annulus && softness < SHARP)
}
