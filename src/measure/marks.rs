//! The ring and the spot in a burn test's picture: which circles they are, and both measured.

use nalgebra::Vector2;

use crate::camera::View;
use crate::error::{Error, Result};
use crate::find::{self, Candidate, Look, Sides};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::bands::{self, is_as_clear, is_concentric};
use crate::measure::concentric;
use crate::measure::expected::{around, measure_candidate};
use crate::measure::points::SHARP_PX;
use crate::measure::polygon::is_polygon;
use crate::measure::ring::{self, Ring};
use crate::measure::spot;

/// Rings that are tried, and spots inside each.
const TRIES: usize = 4;
/// A ring's step as a part of another's that has no spot.
const FAINT: f64 = 0.05;
/// A halo's step as a part of that of the ring that it surrounds, at most.
const HALO: f64 = 0.5;
/// Score of a circle as a part of a clearer one's beside which it is no mark.
const LESS_CLEAR: f64 = 0.5;
/// So soft, as a part of its radius, the edge of what is clipped inside is a glare's: where it is broken, and where it is whole.
pub(super) const CLIPPED_SOFT: (f64, f64) = (0.1, 0.2);
const WHOLE: f64 = 0.95;
/// Radius of an annulus' inner edge as a part of the outer one's.
const INNER: (f64, f64) = (0.5, 0.97);
/// What a mark must keep to: a burn may be ragged, but a glare's border is no circle, and lines of texture that happen
/// to lie about one do not say where it is.
pub(super) struct Limits {
    pub coverage: f64,
    /// Its own form (rms) as a part of its radius; less where less of it is seen.
    pub form: f64,
    /// The standard deviation of its centre, as far as its edge tells it, as a part of its radius.
    pub doubt: f64,
    /// The same with what a tint may have moved it: a glare fades away all round, and what is left says little.
    pub in_all: f64,
}
const RING: Limits = Limits { coverage: 0.35, form: 0.05, doubt: 0.02, in_all: 0.1 };

/// Ring, spot and what a user should know.
pub(super) type Marks = (Ring, Ring, Vec<String>);

