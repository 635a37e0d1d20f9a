//! Scoring of answers against sealed truths.

use std::collections::BTreeMap;

use pivotsight::diagnose::report::{NamedEffect, Report, Verdict};
use pivotsight::diagnose::run::{Options, diagnose};
use rand::RngExt;

use crate::Case;
use crate::sealed::Truth;

/// A sort of case.
pub struct Sort {
    /// Name in the table.
    pub name: &'static str,
    /// Named effects hidden.
    pub known: usize,
    /// 0 none, 1 within the generic shapes, 2 outside every dictionary.
    pub unknown: u8,
    /// Size in standard errors.
    pub z: f64,
    /// Immediate repeats among the captures.
    pub repeats: usize,
    /// A poor design (one C angle, monotonic order).
    pub poor: bool,
    /// How many times larger the first of them is.
    pub first: f64,
}

const fn sort(name: &'static str, known: usize, unknown: u8, z: f64, repeats: usize) -> Sort {
    Sort { name, known, unknown, z, repeats, poor: false, first: 1.0 }
}

impl Sort {
    /// Size in standard errors of the `nth` of `all` that are hidden.
    pub fn size(&self, nth: usize, all: usize, rng: &mut impl RngExt) -> f64 {
        let larger = if nth == 0 { self.first } else { 1.0 };
        larger * if all > 1 { self.z * rng.random_range(1.0..2.5) } else { self.z }
    }
}

/// All sorts.
pub const SORTS: &[Sort] = &[
    sort("nothing", 0, 0, 0.0, 0),
    sort("one z5", 1, 0, 5.0, 0),
    sort("one z10", 1, 0, 10.0, 0),
    sort("one z20", 1, 0, 20.0, 0),
    sort("one z40", 1, 0, 40.0, 0),
    sort("two z10-40", 2, 0, 10.0, 0),
    sort("three z15-40", 3, 0, 15.0, 0),
    sort("unknown z10", 0, 1, 10.0, 0),
    sort("unknown z20", 0, 1, 20.0, 0),
    sort("outside z20 repeats", 0, 2, 20.0, 20),
    sort("known+unknown z15", 1, 1, 15.0, 20),
    Sort { poor: true, ..sort("poor z15", 1, 0, 15.0, 0) },
    sort("large z300", 1, 0, 300.0, 0),
    Sort { first: 20.0, ..sort("large and small", 2, 0, 15.0, 0) },
];

/// Counts of one sort.
#[derive(Default)]
pub struct Tally {
    cases: usize,
    statement: usize,
    exact: usize,
    in_class: usize,
    class_sizes: Vec<f64>,
    false_names: usize,
    flagged: usize,
    right_variable: usize,
    closed: Vec<f64>,
    asked: [Asked; 2],
    intervals: usize,
    covered: usize,
    classes: BTreeMap<String, usize>,
    verbose: Vec<String>,
}

/// Cases whose answer asked for captures, and those of which one name was left with them.
#[derive(Default)]
struct Asked {
    cases: usize,
    resolved: usize,
}

/// The answer to a case; then, where it asked for captures, how many, and the answer with those.
pub struct Answer {
    report: Report,
    again: Option<(usize, Report)>,
}

/// Runs the diagnosis on a case's data alone, and takes the captures that the answer asks for.
pub fn answer(case: &mut Case, kind: &str) -> Answer {
    let report = diagnosed(&case.csv, case.noise_mm, kind);
    let next = report.next_measurement.as_ref().filter(|n| !n.captures.is_empty());
    let again = next.map(|next| {
        let all = case.csv.clone() + &(case.more)(&next.captures);
        (next.captures.len(), diagnosed(&all, case.noise_mm, kind))
    });
    Answer { report, again }
}

