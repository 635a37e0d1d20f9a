//! Reading the data, one file per kind: columns, captures, and what missing columns make untestable.

pub mod ballbar;
pub mod columns;
pub mod cups;
pub mod other_path;
pub mod plain;
pub mod rod;
pub mod rtcp;
pub mod thermal;

use std::collections::HashMap;

use crate::diagnose::effects::{Library, NAMES};
use crate::diagnose::experiment::{Active, PlannedCapture, Untestable};
use crate::error::{Error, Result, nearest};
use crate::machine::{DataKind, Effect, Machine};

/// Numbers rows that agree in all of `columns` (to a part in a million of each column's range) alike.
pub fn sites(columns: &[&[f64]], rows: usize) -> Vec<usize> {
    let steps: Vec<f64> = columns
        .iter()
        .map(|c| {
            let (low, high) = crate::fit::robust::range(c);
            ((high - low) * 1e-6).max(1e-9)
        })
        .collect();
    let mut known: HashMap<Vec<i64>, usize> = HashMap::new();
    (0..rows)
        .map(|r| {
            let key: Vec<i64> =
                columns.iter().zip(&steps).map(|(c, s)| (c[r] / s).round() as i64).collect();
            let next = known.len();
            *known.entry(key).or_insert(next)
        })
        .collect()
}

/// Whether a column is there and varies; otherwise why an effect that needs it cannot be tested.
pub fn need(present: &[(&str, &[f64])], names: &[&str]) -> Option<Untestable> {
    let column = |name: &&str| present.iter().find(|(n, v)| n == name && !v.is_empty());
    if let Some(name) = names.iter().find(|name| column(name).is_none()) {
        let why = format!("column '{name}' is missing");
        return Some(Untestable { why, predictable: false });
    }
    let still = names.iter().filter_map(column).find(|(_, values)| {
        let (low, high) = crate::fit::robust::range(values);
        high - low <= 1e-9 * (1.0 + high.abs())
    });
    still.map(|(name, _)| Untestable {
        why: format!("column '{name}' never changes"),
        predictable: true,
    })
}

/// Whether a column is there and anything but zero, though it may never change; otherwise why an effect that shows where it is not zero
/// cannot be tested.
pub fn show(present: &[(&str, &[f64])], name: &str) -> Option<Untestable> {
    let zero = |(n, values): &(&str, &[f64])| *n == name && values.iter().all(|v| *v == 0.0);
    need(present, &[name]).filter(|u| !u.predictable || present.iter().any(zero))
}

/// Equal steps over a range.
pub fn evenly(low: f64, high: f64, count: usize) -> Vec<f64> {
    (0..count).map(|k| low + (high - low) * k as f64 / (count - 1).max(1) as f64).collect()
}

/// Time from one capture to the next.
pub fn pace_s(t_s: &[f64]) -> f64 {
    let (low, high) = crate::fit::robust::range(t_s);
    (high - low) / t_s.len() as f64
}

/// Appends the time of a further capture, taken as long after the last as the captures follow each other.
pub fn extend_time(t_s: &mut Vec<f64>) {
    if let Some(last) = t_s.iter().copied().reduce(f64::max) {
        t_s.push(last + pace_s(t_s));
    }
}

/// When further captures of a run may be taken: right after it, and as long after it as it took.
pub fn times_to_come(t_s: &[f64]) -> Vec<f64> {
    let (low, high) = crate::fit::robust::range(t_s);
    let soon = high + pace_s(t_s);
    vec![soon, soon + high - low]
}

/// Appends the times of further captures: those planned, and else right after the run, as a few of them will be taken: nothing is promised
/// that only a longer time would show.
pub fn extend_times(t_s: &mut Vec<f64>, plan: &[PlannedCapture]) {
    if let Some(last) = t_s.iter().copied().reduce(f64::max) {
        let step_s = pace_s(t_s) / plan.len() as f64;
        let soon = |k: usize| last + step_s * (k + 1) as f64;
        let times = plan.iter().enumerate();
        t_s.extend(times.map(|(k, capture)| capture.number("t_s").unwrap_or(soon(k))));
    }
}

