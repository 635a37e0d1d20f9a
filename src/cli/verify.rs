//! `pivotsight verify`: a measured RTCP sweep against the machine model, or the sweep to measure.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::json;

use crate::cli::{Global, Outcome, Status, result, rows};
use crate::error::{Error, Result};
use crate::machine::Machine;
use crate::output::Document;
use crate::rtcp::compare::{self, Compared};
use crate::rtcp::export::Control;
use crate::rtcp::plan;
use crate::rtcp::sweep::Size;
use crate::rtcp::verify::{Options, Report, figure};
use crate::uncertainty::Verdict;

/// Compares a measured RTCP sweep with the machine model, or suggests the sweep to measure
#[derive(Debug, clap::Args)]
#[command(group(clap::ArgGroup::new("task").required(true).args(["data", "plan"])))]
pub struct Args {
    /// The machine file
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// The measured sweep: the rotary axes' angles (b_deg,c_deg) and dx_mm,dy_mm,dz_mm
    #[arg(long, value_name = "CSV")]
    data: Option<PathBuf>,
    /// The machine file whose values the control held during the sweep; the machine's own where
    /// left out
    #[arg(long, value_name = "FILE", conflicts_with = "plan")]
    now: Option<PathBuf>,
    /// Largest deviation allowed
    #[arg(long, value_name = "MM", default_value_t = 0.015, conflicts_with = "plan")]
    tolerance_mm: f64,
    /// Standard uncertainty of a measured component (default: from poses measured again, else 0.001)
    #[arg(long, value_name = "MM", conflicts_with = "plan")]
    noise_mm: Option<f64>,
    /// Write a plot per axis into this folder
    #[arg(long, value_name = "DIR", conflicts_with = "plan")]
    report: Option<PathBuf>,
    /// Write the sweep to measure into this folder, as poses.csv and sweep.nc
    #[arg(long, value_name = "DIR")]
    plan: Option<PathBuf>,
    /// With --plan: the control the program is for
    #[arg(long, value_enum, default_value = "siemens", conflicts_with = "data")]
    control: Control,
    /// With --plan: number of different poses
    #[arg(long, value_name = "N", default_value_t = 40, conflicts_with = "data")]
    poses: usize,
}

/// What is printed.
#[derive(JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)] // Only described.
pub enum Output {
    Compared(Box<Compared>),
    Planned(Planned),
}

/// The sweep to measure.
#[derive(Serialize, JsonSchema)]
pub struct Planned {
    /// How many poses.
    poses: usize,
    /// The files written.
    files: Vec<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let machine = Machine::read(&args.machine)?;
    machine.doubts().iter().for_each(|d| global.say(format_args!("warning: {d}")));
    match (&args.data, &args.plan) {
        (Some(data), _) => compare(args, &machine, data, global),
        (None, Some(folder)) => suggest(args, &machine, folder, global),
        (None, None) => Err(Error::option("verify", "needs --data or --plan", "give one")),
    }
}

fn suggest(args: &Args, machine: &Machine, folder: &Path, global: &Global) -> Result<Outcome> {
    let suggested = plan::suggest(machine, &args.machine, args.poses, args.control)?;
    let mut table = format!("{} poses, {} of them repeats\n", suggested.poses, suggested.repeats);
    for (name, text) in &suggested.files {
        let path = global.write_into(folder, name, text.as_bytes())?;
        let _ = writeln!(table, "{}", path.display());
    }
    let planned = Planned {
        poses: suggested.poses,
        files: suggested.files.map(|(name, _)| folder.join(name)).to_vec(),
    };
    Ok(Outcome::good(Document::single(result("verify", &args.machine, &[], &planned), table)))
}

fn compare(args: &Args, machine: &Machine, data: &Path, global: &Global) -> Result<Outcome> {
    let options = compare::Options {
        machine: &args.machine,
        data,
        now: args.now.as_deref(),
        tolerance_mm: args.tolerance_mm,
        noise_mm: args.noise_mm,
    };
    let made = compare::compare(machine, options)?;
    made.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let draw = |folder: &PathBuf| {
        let plot = figure(&made.sweep, &made.report).to_svg();
        global.write_into(folder, "sweep.svg", plot.as_bytes())
    };
    let plot = args.report.as_ref().map(draw).transpose()?;
    let table = table(&made.report, made.options, plot.as_deref());
    let good = made.report.verdict == Verdict::Pass;
    let compared = made.result(plot);
    let input = json!({"machine": args.machine, "data": data, "now": args.now});
    let json = result("verify", input, &made.warnings, &compared);
    Ok(Outcome {
        document: Some(Document { json, rows: rows(&compared.rows), table }),
        status: if good { Status::Good } else { Status::OutOfTolerance },
    })
}

/// The same for people.
fn table(report: &Report, options: Options, plot: Option<&Path>) -> String {
    let poses = report.measured.len();
    let mut table = format!("{poses} poses          rms      x        y        z    worst, mm\n");
    let mut line = |name: &str, s: &Size| {
        let [x, y, z] = s.rms_xyz_mm;
        let _ = writeln!(
            table,
            "{name:<12} {:8.4} {x:8.4} {y:8.4} {z:8.4} {:8.4}",
            s.rms_mm, s.worst_mm
        );
    };
    line("measured", &report.before);
    line("predicted", &Size::of(&report.predicted));
    line("left", &report.after);
    let _ = writeln!(
        table,
        "largest true deviation {:.4} ± {:.4} mm, as the largest of many is seen too large (noise {:.4} mm: {}), {} {} mm: {}",
        report.worst_mm,
        report.worst_u95_mm,
        report.noise_mm,
        report.noise_source,
        if options.corrected {
            "left once the machine's values are in the control, limit"
        } else {
            "measured, limit"
        },
        options.tolerance_mm,
        report.verdict
    );
    if let Some(path) = plot {
        let _ = writeln!(table, "plot: {}", path.display());
    }
    table
}
