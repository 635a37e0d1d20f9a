//! Effects of the user's own, as formulas of the data's columns, in competition with the library.
//!
//! They stand around an experiment of any kind: what a formula gives is added to the prediction along its output.

use std::collections::BTreeMap;
use std::path::Path;

use exmex::{Express, FlatEx};
use serde::Deserialize;

use crate::diagnose::doubts::beyond_machines;
use crate::diagnose::experiment::{
    Active, Direction, EffectInfo, Experiment, Layout, Parameter, PlannedCapture,
};
use crate::error::{Error, Result};
use crate::machine::{DataKind, Effect, Machine};
use crate::tomlfile;

/// Columns that some kind of data may have; a formula may ask for them, and cannot be tested without them.
const COLUMNS: &[&str] = &[
    "b_deg",
    "c_deg",
    "dir",
    "dir_b",
    "dir_c",
    "dir_x",
    "dir_y",
    "t_s",
    "temp_c",
    "x_mm",
    "y_mm",
    "z_mm",
    "height_mm",
    "power_w",
    "position_mm",
    "screw_c",
    "head_1_c",
    "ambient_c",
    "edge_angle_deg",
    "rod_angle_deg",
    "frame_u_mm",
    "frame_v_mm",
    "frame_radius_mm",
];

/// Least size that a parameter of a model file is taken to have: it may be zero.
const LEAST_TYPICAL: f64 = 1e-6;

/// An effects file: `docs/diagnose.md` explains each key.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    /// Version of the file's form: 1.
    pub schema: u32,
    /// The effects.
    #[serde(default)]
    pub effects: Vec<Entry>,
}

/// One effect of the user's own.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// What it is called.
    pub name: String,
    /// The kind of data it shows in.
    pub kind: String,
    /// What is wrong with the machine, in one line.
    #[serde(default)]
    pub meaning: String,
    /// What measurement shows it best.
    #[serde(default)]
    pub best: String,
    /// Its parameters, with the unit in the name.
    pub parameters: BTreeMap<String, Prior>,
    /// What it adds to each output, mm: formulas of columns and parameters.
    pub outputs: BTreeMap<String, String>,
}

/// What a parameter may be.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// What a real machine shows: the prior's standard deviation.
    pub typical: f64,
    /// Values tried first, where the formula is not linear in the parameter (a lag, a pitch).
    #[serde(default)]
    pub grid: Vec<f64>,
}

/// Where a formula's variable comes from.
#[derive(Debug, Clone, Copy)]
enum Origin {
    Column(usize),
    Parameter(usize),
}

/// A formula along one direction of the layout.
#[derive(Debug, Clone)]
struct Formula {
    direction: usize,
    tree: FlatEx<f64>,
    origins: Vec<Origin>,
}

/// An experiment with effects of the user's own beside the library's.
pub struct OwnEffects {
    inner: Box<dyn Experiment>,
    entries: Vec<Entry>,
    infos: Vec<EffectInfo>,
    /// Formulas of each own effect; none where a column is missing.
    formulas: Vec<Vec<Formula>>,
    /// Own effects that the model file already has.
    known: Vec<Active>,
}

/// Reads the effects of one kind of data from a file.
pub fn read(path: impl AsRef<Path>, kind: &str) -> Result<Vec<Entry>> {
    let path = path.as_ref();
    let file: File = tomlfile::read(path)?;
    if file.schema != 1 {
        let reason = format!("is {}", file.schema);
        return Err(Error::field(path, None, "schema", reason, "write schema = 1"));
    }
    for (i, e) in file.effects.iter().enumerate() {
        let fail = |field: &str, reason: &str, fix: &str| {
            Err(Error::field(path, None, format!("effects '{}': {field}", e.name), reason, fix))
        };
        let named = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if e.name.is_empty() || !e.name.chars().all(named) {
            return fail("name", "is not a name", "use small letters, digits and '-'");
        }
        if file.effects[..i].iter().any(|o| o.name == e.name && o.kind == e.kind) {
            return fail("name", "is used twice", "give each effect a name of its own");
        }
        if !DataKind::has(&e.kind) {
            return fail("kind", &format!("is '{}'", e.kind), DataKind::FIX);
        }
        if e.outputs.is_empty() || e.parameters.values().all(|p| !p.grid.is_empty()) {
            let reason = "needs an output and a parameter without a grid, which makes its size";
            return fail("outputs", reason, "see docs/diagnose.md");
        }
        for (name, p) in &e.parameters {
            let good = p.typical.is_finite() && p.typical > 0.0 && p.grid.iter().all(|g| *g != 0.0);
            if !good || p.grid.iter().any(|g| !g.is_finite()) {
                let fix = "give sizes that are finite and not zero";
                return fail(&format!("parameters.{name}"), "has no usable size", fix);
            }
            if COLUMNS.contains(&name.as_str()) {
                let fix = "give the parameter another name";
                return fail(&format!("parameters.{name}"), "is a column's name", fix);
            }
        }
    }
    Ok(file.effects.into_iter().filter(|e| e.kind == kind).collect())
}

