//! A history's page: every record in a line, and the followed values over time.

use serde_json::Value;

use super::lists::{List, MAX_ROWS};
use crate::plot::Figure;
use crate::store::{Record, drift};

/// The records of a history's result; none where it is another command's.
fn records(result: &Value) -> Vec<Record> {
    let records = result.get("records").cloned();
    records.and_then(|list| serde_json::from_value(list).ok()).unwrap_or_default()
}

/// The newest records, oldest first.
pub fn list(result: &Value) -> List {
    let records = records(result);
    let newest = &records[records.len().saturating_sub(MAX_ROWS)..];
    let more = if newest.len() < records.len() {
        format!(" (the newest {MAX_ROWS} of {})", records.len())
    } else {
        String::new()
    };
    let row = |r: &Record| {
        let verdict = r.verdict.clone().unwrap_or_default();
        let values = drift::values(r).join("; ");
        vec![r.time_utc.clone(), r.command.clone(), r.input.clone(), verdict, values]
    };
    List {
        title: format!("Records{more}"),
        head: ["Time, UTC", "Command", "Input", "Verdict", "Values"].map(String::from).into(),
        rows: newest.iter().map(row).collect(),
    }
}

/// Every followed value over time.
pub fn figure(result: &Value) -> Option<Figure> {
    let series = drift::series(&records(result));
    (!series.is_empty()).then(|| drift::figure(&series))
}

/// What the records say, in a sentence, and the class of that.
pub fn verdict(result: &Value) -> (&'static str, String) {
    let count = |key: &str| result.get(key).and_then(Value::as_array).map_or(0, Vec::len);
    let (records, drifts) = (count("records"), count("drift"));
    match drifts {
        0 => (
            "measured",
            format!("{records} records: no followed value drifts beyond its uncertainty."),
        ),
        n => {
            ("undecided", format!("{records} records: {n} changes beyond uncertainty, see Drift."))
        }
    }
}