fn diagnosed(csv: &str, noise_mm: Option<f64>, kind: &str) -> Report {
    let options = Options { noise_mm };
    let experiment = match kind {
        "rtcp" => crate::rtcp::read(csv),
        "rod" | "rod100" => crate::rod::read(csv),
        _ => crate::plain::read(kind, csv),
    };
    diagnose(experiment.as_ref(), &options).expect("the diagnosis runs").report
}

impl Tally {
    /// Scores an answer.
    pub fn add(&mut self, sort: &Sort, truth: &Truth, answer: &Answer) {
        let report = &answer.report;
        self.count_loop(truth, answer);
        self.count_intervals(truth, report);
        self.cases += 1;
        let names: Vec<&str> = report.effects.iter().map(|e| e.name.as_str()).collect();
        let classes: Vec<Vec<&str>> = report
            .effects
            .iter()
            .map(|e| {
                let rivals = e.confusable_with.iter().map(String::as_str);
                std::iter::once(e.name.as_str()).chain(rivals).collect()
            })
            .collect();
        self.statement += usize::from(report.verdict != Verdict::Consistent);
        let all_in = truth.names.iter().all(|t| classes.iter().any(|c| c.contains(&t.as_str())));
        let false_name =
            classes.iter().any(|c| !truth.names.iter().any(|t| c.contains(&t.as_str())));
        let same = names.len() == truth.names.len()
            && truth.names.iter().all(|t| names.contains(&t.as_str()));
        self.exact += usize::from(same && (truth.unknown.is_some() || report.unnamed.is_empty()));
        self.in_class += usize::from(all_in);
        self.false_names += usize::from(false_name);
        for class in classes.iter().filter(|c| c.len() > 1) {
            let mut members = class.clone();
            members.sort_unstable();
            *self.classes.entry(members.join("|")).or_default() += 1;
        }
        self.class_sizes.extend(classes.iter().map(|c| c.len() as f64));
        self.flagged += usize::from(matches!(report.verdict, Verdict::Unknown | Verdict::Partly));
        if let Some(variable) = &truth.unknown {
            self.right_variable +=
                usize::from(report.unnamed.iter().any(|u| u.versus.contains(variable.as_str())));
        }
        let g = &report.gap;
        let noise2 = g.noise_rms_mm.powi(2);
        let before = g.heldout_before_rms_mm.powi(2) - noise2;
        if before > 0.0 {
            self.closed.push(1.0 - (g.heldout_after_rms_mm.powi(2) - noise2).max(0.0) / before);
        }
        let wrong = if sort.unknown > 0 {
            false_name || !all_in || report.verdict == Verdict::Consistent
        } else {
            !all_in
                || false_name
                || (sort.known > 0 && !same)
                || (sort.known == 0 && report.verdict != Verdict::Consistent)
        };
        if wrong {
            let bent = |e: &NamedEffect| match e.form_corrected_over.join(",") {
                over if over.is_empty() => String::new(),
                over => format!(" bent over {over}"),
            };
            let found: Vec<String> =
                classes.iter().zip(&report.effects).map(|(c, e)| c.join("|") + &bent(e)).collect();
            let unnamed: Vec<String> = report
                .unnamed
                .iter()
                .map(|u| format!("{}/{}/{}", u.output, u.versus, u.shape))
                .collect();
            self.verbose
                .push(format!("    {truth:?} -> {found:?} {unnamed:?} {}", report.verdict.word()));
        }
    }

    /// Whether the stated intervals of the sizes contain the truth, where a name and its form are right.
    fn count_intervals(&mut self, truth: &Truth, report: &Report) {
        for size in &truth.sizes {
            let same =
                |e: &&NamedEffect| e.name == size.name && !e.parameters.contains_key("datum");
            let Some(e) = report.effects.iter().find(same) else { continue };
            let key = &size.parameter;
            let (Some(value), Some(u95)) = (e.parameters.get(key), e.parameters_u95.get(key))
            else {
                continue;
            };
            let holds = (value.abs() - size.value.abs()).abs() <= *u95;
            self.intervals += 1;
            self.covered += usize::from(holds);
            if !holds {
                let missed = format!("{key} = {value:.6} ± {u95:.6}, not {:.6}", size.value);
                self.verbose
                    .push(format!("    interval: {} of {:?}: {missed}", e.name, truth.names));
            }
        }
    }

