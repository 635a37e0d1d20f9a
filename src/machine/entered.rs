//! Errors of a machine that are numbers its control holds: entered there, they are gone.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{Effect, Machine};

/// A number of the control that an effect corrects.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Entered {
    /// The effect.
    pub effect: String,
    /// Where it stands in the machine file: `head.delta_x_mm`, `head.r_mm`, `table.xc_mm` or `table.yc_mm`.
    pub key: String,
    /// What the control holds.
    pub now_mm: f64,
    /// What it should hold.
    pub new_mm: f64,
    /// Half-width of the 95 % interval of the change; none where the effect states none.
    pub u95_mm: Option<f64>,
}

/// Which effects correct which numbers: effect, its parameter, and where the number stands.
const NUMBERS: [(&str, &str, &str); 4] = [
    ("pivot-offset-x", "delta_x_mm", "head.delta_x_mm"),
    ("pivot-length", "r_mm", "head.r_mm"),
    ("c-centre", "x_mm", "table.xc_mm"),
    ("c-centre", "y_mm", "table.yc_mm"),
];

/// The control's number and the part of an effect that corrects it.
fn corrected<'m>(
    machine: &'m mut Machine,
    effect: &Effect,
) -> Vec<(&'static str, &'static str, &'m mut f64)> {
    let Machine { head, table, .. } = machine;
    let places = [&mut head.delta_x_mm, &mut head.r_mm, &mut table.xc_mm, &mut table.yc_mm];
    let numbers = NUMBERS.into_iter().zip(places);
    let own = |name: &str, p: &str| name == effect.name && effect.parameters.contains_key(p);
    let own = numbers.filter(|((name, p, _), _)| own(name, p) && effect.outputs.is_empty());
    own.map(|((_, p, key), place)| (p, key, place)).collect()
}

/// The machine whose control holds the numbers that its effects correct, without those effects, and what changed. An effect that is less
/// than its own uncertainty stays where it is.
pub fn entered(machine: &Machine) -> (Machine, Vec<Entered>) {
    let mut new = machine.clone();
    let mut list = Vec::new();
    for effect in machine.effects.iter().filter(|e| is_told(e)) {
        for (parameter, key, place) in corrected(&mut new, effect) {
            let now_mm = *place;
            *place += effect.parameters[parameter];
            list.push(Entered {
                effect: effect.name.clone(),
                key: key.into(),
                now_mm,
                new_mm: *place,
                u95_mm: effect.parameters_u95.get(parameter).copied(),
            });
        }
    }
    new.effects.retain(|e| !is_entered(e) || !is_told(e));
    (new, list)
}

/// Whether an effect is known well enough to be entered: its sizes together are more than what is not known of them.
pub fn is_told(effect: &Effect) -> bool {
    let numbers = || NUMBERS.iter().filter(|(name, ..)| *name == effect.name);
    let size = |of: &BTreeMap<String, f64>| {
        numbers().filter_map(|(_, parameter, _)| of.get(*parameter)).map(|v| v * v).sum::<f64>()
    };
    size(&effect.parameters_u95) <= size(&effect.parameters)
}

/// Whether an effect corrects numbers that the control holds.
pub fn is_entered(effect: &Effect) -> bool {
    effect.outputs.is_empty() && NUMBERS.iter().any(|(name, ..)| *name == effect.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_less_than_its_own_uncertainty_is_not_entered() {
        let machine = |u95: f64| -> Machine {
            let text = format!(
                "schema = 1\n[head]\ndelta_x_mm = 0.0\nr_mm = 300.0\n[[effects]]\nname = \"pivot-length\"\n\
                 parameters = {{ r_mm = 0.02, datum = 1.0 }}\nparameters_u95 = {{ r_mm = {u95} }}\n"
            );
            crate::tomlfile::parse(std::path::Path::new("m.toml"), &text).unwrap()
        };
        let (new, list) = entered(&machine(0.005));
        assert!(new.effects.is_empty() && list.len() == 1 && new.head.r_mm == 300.02);
        let (new, list) = entered(&machine(0.3));
        assert!(new.effects.len() == 1 && list.is_empty() && new.head.r_mm == 300.0);
    }
}
