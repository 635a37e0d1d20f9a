//! The answer: verdict, named effects with their rivals, what has no name, and the gap before and after.

use serde::Serialize;
use std::collections::BTreeMap;

use crate::diagnose::experiment::{PlannedCapture, Setting};
use crate::machine::Entered;

/// What the diagnosis says as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing is missing.
    Consistent,
    /// Named effects explain all of the gap.
    Named,
    /// Named effects were found, and more remains.
    Partly,
    /// Something is missing that is not in the library.
    Unknown,
}

impl Verdict {
    /// The word used in every output.
    pub fn word(self) -> &'static str {
        match self {
            Self::Consistent => "consistent",
            Self::Named => "named",
            Self::Partly => "partly",
            Self::Unknown => "unknown",
        }
    }
}

/// A named effect.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct NamedEffect {
    /// The library's name.
    pub name: String,
    /// What is wrong with the machine.
    pub meaning: String,
    /// Names that fit as well on this design.
    pub confusable_with: Vec<String>,
    /// Parameters with their units in their names.
    pub parameters: BTreeMap<String, f64>,
    /// Half-widths of their 95 % intervals.
    pub parameters_u95: BTreeMap<String, f64>,
    /// Those of the form (lags, pitches, exponents, switches): two effects of one name add up only where these agree.
    #[serde(skip)]
    pub form_parameters: Vec<String>,
    /// Share of the gap's mean square.
    pub share_percent: f64,
    /// Chance of as much evidence from noise.
    pub p_value: f64,
    /// Probability among the names of its class, from likelihood alone: beforehand all are as likely.
    pub weight: f64,
    /// The same of those that fit as well by themselves; the others of `confusable_with` do so only in twos.
    pub confusable_weights: BTreeMap<String, f64>,
    /// Whether its form was corrected beyond the library's forms, and over what.
    pub form_corrected_over: Vec<String>,
}

impl NamedEffect {
    /// The names that fit as well, each with its probability: for people.
    pub fn class(&self) -> String {
        let percent = |weight: &f64| format!(" {:.0} %", 100.0 * weight);
        let told = self.confusable_with.iter().map(|name| {
            name.clone() + &self.confusable_weights.get(name).map_or(String::new(), percent)
        });
        told.collect::<Vec<_>>().join(", ")
    }
}

/// Something without a name.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Unnamed {
    /// The output it shows in.
    pub output: String,
    /// The variable it follows.
    pub versus: String,
    /// Its shape.
    pub shape: String,
    /// Its amplitude.
    pub amplitude_mm: f64,
    /// Half-width of its 95 % interval; none for what has no shape.
    pub amplitude_u95_mm: Option<f64>,
    /// The shape as a formula of the columns, for an amplitude of 1; none for what has no shape.
    pub formula: Option<String>,
    /// The same in words.
    pub text: String,
}

/// Root mean squares before and after, on the fitted data and on captures held out.
#[derive(Debug, Clone, Default, Serialize, schemars::JsonSchema)]
pub struct Gap {
    /// The model as given, on the data it is fitted to.
    pub before_rms_mm: f64,
    /// The same with the named effects.
    pub after_rms_mm: f64,
    /// The model as given, on captures the fit has not seen.
    pub heldout_before_rms_mm: f64,
    /// The same with the named effects.
    pub heldout_after_rms_mm: f64,
    /// What the noise alone leaves.
    pub noise_rms_mm: f64,
    /// After, with the shapes that have no name as well; none where there are none.
    pub with_unnamed_rms_mm: Option<f64>,
}

/// Where simulation and data disagree.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Where {
    /// The column that differs.
    pub output: String,
    /// The variable over which it does.
    pub versus: String,
    /// The range's lower end, in the variable's unit.
    pub from: f64,
    /// Its upper end.
    pub to: f64,
    /// Root mean square of the differences there.
    pub rms_mm: f64,
}

/// What to capture next, and what it would tell apart.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct NextMeasurement {
    /// Names it tells apart.
    pub separates: Vec<String>,
    /// The captures.
    pub captures: Vec<PlannedCapture>,
    /// Whether they are expected to leave one name, with odds of about 100 to 1.
    pub resolves: bool,
    /// The same in words.
    pub text: String,
}

