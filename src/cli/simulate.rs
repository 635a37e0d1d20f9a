//! `pivotsight simulate`: what should be measured, from the machine file and its effects.

use std::path::PathBuf;

use serde_json::{Map, Value, json};

use crate::cli::diagnose::is_of_kind;
use crate::cli::{Global, Outcome, result};
use crate::diagnose::load::Source;
use crate::diagnose::simulate::{Options, Simulated, simulate};
use crate::error::Result;
use crate::machine::DataKind;
use crate::output::{Document, Format, csv_text};

/// Predicts measured data from a machine model
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The kind of data
    #[arg(value_enum)]
    kind: DataKind,
    /// The machine file, with the effects it is to show; rtcp and ballbar need one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// CSV of what is commanded; measured columns in it are replaced by predicted ones
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// rtcp: the machine file whose values the control holds; the model's own where left out
    #[arg(long, value_name = "FILE")]
    now: Option<PathBuf>,
    /// rod: the camera's calibration file
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// rod: its nominal diameter, where the data are a plan of captures (x_mm,y_mm,c_deg,...) without edge points
    #[arg(long, value_name = "D")]
    diameter_mm: Option<f64>,
    /// A TOML file with effects of your own that the model names (docs/diagnose.md)
    #[arg(long, value_name = "FILE")]
    effects: Option<PathBuf>,
    /// Add Gaussian noise of this standard deviation
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    noise_mm: f64,
    /// Seed of the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// The kind of data.
    kind: String,
    /// The data's columns with what is predicted.
    rows: Vec<Map<String, Value>>,
}

/// Columns of names, which may look like numbers.
const LABELS: [&str; 3] = ["axis", "capture", "path"];

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    is_of_kind(
        args.kind,
        &[
            ("--calib", DataKind::Rod, args.calib.is_some()),
            ("--diameter-mm", DataKind::Rod, args.diameter_mm.is_some()),
            ("--now", DataKind::Rtcp, args.now.is_some()),
        ],
    )?;
    let made = simulate(&Options {
        source: Source {
            kind: args.kind,
            data: args.data.clone(),
            model: args.model.clone(),
            calib: args.calib.clone(),
            effects: args.effects.clone(),
            diameter_mm: args.diameter_mm,
            measured: false,
        },
        now: args.now.clone(),
        noise_mm: args.noise_mm,
        seed: args.seed,
    })?;
    made.warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let output =
        Output { kind: made.kind.clone(), rows: rows(&made, global.format == Format::Csv) };
    let input = json!({"model": args.model, "data": args.data});
    let json = result("simulate", input, &made.warnings, &output);
    let objects = output.rows.into_iter().map(Value::Object).collect();
    // People and programs get the same table, with the very decimals.
    let table = csv_text(&rows(&made, true).into_iter().map(Value::Object).collect::<Vec<_>>());
    Ok(Outcome::good(Document { json, rows: objects, table }))
}

/// The rows under their columns' names; numbers that stand in the data as text, or as numbers.
fn rows(made: &Simulated, as_text: bool) -> Vec<Map<String, Value>> {
    let value = |name: &String, text: &String| {
        let is_text = as_text || LABELS.contains(&name.as_str());
        let number = text.parse::<f64>().ok().filter(|_| !is_text);
        number.map_or_else(|| text.as_str().into(), Value::from)
    };
    let row = |cells: &Vec<String>| {
        made.names.iter().zip(cells).map(|(name, cell)| (name.clone(), value(name, cell))).collect()
    };
    made.rows.iter().map(row).collect()
}
