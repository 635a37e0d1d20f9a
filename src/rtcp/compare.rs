//! A measured sweep's file against the machine file: read, doubted, predicted, compared.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

use super::sweep::{Size, Sweep, predict};
use super::verify::{self, Report, verify};
use crate::diagnose::data::of_model;
use crate::diagnose::data::rtcp::{RtcpExperiment, add_effects};
use crate::diagnose::own;
use crate::error::{Error, Result, above_zero};
use crate::fit::robust::range;
use crate::machine::{AxisName, DataKind, Machine, written_deg};
use crate::uncertainty::{Contribution, K95, Verdict, budget};
use crate::units;

/// What is compared, and how.
#[derive(Debug, Clone, Copy)]
pub struct Options<'p> {
    /// The machine file, for messages.
    pub machine: &'p Path,
    /// The measured sweep: the rotary axes' angles (`b_deg,c_deg`) and `dx_mm,dy_mm,dz_mm`.
    pub data: &'p Path,
    /// The machine file whose values the control held during the sweep; the machine's own where there is none.
    pub now: Option<&'p Path>,
    /// Largest deviation allowed.
    pub tolerance_mm: f64,
    /// Standard uncertainty of a measured component; `None`: from poses measured again, else what is usual.
    pub noise_mm: Option<f64>,
}

/// A sweep and what the comparison makes of it.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// As read.
    pub sweep: Sweep,
    /// As compared.
    pub report: Report,
    /// How it was compared.
    pub options: verify::Options,
    /// What the sweep cannot show, and what looks wrong.
    pub warnings: Vec<String>,
}

/// A measured sweep against the model.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Compared {
    /// How many poses.
    pub poses: usize,
    /// The measured deviations.
    pub before: Size,
    /// What the model leaves of them.
    pub after: Size,
    /// Where the target really is, seen from where the model has it, in the table frame.
    pub target_offset_mm: [f64; 3],
    /// Which of `before` and `after` the tolerance is held against.
    pub judged: &'static str,
    /// The largest true deviation of those: the middle of what it may be, as the largest that is seen was chosen for its noise, too.
    pub worst_mm: f64,
    /// Half-width of its 95 % interval.
    pub worst_u95_mm: f64,
    /// Standard uncertainty of a measured component.
    pub noise_mm: f64,
    /// Where it is from: `given`, `poses measured again` or `assumed`.
    pub noise_source: &'static str,
    /// Largest deviation allowed.
    pub tolerance_mm: f64,
    /// Of `worst_mm` of what is judged.
    pub verdict: Verdict,
    /// What contributes how much to the uncertainty of a deviation.
    pub budget: Vec<Contribution>,
    /// The plot written.
    pub plot: Option<PathBuf>,
    /// Pose by pose.
    pub rows: Vec<Row>,
}

/// One pose; deviations along X, Y, Z.
#[derive(Debug, Clone, Serialize, JsonSchema)]
#[allow(missing_docs)] // The names say it.
pub struct Row {
    /// The rotary axes, `b_deg` and `c_deg` on a machine with its head about B and its table about C.
    #[serde(flatten)]
    pub rotary_deg: Map<String, Value>,
    /// Without the target's own offset.
    pub measured_mm: [f64; 3],
    pub predicted_mm: [f64; 3],
    pub left_mm: [f64; 3],
}

