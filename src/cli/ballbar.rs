//! `pivotsight ballbar plan|simulate|decouple`.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;

use super::outfiles::OutFile;
use super::{Global, Outcome, result, rows};
use crate::ballbar::simulate::{self, Row};
use crate::ballbar::{Data, Path, Range, Setup, decouple, path, swarm};
use crate::error::{Error, Result, above_zero};
use crate::output::Document;

/// Ball bar with B and a linear axis moving together
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Plan(PlanArgs),
    Simulate(SimulateArgs),
    Decouple(DecoupleArgs),
}

#[derive(Debug, Clone, clap::Args)]
struct SetupArgs {
    /// Length of the bar
    #[arg(long, value_name = "MM", default_value_t = 400.0)]
    bar_mm: f64,
    /// From the B axis to the tool ball
    #[arg(long, value_name = "MM", default_value_t = 400.0)]
    pivot_mm: f64,
    /// Base ball below the B axis at zero
    #[arg(long, value_name = "MM", default_value_t = 800.0)]
    below_mm: f64,
}

impl SetupArgs {
    fn setup(&self) -> Setup {
        Setup { bar_mm: self.bar_mm, pivot_mm: self.pivot_mm, below_mm: self.below_mm }
    }
}

#[derive(Debug, Clone, clap::Args)]
struct RangeArgs {
    /// First B angle
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    from_deg: f64,
    /// Last B angle
    #[arg(long, value_name = "DEG", default_value_t = -60.0)]
    to_deg: f64,
    /// Number of equal steps along the arc
    #[arg(long, default_value_t = 600)]
    steps: usize,
}

impl RangeArgs {
    fn range(&self) -> Range {
        Range { from_deg: self.from_deg, to_deg: self.to_deg, steps: self.steps }
    }
}

/// Positions with equal steps along the arc, and G-code at constant speed
#[derive(Debug, clap::Args)]
struct PlanArgs {
    /// zb (the source's), xb; with a shift of the base cup in Y zb-y150 (longer bar) or zbk-y150 (same bar)
    #[arg(long, default_value = "zb")]
    path: String,
    #[command(flatten)]
    setup: SetupArgs,
    #[command(flatten)]
    range: RangeArgs,
    /// Write G-code, there and back, to FILE
    #[arg(long, value_name = "FILE")]
    gcode: Option<OutFile>,
    /// Speed of the tool ball
    #[arg(long, value_name = "MM/MIN", default_value_t = 500.0)]
    feed_mm_min: f64,
    /// Machine X where the B axis is above the base cup
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    x_zero_mm: f64,
    /// Machine Z at the start of the source's path
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    z_zero_mm: f64,
}

/// Lengths a machine with known errors would show
#[derive(Debug, clap::Args)]
struct SimulateArgs {
    /// One or more paths
    #[arg(long, default_value = "zb", value_delimiter = ',')]
    path: Vec<String>,
    #[command(flatten)]
    setup: SetupArgs,
    #[command(flatten)]
    range: RangeArgs,
    /// Errors: X0B, Z0B in mm; A0B, C0B, A0Z, B0Z in degrees
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',', allow_hyphen_values = true)]
    error: Vec<String>,
    /// Standard deviation of a length
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    noise_mm: f64,
    /// Same seed, same noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Take the errors apart: what is visible, with uncertainty, and what is not
#[derive(Debug, clap::Args)]
struct DecoupleArgs {
    /// CSV with b_deg,length_mm and optionally x_mm,z_mm,path,cup_y_mm,dir
    #[arg(long, value_name = "DATA.csv")]
    data: PathBuf,
    #[command(flatten)]
    setup: SetupArgs,
    /// The base cup's position is not known
    #[arg(long)]
    unknown_cup: bool,
    /// The bar's length is not known
    #[arg(long)]
    unknown_bar: bool,
    /// Standard uncertainty of a length (default: from the residuals)
    #[arg(long, value_name = "MM")]
    noise_mm: Option<f64>,
    /// The path behind a name in the data, for example 2=zb-y150
    #[arg(long, value_name = "NAME=PATH", value_delimiter = ',')]
    path: Vec<String>,
    /// Particles of the swarm
    #[arg(long, default_value_t = 40)]
    particles: usize,
    /// Write ballbar.svg to DIR
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
}

