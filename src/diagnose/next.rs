//! What to measure next: captures on which the confusable effects would differ most.

use crate::diagnose::classes::rivals;
use crate::diagnose::experiment::PlannedCapture;
use crate::diagnose::fit::Fitter;
use crate::diagnose::report::NextMeasurement;
use crate::diagnose::score::{Part, Who};
use crate::diagnose::select::{Selection, remove};

/// Captures proposed.
const CAPTURES: usize = 8;
/// A capture that parts two rivals by less than this many standard deviations is not worth proposing.
const LEAST_PARTED: f64 = 0.5;

/// Captures that part each named effect from its rivals (greedy max-min of the predicted difference), or, where no
/// capture of this kind can, the measurement that would. `None` where nothing is confusable.
pub fn next_measurement(fitter: &Fitter, selection: &Selection) -> Option<NextMeasurement> {
    let f = &selection.fitted;
    let effects = fitter.experiment.effects();
    let classes = rivals(fitter, selection);
    let mut separates: Vec<String> = Vec::new();
    let mut words: Vec<String> = Vec::new();
    let mut differences: Vec<Vec<f64>> = Vec::new();
    let proposals = fitter.experiment.proposals();
    let plan = fitter.experiment.with_plan(&proposals);
    let per_capture = |values: &[f64]| -> Vec<f64> {
        let k = values.len() / proposals.len().max(1);
        values.chunks(k.max(1)).map(|c| c.iter().map(|v| v * v).sum::<f64>()).collect()
    };
    for (i, class) in classes.iter().enumerate() {
        for rival in class {
            let name = effects[f.model.active[i].effect].name.to_string();
            let other = effects[rival.effect].name.to_string();
            for (name, best) in [
                (name, &effects[f.model.active[i].effect].best),
                (other, &effects[rival.effect].best),
            ] {
                if !separates.contains(&name) {
                    words.push(format!("{name}: {best}"));
                    separates.push(name);
                }
            }
            let (Some(plan), Who::Effect(active)) =
                (&plan, &selection.library.candidates[rival.candidate].who)
            else {
                continue;
            };
            let mut swapped = remove(&f.model, Part::Effect(i));
            swapped.active.push(active.clone());
            let swapped = fitter.fit(swapped, Some(&f.noise));
            let a = plan.predict(&f.model.nuisances, &f.model.active);
            let b = plan.predict(&swapped.model.nuisances, &swapped.model.active);
            let sigma = f.noise.sigma_mm[0];
            let d: Vec<f64> = a.iter().zip(&b).map(|(a, b)| (a - b) / sigma).collect();
            differences.push(per_capture(&d));
        }
    }
    if separates.is_empty() {
        return None;
    }
    let mut captures: Vec<PlannedCapture> = Vec::new();
    let mut parted: Vec<f64> = vec![0.0; differences.len()];
    let mut left: Vec<usize> = (0..proposals.len()).collect();
    while captures.len() < CAPTURES && !left.is_empty() && !differences.is_empty() {
        let worst = (0..parted.len()).min_by(|a, b| parted[*a].total_cmp(&parted[*b]))?;
        let at = (0..left.len())
            .max_by(|a, b| differences[worst][left[*a]].total_cmp(&differences[worst][left[*b]]))?;
        let pick = left.remove(at);
        for (sum, d) in parted.iter_mut().zip(&differences) {
            *sum += d[pick];
        }
        captures.push(proposals[pick].clone());
    }
    let useful = parted.iter().any(|p| *p > LEAST_PARTED);
    if !differences.is_empty() && !useful {
        captures.clear();
    }
    if differences.is_empty() {
        captures = proposals.into_iter().take(CAPTURES).collect();
    }
    let text = if captures.is_empty() {
        format!("no capture of this kind tells them apart; {}", words.join("; "))
    } else {
        format!(
            "take the {} captures listed, in random order; {}",
            captures.len(),
            words.join("; ")
        )
    };
    Some(NextMeasurement { separates, captures, text })
}
