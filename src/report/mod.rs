//! A result as one self-contained HTML page: verdict first, then the numbers as metrology people read them,
//! pictures, what contributes to the uncertainty, the calibration, and what to do next. Prints on A4.

mod advice;
mod charts;
mod html;
mod numbers;

use std::path::PathBuf;

use serde_json::Value;

use crate::clock;
use crate::error::{Error, Result};
use crate::output::escape;
use html::{embed, table};
use numbers::Characteristic;

/// What a page shows beside the result itself.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// A heading; the command's name where empty.
    pub title: String,
    /// Pictures to show: overlays and plots (PNG, JPEG or SVG).
    pub pictures: Vec<PathBuf>,
    /// The calibration file the result was measured with.
    pub calib: Option<PathBuf>,
    /// Seconds since 1970 that the page gives as its date.
    pub now: u64,
}

/// Makes the page of a result as a command printed it with `--format json`.
pub fn page(result: &Value, options: &Options) -> Result<String> {
    let schema = result.get("schema").and_then(Value::as_str).unwrap_or("");
    let Some(command) = schema.strip_prefix("pivotsight.").and_then(|s| s.split('/').next()) else {
        return Err(Error::measure(
            "report",
            "this is not a result of pivotsight",
            "give the file a command wrote with --format json",
        ));
    };
    let several = result.get("results").and_then(Value::as_array);
    let parts: Vec<&Value> = several.map_or_else(|| vec![result], |list| list.iter().collect());
    let title = if options.title.is_empty() { heading(command) } else { &options.title };
    let mut body = format!(
        "<header><h1>{}</h1><p>{} · pivotsight {} · {}</p></header>\n",
        escape(title),
        escape(&words(result.get("input"))),
        escape(&words(result.get("version"))),
        clock::utc(options.now),
    );
    for part in parts {
        body += &section(command, part);
    }
    for path in &options.pictures {
        body += &embed(path)?;
    }
    body += &calibration(result, options)?;
    let warnings = result.get("warnings").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    if !warnings.is_empty() {
        body += "<h2>Warnings</h2>\n<ul>\n";
        warnings.iter().for_each(|w| body += &format!("<li>{}</li>\n", escape(&words(Some(w)))));
        body += "</ul>\n";
    }
    Ok(html::document(title, &body))
}

/// Verdict, numbers, charts, budget and advice of one result.
fn section(command: &str, result: &Value) -> String {
    let mut text = String::new();
    let (verdict, sentence) = advice::verdict(command, result);
    text += &format!(
        "<p class=\"verdict {verdict}\"><b>{}</b> {}</p>\n",
        verdict.to_uppercase(),
        escape(&sentence)
    );
    if let Some(image) = result.get("image").and_then(Value::as_str) {
        text += &format!("<h2>{}</h2>\n", escape(image));
    }
    let rows = numbers::characteristics(command, result);
    if !rows.is_empty() {
        text += "<h2>Results</h2>\n";
        let head = [
            "Characteristic",
            "Nominal",
            "Actual",
            "Deviation",
            "Tolerance",
            "U (95 %)",
            "Verdict",
        ];
        text += &table(&head, rows.iter().map(Characteristic::cells));
    }
    for list in numbers::lists(result) {
        text += &format!("<h2>{}</h2>\n", escape(&list.title));
        let head: Vec<&str> = list.head.iter().map(String::as_str).collect();
        text += &table(&head, list.rows.iter().cloned());
    }
    for figure in charts::of(command, result) {
        text += &format!("<figure>{}</figure>\n", figure.to_svg());
    }
    let budget = numbers::budget(command, result);
    if !budget.is_empty() {
        text += "<h2>Uncertainty budget</h2>\n<p>What contributes how much to the variance of the result.</p>\n";
        let rows = budget.iter().map(|b| {
            let share = if b.share_percent.is_finite() {
                format!("{:.0} %", b.share_percent)
            } else {
                String::new()
            };
            vec![b.source.clone(), format!("{:.5}", b.u), b.unit.clone(), share]
        });
        text += &table(&["Source", "Standard uncertainty", "", "Share"], rows);
    }
    let steps = advice::next(command, result);
    text += "<h2>What to do next</h2>\n<ul>\n";
    steps.iter().for_each(|s| text += &format!("<li>{}</li>\n", escape(s)));
    text + "</ul>\n"
}

fn heading(command: &str) -> &str {
    match command {
        "burn" => "Burn test",
        "circles" => "Circles",
        "rod" => "Check rod: C axis centre",
        "solve" => "Machine vectors",
        "verify" => "RTCP verification",
        "diagnose" => "Diagnosis",
        "batch" => "Batch",
        other => other,
    }
}

fn calibration(result: &Value, options: &Options) -> Result<String> {
    let mut rows = Vec::new();
    if let Some(path) = &options.calib {
        let calibration = crate::camera::Calibration::read(path)?;
        rows.push(("Name".into(), calibration.name));
        rows.push(("File".into(), path.display().to_string()));
        rows.push(("SHA-256".into(), crate::hash::of_file(path)?));
        let written = std::fs::metadata(path).and_then(|m| m.modified()).ok();
        let seconds =
            written.and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok()).map(|d| d.as_secs());
        if let Some(seconds) = seconds {
            let days = options.now.saturating_sub(seconds) as f64 / clock::DAY_S;
            rows.push((
                "File last changed".into(),
                format!("{} ({days:.0} days ago)", clock::utc(seconds)),
            ));
        }
    }
    if let Some(Value::Object(keys)) = result.get("calibration") {
        rows.extend(keys.iter().map(|(k, v)| (k.clone(), words(Some(v)))));
    }
    if let Some(sha) = result.get("calib_sha256").and_then(Value::as_str) {
        rows.push(("SHA-256 when measured".into(), sha.to_owned()));
    }
    if rows.is_empty() {
        return Ok(
            "<h2>Calibration</h2>\n<p>Not stated: give the report --calib FILE.</p>\n".into()
        );
    }
    Ok(format!(
        "<h2>Calibration</h2>\n{}",
        table(&["", ""], rows.into_iter().map(|(a, b)| vec![a, b]))
    ))
}

/// A JSON value as words.
fn words(value: Option<&Value>) -> String {
    match value {
        None | Some(Value::Null) => String::new(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Array(list)) => {
            list.iter().map(|v| words(Some(v))).collect::<Vec<_>>().join(", ")
        }
        Some(Value::Object(map)) => map
            .iter()
            .map(|(k, v)| format!("{k}: {}", words(Some(v))))
            .collect::<Vec<_>>()
            .join(", "),
        Some(other) => other.to_string(),
    }
}
