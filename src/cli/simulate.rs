//! `pivotsight simulate`: what should be measured, from the machine file and its effects.

use std::path::PathBuf;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Map, Value, json};

use crate::cli::{Global, Outcome, result};
use crate::diagnose::data::rtcp::add_effects;
use crate::diagnose::doubts::beyond_machines;
use crate::diagnose::load::Source;
use crate::error::{Error, Result};
use crate::machine::{DataKind, Machine};
use crate::output::{Document, Format};
use crate::rtcp::sweep::{DEVIATION, Sweep, predict};
use crate::table::Table;

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

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    if !args.noise_mm.is_finite() || args.noise_mm < 0.0 {
        let reason = format!("is {}", args.noise_mm);
        return Err(Error::option("--noise-mm", reason, "give a size in mm, zero or more"));
    }
    match args.kind {
        DataKind::Rtcp => rtcp(args, global),
        _ => other(args, global),
    }
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// The kind of data.
    kind: String,
    /// The data's columns with what is predicted.
    rows: Vec<Map<String, Value>>,
}

fn document(
    args: &Args,
    kind: &str,
    rows: Vec<Map<String, Value>>,
    warnings: &[String],
) -> Document {
    let input = json!({"model": args.model, "data": args.data});
    let output = Output { kind: kind.into(), rows };
    let json = result("simulate", input, warnings, &output);
    let rows = output.rows.into_iter().map(Value::Object).collect();
    Document { json, rows, table: String::new() }
}

/// Gaussian noise in the order of the predicted values.
fn noise(args: &Args) -> impl FnMut() -> f64 {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(args.seed);
    let size = args.noise_mm;
    move || {
        if size == 0.0 {
            return 0.0;
        }
        let z: f64 = StandardNormal.sample(&mut rng);
        size * z
    }
}

/// Where the prediction with effects comes from.
fn source(args: &Args) -> Source {
    Source {
        kind: args.kind,
        data: args.data.clone(),
        model: args.model.clone(),
        calib: args.calib.clone(),
        effects: args.effects.clone(),
        once: false,
    }
}

/// Columns of names, which may look like numbers.
const LABELS: [&str; 3] = ["axis", "capture", "path"];

/// Kinds whose whole prediction comes from the effects library.
fn other(args: &Args, global: &Global) -> Result<Outcome> {
    let source = source(args);
    let mut warnings = Vec::new();
    let experiment = source.load(&mut warnings)?;
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let start: Vec<f64> = experiment.nuisances().iter().map(|p| p.start).collect();
    let mut predicted = experiment.predict(&start, &[]);
    let mut noise = noise(args);
    predicted.iter_mut().for_each(|p| *p += noise());
    let columns = experiment.predicted_columns(&predicted);
    let table = Table::read(&args.data, &[], &["*"])?;
    let rows: Vec<Map<String, Value>> = (0..table.rows())
        .map(|r| {
            let mut row = Map::new();
            for name in table.names() {
                let cell = table.text(r, name);
                let is_text = global.format == Format::Csv || LABELS.contains(&name.as_str());
                let number = cell.parse::<f64>().ok().filter(|_| !is_text);
                row.insert(name.clone(), number.map_or_else(|| cell.into(), Value::from));
            }
            for (name, values) in &columns {
                row.insert((*name).to_owned(), values[r].into());
            }
            row
        })
        .collect();
    let mut document = document(args, experiment.kind(), rows, &warnings);
    document.table = document.text(Format::Csv);
    Ok(Outcome::good(document))
}

fn rtcp(args: &Args, global: &Global) -> Result<Outcome> {
    let path = args.model.as_ref().ok_or_else(|| {
        Error::option("--model", "is missing", "give the machine file the data are predicted from")
    })?;
    let model = Machine::read(path)?;
    let real = model.chain()?;
    let control = match &args.now {
        Some(path) => Machine::read(path)?.chain()?,
        None => real.clone(),
    };
    real.same_rotary(&control, "--now")?;
    let sweep = Sweep::read(&args.data, &real)?;
    let mut d = predict(&control, &real, &model.target_point(), &sweep.rotary_rad);
    let mut warnings = Vec::new();
    if model.effects.is_empty() {
        warnings.extend(model.doubts());
    } else {
        let experiment = source(args).load(&mut warnings)?;
        let mut added = vec![Vector3::zeros(); d.len()];
        add_effects(experiment.as_ref(), &mut added);
        if let Some(most) = beyond_machines(added.iter().map(Vector3::norm)) {
            warnings.push(format!(
                "the model's effects add up to {most:.1} mm, more than any machine shows: check their parameters' units"
            ));
        }
        d.iter_mut().zip(added).for_each(|(d, added)| *d += added);
    }
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let mut noise = noise(args);
    d.iter_mut().for_each(|d| d.iter_mut().for_each(|v| *v += noise()));

    // Columns as in the data, then the deviation; people and programs get the same table.
    let kept = sweep.conditions();
    let names: Vec<&str> = kept.iter().map(String::as_str).chain(DEVIATION).collect();
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
        rows.push(pairs.collect());
    }
    Ok(Outcome::good(Document { table: csv, ..document(args, "rtcp", rows, &warnings) }))
}
