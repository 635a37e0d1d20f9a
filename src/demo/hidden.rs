//! A machine with an effect that its model lacks: its rod is photographed, the pictures measured, the gap diagnosed, the
//! model corrected. The effect is applied here in its own words, not by the diagnosis' library.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use rand::RngExt;
use rand::seq::SliceRandom;
use serde::Serialize;

use crate::demo::VirtualMachine;
use crate::diagnose::data::rod::RodExperiment;
use crate::diagnose::model::with_effects;
use crate::diagnose::page;
use crate::diagnose::report::{Gap, NamedEffect, Unnamed, Verdict};
use crate::diagnose::run::{Options as Wish, diagnose};
use crate::error::Result;
use crate::machine::{Head, Machine, Table};
use crate::measure::rod;
use crate::output::{create_folder, write_whole};
use crate::render::stream_rng;

/// C angles of the pictures: irregular, so that no small harmonic repeats on them.
const C_ANGLES_DEG: [f64; 8] = [0.0, 41.0, 97.0, 139.0, 188.0, 229.0, 283.0, 331.0];

/// What is asked for.
#[derive(Debug, Clone)]
pub struct Options {
    /// Draws the machine, its hidden effect and everything else left to chance.
    pub seed: u64,
    /// Folder for pictures, tables, models and pages; created where it is missing.
    pub folder: PathBuf,
}

/// The whole story.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// The seed.
    pub seed: u64,
    /// Pictures taken.
    pub pictures: usize,
    /// What was hidden.
    pub hidden: Hidden,
    /// What the diagnosis says of the model as it was.
    pub verdict: Verdict,
    /// The effects it names.
    pub effects: Vec<NamedEffect>,
    /// What it leaves without a name.
    pub unnamed: Vec<Unnamed>,
    /// The gap before and after.
    pub gap: Gap,
    /// What the diagnosis says of the corrected model.
    pub corrected_verdict: Verdict,
    /// Whether the hidden effect alone was named, and the corrected model agrees with the pictures.
    pub closed: bool,
}

/// The effect that was hidden.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Hidden {
    /// The library's name for it.
    pub name: &'static str,
    /// Its parameter in the library.
    pub parameter: &'static str,
    /// The parameter's value.
    pub value: f64,
}

impl Hidden {
    fn draw(seed: u64) -> Self {
        let mut rng = stream_rng(seed, 78);
        let (name, parameter, low, high) = [
            ("backlash-x", "width_mm", 0.006, 0.012),
            ("backlash-y", "width_mm", 0.006, 0.012),
            ("scale-x", "um_per_m", 700.0, 1200.0),
            ("scale-y", "um_per_m", 700.0, 1200.0),
            ("squareness-xy", "um_per_m", 700.0, 1200.0),
        ][rng.random_range(0..5usize)];
        Self { name, parameter, value: rng.random_range(low..high) }
    }

    /// Where the control believes to be while the camera stands at `real`, having come from the sides `dir`.
    fn shown(&self, real: [f64; 2], dir: [f64; 2]) -> [f64; 2] {
        let ([x, y], part) = (real, 1e-6 * self.value);
        match self.name {
            "backlash-x" => [x + 0.5 * self.value * dir[0], y],
            "backlash-y" => [x, y + 0.5 * self.value * dir[1]],
            "scale-x" => [x / (1.0 + part), y],
            "scale-y" => [x, y / (1.0 + part)],
            _ => [x + part * y, y],
        }
    }
}

/// Runs the story on the machine and the effect that the seed draws.
pub fn run(options: &Options) -> Result<Report> {
    let folder = &options.folder;
    create_folder(folder)?;
    let hidden = Hidden::draw(options.seed);
    let mut machine = VirtualMachine::new(options.seed);
    // A round rod on the C axis: what is left to find is the hidden effect.
    machine.eccentricity.0 = 0.0;
    machine.rod_form_rms_mm = 0.0;
    let rendered = machine.photograph_rod(&C_ANGLES_DEG)?;
    let mut rng = stream_rng(options.seed, 79);
    let mut turns: Vec<usize> = (0..rendered.captures.len()).collect();
    turns.shuffle(&mut rng);
    let mut side = || if rng.random::<bool>() { 1.0 } else { -1.0 };
    let mut table = String::from("image,x_mm,y_mm,c_deg,t_s,dir_x,dir_y\n");
    for (i, (capture, turn)) in rendered.captures.iter().zip(turns).enumerate() {
        let image = format!("rod-{:02}.png", i + 1);
        capture.picture.write_png(folder.join(&image))?;
        let dir = [side(), side()];
        let [x, y] = hidden.shown(capture.machine_mm, dir);
        let (c, t) = (capture.c_deg, 20 * turn);
        // Writing to a String cannot fail.
        let _ = writeln!(table, "{image},{x:.4},{y:.4},{c},{t},{},{}", dir[0], dir[1]);
    }
    let captures_csv = folder.join("captures.csv");
    write_whole(&captures_csv, table.as_bytes())?;
    let calibration = &rendered.camera.calibration;
    write_whole(folder.join("calibration.toml"), calibration.to_toml().as_bytes())?;

    let captures = rod::read_captures(&captures_csv)?;
    let measured = rod::measure(&captures, calibration, &rod::Options::default())?;
    let points = folder.join("points.csv");
    write_whole(&points, rod::points_csv(&captures, &measured).as_bytes())?;

    let model = Machine::head_b_table_c(Head::default(), Table::default());
    let look = |model: &Machine, page: &str| -> Result<_> {
        let experiment = RodExperiment::read(&points, calibration, Some(model), &mut Vec::new())?;
        let report = diagnose(&experiment, &Wish::default())?.report;
        page::write(folder.join(page), &experiment, &report)?;
        Ok(report)
    };
    let before = look(&model, "before")?;
    let corrected = with_effects(&model, &before);
    write_whole(folder.join("machine-corrected.toml"), corrected.to_toml().as_bytes())?;
    let after = look(&corrected, "after")?;
    let named: BTreeMap<&str, &NamedEffect> =
        before.effects.iter().map(|e| (e.name.as_str(), e)).collect();
    let alone = named.len() == 1 && named.contains_key(hidden.name);
    Ok(Report {
        seed: options.seed,
        pictures: captures.len(),
        closed: alone && after.verdict == Verdict::Consistent,
        hidden,
        verdict: before.verdict,
        effects: before.effects,
        unnamed: before.unnamed,
        gap: before.gap,
        corrected_verdict: after.verdict,
    })
}
