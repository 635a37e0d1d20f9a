//! Values of an effect's form, such as a screw's pitch, that are looked through finely before the library is scored: those at which
//! what the baseline leaves has a peak stand in the library beside the usual ones.

use nalgebra::DMatrix;

use crate::diagnose::experiment::{Active, Parameter, Scan, size_columns};
use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::pool::Pool;
use crate::diagnose::score::{Score, Standing};

/// Peaks of an effect that are taken on, of what the baseline leaves and of what else is left beside all other names.
const PEAKS: usize = 2;
/// Chance of a peak where nothing is hidden that is worth being taken on.
const WORTH_IT: f64 = 0.02;
/// Two peaks less apart are one.
const ALIKE_TURNS: f64 = 0.05;
/// A run of fewer values than this for each other name's size shows nothing beside them all.
const VALUES_A_SIZE: usize = 3;

/// Values tried about a peak, to either side, as far as the next one that was looked at: beside its pitch a clear wave leaves much.
const FINER: i32 = 8;

/// The effects to try beside those on the grids, in every form that has the parameter.
pub fn found(fitter: &Fitter, baseline: &Fitted, standing: &Standing) -> Vec<Active> {
    let scans = |p: &Parameter| !p.scan.values.is_empty();
    let mut found = Vec::new();
    for (effect, info) in fitter.experiment.effects().iter().enumerate() {
        let form = info.forms.first().filter(|_| info.untestable.is_none());
        let Some(scan) = form.and_then(|f| f.iter().find(|p| scans(p))).map(|p| &p.scan) else {
            continue;
        };
        let with = |form: usize, value: f64| {
            let place = |p: &Parameter| if scans(p) { value } else { 0.0 };
            Active { effect, form, values: info.forms[form].iter().map(place).collect() }
        };
        let pool = |values: &[f64]| {
            let all = values.iter().map(|value| with(0, *value)).collect();
            Pool::of_effects(fitter, &baseline.model.nuisances, all)
        };
        let coarse = pool(&scan.values);
        let beside = beside_all(fitter, baseline, effect);
        let mut taken: Vec<f64> = Vec::new();
        for standing in [Some(standing), beside.as_ref()].into_iter().flatten() {
            // A pool parts its candidates only by what they show in: those of one form stay in their order.
            let scores = |pool: &Pool| standing.scores(fitter, baseline, pool);
            for peak in peaks(scores(&coarse), scan) {
                let about = scan.about(peak, FINER);
                let best =
                    scores(&pool(&about)).into_iter().max_by(|a, b| a.chi2.total_cmp(&b.chi2));
                let value = best.map_or(peak, |s| about[s.candidate]);
                if taken.iter().all(|t| scan.turns_apart(*t, value) > ALIKE_TURNS) {
                    taken.push(value);
                    found.extend((0..info.forms.len()).map(|form| with(form, value)));
                }
            }
        }
    }
    found
}

/// The values at which the scores have their highest peaks.
fn peaks(mut scores: Vec<Score>, scan: &Scan) -> Vec<f64> {
    scores.retain(|s| s.ln_p < WORTH_IT.ln());
    scores.sort_by(|a, b| b.chi2.total_cmp(&a.chi2));
    let mut values: Vec<f64> = Vec::new();
    for value in scores.iter().map(|s| scan.values[s.candidate]) {
        if values.len() < PEAKS && values.iter().all(|v| scan.turns_apart(*v, value) > 1.0) {
            values.push(value);
        }
    }
    values
}

/// What the baseline leaves beside the sizes of all other effects: a larger one of them hides a wave otherwise.
fn beside_all(fitter: &Fitter, baseline: &Fitted, own: usize) -> Option<Standing> {
    let experiment = fitter.experiment;
    let nuisances = &baseline.model.nuisances;
    let base = experiment.predict(nuisances, &[]);
    let mut columns = Vec::new();
    for (effect, info) in experiment.effects().iter().enumerate() {
        if effect == own || info.untestable.is_some() {
            continue;
        }
        let plain = |form: &&Vec<Parameter>| form.iter().all(|p| p.grid.is_empty());
        for (form, parameters) in info.forms.iter().enumerate().filter(|(_, f)| plain(f)) {
            let at = Active { effect, form, values: vec![0.0; parameters.len()] };
            let block = size_columns(experiment, nuisances, &base, &at);
            columns.extend(block.column_iter().map(|c| c.into_owned()));
        }
    }
    let enough = base.len() > VALUES_A_SIZE * columns.len() && !columns.is_empty();
    enough.then(|| Standing::beside(fitter, baseline, &DMatrix::from_columns(&columns)))
}
