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
    #[arg(long, value_name = "U", default_value_t = 0.0)]
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
    /// Of all pictures.
    verdict: Verdict,
    /// What is known.
    diameter_mm: f64,
    /// Picture by picture.
    results: Vec<DiameterReport>,
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
            let mut warnings = Vec::new();
            let captures = read_captures(path, &mut warnings)?;
            global.reads(path, captures.iter().map(|c| &c.path))?;
            let mut report = check::plane(&captures, &calibration, args.tolerance_mm)
                .map_err(|e| e.in_file(path, None))?;
            report.warnings.splice(..0, warnings);
            report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
            let json = result("calib-check", path, &report.warnings, &report);
            Ok(outcome(Document::single(json, plane_table(&report)), report.verdict))
        }
        (Some(known), false, images) => {
            let reports = images
                .iter()
                .map(|image| {
                    let subject = image.display().to_string();
                    check::diameter(
                        &Picture::read(image)?,
                        &calibration,
                        known,
                        args.diameter_u95_mm,
                        args.tolerance_mm,
                        &subject,
                    )
                })
                .collect::<Result<Vec<_>>>()?;
            let verdict = check::overall(reports.iter().map(|r| r.verdict));
            let table = diameter_table(&reports, verdict);
            let diameters = Diameters { verdict, diameter_mm: known, results: reports };
            let json = result("calib-check", images, &[], &diameters);
            Ok(outcome(Document { json, rows: rows(&diameters.results), table }, verdict))
        }
        _ => Err(Error::option(
            "calib check",
            "needs either pictures with --diameter-mm, or one captures table alone",
            "photograph a circle of known diameter, or a mark from known machine positions",
        )),
    }
}

fn outcome(document: Document, verdict: Verdict) -> Outcome {
    let status = if verdict == Verdict::Pass { Status::Good } else { Status::OutOfTolerance };
    Outcome { document: Some(document), status }
}

fn diameter_table(reports: &[DiameterReport], verdict: Verdict) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    for r in reports {
        let _ = writeln!(
            t,
            "{:<24} Ø {:.5} mm   off by {} mm   {}",
            r.image,
            r.diameter_mm,
            text(r.deviation_mm, r.deviation_u95_mm),
            r.verdict
        );
    }
    let _ = writeln!(t, "calibration: {verdict}");
    t
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