/// The effects of one kind of data that a machine file holds as formulas.
pub fn of_machine(machine: &Machine, kind: &str) -> Vec<Entry> {
    let typical = |v: &f64| Prior { typical: v.abs().max(LEAST_TYPICAL), grid: Vec::new() };
    let of_kind = |e: &&Effect| !e.outputs.is_empty() && e.kind.as_deref() == Some(kind);
    let entry = |e: &Effect| Entry {
        name: e.name.clone(),
        kind: kind.into(),
        meaning: "a formula of the model file".into(),
        best: String::new(),
        parameters: e.parameters.iter().map(|(name, v)| (name.clone(), typical(v))).collect(),
        outputs: e.outputs.clone(),
    };
    machine.effects.iter().filter(of_kind).map(entry).collect()
}

/// The experiment that `library` makes of a machine's effects of the library, with the effects of `entries` around it, which
/// `path` gives; the library is not asked for those.
pub fn around(
    machine: &Machine,
    path: &Path,
    entries: Vec<Entry>,
    warnings: &mut Vec<String>,
    library: impl FnOnce(&Machine, &mut Vec<String>) -> Result<Box<dyn Experiment>>,
) -> Result<Box<dyn Experiment>> {
    if entries.is_empty() {
        return library(machine, warnings);
    }
    let own = |e: &Effect| entries.iter().any(|o| o.name == e.name);
    let (mut rest, mut taken) = (machine.clone(), machine.clone());
    rest.effects.retain(|e| !own(e));
    taken.effects.retain(own);
    let own = OwnEffects::new(library(&rest, warnings)?, path, entries, &taken)?;
    own.check(path, warnings)?;
    Ok(Box::new(own))
}

impl OwnEffects {
    /// Puts the effects of `path` beside those of `inner`; `machine` has those of them the model holds already.
    fn new(
        inner: Box<dyn Experiment>,
        path: &Path,
        entries: Vec<Entry>,
        machine: &Machine,
    ) -> Result<Self> {
        let mut infos = inner.effects().to_vec();
        let mut formulas = Vec::new();
        for e in &entries {
            let fail = |field: String, reason: String, fix: &str| {
                Error::field(path, None, format!("effects '{}': {field}", e.name), reason, fix)
            };
            if infos.iter().any(|i| i.name == e.name) {
                let reason = "is a name of the library".into();
                return Err(fail("name".into(), reason, "choose another name"));
            }
            let compiled = compile(e, inner.layout())
                .map_err(|(field, reason)| fail(field, reason, "correct the formula"))?;
            infos.push(info(e, compiled.as_ref().err()));
            formulas.push(compiled.unwrap_or_default());
        }
        let first = infos.len() - entries.len();
        let mut known = Vec::new();
        for effect in &machine.effects {
            let Some(at) = entries.iter().position(|e| e.name == effect.name) else { continue };
            if !effect.parameters.keys().eq(entries[at].parameters.keys()) {
                let names: Vec<&str> = entries[at].parameters.keys().map(String::as_str).collect();
                return Err(Error::measure(
                    format!("{}: effects '{}'", path.display(), effect.name),
                    format!("takes the parameters {}", names.join(", ")),
                    "correct its parameters",
                ));
            }
            let values = effect.parameters.values().copied().collect();
            known.push(Active { effect: first + at, form: 0, values });
        }
        Ok(Self { inner, entries, infos, formulas, known })
    }

    /// Formulas must give numbers on every row; says which give sizes that no machine shows.
    fn check(&self, path: &Path, warnings: &mut Vec<String>) -> Result<()> {
        let first = self.inner.effects().len();
        for (k, e) in self.entries.iter().enumerate() {
            let values: Vec<f64> = e
                .parameters
                .values()
                .map(|p| p.grid.first().copied().unwrap_or(p.typical))
                .collect();
            let active = Active { effect: first + k, form: 0, values };
            let mut added = vec![0.0; self.layout().values.len()];
            self.add(&active, &mut added);
            if let Some(i) = added.iter().position(|v| !v.is_finite()) {
                return Err(Error::field(
                    path,
                    None,
                    format!("effects '{}': outputs", e.name),
                    format!("gives no number at value {} of the data", i + 1),
                    "keep logarithms, roots and divisions away from zero",
                ));
            }
            if let Some(most) = beyond_machines(added) {
                warnings.push(format!(
                    "{}: effects '{}' adds up to {most:.1} mm at its typical sizes, more than any machine shows: check the formula's units (outputs in mm, angles in degrees) and what is typical",
                    path.display(),
                    e.name
                ));
            }
        }
        Ok(())
    }

