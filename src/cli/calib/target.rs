//! `pivotsight calib target`: a target to print.

use std::path::PathBuf;

use super::super::{Global, Outcome, result};
use crate::calib::target::{Page, Target, pdf, svg};
use crate::error::{Error, Result};
use crate::frame::named::ends_in;
use crate::output::Document;

/// Writes a calibration target to print, true to scale, as SVG or PDF
#[derive(Debug, clap::Args)]
pub struct Args {
    /// KIND:COLUMNSxROWS:PITCH_MM, as charuco:11x7:15, chessboard:10x7:25 (squares) or dots:9x7:10
    #[arg(value_name = "TARGET")]
    target: Target,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// The drawing.
    file: PathBuf,
    /// The paper it is for.
    paper: String,
    /// The paper's size.
    page_mm: [f64; 2],
    /// The pattern's size.
    pattern_mm: [f64; 2],
    /// Points a camera finds in it.
    points: usize,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let page = Page::new(&args.target);
    let path = global.out.as_deref().ok_or_else(|| {
        Error::option("--out", "is missing", "name the file to write, ending in .svg or .pdf")
    })?;
    if ends_in(path, &["svg"]) {
        global.write(path, svg(&page).as_bytes())?;
    } else if ends_in(path, &["pdf"]) {
        global.write(path, &pdf(&page))?;
    } else {
        return Err(Error::option(
            "--out",
            format!("'{}' is neither .svg nor .pdf", path.display()),
            "name the file accordingly",
        ));
    }
    let (w, h) = (page.size_mm.x, page.size_mm.y);
    let output = Output {
        file: path.to_path_buf(),
        paper: page.paper.to_string(),
        page_mm: [w, h],
        pattern_mm: args.target.size_mm().into(),
        points: args.target.points_mm().len(),
    };
    let json = result("calib-target", args.target.to_string(), &[], &output);
    let table = format!(
        "{}: {} on {} ({w} × {h} mm). Print at 100 %, measure several squares together, and give `calib camera` the pitch measured.\n",
        path.display(),
        args.target,
        page.paper
    );
    Ok(Outcome::good(Document::single(json, table)))
}
