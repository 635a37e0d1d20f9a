//! One circle of an expected diameter: which of the edges in a picture it is, measured.

use std::cell::LazyCell;

use nalgebra::Vector2;

use crate::camera::View;
use crate::find::{self, Candidate, ITSELF, Look, Sides};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::bands;
use crate::measure::points::{Points, Search};
use crate::measure::ring::{self, Ring};
use crate::measure::round::{
    FAINT, REGULAR, WHOLE, form, is_arc, is_faint, is_of_noise, is_regular, may_be_circle,
};
use crate::measure::two_edges::two_edges;

/// A circle is looked for within this share of its expected diameter.
const DIAMETER_WINDOW: f64 = 0.12;
/// Off by more than this share a circle may be another one than the one that is meant.
pub(crate) const FAR: f64 = 0.02;
/// Edges about the same centre that may disturb it, in its radii.
const NEIGHBOURS: std::ops::Range<f64> = 0.5..1.6;
/// Candidates that are tried: the edges of an annulus gather into several of a spot's size.
const TRIES: usize = 8;
/// Centres about which other edges are looked for from nearby.
const CENTERS: usize = 3;
/// An edge beside another, told apart from nearby, is seen on so much of its circumference.
const BESIDE_COVERAGE: f64 = 0.6;
/// And has such a part of the other's step.
const BESIDE_STEP: f64 = 0.2;
/// What has a larger part of the step of an edge, beyond it, is no band of tint.
const MOST_BAND: f64 = 0.4;
/// Of two such edges that one is meant which is nearer to the expected radius by this part of it.
const NEARER: f64 = 0.015;

/// Form over radius above which an edge may be background gathered into a circle, which wanders and has gaps.
const RAGGED: f64 = 0.03;
/// Form over radius above which an edge is no circle's, whole as it may seem.
const MOST_RAGGED: f64 = 0.08;
/// A measured step as a part of the one that was found; another is another edge's.
const SAME_STEP: std::ops::Range<f64> = 0.3..4.0;
/// An edge that was found so far away, in radii, is another than the one that was looked for.
const ASTRAY: f64 = 0.03;
/// The one that was looked for is then looked for no farther than this, in softnesses, in turn.
const NEARBY: [f64; 2] = [4.0, 2.5];

/// Where nothing is seen, a stronger edge about the same centre may hide it: such are looked for within this share.
const WIDE_WINDOW: f64 = 0.4;
/// Pixels of a reduced picture that a circle's radius should have: a smaller one is looked for in one reduced less.
const LEAST_SEEN: f64 = 5.0;

/// The circle of about `expect_mm` diameter that the picture shows best, and where its edge was looked for; `None` where it shows
/// none.
pub(crate) fn measure(frame: &Frame, view: &View, look: &Look, expect_mm: f64) -> Option<Measured> {
    let radius_px = 0.5 * expect_mm / view.pixel_mm();
    let seen = |look: &Look| {
        let candidates = find::circles(look, options(radius_px, DIAMETER_WINDOW));
        let picture = Picture { frame, view, look, candidates: &candidates, expect_mm, radius_px };
        let best = picture.best()?;
        Some(Measured { alike: picture.alike(&best.ring), ..best })
    };
    let hidden = || {
        let candidates = find::circles(look, options(radius_px, WIDE_WINDOW));
        Picture { frame, view, look, candidates: &candidates, expect_mm, radius_px }.hidden()
    };
    let small = || {
        let small = radius_px < LEAST_SEEN * look.factor as f64;
        let factor = (radius_px / LEAST_SEEN) as usize;
        small.then(|| find::look_reduced(frame, factor)).filter(|l| l.factor < look.factor)
    };
    seen(look).or_else(hidden).or_else(|| seen(&small()?))
}

/// Circles within a share of a radius.
fn options(radius_px: f64, window: f64) -> find::Options<'static> {
    find::Options {
        least_radius_px: (1.0 - window) * radius_px,
        most_radius_px: (1.0 + window) * radius_px,
        near: None,
        least_coverage: 0.25,
        centers: 8,
        known: &[],
    }
}

