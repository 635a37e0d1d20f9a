//! `pivotsight calib check`: does a calibration still hold?

use std::fmt::Write;
use std::path::PathBuf;

use super::super::{Global, Outcome, Status, result, rows};
use crate::calib::check::{self, DiameterReport, PlaneReport};
use crate::camera::Calibration;
use crate::error::{Error, Result};
use crate::frame::Picture;
use crate::frame::named::ends_in;
use crate::measure::rod::read_captures;
use crate::output::Document;
use crate::uncertainty::{Verdict, text};

/// Measures a known object again and tells whether the calibration still holds
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Pictures of a circle of known diameter, or one captures table (.csv) of a mark at known machine positions
    #[arg(value_name = "IMAGE|CAPTURES.csv", required = true)]
    inputs: Vec<PathBuf>,
    /// The calibration file
    #[arg(long, value_name = "FILE")]
    calib: PathBuf,
    /// The known diameter
    #[arg(long, value_name = "D")]
    diameter_mm: Option<f64>,
    /// Half-width of the known diameter's 95 % interval
    #[arg(long, requires = "diameter_mm", value_name = "U", default_value_t = 0.0)]
    diameter_u95_mm: f64,
    /// Largest deviation with which the calibration still holds
    #[arg(long, value_name = "MM", default_value_t = 0.01)]
    tolerance_mm: f64,
}

/// What is printed.
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)] // Only described.
pub enum Output {
    Plane(PlaneReport),
    Diameters(Diameters),
}

/// Circles of one known diameter.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Diameters {
    /// Of all pictures that could be measured.
    verdict: Verdict,
    /// What is known.
    diameter_mm: f64,
    /// Picture by picture.
    results: Vec<Checked>,
}

/// What became of a picture.
#[derive(serde::Serialize, schemars::JsonSchema)]
#[serde(untagged)]
pub enum Checked {
    /// It was measured.
    Measured(DiameterReport),
    /// It could not be.
    Failed {
        /// The picture's file.
        image: String,
        /// Why not.
        error: String,
    },
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    for (name, value) in
        [("--tolerance-mm", args.tolerance_mm), ("--diameter-u95-mm", args.diameter_u95_mm)]
    {
        if !(value.is_finite() && value >= 0.0) {
            return Err(Error::option(name, format!("is {value}"), "give a length in mm"));
        }
    }
    let calibration = Calibration::read(&args.calib)?;
    let table_given = ends_in(&args.inputs[0], &["csv"]);
    match (args.diameter_mm, table_given, &args.inputs[..]) {
        (None, true, [path]) => {
            let mut warnings: Vec<String> = calibration.doubts();
            let captures = read_captures(path, &mut warnings)?;
            global.reads(path, captures.iter().map(|c| &c.path))?;
            let mut report = check::plane(&captures, &calibration, args.tolerance_mm)
                .map_err(|e| e.in_file(path, None))?;
            report.warnings.splice(..0, warnings);
            report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
            let json = result("calib-check", path, &report.warnings, &report);
            Ok(outcome(Document::single(json, plane_table(&report)), report.verdict))
        }
        (Some(known), false, images) => diameters(args, images, known, &calibration, global),
        _ => Err(Error::option(
            "calib check",
            "needs either pictures with --diameter-mm, or one captures table alone",
            "photograph a circle of known diameter, or a mark from known machine positions",
        )),
    }
}

/// Measures the circle in every picture. A single picture that fails is the command's error; of several each is an entry.
fn diameters(
    args: &Args,
    images: &[PathBuf],
    known: f64,
    calibration: &Calibration,
    global: &Global,
) -> Result<Outcome> {
    let (u95_mm, tolerance_mm) = (args.diameter_u95_mm, args.tolerance_mm);
    let (mut results, mut table, mut verdicts) = (Vec::new(), String::new(), Vec::new());
    for path in images {
        let image = path.display().to_string();
        let measured = Picture::read(path).and_then(|picture| {
            check::diameter(&picture, calibration, known, u95_mm, tolerance_mm, &image)
        });
        match measured {
            Ok(report) => {
                table.push_str(&diameter_line(&report));
                verdicts.push(report.verdict);
                results.push(Checked::Measured(report));
            }
            Err(e) if images.len() == 1 => return Err(e),
            Err(e) => {
                global.say(format!("pivotsight: {e}"));
                table.push_str(&format!("{image:<24} FAILED: {e}\n"));
                results.push(Checked::Failed { image, error: e.to_string() });
            }
        }
    }
    let verdict = Verdict::worst(verdicts.iter().copied()).unwrap_or(Verdict::Undecided);
    let _ = writeln!(table, "calibration: {verdict}");
    let rows = rows(&results);
    let json =
        result("calib-check", images, &[], &Diameters { verdict, diameter_mm: known, results });
    let mut outcome = outcome(Document { json, rows, table }, verdict);
    match verdicts.len() {
        0 => outcome.status = Status::BadInput,
        n if n < images.len() => outcome.status = Status::SomeFailed,
        _ => {}
    }
    Ok(outcome)
}

fn outcome(document: Document, verdict: Verdict) -> Outcome {
    let status = if verdict == Verdict::Pass { Status::Good } else { Status::OutOfTolerance };
    Outcome { document: Some(document), status }
}

fn diameter_line(r: &DiameterReport) -> String {
    let off = text(r.deviation_mm, r.deviation_u95_mm);
    format!("{:<24} Ø {:.5} mm   off by {off} mm   {}\n", r.image, r.diameter_mm, r.verdict)
}

fn plane_table(r: &PlaneReport) -> String {
    format!(
        "scale off by     {} %\nrotation off by  {} °\nin the frame     off by up to {} mm\nresiduals        {:.5} mm rms over {} captures\ncalibration: {}\n",
        text(r.scale_error_percent, r.scale_error_u95_percent),
        text(r.rotation_error_deg, r.rotation_error_u95_deg),
        text(r.field_error_mm, r.field_error_u95_mm),
        r.residual_rms_mm,
        r.captures_used,
        r.verdict
    )
}
