//! `pivotsight simulate`: what a machine model would show.

use std::path::PathBuf;

use serde_json::{Map, Value, json};

use crate::cli::{Global, Outcome, envelope};
use crate::error::{Error, Result};
use crate::machine::Machine;
use crate::output::{Document, Format};
use crate::rtcp::sweep::{CONDITIONS, DEVIATION, Sweep, predict};

/// Predicts measured data from a machine model
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The kind of data
    #[arg(value_enum)]
    kind: Kind,
    /// The machine file, with the effects it is to show
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// CSV of what is commanded; measured columns in it are replaced by predicted ones
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// rtcp: the machine file whose values the control holds; the model's own where left out
    #[arg(long, value_name = "FILE")]
    now: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// Deviations of a held tool point over B and C
    Rtcp,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match args.kind {
        Kind::Rtcp => rtcp(args, global),
    }
}

fn rtcp(args: &Args, global: &Global) -> Result<Outcome> {
    let model = Machine::read(&args.model)?;
    if let Some(effect) = model.effects.first() {
        return Err(Error::measure(
            format!("effect '{}'", effect.name),
            "cannot be simulated by this version",
            "remove it from the model",
        ));
    }
    let real = model.chain()?;
    let control = match &args.now {
        Some(path) => Machine::read(path)?.chain()?,
        None => real.clone(),
    };
    let sweep = Sweep::read(&args.data)?;
    let d = predict(&control, &real, &model.target_point(), &sweep.rotary_rad);

    // Columns as in the data, then the deviation; people and programs get the same table.
    let kept: Vec<&str> =
        ["b_deg", "c_deg"].into_iter().chain(CONDITIONS).filter(|n| sweep.table.has(n)).collect();
    let names: Vec<&str> = kept.iter().copied().chain(DEVIATION).collect();
    let mut csv = names.join(",") + "\n";
    let mut rows = Vec::with_capacity(d.len());
    for (r, d) in d.iter().enumerate() {
        let text = kept.iter().map(|n| sweep.table.text(r, n).to_owned());
        let cells: Vec<String> = text.chain(d.iter().map(|v| format!("{v:.9}"))).collect();
        csv += &cells.join(",");
        csv.push('\n');
        let value = |cell: String| match (global.format, cell.parse::<f64>()) {
            (Format::Csv, _) | (_, Err(_)) => Value::String(cell),
            (_, Ok(number)) => json!(number),
        };
        let pairs = names.iter().map(|n| (*n).to_owned()).zip(cells.into_iter().map(value));
        rows.push(Value::Object(pairs.collect::<Map<_, _>>()));
    }
    let mut map = envelope("simulate", json!({"model": args.model, "data": args.data}), &[]);
    map.insert("kind".into(), "rtcp".into());
    map.insert("rows".into(), rows.clone().into());
    Ok(Outcome::good(Document { json: Value::Object(map), rows, table: csv }))
}