/// Concentric edges, each no softer than those beside it leave room for: seen together, two look like a soft one.
fn told_apart(mut edges: Vec<Candidate>) -> Vec<Candidate> {
    /// Of the gap to the next.
    const SOFTEST: f64 = 0.25;
    let radii: Vec<f64> = edges.iter().map(|e| e.circle.radius).collect();
    for e in &mut edges {
        let gaps = radii.iter().map(|r| (r - e.circle.radius).abs()).filter(|gap| *gap > 0.0);
        e.softness_px = gaps.fold(e.softness_px, |softest, gap| softest.min(SOFTEST * gap));
    }
    edges
}

/// A circle of the expected size.
#[derive(Debug, Clone)]
pub(crate) struct Measured {
    /// The circle.
    pub ring: Ring,
    /// Where its edge was looked for.
    pub search: Search,
    /// Centres of others as clear and as large, in the plane.
    pub alike: Vec<Vector2<f64>>,
}

/// What a candidate led to.
enum Found {
    Circle(Measured),
    /// Perhaps a poor part's edge; anything better is preferred.
    Ragged(Measured),
}

/// Where a circle is looked for.
struct Picture<'a> {
    frame: &'a Frame,
    view: &'a View,
    look: &'a Look,
    candidates: &'a [Candidate],
    expect_mm: f64,
    radius_px: f64,
}

