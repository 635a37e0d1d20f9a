//! The report page: verdict, ranking, and the residuals before and after over each variable.

use std::fmt::Write as _;

use crate::diagnose::experiment::{Experiment, Variable};
use crate::diagnose::report::{Report, Verdict};
use crate::fit::robust::range;
use crate::output::escape;
use crate::plot::{Figure, Panel};

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
    let mut h = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Diagnosis</title><style>\
         body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}\
         table{border-collapse:collapse;margin:1rem 0}td,th{border-bottom:1px solid #ccc;padding:.3rem .8rem;text-align:left;vertical-align:top}\
         .verdict{font-size:1.4rem;font-weight:600}svg{max-width:100%;height:auto}</style>",
    );
    // Writing to a String cannot fail.
    let _ = write!(
        h,
        "<h1>Diagnosis: {}</h1><p class=\"verdict\">{}</p><p>{}</p><p>{} captures, {} values; noise {:.2} µm ({}).</p>",
        r.kind,
        r.verdict.word(),
        plain(r.verdict),
        r.captures,
        r.observations,
        1e3 * r.noise_mm,
        escape(&r.noise_source)
    );
    if !r.effects.is_empty() {
        h.push_str("<h2>What is missing</h2><table><tr><th>effect</th><th>size</th><th>share</th><th>fits as well</th></tr>");
        for e in &r.effects {
            let sizes: Vec<String> = e
                .parameters
                .iter()
                .map(|(k, v)| match e.parameters_u95.get(k) {
                    Some(u) => format!("{k} = {v:.6} ± {u:.6}"),
                    None => format!("{k} = {v}"),
                })
                .collect();
            let rivals = if e.confusable_with.is_empty() {
                "none".into()
            } else {
                e.confusable_with.join(", ")
            };
            let _ = write!(
                h,
                "<tr><td><b>{}</b><br>{}</td><td>{}</td><td>{:.0} %</td><td>{rivals}</td></tr>",
                e.name,
                escape(&e.meaning),
                sizes.join("<br>"),
                e.share_percent
            );
        }
        h.push_str("</table>");
    }
    if !r.unnamed.is_empty() {
        h.push_str("<h2>Without a name</h2><ul>");
        r.unnamed.iter().for_each(|u| {
            let _ = write!(h, "<li>{}</li>", escape(&u.text));
        });
        h.push_str("</ul>");
    }
    let g = &r.gap;
    let _ = write!(
        h,
        "<h2>The gap</h2><table><tr><th>µm rms</th><th>before</th><th>after</th></tr>\
         <tr><td>fitted captures</td><td>{:.2}</td><td>{:.2}</td></tr><tr><td>captures held out</td><td>{:.2}</td><td>{:.2}</td></tr>\
         <tr><td>noise</td><td colspan=\"2\">{:.2}</td></tr></table>",
        1e3 * g.before_rms_mm,
        1e3 * g.after_rms_mm,
        1e3 * g.heldout_before_rms_mm,
        1e3 * g.heldout_after_rms_mm,
        1e3 * g.noise_rms_mm
    );
    if let Some(next) = &r.next_measurement {
        let _ = write!(h, "<h2>Measure next</h2><p>{}</p>", escape(&next.text));
        let rows = next.places();
        if !next.captures.is_empty() {
            h.push_str("<table>");
            for (row, tag) in rows.iter().zip(std::iter::once("th").chain(std::iter::repeat("td")))
            {
                let cell = |text: &String| format!("<{tag}>{}</{tag}>", escape(text));
                let _ = write!(h, "<tr>{}</tr>", row.iter().map(cell).collect::<String>());
            }
            h.push_str("</table>");
        }
    }
    h.push_str("<h2>Measured less predicted, before and after</h2>");
    for variable in &experiment.layout().variables {
        let (low, high) = range(&variable.values);
        if high > low {
            h.push_str(&figure(experiment, variable, r).to_svg());
        }
    }
    if !r.untested.is_empty() {
        h.push_str("<h2>Not tested</h2><ul>");
        r.untested.iter().for_each(|(name, why)| {
            let _ = write!(h, "<li>{}: {}</li>", escape(name), escape(why));
        });
        h.push_str("</ul>");
    }
    h.push_str("</html>\n");
    h
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
