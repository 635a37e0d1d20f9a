//! `pivotsight verify`: a measured RTCP sweep against the machine model, or the sweep to measure.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::cli::{Global, Outcome, Status, result, rows};
use crate::diagnose::data::of_model;
use crate::diagnose::data::rtcp::{RtcpExperiment, add_effects};
use crate::diagnose::own;
use crate::error::{Error, Result};
use crate::fit::robust::range;
use crate::machine::{AxisName, Machine, written_deg};
use crate::output::Document;
use crate::rtcp::export::Control;
use crate::rtcp::plan::Plan;
use crate::rtcp::sweep::{Size, Sweep, predict};
use crate::rtcp::verify::{Options, Report, figure, verify};
use crate::uncertainty::{Contribution, K95, Verdict, budget};
use crate::units;

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
    #[arg(long, value_name = "FILE", requires = "data")]
    now: Option<PathBuf>,
    /// Largest deviation allowed
    #[arg(long, value_name = "MM", default_value_t = 0.015)]
    tolerance_mm: f64,
    /// Standard uncertainty of a measured component (default: from poses measured again, else 0.001)
    #[arg(long, value_name = "MM")]
    noise_mm: Option<f64>,
    /// Write a plot per axis into this folder
    #[arg(long, value_name = "DIR", requires = "data")]
    report: Option<PathBuf>,
    /// Write the sweep to measure into this folder, as poses.csv and sweep.nc
    #[arg(long, value_name = "DIR")]
    plan: Option<PathBuf>,
    /// With --plan: the control the program is for
    #[arg(long, value_enum, default_value = "siemens", requires = "plan")]
    control: Control,
    /// With --plan: number of different poses
    #[arg(long, value_name = "N", default_value_t = 40, requires = "plan")]
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

/// A measured sweep against the model.
#[derive(Serialize, JsonSchema)]
pub struct Compared {
    /// How many poses.
    poses: usize,
    /// The measured deviations.
    before: Size,
    /// What the model leaves of them.
    after: Size,
    /// Where the target really is, seen from where the model has it, in the table frame.
    target_offset_mm: [f64; 3],
    /// Which of `before` and `after` the tolerance is held against.
    judged: &'static str,
    /// The largest true deviation of those: the middle of what it may be, as the largest that is seen was chosen for its noise, too.
    worst_mm: f64,
    /// Half-width of its 95 % interval.
    worst_u95_mm: f64,
    /// Standard uncertainty of a measured component.
    noise_mm: f64,
    /// Where it is from: `given`, `poses measured again` or `assumed`.
    noise_source: &'static str,
    /// Largest deviation allowed.
    tolerance_mm: f64,
    /// Of `worst_mm` of what is judged.
    verdict: Verdict,
    /// What contributes how much to the uncertainty of a deviation.
    budget: Vec<Contribution>,
    /// The plot written.
    plot: Option<PathBuf>,
    /// Pose by pose.
    rows: Vec<Row>,
}

/// One pose; deviations along X, Y, Z.
#[derive(Serialize, JsonSchema)]
struct Row {
    /// The rotary axes, `b_deg` and `c_deg` on a machine with its head about B and its table about C.
    #[serde(flatten)]
    rotary_deg: Map<String, Value>,
    /// Without the target's own offset.
    measured_mm: [f64; 3],
    predicted_mm: [f64; 3],
    left_mm: [f64; 3],
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
    let Some(target) = machine.target else {
        let fix =
            "say where the target stands: [target] position_mm = [x, y, z] in the table frame";
        return Err(Error::field(&args.machine, None, "target", "is missing", fix));
    };
    if !(4..=10_000).contains(&args.poses) {
        return Err(Error::option("--poses", format!("is {}", args.poses), "give 4 to 10000"));
    }
    let plan = Plan::new(&machine.chain()?, args.poses)?;
    let files =
        [("poses.csv", plan.csv()), ("sweep.nc", plan.gcode(target.position_mm, args.control))];
    let mut table =
        format!("{} poses, {} of them repeats\n", plan.poses.len(), plan.poses.len() - args.poses);
    for (name, text) in &files {
        let path = global.write_into(folder, name, text.as_bytes())?;
        let _ = writeln!(table, "{}", path.display());
    }
    let planned = Planned {
        poses: plan.poses.len(),
        files: files.map(|(name, _)| folder.join(name)).to_vec(),
    };
    Ok(Outcome::good(Document::single(result("verify", &args.machine, &[], &planned), table)))
}

