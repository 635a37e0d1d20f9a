//! What to measure next: captures on which the confusable effects would differ most.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::classes::{Rival, stand_ins};
use crate::diagnose::data::pace_s;
use crate::diagnose::experiment::{Experiment, PlannedCapture};
use crate::diagnose::fit::{Fitter, Model};
use crate::diagnose::noise::Space;
use crate::diagnose::parts::{Part, remove};
use crate::diagnose::pool::Who;
use crate::diagnose::report::NextMeasurement;
use crate::diagnose::select::Selection;
use crate::machine::DataKind;

/// Most captures of one and the same place.
const MOST_REPEATS: usize = 4;
/// Captures proposed at most: as many as there are, or this many.
const LEAST_BUDGET: usize = 24;
/// χ² by which a rival must be expected to fit worse: its threshold (9.2) and 2.4 standard deviations more.
const PARTED: f64 = 40.0;
/// Captures that a promise stands on at least, at as many places: one may slip, and the forms here are not the only ones.
const LEAST_CAPTURES: usize = 3;
/// Captures that part no pair by as much as this more than the data do are not worth taking.
const LEAST_PARTED: f64 = 4.0;

/// Captures that part each named effect from its rivals (greedy max-min of the predicted χ², or the best of all together), or, where no
/// capture of this kind can, the measurement that would. `None` where nothing is confusable.
pub fn next_measurement(fitter: &Fitter, selection: &Selection) -> Option<NextMeasurement> {
    let f = &selection.fitted;
    let effects = fitter.experiment.effects();
    let classes = stand_ins(fitter, selection);
    let mut separates: Vec<String> = Vec::new();
    let mut words: Vec<String> = Vec::new();
    let mut add = |effect: usize| {
        let info = &effects[effect];
        if !separates.iter().any(|s| *s == info.name) {
            words.push(format!("{}: {}", info.name, info.best));
            separates.push(info.name.to_string());
        }
    };
    for (active, class) in f.model.active.iter().zip(&classes) {
        if class.iter().any(|r| r.effect != active.effect) {
            add(active.effect);
            class.iter().for_each(|rival| add(rival.effect));
        }
    }
    if separates.is_empty() {
        return None;
    }
    let proposals = fitter.experiment.proposals();
    let rivalries = rivalries(fitter, selection, &classes);
    let singly = pairs(fitter, selection, &rivalries, &proposals);
    let budget = fitter.experiment.layout().group_count().max(LEAST_BUDGET);
    let picked = choose(&singly, proposals.len(), budget);
    let captures = in_order(fitter.experiment, picked, &proposals);
    // What the list is worth depends on its order and times, which the single captures do not know of.
    let pairs = match captures.is_empty() {
        true => Vec::new(),
        false => pairs(fitter, selection, &rivalries, &captures),
    };
    let parted: Vec<f64> = pairs.iter().map(Pair::parted_by_all).collect();
    let useful = pairs.iter().zip(&parted).any(|(p, s)| *s > p.own.separation() + LEAST_PARTED);
    let captures = if useful { captures } else { Vec::new() };
    let best = words.join("; ");
    let resolves = !captures.is_empty() && parted.iter().all(|p| *p >= PARTED);
    let count = captures.len();
    let order = match fitter.experiment.kind() {
        // A path has its own order.
        DataKind::Ballbar => "",
        DataKind::Thermal => ", in their order, while the screw warms up from its coldest",
        _ if captures.iter().any(|c| c.number("temp_c") != captures[0].number("temp_c")) => {
            ", in random order at each temperature"
        }
        _ => ", in random order",
    };
    let comma = if order.is_empty() { "" } else { "," };
    let text = match (count, resolves) {
        (0, _) => format!("no capture of this kind tells them apart; {best}"),
        (_, true) => format!("add the {count} captures listed{order}; {best}"),
        _ => {
            let open = pairs.iter().zip(&parted).filter(|(_, s)| **s < PARTED);
            let mut open: Vec<String> =
                open.map(|(p, _)| p.of.map(|e| effects[e].name.as_ref()).join(" from ")).collect();
            open.sort();
            open.dedup();
            format!(
                "the {count} captures listed{order}{comma} help, but not to tell {}; {best}",
                open.join(", ")
            )
        }
    };
    Some(NextMeasurement { separates, captures, resolves, text })
}

