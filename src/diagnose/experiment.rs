//! What the statistics need to know of one set of measurements, whatever its kind.

use std::borrow::Cow;

use nalgebra::DMatrix;

use crate::machine::DataKind;

/// A parameter of an effect or of the baseline.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Name with its unit, as written in files.
    pub name: Cow<'static, str>,
    /// What a real machine shows: the prior's standard deviation, and the scale of numeric steps.
    pub typical: f64,
    /// Empty where the prediction is (nearly) linear in the parameter; otherwise the values tried first.
    pub grid: Vec<f64>,
    /// The value the fit starts from.
    pub start: f64,
    /// Values beyond the grid that are looked through.
    pub scan: Scan,
}

/// Values of a parameter of the form that are looked through one by one, at a price: where many are tried, one fits by chance.
#[derive(Debug, Clone, Default)]
pub struct Scan {
    /// The values.
    pub values: Vec<f64>,
    /// Two values are one where they make less than a quarter of a turn of difference over so much.
    pub turns_over: f64,
    /// What one that is not on the grid costs: ln of how many independent ones are tried, nats.
    pub nats: f64,
}

impl Scan {
    /// Turns that one value makes more than another.
    pub fn turns_apart(&self, a: f64, b: f64) -> f64 {
        (self.turns_over / a - self.turns_over / b).abs()
    }

    /// So many values to either side of one of them, up to the next ones.
    pub fn about(&self, value: f64, to_a_side: i32) -> Vec<f64> {
        let gap = |other: &f64| Some(self.turns_apart(value, *other)).filter(|turns| *turns > 0.0);
        let step_turns = self.values.iter().filter_map(gap).reduce(f64::min).unwrap_or(0.0)
            / f64::from(to_a_side);
        let at = |k: i32| self.turns_over / (self.turns_over / value + f64::from(k) * step_turns);
        (-to_a_side..=to_a_side).map(at).collect()
    }
}

impl Parameter {
    /// A parameter that enters linearly and is zero where the effect is absent.
    pub fn linear(name: impl Into<Cow<'static, str>>, typical: f64) -> Self {
        Self { name: name.into(), typical, grid: Vec::new(), start: 0.0, scan: Scan::default() }
    }

    /// A parameter of the form (a lag, a pitch), searched on a grid first.
    pub fn shape(name: impl Into<Cow<'static, str>>, grid: &[f64]) -> Self {
        let typical = grid.first().copied().unwrap_or(1.0);
        Self { grid: grid.to_vec(), start: typical, ..Self::linear(name, typical) }
    }

    /// A choice between definitions that is part of the form and never fitted.
    pub fn switch(name: &'static str, value: f64) -> Self {
        Self { grid: vec![value], start: value, ..Self::linear(name, 0.0) }
    }

    /// Whether the parameter is a switch, which no fit changes.
    pub fn is_switch(&self) -> bool {
        self.typical == 0.0
    }

    /// As a model file holds it: its name, a switch with its value.
    pub fn written(&self) -> String {
        match self.is_switch() {
            true => format!("{} = {}", self.name, self.start),
            false => self.name.to_string(),
        }
    }

    /// The least and greatest value that a parameter of the form is looked for at: beyond, it says nothing more than the limit does.
    pub fn limits(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.grid.first()?, self.grid.last()?);
        (!self.is_switch()).then(|| (0.3 * first.min(*last), 3.0 * first.max(*last)))
    }

    /// Whether a fit left a parameter of the form at such a limit.
    pub fn is_at_limit(&self, value: f64) -> bool {
        self.limits().is_some_and(|(low, high)| value <= low || value >= high)
    }

    /// What a value costs that was found among many, nats: nothing where the grid has it.
    pub fn price_of(&self, value: f64) -> f64 {
        let on_grid = |g: &f64| self.scan.turns_apart(value, *g) < 0.25;
        if self.grid.iter().any(on_grid) { 0.0 } else { self.scan.nats }
    }

    /// All combinations of the grid values of several; linear parameters at zero.
    pub fn grid_points(parameters: &[Self]) -> Vec<Vec<f64>> {
        let mut points = vec![Vec::new()];
        for p in parameters {
            let choices: &[f64] = if p.grid.is_empty() { &[0.0] } else { &p.grid };
            points = points
                .into_iter()
                .flat_map(|point: Vec<f64>| {
                    choices.iter().map(move |v| [point.clone(), vec![*v]].concat())
                })
                .collect();
        }
        points
    }
}

