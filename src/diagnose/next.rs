//! What to measure next: captures on which the confusable effects would differ most.

use crate::diagnose::classes::{PairInstead, stand_ins};
use crate::diagnose::data::pace_s;
use crate::diagnose::experiment::{Experiment, PlannedCapture};
use crate::diagnose::fit::Fitter;
use crate::diagnose::report::NextMeasurement;
use crate::diagnose::rivalry::{Evidence, Of, Rivalry, Weighed, rivalries, weigh};
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
/// What captures of another set-up are.
const OTHER_PATH: &str = "rows of the sweep listed, on a path of its own over the same cup (the table then needs path, x_mm and z_mm in every row)";
/// What captures of the data's own set-up are.
const CAPTURES: &str = "captures listed";
/// Captures that part no pair by as much as this more than the data do are not worth taking.
const LEAST_PARTED: f64 = 4.0;

/// Captures that part each named effect from its rivals (greedy max-min of the predicted χ², or the best of all together), or, where no
/// capture of this kind can, the measurement that would. `None` where nothing is confusable.
pub fn next_measurement(
    fitter: &Fitter,
    selection: &Selection,
    pairs: &[Option<PairInstead>],
) -> Option<NextMeasurement> {
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
    for ((active, class), pair) in f.model.active.iter().zip(&classes).zip(pairs) {
        let two = pair.iter().flat_map(|pair| pair.effects);
        let others = class.iter().map(|rival| rival.effect).chain(two);
        if others.clone().any(|effect| effect != active.effect) {
            add(active.effect);
            others.for_each(&mut add);
        }
    }
    if separates.is_empty() {
        return None;
    }
    let rivalries = rivalries(fitter, selection, &classes, pairs);
    let list = |captures| List::of(fitter, selection, &rivalries, captures);
    let mut best = list(Vec::new());
    let mut take = |other: List| {
        // What takes more must be worth it.
        if !other.captures.is_empty()
            && (best.captures.is_empty() || other.open.len() < best.open.len())
        {
            best = other;
        }
        best.resolves()
    };
    let proposals = fitter.experiment.proposals();
    let taken =
        |proposals: &Vec<PlannedCapture>| best_proposals(fitter, selection, &rivalries, proposals);
    if !proposals.iter().any(|p| take(list(taken(p)))) {
        take(List { what: OTHER_PATH, ..list(fitter.experiment.other_sweep()) });
    }
    let text =
        format!("{}; each shows best in: {}", best.text(fitter.experiment), words.join("; "));
    let resolves = best.resolves();
    Some(NextMeasurement { separates, captures: best.captures, resolves, text })
}

/// The best of the captures that could be taken as the data were, in the order in which the machine can take them.
fn best_proposals(
    fitter: &Fitter,
    selection: &Selection,
    rivalries: &[Rivalry],
    proposals: &[PlannedCapture],
) -> Vec<PlannedCapture> {
    let singly = weigh(fitter, selection, rivalries, proposals);
    let budget = fitter.experiment.layout().group_count().max(LEAST_BUDGET);
    let picked = choose(&singly, proposals.len(), budget);
    in_order(fitter.experiment, picked, proposals)
}

/// Captures to take next, and what they leave open.
struct List {
    captures: Vec<PlannedCapture>,
    /// Named effects and rivals that they are not expected to part.
    open: Vec<Of>,
    /// What they are, in words.
    what: &'static str,
}

impl List {
    /// With the captures as they stand, in their order and at their times; none where they hardly tell more than the data.
    fn of(
        fitter: &Fitter,
        selection: &Selection,
        rivalries: &[Rivalry],
        mut captures: Vec<PlannedCapture>,
    ) -> Self {
        let mut open: Vec<Of> = rivalries.iter().map(|r| r.of.clone()).collect();
        if !captures.is_empty() {
            let pairs = weigh(fitter, selection, rivalries, &captures);
            let parted: Vec<f64> = pairs.iter().map(Weighed::parted_by_all).collect();
            let all = || pairs.iter().zip(&parted);
            if all().any(|(p, s)| *s > p.own.separation() + LEAST_PARTED) {
                open = all().filter(|(_, s)| **s < PARTED).map(|(p, _)| p.of.clone()).collect();
            } else {
                captures.clear();
            }
        }
        open.sort_unstable();
        open.dedup();
        Self { captures, open, what: CAPTURES }
    }

    fn resolves(&self) -> bool {
        !self.captures.is_empty() && self.open.is_empty()
    }

    /// What to do, in words.
    fn text(&self, experiment: &dyn Experiment) -> String {
        let Self { captures, what, .. } = self;
        let order = match experiment.kind() {
            // A path has its own order.
            DataKind::Ballbar => "",
            DataKind::Thermal => ", in their order, while the screw warms up from its coldest",
            _ if captures.iter().any(|c| c.number("temp_c") != captures[0].number("temp_c")) => {
                ", in random order at each temperature"
            }
            _ => ", in random order",
        };
        match captures.len() {
            0 => "no capture of this kind tells them apart".into(),
            count if self.open.is_empty() => {
                format!("add the {count} {what}{order}")
            }
            count => {
                let name = |effect: usize| experiment.effects()[effect].name.as_ref();
                let rival =
                    |of: &Of| of.1.iter().map(|e| name(*e)).collect::<Vec<_>>().join(" and ");
                let words = |of: &Of| format!("{} from {}", name(of.0), rival(of));
                let mut open: Vec<String> = self.open.iter().map(words).collect();
                open.sort();
                let comma = if order.is_empty() { "" } else { "," };
                format!(
                    "the {count} {what}{order}{comma} help, but not to tell {}",
                    open.join(", ")
                )
            }
        }
    }
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

/// Picks proposals until every pair is parted, always the one that parts the worst pair most.
fn choose(pairs: &[Weighed], count: usize, budget: usize) -> Vec<usize> {
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
fn together(state: &Evidence, pair: &Weighed, most: usize) -> Vec<usize> {
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
