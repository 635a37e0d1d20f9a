//! What should be measured: data as a machine with its effects would show them, in the form of measured ones.

use std::path::PathBuf;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use crate::diagnose::data::rtcp::add_effects;
use crate::diagnose::doubts::beyond_machines;
use crate::diagnose::load::Source;
use crate::error::{Error, Result};
use crate::machine::{DataKind, Machine};
use crate::rtcp::sweep::{DEVIATION, Sweep, predict};

/// What is simulated.
#[derive(Debug, Clone)]
pub struct Options {
    /// The data that say what is commanded, and the machine file with the effects they are to show.
    pub source: Source,
    /// `rtcp`: the machine file whose values the control holds; the model's own where there is none.
    pub now: Option<PathBuf>,
    /// Standard deviation of Gaussian noise, in mm or, of a rod's edge points, px.
    pub noise_mm: f64,
    /// Seed of the noise.
    pub seed: u64,
}

/// A simulated table.
#[derive(Debug, Clone)]
pub struct Simulated {
    /// The kind of data.
    pub kind: String,
    /// The data's columns, in their order; those predicted in their place or at the end.
    pub names: Vec<String>,
    /// Row by row, a text for each name: as it stands in the data, or predicted, with nine decimals.
    pub rows: Vec<Vec<String>>,
    /// What of the model looks wrong.
    pub warnings: Vec<String>,
}

/// Predicts the measured columns of a table.
///
/// # Errors
/// A noise that is no size, files that cannot be read, machine files of different axes.
pub fn simulate(options: &Options) -> Result<Simulated> {
    if !options.noise_mm.is_finite() || options.noise_mm < 0.0 {
        let reason = format!("is {}", options.noise_mm);
        return Err(Error::option("--noise-mm", reason, "give a size in mm, zero or more"));
    }
    match options.source.kind {
        DataKind::Rtcp => rtcp(options),
        _ => other(options),
    }
}

/// A predicted value, in mm or px, with more decimals than anything measures.
fn decimals(value: f64) -> String {
    format!("{value:.9}")
}

/// Gaussian noise in the order of the predicted values.
fn noise(options: &Options) -> impl FnMut() -> f64 {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
    let size = options.noise_mm;
    move || {
        if size == 0.0 {
            return 0.0;
        }
        let z: f64 = StandardNormal.sample(&mut rng);
        size * z
    }
}

/// Kinds whose whole prediction comes from the effects library.
fn other(options: &Options) -> Result<Simulated> {
    let mut warnings = Vec::new();
    let experiment = options.source.load(&mut warnings)?;
    let start: Vec<f64> = experiment.nuisances().iter().map(|p| p.start).collect();
    let mut predicted = experiment.predict(&start, &[]);
    let mut noise = noise(options);
    predicted.iter_mut().for_each(|p| *p += noise());
    let columns = experiment.predicted_columns(&predicted);
    let table = options.source.table(&mut Vec::new())?;
    let mut names = table.names().to_vec();
    let new = columns.iter().map(|(name, _)| (*name).to_owned());
    names.extend(new.filter(|name| !table.has(name)));
    let cell = |row: usize, name: &String| match columns.iter().rfind(|(n, _)| n == name) {
        Some((_, values)) => decimals(values[row]),
        None => table.text(row, name).to_owned(),
    };
    let rows = (0..table.rows()).map(|row| names.iter().map(|name| cell(row, name)).collect());
    let rows = rows.collect();
    Ok(Simulated { kind: experiment.kind().name().into(), names, rows, warnings })
}

/// A sweep: the control's values and the machine's, of any order of axes, and the library's effects on top.
fn rtcp(options: &Options) -> Result<Simulated> {
    let source = &options.source;
    let path = source.model.as_ref().ok_or_else(|| {
        Error::option("--model", "is missing", "give the machine file the data are predicted from")
    })?;
    let model = Machine::read(path)?;
    let real = model.chain()?;
    let control = match &options.now {
        Some(path) => Machine::read(path)?.chain()?,
        None => real.clone(),
    };
    real.same_rotary(&control, "--now")?;
    let sweep = Sweep::read(&source.data, &real)?;
    let mut d = predict(&control, &real, &model.target_point(), &sweep.rotary_rad);
    let mut warnings = Vec::new();
    if model.effects.is_empty() {
        warnings.extend(model.doubts());
    } else {
        let experiment = source.load(&mut warnings)?;
        let mut added = vec![Vector3::zeros(); d.len()];
        add_effects(experiment.as_ref(), &mut added);
        if let Some(most) = beyond_machines(added.iter().map(Vector3::norm)) {
            warnings.push(format!(
                "the model's effects add up to {most:.1} mm, more than any machine shows: check their parameters' units"
            ));
        }
        d.iter_mut().zip(added).for_each(|(d, added)| *d += added);
    }
    let mut noise = noise(options);
    d.iter_mut().for_each(|d| d.iter_mut().for_each(|v| *v += noise()));

    let kept = sweep.conditions();
    let rows = d.iter().enumerate().map(|(row, d)| {
        let text = kept.iter().map(|name| sweep.table.text(row, name).to_owned());
        text.chain(d.iter().copied().map(decimals)).collect()
    });
    let rows = rows.collect();
    let names = kept.into_iter().chain(DEVIATION.map(str::to_owned)).collect();
    Ok(Simulated { kind: DataKind::Rtcp.name().into(), names, rows, warnings })
}
