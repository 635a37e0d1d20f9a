//! What is to be doubted of an answer: sizes that no machine has, which are more likely the model's or the file's, repeats that are copies, and
//! data that can test nothing.

use std::collections::BTreeMap;

use crate::diagnose::basis::distinct;
use crate::diagnose::experiment::Layout;
use crate::diagnose::fit::Fitter;
use crate::diagnose::parts::{Part, contribution};
use crate::diagnose::report::NamedEffect;
use crate::diagnose::resolution::rounded_to_mm;
use crate::diagnose::select::Selection;
use crate::machine::DataKind;

/// What an effect adds to no machine's outputs, mm.
const MOST_MM: f64 = 5.0;

/// A stated noise that is less than this part of what repeats show is doubted.
const MUCH_LESS: f64 = 0.3;

/// Errors that wander by more than so many times the noise may as well be an effect.
const WANDERS: f64 = 3.0;

/// The greatest of these amounts, mm, if it is more than any machine shows.
pub fn beyond_machines(added: impl IntoIterator<Item = f64>) -> Option<f64> {
    let most = added.into_iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    (most > MOST_MM).then_some(most)
}

/// Captures that were set aside as a whole, in words: by the row at which each begins.
pub fn slipped_captures(captures: &[usize], layout: &Layout) -> Option<String> {
    let first = |capture: &usize| layout.groups.iter().position(|g| g == capture);
    let rows: Vec<String> =
        captures.iter().filter_map(first).map(|row| format!("{}", row + 1)).collect();
    (!rows.is_empty()).then(|| {
        format!(
            "captures that lie apart as a whole are set aside (they begin at row {}): check where the machine stood for them",
            rows.join(", ")
        )
    })
}

/// Numbers of a named effect that these data do not tell by themselves.
pub fn untold(fitter: &Fitter, s: &Selection, named: &NamedEffect) -> Option<String> {
    let effects = fitter.experiment.effects();
    let active =
        s.fitted.model.active.iter().find(|a| effects[a.effect].name == named.name.as_str())?;
    let form = effects[active.effect].forms[active.form].iter().zip(&active.values);
    let untold = form
        .filter(|(p, v)| !p.is_switch() && !p.is_at_limit(**v))
        .map(|(p, _)| p.name.as_ref())
        .filter(|name| !named.parameters_u95.contains_key(*name));
    let names: Vec<&str> = untold.collect();
    (!names.is_empty()).then(|| {
        format!(
            "{}: these data do not tell {} (it shows at no place that was measured, or only together with something else): the value is no measurement",
            named.name,
            names.join(", ")
        )
    })
}

