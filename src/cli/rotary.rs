//! `pivotsight rotary`: deviations in, new pitch-error table out.

use std::path::PathBuf;

use super::outfiles::OutFile;
use super::{Global, Outcome, Status, result, rows};
use crate::error::Result;
use crate::output::Document;
use crate::rotary::{self, Options, Sweep, export};
use crate::uncertainty::Verdict;

/// Correct a rotary axis' pitch-error table from RTCP deviations
#[derive(Debug, clap::Args)]
pub struct Args {
    /// CSV with angle_deg,deviation_mm and optionally dir,run,comp_deg
    deviations: PathBuf,
    /// Measured distance from the rotary axis to the tool point
    #[arg(long, value_name = "L")]
    pivot_mm: f64,
    /// Its standard uncertainty
    #[arg(long, value_name = "U", default_value_t = 0.0)]
    pivot_u_mm: f64,
    /// Deviations at or under this are left alone
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    dead_band_mm: f64,
    /// Standard uncertainty of one reading (default: from repeated runs, else from the curve's roughness)
    #[arg(long, value_name = "MM")]
    noise_mm: Option<f64>,
    /// Judge the sweep: largest deviation allowed (0.015 is usual once a table is in)
    #[arg(long, value_name = "MM")]
    tolerance_mm: Option<f64>,
    /// The axis turns without end: 360° is 0°
    #[arg(long)]
    modulo: bool,
    /// -1 if a positive comp_deg in the file moves the axis in its negative direction (Siemens)
    #[arg(long, value_name = "1|-1", default_value_t = 1.0)]
    comp_sense: f64,
    /// comp_deg holds steps from one angle to the next, and a CSV table is written so
    #[arg(long)]
    incremental: bool,
    /// Angle of the reference position, where an incremental table is zero
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    reference_deg: f64,
    /// Write the new table to FILE
    #[arg(long, value_name = "FILE")]
    table: Option<OutFile>,
    /// For which control
    #[arg(long, requires = "table", value_enum, default_value = "csv")]
    control: export::Control,
    /// The axis' name in the control
    #[arg(long, requires = "table", default_value = "B")]
    axis: String,
    /// The axis' number (FANUC)
    #[arg(long, requires = "table", value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=32))]
    axis_number: u32,
    /// Least step of a table entry
    #[arg(long, requires = "table", value_name = "DEG", default_value_t = 0.0001)]
    resolution_deg: f64,
    /// Distance between table points (default: the smallest measured step)
    #[arg(long, requires = "table", value_name = "DEG")]
    step_deg: Option<f64>,
    /// Number of the table point at the reference position (FANUC)
    #[arg(long, requires = "table", value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(0..=1535))]
    reference_point: u32,
    /// Write rotary.svg to DIR
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let options = Options {
        pivot_u_mm: args.pivot_u_mm,
        dead_band_mm: args.dead_band_mm,
        noise_mm: args.noise_mm,
        modulo: args.modulo,
        comp_sense: args.comp_sense,
        incremental: args.incremental,
        reference_deg: args.reference_deg,
        tolerance_mm: args.tolerance_mm,
        ..Options::new(args.pivot_mm)
    };
    let sweep = Sweep::read(&args.deviations, args.modulo)?;
    let mut report =
        rotary::correct(&sweep, &options).map_err(|e| e.measured_in(&args.deviations))?;
    if let Some(path) = &args.table {
        let table = export::Options {
            control: args.control,
            axis: args.axis.clone(),
            axis_number: args.axis_number,
            resolution_deg: args.resolution_deg,
            step_deg: args.step_deg,
            incremental: args.incremental,
            reference_point: args.reference_point,
            reference_deg: args.reference_deg,
        };
        global.write(path, export::text(&report, &table)?.as_bytes())?;
        report.expect(&export::as_written(&report, &table)?);
        if let Some(apart_deg) = export::left_between_directions_deg(&report, &table)? {
            report.warnings.push(format!(
                "columns of steps are zero at the reference position in both directions, where the entries for - and + are {apart_deg:+.4}° apart: \
                 enter that as the axis' backlash, or it stays out in direction -"
            ));
        }
        if let Some(left_deg) = export::left_at_reference_deg(&report, &table)? {
            report.warnings.push(format!(
                "a table of steps is zero at the reference position, {}°: shift the axis by {left_deg:+.4}° there, or that much of the \
                 correction stays out everywhere",
                args.reference_deg
            ));
        }
    }
    if let Some(folder) = &args.plot {
        let figure = report.figure(args.dead_band_mm).to_svg();
        global.write_into(folder, "rotary.svg", figure.as_bytes())?;
    }
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let json = result("rotary", &args.deviations, &report.warnings, &report);
    let document = Document { json, rows: rows(&report.rows), table: report.text() };
    let good = report.verdict.is_none_or(|v| v == Verdict::Pass);
    let status = if good { Status::Good } else { Status::OutOfTolerance };
    Ok(Outcome { document: Some(document), status })
}
