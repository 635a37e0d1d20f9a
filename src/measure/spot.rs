//! The spot of a burn test: circles inside the ring that may be it, and the one that is measured.

use std::ops::Range;

use nalgebra::Vector2;

use crate::camera::View;
use crate::edge::wrap;
use crate::find::{self, Candidate, Look};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::dirt::{DOT_RADIUS, DOTS, MIDDLE, SPOTS, is_beside, is_dirt_on, is_like};
use crate::measure::limits::{Limits, SOFT_BROKEN, glow, is_steady};
use crate::measure::points::Search;
use crate::measure::polygon::is_polygon;
use crate::measure::ring::{self, Ring};

/// Where a spot is looked for, and how large, in the ring's radii.
pub(super) struct Place {
    /// Farthest from the ring's centre.
    reach: f64,
    /// Radii of circles that are looked for.
    radii: Range<f64>,
    /// Radii of spots as measured: beyond is the inner edge of an annulus, or a ripple.
    measured: Range<f64>,
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
/// A large one is as sharp as the ring, to a pixel, as the ring's own zones are softer: its softness as a part of the ring's, at most.
const LARGE_SOFT: f64 = 1.1;
/// And burnt as the ring is: its step as a part of the ring's, at least.
const LARGE_STEP: f64 = 0.25;
/// But off the ring's centre by this part of its radius it is no zone of the ring's, and may be fainter.
const LARGE_OFF: f64 = 0.1;
/// Far out, large or tiny it must be found whole, to this part: what touches an annulus' edges on two sides looks like a circle, too.
pub(super) const WHOLE: f64 = 0.9;
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
/// Where the spot lies on the ring's edge its own is followed over two grounds, and is twice as uncertain.
const ON_EDGE: f64 = 2.0;
/// How far inside a spot's edge is looked, in radii, where all of it led to another edge.
const CRATER: f64 = 0.4;
/// As soft as this part of its radius a circle may well be a glare instead of a spot.
const GLARE: f64 = 0.3;
/// A glare adds a bump of light: measured it is 0.4 to 0.6 of its radius soft, as no light spot is (less where it is clipped). So soft, what is
/// lighter than its surroundings so far from the ring's centre (in its radii) is one.
const BUMP_SOFT: f64 = 0.35;
const BUMP_FAR: f64 = 0.15;
/// A spot whose step is so small a part of the ring's may as well be the burn's own texture: it must be whole and all the surer.
const FAINT: f64 = 0.15;
/// How many softnesses edges of ring and spot end apart.
const CLEAR: f64 = 2.5;
/// Score of what may stand for a spot that cannot be measured, as a part of that spot's.
const AS_CLEAR: f64 = 0.2;
/// How many softnesses either side of its edge a spot is looked at where more leads astray, in turn.
const NEARBY: [f64; 2] = [4.0, 2.5];
/// Such a look must keep the circle that was found: how far off its centre may be, in radii, and the radius in the found one.
const SAME_CENTER: f64 = 0.3;
const SAME_RADIUS: Range<f64> = 0.75..1.35;
/// What a spot must keep to, and one that is seen in part or faint.
const SPOT: Limits = Limits { coverage: 0.5, form: 0.1, doubt: 0.15, in_all: 0.15 };
const PART: Limits = Limits { doubt: 0.02, ..SPOT };
/// One that is whole and so clear (contrast over noise, texture included) may be rather oval or ragged.
const CLEARLY: f64 = 5.0;
const OVAL: Limits = Limits { form: 0.15, ..SPOT };
/// Of ring and spot one at least is seen to this part, the ring if the spot is large or tiny.
pub(super) const PARTLY: f64 = 0.8;
/// A gap that hides both: at least this share of what is not seen of the spot looks out on a gap of the ring.
const ONE_GAP: f64 = 0.5;
/// How far round the ring, to either side, is looked whether it has a gap there.
const GAP_RAD: f64 = 0.15;

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
fn may_stand_for(likeliest: &Candidate, c: &Candidate, ring: &Candidate) -> bool {
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
fn may_end(inner: &Circle, ring: &Circle, slack: f64) -> bool {
    inner.radius > OWN_RADIUS * ring.radius
        && (inner.center - ring.center).norm() < OWN_OFF * ring.radius + slack
}

/// Whether an annulus of that step ends at another of the `edges`, clear of a radius (px): the bare plate is seen within.
fn ends_farther_out(edges: &[Candidate], ring: &Circle, step: f64, radius_px: f64) -> bool {
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

/// Whether two circles' outlines meet, or come as close as `reach_px`.
fn cross(large: &Circle, small: &Circle, reach_px: f64) -> bool {
    ((large.center - small.center).norm() - large.radius).abs() < small.radius + reach_px
        && large.radius > 1.5 * small.radius
}

/// A picture in which a ring was measured, and the edges about it.
pub(super) struct Inside<'a> {
    pub frame: &'a Frame,
    pub view: &'a View,
    pub ring: &'a Ring,
    pub edges: &'a [Candidate],
    pub place: &'a Place,
}

impl Inside<'_> {
    /// Measures the likeliest of the spots that stand out, or what may stand for it.
    pub(super) fn measure_likeliest<'c>(
        &self,
        clear: impl Iterator<Item = &'c Candidate>,
        outer: &Candidate,
    ) -> Option<Ring> {
        let mut clear = clear.peekable();
        let likeliest = clear.peek().copied();
        let found = clear
            .filter(|s| likeliest.is_some_and(|l| may_stand_for(l, s, outer)))
            .enumerate()
            .find_map(|(nth, s)| {
                // What is likeliest is not left for what is easier to measure.
                let nearby = || if nth == 0 { self.measure_nearby(s) } else { None };
                self.measure(s).or_else(nearby)
            })?;
        Some(self.within_halo(&found).unwrap_or(found))
    }

