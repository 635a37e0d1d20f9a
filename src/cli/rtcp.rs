//! `pivotsight rtcp inverse|forward`: poses through the machine's kinematics.

use std::path::PathBuf;

use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::cli::{Global, Outcome, envelope};
use crate::error::Result;
use crate::machine::{AxisName, Machine};
use crate::output::{Document, Format};
use crate::table::Table;

/// Turns tool points into machine coordinates (inverse) or back (forward)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which way
    #[arg(value_enum)]
    way: Way,
    /// The machine file
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// CSV with x_mm,y_mm,z_mm and the two rotary axes such as b_deg,c_deg
    #[arg(long, value_name = "FILE")]
    poses: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Way {
    /// Tool points in the table frame → machine coordinates that hold them there
    Inverse,
    /// Machine coordinates → tool points in the table frame
    Forward,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let machine = Machine::read(&args.machine)?;
    let chain = machine.chain()?;
    let rotary = chain.rotary_names().map(column);
    let input = ["x_mm", "y_mm", "z_mm", &rotary[0], &rotary[1]];
    let output = match args.way {
        Way::Inverse => ["jx_mm", "jy_mm", "jz_mm"],
        Way::Forward => ["px_mm", "py_mm", "pz_mm"],
    };
    let table = Table::read(&args.poses, &input, &[])?;
    let mut rows = Vec::with_capacity(table.rows());
    let mut outside = 0;
    for r in 0..table.rows() {
        let mut pose = [0.0; 5];
        for (value, name) in pose.iter_mut().zip(input) {
            *value = table.number(r, name)?;
        }
        let [x, y, z, a, b] = pose;
        let turned = [a.to_radians(), b.to_radians()];
        let (joints, result) = match args.way {
            Way::Inverse => {
                let q = chain.inverse_at(&Vector3::new(x, y, z), turned);
                (q, [q[0], q[1], q[2]])
            }
            Way::Forward => {
                let q = [x, y, z, turned[0], turned[1]];
                (q, chain.forward(&q).position_mm.into())
            }
        };
        outside += usize::from(chain.outside(&joints).is_some());
        rows.push((pose, result));
    }
    let mut warnings = Vec::new();
    if outside > 0 {
        warnings.push(format!("{outside} of {} poses lie outside the axes' limits", rows.len()));
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));

    // Poses are a table by nature: people get the CSV too, with nine decimals.
    let names: Vec<&str> = input.into_iter().chain(output).collect();
    let mut csv = names.join(",") + "\n";
    let mut objects = Vec::with_capacity(rows.len());
    for (pose, result) in &rows {
        let cells: Vec<String> = pose.iter().chain(result).map(|v| format!("{v:.9}")).collect();
        csv += &cells.join(",");
        csv.push('\n');
        let values: Vec<Value> = match global.format {
            Format::Csv => cells.into_iter().map(Value::String).collect(),
            _ => pose.iter().chain(result).map(|&v| json!(v)).collect(),
        };
        objects.push(Value::Object(names.iter().map(|n| (*n).to_owned()).zip(values).collect()));
    }
    let word = if args.way == Way::Inverse { "inverse" } else { "forward" };
    let input = json!({"machine": args.machine, "poses": args.poses, "way": word});
    let mut json = envelope("rtcp", input, &warnings);
    json.insert("poses".into(), Value::Array(objects.clone()));
    Ok(Outcome::good(Document { json: Value::Object(json), rows: objects, table: csv }))
}

/// The column of a rotary axis: `b_deg`.
pub fn column(axis: AxisName) -> String {
    format!("{}_deg", axis.letter().to_ascii_lowercase())
}