impl Picture<'_> {
    /// The best of the candidates, or of the edges about the same centre.
    fn best(&self) -> Option<Measured> {
        let mut ragged: Option<Measured> = None;
        let mut tried = |found: Option<Found>| match found? {
            Found::Circle(circle) => Some(circle),
            Found::Ragged(circle) => {
                if ragged.as_ref().is_none_or(|best| form(&circle.ring) < form(&best.ring)) {
                    ragged = Some(circle);
                }
                None
            }
        };
        for (nth, c) in self.likeliest().into_iter().take(TRIES).enumerate() {
            // From nearby edges are told apart that are one from afar: the one nearer to what is expected is meant.
            let beside = if nth < CENTERS { self.beside(&c) } else { vec![] };
            let mut meant: Vec<&Candidate> = beside
                .iter()
                .filter(|o| o.step * c.step > 0.0 && self.off(o) < self.off(&c) - NEARER)
                .collect();
            meant.sort_by(|a, b| self.off(a).total_cmp(&self.off(b)));
            let nearer = meant.into_iter().find_map(|o| tried(self.measure(o, &beside)));
            if nearer.is_some() {
                return nearer;
            }
            let apart = |o: &&Candidate| !one(o, &c, self.look);
            let neighbours: Vec<Candidate> =
                self.candidates.iter().chain(beside.iter().filter(apart)).copied().collect();
            if let Some(circle) = tried(self.measure(&c, &neighbours)) {
                return Some(circle);
            }
        }
        ragged
    }

    /// A circle of the expected size about the centre of a clearer one, which hides it from afar.
    fn hidden(&self) -> Option<Measured> {
        let mut clearest = self.candidates.to_vec();
        clearest.sort_by(|a, b| b.score.total_cmp(&a.score));
        clearest.into_iter().filter(|c| c.coverage > WHOLE).take(CENTERS).find_map(|c| {
            let (rough, search) = around(self.view, &c, self.candidates);
            let clearer = ring::measure(self.frame, self.view, rough, search, None)?;
            if clearer.arc_coverage < WHOLE || !is_regular(&clearer) || is_faint(&clearer) {
                return None;
            }
            let beside = self.beside(&c);
            let mut meant: Vec<&Candidate> =
                beside.iter().filter(|o| self.off(o) < DIAMETER_WINDOW).collect();
            meant.sort_by(|a, b| self.off(a).total_cmp(&self.off(b)));
            meant.into_iter().find_map(|o| match self.measure(o, &beside)? {
                Found::Circle(circle) => Some(circle),
                Found::Ragged(_) => None,
            })
        })
    }

    /// How far a candidate's radius is from the expected one, as a part of that.
    fn off(&self, c: &Candidate) -> f64 {
        (c.circle.radius / self.radius_px - 1.0).abs()
    }

    /// Candidates in the order in which they are tried: strong ones near the expected radius first.
    fn likeliest(&self) -> Vec<Candidate> {
        let mut list = self.candidates.to_vec();
        let rank = |c: &Candidate| c.score / (1.0 + (self.off(c) / 0.05).powi(2));
        list.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
        list
    }

    /// Clear edges about a candidate's centre, seen from nearby.
    fn beside(&self, c: &Candidate) -> Vec<Candidate> {
        let clear = |o: &Candidate| {
            o.coverage > BESIDE_COVERAGE && o.step.abs() > BESIDE_STEP * c.step.abs()
        };
        told_apart(self.about(c).into_iter().filter(clear).collect())
    }

    /// Edges about a candidate's centre, seen from nearby.
    fn about(&self, c: &Candidate) -> Vec<Candidate> {
        let options = find::Options {
            least_radius_px: NEIGHBOURS.start * self.radius_px,
            most_radius_px: NEIGHBOURS.end * self.radius_px,
            ..options(self.radius_px, 0.0)
        };
        find::about(self.frame, c.circle.center, options)
    }

    /// A candidate measured, if it is a circle of the expected size.
    fn measure(&self, c: &Candidate, neighbours: &[Candidate]) -> Option<Found> {
        let (rough, search) = around(self.view, c, neighbours);
        // What neither stands out nor is clear at the first glance will not be found to be a circle.
        let stands_out = LazyCell::new(|| self.stands_out(c));
        let worth = |points: &Points| points.clarity() >= FAINT || *stands_out;
        let judge = |ring, search| self.judge(c, ring, search, || *stands_out);
        let look = |search| ring::measure_if(self.frame, self.view, rough, search, None, &worth);
        let ring = look(search)?;
        if let Some(edges) = two_edges(&ring, self.view.pixel_mm()) {
            return self.one_of(edges, c, search);
        }
        let astray = |ring: &Ring| ring.circle.apart(&rough) > ASTRAY * rough.radius;
        if astray(&ring) {
            let nearer = NEARBY.iter().find_map(|softnesses| {
                let search = search.nearby(*softnesses);
                look(search).filter(|r| !astray(r)).and_then(|r| judge(r, search))
            });
            if nearer.is_some() {
                return nearer;
            }
        }
        judge(ring, search)
    }

    /// Of two edges that look like one, light from one side showing each on its own side, the one nearer to what is expected.
    fn one_of(&self, mut edges: [Circle; 2], c: &Candidate, search: Search) -> Option<Found> {
        let off = |edge: &Circle| (2.0 * edge.radius / self.expect_mm - 1.0).abs();
        edges.sort_by(|a, b| off(a).total_cmp(&off(b)));
        let apart_px = (edges[0].radius - edges[1].radius).abs() / self.view.pixel_mm();
        let half_px = (0.5 * apart_px).max(2.0);
        let search = Search {
            reach_px: search.reach_px.min(0.5 * half_px),
            inside_limit_px: search.inside_limit_px.min(half_px),
            outside_limit_px: search.outside_limit_px.min(half_px),
            softness_px: search.softness_px.min(0.25 * apart_px),
            ..search
        };
        let [first, second] = edges;
        [(first, second), (second, first)].into_iter().find_map(|(edge, other)| {
            let ring = ring::measure(self.frame, self.view, edge, search, None)?;
            let strayed = ring.circle.apart(&edge) > half_px * self.view.pixel_mm();
            if strayed || two_edges(&ring, self.view.pixel_mm()).is_some() {
                return None;
            }
            let ring = Ring { other_mm: Some(2.0 * other.radius), ..ring };
            self.judge(c, ring, search, || true)
        })
    }

    /// Whether a candidate stands out from its surface, as far as that can be told.
    fn stands_out(&self, c: &Candidate) -> bool {
        let rivals: Vec<Circle> =
            self.candidates.iter().filter(|o| rivals(o, c)).map(|o| o.circle).collect();
        find::stands_out(self.look, c, Sides::Edge, &rivals) != Some(false)
    }

    /// Whether what was measured is a circle of the expected size; `stands_out` is asked only of what is not clear by itself.
    fn judge(
        &self,
        c: &Candidate,
        ring: Ring,
        search: Search,
        stands_out: impl FnOnce() -> bool,
    ) -> Option<Found> {
        let ring = ring.perhaps_soft();
        let off = (2.0 * ring.circle.radius / self.expect_mm - 1.0).abs();
        if off > DIAMETER_WINDOW
            || !SAME_STEP.contains(&(ring.contrast / c.step))
            || !may_be_circle(&ring)
        {
            return None;
        }
        let faint = is_faint(&ring);
        if faint && is_of_noise(&ring, self.view.pixel_mm()) {
            return None;
        }
        let clear = is_regular(&ring) && !faint;
        if !clear && !stands_out() {
            return None;
        }
        if clear || form(&ring) < if faint { REGULAR } else { RAGGED } {
            return Some(Found::Circle(self.with_tint(c, ring, search)));
        }
        let poor = form(&ring) < MOST_RAGGED && !faint && !is_arc(&ring);
        poor.then(|| Found::Ragged(self.with_tint(c, ring, search)))
    }

    /// A circle with what bands of tint beyond it may have moved it.
    fn with_tint(&self, c: &Candidate, mut ring: Ring, search: Search) -> Measured {
        let pixel_mm = self.view.pixel_mm();
        if ring.may_hide_tint(pixel_mm) {
            let mut edges = self.about(c);
            // A stronger one is another edge of the part: a chamfer's, a washer's rim.
            edges.retain(|o| o.step.abs() < MOST_BAND * c.step.abs());
            ring = ring.banded(bands::strongest_beyond(c, &edges), pixel_mm);
        }
        Measured { ring, search, alike: Vec::new() }
    }

    /// Where else a circle as clear and as large is seen.
    fn alike(&self, ring: &Ring) -> Vec<Vector2<f64>> {
        /// In radii: as large, and elsewhere.
        const AS_LARGE: f64 = 0.03;
        const ELSEWHERE: f64 = 0.5;
        /// As a part of the own score.
        const AS_CLEAR: f64 = 0.5;
        let seen = ring.seen(self.view);
        let off = |c: &&Candidate| (c.circle.center - seen.center).norm() / seen.radius;
        let alike = |c: &&Candidate| {
            (c.circle.radius / seen.radius - 1.0).abs() < AS_LARGE && c.step * ring.contrast > 0.0
        };
        let same = self.candidates.iter().filter(|c| alike(c) && off(c) < ELSEWHERE);
        let own = same.map(|c| c.score).fold(0.0, f64::max);
        let others = self.candidates.iter().filter(|c| alike(c) && off(c) >= ELSEWHERE);
        let clear = |c: &&Candidate| own > 0.0 && c.score > AS_CLEAR * own && c.coverage > WHOLE;
        others.filter(clear).map(|c| self.view.to_plane(c.circle.center)).collect()
    }
}

