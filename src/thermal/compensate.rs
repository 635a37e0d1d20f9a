//! Corrections from a model, one reading at a time, with flags where the reading is outside what was calibrated.

use std::collections::{BTreeMap, HashMap};
use std::marker::PhantomData;

use serde::de::{Deserializer, Error as _, MapAccess, Visitor};
use serde::{Deserialize, Serialize};

use super::Model;
use super::head::{Head, Predictor};
use crate::error::{self, Error};
use crate::table::Table;

/// Readings further outside the calibrated range than its width plus this are no temperatures of a working sensor.
const IMPLAUSIBLE_C: f64 = 20.0;
/// Part of the calibrated range a reading may lie outside without a flag.
const MARGIN: f64 = 0.05;

/// What the control sends.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(
    expecting = "an object such as {\"position_mm\":{\"x\":1},\"screw_c\":{\"x\":20},\"head_c\":[20]}"
)]
pub struct Request {
    /// Position of each axis to correct.
    #[serde(deserialize_with = "each_once")]
    pub position_mm: BTreeMap<String, f64>,
    /// Screw temperature of each axis; `null` where the sensor gives nothing.
    #[serde(default, deserialize_with = "each_once")]
    pub screw_c: BTreeMap<String, Option<f64>>,
    /// All head sensors in their order; `null` where one gives nothing.
    #[serde(default)]
    pub head_c: Vec<Option<f64>>,
    /// Anything else: refused unless it begins with `x_` or `x-`.
    #[serde(flatten)]
    other: BTreeMap<String, serde_json::Value>,
}

/// A value for each axis, whose letter may be of either case; an axis that stands twice is refused.
fn each_once<'de, D: Deserializer<'de>, V: Deserialize<'de>>(
    from: D,
) -> Result<BTreeMap<String, V>, D::Error> {
    struct Axes<V>(PhantomData<V>);
    impl<'de, V: Deserialize<'de>> Visitor<'de> for Axes<V> {
        type Value = BTreeMap<String, V>;
        fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
            f.write_str("an object with a value for each axis")
        }
        fn visit_map<A: MapAccess<'de>>(self, mut given: A) -> Result<Self::Value, A::Error> {
            let mut axes = BTreeMap::<String, V>::new();
            while let Some((name, value)) = given.next_entry::<String, V>()? {
                if axes.keys().any(|k| k.eq_ignore_ascii_case(&name)) {
                    return Err(A::Error::custom(format!("axis '{name}' stands twice")));
                }
                axes.insert(name, value);
            }
            Ok(axes)
        }
    }
    from.deserialize_map(Axes(PhantomData))
}

/// What the control gets.
#[derive(Debug, Clone, Default, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Answer {
    /// To be added to each axis' position; `null` where it cannot be told.
    pub correction_mm: BTreeMap<String, Option<f64>>,
    /// Half-width of the 95 % interval for what is left.
    pub correction_u95_mm: BTreeMap<String, f64>,
    /// What was wrong, empty when nothing was.
    pub flags: Vec<String>,
}

/// How unusual readings are treated.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options {
    /// A sensor whose reading has not changed at all while another has moved by this much is stuck; `None`: never.
    pub stuck_c: Option<f64>,
}

/// A model at work: keeps the predictors for the sensors that live and the last readings.
#[derive(Debug)]
pub struct Compensator {
    model: Model,
    options: Options,
    /// By which sensors live.
    predictors: HashMap<Vec<bool>, Option<Predictor>>,
    /// For each sensor: its last reading and the others' readings when it last changed.
    held: Vec<(f64, Vec<Option<f64>>)>,
}

impl Compensator {
    /// Ready to answer.
    pub fn new(model: Model, options: Options) -> Self {
        Self { model, options, predictors: HashMap::new(), held: Vec::new() }
    }

