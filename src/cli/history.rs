//! `pivotsight history`: what was measured before, over time; and the keeping of records.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde_json::Value;

use super::{Global, Outcome, Status, result, rows};
use crate::batch::limits::{number, u95_key};
use crate::error::{Error, Result};
use crate::output::{Document, Format};
use crate::store::{Filter, Record, Store, drift};
use crate::{clock, hash};

/// List, filter, plot and export what was measured before; warns of drift
#[derive(Debug, clap::Args)]
pub struct Args {
    /// `export` prints whole records (JSON lines, or CSV with --format csv)
    #[arg(value_enum, default_value = "list", hide_default_value = true)]
    action: Action,
    /// Only of this command
    #[arg(long, value_name = "NAME")]
    command: Option<String>,
    /// Only inputs whose name contains TEXT
    #[arg(long, value_name = "TEXT")]
    input: Option<String>,
    /// Only with this verdict
    #[arg(long, value_parser = ["pass", "fail", "undecided"])]
    verdict: Option<String>,
    /// Not before this UTC date or time (2026-11-21 or 2026-11-21T03:35:10Z)
    #[arg(long, value_name = "TIME")]
    since: Option<String>,
    /// Before this UTC date or time
    #[arg(long, value_name = "TIME")]
    until: Option<String>,
    /// Only the newest N
    #[arg(long, value_name = "N")]
    last: Option<usize>,
    /// Write history.svg to DIR: every followed value over time with its interval and limit
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
    /// End with exit code 1 where a followed value drifts
    #[arg(long)]
    check: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Action {
    List,
    Export,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// What changed by more than its uncertainty.
    drift: Vec<drift::Drift>,
    /// Oldest first.
    records: Vec<Record>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let path = global.records.as_deref().ok_or_else(|| {
        Error::option(
            "--records",
            "is missing",
            "name the records file, here or in the configuration file",
        )
    })?;
    for (option, time) in [("--since", &args.since), ("--until", &args.until)] {
        if time.as_ref().is_some_and(|t| clock::parse(t).is_none()) {
            return Err(Error::option(
                option,
                "is not a date",
                "write 2026-11-21 or 2026-11-21T03:35:10Z",
            ));
        }
    }
    if let (Some(since), Some(until)) = (&args.since, &args.until)
        && clock::parse(since) >= clock::parse(until)
    {
        let reason = format!("{until} is not after --since {since}");
        return Err(Error::option("--until", reason, "exchange them"));
    }
    let store = Store::open_existing(path)?;
    let records = store.read(&Filter {
        command: args.command.clone(),
        input: args.input.clone(),
        verdict: args.verdict.clone(),
        since: args.since.clone(),
        until: args.until.clone(),
        last: args.last,
    })?;
    let mut warnings = Vec::new();
    if records.is_empty() {
        let held: Vec<String> =
            store.commands()?.iter().map(|(command, n)| format!("{command} {n}")).collect();
        if !held.is_empty() {
            warnings.push(format!("none of the records fits; the file holds: {}", held.join(", ")));
        }
    }
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let rows = rows(&records);
    if args.action == Action::Export {
        let document = Document {
            json: result("history", path, &warnings, &Output { drift: Vec::new(), records }),
            rows,
            table: String::new(),
        };
        let table = document.text(Format::Jsonl);
        return Ok(Outcome::good(Document { table, ..document }));
    }
    let series = drift::series(&records);
    let drifts: Vec<_> = series.iter().flat_map(drift::Series::drift).collect();
    warnings.extend(drifts.iter().map(|d| format!("drift: {}", d.text)));
    if let Some(folder) = &args.plot {
        global.write_into(folder, "history.svg", drift::figure(&series).to_svg().as_bytes())?;
    }
    let output = Output { drift: drifts, records };
    let json = result("history", path, &warnings, &output);
    let mut text = format!("{} records\n", output.records.len());
    for record in &output.records {
        let verdict = record.verdict.as_deref().unwrap_or("");
        let _ = writeln!(
            text,
            "{}  {:11} {:9} {}  {}",
            record.time_utc,
            record.command,
            verdict,
            record.input,
            values(record)
        );
    }
    for drift in &output.drift {
        let _ = writeln!(text, "warning: drift: {}", drift.text);
    }
    let drifts = args.check && !output.drift.is_empty();
    let status = if drifts { Status::OutOfTolerance } else { Status::Good };
    Ok(Outcome { document: Some(Document { json, rows, table: text }), status })
}

/// The followed values of one record on one line.
fn values(record: &Record) -> String {
    let Some(result) = record.result.as_object() else { return String::new() };
    drift::series(std::slice::from_ref(record))
        .iter()
        .filter_map(|s| {
            let value = number(result, &s.key)?;
            let u95 = u95_key(&s.key).and_then(|k| number(result, &k));
            let u95 = u95.map_or(String::new(), |u95| format!(" ± {u95:.4}"));
            let (name, unit) = s.label.split_once(", ").unwrap_or((&s.label, ""));
            Some(format!("{name} {value:.4}{u95} {unit}"))
        })
        .collect::<Vec<_>>()
        .join("  ")
}

/// When what is measured was captured.
#[derive(Debug, Clone, Copy)]
pub enum Taken {
    /// Seconds since 1970.
    At(u64),
    /// When the file was last changed.
    File,
}

impl FromStr for Taken {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "file" => Ok(Self::File),
            _ => clock::parse(text).map(Self::At).ok_or_else(|| {
                "is no time: write 2026-11-24, 2026-11-24T10:30:00Z (UTC) or file".into()
            }),
        }
    }
}

