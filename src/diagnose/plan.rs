//! Pre-flight: what a plan can and cannot show, before anything is measured.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::{Active, EffectInfo, Experiment, Parameter, size_columns};
use crate::diagnose::fit::Fitter;
use crate::diagnose::noise::{Noise, Space};
use crate::diagnose::report::Detectable;
use crate::error::{Result, above_zero};

/// A parameter of this many standard errors is found 19 times of 20 at the library's test level.
const SEEN: f64 = 5.4;
/// Signatures this parallel cannot be told apart at ordinary sizes.
const ALIAS: f64 = 0.98;
/// Why an effect is untestable that the baseline's parameters stand for.
const ABSORBED: &str = "the baseline absorbs it on this plan";

/// The least detectable size of each effect's simplest form, and its aliases.
pub fn detectable(experiment: &dyn Experiment, noise_mm: f64) -> Result<Vec<Detectable>> {
    above_zero("--noise-mm", noise_mm, "give a size in mm")?;
    let layout = experiment.layout();
    let space = Space::new(layout, &vec![true; layout.values.len()]);
    let fitter = Fitter::new(experiment, space, Some(noise_mm));
    let base = fitter.baseline();
    let predicted = fitter.predict(&base);
    let tangent = fitter.tangent(&base, &predicted);
    let classes = layout.classes.iter().max().map_or(1, |c| c + 1);
    let noise = Noise {
        sigma_mm: vec![noise_mm; classes],
        // Captures repeat to about half the noise of a point.
        ratios: vec![0.25; layout.random.len()],
        dof: f64::INFINITY,
    };
    let basis = orthonormal(&fitter.whiten(&tangent, &noise), 1e-7);
    let mut list = Vec::new();
    let mut spans: Vec<Option<DMatrix<f64>>> = Vec::new();
    for (effect, info) in experiment.effects().iter().enumerate() {
        let name = info.name.to_string();
        let (untestable, least, span) = if let Some(untestable) = &info.untestable {
            (Some(untestable.why.clone()), BTreeMap::new(), None)
        } else {
            let at = simplest(effect, info);
            let columns = size_columns(experiment, &base.nuisances, &predicted, &at);
            let white = fitter.whiten(&columns, &noise);
            let left = &white - &basis * basis.tr_mul(&white);
            if is_absorbed(&white, &left) {
                (Some(ABSORBED.to_owned()), BTreeMap::new(), None)
            } else {
                let sizes = info.forms[0].iter().filter(|p| p.grid.is_empty());
                let least = sizes
                    .zip(left.column_iter())
                    .map(|(p, seen)| (p.name.to_string(), SEEN / seen.norm().max(1e-300)))
                    .collect();
                (None, least, Some(orthonormal(&left, 1e-4)))
            }
        };
        list.push(Detectable { name, untestable, least, aliases: Vec::new() });
        spans.push(span);
    }
    for (i, a) in spans.iter().enumerate() {
        for (j, b) in spans.iter().enumerate() {
            if let (Some(a), Some(b)) = (a, b)
                && i != j
                && lies_in(a, b)
            {
                let other = list[j].name.clone();
                list[i].aliases.push(other);
            }
        }
    }
    Ok(list)
}

/// An effect in its simplest form, its form parameters in the middle of what is tried.
fn simplest(effect: usize, info: &EffectInfo) -> Active {
    let middle = |p: &Parameter| p.grid.get(p.grid.len() / 2).copied().unwrap_or(0.0);
    Active { effect, form: 0, values: info.forms[0].iter().map(middle).collect() }
}

/// Whether hardly anything is left of columns once the baseline is taken out of them.
fn is_absorbed(whole: &DMatrix<f64>, left: &DMatrix<f64>) -> bool {
    left.column_iter().zip(whole.column_iter()).all(|(l, w)| l.norm() < 3e-3 * w.norm())
}

/// Whether the one basis can do everything that the other can.
fn lies_in(one: &DMatrix<f64>, other: &DMatrix<f64>) -> bool {
    other.tr_mul(one).column_iter().map(|c| c.norm()).fold(1.0, f64::min) > ALIAS
}
