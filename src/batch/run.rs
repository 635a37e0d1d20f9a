//! Measures what is pending on all cores and writes each result into the journal as it comes.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde_json::{Map, Value};

use super::Meanwhile;
use super::input::Item;
use super::journal::{Journal, Status};
use crate::error::{Error, Result};
use crate::output::write_whole;
use crate::uncertainty::Verdict;

/// The folder of overlays in a batch's folder.
pub const OVERLAYS: &str = "overlays";

/// One item's measurement, or why there is none.
#[derive(Debug)]
pub struct Measured {
    /// Of the file's content, in hexadecimal, where it could be read.
    pub sha256: Option<String>,
    /// The keys of the result.
    pub result: Result<Map<String, Value>>,
    /// Pictures of what was measured.
    pub overlays: Vec<Overlay>,
}

/// A picture's file name and its PNG bytes.
pub type Overlay = (String, Vec<u8>);

/// How far a batch has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Measured or failed in this run.
    pub done: usize,
    /// Failed in this run.
    pub failed: usize,
    /// To do in this run.
    pub total: usize,
}

/// Measures `items` and appends a line for each, once its overlays are in `overlays`. A panic while measuring is that
/// item's failure; what cannot be written stops the batch.
pub fn run(
    items: &[&Item],
    overlays: &Path,
    journal: &Mutex<Journal>,
    threads: usize,
    measure: &(dyn Fn(&Item) -> Measured + Sync),
    meanwhile: Meanwhile,
) -> Result<()> {
    let Meanwhile { progress, stop, .. } = meanwhile;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| {
        Error::option("--threads", format!("cannot start {threads} threads ({e})"), "ask for fewer")
    })?;
    let (done, failures) = (AtomicUsize::new(0), AtomicUsize::new(0));
    pool.install(|| {
        items.par_iter().with_max_len(1).try_for_each(|item| {
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let measured = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| measure(item)))
                .unwrap_or_else(|_| Measured {
                    sha256: None,
                    overlays: Vec::new(),
                    result: Err(Error::measure(
                        &item.name,
                        "the measurement broke off inside the program",
                        "report this picture as a bug",
                    )),
                });
            for (name, png) in &measured.overlays {
                write_whole(overlays.join(name), png)?;
            }
            let failed = measured.result.is_err();
            let (line, verdict) = row(item, measured);
            // A poisoned lock only says that another thread panicked; the journal itself stays whole.
            journal
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner)
                .append(&item.name, &line, failed, verdict)?;
            let failed =
                failures.fetch_add(usize::from(failed), Ordering::Relaxed) + usize::from(failed);
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            progress(Progress { done, failed, total: items.len() });
            Ok(())
        })
    })
}

/// The JSON line of one item: name, hash, status and reason first, then the result's own keys.
fn row(item: &Item, measured: Measured) -> (String, Option<Verdict>) {
    let mut row = Map::new();
    row.insert("image".into(), item.name.clone().into());
    row.insert("sha256".into(), measured.sha256.into());
    let (status, reason, result) = match measured.result {
        Ok(result) => (Status::Measured, None, result),
        Err(error) => (Status::Failed, Some(error.to_string()), Map::new()),
    };
    row.insert("status".into(), serde_json::to_value(status).unwrap_or_default());
    row.insert("reason".into(), reason.into());
    let verdict = result.get("verdict").and_then(|v| serde_json::from_value(v.clone()).ok());
    row.insert("verdict".into(), serde_json::to_value(verdict).unwrap_or_default());
    if !measured.overlays.is_empty() {
        let names = measured.overlays.iter().map(|(name, _)| format!("{OVERLAYS}/{name}"));
        row.insert("overlays".into(), names.collect());
    }
    for (key, value) in item.own.clone().into_iter().chain(result) {
        row.entry(key).or_insert(value);
    }
    (Value::Object(row).to_string(), verdict)
}

/// Mean, spread and range of one column.
#[derive(
    Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
pub struct Statistics {
    /// How many rows have it.
    pub n: usize,
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation; null for one row.
    pub sd: Option<f64>,
    /// The least.
    pub min: f64,
    /// The largest.
    pub max: f64,
}

/// Gathers [`Statistics`] of every measured length and angle, row by row (Welford's recurrence).
#[derive(Debug, Default)]
pub struct Gather {
    order: Vec<String>,
    columns: HashMap<String, (usize, f64, f64, f64, f64)>,
}

impl Gather {
    /// Takes one row in.
    pub fn add(&mut self, row: &Value) {
        for (name, value) in crate::output::flatten(row) {
            let head = name.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('.');
            let wanted = !name.starts_with("x_")
                && (head.ends_with("_mm") || head.ends_with("_deg"))
                && !["u95", "tolerance", "limit", "expect"].iter().any(|w| head.contains(w));
            let Some(x) = value.as_f64().filter(|_| wanted) else { continue };
            let (n, mean, m2, min, max) = self.columns.entry(name).or_insert_with_key(|name| {
                self.order.push(name.clone());
                (0, 0.0, 0.0, x, x)
            });
            *n += 1;
            let step = x - *mean;
            *mean += step / *n as f64;
            *m2 += step * (x - *mean);
            (*min, *max) = (min.min(x), max.max(x));
        }
    }

    /// What was gathered, in the order the columns first appeared.
    pub fn finish(&self) -> Vec<(String, Statistics)> {
        let of = |name: &String| {
            let (n, mean, m2, min, max) = self.columns[name];
            let sd = (n > 1).then(|| (m2 / (n - 1) as f64).sqrt());
            (name.clone(), Statistics { n, mean, sd, min, max })
        };
        self.order.iter().map(of).collect()
    }
}
