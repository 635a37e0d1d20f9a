//! `pivotsight calib laser`: where the laser axis is, seen from the camera axis.

use std::fmt::Write;
use std::path::PathBuf;

use super::super::outfiles::OutFile;
use super::super::{Global, Outcome, result};
use crate::calib::laser::{self, Report};
use crate::camera::Calibration;
use crate::error::Result;
use crate::output::Document;
use crate::uncertainty::text;

/// Finds the laser axis seen from the camera axis, from burns shot at one machine position and photographed at another
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Table of the burns: image, burn_x_mm,burn_y_mm (where the laser fired), x_mm,y_mm (where it was photographed)
    #[arg(value_name = "BURNS.csv")]
    burns: PathBuf,
    /// The camera's calibration file
    #[arg(long, value_name = "FILE")]
    calib: PathBuf,
    /// Diameter of the burns, to a tenth
    #[arg(long, value_name = "D")]
    diameter_mm: f64,
    /// Write the calibration with the new [laser] to FILE (which may be the one given)
    #[arg(long, value_name = "FILE")]
    write_calib: Option<OutFile>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let mut calibration = Calibration::read(&args.calib)?;
    let mut warnings: Vec<String> = calibration.doubts();
    let burns = laser::read(&args.burns, &mut warnings)?;
    global.reads(&args.burns, burns.iter().map(|b| &b.path))?;
    let mut report = laser::calibrate(&burns, &calibration, args.diameter_mm)
        .map_err(|e| e.in_file(&args.burns, None))?;
    report.warnings.splice(..0, warnings);
    if let Some(path) = &args.write_calib {
        calibration.laser = Some(report.laser());
        global.write(path, calibration.to_toml().as_bytes())?;
    }
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let json = result("calib-laser", &args.burns, &report.warnings, &report);
    Ok(Outcome::good(Document::single(json, table(&report))))
}

fn table(r: &Report) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        t,
        "laser axis, seen from the camera axis   x {} mm   y {} mm",
        text(r.offset_mm[0], r.offset_u95_mm[0]),
        text(r.offset_mm[1], r.offset_u95_mm[1])
    );
    let _ = writeln!(
        t,
        "burn                 seen at x          y    offset x          y    residual x, y (mm)"
    );
    for b in &r.burns {
        let _ = writeln!(
            t,
            "{:<20} {:>9.4}  {:>9.4}   {:>9.4}  {:>9.4}   {:>+9.5} {:>+9.5}",
            b.image,
            b.center_mm[0],
            b.center_mm[1],
            b.offset_mm[0],
            b.offset_mm[1],
            b.residual_mm[0],
            b.residual_mm[1]
        );
    }
    t
}