/// Why data cannot test an effect.
#[derive(Debug, Clone)]
pub struct Untestable {
    /// In words.
    pub why: String,
    /// The data hold what it depends on: an effect that is in the model has its part in what is predicted.
    pub predictable: bool,
}

impl From<&str> for Untestable {
    fn from(why: &str) -> Self {
        Self { why: why.into(), predictable: false }
    }
}

/// A library effect, as far as naming and explaining it goes.
#[derive(Debug, Clone)]
pub struct EffectInfo {
    /// The contract's name.
    pub name: Cow<'static, str>,
    /// One line: what is wrong with the machine.
    pub meaning: Cow<'static, str>,
    /// Where the evidence is strongest.
    pub evidence: Cow<'static, str>,
    /// What measurement shows it best.
    pub best: Cow<'static, str>,
    /// The functional forms it is known to take, simplest first; each is a list of parameters.
    pub forms: Vec<Vec<Parameter>>,
    /// The variables its size may depend on in a form the library does not have.
    pub varies_with: &'static [&'static str],
    /// How much likelier than another effect it is beforehand, nats: its cause is seen in the data.
    pub beforehand: f64,
    /// Why the data at hand cannot test it.
    pub untestable: Option<Untestable>,
}

/// An effect in the model, in one form with all its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Active {
    /// Index into the experiment's effects.
    pub effect: usize,
    /// Index into the effect's forms.
    pub form: usize,
    /// The form's parameters.
    pub values: Vec<f64>,
}

/// A column of the plan: an angle, a time, a place.
#[derive(Debug, Clone)]
pub struct Variable {
    /// Column name with its unit.
    pub name: &'static str,
    /// Its value at each observation.
    pub values: Vec<f64>,
    /// Degrees round a full turn, so that harmonics make sense.
    pub angle: bool,
    /// Differs between points of one capture (a place in the frame), rather than between captures.
    pub within: bool,
}

/// Between an output and the part of the machine that it is on, in a name.
const ON: &str = " on ";

/// A way in which an unknown effect could show in the observations.
#[derive(Debug, Clone)]
pub struct Direction {
    /// The output's name.
    pub name: Cow<'static, str>,
    /// What one millimetre along it adds to each observation.
    pub factors: Vec<f64>,
    /// Whether it is an output before it on a part of the machine alone, such as one axis.
    pub is_part: bool,
}

impl Direction {
    /// An output of all captures.
    pub fn whole(name: &'static str, factors: Vec<f64>) -> Self {
        Self { name: name.into(), factors, is_part: false }
    }

    /// The outputs of captures whose values stand side by side, capture after capture.
    pub fn side_by_side(names: &[&'static str], captures: usize) -> Vec<Self> {
        let of = |output: usize| -> Vec<f64> {
            let values = 0..captures * names.len();
            values.map(|i| f64::from(u8::from(i % names.len() == output))).collect()
        };
        names.iter().enumerate().map(|(output, name)| Self::whole(name, of(output))).collect()
    }

    /// An output on a part of the machine alone.
    pub fn part(output: &str, part: &str, factors: Vec<f64>) -> Self {
        Self { name: format!("{output}{ON}{part}").into(), factors, is_part: true }
    }

    /// The output that a name is a part of, if it is one's.
    pub fn output_of(part: &str) -> Option<&str> {
        part.split_once(ON).map(|(output, _)| output)
    }

    /// Whether it sees other values than the directions before it: a machine's only axis is the whole of it.
    pub fn is_distinct(&self) -> bool {
        !self.is_part || self.factors.contains(&0.0)
    }
}

/// The observations and how they hang together.
#[derive(Debug, Clone, Default)]
pub struct Layout {
    /// The measured values, mm.
    pub values: Vec<f64>,
    /// The capture (pose, burn) each value belongs to, numbered from 0.
    pub groups: Vec<usize>,
    /// Captures with the same number are repeats of one another.
    pub sites: Vec<usize>,
    /// Observations whose noise may differ from the others' (one class per measured output).
    pub classes: Vec<usize>,
    /// Ways an unknown effect could show.
    pub directions: Vec<Direction>,
    /// What the observations may depend on.
    pub variables: Vec<Variable>,
    /// Values whose errors may follow one another, in order and with their places along the way: those read one after another, or
    /// neighbours along the edge of a capture. Between places that are 1 apart lies one step.
    pub chains: Vec<Vec<(usize, f64)>>,
    /// Random parts shared within a capture: components, each of one or more columns.
    pub random: Vec<Vec<Vec<f64>>>,
    /// Angle on the artefact at which each value was seen; empty where there is no rim to have a form of its own.
    pub rim_deg: Vec<f64>,
}

impl Layout {
    /// Number of captures.
    pub fn group_count(&self) -> usize {
        self.sites.len()
    }