/// Finds and measures both. `near_mm` tells one of several test burns from the others.
pub(super) fn measure(
    frame: &Frame,
    view: &View,
    near_mm: Option<[f64; 2]>,
    subject: &str,
) -> Result<Marks> {
    let look = find::look(frame);
    let side = frame.width().max(frame.height()) as f64;
    let near = near_mm.map(|p| (view.to_pixel(Vector2::from(p)), 0.1 * side));
    let all = find::circles(
        &look,
        find::Options {
            least_radius_px: 0.02 * side,
            most_radius_px: 0.6 * side,
            near,
            least_coverage: 0.35,
            centers: 8,
            known: &[],
        },
    );
    let steady: Vec<Candidate> = all.into_iter().filter(is_steady).collect();
    let rings = ring_candidates(&steady, 0.06 * side);
    // Of the clearest ring without a spot.
    let mut lone_step = 0.0f64;
    // Those that are none.
    let mut refused: Vec<&Candidate> = Vec::new();
    let mut rippled = false;
    // Lamps' reflections: what is seen in them is the lamp's.
    let mut lamps: Vec<&Candidate> = Vec::new();
    for outer in rings.iter().take(TRIES) {
        // Beside a clear circle the faintest ones are no rings, and what is much fainter about one that is none is its halo.
        let refused_step = refused.iter().map(|r| r.step.abs()).fold(lone_step, f64::max);
        if outer.step.abs() < FAINT * refused_step {
            continue;
        }
        if refused.iter().any(|r| is_concentric(r, outer) && outer.step.abs() < HALO * r.step.abs())
        {
            rippled = true;
            continue;
        }
        if lamps.iter().any(|l| l.circle.distance(outer.circle.center) < 0.0) {
            continue;
        }
        let stands_out = |c: &Candidate, sides: Sides| {
            let least_step = 0.3 * outer.step.abs();
            // What runs along ring and spot in turn looks like a circle too: beside a clear spot it is no mark.
            let is_mark = |e: &&Candidate| {
                let clear = e.score > LESS_CLEAR * c.score || is_concentric(e, outer);
                clear || matches!(sides, Sides::Edge)
            };
            let others = (steady.iter().filter(is_mark))
                .filter(|e| e.step.abs() > least_step && !alike(e, c));
            let others: Vec<Circle> = others.map(|e| e.circle).collect();
            find::stands_out(&look, c, sides, &others) == Some(true)
        };
        if !stands_out(outer, Sides::Edge) {
            continue;
        }
        if find::is_folded(&look, outer) {
            refused.push(outer);
            continue;
        }
        if is_rippled(outer, &steady) {
            rippled = true;
            refused.push(outer);
            continue;
        }
        let edges: Vec<Candidate> =
            steady.iter().filter(|c| is_concentric(c, outer)).copied().collect();
        let spots_at = |place| (place, spot::candidates(&look, outer, &edges, place));
        let mut looks = spot::PLACES.iter().map(spots_at).filter(|(_, s)| !s.is_empty()).peekable();
        if looks.peek().is_none() {
            lone_step = lone_step.max(outer.step.abs());
            continue;
        }
        if near_mm.is_none()
            && let Some(other) = second_burn(&look, &rings, outer)
        {
            return Err(two_burns(subject, outer, other));
        }
        let mut is_lone = false;
        for (place, spots) in looks {
            let Some(ring) = measure_ring(frame, view, outer, &edges, spots[0]) else { break };
            if is_lamp(&ring) {
                lamps.push(outer);
                break;
            }
            let inside = spot::Inside { frame, view, ring: &ring, edges: &edges, place };
            let clear = spots.iter().filter(|s| stands_out(s, Sides::Disc)).take(TRIES);
            if let Some(spot) = inside.measure_likeliest(clear, outer) {
                let warnings = warnings(&ring, &spot);
                return Ok((ring, spot, warnings));
            }
            is_lone = true;
        }
        if is_lone {
            lone_step = lone_step.max(outer.step.abs());
            break; // The ring is there; a worse one with a better spot would be a wrong answer.
        }
        refused.push(outer);
    }
    Err(if lone_step > 0.0 {
        Error::measure(
            subject,
            "a ring was found, but no spot inside it that is clear enough to measure",
            "burn the spot (100 W from 1-5 mm) and photograph again, lit so that no glare covers it",
        )
    } else if !lamps.is_empty() {
        Error::measure(
            subject,
            "the circle about the likeliest spot is soft and as bright as the camera can tell: a lamp's reflection, or a burn that is overexposed",
            "shade the lamp or move it, and expose less",
        )
    } else if rippled {
        Error::measure(
            subject,
            "the circles about one centre are ripples or bands of tint, about as strong as each other: which is the ring's edge cannot be told",
            "wipe the tint off the plate, or light and expose so that the burn is darker than its bands",
        )
    } else {
        Error::measure(
            subject,
            "no ring was found",
            "check that the whole ring is in the picture, in focus and darker or brighter than the plate",
        )
    })
}

/// What about two marks makes them less sure.
fn warnings(ring: &Ring, spot: &Ring) -> Vec<String> {
    let seen = 100.0 * ring.arc_coverage;
    let gap = (seen < 60.0).then(|| format!("only {seen:.0} % of the ring's edge was found"));
    let clipped = [("ring", ring), ("spot", spot)].map(|(name, mark)| mark.clip_warning(name));
    gap.into_iter().chain(clipped.into_iter().flatten()).collect()
}

fn two_burns(subject: &str, one: &Candidate, other: &Candidate) -> Error {
    let (a, b) = (one.circle.center, other.circle.center);
    Error::measure(
        subject,
        format!(
            "shows two test burns, near pixel ({:.0}, {:.0}) and ({:.0}, {:.0})",
            a.x, a.y, b.x, b.y
        ),
        "say which one with --near-mm X,Y (plane mm), or crop the picture",
    )
}

