//! `pivotsight history`: what was measured before, over time; and the keeping of records.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::{Global, Outcome, Status, result, rows};
use crate::error::{Error, Result};
use crate::output::{Document, Format};
use crate::store::{Filter, Record, Selected, drift, keep, select};

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
    let Selected { records, mut warnings } = select(
        path,
        &Filter {
            command: args.command.clone(),
            input: args.input.clone(),
            verdict: args.verdict.clone(),
            since: args.since.clone(),
            until: args.until.clone(),
            last: args.last,
        },
    )?;
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    if args.check && records.is_empty() {
        let fix = "correct --command, --input, --verdict, --since or --until";
        return Err(Error::option(
            "--check",
            "has no record to check: none is left by the filter",
            fix,
        ));
    }
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
            drift::values(record).join("  ")
        );
    }
    for drift in &output.drift {
        let _ = writeln!(text, "warning: drift: {}", drift.text);
    }
    let drifts = args.check && !output.drift.is_empty();
    let status = if drifts { Status::OutOfTolerance } else { Status::Good };
    Ok(Outcome { document: Some(Document { json, rows, table: text }), status })
}

/// Keeps a command's result where the user keeps records; a batch keeps its own pictures.
pub fn keep(global: &Global, arguments: &[String], outcome: &Outcome) -> Result<()> {
    match (&global.records, &outcome.document) {
        (Some(path), Some(document)) => keep::result(path, &document.json, arguments, global.taken),
        _ => Ok(()),
    }
}

/// Says that a result could not be kept: it is measured and shown all the same.
pub fn told(global: &Global, kept: Result<()>) {
    if let Err(error) = kept {
        global.insist(format_args!("pivotsight: {error}: the result is whole, but not kept there"));
    }
}