/// The captures in an order that the machine can take them in: a path goes its way, a screw warms up once, and temperatures are not
/// changed more often than they must.
fn in_order(
    experiment: &dyn Experiment,
    mut picked: Vec<usize>,
    proposals: &[PlannedCapture],
) -> Vec<PlannedCapture> {
    if matches!(experiment.kind(), DataKind::Ballbar | DataKind::Thermal) {
        picked.sort_unstable();
    }
    let mut list: Vec<PlannedCapture> = picked.into_iter().map(|p| proposals[p].clone()).collect();
    let temperature =
        |c: &PlannedCapture| c.number("temp_c").or(c.number("screw_c")).unwrap_or(0.0);
    list.sort_by(|a, b| a.by_time(b).then(temperature(a).total_cmp(&temperature(b))));
    let t_s = experiment.layout().variables.iter().find(|v| v.name == "t_s");
    let pace_s = t_s.map_or(0.0, |v| pace_s(&v.values));
    let mut last_s = f64::NEG_INFINITY;
    for capture in &mut list {
        if let Some(t_s) = capture.number("t_s") {
            last_s = t_s.max(last_s + pace_s);
            *capture = capture.clone().with("t_s", last_s);
        }
    }
    list
}

/// What some rows say of a named effect against a rival, in units of the noise: the squares of the difference of their
/// predictions, and what the rival's own parameters can take up of it.
#[derive(Clone)]
struct Evidence {
    squares: f64,
    along: DVector<f64>,
    information: DMatrix<f64>,
}

/// A named effect and a rival: what the data say, and what each proposed capture would.
struct Pair {
    /// Named effect and rival.
    of: [usize; 2],
    own: Evidence,
    proposals: Vec<Evidence>,
}

impl Pair {
    /// χ² by which the rival would fit worse with the data and all of the captures.
    fn parted_by_all(&self) -> f64 {
        self.proposals.iter().fold(self.own.clone(), |sum, p| sum.plus(p)).separation()
    }
}

impl Evidence {
    fn plus(&self, other: &Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            along: &self.along + &other.along,
            information: &self.information + &other.information,
        }
    }

    fn minus(&self, other: &Self) -> Self {
        Self {
            squares: self.squares - other.squares,
            along: &self.along - &other.along,
            information: &self.information - &other.information,
        }
    }

    /// χ² by which the rival would fit worse after it has been refitted.
    fn separation(&self) -> f64 {
        let taken = self.information.clone().cholesky().map(|c| c.solve(&self.along));
        (self.squares - taken.map_or(0.0, |t| t.dot(&self.along))).max(0.0)
    }
}

/// A named effect in each of its forms, and a rival refitted in its place.
struct Rivalry {
    /// Named effect and rival.
    of: [usize; 2],
    forms: Vec<Model>,
    other: Model,
}

fn rivalries(fitter: &Fitter, selection: &Selection, classes: &[Vec<Rival>]) -> Vec<Rivalry> {
    let f = &selection.fitted;
    // Shapes without a name are columns of the data at hand; they are the same on both sides.
    let plain = |model: Model| Model { extras: Vec::new(), ..model };
    let swapped = |i: usize, by: &Rival| -> Option<Model> {
        let Who::Effect(active) = &selection.library.candidates[by.candidate].who else {
            return None;
        };
        let mut swapped = remove(&f.model, Part::Effect(i));
        swapped.active.push(active.clone());
        Some(plain(fitter.fit(swapped, Some(&f.noise)).model))
    };
    let mut list = Vec::new();
    for (i, class) in classes.iter().enumerate() {
        let named = f.model.active[i].effect;
        // The named effect may be there in another form, which the rival must not be able to follow either.
        let (others, rivals): (Vec<&Rival>, Vec<&Rival>) =
            class.iter().partition(|r| r.effect == named);
        if rivals.is_empty() {
            continue;
        }
        let mut forms = vec![plain(f.model.clone())];
        forms.extend(others.iter().filter_map(|form| swapped(i, form)));
        list.extend(rivals.iter().filter_map(|r| {
            let (of, forms) = ([named, r.effect], forms.clone());
            Some(Rivalry { of, forms, other: swapped(i, r)? })
        }));
    }
    list
}

