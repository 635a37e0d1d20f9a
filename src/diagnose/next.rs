//! What to measure next: captures on which the confusable effects would differ most.

use nalgebra::DMatrix;

use crate::diagnose::classes::{Rival, rivals};
use crate::diagnose::experiment::PlannedCapture;
use crate::diagnose::fit::Fitter;
use crate::diagnose::noise::Space;
use crate::diagnose::report::NextMeasurement;
use crate::diagnose::score::{Part, Who};
use crate::diagnose::select::{Selection, remove};

/// Most captures proposed.
const MOST_CAPTURES: usize = 24;
/// Squared distance of two rivals, in units of the noise, at which one of them is ruled out with some to spare.
const PARTED: f64 = 40.0;
/// Captures that part rivals by less than this in all are not worth taking.
const LEAST_PARTED: f64 = 0.5;

/// Captures that part each named effect from its rivals (greedy max-min of the predicted difference), or, where no
/// capture of this kind can, the measurement that would. `None` where nothing is confusable.
pub fn next_measurement(fitter: &Fitter, selection: &Selection) -> Option<NextMeasurement> {
    let f = &selection.fitted;
    let effects = fitter.experiment.effects();
    let classes = rivals(fitter, selection);
    let mut separates: Vec<String> = Vec::new();
    let mut words: Vec<String> = Vec::new();
    let mut add = |effect: usize| {
        let info = &effects[effect];
        if !separates.iter().any(|s| *s == info.name) {
            words.push(format!("{}: {}", info.name, info.best));
            separates.push(info.name.to_string());
        }
    };
    for (active, class) in f.model.active.iter().zip(&classes).filter(|(_, c)| !c.is_empty()) {
        add(active.effect);
        class.iter().for_each(|rival| add(rival.effect));
    }
    if separates.is_empty() {
        return None;
    }
    let proposals = fitter.experiment.proposals();
    let differences = differences(fitter, selection, &classes, &proposals);
    let (picked, parted) = choose(&differences, proposals.len());
    let useful = parted.iter().any(|p| *p > LEAST_PARTED);
    let captures: Vec<PlannedCapture> = if useful {
        picked.into_iter().map(|p| proposals[p].clone()).collect()
    } else {
        Vec::new()
    };
    let best = words.join("; ");
    let text = if captures.is_empty() {
        format!("no capture of this kind tells them apart; {best}")
    } else {
        format!("add the {} captures listed, in random order; {best}", captures.len())
    };
    Some(NextMeasurement { separates, captures, text })
}

/// Squared difference of each pair of rivals at each proposal, in units of the noise (shared parts included).
fn differences(
    fitter: &Fitter,
    selection: &Selection,
    classes: &[Vec<Rival>],
    proposals: &[PlannedCapture],
) -> Vec<Vec<f64>> {
    let f = &selection.fitted;
    let plan = fitter.experiment.with_plan(proposals);
    let layout = plan.layout();
    let space = Space::new(layout, &vec![true; layout.values.len()]);
    let before = layout.group_count() - proposals.len();
    let named = plan.predict(&f.model.nuisances, &f.model.active);
    let mut list = Vec::new();
    for (i, class) in classes.iter().enumerate() {
        for rival in class {
            let Who::Effect(active) = &selection.library.candidates[rival.candidate].who else {
                continue;
            };
            let mut swapped = remove(&f.model, Part::Effect(i));
            swapped.active.push(active.clone());
            let swapped = fitter.fit(swapped, Some(&f.noise)).model;
            let other = plan.predict(&swapped.nuisances, &swapped.active);
            let d = DMatrix::from_fn(named.len(), 1, |r, _| named[r] - other[r]);
            let white = space.whiten(&space.split(&d), &f.noise);
            let of = |capture: usize| -> f64 {
                let rows = space.rows_of(&|g| g == before + capture);
                rows.into_iter().map(|r| white[(r, 0)].powi(2)).sum()
            };
            list.push((0..proposals.len()).map(of).collect());
        }
    }
    list
}

/// Picks proposals until every pair is parted, always the one that parts the worst pair most; and how far each is parted.
fn choose(differences: &[Vec<f64>], count: usize) -> (Vec<usize>, Vec<f64>) {
    let mut picked = Vec::new();
    let mut parted = vec![0.0; differences.len()];
    let mut left: Vec<usize> = (0..count).collect();
    while picked.len() < MOST_CAPTURES && !left.is_empty() {
        // A pair that nothing parts must not keep the others from being parted.
        let open = (0..parted.len()).filter(|&p| {
            parted[p] < PARTED && left.iter().any(|&c| differences[p][c] > 0.01 * LEAST_PARTED)
        });
        let Some(worst) = open.min_by(|a, b| parted[*a].total_cmp(&parted[*b])) else { break };
        let d = &differences[worst];
        let Some(at) = (0..left.len()).max_by(|a, b| d[left[*a]].total_cmp(&d[left[*b]])) else {
            break;
        };
        let pick = left.remove(at);
        parted.iter_mut().zip(differences).for_each(|(sum, d)| *sum += d[pick]);
        picked.push(pick);
    }
    (picked, parted)
}
