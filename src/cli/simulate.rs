//! `pivotsight simulate`: what should be measured, from the machine file and its effects.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Map, Value};

use crate::cli::{Global, Outcome, envelope};
use crate::diagnose::load::{Kind, Source};
use crate::error::{Error, Result};
use crate::output::Document;

/// Predict every row of a plan or of measured data from the machine file and its effects
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// The kind of data
    #[arg(value_enum)]
    kind: Kind,
    /// The plan: a data file; its measured columns may be missing
    #[arg(long, value_name = "DATA.csv")]
    data: PathBuf,
    /// The machine file, with its [[effects]]
    #[arg(long, value_name = "machine.toml")]
    model: Option<PathBuf>,
    /// The camera's calibration file (rod)
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
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
        return Err(Error::option(
            "--noise-mm",
            format!("is {}", args.noise_mm),
            "give mm, zero or more",
        ));
    }
    let source = Source {
        kind: args.kind,
        data: args.data.clone(),
        model: args.model.clone(),
        calib: args.calib.clone(),
    };
    let mut warnings = Vec::new();
    let experiment = source.load(&mut warnings)?;
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let nuisances: Vec<f64> = experiment.nuisances().iter().map(|p| p.start).collect();
    let mut predicted = experiment.predict(&nuisances, &[]);
    if args.noise_mm > 0.0 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(args.seed);
        for p in &mut predicted {
            let z: f64 = StandardNormal.sample(&mut rng);
            *p += args.noise_mm * z;
        }
    }
    let columns = experiment.predicted_columns(&predicted);
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_path(&args.data)
        .map_err(|e| Error::file(&args.data, e.to_string(), "give a CSV file"))?;
    let header = reader
        .headers()
        .map_err(|e| Error::file(&args.data, e.to_string(), "give a CSV file"))?
        .clone();
    let mut rows = Vec::new();
    for (r, record) in reader.records().enumerate() {
        let record =
            record.map_err(|e| Error::file(&args.data, e.to_string(), "correct the row"))?;
        let mut row = Map::new();
        for (name, cell) in header.iter().zip(record.iter()) {
            let name = name.trim_start_matches('\u{feff}');
            let value = cell.parse::<f64>().map_or_else(|_| Value::from(cell), Value::from);
            row.insert(name.to_owned(), value);
        }
        for (name, values) in &columns {
            row.insert((*name).to_owned(), values[r].into());
        }
        rows.push(Value::Object(row));
    }
    let mut json = envelope("simulate", args.data.display().to_string(), &warnings);
    json.insert("kind".into(), experiment.kind().into());
    json.insert("rows".into(), Value::Array(rows.clone()));
    let mut document = Document { json: json.into(), rows, table: String::new() };
    document.table = document.text(crate::output::Format::Csv);
    Ok(Outcome::good(document))
}