/// What the data and each of some further captures say of each rivalry.
fn pairs(
    fitter: &Fitter,
    selection: &Selection,
    rivalries: &[Rivalry],
    captures: &[PlannedCapture],
) -> Vec<Pair> {
    let experiment = fitter.experiment.with_plan(captures);
    let layout = experiment.layout();
    let space = Space::new(layout, &vec![true; layout.values.len()]);
    let plan = Fitter { experiment: experiment.as_ref(), space, given_mm: fitter.given_mm };
    let before = layout.group_count() - captures.len();
    let noise = selection.fitted.noise.without_rim(&fitter.space);
    let mut list = Vec::new();
    for rivalry in rivalries {
        let predicted = plan.predict(&rivalry.other);
        let mut tangent = plan.whiten(&plan.tangent(&rivalry.other, &predicted), &noise);
        for mut column in tangent.column_iter_mut() {
            let norm = column.norm();
            column /= if norm > 0.0 { norm } else { 1.0 };
        }
        for form in rivalry.forms.iter().map(|form| plan.predict(form)) {
            let d = DMatrix::from_fn(form.len(), 1, |r, _| form[r] - predicted[r]);
            let d = plan.whiten(&d, &noise);
            let evidence = |rows: Vec<usize>| {
                let (j, d) = (tangent.select_rows(&rows), d.select_rows(&rows));
                Evidence {
                    squares: d.norm_squared(),
                    along: j.tr_mul(&d).column(0).into_owned(),
                    information: j.tr_mul(&j),
                }
            };
            let mut own = evidence(plan.space.rows_of(&|g| g < before));
            // Parameters that the data do not determine must not make the system singular.
            (0..own.information.nrows()).for_each(|k| own.information[(k, k)] += 1e-9);
            let of = |k: usize| evidence(plan.space.rows_of(&|g| g == before + k));
            let proposals = (0..captures.len()).map(of).collect();
            list.push(Pair { of: rivalry.of, own, proposals });
        }
    }
    list
}

/// Picks proposals until every pair is parted, always the one that parts the worst pair most.
fn choose(pairs: &[Pair], count: usize, budget: usize) -> Vec<usize> {
    let mut picked = Vec::new();
    let mut state: Vec<Evidence> = pairs.iter().map(|p| p.own.clone()).collect();
    let mut parted: Vec<f64> = state.iter().map(Evidence::separation).collect();
    let mut hopeless = vec![false; pairs.len()];
    let mut taken = vec![0; count];
    while picked.len() < budget {
        let few = (1..LEAST_CAPTURES).contains(&picked.len());
        let open = (0..pairs.len()).filter(|p| (parted[*p] < PARTED || few) && !hopeless[*p]);
        let Some(worst) = open.min_by(|a, b| parted[*a].total_cmp(&parted[*b])) else { break };
        let gain = |k: usize| state[worst].plus(&pairs[worst].proposals[k]).separation();
        let best = (0..count)
            .filter(|k| taken[*k] < if few { 1 } else { MOST_REPEATS })
            .map(|k| (k, gain(k)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match best {
            // A pair that nothing parts must not keep the others from being parted.
            Some((k, separation)) if separation > parted[worst] + 0.1 * PARTED / budget as f64 => {
                taken[k] += 1;
                picked.push(k);
                for (s, p) in state.iter_mut().zip(pairs) {
                    *s = s.plus(&p.proposals[k]);
                }
                parted = state.iter().map(Evidence::separation).collect();
            }
            // A rival of many parameters follows any one capture: several together may part it all the same.
            _ => {
                let room = if parted[worst] < PARTED { budget - picked.len() } else { 0 };
                let together = together(&state[worst], &pairs[worst], room);
                for &k in &together {
                    state.iter_mut().zip(pairs).for_each(|(s, p)| *s = s.plus(&p.proposals[k]));
                }
                parted = state.iter().map(Evidence::separation).collect();
                hopeless[worst] = together.is_empty() || parted[worst] < PARTED;
                picked.extend(together);
            }
        }
    }
    picked
}

/// The captures, `most` of them, that together part a pair which none parts alone: what is left of all when always the one goes that is missed
/// least. None where not even all of them do.
fn together(state: &Evidence, pair: &Pair, most: usize) -> Vec<usize> {
    /// Proposals looked at, evenly spread over all.
    const TRIED: usize = 150;
    if most == 0 {
        return Vec::new();
    }
    let count = pair.proposals.len();
    let mut kept: Vec<usize> = (0..count).step_by(count.div_ceil(TRIED).max(1)).collect();
    let mut all = kept.iter().fold(state.clone(), |sum, k| sum.plus(&pair.proposals[*k]));
    if all.separation() < state.separation() + LEAST_PARTED {
        return Vec::new();
    }
    while !kept.is_empty() {
        let without = |k: &usize| all.minus(&pair.proposals[*k]).separation();
        let left = kept.iter().map(without).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((at, separation)) = left else { break };
        if kept.len() <= most && separation < PARTED {
            break;
        }
        all = all.minus(&pair.proposals[kept.remove(at)]);
    }
    kept
}
