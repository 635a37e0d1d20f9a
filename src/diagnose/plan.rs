//! Pre-flight: what a plan can and cannot show, before anything is measured.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::{Active, Experiment};
use crate::diagnose::fit::Fitter;
use crate::diagnose::noise::{Noise, Space};
use crate::diagnose::report::Detectable;
use crate::error::{Error, Result};

/// A parameter of this many standard errors is found 19 times of 20 at the library's test level.
const SEEN: f64 = 5.4;
/// Signatures this parallel cannot be told apart at ordinary sizes.
const ALIAS: f64 = 0.98;

/// The least detectable size of each effect's simplest form, and its aliases.
pub fn detectable(experiment: &dyn Experiment, noise_mm: f64) -> Result<Vec<Detectable>> {
    if !(noise_mm.is_finite() && noise_mm > 0.0) {
        return Err(Error::option(
            "--noise-mm",
            format!("is {noise_mm}"),
            "give a size above zero",
        ));
    }
    let layout = experiment.layout();
    let fitter = Fitter {
        experiment,
        space: Space::new(layout, &vec![true; layout.values.len()]),
        given_mm: Some(noise_mm),
    };
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
        let empty = |why: String| Detectable {
            name: name.clone(),
            untestable: Some(why),
            least: BTreeMap::new(),
            aliases: Vec::new(),
        };
        if let Some(why) = &info.untestable {
            list.push(empty(why.clone()));
            spans.push(None);
            continue;
        }
        let form = &info.forms[0];
        let values: Vec<f64> =
            form.iter().map(|p| p.grid.get(p.grid.len() / 2).copied().unwrap_or(0.0)).collect();
        let linear: Vec<usize> = (0..form.len()).filter(|i| form[*i].grid.is_empty()).collect();
        let mut columns = DMatrix::zeros(predicted.len(), linear.len());
        for (c, &i) in linear.iter().enumerate() {
            let step = 1e-3 * form[i].typical;
            let mut moved = values.clone();
            moved[i] += step;
            let forward =
                experiment.predict(&base.nuisances, &[Active { effect, form: 0, values: moved }]);
            for (r, (f, p)) in forward.iter().zip(&predicted).enumerate() {
                columns[(r, c)] = (f - p) / step;
            }
        }
        let white = fitter.whiten(&columns, &noise);
        let left = &white - &basis * basis.tr_mul(&white);
        let hidden =
            (0..linear.len()).all(|c| left.column(c).norm() < 3e-3 * white.column(c).norm());
        if hidden {
            list.push(empty("the baseline absorbs it on this plan".into()));
            spans.push(None);
            continue;
        }
        let least = linear
            .iter()
            .enumerate()
            .map(|(c, &i)| (form[i].name.to_string(), SEEN / left.column(c).norm().max(1e-300)))
            .collect();
        list.push(Detectable { name, untestable: None, least, aliases: Vec::new() });
        spans.push(Some(orthonormal(&left, 1e-4)));
    }
    for i in 0..list.len() {
        for j in 0..list.len() {
            let (Some(a), Some(b)) = (&spans[i], &spans[j]) else { continue };
            // Everything that effect i can do, effect j can do too.
            let inside = b.tr_mul(a);
            let least = inside.column_iter().map(|c| c.norm()).fold(1.0, f64::min);
            if i != j && least > ALIAS {
                let other = list[j].name.clone();
                list[i].aliases.push(other);
            }
        }
    }
    Ok(list)
}
