//! `pivotsight capture`: pictures with the machine's position, in the manifest that `rod` reads.

use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::{Global, Outcome, Status, result, rows, seconds};
use crate::error::{Error, Result};
use crate::live::store::{Position, Store};
use crate::live::{Event, Feed, Shot};
use crate::output::Document;

/// Stores pictures with the machine's position, typed in or read from a file, in the manifest that `rod` reads
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A camera's number or a video file (need OpenCV built in), a folder of pictures, or an http:// MJPEG stream
    #[arg(value_name = "SOURCE")]
    source: String,
    /// Folder for the pictures and captures.csv; an old one is continued
    #[arg(long, value_name = "DIR")]
    store: PathBuf,
    /// Table of the positions in order: x_mm,y_mm and optionally c_deg; Enter takes the next picture of a live source.
    /// Without it each line typed, X Y or X Y C, takes a picture
    #[arg(long, value_name = "FILE")]
    positions: Option<PathBuf>,
    /// Live source: give up when no picture comes for this many seconds
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    timeout_s: f64,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// The table of all captures of the folder.
    manifest: PathBuf,
    /// What was added.
    results: Vec<Captured>,
    /// Frames that came.
    received: u64,
    /// Of these, frames that a newer one replaced before they were looked at.
    dropped: u64,
    /// How often the source was lost and came back.
    reconnects: u64,
}

/// A picture with the machine's position.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Captured {
    image: String,
    x_mm: f64,
    y_mm: f64,
    c_deg: f64,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let timeout = seconds("--timeout-s", args.timeout_s)?;
    let positions = args.positions.as_deref().map(Position::read).transpose()?;
    let mut feed = Feed::open(&args.source)?;
    if same_folder(args.source.as_ref(), &args.store) {
        return Err(Error::option(
            "--store",
            "is the folder that is read: its captures would be taken again by the next run",
            "name another folder",
        ));
    }
    let mut store = Store::open(&args.store)?;
    let mut lines = std::io::stdin().lock().lines();
    let mut line = || -> Result<Option<String>> {
        lines.next().transpose().map_err(|e| Error::io("standard input", "read", e))
    };
    let mut results = Vec::new();
    let mut take = |feed: &mut Feed, at: Position| -> Result<bool> {
        let Some(shot) = picture(feed, timeout, global)? else { return Ok(false) };
        let name = store.add(&shot, at)?;
        global.say(format_args!("{name}  X {} Y {} C {}", at.x_mm, at.y_mm, at.c_deg));
        results.push(Captured { image: name, x_mm: at.x_mm, y_mm: at.y_mm, c_deg: at.c_deg });
        Ok(true)
    };
    match &positions {
        Some(positions) => {
            for &at in positions {
                if feed.is_live() {
                    global.say(format_args!(
                        "drive to X {} Y {} C {}, then press Enter",
                        at.x_mm, at.y_mm, at.c_deg
                    ));
                    if line()?.is_none() {
                        break;
                    }
                }
                if !take(&mut feed, at)? {
                    break;
                }
            }
        }
        None => {
            global.say("type the machine's X Y, or X Y C; an empty line or the end of input ends");
            while let Some(text) = line()?.filter(|t| !t.trim().is_empty()) {
                match Position::parse(&text) {
                    // A slip of the fingers costs a line, not the session.
                    Err(e) => global.say(e),
                    Ok(at) => {
                        if !take(&mut feed, at)? {
                            break;
                        }
                    }
                }
            }
        }
    }
    let stats = feed.stats();
    let table = format!("{}: {} captures added\n", store.manifest().display(), results.len());
    let output = Output {
        manifest: store.manifest(),
        results,
        received: stats.received,
        dropped: stats.dropped,
        reconnects: stats.reconnects,
    };
    let taken = output.results.len();
    let asked = positions.map_or(taken, |p| p.len());
    let mut warnings = Vec::new();
    if taken < asked {
        warnings.push(format!(
            "the source or the input ended: the last {} of {asked} positions have no picture",
            asked - taken
        ));
    }
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let json = result("capture", &args.source, &warnings, &output);
    let document = Document { json, rows: rows(&output.results), table };
    let status = match taken {
        _ if taken == asked => Status::Good,
        0 => Status::BadInput,
        _ => Status::SomeFailed,
    };
    Ok(Outcome { document: Some(document), status })
}

/// Whether both name one folder that is there.
fn same_folder(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// A whole picture that came after now; `None` at the source's end.
fn picture(feed: &mut Feed, timeout: Duration, global: &Global) -> Result<Option<Shot>> {
    feed.freshen();
    let start = std::time::Instant::now();
    while start.elapsed() < timeout {
        match feed.wait()? {
            // What cannot be decoded is not stored; a live source soon has another one.
            Event::Shot(shot, _) => match shot.frame() {
                Ok(_) => return Ok(Some(shot)),
                Err(e) if feed.is_live() => global.say(e),
                Err(e) => return Err(e),
            },
            Event::Ended => return Ok(None),
            Event::Stalled(silent) => {
                global.say(format_args!("STALLED: no frame for {:.1} s", silent.as_secs_f64()))
            }
            Event::Lost(reason) => global.say(format_args!("LOST: {reason}; trying again")),
            Event::Back => global.say("the source is back"),
        }
    }
    Err(Error::measure(
        "source",
        format!("no picture came for {} s; what is stored is complete", timeout.as_secs_f64()),
        "check the camera and start again: the folder is continued",
    ))
}