/// The same captures when the machine has rested as long as the run took, and two hours at least, as cold and as hot as it has been; none
/// where it was always as warm: what a drift does then is not known.
pub fn after_a_rest(
    captures: &[PlannedCapture],
    t_s: &[f64],
    temp_c: &[f64],
) -> Vec<PlannedCapture> {
    /// Readings of one temperature, K.
    const SAME: f64 = 0.5;
    /// In less a machine hardly cools, s.
    const LEAST_S: f64 = 7200.0;
    let (cold, hot) = crate::fit::robust::range(temp_c);
    if hot - cold < SAME {
        return Vec::new();
    }
    let (start_s, end_s) = crate::fit::robust::range(t_s);
    let later_s = (!t_s.is_empty()).then(|| end_s + (end_s - start_s).max(LEAST_S));
    let at = |capture: &PlannedCapture, temp_c: f64| {
        let capture = capture.clone().with("temp_c", temp_c);
        match later_s {
            Some(t_s) => capture.with("t_s", t_s),
            None => capture,
        }
    };
    [cold, hot]
        .into_iter()
        .flat_map(|c| captures.iter().map(move |capture| at(capture, c)))
        .collect()
}

/// The library's effects are written for B in the head and C in the table; a machine of another order is refused, not
/// predicted wrongly. `any_sense`: B may count the other way.
pub fn need_head_b_table_c(kind: DataKind, machine: &Machine, any_sense: bool) -> Result<()> {
    let rotary = |part: Option<&str>| -> String {
        part.unwrap_or("").chars().filter(|c| "ABC".contains(*c)).collect()
    };
    let mut parts = machine.kinematics.order.split('b');
    let usual = rotary(parts.next()) == "C" && rotary(parts.next()) == "B";
    let moved = machine.axes.iter().find(|(name, a)| {
        let turned = a.sense.is_some_and(|s| s != 1) && !(any_sense && *name == "B");
        a.point_mm.is_some() || a.direction.is_some() || turned
    });
    let reason = match moved {
        None if usual => return Ok(()),
        None => format!(
            "the effects library knows B in the head and C in the table, not '{}'",
            machine.kinematics.order
        ),
        Some((name, _)) => {
            format!("the effects library does not know the line or sense that [axes.{name}] gives")
        }
    };
    Err(Error::measure(
        format!("{} data", kind.name()),
        reason,
        "take the [[effects]] out of its file for simulate and verify, which then take any order of axes",
    ))
}

/// An error of [`known_effects`] with the name of the model file; any other as it is.
pub fn of_model(error: Error, path: &std::path::Path) -> Error {
    match &error {
        Error::Measure { subject, .. }
            if subject.starts_with("effects") || subject.ends_with(" data") =>
        {
            error.in_file(path, None)
        }
        _ => error,
    }
}

/// Refuses an effect that is neither the library's nor has formulas of its own.
pub fn spelt(effect: &Effect) -> Result<()> {
    // One with formulas has whatever name its owner gave it.
    let own = !effect.outputs.is_empty();
    if own || NAMES.contains(&effect.name.as_str()) {
        return Ok(());
    }
    let fix = match nearest(&effect.name, NAMES) {
        Some(name) => format!("did you mean '{name}'?"),
        None => "an effect of your own needs kind and outputs (docs/machine.md)".into(),
    };
    let subject = format!("effects: name = \"{}\"", effect.name);
    Err(Error::measure(subject, "is not the name of an effect", fix))
}

/// The effects that the model file already has, as far as this kind of data knows them.
pub fn known_effects<C, E: Clone + Default>(
    library: &Library<C, E>,
    machine: &Machine,
    warnings: &mut Vec<String>,
) -> Result<Vec<Active>> {
    let mut known = Vec::new();
    for effect in &machine.effects {
        if !library.infos.iter().any(|i| i.name == effect.name) {
            spelt(effect)?;
            warnings.push(format!(
                "the model's effect '{}' does not touch this kind of data",
                effect.name
            ));
            continue;
        }
        let active = library.resolve(&effect.name, &effect.parameters).map_err(|reason| {
            Error::measure(format!("effects '{}'", effect.name), reason, "correct its parameters")
        })?;
        match &library.infos[active.effect].untestable {
            Some(Untestable { why, predictable: false }) => warnings.push(format!(
                "the model's effect '{}' cannot be predicted here: {why}",
                effect.name
            )),
            _ => known.push(active),
        }
    }
    Ok(known)
}