/// Whether two were seen on one edge, as far as the reduced picture can tell.
fn one(a: &Candidate, b: &Candidate, look: &Look) -> bool {
    const APART: f64 = 1.5;
    a.step * b.step > 0.0 && a.circle.apart(&b.circle) < APART * look.factor as f64
}

/// Whether another circle is about as strong, and not the same one seen twice.
fn rivals(other: &Candidate, c: &Candidate) -> bool {
    let apart = (other.circle.center - c.circle.center).norm() / c.circle.radius;
    let larger = other.circle.radius / c.circle.radius - 1.0;
    other.score > 0.3 * c.score && apart.max(larger.abs()) > 0.1
}

/// The plane's circle and where its edge is to be looked for, clear of concentric neighbours.
pub(super) fn around(view: &View, candidate: &Candidate, others: &[Candidate]) -> (Circle, Search) {
    let c = candidate.circle;
    let (mut inside, mut outside) = (0.9 * c.radius, 0.9 * c.radius);
    for o in others {
        let apart = o.circle.radius - c.radius;
        let off = (o.circle.center - c.center).norm();
        // A neighbour is as concentric as both are steady; what is not is no edge of this part.
        let concentric = off < 0.02 * c.radius + 2.0 + candidate.scatter_px.min(0.05 * c.radius);
        // Within an edge's own softness there is no other.
        let itself = o.step * candidate.step > 0.0 && apart.abs() < ITSELF * candidate.softness_px;
        if concentric && !itself && apart.abs() > 3.0 + off && o.score > 0.15 * candidate.score {
            let half = (0.6 * apart.abs() - off).max(3.0);
            if apart < 0.0 {
                inside = inside.min(half);
            } else {
                outside = outside.min(half);
            }
        }
    }
    let search = Search {
        reach_px: (3.0 * candidate.scatter_px).clamp(3.0, 0.2 * c.radius + 4.0),
        inside_limit_px: inside,
        outside_limit_px: outside,
        softness_px: candidate.softness_px.max(1.0),
        tinted: false,
        light: None,
    };
    (ring::in_plane(view, c), search)
}
