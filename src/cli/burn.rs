//! `pivotsight burn`: is the spot concentric with the ring, and what has to be turned?

use std::fmt::Write;
use std::path::PathBuf;

use serde::Deserialize;
use serde_json::json;

use super::pictures::{self, Camera, Shown};
use super::{Global, Outcome, Status, place};
use crate::camera::Calibration;
use crate::draw;
use crate::error::{Error, Result};
use crate::frame::{Channel, Picture};
use crate::measure::CircleReport;
use crate::measure::burn::{self, Options, Report, ToleranceKind};
use crate::measure::cross;
use crate::measure::offset::{self, Offset};
use crate::output::{Document, Format};
use crate::repeats;
use crate::uncertainty::{Verdict, text};

/// Measures burn tests: the spot against the ring, the verdict, and how to turn B and shim the head
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Pictures of burn tests
    #[arg(value_name = "IMAGE", required = true)]
    images: Vec<PathBuf>,
    /// The camera's calibration file
    #[arg(long, value_name = "FILE")]
    calib: PathBuf,
    /// The limit
    #[arg(long, value_name = "MM", default_value_t = 0.01)]
    tolerance_mm: f64,
    /// What the limit applies to
    #[arg(long, value_enum, default_value = "distance")]
    tolerance_kind: ToleranceKind,
    /// Nozzle height at which the ring was burnt
    #[arg(long, value_name = "MM", default_value_t = 50.0)]
    ring_height_mm: f64,
    /// Nozzle height at which the spot was burnt
    #[arg(long, value_name = "MM", default_value_t = 3.0)]
    spot_height_mm: f64,
    /// Length of the head's flange over which shims tilt it
    #[arg(long, value_name = "L")]
    flange_mm: Option<f64>,
    /// Which part of colour pictures is measured
    #[arg(long, value_enum, default_value = "auto")]
    channel: Channel,
    /// About where the ring's centre is in the plane, for pictures with several burns
    #[arg(long, value_name = "X,Y", value_parser = place, allow_hyphen_values = true)]
    near_mm: Option<[f64; 2]>,
    /// The pictures are of tests burnt at one setting, each on a fresh place: judge their mean
    #[arg(long)]
    mean: bool,
    /// Write pictures of what was measured to DIR
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Ask OpenCV for a second opinion on the same pictures (needs it built in)
    #[arg(long)]
    cross_check: bool,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let options = Options {
        tolerance_mm: args.tolerance_mm,
        tolerance_kind: args.tolerance_kind,
        ring_height_mm: args.ring_height_mm,
        spot_height_mm: args.spot_height_mm,
        flange_mm: args.flange_mm,
        channel: args.channel,
        near_mm: args.near_mm,
    };
    burn::check(&options)?;
    if args.mean && args.images.len() < 2 {
        return Err(Error::option(
            "--mean",
            "is of several pictures, and there is one",
            "give the pictures of all tests burnt at this setting",
        ));
    }
    if args.mean && !matches!(global.format, Format::Table | Format::Json) {
        return Err(Error::option(
            "--mean",
            "has no place among rows of one picture each",
            "use --format table or json",
        ));
    }
    if args.mean {
        each_once(&args.images)?;
    }
    let (calibration, identity) = Calibration::identified(&args.calib)?;
    let overlay = args.overlay.as_deref();
    let doubts = calibration.doubts().into_iter().chain(burn::doubts(&options)).collect();
    let camera =
        Camera { calibration: &calibration, identity: &identity, channel: args.channel, doubts };
    let measure = |picture: &Picture, subject: &str| {
        let measured = burn::measure(picture, &calibration, &options, subject)?;
        let report = &measured.report;
        let overlay = match &args.overlay {
            Some(_) => Some(draw::burn(picture, &calibration, &measured, subject)?),
            None => None,
        };
        let mut shown = Shown {
            keys: pictures::keys(report, subject)?,
            table: format!("{subject}\n{}", table(report)),
            warnings: report.warnings.clone(),
            good: report.offset.verdict == Verdict::Pass,
            overlay,
            size: picture.size(),
        };
        if args.cross_check {
            let frame = calibration.light_in(picture, report.channel);
            let view = calibration.view(frame.width(), frame.height())?;
            shown.cross_check(&cross::circles(&frame, &view, &named(report))?);
        }
        Ok(shown)
    };
    let mut outcome = pictures::run("burn", &args.images, camera, overlay, global, measure)?;
    if args.mean {
        add_mean(&mut outcome, &options, global);
    }
    Ok(outcome)
}

/// Tests that are one picture twice are no two tests: their mean would seem surer than it is.
fn each_once(images: &[PathBuf]) -> Result<()> {
    // What cannot be read is said with its picture.
    let firsts = repeats::firsts(repeats::contents(images));
    match images.iter().zip(firsts).find_map(|(image, first)| Some((image, first?))) {
        None => Ok(()),
        Some((image, first)) => Err(Error::option(
            "--mean",
            format!("'{}' and '{}' are one picture", images[first].display(), image.display()),
            "give each test once",
        )),
    }
}