/// What `plan` prints.
#[derive(Serialize, JsonSchema)]
pub struct Planned {
    /// From one point to the next.
    step_mm: f64,
    /// The points.
    rows: Vec<Row>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.command {
        Command::Plan(args) => plan(args, global),
        Command::Simulate(args) => simulate(args),
        Command::Decouple(args) => take_apart(args, global),
    }
}

fn plan(args: &PlanArgs, global: &Global) -> Result<Outcome> {
    let (path, setup) = (Path::parse(&args.path)?, args.setup.setup());
    let poses = path.plan(&setup, args.range.range())?;
    let step_mm = path::step_mm(&setup, &poses);
    above_zero("--feed-mm-min", args.feed_mm_min, "give a speed")?;
    let zero = [args.x_zero_mm, args.z_zero_mm];
    if !zero.iter().all(|v| v.abs() < 1e6) {
        return Err(Error::option(
            "--x-zero-mm, --z-zero-mm",
            "are no places on a machine",
            "give lengths in mm",
        ));
    }
    if let Some(file) = &args.gcode {
        let code = path::gcode(&path, &setup, &poses, args.feed_mm_min, zero);
        global.write(file, code.as_bytes())?;
    }
    let list: Vec<Row> = poses.iter().map(|p| Row::new(&path, p, path.bar_mm(&setup))).collect();
    let (first, last) = (&poses[0], &poses[poses.len() - 1]);
    let table = format!(
        "path {}: {} points {step_mm:.4} mm apart\nB {:.3}° to {:.3}°, X {:.3} to {:.3} mm, Z (down) {:.3} to {:.3} mm\n\
         bar {:.4} mm; base cup {} mm below the B axis, {} mm off in Y; --format csv gives all points\n",
        path.name(),
        poses.len(),
        first.b_rad.to_degrees(),
        last.b_rad.to_degrees(),
        first.x_mm,
        last.x_mm,
        -first.up_mm + 0.0,
        -last.up_mm,
        path.bar_mm(&setup),
        setup.below_mm,
        path.cup_y_mm
    );
    let (rows, planned) = (rows(&list), Planned { step_mm, rows: list });
    Ok(Outcome::good(Document {
        json: result("ballbar-plan", path.name(), &[], &planned),
        rows,
        table,
    }))
}

fn simulate(args: &SimulateArgs) -> Result<Outcome> {
    let simulated = simulate::simulate(&simulate::Options {
        setup: args.setup.setup(),
        paths: args.path.iter().map(|name| Path::parse(name)).collect::<Result<_>>()?,
        range: args.range.range(),
        errors: simulate::errors(&args.error)?,
        noise_mm: args.noise_mm,
        seed: args.seed,
    })?;
    let table = format!(
        "{} points on {}; the length changes by up to {:.5} mm; --format csv gives them\n",
        simulated.rows.len(),
        args.path.join(", "),
        simulated.largest_mm
    );
    let json = result("ballbar-simulate", &args.path, &[], &simulated);
    Ok(Outcome::good(Document { json, rows: rows(&simulated.rows), table }))
}

fn take_apart(args: &DecoupleArgs, global: &Global) -> Result<Outcome> {
    let mut paths = Vec::new();
    for text in &args.path {
        let (name, path) = text.split_once('=').ok_or_else(|| {
            Error::option(
                "--path",
                format!("'{text}' has no ="),
                "write NAME=PATH, for example 2=zb-y150",
            )
        })?;
        paths.push((name.to_owned(), Path::parse(path)?));
    }
    if !(5..=10_000).contains(&args.particles) {
        return Err(Error::option("--particles", "is out of range", "give 5 to 10000"));
    }
    let options = decouple::Options {
        setup: args.setup.setup(),
        unknown_cup: args.unknown_cup,
        unknown_bar: args.unknown_bar,
        noise_mm: args.noise_mm,
        paths,
        swarm: swarm::Options { particles: args.particles, ..swarm::Options::default() },
    };
    options.setup.validate()?;
    let report = decouple::decouple(&Data::read(&args.data, &options)?, &options)
        .map_err(|e| e.measured_in(&args.data))?;
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    if let Some(folder) = &args.plot {
        global.write_into(folder, "ballbar.svg", report.figure().to_svg().as_bytes())?;
    }
    let json = result("ballbar-decouple", &args.data, &report.warnings, &report);
    Ok(Outcome::good(Document::single(json, report.text())))
}
