//! `pivotsight center`: guides an operator over the centre of a rim or a mark.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::outfiles::OutFile;
use super::{Global, Outcome, Status, result, seconds};
use crate::camera::Calibration;
use crate::draw;
use crate::error::{Error, Result};
use crate::frame::named::ends_in;
use crate::live::average::LEAST_FRAMES;
use crate::live::center::{self, News, Options, Report};
use crate::live::store::{Position, Store};
use crate::live::{self, Feed};
use crate::output::{Document, write_whole};
use crate::uncertainty::text;
use crate::units;

/// Guides over a rim or a round mark with a live picture: its offset from the camera axis and the moves that centre it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A camera's number or a video file (need OpenCV built in), a folder of pictures, or an http:// MJPEG stream
    #[arg(value_name = "SOURCE")]
    source: String,
    /// The camera's calibration file
    #[arg(long, value_name = "FILE")]
    calib: PathBuf,
    /// Diameter of the rim or mark, to a tenth; known to 0.02 mm it also carries arcs
    #[arg(long, value_name = "D")]
    diameter_mm: Option<f64>,
    /// Average frames until the centre is known this well (95 %)
    #[arg(long, value_name = "MM", default_value_t = 0.002)]
    u95_mm: f64,
    /// Guide on until the centre is this near to the camera axis, for certain
    #[arg(long, value_name = "MM")]
    tolerance_mm: Option<f64>,
    /// Longest time in seconds
    #[arg(long, value_name = "S", default_value_t = 300.0)]
    timeout_s: f64,
    /// Write a picture of what is seen to FILE.png, once a second and at the end
    #[arg(long, value_name = "FILE")]
    overlay: Option<OutFile>,
    /// Store the last picture in DIR with the machine position given by --at
    #[arg(long, value_name = "DIR", requires = "at")]
    store: Option<PathBuf>,
    /// The machine's position: X,Y or X,Y,C
    #[arg(long, value_name = "X,Y[,C]", allow_hyphen_values = true)]
    at: Option<String>,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output<'r> {
    #[serde(flatten)]
    report: &'r Report,
    /// Where the machine has to be for the laser (the camera, where no laser offset is known) to be over the centre.
    #[serde(skip_serializing_if = "Option::is_none")]
    center_machine_mm: Option<[f64; 2]>,
    /// The picture stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    stored: Option<String>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let options = Options {
        diameter_mm: args.diameter_mm,
        u95_mm: args.u95_mm,
        tolerance_mm: args.tolerance_mm,
        timeout: seconds("--timeout-s", args.timeout_s)?,
    };
    if let Some(path) = args.overlay.as_deref().filter(|p| !ends_in(p, &["png"])) {
        let reason = format!("'{}' is to hold a PNG picture", path.display());
        return Err(Error::option("--overlay", reason, "give a name that ends in .png"));
    }
    let at = args.at.as_deref().map(Position::parse).transpose()?;
    let calibration = Calibration::read(&args.calib)?;
    let mut store = args.store.as_deref().map(Store::open).transpose()?;
    global.reads(Path::new(&args.source), live::files(&args.source)?)?;
    let mut feed = Feed::open(&args.source)?;
    let mut terminal = Terminal::new(global);
    let mut drawn: Option<Instant> = None;
    let made = center::run(&mut feed, &calibration, &options, |news| {
        if let (News::Seen(report, frame, view, ring), Some(path)) = (&news, &args.overlay) {
            let due = drawn.is_none_or(|t| t.elapsed() > Duration::from_secs(1));
            if due || report.is_done() {
                write_whole(path, &draw::center(frame, view, ring, report)?)?;
                drawn = Some(Instant::now());
            }
        }
        terminal.tell(&news);
        Ok(())
    })?;
    terminal.end();
    let report = &made.report;
    let mut warnings: Vec<String> = calibration.doubts();
    warnings.extend(args.tolerance_mm.and_then(|mm| units::limit("--tolerance-mm", mm)));
    if !report.is_done() && args.tolerance_mm.is_none() {
        warnings.push(if report.frames_used < LEAST_FRAMES {
            format!(
                "{} frames show the centre in one place, {} have to: let more come",
                report.frames_used, LEAST_FRAMES
            )
        } else {
            format!(
                "the centre is known to {:.4} mm only, not to {} mm",
                report.offset_u95_mm[0].max(report.offset_u95_mm[1]),
                args.u95_mm
            )
        });
    }
    let there = at.map(|at| {
        let laser = calibration.laser.as_ref();
        let from = [at.x_mm, at.y_mm].into();
        crate::calib::laser::machine_mm(from, report.offset_mm.into(), laser).into()
    });
    let stored = match (at, &mut store) {
        (Some(at), Some(store)) => Some(store.add(&made.shot, at)?),
        _ => None,
    };
    let output = Output { report, center_machine_mm: there, stored };
    let json = result("center", &args.source, &warnings, &output);
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let status = if report.is_done() { Status::Good } else { Status::OutOfTolerance };
    let words = table(report, args.tolerance_mm.is_some());
    Ok(Outcome { document: Some(Document::single(json, words)), status })
}