/// Adds the mean of the tests that were measured; its verdict is the command's.
fn add_mean(outcome: &mut Outcome, options: &Options, global: &Global) {
    let Some(document) = &mut outcome.document else { return };
    let tests: Vec<Offset> =
        document.rows.iter().filter_map(|row| Offset::deserialize(row).ok()).collect();
    let mean = match offset::mean(&tests, options) {
        Ok(mean) => mean,
        // What was measured is shown all the same.
        Err(e) => {
            warn(document, format!("no mean: {e}"), global);
            return;
        }
    };
    if let Some(warning) = mean.warning() {
        warn(document, warning, global);
    }
    let _ = writeln!(document.table, "mean of {} tests", mean.tests);
    document.table.push_str(&lines(&mean.offset));
    document.json["mean"] = json!(mean);
    if outcome.status != Status::SomeFailed {
        outcome.status = pictures::status(mean.offset.verdict == Verdict::Pass);
    }
}

/// A warning on the screen and in the result.
fn warn(document: &mut Document, warning: String, global: &Global) {
    global.say(format!("warning: {warning}"));
    if let Some(warnings) = document.json["warnings"].as_array_mut() {
        warnings.push(warning.into());
    }
}

/// The circles by name.
fn named(r: &Report) -> [(String, &CircleReport); 2] {
    [("ring".into(), &r.ring), ("spot".into(), &r.spot)]
}

fn table(r: &Report) -> String {
    let [ring, spot] = [&r.ring, &r.spot].map(circle);
    format!("  {:<11}{ring}\n  {:<11}{spot}\n{}", "ring", "spot", lines(&r.offset))
}

/// How far the spot lies from the ring, and what to turn.
fn lines(r: &Offset) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        t,
        "  {:<11}dx {} mm   dy {} mm   (spot - ring)",
        "offset",
        text(r.offset_mm[0], r.offset_u95_mm[0]),
        text(r.offset_mm[1], r.offset_u95_mm[1]),
    );
    let (of_distance, of_zone) = match r.tolerance_kind {
        ToleranceKind::Distance => (format!(" (limit {} mm)", r.tolerance_mm), String::new()),
        ToleranceKind::Zone => (String::new(), format!(" (limit {} mm)", r.tolerance_mm)),
    };
    let _ = writeln!(
        t,
        "  {:<11}{} mm{of_distance}   zone {} mm{of_zone}",
        "distance",
        text(r.distance_mm, r.distance_u95_mm),
        text(r.zone_mm, r.zone_u95_mm),
    );
    let _ = writeln!(t, "  {:<11}{}", "verdict", verdict(r.verdict));
    let c = &r.correction;
    let _ = writeln!(
        t,
        "  {:<11}{}° about Y: {}",
        "turn B by",
        text(c.b_deg, c.b_u95_deg),
        swing(c.b_way())
    );
    let shims = c.shim_mm.zip(c.shim_u95_mm);
    let shims =
        shims.map_or(String::new(), |(mm, u95)| format!(", shims of {} mm", text(mm.abs(), u95)));
    let _ = writeln!(
        t,
        "  {:<11}{}° about X: {}{shims}",
        "shim by",
        text(c.shim_deg, c.shim_u95_deg),
        swing(c.shim_way())
    );
    t
}

/// A circle in one line.
pub fn circle(c: &CircleReport) -> String {
    format!(
        "Ø {} mm   at ({}, {}) ± ({:.5}, {:.5}) mm   edge {:.0} %, form {:.4} mm rms",
        text(c.diameter_mm, c.diameter_u95_mm),
        bare(c.center_mm[0], c.center_u95_mm[0]),
        bare(c.center_mm[1], c.center_u95_mm[1]),
        c.center_u95_mm[0],
        c.center_u95_mm[1],
        100.0 * c.arc_coverage,
        c.form_rms_mm,
    )
}

fn bare(value: f64, u95: f64) -> String {
    text(value, u95).split(' ').next().unwrap_or_default().to_owned()
}

fn verdict(v: Verdict) -> &'static str {
    match v {
        Verdict::Pass => "PASS",
        Verdict::Fail => "FAIL",
        Verdict::Undecided => {
            "UNDECIDED: the limit lies inside the uncertainty; measure again, or better"
        }
    }
}

/// Which way the nozzle has to swing, or that nothing is to be turned.
fn swing(way: Option<&str>) -> String {
    way.map_or_else(
        || "nothing to turn, the offset is within its uncertainty".to_owned(),
        |way| format!("the nozzle has to swing towards {way}"),
    )
}
