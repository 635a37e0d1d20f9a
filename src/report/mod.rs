//! A result as one self-contained HTML page: verdict first, then the numbers as metrology people read them,
//! pictures, what contributes to the uncertainty, the calibration, and what to do next. Prints on A4.

pub(crate) mod advice;
mod ballbar;
mod charts;
mod history;
pub(crate) mod html;
mod lists;
mod numbers;
mod source;
mod thermal;

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::clock;
use crate::error::{Error, Result};
use crate::output::escape;
pub use source::Source;

use html::{embed, table};
use numbers::Characteristic;

/// Overlays of a batch shown on its page.
const MAX_OVERLAYS: usize = 8;

/// What a page shows beside the result itself.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// A heading; the command's name where empty.
    pub title: String,
    /// Pictures to show: overlays and plots (PNG, JPEG or SVG).
    pub pictures: Vec<PathBuf>,
    /// The calibration file; the one the result names where left out.
    pub calib: Option<PathBuf>,
    /// The folder the result lies in, where the pictures it names are looked for too.
    pub base: PathBuf,
    /// Rows of a batch that want looking at.
    pub rows: Vec<Value>,
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
    if schema.split('/').nth(1) != Some("1") {
        return Err(Error::measure(
            "report",
            format!("the result's schema is '{schema}', this program reads version 1"),
            "use the version that wrote it",
        ));
    }
    for (key, value) in result.as_object().into_iter().flatten().filter(|(key, _)| *key != "input")
    {
        numbers::refuse_text(key, value)?;
    }
    let several = result.get("results").and_then(Value::as_array);
    let parts: Vec<&Value> = several.map_or_else(|| vec![result], |list| list.iter().collect());
    let title = if options.title.is_empty() { heading(command) } else { &options.title };
    let mut body = format!(
        "<header><h1>{}</h1><p>{} · pivotsight {} · {}</p></header>\n",
        escape(title),
        escape(&input(result.get("input"))),
        escape(&words(result.get("version"))),
        clock::utc(options.now),
    );
    // A folder of a batch or a list of failures has something to say in any case.
    let mut shows = command == "batch" || several.is_some_and(|list| !list.is_empty());
    // What was asked to be judged by its mean is not corrected by one of its tests.
    let mean = result.get("mean");
    for part in mean.into_iter().chain(parts) {
        let advised = mean.is_none_or(|mean| std::ptr::eq(mean, part));
        let (text, numbers) = section(command, part, advised);
        shows |= numbers;
        body += &text;
        body += &html::pictures(&own_pictures(part, &options.base)?);
    }
    if !shows {
        return Err(Error::measure(
            "report",
            format!("a result '{schema}' holds nothing that a page shows"),
            "give the result of a measurement",
        ));
    }
    body += &batch_rows(&options.rows, &options.base)?;
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

/// Verdict, numbers, charts, budget and, where asked for, advice of one result, and whether there are any numbers or charts.
fn section(command: &str, result: &Value, advised: bool) -> (String, bool) {
    let mut text = String::new();
    let (verdict, sentence) = advice::verdict(command, result);
    text += &format!(
        "<p class=\"verdict {}\"><b>{}</b> {}</p>\n",
        verdict.replace(' ', "-"),
        result.get("verdict").and_then(Value::as_str).unwrap_or(verdict).to_uppercase(),
        escape(&sentence)
    );
    if let Some(image) = result.get("image").and_then(Value::as_str) {
        text += &format!("<h2>{}</h2>\n", escape(image));
    }
    if let Some(tests) = result.get("tests").and_then(Value::as_u64).filter(|_| command == "burn") {
        text += &format!("<h2>Mean of {tests} tests</h2>\n");
    }
    let rows = numbers::characteristics(command, result);
    let mut shows = !rows.is_empty();
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
    for list in lists::lists(command, result) {
        shows |= !list.rows.is_empty();
        text += &format!("<h2>{}</h2>\n", escape(&list.title));
        let head: Vec<&str> = list.head.iter().map(String::as_str).collect();
        text += &table(&head, list.rows.iter().cloned());
    }
    for figure in charts::of(command, result) {
        shows = true;
        text += &format!("<figure>{}</figure>\n", figure.to_svg());
    }
    let budgets = numbers::budgets(result);
    if !budgets.is_empty() {
        text += "<h2>Uncertainty budget</h2>\n<p>What contributes how much to the variance of each value. Where no calibration is named, its file does not say how surely it is known, and it is taken as exact: pivotsight calib check tells how well it holds.</p>\n";
    }
    for budget in budgets {
        let head = [budget.of.as_str(), "Standard uncertainty", "Share"];
        text += &table(&head, budget.rows.into_iter());
    }
    if !advised {
        return (text, shows);
    }
    let steps = advice::next(command, result);
    text += "<h2>What to do next</h2>\n<ul>\n";
    steps.iter().for_each(|s| text += &format!("<li>{}</li>\n", escape(s)));
    (text + "</ul>\n", shows)
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
        "history" => "History",
        "align" => "Lie of the blank",
        "rotary" => "Pitch-error correction of a rotary axis",
        "ballbar-decouple" => "Ball bar: errors taken apart",
        "thermal-fit" => "Thermal error model",
        "thermal-compensate" => "Thermal compensation",
        "machine" => "Machine",
        "demo" => "The method on a virtual machine",
        "demo-hidden-effect" => "An effect the model lacks, on a virtual machine",
        other => other,
    }
}

