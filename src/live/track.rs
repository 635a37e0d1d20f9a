//! Follows a rim or a mark from frame to frame.
//!
//! The first frame is searched; in later ones the edge is measured near its last place, or searched for where it is not there. Each
//! frame's centre stands for itself: one told from its shift against an earlier frame has that frame's error, which does not average out.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::View;
use crate::find::{self, Candidate, Sides};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::live::center::Options;
use crate::measure::expected::{self, Measured};
use crate::measure::points::Search;
use crate::measure::ring::{self, Ring};
use crate::measure::rod;
use crate::measure::round;
use crate::uncertainty::K95;

/// Circles of a frame that are tried where no diameter is given.
const TRIES: usize = 4;
/// Standard uncertainty of a given diameter: what the tolerance of a turned or ground part leaves.
const DIAMETER_U_MM: f64 = 0.02;
/// How far it may jump before it is searched for in the whole frame, px.
const NEARBY_PX: f64 = 8.0;

/// Finds the circle and follows it.
pub(super) struct Tracker {
    options: Options,
    /// The last circle that was seen whole, and where its edge was looked for.
    last: Option<(Ring, Search)>,
}

impl Tracker {
    pub(super) fn new(options: Options) -> Self {
        Self { options, last: None }
    }

    /// The circle in the next frame.
    pub(super) fn look(&mut self, frame: &Frame, view: &View) -> Option<Ring> {
        if let Some(diameter_mm) = self.rim_mm(view) {
            return arc(frame, view, diameter_mm);
        }
        let near = self.last.take().and_then(|last| nearby(&last, frame, view));
        let found = || self.find(frame, view).map(|found| (found.ring, found.search));
        let (ring, search) = near.or_else(found)?;
        self.last = Some((ring.clone(), search));
        Some(self.known_diameter(ring))
    }

    /// The diameter, where it is given and the frame can only hold an arc of it.
    fn rim_mm(&self, view: &View) -> Option<f64> {
        let field = view.width_px().min(view.height_px()) as f64 * view.pixel_mm();
        self.options.diameter_mm.filter(|d| *d > 0.9 * field)
    }

    /// Anywhere in the frame: of the given diameter, or of whichever size it shows best.
    fn find(&self, frame: &Frame, view: &View) -> Option<Measured> {
        let look = find::look(frame);
        if let Some(diameter_mm) = self.options.diameter_mm {
            return expected::measure(frame, view, &look, diameter_mm);
        }
        let side = frame.width().max(frame.height()) as f64;
        let mut shown = find::circles(
            &look,
            find::Options {
                least_radius_px: 0.02 * side,
                most_radius_px: 0.6 * side,
                near: None,
                least_coverage: 0.35,
                centers: 8,
                known: &[],
            },
        );
        let rank = |c: &Candidate| c.score * c.circle.radius.sqrt();
        shown.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
        let stands_out =
            |c: &&Candidate| find::stands_out(&look, c, Sides::Edge, &[]) != Some(false);
        shown.iter().take(TRIES).filter(stands_out).find_map(|c| {
            expected::measure(frame, view, &look, 2.0 * c.circle.radius * view.pixel_mm())
        })
    }

    /// A given diameter as one more observation: worth much where only an arc is seen.
    fn known_diameter(&self, mut ring: Ring) -> Ring {
        let Some(d) = self.options.diameter_mm else { return ring };
        let gap = 0.5 * d - ring.circle.radius;
        let total = ring.covariance[(2, 2)] + (0.5 * DIAMETER_U_MM).powi(2);
        if gap.abs() > 3.0 * total.sqrt() {
            return ring;
        }
        let gain = ring.covariance.column(2) / total;
        ring.covariance -= gain * gain.transpose() * total;
        ring.circle = Circle {
            center: ring.circle.center + Vector2::new(gain[0], gain[1]) * gap,
            radius: ring.circle.radius + gain[2] * gap,
        };
        ring
    }
}

/// Near where it was, if it is still the same edge.
fn nearby((last, search): &(Ring, Search), frame: &Frame, view: &View) -> Option<(Ring, Search)> {
    let near = Search { reach_px: NEARBY_PX, softness_px: last.softness_px.max(1.0), ..*search };
    let ring = ring::measure(frame, view, last.circle, near, None)?.perhaps_soft();
    let same = (ring.circle.radius / last.circle.radius - 1.0).abs() < 0.02
        && ring.contrast.signum() == last.contrast.signum()
        && ring.contrast.abs() > 0.4 * last.contrast.abs()
        && ring.arc_coverage > 0.6 * last.arc_coverage
        && round::may_be_circle(&ring);
    same.then_some((ring, *search))
}

/// A rim of which the frame holds an arc, measured as a check rod's single capture.
fn arc(frame: &Frame, view: &View, diameter_mm: f64) -> Option<Ring> {
    let capture = rod::Capture::in_memory(String::new(), Vector2::zeros(), 0.0);
    let options = rod::Options { diameter_mm: Some(diameter_mm), ..Default::default() };
    let seen = rod::measure_frames(&[capture], &[(frame.clone(), view.clone())], &options).ok()?;
    let center = seen.report.rod_centers.first()?;
    let circle = *seen.circles.first()?;
    // A given diameter that the arc contradicts was not used, and an arc alone says too little.
    if (2.0 * circle.radius / diameter_mm - 1.0).abs() > 0.02 {
        return None;
    }
    let [x, y] = center.center_u95_mm.map(|u| (u / K95).powi(2));
    let used = seen.points.iter().filter(|p| p.used).count();
    Some(Ring {
        circle,
        covariance: Matrix3::from_diagonal(&Vector3::new(x, y, 0.0)),
        dof: f64::INFINITY,
        fitted_sd_mm: (x + y).sqrt(),
        center_px: view.to_pixel(circle.center),
        form_rms_mm: seen.report.form_rms_mm,
        form_from_texture_mm: 0.0,
        edge_points: used,
        gain: 1.0,
        other_mm: None,
        arc_coverage: used as f64 * arc_step(&seen.points) * view.pixel_mm()
            / (std::f64::consts::TAU * circle.radius),
        contrast: 0.0,
        noise: 0.0,
        softness_px: 2.0,
        blur_mm: 0.0,
        clipped_inside: false,
        clipped_outside: false,
        wander: Default::default(),
        trace: seen.points.iter().map(|p| (p.pixel, p.used)).collect(),
        residuals: Vec::new(),
    })
}

/// Typical distance of neighbouring edge points, px.
fn arc_step(points: &[rod::EdgePoint]) -> f64 {
    let mut steps: Vec<f64> = points.windows(2).map(|w| (w[1].pixel - w[0].pixel).norm()).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}
