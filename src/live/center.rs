//! Guiding an operator: the centre of a rim or a round mark, frame by frame, until it is known as well as asked.
//!
//! The first frame is searched and its edge measured in full. How far the edge has shifted since then is read from the pixels
//! along it, at a tenth of the cost; after a move it is measured anew. The frames' scatter averages out with their number; what
//! the edge's own form leaves uncertain is the same in all of them and does not.

use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector2, Vector3};
use serde::Serialize;

use crate::calib::register::Patch;
use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::find::{self, Candidate};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::live::{Event, Feed, Shot};
use crate::measure::expected::around;
use crate::measure::points::Search;
use crate::measure::ring::{self, Ring};
use crate::measure::rod;
use crate::uncertainty::{K95, Verdict, distance, k95};

/// A circle is looked for within this share of its expected diameter.
const DIAMETER_WINDOW: f64 = 0.12;
/// Standard uncertainty of a given diameter: what the tolerance of a turned or ground part leaves.
const DIAMETER_U_MM: f64 = 0.02;
/// How far the edge may shift from where it was measured in full, px: the lens' and the plane's mapping hardly differ there.
const SHIFT_PX: f64 = 1.5;
/// How far it may jump before it is searched for in the whole frame, px.
const NEARBY_PX: f64 = 8.0;
/// Pixels along the edge that tell its shift.
const ALONG: usize = 500;

/// What is asked for.
#[derive(Debug, Clone)]
pub struct Options {
    /// Expected diameter; without it the clearest circle is taken.
    pub diameter_mm: Option<f64>,
    /// Half-width of the 95 % interval at which the average is good enough.
    pub u95_mm: f64,
    /// With it, guiding goes on until the centre is this near to the camera axis, for certain.
    pub tolerance_mm: Option<f64>,
    /// Longest time without a result.
    pub timeout: Duration,
}

/// Where the centre is and what to do about it.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// Centre seen from the camera axis, in the plane.
    pub offset_mm: [f64; 2],
    /// Half-widths of its 95 % intervals.
    pub offset_u95_mm: [f64; 2],
    /// Its length.
    pub distance_mm: f64,
    /// Half-width of its 95 % interval.
    pub distance_u95_mm: f64,
    /// Axis moves that bring the camera axis over the centre.
    pub move_mm: [f64; 2],
    /// Axis moves that bring the laser axis over it; null where the calibration has no laser offset.
    pub move_laser_mm: Option<[f64; 2]>,
    /// Diameter in the last frame.
    pub diameter_mm: f64,
    /// Share of the circle on which the edge was found in the last frame.
    pub arc_coverage: f64,
    /// Frames averaged, since the last move.
    pub frames_used: usize,
    /// Frames looked at.
    pub frames_seen: usize,
    /// Of these, frames in which nothing was found.
    pub frames_failed: usize,
    /// Frames that came.
    pub received: u64,
    /// Frames that a newer one replaced before they were looked at.
    pub dropped: u64,
    /// How often the source was lost and came back.
    pub reconnects: u64,
    /// Frames looked at per second.
    pub frames_per_s: f64,
    /// Whether the asked uncertainty (and the tolerance, where one is given) was reached.
    pub verdict: Verdict,
}

/// What the operator is told on the way.
#[derive(Debug)]
pub enum News<'a> {
    /// A frame was measured: the average so far, the frame and its circle.
    Seen(&'a Report, &'a Frame, &'a View, &'a Ring),
    /// A frame shows no circle, or cannot be decoded.
    NotSeen(String),
    /// The centre has moved: the average begins anew.
    Moved,
    /// No frame for this long.
    Stalled(Duration),
    /// The source is lost; it is being opened again.
    Lost(&'a str),
    /// It is back.
    Back,
}

/// The result, with the last frame that showed the circle.
#[derive(Debug)]
pub struct Centred {
    /// The average.
    pub report: Report,
    /// The last measured picture as it came.
    pub shot: Shot,
}

