//! What is to be doubted of an answer: sizes that no machine has, which are more likely the model's or the file's, repeats that are copies, and
//! data that can test nothing.

use std::collections::BTreeMap;

use crate::diagnose::experiment::Layout;
use crate::diagnose::fit::Fitter;
use crate::diagnose::parts::{Part, contribution};
use crate::diagnose::select::Selection;

/// What an effect adds to no machine's outputs, mm.
const MOST_MM: f64 = 5.0;

/// The greatest of these amounts, mm, if it is more than any machine shows.
pub fn beyond_machines(added: impl IntoIterator<Item = f64>) -> Option<f64> {
    let most = added.into_iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    (most > MOST_MM).then_some(most)
}

/// What is to be doubted of an answer, in words.
pub fn of_answer(fitter: &Fitter, s: &Selection) -> Vec<String> {
    const CHECK: &str = "more than any machine shows: check that --model is the machine measured and that the columns are in mm and degrees";
    let model = &s.fitted.model;
    let effects = fitter.experiment.effects();
    let mut doubts: Vec<String> = (0..model.active.len())
        .filter_map(|i| {
            let most = beyond_machines(contribution(fitter, model, Part::Effect(i)))?;
            let name = &effects[model.active[i].effect].name;
            Some(format!("{name} adds up to {most:.1} mm, {CHECK}"))
        })
        .collect();
    let within = doubts.is_empty();
    let layout = fitter.experiment.layout();
    doubts.extend(copies(layout).map(|count| {
        format!("all {count} repeated captures are the same to the last digit: copies tell nothing of the noise")
    }));
    if effects.iter().all(|e| e.untestable.is_some()) {
        doubts.push(
            "no effect of the library could be tested: that nothing is found says nothing".into(),
        );
    }
    let gap = s.baseline.residual.iter().enumerate();
    let gap = gap.filter(|(i, _)| fitter.space.kept(*i)).map(|(_, r)| *r);
    if let (true, Some(most)) = (within, beyond_machines(gap)) {
        doubts.push(format!("the data are up to {most:.1} mm off the model, {CHECK}"));
    }
    doubts
}

/// How many captures repeat another, if each of them is that other's copy and they are too many for that to be chance.
fn copies(layout: &Layout) -> Option<usize> {
    const LEAST: usize = 3;
    let mut captures = vec![Vec::new(); layout.group_count()];
    layout.groups.iter().zip(&layout.values).for_each(|(g, v)| captures[*g].push(*v));
    let mut first: BTreeMap<usize, &[f64]> = BTreeMap::new();
    let mut count = 0;
    for (site, values) in layout.sites.iter().zip(&captures) {
        match first.get(site) {
            Some(same) if *same != values.as_slice() => return None,
            Some(_) => count += 1,
            None => drop(first.insert(*site, values)),
        }
    }
    (count >= LEAST).then_some(count)
}