/// Whether a candidate's edge runs along its circle rather than wandering about it.
pub(super) fn is_steady(c: &Candidate) -> bool {
    c.scatter_px < 0.035 * c.circle.radius + 4.0 && c.step.abs() > 0.0
}

/// Whether what was measured is a circle with some ragged edge rather than something else.
pub(super) fn is_circle(ring: &Ring, view: &View, limits: &Limits) -> bool {
    let radius_mm = ring.circle.radius;
    let softness = ring.softness_px * view.pixel_mm() / radius_mm;
    let whole = ring.arc_coverage > WHOLE;
    let glare =
        ring.clipped_inside && softness > if whole { CLIPPED_SOFT.1 } else { CLIPPED_SOFT.0 };
    let form2 = ring.form_rms_mm.powi(2) - ring.form_from_texture_mm.powi(2);
    !glare
        && ring.arc_coverage >= limits.coverage
        && form2.max(0.0).sqrt() < limits.form * ring.arc_coverage.powi(2) * radius_mm
        && ring.fitted_sd_mm < limits.doubt * radius_mm
        && ring.center_covariance().trace().sqrt() < limits.in_all * radius_mm
}

/// How much of a mark an edge is: strong, well covered, long; a burn's is as good as a sharper one's unless it is as soft as
/// the border of a lamp's light.
fn strength(c: &Candidate) -> f64 {
    let radius = c.circle.radius;
    (c.step.abs() * radius).sqrt() * c.coverage / (1.0 + 0.1 * c.scatter_px) / glow(c, 0.1)
}

/// How much less a circle counts for being soft: by half where its softness is this part of its radius.
pub(super) fn glow(c: &Candidate, part: f64) -> f64 {
    1.0 + (c.softness_px / (part * c.circle.radius)).powi(2)
}

/// Likely rings, best first; of concentric edges the outermost strong one.
fn ring_candidates(all: &[Candidate], least_radius_px: f64) -> Vec<Candidate> {
    let mut list: Vec<Candidate> =
        all.iter().filter(|c| c.circle.radius > least_radius_px).copied().collect();
    list.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    let mut rings: Vec<Candidate> = Vec::new();
    for c in list.iter().take(16) {
        let shares_center = |o: &&Candidate| shares_center(o, c);
        // A halo is much fainter than the ring it surrounds.
        let strongest = (all.iter().filter(shares_center))
            .filter(|o| o.step * c.step > 0.0 && o.circle.radius > 0.6 * c.circle.radius)
            .map(|o| o.step.abs())
            .fold(0.0, f64::max);
        let outermost = (all.iter().filter(shares_center))
            .filter(|o| o.circle.radius > 0.6 * c.circle.radius)
            .filter(|o| o.step.abs() > HALO * strongest)
            .max_by(|a, b| a.circle.radius.total_cmp(&b.circle.radius))
            .unwrap_or(c);
        let known = |r: &Candidate| {
            is_concentric(r, outermost)
                && (r.circle.radius / outermost.circle.radius - 1.0).abs() < 0.05
        };
        if !rings.iter().any(known) {
            rings.push(*outermost);
        }
    }
    rings
}

/// Whether another edge has a candidate's centre, and is about as well seen.
fn shares_center(o: &Candidate, c: &Candidate) -> bool {
    is_concentric(o, c)
        && (o.circle.center - c.circle.center).norm()
            < 0.02 * c.circle.radius + c.scatter_px + o.scatter_px
        && is_as_clear(o, c)
}