/// One line that is written over and over on a terminal; news stays.
struct Terminal<'a> {
    global: &'a Global,
    overwrites: bool,
    shown: Option<Instant>,
}

impl<'a> Terminal<'a> {
    fn new(global: &'a Global) -> Self {
        let overwrites = !global.quiet && std::io::stderr().is_terminal();
        Self { global, overwrites, shown: None }
    }

    fn tell(&mut self, news: &News<'_>) {
        match news {
            News::Seen(r, ..) => self.line(r),
            News::NotSeen(why) => {
                if self.shown.is_none_or(|t| t.elapsed() > Duration::from_secs(1)) {
                    self.say(&format!("not measured: {why}"));
                    self.shown = Some(Instant::now());
                }
            }
            News::Copy => {
                self.say("the second frame is a copy of the first: is the camera running?")
            }
            News::Moved => {}
            News::Stalled(silent) => {
                self.say(&format!("STALLED: no frame for {:.1} s", silent.as_secs_f64()))
            }
            News::Lost(reason) => self.say(&format!("LOST: {reason}; trying again")),
            News::Back => self.say("the source is back"),
        }
    }

    /// At most five times a second, and only where it can be written over.
    fn line(&mut self, r: &Report) {
        if !self.overwrites || self.shown.is_some_and(|t| t.elapsed() < Duration::from_millis(200))
        {
            return;
        }
        self.shown = Some(Instant::now());
        eprint!(
            "\rmove X {:+.4} ± {:.4}  Y {:+.4} ± {:.4} mm   {} frames, {:.0}/s, {} dropped   ",
            r.move_mm[0],
            r.offset_u95_mm[0],
            r.move_mm[1],
            r.offset_u95_mm[1],
            r.frames_used,
            r.frames_per_s,
            r.dropped
        );
        let _ = std::io::stderr().flush();
    }

    fn say(&mut self, words: &str) {
        self.end();
        self.global.say(words);
    }

    /// Leaves the line.
    fn end(&mut self) {
        if self.overwrites && self.shown.take().is_some() {
            eprintln!();
        }
    }
}

fn table(r: &Report, judged: bool) -> String {
    let pair = |v: [f64; 2], u95: [f64; 2]| {
        format!("X {} mm   Y {} mm", text(v[0], u95[0]), text(v[1], u95[1]))
    };
    let laser = r.move_laser_mm.zip(r.move_laser_u95_mm);
    let laser =
        laser.map_or(String::new(), |(v, u95)| format!("laser over it   move {}\n", pair(v, u95)));
    format!(
        "camera over it  move {}\n{laser}distance        {} mm   Ø {:.4} mm, edge {:.0} %\nframes          {} averaged of {} looked at ({:.1}/s), {} received, {} dropped, {} reconnects\n{}\n",
        pair(r.move_mm, r.offset_u95_mm),
        text(r.distance_mm, r.distance_u95_mm),
        r.diameter_mm,
        100.0 * r.arc_coverage,
        r.frames_used,
        r.frames_seen,
        r.frames_per_s,
        r.received,
        r.dropped,
        r.reconnects,
        match (judged, r.verdict) {
            (true, Some(verdict)) => format!("verdict         {verdict}"),
            (_, None) => "as sure as asked (no --tolerance-mm: nothing is judged)".to_owned(),
            (false, _) => "not as sure as asked".to_owned(),
        }
    )
}