    /// Whether one name is left once the captures that the answer asks for have been taken.
    fn count_loop(&mut self, truth: &Truth, answer: &Answer) {
        let Some((captures, again)) = &answer.again else { return };
        let names: Vec<&str> = again.effects.iter().map(|e| e.name.as_str()).collect();
        let alone = again.effects.iter().all(|e| e.confusable_with.is_empty());
        let right = names.len() == truth.names.len()
            && truth.names.iter().all(|t| names.contains(&t.as_str()));
        let promised = answer.report.next_measurement.as_ref().is_some_and(|n| n.resolves);
        let asked = &mut self.asked[usize::from(promised)];
        asked.cases += 1;
        asked.resolved += usize::from(alone && right);
        if !(alone && right) {
            let found: Vec<String> = again
                .effects
                .iter()
                .map(|e| format!("{}|{}", e.name, e.confusable_with.join("|")))
                .collect();
            let word = if promised { "promised" } else { "not promised" };
            self.verbose.push(format!(
                "    loop: {truth:?} after {captures} captures ({word}) -> {found:?}"
            ));
        }
    }

    /// Prints one line of rates, then (where BLIND_VERBOSE is set) the wrong answers and the classes.
    pub fn print(&mut self, sort: &Sort, seconds: f64) {
        let n = self.cases;
        let mut parts = Vec::new();
        if sort.known + usize::from(sort.unknown) == 0 {
            parts.push(format!("any statement {}", rate(self.statement, n)));
        }
        if sort.known > 0 {
            parts.push(format!("exact {}", rate(self.exact, n)));
            parts.push(format!("in class {}", rate(self.in_class, n)));
            let mean = self.class_sizes.iter().sum::<f64>() / self.class_sizes.len().max(1) as f64;
            parts.push(format!("class size {mean:.2}"));
        }
        if sort.unknown > 0 {
            parts.push(format!("flagged {}", rate(self.flagged, n)));
            parts.push(format!("right variable {}", rate(self.right_variable, n)));
        }
        parts.push(format!("false names {}", rate(self.false_names, n)));
        if self.intervals > 0 {
            let covered = rate(self.covered, self.intervals);
            parts.push(format!("{} intervals of sizes, with the truth {covered}", self.intervals));
        }
        if sort.known > 0 && sort.unknown == 0 && !self.closed.is_empty() {
            self.closed.sort_by(f64::total_cmp);
            parts.push(format!(
                "held-out excess removed {:.1} %",
                100.0 * self.closed[self.closed.len() / 2]
            ));
        }
        for (asked, word) in self.asked.iter().zip(["may help", "should part their class"]) {
            if sort.known > 0 && asked.cases > 0 {
                parts.push(format!(
                    "{} given captures that {word}, one name left {}",
                    asked.cases,
                    rate(asked.resolved, asked.cases)
                ));
            }
        }
        println!("{:20} {} ({seconds:.3} s a case)", sort.name, parts.join(", "));
        if std::env::var_os("BLIND_VERBOSE").is_some() {
            self.verbose.iter().for_each(|v| println!("{v}"));
            self.classes.iter().for_each(|(class, count)| println!("    class {class}: {count}"));
        }
    }
}

/// A rate in percent with its 95 % Wilson interval.
fn rate(hits: usize, n: usize) -> String {
    let (n, z) = (n.max(1) as f64, 1.96);
    let p = hits as f64 / n;
    let centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    format!(
        "{:.1} % [{:.1}, {:.1}]",
        100.0 * p,
        100.0 * (centre - half).max(0.0),
        100.0 * (centre + half).min(1.0)
    )
}