    /// Refuses a table of readings with so many head sensors that this model could correct nothing by.
    pub fn accepts(&self, table: &Table, sensors: usize) -> error::Result<()> {
        let needed = self.model.head.as_ref().map_or(0, |head| head.sensors);
        let does_without = sensors == 0 && !self.model.head_axes.is_empty();
        if needed > 0 && sensors != needed && !does_without {
            let reason = format!("has {sensors} head sensors where the model has {needed}");
            let fix = format!("give head_1_c to head_{needed}_c, empty where a sensor is dead");
            return Err(Error::file(table.path(), reason, fix));
        }
        if !self.model.screws.is_empty() && !table.has("screw_c") {
            let fix = "add the screws' temperatures";
            return Err(Error::field(table.path(), None, "column 'screw_c'", "is missing", fix));
        }
        Ok(())
    }

    /// Answers one JSON line; a line that cannot be read gets the flag `bad-line` and no correction.
    pub fn answer_line(&mut self, line: &str) -> Answer {
        // A file's first line may begin with a byte order mark.
        match serde_json::from_str::<Request>(line.trim_start_matches('\u{feff}')) {
            Ok(request) => self.answer(&request),
            Err(e) => Answer { flags: vec![format!("bad-line: {e}")], ..Answer::default() },
        }
    }

    /// Answers one reading.
    pub fn answer(&mut self, request: &Request) -> Answer {
        let mut flags = Vec::new();
        if let Some(key) =
            request.other.keys().find(|k| !k.starts_with("x_") && !k.starts_with("x-"))
        {
            return Answer {
                flags: vec![format!("bad-line: unknown key '{key}'")],
                ..Answer::default()
            };
        }
        let head = self.head(&request.head_c, &mut flags);
        let mut answer = Answer::default();
        for (axis, &position_mm) in &request.position_mm {
            let of_axis = request.screw_c.iter().find(|(name, _)| name.eq_ignore_ascii_case(axis));
            let screw_c = of_axis.and_then(|(_, t)| *t).filter(|t| t.is_finite());
            let moved = self.screw(axis, position_mm, screw_c, &mut flags);
            let acts = self.model.head_axes.is_empty()
                || self.model.head_axes.iter().any(|a| a.eq_ignore_ascii_case(axis));
            let head = if acts { head } else { Some((0.0, 0.0)) };
            let total = head.zip(moved).map(|((h, hu), (s, su))| (h + s, hu.hypot(su)));
            answer.correction_mm.insert(axis.clone(), total.map(|t| -t.0));
            if let Some((_, u95)) = total {
                answer.correction_u95_mm.insert(axis.clone(), u95);
            }
        }
        answer.flags = flags;
        answer
    }

    /// The screw's deviation; outside the calibrated temperatures the slope is held at the nearest limit, and what the law would add
    /// beyond is in the interval. None where no screw was calibrated at all: the model is of the head.
    fn screw(
        &self,
        axis: &str,
        position_mm: f64,
        screw_c: Option<f64>,
        flags: &mut Vec<String>,
    ) -> Option<(f64, f64)> {
        if self.model.screws.is_empty() {
            return Some((0.0, 0.0));
        }
        let Some(screw) = self.model.screws.iter().find(|s| s.axis.eq_ignore_ascii_case(axis))
        else {
            flags.push(format!("axis-not-calibrated:{axis}"));
            return None;
        };
        let Some(t) = screw_c else {
            flags.push(format!("screw-missing:{axis}"));
            return None;
        };
        // Beyond a kilometre no axis goes: a number that was torn or in another unit.
        if position_mm.is_nan() || position_mm.abs() > 1e6 {
            flags.push(format!("position-missing:{axis}"));
            return None;
        }
        if is_implausible(t, [screw.t0_c, screw.t_max_c]) {
            flags.push(format!("screw-dead:{axis}"));
            return None;
        }
        // T0 is known to its own uncertainty only: a screw as cold as that is no fault.
        let lowest_c = screw.lowest_c();
        if t < screw.t0_c - screw.t0_u95_c {
            flags.push(format!("screw-below-t0:{axis}"));
        }
        if t > screw.t_max_c + 1e-9 {
            flags.push(format!("screw-above-tmax:{axis}"));
        }
        let margin = MARGIN * (screw.range_mm[1] - screw.range_mm[0]);
        if position_mm < screw.range_mm[0] - margin || position_mm > screw.range_mm[1] + margin {
            flags.push(format!("position-out-of-range:{axis}"));
        }
        let held_c = t.clamp(lowest_c, screw.t_max_c);
        let (deviation, u95) = screw.deviation(held_c, position_mm);
        // If the law goes on this is all missing: no scatter that would add up in squares.
        let beyond = screw.deviation(t, position_mm).0 - deviation;
        Some((deviation, u95 + beyond.abs()))
    }

