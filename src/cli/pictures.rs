//! What `burn` and `circles` share: many pictures measured in parallel, printed in the order given.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::{Global, Outcome, Status, envelope};
use crate::camera::{Calibration, Identity};
use crate::draw;
use crate::error::{Error, Result};
use crate::frame::{self, Channel};
use crate::measure::cross::Opinion;
use crate::measure::offset::Mean;
use crate::output::{Document, create_folder, write_whole};
use crate::units;

/// What is printed of one picture, or of several.
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)] // Only described: reports of any kind are printed the same way.
pub enum Pictures<R> {
    One(Picture<R>),
    Failed(Failed),
    Several {
        calibration: Identity,
        results: Vec<Entry<R>>,
        /// With `burn --mean`.
        #[serde(skip_serializing_if = "Option::is_none")]
        mean: Option<Mean>,
    },
}

/// One of several.
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)]
pub enum Entry<R> {
    Measured(Picture<R>),
    Failed(Failed),
}

/// A measured picture.
#[derive(schemars::JsonSchema)]
#[allow(dead_code)]
pub struct Picture<R> {
    /// The picture's file.
    image: String,
    /// The overlay written.
    #[serde(skip_serializing_if = "Option::is_none")]
    overlay: Option<PathBuf>,
    /// What it was measured with; stands beside `results` where there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    calibration: Option<Identity>,
    #[serde(flatten)]
    report: R,
    /// OpenCV's second opinion, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    cross_check: Option<Vec<Opinion>>,
}

/// A picture that could not be measured.
#[derive(schemars::JsonSchema)]
#[allow(dead_code)]
pub struct Failed {
    /// The picture's file.
    image: String,
    /// The overlay written.
    #[serde(skip_serializing_if = "Option::is_none")]
    overlay: Option<PathBuf>,
    /// Why not.
    error: String,
    warnings: Vec<String>,
}

/// One measured picture, ready to print.
pub struct Shown {
    /// The report's keys.
    pub keys: Map<String, Value>,
    /// The same for people.
    pub table: String,
    /// Its warnings.
    pub warnings: Vec<String>,
    /// Whether a verdict, where there is one, is `pass`.
    pub good: bool,
    /// The overlay as PNG, where one is asked for.
    pub overlay: Option<Vec<u8>>,
    /// Pixels a row and rows.
    pub size: (usize, usize),
}

impl Shown {
    /// Adds OpenCV's second opinion.
    pub fn cross_check(&mut self, opinions: &[Opinion]) {
        self.keys.insert("cross_check".into(), json!(opinions));
        self.warnings.extend(opinions.iter().filter_map(Opinion::warning));
        opinions.iter().for_each(|o| self.table.push_str(&format!("  {}\n", o.line())));
    }
}

/// What became of one picture.
struct Answer {
    shown: Result<Shown>,
    /// The overlay written, where one was asked for and the picture can be shown.
    overlay: Option<PathBuf>,
}

/// What a command measures pictures with.
pub struct Camera<'c> {
    /// The calibration.
    pub calibration: &'c Calibration,
    /// Which one it is.
    pub identity: &'c Identity,
    /// Which part of colour pictures is measured.
    pub channel: Channel,
    /// What is doubtful about it or the options, whatever the pictures.
    pub doubts: Vec<String>,
}

/// Measures every picture with `job`, which is given it and its name, and builds what the command prints. A single picture
/// that fails is the command's error; of several, each that fails is an entry with `image` and `error`. `overlay` is the
/// folder for overlays: also of what was refused, with the reason.
pub fn run(
    command: &str,
    images: &[PathBuf],
    camera: Camera<'_>,
    overlay: Option<&Path>,
    global: &Global,
    job: impl Fn(&frame::Picture, &str) -> Result<Shown> + Sync,
) -> Result<Outcome> {
    let names = overlay_names(images);
    if let Some(folder) = overlay {
        global.makes("--overlay", folder, &names)?;
        create_folder(folder)?;
    }
    let one = |(image, name): (&PathBuf, &String)| -> Answer {
        let picture = match frame::Picture::read(image) {
            Ok(picture) => picture,
            Err(e) => return Answer { shown: Err(e), overlay: None },
        };
        let mut shown = job(&picture, &image.display().to_string());
        let drawn = match &mut shown {
            Ok(shown) => shown.overlay.take(),
            Err(why) => overlay
                .and_then(|_| draw::refused(&picture, camera.calibration, camera.channel, why)),
        };
        let written = drawn.zip(overlay).map(|(png, folder)| {
            let path = folder.join(name);
            write_whole(&path, &png).map(|()| path)
        });
        match written.transpose() {
            Ok(overlay) => Answer { shown, overlay },
            // Why a picture was refused matters more.
            Err(e) => Answer { shown: shown.and(Err(e)), overlay: None },
        }
    };
    let mut answers: Vec<Answer> = images.par_iter().zip(&names).map(one).collect();
    if let [image] = images {
        let Answer { shown, overlay } = answers.remove(0);
        let mut shown = shown?;
        shown.warnings.splice(..0, camera.doubts);
        shown.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
        let document = Document::single(
            entry(command, image, overlay.as_ref(), camera.identity, &shown),
            shown.table,
        );
        return Ok(Outcome { document: Some(document), status: status(shown.good) });
    }
    Ok(several(command, images, camera, &answers, global))
}