/// Guides until the result is good enough, the source ends, or time is up.
pub fn run(
    feed: &mut Feed,
    calibration: &Calibration,
    options: &Options,
    mut tell: impl FnMut(News<'_>) -> Result<()>,
) -> Result<Centred> {
    check(options)?;
    let start = Instant::now();
    let mut tracker = Tracker { options: options.clone(), key: None };
    let mut average = Average::default();
    let (mut seen, mut failed) = (0, 0);
    let mut first = None;
    let mut last: Option<Centred> = None;
    let mut view: Option<View> = None;
    let mut why = String::from("no frame came");
    while start.elapsed() < options.timeout {
        let shot = match feed.wait()? {
            Event::Shot(shot, _) => shot,
            Event::Stalled(silent) => {
                tell(News::Stalled(silent))?;
                continue;
            }
            Event::Lost(reason) => {
                tell(News::Lost(&reason))?;
                why = reason;
                continue;
            }
            Event::Back => {
                tell(News::Back)?;
                continue;
            }
            Event::Ended => break,
        };
        seen += 1;
        let first = *first.get_or_insert_with(Instant::now);
        // A damaged frame is not the stream's end.
        let frame = match shot.frame() {
            Ok(frame) => calibration.linear(frame),
            Err(e) => {
                failed += 1;
                tell(News::NotSeen(e.to_string()))?;
                continue;
            }
        };
        let size = (frame.width(), frame.height());
        let fits = |v: &&View| (v.width_px(), v.height_px()) == size;
        let view = match view.as_ref().filter(fits) {
            Some(view) => view,
            None => view.insert(calibration.view(size.0, size.1)?),
        };
        let Some(ring) = tracker.look(&frame, view) else {
            failed += 1;
            why = "no circle was found".into();
            tell(News::NotSeen(why.clone()))?;
            continue;
        };
        if average.add(&ring, 0.25 * view.pixel_mm()) {
            tell(News::Moved)?;
        }
        let mut report = average.report(&ring, calibration, options);
        let stats = feed.stats();
        (report.frames_seen, report.frames_failed) = (seen, failed);
        (report.received, report.dropped, report.reconnects) =
            (stats.received, stats.dropped, stats.reconnects);
        report.frames_per_s = (seen - 1) as f64 / first.elapsed().as_secs_f64().max(1e-9);
        tell(News::Seen(&report, &frame, view, &ring))?;
        let done = report.verdict == Verdict::Pass;
        last = Some(Centred { report, shot });
        if done {
            break;
        }
    }
    last.ok_or_else(|| {
        Error::measure(
            "source",
            format!("nothing was measured in {seen} frames: {why}"),
            "check the light, --diameter-mm and the calibration's scale, or the camera's address",
        )
    })
}

fn check(options: &Options) -> Result<()> {
    let lengths = [
        ("--u95-mm", Some(options.u95_mm)),
        ("--diameter-mm", options.diameter_mm),
        ("--tolerance-mm", options.tolerance_mm),
    ];
    for (name, value) in lengths {
        if let Some(v) = value
            && !(v.is_finite() && v > 0.0)
        {
            return Err(Error::option(
                name,
                format!("{v} is not a length"),
                "give a positive number in mm",
            ));
        }
    }
    Ok(())
}

/// Finds the circle and follows it.
struct Tracker {
    options: Options,
    key: Option<Key>,
}

/// The last frame that was measured in full.
struct Key {
    ring: Ring,
    /// Where its edge is looked for; `None` for an arc of a rim.
    search: Option<Search>,
    /// The pixels along its edge, and the middle of them.
    patch: Patch,
    middle: Vector2<f64>,
}

impl Tracker {
    fn look(&mut self, frame: &Frame, view: &View) -> Option<Ring> {
        if let Some(ring) = self.key.as_ref().and_then(|key| key.shifted(frame, view)) {
            return Some(ring);
        }
        let before = self.key.take();
        let (ring, search) = match self.rim_mm(view) {
            Some(diameter_mm) => (arc(frame, view, diameter_mm)?, None),
            None => {
                let near = before.and_then(|key| self.nearby(&key, frame, view));
                let (ring, search) = near.or_else(|| self.find(frame, view))?;
                (self.known_diameter(ring), Some(search))
            }
        };
        self.key = Key::new(frame, ring.clone(), search);
        Some(ring)
    }

    /// The diameter, where it is given and the frame can only hold an arc of it.
    fn rim_mm(&self, view: &View) -> Option<f64> {
        let field = view.width_px().min(view.height_px()) as f64 * view.pixel_mm();
        self.options.diameter_mm.filter(|d| *d > 0.9 * field)
    }

    /// Near where it was, if it is still the same edge.
    fn nearby(&self, key: &Key, frame: &Frame, view: &View) -> Option<(Ring, Search)> {
        let (last, search) = (&key.ring, key.search?);
        let near = Search { reach_px: NEARBY_PX, softness_px: last.softness_px.max(1.0), ..search };
        let ring = ring::measure(frame, view, last.circle, near, None)?;
        let same = (ring.circle.radius / last.circle.radius - 1.0).abs() < 0.02
            && ring.contrast.signum() == last.contrast.signum()
            && ring.contrast.abs() > 0.4 * last.contrast.abs()
            && ring.arc_coverage > 0.6 * last.arc_coverage;
        same.then_some((ring, search))
    }

    /// Anywhere in the frame, and a little outside where an arc is seen of a larger rim.
    fn find(&self, frame: &Frame, view: &View) -> Option<(Ring, Search)> {
        let look = find::look(frame);
        let side = frame.width().max(frame.height()) as f64;
        let expected = self.options.diameter_mm.map(|d| 0.5 * d / view.pixel_mm());
        let (least, most) = match expected {
            Some(r) => (r * (1.0 - DIAMETER_WINDOW), r * (1.0 + DIAMETER_WINDOW)),
            None => (0.02 * side, 0.6 * side),
        };
        let candidates = find::circles(
            &look,
            find::Options {
                least_radius_px: least,
                most_radius_px: most,
                near: None,
                least_coverage: if expected.is_some() { 0.1 } else { 0.35 },
                centers: 8,
                known: &[],
            },
        );
        let rank = |c: &Candidate| {
            let off = expected.map_or(0.0, |r| (c.circle.radius / r - 1.0) / 0.05);
            c.score * c.circle.radius.sqrt() / (1.0 + off * off)
        };
        let mut order = candidates.clone();
        order.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
        order.iter().take(4).find_map(|c| {
            let (rough, search) = around(view, c, &candidates);
            let ring = ring::measure(frame, view, rough, search, None)?;
            let off = self.options.diameter_mm.map_or(0.0, |d| 2.0 * ring.circle.radius / d - 1.0);
            (off.abs() < DIAMETER_WINDOW).then_some((ring, search))
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

impl Key {
    /// `None` for an edge that is hardly seen.
    fn new(frame: &Frame, ring: Ring, search: Option<Search>) -> Option<Self> {
        let used: Vec<Vector2<f64>> =
            ring.trace.iter().filter(|(_, used)| *used).map(|(p, _)| *p).collect();
        if used.len() < 12 {
            return None;
        }
        let middle = (used.iter().sum::<Vector2<f64>>() / used.len() as f64).map(f64::round);
        let half = (2.5 * ring.softness_px + 3.0).ceil() as i64;
        let step = used.len().div_ceil(ALONG).max(1);
        let offsets = used
            .iter()
            .step_by(step)
            .flat_map(|p| {
                let out = (p - ring.center_px).normalize();
                // Whole pixels: the reference is not interpolated.
                (-half..=half).map(move |i| (p + out * i as f64).map(f64::round) - middle)
            })
            .collect();
        let patch = match frame {
            Frame::Eight(gray) => Patch::cut(gray, middle, offsets),
            Frame::Sixteen(gray) => Patch::cut(gray, middle, offsets),
        };
        Some(Self { ring, search, patch, middle })
    }

    /// The circle where the edge's pixels have shifted to; `None` where they are gone too far.
    fn shifted(&self, frame: &Frame, view: &View) -> Option<Ring> {
        let (place, _) = match frame {
            Frame::Eight(gray) => self.patch.register(gray, self.middle, SHIFT_PX),
            Frame::Sixteen(gray) => self.patch.register(gray, self.middle, SHIFT_PX),
        }?;
        let mut ring = self.ring.clone();
        ring.circle.center += view.to_plane(place) - view.to_plane(self.middle);
        ring.center_px += place - self.middle;
        ring.trace.iter_mut().for_each(|(p, _)| *p += place - self.middle);
        Some(ring)
    }
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

/// The running mean of the centres since the last move.
#[derive(Debug, Clone, Default)]
struct Average {
    n: usize,
    mean: Vector2<f64>,
    squares: Vector2<f64>,
    own: Vector2<f64>,
}

impl Average {
    /// Takes in a frame's centre; `true` where it has moved and the average began anew.
    fn add(&mut self, ring: &Ring, least_mm: f64) -> bool {
        let center = ring.circle.center;
        let scatter = if self.n > 2 {
            (self.squares / (self.n - 1) as f64).map(f64::sqrt)
        } else {
            Vector2::zeros()
        };
        let moved = self.n > 0 && (center - self.mean).norm() > 6.0 * scatter.norm() + least_mm;
        if moved {
            *self = Self::default();
        }
        self.n += 1;
        let n = self.n as f64;
        let before = center - self.mean;
        self.mean += before / n;
        self.squares += before.component_mul(&(center - self.mean));
        let factor = k95(ring.dof);
        let own = Vector2::new(ring.covariance[(0, 0)], ring.covariance[(1, 1)]);
        self.own += (own * factor * factor - self.own) / n;
        moved
    }

    /// Half-widths of the mean's 95 % intervals.
    fn u95(&self) -> Vector2<f64> {
        let n = self.n as f64;
        if self.n < 3 {
            return self.own.map(|v| v.max(0.0).sqrt());
        }
        let scatter = self.squares / (n - 1.0);
        let factor = k95(n - 1.0);
        self.own.zip_map(&scatter, |own, s| {
            // What of a frame's uncertainty does not show as scatter is the same in every frame; a tenth of it at least,
            // since what shows as scatter is itself not known well.
            ((own - K95 * K95 * s).max(0.1 * own) + factor * factor * s / n).sqrt()
        })
    }

    fn report(&self, ring: &Ring, calibration: &Calibration, options: &Options) -> Report {
        let u95 = self.u95();
        let covariance = nalgebra::Matrix2::from_diagonal(&u95.map(|u| (u / K95).powi(2)));
        let (distance_mm, distance_u95_mm) = distance(self.mean, covariance, f64::INFINITY);
        let good = self.n >= 3 && u95.max() <= options.u95_mm;
        let verdict = match (good, options.tolerance_mm) {
            (false, _) => Verdict::Undecided,
            (true, Some(limit)) => Verdict::of(distance_mm, distance_u95_mm, limit),
            (true, None) => Verdict::Pass,
        };
        Report {
            offset_mm: self.mean.into(),
            offset_u95_mm: u95.into(),
            distance_mm,
            distance_u95_mm,
            move_mm: self.mean.into(),
            move_laser_mm: calibration
                .laser
                .as_ref()
                .map(|l| (self.mean - Vector2::from(l.offset_mm)).into()),
            diameter_mm: 2.0 * ring.circle.radius,
            arc_coverage: ring.arc_coverage,
            frames_used: self.n,
            frames_seen: 0,
            frames_failed: 0,
            received: 0,
            dropped: 0,
            reconnects: 0,
            frames_per_s: 0.0,
            verdict,
        }
    }
}
