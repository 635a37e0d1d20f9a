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
use crate::live::track::Tracker;
use crate::live::{Event, Feed, Shot, Stats};
use crate::measure::plane_errors::PlaneErrors;
use crate::measure::ring::Ring;
use crate::uncertainty::{K95, Verdict, distance, k95};

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
    /// Whether the asked uncertainty (and the tolerance, where one is given) was reached.
    pub verdict: Verdict,
}

impl Report {
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
        // A damaged frame is not the stream's end.
        let frame = match shot.frame() {
            Ok(frame) => calibration.linear(frame),
            Err(e) => {
                failed += 1;
                tell(News::NotSeen(e.to_string()))?;
                continue;
            }
        };
        let (width, height) = (frame.width(), frame.height());
        let view = match &view {
            Some(view) => view,
            None => view.insert(calibration.view_of(&shot.name(seen), width, height)?),
        };
        if (view.width_px(), view.height_px()) != (width, height) {
            failed += 1;
            let (w, h) = (view.width_px(), view.height_px());
            let name = shot.name(seen);
            why = format!("{name} has {width}×{height} px where the first frame has {w}×{h} px");
            tell(News::NotSeen(why.clone()))?;
            continue;
        }
        let Some(ring) = tracker.look(&frame, view) else {
            failed += 1;
            why = "no circle was found".into();
            tell(News::NotSeen(why.clone()))?;
            continue;
        };
        if average.add(&ring, 0.25 * view.pixel_mm()) {
            tell(News::Moved)?;
        }
        let mut report = average.report(&ring, view, calibration, options);
        report.count(seen, failed, feed.stats());
        report.frames_per_s = (seen - 1) as f64 / first.elapsed().as_secs_f64().max(1e-9);
        tell(News::Seen(&report, &frame, view, &ring))?;
        let done = report.verdict == Verdict::Pass;
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

/// The running mean of the centres since the last move.
#[derive(Debug, Clone, Default)]
struct Average {
    n: usize,
    mean: Vector2<f64>,
    squares: Vector2<f64>,
    /// The last centre, and the sum of the squared steps from each to the next.
    last: Vector2<f64>,
    steps: Vector2<f64>,
    own: Vector2<f64>,
}

/// Frames that the scatter is told from, and that a result needs.
pub const LEAST_FRAMES: usize = 3;

/// How many standard deviations steps must be too small for the scatter before the centre is said to creep.
const CREEPS: f64 = 3.0;

impl Average {
    /// Takes in a frame's centre; `true` where it has moved and the average began anew.
    fn add(&mut self, ring: &Ring, least_mm: f64) -> bool {
        let center = ring.circle.center;
        let scatter = if self.n > 2 {
            (self.squares / (self.n - 1) as f64).map(f64::sqrt)
        } else {
            Vector2::zeros()
        };
        let moved = self.n > 0
            && ((center - self.mean).norm() > 6.0 * scatter.norm() + least_mm || self.creeps());
        if moved {
            *self = Self::default();
        }
        self.n += 1;
        let n = self.n as f64;
        let before = center - self.mean;
        self.mean += before / n;
        self.squares += before.component_mul(&(center - self.mean));
        if self.n > 1 {
            self.steps += (center - self.last).map(|d| d * d);
        }
        self.last = center;
        let factor = k95(ring.dof);
        let own = Vector2::new(ring.covariance[(0, 0)], ring.covariance[(1, 1)]);
        self.own += (own * factor * factor - self.own) / n;
        moved
    }

    /// How far the frames follow one another instead of scattering about the mean: 0 for independent ones, 1 for a slow drift.
    fn follow(steps: f64, squares: f64) -> f64 {
        if squares > 0.0 { 1.0 - 0.5 * steps / squares } else { 0.0 }
    }

    /// Whether the centre moves by less from frame to frame than it strays from the mean (von Neumann 1941; the standard
    /// deviation is that of independent frames, Young 1941).
    fn creeps(&self) -> bool {
        let n = self.n as f64;
        let sd = ((n - 2.0) / (n * n - 1.0)).sqrt();
        self.n > 3 && Self::follow(self.steps.sum(), self.squares.sum()) > CREEPS * sd
    }