impl NextMeasurement {
    /// The captures for people: each place once, with how often it is to be measured; and how many more places there are.
    pub fn places(&self) -> (Vec<Vec<String>>, usize) {
        /// Lines of a table that somebody reads.
        const MOST: usize = 30;
        let mut places: Vec<(Vec<String>, usize)> = Vec::new();
        for row in self.rows() {
            match places.iter_mut().find(|(known, _)| *known == row) {
                Some((_, times)) => *times += 1,
                None => places.push((row, 1)),
            }
        }
        let more = places.len().saturating_sub(MOST);
        places.truncate(MOST);
        let row = |(k, (mut row, times)): (usize, (Vec<String>, usize))| {
            row.push(if k == 0 { "times".to_owned() } else { times.to_string() });
            row
        };
        (places.into_iter().enumerate().map(row).collect(), more)
    }

    /// The captures as rows of text under the names of their columns.
    fn rows(&self) -> Vec<Vec<String>> {
        let Some(first) = self.captures.first() else { return Vec::new() };
        let names: Vec<&str> = first.0.keys().copied().collect();
        let row = |c: &PlannedCapture| names.iter().map(|n| short(&c.0[n])).collect();
        let head = names.iter().map(|n| (*n).to_owned()).collect();
        std::iter::once(head).chain(self.captures.iter().map(row)).collect()
    }

    /// The captures as a CSV table, for `simulate` or the machine.
    pub fn csv(&self) -> String {
        let mut writer = csv::Writer::from_writer(Vec::new());
        // Writing to memory cannot fail.
        self.rows().iter().for_each(|row| drop(writer.write_record(row)));
        String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
    }
}

/// A planned value as text.
fn short(setting: &Setting) -> String {
    match setting {
        Setting::Number(value) => value.to_string(),
        Setting::Name(name) => name.clone(),
    }
}

impl Report {
    /// The noise in words: where whole captures have an error of their own, without it and with it.
    pub fn noise_text(&self) -> String {
        /// As much more shows in two digits.
        const SHOWS: f64 = 1.05;
        let (point, all) = (1e3 * self.noise_mm, 1e3 * self.gap.noise_rms_mm);
        match self.kind == "rod" && all > SHOWS * point {
            true => {
                format!("noise {point:.2} µm a point, {all:.2} µm with its capture's own error")
            }
            false => format!("noise {point:.2} µm"),
        }
    }
}

/// What each effect's smallest visible size is on this plan.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Detectable {
    /// The library's name.
    pub name: String,
    /// Why it cannot be tested, if so.
    pub untestable: Option<String>,
    /// Smallest size seen with 95 % probability, per parameter of the simplest form.
    pub least: BTreeMap<String, f64>,
    /// Names whose signatures coincide (correlation over 0.98) on this plan.
    pub aliases: Vec<String>,
}

/// The whole answer.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// What kind of data.
    pub kind: String,
    /// What the diagnosis says.
    pub verdict: Verdict,
    /// Numbers of the control that named effects correct, where a machine file says what it holds.
    pub in_the_control: Vec<Entered>,
    /// Standard deviation of an observation.
    pub noise_mm: f64,
    /// Where the noise figure comes from.
    pub noise_source: String,
    /// Captures or poses.
    pub captures: usize,
    /// Values measured.
    pub observations: usize,
    /// Named effects, strongest first.
    pub effects: Vec<NamedEffect>,
    /// What has no name.
    pub unnamed: Vec<Unnamed>,
    /// The gap.
    pub gap: Gap,
    /// Where simulation and data disagree most.
    #[serde(rename = "where")]
    pub places: Vec<Where>,
    /// What to capture next to tell confusable effects apart.
    pub next_measurement: Option<NextMeasurement>,
    /// Values set aside as outliers.
    pub outliers: Vec<Outlier>,
    /// Effects that could not be tested, with the reason.
    pub untested: Vec<(String, String)>,
    /// p-value of the lack of fit that remains, where it can be tested.
    pub lack_of_fit_p: Option<f64>,
    /// What is to be doubted, in words: sizes that no machine has, repeats that are copies, captures out of place.
    #[serde(skip)]
    pub doubts: Vec<String>,
    /// Before and after, for plots.
    #[serde(skip)]
    pub residuals: Residuals,
}

/// A value that was set aside: it lies where neither the noise nor any effect has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
pub struct Outlier {
    /// Row of the data; the first below the header is 1, and copies of rows do not count.
    pub row: usize,
    /// Its column; null where it is read from several.
    pub column: Option<&'static str>,
}

/// Residuals for plots.
#[derive(Debug, Clone, Default)]
pub struct Residuals {
    /// With the baseline alone.
    pub before_mm: Vec<f64>,
    /// With the named effects.
    pub after_mm: Vec<f64>,
}
