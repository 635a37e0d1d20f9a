//! Guiding an operator: the centre of a rim or a round mark, frame by frame, until it is known as well as asked.
//!
//! The frames' scatter averages out with their number; what the edge's own form leaves uncertain is the same in all of them and
//! does not.

use std::time::{Duration, Instant};

use nalgebra::Vector2;
use serde::Serialize;

use crate::camera::{Calibration, View};
use crate::error::{Error, Result, above_zero};
use crate::frame::Frame;
use crate::live::average::{Average, LEAST_FRAMES};
use crate::live::track::Tracker;
use crate::live::{Event, Feed, Shot, Stats};
use crate::measure::plane_errors::PlaneErrors;
use crate::measure::ring::Ring;
use crate::uncertainty::{K95, Verdict, distance};

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
    /// Half-widths of its 95 % intervals, the laser offset's own with them.
    pub move_laser_u95_mm: Option<[f64; 2]>,
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
    /// Whether the tolerance is kept; `undecided` below the asked uncertainty, `null` where that is reached and no tolerance is given.
    pub verdict: Option<Verdict>,
}

impl Report {
    /// Whether all that was asked for is reached.
    pub fn is_done(&self) -> bool {
        matches!(self.verdict, None | Some(Verdict::Pass))
    }

    fn count(&mut self, seen: usize, failed: usize, stats: Stats) {
        (self.frames_seen, self.frames_failed) = (seen, failed);
        (self.received, self.dropped, self.reconnects) =
            (stats.received, stats.dropped, stats.reconnects);
    }
}

/// What the operator is told on the way.
#[derive(Debug)]
pub enum News<'a> {
    /// A frame was measured: the average so far, the frame and its circle.
    Seen(&'a Report, &'a Frame, &'a View, &'a Ring),
    /// A frame shows no circle, or cannot be decoded.
    NotSeen(String),
    /// The second frame is a copy of the first: noise never comes twice, but a camera that stands still sends one frame over and over.
    Copy,
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
    let mut tracker = Tracker::new(options.clone());
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
        let looked = match usable(&shot, &shot.name(seen), calibration, &mut view)? {
            Ok((frame, view)) => match tracker.look(&frame, view) {
                Some(ring) => Ok((frame, view, ring)),
                None => Err("no circle was found".into()),
            },
            Err(reason) => Err(reason),
        };
        let (frame, view, ring) = match looked {
            Ok(all) => all,
            Err(reason) => {
                failed += 1;
                tell(News::NotSeen(reason.clone()))?;
                why = reason;
                continue;
            }
        };
        if average.n == 1 && last.as_ref().is_some_and(|last| shot.is_copy_of(&last.shot)) {
            tell(News::Copy)?;
        }
        if average.add(&ring, 0.25 * view.pixel_mm()) {
            tell(News::Moved)?;
        }
        let mut report = report(&average, &ring, view, calibration, options);
        report.count(seen, failed, feed.stats());
        report.frames_per_s = (seen - 1) as f64 / first.elapsed().as_secs_f64().max(1e-9);
        tell(News::Seen(&report, &frame, view, &ring))?;
        let done = report.is_done();
        last = Some(Centred { report, shot });
        if done {
            break;
        }
    }
    // Frames may have come after the last that showed the circle.
    if let Some(last) = &mut last {
        last.report.count(seen, failed, feed.stats());
    }
    last.ok_or_else(|| {
        Error::measure(
            "source",
            format!("nothing was measured in {seen} frames: {why}"),
            "check the light, --diameter-mm and the calibration's scale, or the camera's address",
        )
    })
}

/// A frame as it is measured, with the view of the first one; or why it cannot be: a damaged frame is not the stream's end.
fn usable<'v>(
    shot: &Shot,
    name: &str,
    calibration: &Calibration,
    view: &'v mut Option<View>,
) -> Result<std::result::Result<(Frame, &'v View), String>> {
    let frame = match shot.frame() {
        Ok(frame) => calibration.linear(frame),
        Err(e) => return Ok(Err(e.to_string())),
    };
    let (width, height) = (frame.width(), frame.height());
    let view = match view {
        Some(view) => view,
        None => view.insert(calibration.view_of(name, width, height)?),
    };
    let (w, h) = (view.width_px(), view.height_px());
    Ok(match (w, h) == (width, height) {
        true => Ok((frame, view)),
        false => {
            Err(format!("{name} has {width}×{height} px where the first frame has {w}×{h} px"))
        }
    })
}

fn check(options: &Options) -> Result<()> {
    let lengths = [
        ("--u95-mm", Some(options.u95_mm)),
        ("--diameter-mm", options.diameter_mm),
        ("--tolerance-mm", options.tolerance_mm),
    ];
    for (name, value) in lengths {
        value.map_or(Ok(()), |v| above_zero(name, v, "give a length in mm"))?;
    }
    Ok(())
}

/// What the average so far says.
fn report(
    average: &Average,
    ring: &Ring,
    view: &View,
    calibration: &Calibration,
    options: &Options,
) -> Report {
    // The plane's errors are the same in all frames.
    let plane = PlaneErrors::of(view, ring).center_covariance(f64::INFINITY);
    let own = nalgebra::Matrix2::from_diagonal(&average.u95().map(|u| (u / K95).powi(2)));
    let covariance = own + plane;
    let u95 = covariance.diagonal().map(|v| K95 * v.sqrt());
    let (distance_mm, distance_u95_mm) = distance(average.mean, covariance, f64::INFINITY);
    let good = average.n >= LEAST_FRAMES && u95.max() <= options.u95_mm;
    let verdict = match (good, options.tolerance_mm) {
        (false, _) => Some(Verdict::Undecided),
        (true, Some(limit)) => Some(Verdict::of(distance_mm, distance_u95_mm, limit)),
        (true, None) => None,
    };
    Report {
        offset_mm: average.mean.into(),
        offset_u95_mm: u95.into(),
        distance_mm,
        distance_u95_mm,
        move_mm: average.mean.into(),
        move_laser_mm: calibration
            .laser
            .as_ref()
            .map(|l| (average.mean - Vector2::from(l.offset_mm)).into()),
        move_laser_u95_mm: calibration.laser.as_ref().map(|l| {
            let laser = l.offset_u95_mm.unwrap_or_default();
            [0, 1].map(|k| u95[k].hypot(laser[k]))
        }),
        diameter_mm: 2.0 * ring.circle.radius,
        arc_coverage: ring.arc_coverage,
        frames_used: average.n,
        frames_seen: 0,
        frames_failed: 0,
        received: 0,
        dropped: 0,
        reconnects: 0,
        frames_per_s: 0.0,
        verdict,
    }
}