/// What a sweep cannot show, and units that look wrong.
fn doubts(sweep: &Sweep, measured: &[Vector3<f64>], warnings: &mut Vec<String>) {
    for (k, name) in sweep.axes.map(AxisName::column_deg).into_iter().enumerate() {
        let name = name.as_str();
        let angles: Vec<f64> = sweep.rotary_rad.iter().map(|r| r[k].to_degrees()).collect();
        warnings.extend(units::swept_angles(name, &angles));
        let (low, high) = range(&angles);
        if high - low < 1e-6 {
            warnings.push(format!(
                "{name} is constant: errors of that axis cannot be told from the target's place, or do not show"
            ));
        }
    }
    for (k, name) in ["dx_mm", "dy_mm", "dz_mm"].into_iter().enumerate() {
        let column: Vec<f64> = measured.iter().map(|d| d[k]).collect();
        warnings.extend(units::errors(name, &column));
    }
}

fn compare(args: &Args, machine: &Machine, data: &Path, global: &Global) -> Result<Outcome> {
    for (option, value) in
        [("--tolerance-mm", args.tolerance_mm), ("--noise-mm", args.noise_mm.unwrap_or(0.0))]
    {
        if !(value.is_finite() && value >= 0.0) {
            return Err(Error::option(option, format!("is {value}"), "give a length in mm"));
        }
    }
    let real = machine.chain()?;
    let control = match &args.now {
        Some(path) => Machine::read(path)?.chain()?,
        None => real.clone(),
    };
    real.same_rotary(&control, "--now")?;
    let mut warnings: Vec<String> = machine.without_target().into_iter().collect();
    let sweep = Sweep::read_measured(data, &real, &mut warnings)?;
    let measured = sweep.deviation_mm.clone().unwrap_or_default();
    if measured.len() < 4 {
        let fix = "measure more poses (verify --plan suggests them)";
        return Err(Error::file(data, "has fewer than four poses", fix));
    }
    if measured.iter().all(|d| d.norm() == 0.0) {
        let fix = "fill in what was measured";
        return Err(Error::file(data, "has zeros alone in dx_mm, dy_mm and dz_mm", fix));
    }
    let options = Options {
        tolerance_mm: args.tolerance_mm,
        noise_mm: args.noise_mm,
        corrected: args.now.is_some(),
    };
    let mut predicted = predict(&control, &real, &machine.target_point(), &sweep.rotary_rad);
    doubts(&sweep, &measured, &mut warnings);
    if !machine.effects.is_empty() {
        add_effects_of(args, machine, &sweep, &mut predicted, &mut warnings)?;
    }
    let report = verify(&real, &sweep.rotary_rad, &measured, predicted, options);
    warnings.extend(report.noise_doubt.clone());
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let draw = |folder: &PathBuf| {
        let plot = figure(&sweep, &report).to_svg();
        global.write_into(folder, "sweep.svg", plot.as_bytes())
    };
    let plot = args.report.as_ref().map(draw).transpose()?;
    let table = table(&report, options, plot.as_deref());
    let good = report.verdict == Verdict::Pass;
    let compared = compared(report, &sweep, options, plot);
    let input = json!({"machine": args.machine, "data": data, "now": args.now});
    let json = result("verify", input, &warnings, &compared);
    Ok(Outcome {
        document: Some(Document { json, rows: rows(&compared.rows), table }),
        status: if good { Status::Good } else { Status::OutOfTolerance },
    })
}

/// Adds what the machine file's effects do in a sweep to what is predicted.
fn add_effects_of(
    args: &Args,
    machine: &Machine,
    sweep: &Sweep,
    predicted: &mut [Vector3<f64>],
    warnings: &mut Vec<String>,
) -> Result<()> {
    let entries = own::of_machine(machine, "rtcp");
    let mut more = Vec::new();
    let experiment = own::around(machine, &args.machine, entries, &mut more, |rest, more| {
        let made = RtcpExperiment::from_table(&sweep.table, rest, more);
        Ok(Box::new(made.map_err(|e| of_model(e, &args.machine))?))
    })?;
    more.retain(|w| !warnings.contains(w));
    warnings.extend(more);
    add_effects(experiment.as_ref(), predicted);
    Ok(())
}

/// The result as it is written.
fn compared(report: Report, sweep: &Sweep, options: Options, plot: Option<PathBuf>) -> Compared {
    let list = (0..report.measured.len()).map(|i| Row {
        rotary_deg: (sweep.axes.iter().zip(sweep.rotary_rad[i]))
            .map(|(axis, rad)| (axis.column_deg(), written_deg(rad).into()))
            .collect(),
        measured_mm: report.measured[i].into(),
        predicted_mm: report.predicted[i].into(),
        left_mm: report.rest[i].into(),
    });
    Compared {
        poses: report.measured.len(),
        rows: list.collect(),
        before: report.before,
        after: report.after,
        target_offset_mm: report.target_offset_mm.into(),
        judged: if options.corrected { "after" } else { "before" },
        worst_mm: report.worst_mm,
        worst_u95_mm: report.worst_u95_mm,
        noise_mm: report.noise_mm,
        noise_source: report.noise_source,
        tolerance_mm: options.tolerance_mm,
        verdict: report.verdict,
        budget: budget("worst_mm", [("reading of a deviation", report.worst_u95_mm / K95)]),
        plot,
    }
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