/// The overlays and plots that a result names, where they still are.
fn own_pictures(result: &Value, base: &Path) -> Result<String> {
    let one = ["overlay", "plot"].into_iter().filter_map(|key| result.get(key)?.as_str());
    let several = result.get("overlays").and_then(Value::as_array).into_iter().flatten();
    let mut text = String::new();
    for name in one.chain(several.filter_map(Value::as_str)) {
        match found(name, base) {
            Some(path) => text += &embed(&path)?,
            None => text += &format!("<p>{} is not there any more.</p>\n", escape(name)),
        }
    }
    Ok(text)
}

/// A file a result names, seen from here or from the result's own folder.
fn found(name: &str, base: &Path) -> Option<PathBuf> {
    [PathBuf::from(name), base.join(name)].into_iter().find(|path| path.is_file())
}

/// The pictures of a batch that failed or broke a limit: their reasons, and their overlays.
fn batch_rows(rows: &[Value], base: &Path) -> Result<String> {
    if rows.is_empty() {
        return Ok(String::new());
    }
    let text_of = |row: &Value, key: &str| words(row.get(key));
    let cells = rows.iter().map(|row| {
        let verdict = match row.get("verdict") {
            None | Some(Value::Null) => text_of(row, "status"),
            Some(verdict) => words(Some(verdict)),
        };
        let reason = match text_of(row, "reason") {
            none if none.is_empty() => numbers::broken(row).join("; "),
            reason => reason,
        };
        vec![text_of(row, "image"), verdict, reason]
    });
    let mut text = String::from("<h2>Pictures to look at</h2>\n");
    text += &table(&["Picture", "Verdict", "Reason"], cells);
    let mut figures = String::new();
    for row in rows.iter().filter(|row| row.get("overlays").is_some()).take(MAX_OVERLAYS) {
        figures += &own_pictures(row, base)?;
    }
    Ok(text + &html::pictures(&figures))
}

/// Which calibration the result rests on, and how old it is.
fn calibration(result: &Value, options: &Options) -> Result<String> {
    let stated = |key: &str| result.get("calibration")?.get(key)?.as_str();
    let own = stated("file").and_then(|file| found(file, &options.base));
    let mut rows: Vec<(&str, String)> = Vec::new();
    let measured = stated("sha256").or_else(|| result.get("calib_sha256")?.as_str());
    if let Some(path) = options.calib.as_ref().or(own.as_ref()) {
        let (calibration, now) = crate::camera::Calibration::identified(path)?;
        rows.push(("Name", calibration.name));
        rows.push(("File", path.display().to_string()));
        if let Some(seconds) = clock::changed(path) {
            let days = (options.now.saturating_sub(seconds) as f64 / clock::DAY_S).floor();
            let age = if days == 1.0 { "1 day".to_owned() } else { format!("{days} days") };
            rows.push(("Age", format!("{age}: last changed {}", clock::utc(seconds))));
        }
        rows.push(("SHA-256", now.sha256.clone()));
        if let Some(measured) = measured.filter(|sha| *sha != now.sha256) {
            rows.push(("SHA-256 when measured", measured.to_owned()));
            rows.push((
                "Note",
                "The file has changed since: measure again, or find the old one.".into(),
            ));
        }
    } else if let Some(name) = stated("name") {
        rows.push(("Name", name.to_owned()));
        rows.push(("File", format!("{} (not found now)", stated("file").unwrap_or("?"))));
        rows.push(("SHA-256 when measured", measured.unwrap_or("?").to_owned()));
    }
    if rows.is_empty() {
        return Ok(String::new());
    }
    let rows = rows.into_iter().map(|(a, b)| vec![a.to_owned(), b]);
    Ok(format!("<h2>Calibration</h2>\n{}", html::facts(rows)))
}

/// What a result was made from, without what was not given.
fn input(value: Option<&Value>) -> String {
    match value {
        Some(Value::Object(map)) => map
            .iter()
            .filter(|(_, v)| !v.is_null())
            .map(|(k, v)| format!("{k} {}", words(Some(v))))
            .collect::<Vec<_>>()
            .join(" · "),
        other => words(other),
    }
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
