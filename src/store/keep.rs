//! How results get into the records: which parts of a result are records, and what they are told apart by.

use std::path::Path;
use std::str::FromStr;

use serde_json::Value;

use super::{Record, Store};
use crate::error::Result;
use crate::{clock, hash};

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
            _ => match clock::parse(text) {
                // A day more than the clock says: where it is tomorrow already, and for clocks that differ.
                Some(time) if time > clock::now() + 86_400 => {
                    Err("is in the future: correct the date".into())
                }
                Some(time) => Ok(Self::At(time)),
                None => {
                    Err("is no time: write 2026-11-24, 2026-11-24T10:30:00Z (UTC) or file".into())
                }
            },
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

/// Keeps a command's result in the records `path`, a record for each of several; what a batch measures [`batch`] keeps. `arguments` is the
/// command line.
pub fn result(
    path: &Path,
    document: &Value,
    arguments: &[String],
    taken: Option<Taken>,
) -> Result<()> {
    let schema = document.get("schema").and_then(Value::as_str).unwrap_or("");
    let command = schema.trim_start_matches("pivotsight.").split('/').next().unwrap_or("");
    if ["", "batch"].contains(&command) {
        return Ok(());
    }
    let results = match document.get("results").and_then(Value::as_array) {
        Some(several) => several.clone(),
        None => vec![document.clone()],
    };
    let input = document.get("input").cloned().unwrap_or_default();
    let records = results.into_iter().filter(|r| r.get("error").is_none()).map(|result| {
        let name = result
            .get("image")
            .or(Some(&input))
            .and_then(Value::as_str)
            .map_or_else(|| input.to_string(), str::to_owned);
        let time_utc = time(taken, Path::new(&name));
        Ok(record(command, name, time_utc, arguments, None, result))
    });
    // The mean of several tests is what was judged: a series of its own beside that of the tests.
    let mean = document.get("mean").map(|mean| {
        let name = format!("{command}-mean");
        let first = results_image(document).unwrap_or_default();
        let time_utc = time(taken, Path::new(&first));
        Ok(record(&name, input.to_string(), time_utc, arguments, None, mean.clone()))
    });
    Store::open(path)?.add(records.chain(mean)).map(drop)
}

/// The first picture of several.
fn results_image(document: &Value) -> Option<String> {
    text(document.get("results")?.get(0)?, "image")
}

/// Keeps the measured pictures of a batch in the records `path`: of the `lines` of its results those that are measured, each at the time that
/// `taken` gives for its picture.
pub fn batch(
    path: &Path,
    command: &str,
    folder: &Path,
    calib: &Path,
    taken: impl Fn(&str) -> String,
    lines: impl Iterator<Item = Result<Value>>,
) -> Result<()> {
    let arguments = vec![format!("--calib={}", calib.display())];
    let which = Some(crate::batch::which(folder));
    let sample = record(command, String::new(), String::new(), &arguments, which, Value::Null);
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
