//! The spot of a burn test measured inside its ring, and whether what was measured is one.

use std::ops::Range;

use nalgebra::Vector2;

use crate::camera::View;
use crate::edge::wrap;
use crate::find::Candidate;
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::dirt::MIDDLE;
use crate::measure::limits::{Limits, SOFT_BROKEN};
use crate::measure::points::Search;
use crate::measure::polygon::is_polygon;
use crate::measure::ring::{self, Ring};
use crate::measure::spots::{PLACES, Place, clear_px, ends_farther_out, may_end, may_stand_for};

/// A large one is as sharp as the ring, to a pixel, as the ring's own zones are softer: its softness as a part of the ring's, at most.
const LARGE_SOFT: f64 = 1.1;
/// And burnt as the ring is: its step as a part of the ring's, at least.
const LARGE_STEP: f64 = 0.25;
/// But off the ring's centre by this part of its radius it is no zone of the ring's, and may be fainter.
const LARGE_OFF: f64 = 0.1;
/// Far out, large or tiny it must be found whole, to this part: what touches an annulus' edges on two sides looks like a circle, too.
pub(super) const WHOLE: f64 = 0.9;
/// Where the spot lies on the ring's edge its own is followed over two grounds, and is twice as uncertain.
const ON_EDGE: f64 = 2.0;
/// How far inside a spot's edge is looked, in radii, where all of it led to another edge.
const CRATER: f64 = 0.4;
/// A glare adds a bump of light: measured it is 0.4 to 0.6 of its radius soft, as no light spot is (less where it is clipped). So soft, what is
/// lighter than its surroundings so far from the ring's centre (in its radii) is one.
const BUMP_SOFT: f64 = 0.35;
const BUMP_FAR: f64 = 0.15;
/// So is what does not tell how large it is: standard deviation of its radius, in radii.
const VAGUE: f64 = 0.05;
/// A spot whose step is so small a part of the ring's may as well be the burn's own texture: it must be whole and all the surer.
const FAINT: f64 = 0.15;
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
        all: &[Candidate],
        outer: &Candidate,
    ) -> Option<Ring> {
        let mut clear = clear.peekable();
        let likeliest = clear.peek().copied();
        for (nth, s) in
            clear.filter(|s| likeliest.is_some_and(|l| may_stand_for(l, s, outer))).enumerate()
        {
            // What is likeliest is not left for what is easier to measure.
            let nearby = || if nth == 0 { self.measure_nearby(s) } else { None };
            if let Some(found) = self.measure(s).or_else(nearby) {
                let about = self.around_glint(&found, all);
                return about.or_else(|| self.within_halo(&found)).or(Some(found));
            }
            if nth == 0 && self.is_lost(s) {
                return None;
            }
        }
        None
    }

    /// Whether a spot is there, whole, that does not tell where it is.
    fn is_lost(&self, spot: &Candidate) -> bool {
        let (rough, search) = self.search(spot);
        self.look(spot, rough, search).is_some_and(|found| {
            found.arc_coverage > WHOLE && self.tells_where(&found, rough) == Some(false)
        })
    }

    /// Measures a spot, looking as far to both sides of its edge as there is anything to learn.
    pub(super) fn measure(&self, spot: &Candidate) -> Option<Ring> {
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
        let search = Search {
            reach_px: (3.0 * spot.scatter_px).clamp(3.0, 0.3 * c.radius + 3.0),
            inside_limit_px: 0.95 * c.radius,
            outside_limit_px: clear_px.clamp(0.4 * c.radius + 4.0, 4.0 * c.radius),
            softness_px: spot.softness_px.max(1.5),
            // It lies on what is burnt already.
            tinted: false,
            light: None,
        };
        (ring::in_plane(self.view, c), search)
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
        let is_vague = found.covariance[(2, 2)].sqrt() > VAGUE * found.circle.radius;
        found.contrast < 0.0 && is_far && (softness > least || is_vague)
    }

    pub(super) fn is_spot(&self, found: &Ring, rough: Circle) -> bool {
        self.tells_where(found, rough) == Some(true)
    }

    /// Whether what may be the spot tells where it is; `None` for what is none.
    fn tells_where(&self, found: &Ring, rough: Circle) -> Option<bool> {
        let ring = self.ring.circle;
        let apart = (found.circle.center - ring.center).norm() / ring.radius;
        let size = found.circle.radius / ring.radius;
        let ring_px = self.ring.seen(self.view);
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
        let may_be = limits.allow(found, self.view)
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
            && !strayed(found, rough);
        may_be.then(|| limits.trust(found))
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

/// Whether two circles' outlines meet, or come as close as `reach_px`.
fn cross(large: &Circle, small: &Circle, reach_px: f64) -> bool {
    ((large.center - small.center).norm() - large.radius).abs() < small.radius + reach_px
        && large.radius > 1.5 * small.radius
}