/// Compares a sweep's file with the machine and its effects.
///
/// # Errors
/// A tolerance or noise that is no length, fewer than four poses, a sweep of zeros alone, machine files of different axes.
pub fn compare(machine: &Machine, files: Options) -> Result<Comparison> {
    above_zero("--tolerance-mm", files.tolerance_mm, "give a length in mm")?;
    if let Some(noise_mm) = files.noise_mm {
        above_zero("--noise-mm", noise_mm, "give the standard uncertainty of a reading in mm")?;
    }
    let real = machine.chain()?;
    let control = match files.now {
        Some(path) => Machine::read(path)?.chain()?,
        None => real.clone(),
    };
    real.same_rotary(&control, "--now")?;
    let mut warnings: Vec<String> = machine.without_target().into_iter().collect();
    warnings.extend(units::limit("--tolerance-mm", files.tolerance_mm));
    let sweep = Sweep::read_measured(files.data, &real, &mut warnings)?;
    let measured = sweep.deviation_mm.clone().unwrap_or_default();
    if measured.len() < 4 {
        let fix = "measure more poses (verify --plan suggests them)";
        return Err(Error::file(files.data, "has fewer than four poses", fix));
    }
    if measured.iter().all(|d| d.norm() == 0.0) {
        let fix = "fill in what was measured";
        return Err(Error::file(files.data, "has zeros alone in dx_mm, dy_mm and dz_mm", fix));
    }
    let options = verify::Options {
        tolerance_mm: files.tolerance_mm,
        noise_mm: files.noise_mm,
        corrected: files.now.is_some(),
    };
    let mut predicted = predict(&control, &real, &machine.target_point(), &sweep.rotary_rad);
    doubts(&sweep, &measured, &mut warnings);
    if !machine.effects.is_empty() {
        add_effects_of(files.machine, machine, &sweep, &mut predicted, &mut warnings)?;
    }
    let report = verify(&real, &sweep.rotary_rad, &measured, predicted, options);
    warnings.extend(report.noise_doubt.clone());
    Ok(Comparison { sweep, report, options, warnings })
}

/// What a sweep cannot show, and units that look wrong.
fn doubts(sweep: &Sweep, measured: &[Vector3<f64>], warnings: &mut Vec<String>) {
    for (k, name) in sweep.axes.map(AxisName::column_deg).into_iter().enumerate() {
        let name = name.as_str();
        let angles: Vec<f64> = sweep.rotary_rad.iter().map(|r| r[k].to_degrees()).collect();
        warnings.extend(units::swept_angles(name, &angles));
        let (low, high) = range(&angles);
        if high - low < 1e-6 {
            warnings.push(format!(
                "{name} is constant: errors of that axis cannot be told from the target's place, or do not show"
            ));
        }
    }
    for (k, name) in ["dx_mm", "dy_mm", "dz_mm"].into_iter().enumerate() {
        let column: Vec<f64> = measured.iter().map(|d| d[k]).collect();
        warnings.extend(units::errors(name, &column));
    }
}

/// Adds what the machine file's effects do in a sweep to what is predicted.
fn add_effects_of(
    path: &Path,
    machine: &Machine,
    sweep: &Sweep,
    predicted: &mut [Vector3<f64>],
    warnings: &mut Vec<String>,
) -> Result<()> {
    let entries = own::of_machine(machine, DataKind::Rtcp.name());
    let mut more = Vec::new();
    let experiment = own::around(machine, path, entries, &mut more, |rest, more| {
        let made = RtcpExperiment::from_table(&sweep.table, rest, more);
        Ok(Box::new(made.map_err(|e| of_model(e, path))?))
    })?;
    more.retain(|w| !warnings.contains(w));
    warnings.extend(more);
    add_effects(experiment.as_ref(), predicted);
    Ok(())
}

impl Comparison {
    /// The result as it is written, with the plot of it where one was drawn.
    pub fn result(&self, plot: Option<PathBuf>) -> Compared {
        let Self { sweep, report, options, .. } = self;
        let list = (0..report.measured.len()).map(|i| Row {
            rotary_deg: (sweep.axes.iter().zip(sweep.rotary_rad[i]))
                .map(|(axis, rad)| (axis.column_deg(), written_deg(rad).into()))
                .collect(),
            measured_mm: report.measured[i].into(),
            predicted_mm: report.predicted[i].into(),
            left_mm: report.rest[i].into(),
        });
        Compared {
            poses: report.measured.len(),
            rows: list.collect(),
            before: report.before,
            after: report.after,
            target_offset_mm: report.target_offset_mm.into(),
            judged: if options.corrected { "after" } else { "before" },
            worst_mm: report.worst_mm,
            worst_u95_mm: report.worst_u95_mm,
            noise_mm: report.noise_mm,
            noise_source: report.noise_source,
            tolerance_mm: options.tolerance_mm,
            verdict: report.verdict,
            budget: budget("worst_mm", [("reading of a deviation", report.worst_u95_mm / K95)]),
            plot,
        }
    }
}