/// What the command ends with where every picture was measured.
pub fn status(good: bool) -> Status {
    if good { Status::Good } else { Status::OutOfTolerance }
}

/// A picture's result as it is printed on its own.
fn entry(
    command: &str,
    image: &Path,
    overlay: Option<&PathBuf>,
    calibration: &Identity,
    shown: &Shown,
) -> Value {
    let mut json = envelope(command, image, &shown.warnings);
    json.insert("image".into(), json!(image));
    json.insert("calibration".into(), json!(calibration));
    json.extend(named(overlay));
    json.extend(shown.keys.clone());
    Value::Object(json)
}

/// The key of an overlay that was written.
fn named(overlay: Option<&PathBuf>) -> Option<(String, Value)> {
    overlay.map(|path| ("overlay".into(), json!(path)))
}

fn several(
    command: &str,
    images: &[PathBuf],
    camera: Camera<'_>,
    answers: &[Answer],
    global: &Global,
) -> Outcome {
    let Camera { calibration, identity, doubts: mut warnings, .. } = camera;
    if calibration.lens_size().is_none() {
        let names = images.iter().map(|i| i.to_str().unwrap_or_default());
        let measured =
            names.zip(answers).filter_map(|(name, a)| Some((name, a.shown.as_ref().ok()?.size)));
        warnings.extend(units::sizes(measured));
    }
    let (mut rows, mut table) = (Vec::new(), String::new());
    let (mut failed, mut good) = (0, true);
    for (image, Answer { shown, overlay }) in images.iter().zip(answers) {
        match shown {
            Ok(shown) => {
                good &= shown.good;
                rows.push(entry(command, image, overlay.as_ref(), identity, shown));
                warnings.extend(shown.warnings.iter().map(|w| format!("{}: {w}", image.display())));
                table.push_str(&shown.table);
            }
            Err(e) => {
                failed += 1;
                let mut json = envelope(command, image, &[]);
                json.insert("image".into(), json!(image));
                json.extend(named(overlay.as_ref()));
                json.insert("error".into(), json!(e.to_string()));
                rows.push(Value::Object(json));
                table.push_str(&format!("{}\n  FAILED: {e}\n", image.display()));
                global.say(format!("pivotsight: {e}"));
            }
        }
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let mut json = envelope(command, images, &warnings);
    json.insert("calibration".into(), json!(identity));
    let results: Vec<Value> = rows.iter().map(own_keys).collect();
    json.insert("results".into(), results.into());
    let status = match failed {
        0 => status(good),
        n if n == images.len() => Status::BadInput,
        _ => Status::SomeFailed,
    };
    Outcome { document: Some(Document { json: json.into(), rows, table }), status }
}

/// An entry of `results`: the envelope round all of them says the rest.
fn own_keys(row: &Value) -> Value {
    let mut row = row.clone();
    if let Value::Object(map) = &mut row {
        ["schema", "version", "input", "calibration"]
            .iter()
            .for_each(|key| drop(map.shift_remove(*key)));
    }
    row
}

/// A file name for each picture's overlay; pictures of one name in different folders are numbered.
pub fn overlay_names<'p>(images: impl IntoIterator<Item = &'p PathBuf>) -> Vec<String> {
    let mut taken = HashSet::new();
    images
        .into_iter()
        .map(|image| {
            let stem = image.file_stem().unwrap_or_default().to_string_lossy();
            let mut name = format!("{stem}.overlay.png");
            let mut number = 2;
            while !taken.insert(name.clone()) {
                name = format!("{stem}-{number}.overlay.png");
                number += 1;
            }
            name
        })
        .collect()
}

/// The keys of a report.
pub fn keys(report: &impl serde::Serialize, subject: &str) -> Result<Map<String, Value>> {
    match serde_json::to_value(report) {
        Ok(Value::Object(keys)) => Ok(keys),
        _ => Err(Error::measure(subject, "the report cannot be written as JSON", "report this")),
    }
}
