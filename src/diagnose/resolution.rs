//! Readings that are rounded more coarsely than they scatter: what the model then leaves is rounding, which follows the readings and
//! looks like an effect.

use crate::diagnose::basis::distinct;
use crate::diagnose::experiment::Layout;
use crate::diagnose::fit::{Fitted, Fitter};

/// What rounding to a step may leave, in steps: 0.29 by itself, half of one where a reading lies between two steps. Noise of half a step
/// leaves more, and makes rounding another noise.
const ROUNDING: f64 = 0.55;
/// The finest and the coarsest step that is looked for, as powers of ten of a millimetre.
const POWERS: std::ops::RangeInclusive<i32> = -5..=-1;
/// Fewer values of one kind may be whole numbers of steps by chance.
const FEWEST: usize = 8;

/// The step of the readings, mm, if they are told no better than that and the model leaves no more than their rounding.
pub fn rounded_to_mm(fitter: &Fitter, f: &Fitted) -> Option<f64> {
    let layout = fitter.experiment.layout();
    let mut coarsest = None;
    for (kind, &step) in fitter.steps_mm.iter().enumerate() {
        let own = |i: &usize| layout.classes[*i] == kind && fitter.space.kept(*i);
        let squares: Vec<f64> =
            (0..f.residual.len()).filter(own).map(|i| f.residual[i].powi(2)).collect();
        if squares.len() < FEWEST {
            continue;
        }
        if (squares.iter().sum::<f64>() / squares.len() as f64).sqrt() > ROUNDING * step {
            return None;
        }
        coarsest = Some(step.max(coarsest.unwrap_or(0.0)));
    }
    coarsest
}

/// The part of the noise's variance that rounding is; 0 where it hardly counts.
pub fn rounding_share(fitter: &Fitter, f: &Fitted) -> f64 {
    const COUNTS: f64 = 1e-3;
    let layout = fitter.experiment.layout();
    let of_kind: Vec<f64> = (fitter.steps_mm.iter().zip(&f.noise.sigma_mm))
        .map(|(step, sigma)| (step * step / (12.0 * sigma * sigma)).min(1.0))
        .collect();
    let kept = (0..layout.values.len()).filter(|i| fitter.space.kept(*i));
    let shares: Vec<f64> = kept.map(|i| of_kind[layout.classes[i]]).collect();
    let share = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
    if share > COUNTS { share } else { 0.0 }
}

/// How much wider rounding makes intervals than noise of its size would: captures of one site are rounded alike, and all whose
/// readings are the same where they are hardly ever others.
pub fn widening(fitter: &Fitter, f: &Fitted) -> f64 {
    /// Different readings that are few.
    const FEW: usize = 4;
    if rounded_to_mm(fitter, f).is_none() {
        return 1.0;
    }
    let layout = fitter.experiment.layout();
    let sites = layout.sites.iter().max().map_or(1, |last| last + 1);
    let different = (0..fitter.steps_mm.len()).map(|kind| {
        let own: Vec<f64> = readings(layout, kind).collect();
        if own.is_empty() { 0 } else { distinct(&own).len() }
    });
    let alike = different.max().filter(|most| *most <= FEW).unwrap_or(sites);
    (layout.group_count() as f64 / alike as f64).sqrt()
}

/// The coarsest step of which all values of a class are whole numbers, mm; 0 where there is none.
pub fn steps_mm(layout: &Layout) -> Vec<f64> {
    let kinds = layout.classes.iter().max().map_or(0, |last| last + 1);
    // Edge points are no readings.
    if !layout.random.is_empty() {
        return vec![0.0; kinds];
    }
    let steps = || POWERS.rev().flat_map(|power| [5.0, 2.0, 1.0].map(|n| n * 10f64.powi(power)));
    let of = |kind: usize| -> Option<f64> {
        let whole = |step: &f64| {
            let off = |v: f64| (v / step - (v / step).round()).abs();
            readings(layout, kind).all(|v| off(v) < 1e-4)
        };
        // Zeros are whole numbers of any step.
        let tells = readings(layout, kind).any(|v| v != 0.0);
        tells.then(|| steps().find(whole).unwrap_or(0.0))
    };
    let told: Vec<Option<f64>> = (0..kinds).map(of).collect();
    // What reads zero throughout is read as the others are.
    let others = told.iter().flatten().copied().fold(0.0, f64::max);
    told.into_iter().map(|step| step.unwrap_or(others)).collect()
}

/// The readings of one class.
fn readings(layout: &Layout, kind: usize) -> impl Iterator<Item = f64> {
    let all = layout.values.iter().zip(&layout.classes);
    all.filter(move |(_, class)| **class == kind).map(|(value, _)| *value)
}
