//! A diagnosis of files: what was found, what of it the control can hold, and the model it makes.

use crate::diagnose::experiment::Experiment;
use crate::diagnose::load::Source;
use crate::diagnose::plan::detectable;
use crate::diagnose::report::{Detectable, Report};
use crate::diagnose::{model, own, run};
use crate::error::{Error, Result};
use crate::machine::{Entered, Machine, entered, is_entered, is_told};

/// What is asked of a diagnosis.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options {
    /// Standard deviation of one value, mm; from repeats and the data where it is not known.
    pub noise_mm: Option<f64>,
    /// Whether the model that results is to be written.
    pub with_model: bool,
}

/// What was found in the files.
#[derive(Debug, Clone)]
pub struct Diagnosed {
    /// The report, with what the control can hold where a model file is given.
    pub report: Report,
    /// The model with what was found added, where it is to be written.
    pub model: Option<Machine>,
    /// What is doubtful, untested, or neither in the control nor in the model.
    pub warnings: Vec<String>,
}

/// Diagnoses the experiment that `source` gave.
///
/// # Errors
/// As [`run::diagnose`], with the data file's name; a model or effects file that cannot be read.
pub fn diagnose(
    source: &Source,
    experiment: &dyn Experiment,
    options: Options,
) -> Result<Diagnosed> {
    let asked = run::Options { noise_mm: options.noise_mm };
    let found = run::diagnose(experiment, &asked).map_err(|e| of_data(source, e))?;
    let mut report = found.report;
    let mut warnings = report.doubts.clone();
    for (name, why) in &report.untested {
        warnings.push(format!("{name} could not be tested: {why}"));
    }
    let told = source.model.is_some();
    let mut model = None;
    if told && !report.effects.is_empty() || options.with_model {
        let own = source.effects.as_ref().map(|path| own::read(path, experiment.kind().name()));
        let own = own.transpose()?.unwrap_or_default();
        let machine = model::with_effects(&source.machine()?, &report, &own);
        if told {
            enter(&machine, &mut report, &mut warnings);
        }
        if options.with_model {
            warnings.extend(model::left_out(&report));
            model = Some(machine);
        }
    }
    Ok(Diagnosed { report, model, warnings })
}

/// What a plan can show, where one value scatters by `noise_mm`.
///
/// # Errors
/// As [`detectable`], with the data file's name.
pub fn plan(
    source: &Source,
    experiment: &dyn Experiment,
    noise_mm: f64,
) -> Result<Vec<Detectable>> {
    detectable(experiment, noise_mm).map_err(|e| of_data(source, e))
}

/// Says which numbers of the control the effects found correct, and which they are too uncertain for.
fn enter(machine: &Machine, report: &mut Report, warnings: &mut Vec<String>) {
    let found = |name: &str| report.effects.iter().any(|n| n.name == name);
    let named = |e: &Entered| found(&e.effect);
    let numbers = entered(machine).1.into_iter().filter(named).collect();
    let untold = machine.effects.iter().filter(|e| found(&e.name) && is_entered(e) && !is_told(e));
    warnings.extend(untold.map(|e| {
        format!(
            "{} is less than its own uncertainty: nothing to enter into the control yet; more readings tell its size",
            e.name
        )
    }));
    report.in_the_control = numbers;
}

/// An error of what the data show with the data file's name; one of an option as it is.
fn of_data(source: &Source, error: Error) -> Error {
    match error {
        Error::Measure { .. } => error.in_file(&source.data, None),
        of_an_option => of_an_option,
    }
}