/// What is to be doubted of an answer, in words; `pairs` are the two names that could stand for each of its own.
pub fn of_answer(fitter: &Fitter, s: &Selection, pairs: &[Option<[usize; 2]>]) -> Vec<String> {
    let bar = match fitter.experiment.kind() {
        DataKind::Ballbar => {
            " (for a ball bar R and the stand-off add up to the ball's distance from the B axis)"
        }
        _ => "",
    };
    let check = format!(
        "more than any machine shows: check that --model is the machine measured{bar} and that the columns are in mm and degrees"
    );
    let model = &s.fitted.model;
    let effects = fitter.experiment.effects();
    let mut doubts: Vec<String> = (0..model.active.len())
        .filter_map(|i| {
            let most = beyond_machines(contribution(fitter, model, Part::Effect(i)))?;
            let name = &effects[model.active[i].effect].name;
            Some(format!("{name} adds up to {most:.1} mm, {check}"))
        })
        .collect();
    let within = doubts.is_empty();
    for named in &model.active {
        let info = &effects[named.effect];
        let form = info.forms[named.form].iter().zip(&named.values);
        doubts.extend(form.filter(|(p, v)| p.is_at_limit(**v)).map(|(p, v)| {
            format!(
                "{}: {} = {v:.4} is as far as it is looked for: it may be more (or less), and the effect's size goes with it",
                info.name, p.name
            )
        }));
    }
    doubts.extend(model.active.iter().zip(pairs).filter_map(|(named, pair)| {
        let [one, other] = pair.as_ref()?.map(|e| &effects[e].name);
        let name = &effects[named.effect].name;
        Some(format!(
            "{one} and {other} together explain as much as {name}, with no more parameters"
        ))
    }));
    let layout = fitter.experiment.layout();
    doubts.extend(model.active.iter().filter_map(|named| {
        let info = &effects[named.effect];
        let mut form = info.forms[named.form].iter().zip(&named.values);
        let lag_s = *form.find(|(p, _)| p.name == "lag_s")?.1;
        let gap_s = longest_gap_s(layout)?;
        (gap_s > lag_s).then(|| {
            format!(
                "{}: nothing was read for up to {gap_s:.0} s, longer than its lag: what the temperatures did meanwhile is not known, and lag_s \
                 and the size are less sure than they are stated",
                info.name
            )
        })
    }));
    doubts.extend(copies(layout).map(|count| {
        format!("all {count} repeated captures are the same to the last digit: copies tell nothing of the noise")
    }));
    if let (Some(given), Some(seen)) = (fitter.given_mm, repeated_mm(layout))
        && given < MUCH_LESS * seen
    {
        doubts.push(format!(
            "--noise-mm {given} is far less than repeated captures differ by, {seen:.5} mm: what they differ by is then no noise, and hides effects"
        ));
    }
    doubts.extend(rounded_to_mm(fitter, &s.fitted).map(|step| {
        format!("readings are rounded to {step} mm, more coarsely than they scatter: what is smaller is not told")
    }));
    if fitter.space.serial().is_some() {
        let residual = &s.fitted.residual;
        let rms = (residual.iter().map(|r| r * r).sum::<f64>() / residual.len() as f64).sqrt();
        let noise = s.fitted.noise.sigma_mm[0];
        if rms > WANDERS * noise {
            doubts.push(format!(
                "what the model leaves, {:.2} µm rms, goes on from value to value and is taken for errors that wander: it may be an effect \
                 that no name fits; run the path again, which tells the two apart",
                1e3 * rms
            ));
        }
    }
    if effects.iter().all(|e| e.untestable.is_some()) {
        doubts.push(
            "no effect of the library could be tested: that nothing is found says nothing".into(),
        );
    }
    let gap = s.baseline.residual.iter().enumerate();
    let gap = gap.filter(|(i, _)| fitter.space.kept(*i)).map(|(_, r)| *r);
    if let (true, Some(most)) = (within, beyond_machines(gap)) {
        doubts.push(format!("the data are up to {most:.1} mm off the model, {check}"));
    }
    doubts
}

/// The longest time between captures, s.
fn longest_gap_s(layout: &Layout) -> Option<f64> {
    let times = layout.variables.iter().find(|v| v.name == "t_s")?;
    distinct(&times.values).windows(2).map(|w| w[1] - w[0]).max_by(f64::total_cmp)
}

/// Standard deviation of a value among captures at one site, mm; `None` without such, or where captures see edges of their own.
fn repeated_mm(layout: &Layout) -> Option<f64> {
    if !layout.random.is_empty() {
        return None;
    }
    let mut sites: BTreeMap<usize, Vec<Vec<f64>>> = BTreeMap::new();
    for (site, values) in layout.sites.iter().zip(captures(layout)) {
        sites.entry(*site).or_default().push(values);
    }
    let (mut squares, mut dof) = (0.0, 0.0);
    for alike in sites.values().filter(|s| s.iter().all(|v| v.len() == s[0].len())) {
        for k in 0..alike[0].len() {
            let mean = alike.iter().map(|v| v[k]).sum::<f64>() / alike.len() as f64;
            squares += alike.iter().map(|v| (v[k] - mean).powi(2)).sum::<f64>();
            dof += alike.len() as f64 - 1.0;
        }
    }
    (dof >= 6.0).then(|| (squares / dof).sqrt())
}

/// The values of every capture.
fn captures(layout: &Layout) -> Vec<Vec<f64>> {
    let mut captures = vec![Vec::new(); layout.group_count()];
    layout.groups.iter().zip(&layout.values).for_each(|(g, v)| captures[*g].push(*v));
    captures
}

/// How many captures repeat another, if each of them is that other's copy and they are too many for that to be chance.
fn copies(layout: &Layout) -> Option<usize> {
    const LEAST: usize = 3;
    let captures = captures(layout);
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
