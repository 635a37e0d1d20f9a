//! `pivotsight calib target`: a target to print.

use serde_json::json;

use super::super::{Global, Outcome, envelope};
use crate::calib::target::{Page, Target, pdf, svg};
use crate::error::{Error, Result};
use crate::output::{Document, write_whole};

/// Writes a calibration target to print, true to scale, as SVG or PDF
#[derive(Debug, clap::Args)]
pub struct Args {
    /// KIND:COLUMNSxROWS:PITCH_MM, as charuco:11x7:15, chessboard:10x7:25 (squares) or dots:9x7:10
    #[arg(value_name = "TARGET")]
    target: Target,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let page = Page::new(&args.target);
    let path = global.out.as_deref().ok_or_else(|| {
        Error::option("--out", "is missing", "name the file to write, ending in .svg or .pdf")
    })?;
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match extension.as_str() {
        "svg" => write_whole(path, svg(&page).as_bytes())?,
        "pdf" => write_whole(path, &pdf(&page))?,
        _ => {
            return Err(Error::option(
                "--out",
                format!("'{}' is neither .svg nor .pdf", path.display()),
                "name the file accordingly",
            ));
        }
    }
    let (w, h) = (page.size_mm.x, page.size_mm.y);
    let mut json = envelope("calib-target", args.target.to_string(), &[]);
    json.insert("file".into(), json!(path));
    json.insert("paper".into(), json!(page.paper));
    json.insert("page_mm".into(), json!([w, h]));
    json.insert("pattern_mm".into(), json!([args.target.size_mm().x, args.target.size_mm().y]));
    json.insert("points".into(), json!(args.target.points_mm().len()));
    let table = format!(
        "{}: {} on {} ({w} × {h} mm). Print at 100 %, measure several squares together, and give `calib camera` the pitch measured.\n",
        path.display(),
        args.target,
        page.paper
    );
    Ok(Outcome::good(Document::single(json.into(), table)))
}
