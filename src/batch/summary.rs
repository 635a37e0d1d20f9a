//! What a batch has come to: its tables, and how many pictures of each kind there are.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Mutex;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::journal::{Entry, Journal};
use super::run::{Gather, Statistics};
use super::{Item, Meanwhile, Options, burns, lock, tables};
use crate::error::{Error, Result};
use crate::output::{csv_text, write_whole};
use crate::uncertainty::Verdict;

/// How a batch went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Summary {
    /// Pictures with a row.
    pub pictures: usize,
    /// Of these, measured now; the others were there already.
    pub new: usize,
    /// Measured.
    pub measured: usize,
    /// Not measured; the rows say why.
    pub failed: usize,
    /// Byte for byte another picture of the batch; each has its row.
    pub copies: usize,
    /// Measured before, and not among the pictures now; their rows stay.
    pub gone: usize,
    /// Not measured yet, as the batch was told to end early.
    pub left: usize,
    /// Verdicts `pass`.
    pub pass: usize,
    /// Verdicts `fail`.
    pub fail: usize,
    /// Verdicts `undecided`.
    pub undecided: usize,
    /// Every measured length and angle.
    pub statistics: Vec<Column>,
    /// The first of those that were not measured; all are in the tables.
    pub failures: Vec<Failure>,
    /// The files made.
    pub files: Vec<PathBuf>,
}

/// The statistics of one column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Column {
    /// The column's name.
    pub column: String,
    /// Over its rows.
    #[serde(flatten)]
    pub statistics: Statistics,
}

/// A picture that was not measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Failure {
    /// Its name.
    pub image: String,
    /// Why.
    pub reason: String,
}

impl Failure {
    fn of(row: &Value) -> Option<Self> {
        let text = |key: &str| row[key].as_str().map(str::to_owned);
        Some(Self { image: text("image")?, reason: text("reason")? })
    }
}

/// Failures that a summary names.
const MOST_NAMED: usize = 10;

/// Writes the tables and the summary of what the journal holds now.
pub(super) fn written(
    options: &Options,
    items: &[Item],
    journal: &Mutex<Journal>,
    before: usize,
    meanwhile: Meanwhile,
) -> Result<Summary> {
    let mut journal = lock(journal);
    let lines = sorted(options, items, &journal);
    let there = items.iter().filter(|i| journal.entries().contains_key(&i.name)).count();
    let mut row = |entry: Entry| -> Result<Value> {
        serde_json::from_str(&journal.line(entry)?).map_err(|e| {
            Error::file(
                options.out.join("results.jsonl"),
                format!("is damaged ({e})"),
                "start again",
            )
        })
    };
    let (mut columns, mut gather) = (tables::Columns::default(), Gather::default());
    let (mut contents, mut copies) = (HashSet::new(), 0);
    let made: HashMap<&str, &burns::Burnt> =
        items.iter().map(|item| (item.name.as_str(), &item.burnt)).collect();
    let (mut burns, mut failures) = (Vec::new(), Vec::new());
    for (name, entry) in &lines {
        let value = row(*entry)?;
        if let Some(sha256) = value["sha256"].as_str() {
            copies += usize::from(!contents.insert(sha256.to_owned()));
        }
        columns.add(&value);
        gather.add(&value);
        failures.extend(Failure::of(&value).filter(|_| failures.len() < MOST_NAMED));
        burns.extend(made.get(name.as_str()).and_then(|burnt| burns::row(name, burnt, &value)));
    }
    let path = |name: &str| options.out.join(name);
    columns.write_csv(&path("results.csv"), lines.iter().map(|l| row(l.1)))?;
    columns.write_parquet(&path("results.parquet"), lines.iter().map(|l| row(l.1)))?;
    let mut files = ["results.jsonl", "results.csv", "results.parquet"].map(path).to_vec();
    if burns.is_empty() {
        // One of before the manifest changed would pass for this batch's.
        let _ = std::fs::remove_file(path(burns::FILE));
    } else {
        write_whole(path(burns::FILE), csv_text(&burns).as_bytes())?;
        files.push(path(burns::FILE));
    }
    let count = |f: &dyn Fn(&Entry) -> bool| lines.iter().filter(|l| f(&l.1)).count();
    let verdict = |v| count(&|e| e.verdict == Some(v));
    let failed = count(&|e| e.failed);
    let statistics =
        gather.finish().into_iter().map(|(column, statistics)| Column { column, statistics });
    let summary = Summary {
        pictures: lines.len(),
        new: lines.len().saturating_sub(before),
        measured: lines.len() - failed,
        failed,
        copies,
        gone: lines.len() - there,
        left: if meanwhile.is_stopped() { items.len() - there } else { 0 },
        pass: verdict(Verdict::Pass),
        fail: verdict(Verdict::Fail),
        undecided: verdict(Verdict::Undecided),
        statistics: statistics.collect(),
        failures,
        files,
    };
    (meanwhile.summary)(&summary, &mut lines.iter().map(|l| row(l.1)))?;
    Ok(summary)
}

/// The journal's entries in the order of the results: the manifest's, else by name.
pub(super) fn sorted(options: &Options, items: &[Item], journal: &Journal) -> Vec<(String, Entry)> {
    let listed: HashSet<&str> = items.iter().map(|i| i.name.as_str()).collect();
    let mut gone: Vec<&str> =
        journal.entries().keys().map(String::as_str).filter(|n| !listed.contains(n)).collect();
    gone.sort_unstable();
    let mut names: Vec<&str> = items.iter().map(|i| i.name.as_str()).chain(gone).collect();
    if options.watch.is_some() {
        names.sort_unstable();
    }
    names
        .into_iter()
        .filter_map(|n| journal.entries().get(n).map(|entry| (n.to_owned(), *entry)))
        .collect()
}
