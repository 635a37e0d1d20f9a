//! `pivotsight report`: a result as a page.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Global, Outcome, result as output_of};
use crate::error::{Error, Result};
use crate::input;
use crate::output::{Document, identity};
use crate::report::{self, Options};
use crate::{batch, clock};

/// Make one self-contained HTML page of a result (print it from any browser, on A4)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What a command wrote with --format json, or the folder of a batch
    result: PathBuf,
    /// Heading of the page
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    title: String,
    /// Show this overlay or plot (PNG, JPEG, SVG); may be given several times
    #[arg(long = "picture", value_name = "FILE")]
    pictures: Vec<PathBuf>,
    /// The calibration file the result was measured with: its identity and age are shown
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// The page written.
    page: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let path =
        if args.result.is_dir() { args.result.join("summary.json") } else { args.result.clone() };
    let out = match &global.out {
        Some(out) => out.to_path_buf(),
        None => path.with_extension("html"),
    };
    if identity(&out) == identity(&path) {
        return Err(Error::option(
            "--out",
            format!("'{}' is the result itself", out.display()),
            "name the page",
        ));
    }
    if args.result.is_dir() && !path.exists() {
        return Err(Error::file(
            &args.result,
            "is not the folder of a batch that has measured: it holds no summary.json",
            "give the folder that `batch --out` named, or a result's file",
        ));
    }
    let text = input::text(&path, input::MOST_TABLE)?;
    let result: Value = serde_json::from_str(&text).map_err(|e| {
        Error::file(
            &path,
            format!("is not a JSON result ({e})"),
            "give what a command wrote with --format json",
        )
    })?;
    let rows = if args.result.is_dir() { worth_a_look(&args.result)? } else { Vec::new() };
    let options = Options {
        title: args.title.clone(),
        pictures: args.pictures.clone(),
        calib: args.calib.clone(),
        now: clock::now(),
        base: path.parent().unwrap_or(Path::new("")).to_owned(),
        rows,
    };
    let page = report::page(&result, &options).map_err(|e| e.in_file(&path, None))?;
    global.write(&out, page.as_bytes())?;
    // What was written is said where messages are.
    let json = output_of("report", &path, &[], &Output { page: out });
    Ok(Outcome::good(Document::single(json, String::new())))
}

/// The first rows of a batch that were not measured or not passed.
fn worth_a_look(folder: &Path) -> Result<Vec<Value>> {
    let good = |row: &Value| {
        row.get("status").is_some_and(|s| s == "measured")
            && row.get("verdict").is_none_or(|v| v == "pass" || v.is_null())
    };
    let mut list = Vec::new();
    for row in batch::rows(folder)? {
        let row = row?;
        if !good(&row) {
            list.push(row);
        }
        if list.len() == MAX_ROWS {
            break;
        }
    }
    Ok(list)
}

/// Rows of a batch shown on its page; all are in the tables.
const MAX_ROWS: usize = 50;
