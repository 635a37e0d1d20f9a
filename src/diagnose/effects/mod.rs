//! The effects the diagnosis knows by name, one file per kind of data.

pub mod ballbar;
mod ballbar_ways;
pub mod burn;
mod cycles;
mod harmonics;
pub mod rod;
mod rod_camera;
mod rod_slow;
pub mod rtcp;
pub mod rtcp_pose;
mod rtcp_slow;
mod rtcp_table;
pub mod thermal;
pub mod thermal_columns;
pub mod thermal_sensors;
mod thermal_ways;

use std::collections::BTreeMap;

use crate::diagnose::experiment::{Active, EffectInfo, Parameter, Untestable};

/// The names of all kinds' effects: one that stands here is another kind's, one that nearly does is misspelt.
pub const NAMES: [&str; 59] = [
    "ambient",
    "b-axis-tilt-x",
    "b-axis-tilt-z",
    "b-backlash",
    "b-pitch-error",
    "b-zero",
    "backlash-x",
    "backlash-y",
    "beam-tilt-x",
    "beam-tilt-y",
    "c-axial",
    "c-axis-tilt-x",
    "c-axis-tilt-y",
    "c-backlash",
    "c-centre",
    "c-pitch-error",
    "c-radial-2x",
    "camera-rotation",
    "camera-shear",
    "camera-tilt",
    "cyclic-x",
    "cyclic-y",
    "cyclic-z",
    "drift-temperature",
    "drift-time",
    "edge-bias-light",
    "head-constant",
    "head-lag",
    "head-nonlinear",
    "head-sag",
    "heating-hysteresis",
    "lens-decentring",
    "lens-radial",
    "lens-radial-5",
    "nozzle-offset",
    "pivot-length",
    "pivot-offset-x",
    "pixel-aspect",
    "pixel-scale",
    "pointing-drift",
    "position-quadratic",
    "rod-eccentricity",
    "rod-growth",
    "rod-oval",
    "rod-three-lobe",
    "scale-x",
    "scale-y",
    "scale-z",
    "screw-nonlinear",
    "sensor-dead",
    "servo-mismatch",
    "shutter-skew",
    "squareness-xy",
    "squareness-xz",
    "squareness-yz",
    "target-runout",
    "thermal-growth",
    "thermal-lens",
    "z-backlash",
];

/// Adds an effect with these parameters to the errors of every row. `C` is the data, `E` the errors of one row.
type Apply<C, E> = Box<dyn Fn(&C, &[f64], &mut [E]) + Send + Sync>;

/// The library of one kind of data: what each effect is called, and what it does.
pub struct Library<C, E> {
    /// Names, meanings, forms.
    pub infos: Vec<EffectInfo>,
    apply: Vec<Vec<Apply<C, E>>>,
}

/// The words that go with an effect.
pub struct Words {
    /// The contract's name.
    pub name: &'static str,
    /// What is wrong with the machine.
    pub meaning: &'static str,
    /// Where the evidence is strongest.
    pub evidence: &'static str,
    /// What shows it best.
    pub best: &'static str,
    /// Variables its size may depend on beyond the library's forms.
    pub varies_with: &'static [&'static str],
}

/// Words of an effect whose size depends on nothing beyond the library's forms.
fn words(
    name: &'static str,
    meaning: &'static str,
    evidence: &'static str,
    best: &'static str,
) -> Words {
    Words { name, meaning, evidence, best, varies_with: &[] }
}

impl<C, E> Default for Library<C, E> {
    fn default() -> Self {
        Self { infos: Vec::new(), apply: Vec::new() }
    }
}

impl<C, E: Clone + Default> Library<C, E> {
    /// Starts a new effect; its forms follow.
    pub fn effect(&mut self, words: Words, untestable: Option<Untestable>) -> &mut Self {
        self.infos.push(EffectInfo {
            name: words.name.into(),
            meaning: words.meaning.into(),
            evidence: words.evidence.into(),
            best: words.best.into(),
            forms: Vec::new(),
            varies_with: words.varies_with,
            beforehand: 0.0,
            untestable,
        });
        self.apply.push(Vec::new());
        self
    }

    /// How much likelier than another effect the one started last is beforehand, nats.
    pub fn beforehand(&mut self, nats: f64) {
        if let Some(info) = self.infos.last_mut() {
            info.beforehand = nats;
        }
    }

    /// Adds a form to the effect started last.
    pub fn form(
        &mut self,
        parameters: Vec<Parameter>,
        apply: impl Fn(&C, &[f64], &mut [E]) + Send + Sync + 'static,
    ) -> &mut Self {
        self.add(parameters, Box::new(apply))
    }

