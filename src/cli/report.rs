//! `pivotsight report`: a result as a page.

use std::path::PathBuf;

use super::{Global, Outcome, result};
use crate::clock;
use crate::error::{Error, Result};
use crate::output::{Document, identity};
use crate::report::{Options, Source};

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
    let source = Source::of(&args.result);
    let out = match &global.out {
        Some(out) => out.to_path_buf(),
        None => source.path.with_extension("html"),
    };
    if identity(&out) == identity(&source.path) {
        return Err(Error::option(
            "--out",
            format!("'{}' is the result itself", out.display()),
            "name the page",
        ));
    }
    let page = source.page(Options {
        title: args.title.clone(),
        pictures: args.pictures.clone(),
        calib: args.calib.clone(),
        now: clock::now(),
        ..Options::default()
    })?;
    global.write(&out, page.as_bytes())?;
    // What was written is said where messages are.
    let json = result("report", &source.path, &[], &Output { page: out });
    Ok(Outcome::good(Document::single(json, String::new())))
}