    /// Measures a spot, looking as far to both sides of its edge as there is anything to learn.
    fn measure(&self, spot: &Candidate) -> Option<Ring> {
        let (rough, search) = self.search(spot);
        let mut found = self.look(spot, rough, search)?;
        if strayed(&found, rough) {
            // A crater's inner edge may be the stronger one.
            let inside_limit_px = CRATER * spot.circle.radius;
            found = self.look(spot, rough, Search { inside_limit_px, ..search })?;
        }
        self.is_spot(&found, rough).then_some(found)
    }

    /// The same where a glare, a gap or dirt beside the spot has led astray: no farther from its edge than it takes, and to no
    /// other circle.
    fn measure_nearby(&self, spot: &Candidate) -> Option<Ring> {
        let (rough, search) = self.search(spot);
        for softnesses in NEARBY {
            let Some(found) = self.look(spot, rough, search.nearby(softnesses)) else { continue };
            // From nearer still a glare's foot is not seen, and it seems sharp.
            if self.is_glare(&found) {
                return None;
            }
            let same = (found.circle.center - rough.center).norm() < SAME_CENTER * rough.radius
                && SAME_RADIUS.contains(&(found.circle.radius / rough.radius));
            if same && self.is_spot(&found, rough) {
                return Some(found);
            }
        }
        None
    }

    /// Where it is in the plane, and where its edge is looked for.
    fn search(&self, spot: &Candidate) -> (Circle, Search) {
        // The spot's band ends where the ring's next edge begins.
        let clear_px = (self.edges.iter())
            .filter(|c| c.circle.radius > 1.5 * spot.circle.radius)
            .map(|c| clear_px(&c.circle, &spot.circle, c.softness_px))
            .fold(f64::INFINITY, f64::min);
        let c = spot.circle;
        let rough = Circle {
            center: self.view.to_plane(c.center),
            radius: c.radius * self.view.pixel_mm_at(c.center),
        };
        let search = Search {
            reach_px: (3.0 * spot.scatter_px).clamp(3.0, 0.3 * c.radius + 3.0),
            inside_limit_px: 0.95 * c.radius,
            outside_limit_px: clear_px.clamp(0.4 * c.radius + 4.0, 4.0 * c.radius),
            softness_px: spot.softness_px.max(1.5),
            // It lies on what is burnt already.
            tinted: false,
        };
        (rough, search)
    }

    fn look(&self, spot: &Candidate, rough: Circle, search: Search) -> Option<Ring> {
        let wander = Some(&self.ring.wander);
        let mut found = ring::measure(self.frame, self.view, rough, search, wander)?;
        let strong = |e: &&Candidate| e.step.abs() > 0.3 * self.ring.contrast.abs();
        let reach_px = 2.0 * found.softness_px;
        if self.edges.iter().filter(strong).any(|e| cross(&e.circle, &spot.circle, reach_px)) {
            found.covariance *= ON_EDGE * ON_EDGE;
        }
        Some(found)
    }

