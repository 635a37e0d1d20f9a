//! `pivotsight render burn|rod`: pictures with known truth.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::json;

use super::{Global, Outcome, result, rows};
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

/// What is printed.
#[derive(Serialize, JsonSchema)]
pub struct Output<R> {
    results: Vec<R>,
}

/// A rendered burn.
#[derive(Serialize, JsonSchema)]
pub struct Burn {
    /// The picture.
    image: String,
    truth: Truth<burn::BurnTruth>,
}

/// A rendered rod.
#[derive(Serialize, JsonSchema)]
pub struct Rod {
    /// The captures table.
    captures: String,
    truth: Truth<rod::RodTruth>,
}

/// What the truth file holds.
#[derive(Serialize, JsonSchema)]
struct Truth<T> {
    /// Its own schema.
    schema: String,
    /// The file it is the truth of.
    of: String,
    /// The calibration beside it.
    calib: &'static str,
    #[serde(flatten)]
    truth: T,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.what {
        What::Burn(wish) => {
            let made = burns(wish, global)?;
            let line = |b: &Burn| {
                let (t, [x, y]) = (&b.truth.truth, b.truth.truth.offset_mm);
                format!(
                    "{}  offset ({x:+.4}, {y:+.4}) mm  ring {:.4} mm  spot {:.4} mm\n",
                    b.image, t.ring.diameter_mm, t.spot.diameter_mm
                )
            };
            Ok(document("burn", made.iter().map(line).collect(), made))
        }
        What::Rod(wish) => {
            let made = rods(wish, global)?;
            let line = |(r, captures): &(Rod, usize)| {
                let (t, [x, y]) = (&r.truth.truth, r.truth.truth.axis_center_mm);
                format!(
                    "{}  {captures} captures  axis ({x:.4}, {y:.4}) mm  rod {:.4} mm\n",
                    r.captures, t.diameter_mm
                )
            };
            let table = made.iter().map(line).collect();
            Ok(document("rod", table, made.into_iter().map(|m| m.0).collect()))
        }
    }
}

fn document(kind: &str, table: String, results: Vec<impl Serialize>) -> Outcome {
    let rows = rows(&results);
    let json = result(&format!("render-{kind}"), json!({ "kind": kind }), &[], &Output { results });
    Outcome::good(Document { json, rows, table })
}

fn burns(wish: &Wish, global: &Global) -> Result<Vec<Burn>> {
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
        let name = format!("burn-{number:04}");
        let image = format!("{name}.png");
        global.makes(
            "--out-dir",
            &wish.out_dir,
            ["calib.toml".into(), image.clone(), truth_name(&name)],
        )?;
        if number == 1 {
            write_calibration(wish, "burn", &camera, global)?;
        }
        made.picture.write_png(wish.out_dir.join(&image))?;
        let truth = write_truth(&wish.out_dir, &name, &image, "burn", made.truth)?;
        global.say(format_args!("{image}"));
        rows.push(Burn { image, truth });
    }
    Ok(rows)
}

fn rods(wish: &Wish, global: &Global) -> Result<Vec<(Rod, usize)>> {
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
        let name = format!("rod-{number:04}");
        let names = ["calib.toml".into(), format!("{name}.csv"), truth_name(&name)];
        global.makes("--out-dir", &wish.out_dir, names)?;
        if number == 1 {
            write_calibration(wish, "rod", &camera, global)?;
        }
        let table = made.write(&wish.out_dir, &name)?;
        let truth = write_truth(&wish.out_dir, &name, &table, "rod", made.truth)?;
        global.say(format_args!("{table}"));
        rows.push((Rod { captures: table, truth }, made.captures.len()));
    }
    Ok(rows)
}

/// The camera's calibration, for all pictures of a folder. What an earlier run has left there and this one does not replace may be another
/// camera's.
fn write_calibration(wish: &Wish, kind: &str, camera: &Camera, global: &Global) -> Result<()> {
    let folder = &wish.out_dir;
    create_folder(folder)?;
    let (path, text) = (folder.join("calib.toml"), camera.calibration.to_toml());
    if std::fs::read(&path).is_ok_and(|old| old != text.as_bytes()) {
        let number = |name: &str, kind: &str| -> Option<u32> {
            let digits = name.strip_prefix(kind)?.strip_prefix('-')?;
            digits.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
        };
        let is_left = |name: &str| {
            let of = |other: &str| number(name, other);
            ["burn", "rod"].iter().any(|o| of(o).is_some_and(|n| *o != kind || n > wish.count))
        };
        let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut left: Vec<String> = files
            .filter_map(|file| file.file_name().into_string().ok())
            .filter(|name| is_left(name))
            .collect();
        left.sort();
        if let Some(first) = left.first() {
            global.say(format_args!(
                "warning: {}: {} older files, from {first} on, are of another camera than calib.toml is now: delete them",
                folder.display(),
                left.len()
            ));
        }
    }
    write_whole(path, text.as_bytes())
}

fn truth_name(name: &str) -> String {
    format!("{name}.truth.json")
}

/// Writes `NAME.truth.json` and hands back what it holds.
fn write_truth<T: Serialize>(
    folder: &Path,
    name: &str,
    of: &str,
    kind: &str,
    truth: T,
) -> Result<Truth<T>> {
    let schema = format!("pivotsight.truth-{kind}/1");
    let truth = Truth { schema, of: of.into(), calib: "calib.toml", truth };
    let path = folder.join(truth_name(name));
    let text = serde_json::to_string_pretty(&truth).map_err(|e| {
        Error::file(&path, format!("cannot be written as JSON: {e}"), "report this")
    })?;
    write_whole(path, (text + "\n").as_bytes())?;
    Ok(truth)
}
