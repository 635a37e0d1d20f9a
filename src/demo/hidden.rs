//! The demo's second story: a machine with an effect that its model lacks is photographed and measured; the diagnosis names
//! the effect, corrects the model, and shows the gap shrink.

use std::fmt::Write as _;
use std::path::Path;

use rand::RngExt;
use serde::Serialize;

use super::Options;
use super::machine::VirtualMachine;
use crate::camera::Calibration;
use crate::diagnose::data::rod::{COLUMNS, RodExperiment};
use crate::diagnose::experiment::Experiment;
use crate::diagnose::model::with_effects;
use crate::diagnose::page;
use crate::diagnose::report::{Gap, Report, Verdict};
use crate::diagnose::run::diagnose;
use crate::error::Result;
use crate::machine::{Head, Machine, Table};
use crate::measure::rod;
use crate::output::{create_folder, write_whole};
use crate::render::rod::RenderedRod;
use crate::render::stream_rng;
use crate::table;

/// Seconds from one capture to the next.
const PACE_S: f64 = 20.0;
/// The effect counts as found where its size lies within this many times its interval of the truth.
const FOUND_U95: f64 = 1.6;

/// What was hidden, found and corrected.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct HiddenReport {
    /// The seed.
    pub seed: u64,
    /// Captures of the check rod.
    pub captures: usize,
    /// The effect that the model lacks.
    pub hidden: String,
    /// Its true size.
    pub true_width_mm: f64,
    /// What the diagnosis says with the model as it was.
    pub verdict: Verdict,
    /// The effects it names.
    pub named: Vec<String>,
    /// The size it gives the hidden effect.
    pub found_width_mm: Option<f64>,
    /// Half-width of its 95 % interval.
    pub found_width_u95_mm: Option<f64>,
    /// What the diagnosis says with the corrected model.
    pub verdict_corrected: Verdict,
    /// Gap between simulation and pictures: with the model as it was, with the effect added.
    pub gap: Gap,
    /// Gap that is left when the corrected model is diagnosed in its turn.
    pub rms_corrected_mm: f64,
    /// Whether the effect alone was named, with its size, and the corrected model needs no further name.
    pub found: bool,
}

/// Photographs, measures, diagnoses, corrects and diagnoses again.
pub fn run_hidden(options: &Options) -> Result<HiddenReport> {
    let folder = &options.folder;
    create_folder(folder)?;
    let mut dice = stream_rng(options.seed, 78);
    let axis = usize::from(dice.random::<bool>());
    let width_mm = dice.random_range(0.008..0.016);
    let hidden = ["backlash-x", "backlash-y"][axis];
    let mut rendered = VirtualMachine::new(options.seed).photograph_many()?;
    let directions: Vec<[i8; 2]> = rendered
        .captures
        .iter()
        .map(|_| [(); 2].map(|()| if dice.random() { 1 } else { -1 }))
        .collect();
    for (capture, direction) in rendered.captures.iter_mut().zip(&directions) {
        // The axis lags behind by half the width; the control does not see it.
        capture.machine_mm[axis] += 0.5 * width_mm * f64::from(direction[axis]);
    }
    write_captures(&rendered, &directions, folder)?;

    // From here on only the files are known: pictures, captures table, calibration, model.
    let calibration = Calibration::read(folder.join("calib.toml"))?;
    let captures = rod::read_captures(folder.join("captures.csv"), &mut Vec::new())?;
    let measured = rod::measure(&captures, &calibration, &rod::Options::default())?;
    write_whole(folder.join("points.csv"), rod::points_csv(&captures, &measured).as_bytes())?;
    let machine = Machine::head_b_table_c(Head::default(), Table::default());
    write_whole(folder.join("machine.toml"), machine.to_toml().as_bytes())?;
    let before = diagnosed(folder, &machine, &calibration, "before")?;
    let corrected = with_effects(&machine, &before, &[]);
    write_whole(folder.join("corrected.toml"), corrected.to_toml().as_bytes())?;
    let after = diagnosed(folder, &corrected, &calibration, "after")?;

    let effect = before.effects.iter().find(|e| e.name == hidden);
    let of = |map: &std::collections::BTreeMap<String, f64>| map.get("width_mm").copied();
    let found_width_mm = effect.and_then(|e| of(&e.parameters));
    let found_width_u95_mm = effect.and_then(|e| of(&e.parameters_u95));
    let close = found_width_mm
        .zip(found_width_u95_mm)
        .is_some_and(|(w, u)| (w - width_mm).abs() <= FOUND_U95 * u);
    Ok(HiddenReport {
        seed: options.seed,
        captures: captures.len(),
        hidden: hidden.into(),
        true_width_mm: width_mm,
        verdict: before.verdict,
        named: before.effects.iter().map(|e| e.name.clone()).collect(),
        found_width_mm,
        found_width_u95_mm,
        verdict_corrected: after.verdict,
        rms_corrected_mm: after.gap.after_rms_mm,
        found: close && before.effects.len() == 1 && after.effects.is_empty(),
        gap: before.gap,
    })
}

/// Diagnoses the measured points against a model, and writes the page and the plots into a folder of the demo's.
fn diagnosed(
    folder: &Path,
    machine: &Machine,
    calibration: &Calibration,
    name: &str,
) -> Result<Report> {
    let points = folder.join("points.csv");
    let table = table::Table::read(points, COLUMNS.0, COLUMNS.1)?;
    let experiment =
        RodExperiment::from_table(&table, calibration, Some(machine), &mut Vec::new())?;
    let report = diagnose(&experiment, &crate::diagnose::run::Options::default())?.report;
    let pages = folder.join(name);
    create_folder(&pages)?;
    write_whole(pages.join("index.html"), page::html(&experiment, &report).as_bytes())?;
    for variable in experiment.layout().variables.iter().filter(|v| !v.within) {
        let plot = page::figure(&experiment, variable, &report);
        plot.write(&pages, &format!("over-{}", variable.name))?;
    }
    Ok(report)
}

/// Writes the pictures, the table of what the control showed, and the calibration.
fn write_captures(rendered: &RenderedRod, directions: &[[i8; 2]], folder: &Path) -> Result<()> {
    let mut table = String::from("image,x_mm,y_mm,c_deg,t_s,dir_x,dir_y\n");
    for (i, (capture, [dir_x, dir_y])) in rendered.captures.iter().zip(directions).enumerate() {
        let image = format!("rod-{:02}.png", i + 1);
        capture.picture.write_png(folder.join(&image))?;
        let ([x, y], c, t) = (capture.machine_mm, capture.c_deg, PACE_S * i as f64);
        // Writing to a String cannot fail.
        let _ = writeln!(table, "{image},{x:.4},{y:.4},{c},{t},{dir_x},{dir_y}");
    }
    write_whole(folder.join("captures.csv"), table.as_bytes())?;
    write_whole(folder.join("calib.toml"), rendered.camera.calibration.to_toml().as_bytes())
}