    /// Half-widths of the mean's 95 % intervals.
    fn u95(&self) -> Vector2<f64> {
        let n = self.n as f64;
        if self.n < LEAST_FRAMES {
            // Two frames may differ because the centre has moved: it is where the later one says.
            return self.own.zip_map(&self.steps, |own, s| (own.max(0.0) + 0.25 * s).sqrt());
        }
        let factor = k95(n - 1.0);
        Vector2::from_fn(|i, _| {
            let (own, s) = (self.own[i], self.squares[i] / (n - 1.0));
            // Frames that follow one another count as fewer.
            let follow = Self::follow(self.steps[i], self.squares[i]).clamp(0.0, 0.99);
            let fewer = (1.0 + follow) / (1.0 - follow);
            // What of a frame's uncertainty does not show as scatter is the same in every frame; a tenth of it at least,
            // since what shows as scatter is itself not known well.
            ((own - K95 * K95 * s).max(0.1 * own) + factor * factor * s * fewer / n).sqrt()
        })
    }

    fn report(
        &self,
        ring: &Ring,
        view: &View,
        calibration: &Calibration,
        options: &Options,
    ) -> Report {
        // The plane's errors are the same in all frames.
        let plane = PlaneErrors::of(view, ring).center_covariance(f64::INFINITY);
        let own = nalgebra::Matrix2::from_diagonal(&self.u95().map(|u| (u / K95).powi(2)));
        let covariance = own + plane;
        let u95 = covariance.diagonal().map(|v| K95 * v.sqrt());
        let (distance_mm, distance_u95_mm) = distance(self.mean, covariance, f64::INFINITY);
        let good = self.n >= LEAST_FRAMES && u95.max() <= options.u95_mm;
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
            move_laser_u95_mm: calibration.laser.as_ref().map(|l| {
                let laser = l.offset_u95_mm.unwrap_or_default();
                [0, 1].map(|k| u95[k].hypot(laser[k]))
            }),
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// A circle of which only the centre and its variance matter.
    fn ring(x: f64, y: f64) -> Ring {
        Ring {
            circle: crate::fit::Circle { center: Vector2::new(x, y), radius: 1.0 },
            covariance: Matrix3::identity() * 1e-8,
            dof: f64::INFINITY,
            fitted_sd_mm: 1e-4,
            center_px: Vector2::zeros(),
            form_rms_mm: 0.0,
            form_from_texture_mm: 0.0,
            edge_points: 100,
            gain: 1.0,
            other_mm: None,
            arc_coverage: 1.0,
            contrast: 50.0,
            noise: 1.0,
            softness_px: 2.0,
            blur_mm: 0.0,
            clipped_inside: false,
            clipped_outside: false,
            wander: Default::default(),
            trace: Vec::new(),
            residuals: Vec::new(),
        }
    }

    /// Scatter that repeats, of about 1.
    fn noise(i: usize) -> f64 {
        let n = |k: f64| (k * (i as f64 + 0.7)).sin() * 43758.5453 % 1.0;
        n(12.9898) + n(78.233) + n(37.719)
    }

    #[test]
    fn a_creeping_centre_begins_the_average_anew_and_one_that_stays_does_not() {
        let anew = |creep_mm: f64| {
            let mut average = Average::default();
            let mut count = 0;
            for i in 0..60 {
                let at = creep_mm * i as f64;
                count += usize::from(
                    average.add(&ring(at + 1e-4 * noise(i), 1e-4 * noise(i + 500)), 0.005),
                );
                let lag = (average.mean.x - at).abs();
                assert!(lag < 2.0 * average.u95().x, "{i}: {lag} {}", average.u95().x);
            }
            count
        };
        assert_eq!(anew(0.0), 0);
        assert!(anew(0.001) > 3);
    }
}