    /// The head's displacement, from the sensors that live.
    fn head(&mut self, readings: &[Option<f64>], flags: &mut Vec<String>) -> Option<(f64, f64)> {
        let Some(head) = &self.model.head else { return Some((0.0, 0.0)) };
        if readings.len() != head.sensors {
            flags.push(format!(
                "head-sensors: {} given, {} calibrated",
                readings.len(),
                head.sensors
            ));
            return None;
        }
        let stuck = match self.options.stuck_c {
            Some(limit) => stuck(&mut self.held, readings, limit),
            None => Vec::new(),
        };
        let mut living = vec![false; head.sensors];
        for c in &head.coefficients {
            let i = c.sensor - 1;
            let range = c.range_c[1] - c.range_c[0];
            match rise(head, i, readings) {
                Some(_) if stuck.get(i) == Some(&true) => {
                    flags.push(format!("head-stuck:{}", c.sensor))
                }
                Some(t) => {
                    if is_implausible(t, c.range_c) {
                        flags.push(format!("head-dead:{}", c.sensor));
                        continue;
                    }
                    if outside_c(t, c.range_c) > MARGIN * range {
                        flags.push(format!("head-out-of-range:{}", c.sensor));
                    }
                    living[i] = true;
                }
                None => flags.push(format!("head-dead:{}", c.sensor)),
            }
        }
        let of_living = |living: &Vec<bool>| head.predictor(|i| living[i]);
        let predictor = self.predictors.entry(living).or_insert_with_key(of_living);
        if predictor.is_none() {
            flags.push("head-unknown".to_owned());
        }
        // Column `sensors` is the constant.
        let value =
            |i: usize| if i == head.sensors { 1.0 } else { rise(head, i, readings).unwrap_or(0.0) };
        predictor.as_ref().map(|p| p.predict(value))
    }
}

/// How far a temperature lies outside the calibrated range.
fn outside_c(t_c: f64, [low_c, high_c]: [f64; 2]) -> f64 {
    (low_c - t_c).max(t_c - high_c)
}

/// Whether a reading is no temperature of a working sensor.
fn is_implausible(t_c: f64, [low_c, high_c]: [f64; 2]) -> bool {
    outside_c(t_c, [low_c, high_c]) > high_c - low_c + IMPLAUSIBLE_C
}

/// A sensor's rise above the cold state.
fn rise(head: &Head, sensor: usize, readings: &[Option<f64>]) -> Option<f64> {
    let cold = head.cold_c.get(sensor).copied().unwrap_or(0.0);
    readings[sensor].filter(|t| t.is_finite()).map(|t| t - cold)
}

/// Which sensors have stood still while another moved by `limit`.
fn stuck(
    held: &mut Vec<(f64, Vec<Option<f64>>)>,
    readings: &[Option<f64>],
    limit: f64,
) -> Vec<bool> {
    held.resize(readings.len(), (f64::NAN, Vec::new()));
    let mut stuck = vec![false; readings.len()];
    for (i, reading) in readings.iter().enumerate() {
        let Some(value) = reading else { continue };
        if held[i].0 != *value {
            held[i] = (*value, readings.to_vec());
            continue;
        }
        stuck[i] = readings
            .iter()
            .zip(&held[i].1)
            .filter_map(|(now, then)| now.zip(*then))
            .any(|(now, then)| (now - then).abs() > limit);
    }
    stuck
}