    /// Adds one own effect to the prediction, mm.
    fn add(&self, active: &Active, out: &mut [f64]) {
        let layout = self.inner.layout();
        for f in &self.formulas[active.effect - self.inner.effects().len()] {
            let mut inputs = vec![0.0; f.origins.len()];
            for (i, factor) in layout.directions[f.direction].factors.iter().enumerate() {
                if *factor == 0.0 {
                    continue;
                }
                for (input, origin) in inputs.iter_mut().zip(&f.origins) {
                    *input = match origin {
                        Origin::Column(c) => layout.variables[*c].values[i],
                        Origin::Parameter(p) => active.values[*p],
                    };
                }
                out[i] += factor * f.tree.eval(&inputs).unwrap_or(f64::NAN);
            }
        }
    }
}

fn info(e: &Entry, missing: Option<&String>) -> EffectInfo {
    let form = e.parameters.iter().map(|(name, p)| match p.grid.as_slice() {
        [] => Parameter::linear(name.clone(), p.typical),
        grid => Parameter::shape(name.clone(), grid),
    });
    EffectInfo {
        name: e.name.clone().into(),
        meaning: e.meaning.clone().into(),
        evidence: e.outputs.keys().cloned().collect::<Vec<_>>().join(", ").into(),
        best: e.best.clone().into(),
        forms: vec![form.collect()],
        varies_with: &[],
        beforehand: 0.0,
        untestable: missing.map(|why| why.as_str().into()),
    }
}

/// Field and reason of a formula that is wrong.
type Wrong = (String, String);

/// The formulas of an effect, or which column the data lack for them.
fn compile(
    e: &Entry,
    layout: &Layout,
) -> std::result::Result<std::result::Result<Vec<Formula>, String>, Wrong> {
    let mut formulas = Vec::new();
    let mut missing = None;
    for (output, text) in &e.outputs {
        let field = format!("outputs.{output}");
        let names: Vec<&str> = layout.directions.iter().map(|d| &*d.name).collect();
        let Some(direction) = names.iter().position(|n| n == output) else {
            if Direction::output_of(output).is_some_and(|whole| names.contains(&whole)) {
                missing = Some(format!("the data hold no {output}"));
                continue;
            }
            return Err((field, format!("is not an output; there are {}", names.join(", "))));
        };
        let tree = exmex::parse::<f64>(text).map_err(|e| (field.clone(), e.to_string()))?;
        let mut origins = Vec::new();
        for name in tree.var_names() {
            let parameter = e.parameters.keys().position(|p| p == name).map(Origin::Parameter);
            let column = layout.variables.iter().position(|v| v.name == name).map(Origin::Column);
            match parameter.or(column) {
                Some(origin) => origins.push(origin),
                None if COLUMNS.contains(&name.as_str()) => {
                    missing = Some(format!("column '{name}' is missing"));
                }
                None => {
                    let known: Vec<&str> = layout.variables.iter().map(|v| v.name).collect();
                    let known = known.join(", ");
                    return Err((
                        field,
                        format!("'{name}' is neither a parameter nor one of the columns {known}"),
                    ));
                }
            }
        }
        formulas.push(Formula { direction, tree, origins });
    }
    Ok(missing.map_or(Ok(formulas), Err))
}

impl Experiment for OwnEffects {
    fn kind(&self) -> DataKind {
        self.inner.kind()
    }

    fn layout(&self) -> &Layout {
        self.inner.layout()
    }

    fn nuisances(&self) -> &[Parameter] {
        self.inner.nuisances()
    }

    fn effects(&self) -> &[EffectInfo] {
        &self.infos
    }

    fn predict(&self, nuisances: &[f64], active: &[Active]) -> Vec<f64> {
        let first = self.inner.effects().len();
        let (own, library): (Vec<&Active>, Vec<&Active>) =
            active.iter().chain(&self.known).partition(|a| a.effect >= first);
        let library: Vec<Active> = library.into_iter().cloned().collect();
        let mut out = self.inner.predict(nuisances, &library);
        own.into_iter().for_each(|a| self.add(a, &mut out));
        out
    }

    fn predicted_columns(&self, predicted: &[f64]) -> Vec<(&'static str, Vec<f64>)> {
        self.inner.predicted_columns(predicted)
    }

    fn with_plan(&self, extra: &[PlannedCapture]) -> Box<dyn Experiment> {
        let inner = self.inner.with_plan(extra);
        let formulas = self.entries.iter().map(|e| {
            let compiled = compile(e, inner.layout());
            compiled.ok().and_then(std::result::Result::ok).unwrap_or_default()
        });
        let formulas = formulas.collect();
        let (entries, infos) = (self.entries.clone(), self.infos.clone());
        Box::new(Self { inner, entries, infos, formulas, known: self.known.clone() })
    }

    fn proposals(&self) -> Vec<Vec<PlannedCapture>> {
        self.inner.proposals()
    }

    fn other_sweep(&self) -> Vec<PlannedCapture> {
        self.inner.other_sweep()
    }
}
