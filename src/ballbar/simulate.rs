//! What a machine with known errors would show on given paths, with noise.

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use schemars::JsonSchema;
use serde::Serialize;

use super::model::{Bar, ERRORS, Errors, Point};
use super::path::{Path, Pose, Range, Setup};
use crate::error::{Error, Result};
use crate::machine::written_deg;

/// The largest error that still counts as a small one, mm and degrees.
const SMALL_MM: f64 = 10.0;
const SMALL_DEG: f64 = 5.7;

/// A point of a path.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Row {
    /// The path's name.
    path: String,
    b_deg: f64,
    x_mm: f64,
    /// Downwards.
    z_mm: f64,
    /// Of the bar.
    length_mm: f64,
}

impl Row {
    /// A pose of a path, and the bar's length there.
    pub fn new(path: &Path, pose: &Pose, length_mm: f64) -> Self {
        // Adding zero turns -0 into 0.
        let (b_deg, z_mm) = (written_deg(pose.b_rad), -pose.up_mm + 0.0);
        Self { path: path.name(), b_deg, x_mm: pose.x_mm, z_mm, length_mm }
    }
}

/// What is simulated.
#[derive(Debug, Clone)]
pub struct Options {
    /// Where bar and cups are.
    pub setup: Setup,
    /// One or more paths.
    pub paths: Vec<Path>,
    /// The part of each that is measured.
    pub range: Range,
    /// The machine's errors.
    pub errors: Errors,
    /// Standard deviation of a length.
    pub noise_mm: f64,
    /// Same seed, same noise.
    pub seed: u64,
}

/// What the bar shows.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Simulated {
    /// The points of every path.
    pub rows: Vec<Row>,
    /// The largest change of length by the errors.
    #[serde(skip)]
    pub largest_mm: f64,
}

/// Lengths on all paths.
pub fn simulate(options: &Options) -> Result<Simulated> {
    let noise = Normal::new(0.0, options.noise_mm)
        .ok()
        .filter(|_| options.noise_mm >= 0.0)
        .ok_or_else(|| Error::option("--noise-mm", "is out of range", "give 0 or more"))?;
    let bar = Bar::new(&options.setup)?;
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
    let mut simulated = Simulated { rows: Vec::new(), largest_mm: 0.0 };
    for (index, path) in options.paths.iter().enumerate() {
        let poses = path.plan(&options.setup, options.range)?;
        let bar_mm = path.bar_mm(&options.setup);
        let lengths = bar.known(&Point::of(path, index, &poses), &options.errors)?;
        for (pose, length) in poses.iter().zip(lengths) {
            simulated.largest_mm = simulated.largest_mm.max((length - bar_mm).abs());
            simulated.rows.push(Row::new(path, pose, length + noise.sample(&mut random)));
        }
    }
    Ok(simulated)
}

/// Reads errors written as `X0B=0.01` (mm) or `B0Z=-0.002` (degrees), each at most once.
pub fn errors(list: &[String]) -> Result<Errors> {
    let (mut errors, mut given) = ([0.0; 6], [false; 6]);
    for text in list {
        let wrong = |reason: String| {
            Error::option("--error", reason, "write for example X0B=0.01,B0Z=-0.002")
        };
        let (name, value) =
            text.split_once('=').ok_or_else(|| wrong(format!("'{text}' has no =")))?;
        let written = name.trim().to_ascii_uppercase().replace('O', "0");
        let index = ERRORS
            .iter()
            .position(|e| e.0 == written)
            .ok_or_else(|| wrong(format!("'{name}' is none of X0B Z0B A0B C0B A0Z B0Z")))?;
        if std::mem::replace(&mut given[index], true) {
            return Err(wrong(format!("{written} is given twice")));
        }
        let value: f64 =
            value.trim().parse().map_err(|_| wrong(format!("'{value}' is no number")))?;
        let is_length = ERRORS[index].1 == "mm";
        let most = if is_length { SMALL_MM } else { SMALL_DEG };
        if value.is_nan() || value.abs() > most {
            return Err(wrong(format!("'{text}' is no small error")));
        }
        errors[index] = if is_length { value } else { value.to_radians() };
    }
    Ok(errors)
}
