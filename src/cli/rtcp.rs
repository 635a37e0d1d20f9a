//! `pivotsight rtcp inverse|forward`: poses through the machine's kinematics.

use std::path::PathBuf;

use serde_json::{Map, Value, json};

use crate::cli::{Global, Outcome, result};
use crate::error::Result;
use crate::machine::Machine;
use crate::output::{Document, Format};
use crate::rtcp::poses::{Row, Way, turn};

/// Turns tool points into machine coordinates (inverse) or back (forward)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which way
    #[arg(value_enum)]
    way: Way,
    /// The machine file
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// CSV with x_mm,y_mm,z_mm and the two rotary axes such as b_deg,c_deg; for inverse also
    /// x_mm,y_mm,z_mm and the tool's direction i,j,k, which gives all solutions
    #[arg(long, value_name = "FILE")]
    poses: PathBuf,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// Each pose (or solution) under its columns' names, which depend on the machine's rotary axes.
    poses: Vec<Map<String, Value>>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let poses = turn(&Machine::read(&args.machine)?, &args.poses, args.way)?;
    poses.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));

    // Poses are a table by nature: people get the CSV too, with nine decimals.
    let mut csv = poses.names.join(",") + "\n";
    let mut objects: Vec<Map<String, Value>> = Vec::with_capacity(poses.rows.len());
    for Row { counts, numbers, note } in poses.rows {
        let mut cells: Vec<String> = counts.iter().map(ToString::to_string).collect();
        cells.extend(numbers.iter().map(|v| format!("{v:.9}")));
        cells.extend(note.clone());
        csv += &cells.join(",");
        csv.push('\n');
        let values: Vec<Value> = if global.format == Format::Csv {
            cells.into_iter().map(Value::String).collect()
        } else {
            let counts = counts.iter().map(|&n| json!(n));
            counts.chain(numbers.iter().map(|&v| json!(v))).chain(note.map(Value::String)).collect()
        };
        objects.push(poses.names.iter().cloned().zip(values).collect());
    }
    let word = if args.way == Way::Inverse { "inverse" } else { "forward" };
    let input = json!({"machine": args.machine, "poses": args.poses, "way": word});
    let output = Output { poses: objects };
    let json = result("rtcp", input, &poses.warnings, &output);
    let rows = output.poses.into_iter().map(Value::Object).collect();
    Ok(Outcome::good(Document { json, rows, table: csv }))
}