    /// Compiled once, not for every form.
    fn add(&mut self, parameters: Vec<Parameter>, apply: Apply<C, E>) -> &mut Self {
        if let (Some(info), Some(list)) = (self.infos.last_mut(), self.apply.last_mut()) {
            info.forms.push(parameters);
            list.push(apply);
        }
        self
    }

    /// The errors of every row with these effects in the machine.
    pub fn errors(&self, data: &C, rows: usize, active: &[Active]) -> Vec<E> {
        let mut errors = vec![E::default(); rows];
        for a in active {
            (self.apply[a.effect][a.form])(data, &a.values, &mut errors);
        }
        errors
    }

    /// See [`resolve`].
    pub fn resolve(
        &self,
        name: &str,
        parameters: &BTreeMap<String, f64>,
    ) -> Result<Active, String> {
        resolve(&self.infos, name, parameters)
    }
}

/// Finds the effect and form that a model file's entry means: the form whose parameters have the same names
/// (a switch may be left out where no other form has the remaining names).
pub fn resolve(
    infos: &[EffectInfo],
    name: &str,
    parameters: &BTreeMap<String, f64>,
) -> Result<Active, String> {
    let Some(effect) = infos.iter().position(|i| i.name == name) else {
        return Err(format!("is not an effect of this kind of data: {name}"));
    };
    let forms = &infos[effect].forms;
    let is_known = |key: &str| forms.iter().flatten().any(|p| p.name == key);
    let mut parameters = parameters.clone();
    parameters.retain(|key, _| is_known(key) || !key.starts_with("x_"));
    let stranger = parameters.keys().find(|key| !is_known(key));
    let stranger = stranger.map_or(String::new(), |key| format!("has no parameter {key}: "));
    for (form, list) in forms.iter().enumerate() {
        let same = list.len() == parameters.len()
            && list.iter().all(|p| {
                parameters.get(p.name.as_ref()).is_some_and(|v| !p.is_switch() || *v == p.start)
            });
        if same {
            let values = list.iter().map(|p| parameters[p.name.as_ref()]).collect();
            return Ok(Active { effect, form, values });
        }
    }
    let set =
        |form: &Vec<Parameter>| form.iter().map(Parameter::written).collect::<Vec<_>>().join(", ");
    let known = forms.iter().map(set).collect::<Vec<_>>().join(" | ");
    Err(format!("{stranger}{name} takes one of these sets of parameters: {known}"))
}

/// How far what rises from 0 towards 1 has come.
pub fn risen(since_s: f64, rise_s: f64) -> f64 {
    1.0 - (-since_s / rise_s.abs().max(1e-3)).exp()
}

/// How far a drift has come since the start: in hours where it is steady, else in parts of where it ends.
fn drifted(since_s: f64, rise_s: Option<f64>) -> f64 {
    rise_s.map_or(since_s / 3600.0, |rise_s| risen(since_s, rise_s))
}

/// A first-order lag of `values` over `times_s`, starting in balance with the first value: the exact solution for values that
/// change linearly between readings. Rows may be in any order.
pub fn lagged(times_s: &[f64], values: &[f64], lag_s: f64) -> Vec<f64> {
    lag(times_s, values, |dt, last, value, y| {
        let slope = (value - last) / dt;
        // Response of a first-order lag to a ramp from the last value.
        value - slope * lag_s + (y - last + slope * lag_s) * (-dt / lag_s).exp()
    })
}

/// The same for readings that stand for all the time since the one before.
pub fn held(times_s: &[f64], values: &[f64], lag_s: f64) -> Vec<f64> {
    lag(times_s, values, |dt, _, value, y| y + (1.0 - (-dt / lag_s).exp()) * (value - y))
}

/// Rows in the order of time.
fn in_time(times_s: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..times_s.len()).collect();
    order.sort_by(|a, b| times_s[*a].total_cmp(&times_s[*b]));
    order
}

/// A lag whose next value follows from the time gone by, the last and the present reading, and its last value.
fn lag(times_s: &[f64], values: &[f64], next: impl Fn(f64, f64, f64, f64) -> f64) -> Vec<f64> {
    let order = in_time(times_s);
    let mut out = vec![0.0; values.len()];
    let Some(&first) = order.first() else { return out };
    let (mut t, mut v, mut y) = (times_s[first], values[first], values[first]);
    for &i in &order {
        let dt = times_s[i] - t;
        if dt > 0.0 {
            y = next(dt, v, values[i], y);
            (t, v) = (times_s[i], values[i]);
        }
        out[i] = y;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_has_its_name_in_the_list() {
        let data = crate::diagnose::data::columns::Columns::default();
        let libraries = [ballbar::library(&data), burn::library(&data), thermal::library(&data)];
        for effect in libraries.iter().flat_map(|l| &l.infos) {
            assert!(NAMES.contains(&effect.name.as_ref()), "{}", effect.name);
        }
        assert!(NAMES.is_sorted());
    }
}
