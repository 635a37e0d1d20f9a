//! `pivotsight render burn|rod`: pictures with known truth.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::json;

use super::{Global, Outcome, result, rows};
use crate::error::Result;
use crate::output::Document;
use crate::render::series::{self, Burn, Meanwhile, Rod};
use crate::render::{BurnScene, Preset, RodScene};

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

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.what {
        What::Burn(wish) => {
            let scene = match (&wish.scene, wish.preset) {
                (Some(path), _) => BurnScene::read(path)?,
                (None, preset) => BurnScene::preset(preset.unwrap_or(Preset::Clean))?,
            };
            let made = wish
                .series(global, |options, meanwhile| series::burns(&scene, options, meanwhile))?;
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
            let scene = match (&wish.scene, wish.preset) {
                (Some(path), _) => RodScene::read(path)?,
                (None, preset) => RodScene::preset(preset.unwrap_or(Preset::Clean))?,
            };
            let made =
                wish.series(global, |options, meanwhile| series::rods(&scene, options, meanwhile))?;
            let line = |r: &Rod| {
                let (t, [x, y]) = (&r.truth.truth, r.truth.truth.axis_center_mm);
                format!(
                    "{}  {} captures  axis ({x:.4}, {y:.4}) mm  rod {:.4} mm\n",
                    r.captures, r.count, t.diameter_mm
                )
            };
            Ok(document("rod", made.iter().map(line).collect(), made))
        }
    }
}

fn document(kind: &str, table: String, results: Vec<impl Serialize>) -> Outcome {
    let rows = rows(&results);
    let json = result(&format!("render-{kind}"), json!({ "kind": kind }), &[], &Output { results });
    Outcome::good(Document { json, rows, table })
}

impl Wish {
    /// What `make` writes of it, told to the user as it goes.
    fn series<R>(
        &self,
        global: &Global,
        make: impl FnOnce(series::Options, Meanwhile) -> Result<R>,
    ) -> Result<R> {
        let options = series::Options {
            folder: &self.out_dir,
            seed: self.seed,
            count: self.count,
            binning: self.binning,
        };
        let makes = |names: &[String]| global.makes("--out-dir", &self.out_dir, names);
        make(options, Meanwhile { makes: &makes, say: &|line| global.say(line) })
    }
}
