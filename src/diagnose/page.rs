//! The report page: verdict, ranking, and the residuals before and after over each variable.

use crate::diagnose::experiment::{Experiment, Variable};
use crate::diagnose::report::{NamedEffect, Report, Verdict};
use crate::fit::robust::range;
use crate::machine::Entered;
use crate::output::escape;
use crate::plot::{Figure, Panel};
use crate::report::advice::class;
use crate::report::html::{document, table};

/// What the verdict means, for a service engineer.
fn plain(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Consistent => {
            "The machine does what its model says: nothing is missing beyond the noise."
        }
        Verdict::Named => {
            "The model lacks the effects named below; with them it agrees with the measurement."
        }
        Verdict::Partly => {
            "Some of the gap has a name; more remains that the library does not know."
        }
        Verdict::Unknown => {
            "Something is missing that the library does not know. It is described, not named."
        }
    }
}

/// The page.
pub fn html(experiment: &dyn Experiment, r: &Report) -> String {
    let mut body = format!(
        "<header><h1>Diagnosis: {}</h1><p>{} captures, {} values; {} ({})</p></header>\n\
         <p class=\"verdict {}\"><b>{}</b> {}</p>\n",
        r.kind,
        r.captures,
        r.observations,
        escape(&r.noise_text()),
        escape(&r.noise_source),
        class(r.verdict.word()),
        r.verdict.word().to_uppercase(),
        plain(r.verdict),
    );
    if !r.effects.is_empty() {
        body += "<h2>What is missing</h2>\n";
        let head = ["Effect", "What is wrong", "Size", "Share", "Fits as well"];
        body += &table(&head, r.effects.iter().map(named));
    }
    if !r.in_the_control.is_empty() {
        body += "<h2>In the control</h2>\n";
        let row = |e: &Entered| {
            let new = format!("{:.4}", e.new_mm);
            let u95 = e.u95_mm.map_or(String::new(), |u| format!("{u:.4}"));
            vec![e.key.clone(), format!("{:.4}", e.now_mm), new, u95, e.effect.clone()]
        };
        let head = ["Number, mm", "Now", "New", "U (95 %)", "If it is"];
        body += &table(&head, r.in_the_control.iter().map(row));
    }
    body += &list("Without a name", r.unnamed.iter().map(|u| u.text.clone()));
    let g = &r.gap;
    let line = |name: &str, values: [f64; 2]| {
        let [before, after] = values.map(|mm| format!("{:.2}", 1e3 * mm));
        vec![name.to_owned(), before, after]
    };
    let lines = [
        line("fitted captures", [g.before_rms_mm, g.after_rms_mm]),
        line("captures held out", [g.heldout_before_rms_mm, g.heldout_after_rms_mm]),
        line("noise", [g.noise_rms_mm; 2]),
    ];
    body += "<h2>The gap</h2>\n";
    body += &table(&["µm rms", "Before", "After"], lines.into_iter());
    if let Some(next) = &r.next_measurement {
        body += &format!("<h2>Measure next</h2>\n<p>{}</p>\n", escape(&next.text));
        let (places, more) = next.places();
        let mut places = places.into_iter();
        if let Some(head) = places.next() {
            body += &table(&head.iter().map(String::as_str).collect::<Vec<_>>(), places);
        }
        if more > 0 {
            body += &format!("<p>And {more} more: --write-next FILE writes them all.</p>\n");
        }
    }
    let varies = |v: &&Variable| {
        let (low, high) = range(&v.values);
        high > low
    };
    let figure = |v: &Variable| format!("<figure>{}</figure>\n", figure(experiment, v, r).to_svg());
    let figures: String = experiment.layout().variables.iter().filter(varies).map(figure).collect();
    if !figures.is_empty() {
        body += &format!("<h2>Measured less predicted, before and after</h2>\n{figures}");
    }
    body += &list("Not tested", r.untested.iter().map(|(name, why)| format!("{name}: {why}")));
    document("Diagnosis", &body)
}

/// A named effect as a row.
fn named(e: &NamedEffect) -> Vec<String> {
    let size = |(k, v): (&String, &f64)| match e.parameters_u95.get(k) {
        Some(u) => format!("{k} = {v:.6} ± {u:.6}"),
        None => format!("{k} = {v}"),
    };
    let sizes: Vec<String> = e.parameters.iter().map(size).collect();
    let rivals = if e.confusable_with.is_empty() { "none".into() } else { e.class() };
    let share = format!("{:.0} %", e.share_percent);
    vec![e.name.clone(), e.meaning.clone(), sizes.join(", "), share, rivals]
}

/// A list under a heading, if there is anything in it.
fn list(heading: &str, items: impl Iterator<Item = String>) -> String {
    let items: String = items.map(|text| format!("<li>{}</li>\n", escape(&text))).collect();
    match items.is_empty() {
        true => items,
        false => format!("<h2>{heading}</h2>\n<ul>\n{items}</ul>\n"),
    }
}

/// One panel per output: means over the variable's ranges, before and after.
pub fn figure(experiment: &dyn Experiment, variable: &Variable, r: &Report) -> Figure {
    let layout = experiment.layout();
    let mut figure = Figure::new(format!("over {}", variable.name)).columns(3);
    for d in layout.directions.iter().filter(|d| d.is_distinct()) {
        let before = means(variable, &d.factors, &r.residuals.before_mm);
        let after = means(variable, &d.factors, &r.residuals.after_mm);
        let panel = Panel::new(variable.name, format!("{} (µm)", d.name.replace("_mm", "")))
            .points("before", &before)
            .points("after", &after);
        figure = figure.panel(panel);
    }
    figure
}

/// Mean residual along a direction in up to 40 ranges of a variable, µm.
fn means(variable: &Variable, factors: &[f64], residual_mm: &[f64]) -> Vec<(f64, f64)> {
    const BINS: usize = 40;
    let (low, high) = range(&variable.values);
    let width = (high - low) / BINS as f64;
    let mut sums = vec![(0.0, 0.0, 0.0); BINS];
    for ((x, f), residual) in variable.values.iter().zip(factors).zip(residual_mm) {
        let bin = (((x - low) / width) as usize).min(BINS - 1);
        let weight = f * f;
        sums[bin].0 += weight * x;
        sums[bin].1 += f * residual;
        sums[bin].2 += weight;
    }
    sums.iter().filter(|s| s.2 > 0.0).map(|s| (s.0 / s.2, 1e3 * s.1 / s.2)).collect()
}
