//! The model file: what was found, added to `machine.toml`: named effects with their parameters, shapes without a name as formulas.

use crate::diagnose::own;
use crate::diagnose::report::{NamedEffect, Report, Unnamed};
use crate::machine::{Effect, Machine};

/// The machine with the report's named effects added. An effect that is already there in the same form is corrected: its sizes add
/// up. One with a lag, pitch or exponent of its own stands beside it. What has a shape but no name is added as a formula, so that
/// the model predicts it all the same.
/// `own` are effects of the user's own that were tried: their formulas go with them.
pub fn with_effects(machine: &Machine, report: &Report, own: &[own::Entry]) -> Machine {
    let mut machine = machine.clone();
    for named in &report.effects {
        let formulas = own.iter().find(|e| e.name == named.name);
        let sizes = |key: &&String| !named.form_parameters.contains(key);
        match machine.effects.iter_mut().find(|e| same_form(e, named)) {
            Some(old) => {
                for key in named.parameters.keys().filter(sizes) {
                    if let Some(size) = old.parameters.get_mut(key) {
                        *size += named.parameters[key];
                    }
                }
                old.parameters_u95 = named.parameters_u95.clone();
            }
            None => machine.effects.push(Effect {
                name: named.name.clone(),
                parameters: named.parameters.clone(),
                parameters_u95: named.parameters_u95.clone(),
                kind: formulas.map(|e| e.kind.clone()),
                outputs: formulas.map_or_else(Default::default, |e| e.outputs.clone()),
            }),
        }
    }
    for shape in &report.unnamed {
        if let Some(formula) = &shape.formula {
            let effect = unnamed(&machine, &report.kind, shape, formula);
            machine.effects.push(effect);
        }
    }
    machine
}

/// What was found and cannot be written into a model file, in words.
pub fn left_out(report: &Report) -> Vec<String> {
    let shapeless = report.unnamed.iter().filter(|u| u.formula.is_none());
    let shapeless = shapeless.map(|u| format!("not in the written model: {}", u.text));
    let bent = report.effects.iter().filter(|e| !e.form_corrected_over.is_empty()).map(|e| {
        let over = e.form_corrected_over.join(", ");
        format!("not in the written model: how the size of {} changes with {over}", e.name)
    });
    shapeless.chain(bent).collect()
}

/// A shape without a name as an effect of a name that the machine does not have yet.
fn unnamed(machine: &Machine, kind: &str, shape: &Unnamed, formula: &str) -> Effect {
    let of = format!("unnamed-{}-over-{}", shape.output, shape.versus);
    let of = of.replace(", ", "-").replace(['_', ' '], "-");
    let taken = |name: &String| machine.effects.iter().any(|e| e.name == *name);
    let others = (2..).map(|k| format!("{of}-{k}"));
    let name = std::iter::once(of.clone()).chain(others).find(|n| !taken(n)).unwrap_or(of.clone());
    let amplitude = "amplitude_mm".to_owned();
    Effect {
        name,
        kind: Some(kind.into()),
        outputs: [(shape.output.clone(), format!("{amplitude}*({formula})"))].into(),
        parameters_u95: shape
            .amplitude_u95_mm
            .map(|u| (amplitude.clone(), u))
            .into_iter()
            .collect(),
        parameters: [(amplitude, shape.amplitude_mm)].into(),
    }
}

/// Whether an effect of the machine has the form that was found: the same parameters, and the same lags, pitches and exponents. A
/// fitted one is never quite the same, and its size goes with it.
fn same_form(old: &Effect, named: &NamedEffect) -> bool {
    let alike = |key: &String| old.parameters[key] == named.parameters[key];
    old.name == named.name
        && old.parameters.keys().eq(named.parameters.keys())
        && named.form_parameters.iter().all(alike)
}
