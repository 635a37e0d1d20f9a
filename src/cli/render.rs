//! `pivotsight render burn|rod`: pictures with known truth.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{Global, Outcome, Status, envelope};
use crate::error::{Error, Result};
use crate::output::{Document, create_folder, write_whole};
use crate::render::camera::Camera;
use crate::render::{BurnScene, Preset, RodScene, burn, rod};

/// Pictures with known truth
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Burn marks: IMAGE, its truth and the camera's calibration
    Burn(Wish),
    /// Captures of a check rod's rim: images, a captures table, truth and calibration
    Rod(Wish),
}

/// What to render, how often and where to.
#[derive(Debug, clap::Args)]
struct Wish {
    /// Scene file (docs/render.md)
    #[arg(
        value_name = "SCENE.toml",
        required_unless_present = "preset",
        conflicts_with = "preset"
    )]
    scene: Option<PathBuf>,
    /// A scene that comes with the program
    #[arg(long, value_enum)]
    preset: Option<Preset>,
    /// Folder for what is made; created where it is missing
    #[arg(long, value_name = "DIR")]
    out_dir: PathBuf,
    /// Seed of everything that is left to chance; picture N uses SEED + N - 1
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many burns or rods, all seen by one camera
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    count: u32,
    /// Read N × N pixels as one: smaller pictures of the same view
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    binning: u32,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let (kind, rows) = match &args.what {
        What::Burn(wish) => ("burn", burns(wish, global)?),
        What::Rod(wish) => ("rod", rods(wish, global)?),
    };
    let table = rows.iter().map(|r| format!("{}\n", r["line"].as_str().unwrap_or(""))).collect();
    let rows: Vec<Value> = rows
        .into_iter()
        .map(|mut row| {
            row.as_object_mut().map(|r| r.shift_remove("line"));
            row
        })
        .collect();
    let mut json = envelope(&format!("render-{kind}"), json!({ "kind": kind }), &[]);
    json.insert("results".into(), rows.clone().into());
    Ok(Outcome {
        document: Some(Document { json: json.into(), rows, table }),
        status: Status::Good,
    })
}

fn burns(wish: &Wish, global: &Global) -> Result<Vec<Value>> {
    let mut scene = match (&wish.scene, wish.preset) {
        (Some(path), _) => BurnScene::read(path)?,
        (None, preset) => BurnScene::preset(preset.unwrap_or(Preset::Clean))?,
    };
    scene.camera = scene.camera.binned(wish.binning);
    let camera = scene.draw_camera(wish.seed)?;
    let mut rows = Vec::new();
    for number in 1..=wish.count {
        let made =
            burn::render_with(&scene, &camera, wish.seed.wrapping_add(u64::from(number) - 1))?;
        if number == 1 {
            write_calibration(&wish.out_dir, &camera)?;
        }
        let name = format!("burn-{number:04}");
        let image = format!("{name}.png");
        made.picture.write_png(wish.out_dir.join(&image))?;
        let truth = write_truth(&wish.out_dir, &name, &image, "burn", &made.truth)?;
        global.say(format_args!("{image}"));
        let [x, y] = made.truth.offset_mm;
        rows.push(json!({
            "line": format!("{image}  offset ({x:+.4}, {y:+.4}) mm  ring {:.4} mm  spot {:.4} mm",
                made.truth.ring.diameter_mm, made.truth.spot.diameter_mm),
            "image": image,
            "truth": truth,
        }));
    }
    Ok(rows)
}

fn rods(wish: &Wish, global: &Global) -> Result<Vec<Value>> {
    let mut scene = match (&wish.scene, wish.preset) {
        (Some(path), _) => RodScene::read(path)?,
        (None, preset) => RodScene::preset(preset.unwrap_or(Preset::Clean))?,
    };
    scene.camera = scene.camera.binned(wish.binning);
    let camera = scene.draw_camera(wish.seed)?;
    let mut rows = Vec::new();
    for number in 1..=wish.count {
        let made =
            rod::render_with(&scene, &camera, wish.seed.wrapping_add(u64::from(number) - 1))?;
        if number == 1 {
            write_calibration(&wish.out_dir, &camera)?;
        }
        let name = format!("rod-{number:04}");
        let table = made.write(&wish.out_dir, &name)?;
        let truth = write_truth(&wish.out_dir, &name, &table, "rod", &made.truth)?;
        global.say(format_args!("{table}"));
        let [x, y] = made.truth.axis_center_mm;
        rows.push(json!({
            "line": format!("{table}  {} captures  axis ({x:.4}, {y:.4}) mm  rod {:.4} mm",
                made.captures.len(), made.truth.diameter_mm),
            "captures": table,
            "truth": truth,
        }));
    }
    Ok(rows)
}

/// The camera's calibration, for all pictures of a folder.
fn write_calibration(folder: &Path, camera: &Camera) -> Result<()> {
    create_folder(folder)?;
    write_whole(folder.join("calib.toml"), camera.calibration.to_toml().as_bytes())
}

/// Writes `NAME.truth.json` and hands back what it holds.
fn write_truth(
    folder: &Path,
    name: &str,
    of: &str,
    kind: &str,
    truth: &impl serde::Serialize,
) -> Result<Value> {
    let mut json = serde_json::Map::new();
    json.insert("schema".into(), format!("pivotsight.truth-{kind}/1").into());
    json.insert("of".into(), of.into());
    json.insert("calib".into(), "calib.toml".into());
    let path = folder.join(format!("{name}.truth.json"));
    match serde_json::to_value(truth) {
        Ok(Value::Object(truth)) => json.extend(truth),
        _ => return Err(Error::file(path, "cannot be written as JSON", "report this")),
    }
    let value = Value::Object(json);
    let text = serde_json::to_string_pretty(&value).unwrap_or_default() + "\n";
    write_whole(path, text.as_bytes())?;
    Ok(value)
}