/// The time that a record of what was measured from `path` has.
pub fn time(taken: Option<Taken>, path: &Path) -> String {
    let seconds = match taken {
        None => None,
        Some(Taken::At(seconds)) => Some(seconds),
        Some(Taken::File) => clock::changed(path),
    };
    clock::utc(seconds.unwrap_or_else(clock::now))
}

/// Keeps a command's result where the user keeps records; a batch keeps its own pictures.
pub fn keep(global: &Global, arguments: &[String], outcome: &Outcome) -> Result<()> {
    let (Some(path), Some(document)) = (&global.records, &outcome.document) else { return Ok(()) };
    let schema = document.json.get("schema").and_then(Value::as_str).unwrap_or("");
    let command = schema.trim_start_matches("pivotsight.").split('/').next().unwrap_or("");
    if ["", "batch"].contains(&command) {
        return Ok(());
    }
    let results = match document.json.get("results").and_then(Value::as_array) {
        Some(several) => several.clone(),
        None => vec![document.json.clone()],
    };
    let input = document.json.get("input").cloned().unwrap_or_default();
    let records = results.into_iter().filter(|r| r.get("error").is_none()).map(|result| {
        let name = result
            .get("image")
            .or(Some(&input))
            .and_then(Value::as_str)
            .map_or_else(|| input.to_string(), str::to_owned);
        let time_utc = time(global.taken, Path::new(&name));
        Ok(record(command, name, time_utc, arguments, None, result))
    });
    // The mean of several tests is what was judged: a series of its own beside that of the tests.
    let mean = document.json.get("mean").map(|mean| {
        let name = format!("{command}-mean");
        let first = results_image(&document.json).unwrap_or_default();
        let time_utc = time(global.taken, Path::new(&first));
        Ok(record(&name, input.to_string(), time_utc, arguments, None, mean.clone()))
    });
    Store::open(path)?.add(records.chain(mean)).map(drop)
}

/// The first picture of several.
fn results_image(document: &Value) -> Option<String> {
    text(document.get("results")?.get(0)?, "image")
}

/// Says that a result could not be kept: it is measured and shown all the same.
pub fn told(global: &Global, kept: Result<()>) {
    if let Err(error) = kept {
        global.insist(format_args!("pivotsight: {error}: the result is whole, but not kept there"));
    }
}

/// Keeps the measured pictures of a batch.
pub fn keep_batch(
    path: &Path,
    command: &str,
    folder: &Path,
    calib: &Path,
    taken: impl Fn(&str) -> String,
    lines: impl Iterator<Item = Result<Value>>,
) -> Result<()> {
    let arguments = vec![format!("--calib={}", calib.display())];
    let batch = Some(crate::batch::which(folder));
    let sample = record(command, String::new(), String::new(), &arguments, batch, Value::Null);
    let records = lines.filter_map(|line| {
        let result = match line {
            Ok(line) => line,
            Err(e) => return Some(Err(e)),
        };
        if text(&result, "status").as_deref() != Some("measured") {
            return None;
        }
        let image = text(&result, "image").unwrap_or_default();
        Some(Ok(Record {
            time_utc: taken(&image),
            input: image,
            input_sha256: text(&result, "sha256"),
            verdict: text(&result, "verdict"),
            options: "batch".into(),
            result,
            ..sample.clone()
        }))
    });
    Store::open(path)?.add(records).map(drop)
}

fn record(
    command: &str,
    input: String,
    time_utc: String,
    arguments: &[String],
    batch: Option<String>,
    result: Value,
) -> Record {
    let calib = option(arguments, "--calib");
    Record {
        time_utc,
        command: command.into(),
        input_sha256: hash::of_file(&input).ok(),
        input,
        calib_sha256: calib.as_ref().and_then(|path| hash::of_file(path).ok()),
        calib,
        options: arguments.iter().skip(1).cloned().collect::<Vec<_>>().join(" "),
        version: env!("CARGO_PKG_VERSION").into(),
        verdict: text(&result, "verdict"),
        batch,
        result,
    }
}

fn text(result: &Value, key: &str) -> Option<String> {
    result.get(key).and_then(Value::as_str).map(str::to_owned)
}

/// The value of an option in a command line.
fn option(arguments: &[String], name: &str) -> Option<String> {
    let at = arguments
        .iter()
        .position(|a| a == name || a.strip_prefix(name).is_some_and(|r| r.starts_with('=')))?;
    match arguments[at].split_once('=') {
        Some((_, value)) => Some(value.to_owned()),
        None => arguments.get(at + 1).cloned(),
    }
}
