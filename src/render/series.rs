//! A series of pictures of one camera in a folder: their names, truth files and calibration, and what an earlier series left there.

use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;

use super::camera::Camera;
use super::{BurnScene, RodScene, burn, rod};
use crate::error::{Error, Result};
use crate::output::{create_folder, write_whole};

/// The calibration beside the pictures.
const CALIB: &str = "calib.toml";

/// How many pictures, and where they go.
#[derive(Debug, Clone, Copy)]
pub struct Options<'p> {
    /// Created where it is missing.
    pub folder: &'p Path,
    /// Seed of everything that is left to chance; picture N uses `seed + N - 1`.
    pub seed: u64,
    /// How many burns or rods, all seen by one camera.
    pub count: u32,
    /// So many pixels each way are read as one.
    pub binning: u32,
}

/// What the caller does while the pictures are made.
#[derive(Clone, Copy)]
pub struct Meanwhile<'c> {
    /// Told the names of files before they are written; an error ends the series.
    pub makes: &'c dyn Fn(&[String]) -> Result<()>,
    /// Told of each picture, and of what an earlier series left.
    pub say: &'c dyn Fn(&str),
}

/// A rendered burn.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Burn {
    /// The picture.
    pub image: String,
    #[allow(missing_docs)] // As its type says.
    pub truth: Truth<burn::BurnTruth>,
}

/// A rendered rod.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Rod {
    /// The captures table.
    pub captures: String,
    /// How many they are.
    #[serde(skip)]
    pub count: usize,
    #[allow(missing_docs)] // As its type says.
    pub truth: Truth<rod::RodTruth>,
}

/// What the truth file holds.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Truth<T> {
    /// Its own schema.
    pub schema: String,
    /// The file it is the truth of.
    pub of: String,
    /// The calibration beside it.
    pub calib: &'static str,
    #[allow(missing_docs)] // As its type says.
    #[serde(flatten)]
    pub truth: T,
}

/// Renders burns: `burn-0001.png`, `burn-0001.truth.json` and so on, and the camera's `calib.toml`.
///
/// # Errors
/// A scene that cannot be, a folder that cannot be written, or what `meanwhile` refuses.
pub fn burns(scene: &BurnScene, options: Options, meanwhile: Meanwhile) -> Result<Vec<Burn>> {
    // What is wrong with the camera is told in the file's own numbers.
    scene.draw_camera(options.seed)?;
    let mut scene = scene.clone();
    scene.camera = scene.camera.binned(options.binning);
    let camera = scene.draw_camera(options.seed)?;
    let one = |number: u32| {
        let made = burn::render_with(&scene, &camera, options.seed_of(number))?;
        let name = format!("burn-{number:04}");
        let image = format!("{name}.png");
        options.begin("burn", number, [&image, &truth_name(&name)], &camera, meanwhile)?;
        made.picture.write_png(options.folder.join(&image))?;
        let truth = write_truth(options.folder, &name, &image, "burn", made.truth)?;
        (meanwhile.say)(&image);
        Ok(Burn { image, truth })
    };
    (1..=options.count).map(one).collect()
}

/// Renders rods: for each the pictures `rod-0001-01.png` and so on, the captures table `rod-0001.csv` and `rod-0001.truth.json`, and the camera's
/// `calib.toml`.
///
/// # Errors
/// As [`burns`].
pub fn rods(scene: &RodScene, options: Options, meanwhile: Meanwhile) -> Result<Vec<Rod>> {
    // What is wrong with the camera is told in the file's own numbers.
    scene.draw_camera(options.seed)?;
    let mut scene = scene.clone();
    scene.camera = scene.camera.binned(options.binning);
    let camera = scene.draw_camera(options.seed)?;
    let one = |number: u32| {
        let made = rod::render_with(&scene, &camera, options.seed_of(number))?;
        let name = format!("rod-{number:04}");
        let table = format!("{name}.csv");
        options.begin("rod", number, [&table, &truth_name(&name)], &camera, meanwhile)?;
        let captures = made.write(options.folder, &name)?;
        let truth = write_truth(options.folder, &name, &captures, "rod", made.truth)?;
        (meanwhile.say)(&captures);
        Ok(Rod { captures, count: made.captures.len(), truth })
    };
    (1..=options.count).map(one).collect()
}

impl Options<'_> {
    fn seed_of(&self, number: u32) -> u64 {
        self.seed.wrapping_add(u64::from(number) - 1)
    }

    /// Announces the files of a picture, and before the first writes the calibration of all.
    fn begin(
        &self,
        kind: &str,
        number: u32,
        names: [&str; 2],
        camera: &Camera,
        meanwhile: Meanwhile,
    ) -> Result<()> {
        let [first, second] = names.map(str::to_owned);
        (meanwhile.makes)(&[CALIB.to_owned(), first, second])?;
        if number > 1 {
            return Ok(());
        }
        create_folder(self.folder)?;
        let (path, text) = (self.folder.join(CALIB), camera.calibration.to_toml());
        if std::fs::read(&path).is_ok_and(|old| old != text.as_bytes())
            && let Some(left) = self.left_there(kind)
        {
            (meanwhile.say)(&format!("warning: {left}"));
        }
        write_whole(path, text.as_bytes())
    }

    /// What an earlier series has left there and this one does not replace may be another camera's.
    fn left_there(&self, kind: &str) -> Option<String> {
        let number = |name: &str, kind: &str| -> Option<u32> {
            let digits = name.strip_prefix(kind)?.strip_prefix('-')?;
            digits.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
        };
        let is_left = |name: &str| {
            let of = |other: &str| number(name, other);
            ["burn", "rod"].iter().any(|o| of(o).is_some_and(|n| *o != kind || n > self.count))
        };
        let files = std::fs::read_dir(self.folder).into_iter().flatten().flatten();
        let mut left: Vec<String> = files
            .filter_map(|file| file.file_name().into_string().ok())
            .filter(|name| is_left(name))
            .collect();
        left.sort();
        let first = left.first()?;
        Some(format!(
            "{}: {} older files, from {first} on, are of another camera than {CALIB} is now: delete them",
            self.folder.display(),
            left.len()
        ))
    }
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
    let truth = Truth { schema, of: of.into(), calib: CALIB, truth };
    let path = folder.join(truth_name(name));
    let text = serde_json::to_string_pretty(&truth).map_err(|e| {
        Error::file(&path, format!("cannot be written as JSON: {e}"), "report this")
    })?;
    write_whole(path, (text + "\n").as_bytes())?;
    Ok(truth)
}