    /// Whether a large circle is whole, sharp and burnt enough for a spot.
    fn is_clearly_burnt(&self, found: &Ring) -> bool {
        let off_mm = (found.circle.center - self.ring.circle.center).norm();
        let least_step =
            if off_mm > LARGE_OFF * self.ring.circle.radius { FAINT } else { LARGE_STEP };
        found.arc_coverage > WHOLE
            && found.softness_px < LARGE_SOFT * self.ring.softness_px + 1.0
            && (found.contrast / self.ring.contrast).abs() > least_step
    }

    /// Whether what lies far out is light that the plate throws back.
    fn is_glare(&self, found: &Ring) -> bool {
        let ring = self.ring.circle;
        let is_far = (found.circle.center - ring.center).norm() > BUMP_FAR * ring.radius;
        let least = if found.clipped_inside { SOFT_BROKEN } else { BUMP_SOFT };
        let softness = found.softness_px * self.view.pixel_mm() / found.circle.radius;
        found.contrast < 0.0 && is_far && softness > least
    }

    pub(super) fn is_spot(&self, found: &Ring, rough: Circle) -> bool {
        let ring = self.ring.circle;
        let apart = (found.circle.center - ring.center).norm() / ring.radius;
        let size = found.circle.radius / ring.radius;
        let ring_px = Circle {
            center: self.ring.center_px,
            radius: ring.radius / self.view.pixel_mm_at(ring.center),
        };
        let is_rings_own = found.contrast * self.ring.contrast < 0.0
            && may_end(&found.circle, &ring, 0.0)
            && !ends_farther_out(self.edges, &ring_px, self.ring.contrast, size * ring_px.radius);
        // Of letters, screws and scratches a part may be round: what is seen in part must be all the surer, but where texture makes it
        // unsure or the ring ends with it.
        let in_part = found.arc_coverage < PARTLY && hidden_share(self.ring, found) < ONE_GAP;
        let is_faint = (found.contrast / self.ring.contrast).abs() < FAINT;
        let unsure = (in_part && found.form_from_texture_mm == 0.0) || is_faint;
        let clear = found.contrast.abs() > CLEARLY * found.noise && found.arc_coverage > WHOLE;
        let limits = match (unsure, clear) {
            (true, _) => &PART,
            (false, true) => &OVAL,
            (false, false) => &SPOT,
        };
        limits.are_kept(found, self.view)
            && self.place.measured.contains(&size)
            && apart < 1.0
            && !(is_faint && found.arc_coverage < WHOLE)
            && !self.is_glare(found)
            && (size < PLACES[0].measured.end || self.is_clearly_burnt(found))
            && !is_rings_own
            && (self.ring.arc_coverage >= PARTLY
                || !(in_part
                    || size > PLACES[0].measured.end
                    || self.place.near && !(clear && apart < MIDDLE)))
            && !is_polygon(found)
            && !strayed(found, rough)
    }
}

/// Share of what is not seen of a spot's edge that looks out on a gap of the ring.
fn hidden_share(ring: &Ring, spot: &Ring) -> f64 {
    let turns: Vec<(f64, bool)> = (ring.trace.iter())
        .map(|(p, seen)| ((p - ring.center_px).y.atan2((p - ring.center_px).x), *seen))
        .collect();
    let radius_px =
        (ring.trace.iter()).map(|(p, _)| (p - ring.center_px).norm()).fold(0.0, f64::max);
    let is_gap = |p: &Vector2<f64>| {
        // Where the ray from the spot's centre through its edge meets the ring.
        let (from, way) = (spot.center_px - ring.center_px, (p - spot.center_px).normalize());
        let along = from.dot(&way);
        let end = (along * along - from.norm_squared() + radius_px * radius_px).max(0.0).sqrt();
        let out = from + way * (end - along);
        let angle = out.y.atan2(out.x);
        let near = turns.iter().filter(|(turn, _)| wrap(turn - angle).abs() < GAP_RAD);
        let (all, seen) = near.fold((0, 0), |(a, s), (_, seen)| (a + 1, s + usize::from(*seen)));
        2 * seen <= all
    };
    let unseen: Vec<_> = spot.trace.iter().filter(|(_, seen)| !seen).map(|(p, _)| p).collect();
    unseen.iter().filter(|p| is_gap(p)).count() as f64 / unseen.len().max(1) as f64
}

/// Whether another edge was followed than the one that was found.
fn strayed(found: &Ring, rough: Circle) -> bool {
    (found.circle.radius / rough.radius - 1.0).abs() >= 0.5
}
