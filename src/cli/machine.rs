//! `pivotsight machine`: what a machine file describes, in words and as a figure.

use std::fmt::Write;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::outfiles::OutFile;
use crate::cli::{Global, Outcome, result};
use crate::diagnose::catalogue;
use crate::error::{Error, Result};
use crate::machine::{Effect, Kinematics, Machine, Side, frames_svg};
use crate::output::Document;

/// Checks a machine file and shows its axes from the work to the tool
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The machine file
    #[arg(value_name = "MACHINE.toml")]
    machine: PathBuf,
    /// Draw the frames and vectors of a head B / table C machine as SVG
    #[arg(long, value_name = "SVG")]
    figure: Option<OutFile>,
}

/// What is printed.
#[derive(Serialize, JsonSchema)]
pub struct Output {
    /// The machine's name.
    name: String,
    /// The axes' order from the work to the tool.
    order: String,
    /// The axes in that order.
    axes: Vec<Axis>,
    /// Known faults.
    effects: Vec<Effect>,
}

/// An axis at zero.
#[derive(Serialize, JsonSchema)]
struct Axis {
    /// Its letter.
    name: String,
    /// What it moves: the tool or the work.
    carries: &'static str,
    /// Unit vector in the machine frame.
    direction: [f64; 3],
    /// A point on a rotary axis.
    point_mm: Option<[f64; 3]>,
    /// +1, or -1 where the control counts the other way.
    sense: f64,
    /// Travel; null where unlimited.
    limits: [Option<f64>; 2],
    /// Their unit.
    limits_unit: &'static str,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let machine = Machine::read(&args.machine)?;
    let chain = machine.chain()?;
    catalogue::check(&machine).map_err(|e| e.in_file(&args.machine, None))?;
    let warnings = machine.doubts();
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    if let Some(path) = &args.figure {
        if machine.kinematics != Kinematics::default() {
            let fix = "leave --figure out";
            return Err(Error::option("--figure", "draws head B / table C machines only", fix));
        }
        global.write(path, frames_svg(&machine).as_bytes())?;
    }
    let mut table = format!("{} ({})\n", machine.name, machine.kinematics.order);
    let mut axes = Vec::new();
    for axis in chain.axes() {
        let rotary = axis.name.is_rotary();
        let side = if axis.side == Side::Head { "tool" } else { "work" };
        // Adding zero turns -0 into 0.
        let [d, p] = [axis.direction(), axis.point_mm()].map(|v| v.add_scalar(0.0));
        let limits = axis.limits.map(|v| if rotary { v.to_degrees() } else { v });
        let unit = if rotary { "deg" } else { "mm" };
        let way = if rotary { "turns" } else { "moves" };
        let about = if rotary { "about" } else { "along" };
        let _ = write!(
            table,
            "{}  {way} the {side} {about} ({:.4}, {:.4}, {:.4})",
            axis.name, d.x, d.y, d.z
        );
        if rotary {
            let _ = write!(
                table,
                " through ({:.4}, {:.4}, {:.4}) mm, sense {:+.0}",
                p.x, p.y, p.z, axis.sense
            );
        }
        if limits.iter().all(|v| v.is_finite()) {
            let _ = write!(table, ", {:.3} to {:.3} {unit}", limits[0], limits[1]);
        }
        table.push('\n');
        axes.push(Axis {
            name: axis.name.to_string(),
            carries: side,
            direction: d.into(),
            point_mm: rotary.then(|| p.into()),
            sense: axis.sense,
            limits: limits.map(|v| v.is_finite().then_some(v)),
            limits_unit: unit,
        });
    }
    for effect in &machine.effects {
        let sizes: Vec<String> =
            effect.parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
        let _ = writeln!(table, "effect {}: {}", effect.name, sizes.join(", "));
    }
    let output = Output {
        name: machine.name,
        order: machine.kinematics.order,
        axes,
        effects: machine.effects,
    };
    let json = result("machine", &args.machine, &warnings, &output);
    Ok(Outcome::good(Document::single(json, table)))
}