/// Whether a ring is one of many bands about its centre, as ripples and strong tints have: a burn's ring and spot have two edges each.
fn is_rippled(ring: &Candidate, all: &[Candidate]) -> bool {
    /// Edges about the centre, the ring's own included, with such a part of its step.
    const MOST: (usize, f64) = (6, 0.3);
    /// The same beyond the ring.
    const MOST_BEYOND: (usize, f64) = (1, 0.4);
    let rivals = |part: f64, least_radius_px: f64| {
        let counts = |o: &&Candidate| {
            shares_center(o, ring)
                && o.step.abs() > part * ring.step.abs()
                && o.circle.radius > least_radius_px
        };
        all.iter().filter(counts).count()
    };
    rivals(MOST.1, 0.0) > MOST.0 || rivals(MOST_BEYOND.1, 1.02 * ring.circle.radius) > MOST_BEYOND.0
}

/// Whether two may be one edge, seen twice.
fn alike(a: &Candidate, b: &Candidate) -> bool {
    (a.circle.radius / b.circle.radius - 1.0).abs() < 0.15 && a.step * b.step > 0.0
}

/// Another ring beside this one, of nearly the same standing or with a spot of its own.
fn second_burn<'a>(
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
            let spot = |c: &Candidate| c.coverage > 0.75 && c.score > 0.15 * r.score;
            r.score > 0.2 * first.score
                && r.coverage > 0.7
                && spot::candidates(look, r, &[**r], &spot::PLACES[0]).first().is_some_and(spot)
        };
        other && (rivals || has_spot())
    })
}

/// Whether a ring is a lamp's reflection: it lies far behind the plate, so it is soft where the plate is in focus, and clips.
fn is_lamp(ring: &Ring) -> bool {
    ring.clipped_inside && ring.softness_px > SHARP_PX
}

/// Whether an arc's step drowns in what its surface does by itself: texture has such arcs.
fn is_texture(ring: &Ring) -> bool {
    /// Of the noise of a pixel, texture included.
    const DROWNED: f64 = 0.4;
    ring.arc_coverage < spot::PARTLY && ring.contrast.abs() < DROWNED * ring.noise
}

fn measure_ring(
    frame: &Frame,
    view: &View,
    outer: &Candidate,
    edges: &[Candidate],
    spot: Candidate,
) -> Option<Ring> {
    let mut others = edges.to_vec();
    others.push(spot);
    let good = |ring: &Ring| is_circle(ring, view, &RING) && !is_polygon(ring) && !is_texture(ring);
    let ring = measure_candidate(frame, view, outer, &others).filter(good)?;
    let measure_inner = |c: Candidate| {
        let (rough, mut search) = around(view, &c, &others);
        // Inside an annulus the spot's edge may be the stronger one.
        let clear_px = spot::clear_px(&c.circle, &spot.circle, spot.softness_px);
        search.inside_limit_px = search.inside_limit_px.min(clear_px.max(3.0));
        ring::measure(frame, view, rough, search, None)
    };
    let inner = inner_edge(outer, edges).and_then(measure_inner).filter(|inner| {
        let is_inner = (INNER.0..0.98).contains(&(inner.circle.radius / ring.circle.radius));
        good(inner) && is_inner && inner.contrast * ring.contrast < 0.0
    });
    let ring = match inner {
        Some(inner) => concentric::join(ring, &inner),
        None => ring,
    };
    Some(ring.banded(bands::strongest_beyond(outer, edges), view.pixel_mm()))
}

/// The inner edge of an annulus: of the opposite sense, steady, and as clear as the outer one.
fn inner_edge(outer: &Candidate, edges: &[Candidate]) -> Option<Candidate> {
    edges
        .iter()
        .filter(|c| {
            c.step * outer.step < 0.0
                && (INNER.0..INNER.1).contains(&(c.circle.radius / outer.circle.radius))
                && c.score > 0.4 * outer.score
                && (c.circle.center - outer.circle.center).norm()
                    < 0.02 * outer.circle.radius + c.scatter_px + outer.scatter_px
        })
        .max_by(|a, b| a.score.total_cmp(&b.score))
        .copied()
}
