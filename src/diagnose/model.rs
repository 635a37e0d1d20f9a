//! The model file: named effects with their parameters, added to `machine.toml`.

use std::collections::BTreeMap;

use crate::diagnose::report::Report;
use crate::machine::{Effect, Machine};

/// The machine with the report's named effects added. An effect that is already there in the same form is corrected: its
/// parameters add up, those that belong to the form (lags, pitches, switches) are replaced.
pub fn with_effects(machine: &Machine, report: &Report) -> Machine {
    let mut machine = machine.clone();
    for named in &report.effects {
        let same = |e: &&mut Effect| {
            e.name == named.name && e.parameters.keys().eq(named.parameters.keys())
        };
        match machine.effects.iter_mut().find(same) {
            Some(old) => {
                add(&mut old.parameters, named);
                old.parameters_u95 = named.parameters_u95.clone();
            }
            None => machine.effects.push(Effect {
                name: named.name.clone(),
                parameters: named.parameters.clone(),
                parameters_u95: named.parameters_u95.clone(),
            }),
        }
    }
    machine
}

fn add(old: &mut BTreeMap<String, f64>, named: &crate::diagnose::report::NamedEffect) {
    for (key, value) in &named.parameters {
        let fitted = named.parameters_u95.contains_key(key);
        let form = ["lag_s", "rise_s", "pitch_mm"].contains(&key.as_str());
        let slot = old.entry(key.clone()).or_insert(0.0);
        *slot = if fitted && !form { *slot + value } else { *value };
    }
}