    /// The outputs, each of all captures.
    pub fn outputs(&self) -> impl Iterator<Item = &Direction> {
        self.directions.iter().filter(|d| !d.is_part)
    }
}

/// One set of measurements and its exact model.
pub trait Experiment {
    /// What the data are.
    fn kind(&self) -> DataKind;
    /// The observations.
    fn layout(&self) -> &Layout;
    /// Parameters of the baseline that are fitted with everything else.
    fn nuisances(&self) -> &[Parameter];
    /// The library.
    fn effects(&self) -> &[EffectInfo];
    /// The exact prediction of every observation, mm.
    fn predict(&self, nuisances: &[f64], active: &[Active]) -> Vec<f64>;
    /// The prediction in the data file's own columns, one value a row.
    fn predicted_columns(&self, predicted: &[f64]) -> Vec<(&'static str, Vec<f64>)>;
    /// The experiment with further captures after its own, their measured values unset.
    fn with_plan(&self, extra: &[PlannedCapture]) -> Box<dyn Experiment>;
    /// Captures the machine could take next, for `next_measurement`: as it stands, and such as take more, in the order in which they are
    /// thought of.
    fn proposals(&self) -> Vec<Vec<PlannedCapture>>;
    /// A whole sweep in another set-up than those measured, for `next_measurement`; empty where there is none.
    fn other_sweep(&self) -> Vec<PlannedCapture> {
        Vec::new()
    }
}

/// d(prediction)/d(each size of an effect), mm per unit, at a point where all of its sizes are nil; `base` is the prediction without it.
pub fn size_columns(
    experiment: &dyn Experiment,
    nuisances: &[f64],
    base: &[f64],
    at: &Active,
) -> DMatrix<f64> {
    let parameters = &experiment.effects()[at.effect].forms[at.form];
    let sizes: Vec<usize> =
        (0..parameters.len()).filter(|&i| parameters[i].grid.is_empty()).collect();
    let mut columns = DMatrix::zeros(base.len(), sizes.len());
    for (mut column, &i) in columns.column_iter_mut().zip(&sizes) {
        let step = 1e-3 * parameters[i].typical;
        let mut moved = at.clone();
        moved.values[i] += step;
        let forward = experiment.predict(nuisances, &[moved]);
        column.iter_mut().zip(forward.iter().zip(base)).for_each(|(d, (f, b))| *d = (f - b) / step);
    }
    columns
}

/// A capture that could be taken: column names with values.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, schemars::JsonSchema)]
pub struct PlannedCapture(pub std::collections::BTreeMap<&'static str, Setting>);

/// What a planned capture sets a column to.
#[derive(Debug, Clone, PartialEq, serde::Serialize, schemars::JsonSchema)]
#[serde(untagged)]
pub enum Setting {
    /// A position, a temperature, a direction.
    Number(f64),
    /// The axis or path that is measured.
    Name(String),
}

impl PlannedCapture {
    /// The same with a column set, with no more digits than people set.
    pub fn with(mut self, name: &'static str, value: f64) -> Self {
        self.0.insert(name, Setting::Number((value * 1e3).round() / 1e3 + 0.0));
        self
    }

    /// The planned value of a column of numbers.
    pub fn number(&self, name: &str) -> Option<f64> {
        match self.0.get(name) {
            Some(Setting::Number(value)) => Some(*value),
            _ => None,
        }
    }

    /// The axis or path that is planned in a column of names.
    pub fn name(&self, column: &str) -> Option<&str> {
        match self.0.get(column) {
            Some(Setting::Name(name)) => Some(name),
            _ => None,
        }
    }

    /// The planned value of a column, or else the last one measured.
    pub fn or_last(&self, name: &str, column: &[f64]) -> f64 {
        self.number(name).or(column.last().copied()).unwrap_or(0.0)
    }

    /// The order in which planned captures are taken, where they have times.
    pub fn by_time(&self, other: &Self) -> std::cmp::Ordering {
        let time = |c: &Self| c.number("t_s").unwrap_or(0.0);
        time(self).total_cmp(&time(other))
    }

    /// Appends the value of a column, where the data have that column at all.
    pub fn extend(&self, name: &str, column: &mut Vec<f64>) {
        if !column.is_empty() {
            column.push(self.or_last(name, column));
        }
    }
}
