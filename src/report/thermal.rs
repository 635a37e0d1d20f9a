//! The page of a thermal model: what the head's sensors and the screws' temperatures stand for, and how well that fits.

use serde_json::{Value, json};

use super::lists::List;
use super::numbers::Characteristic;
use crate::plot::Figure;
use crate::thermal::Model;

/// The model in a result of `thermal fit`; none where it is not one.
fn model(result: &Value) -> Option<Model> {
    let own = ["head", "head_axes", "screws"].map(|key| (key.to_owned(), result.get(key).cloned()));
    let own = own.into_iter().map(|(key, value)| (key, value.unwrap_or_default()));
    serde_json::from_value(json!(own.collect::<serde_json::Map<_, _>>())).ok()
}

/// Coefficients, the screws' law, and what the model leaves.
pub fn characteristics(result: &Value) -> Vec<Characteristic> {
    let Some(model) = model(result) else { return Vec::new() };
    let mut rows = Vec::new();
    let mut row = |name: String, unit: &'static str, value: f64, u95: Option<f64>| {
        rows.push(Characteristic::new(name, unit, value, u95.filter(|u| *u > 0.0)));
    };
    for s in &model.screws {
        let name = |what: &str| format!("{} screw: {what}", s.axis.to_uppercase());
        row(name("T0, no slope"), "°C", s.t0_c, Some(s.t0_u95_c));
        row(name("T max"), "°C", s.t_max_c, None);
        row(name("slope at T max"), "µm/m", s.tk_max_um_per_m, Some(s.tk_max_u95_um_per_m));
        row(name("P0, does not move"), "mm", s.p0_mm, Some(s.p0_u95_mm));
        row(name("error, rms"), "mm", s.before_rms_mm, None);
        row(name("left by the law, rms"), "mm", s.after_rms_mm, None);
    }
    if let Some(head) = &model.head {
        for c in &head.coefficients {
            let name = format!("head sensor {}", c.sensor);
            row(name, "µm/°C", 1e3 * c.mm_per_c, Some(1e3 * c.mm_per_c_u95));
        }
        if head.has_constant {
            row("head: constant".into(), "mm", head.constant_mm, None);
        }
        row("head: displacement, rms".into(), "mm", head.before_rms_mm, None);
        row("head: left by the model, rms".into(), "mm", head.after_rms_mm, None);
        row("head: left on rows not seen, rms".into(), "mm", head.held_out_rms_mm, None);
    }
    rows
}

/// The slopes behind the laws, and where the head was calibrated.
pub fn lists(result: &Value) -> Vec<List> {
    let Some(model) = model(result) else { return Vec::new() };
    let slopes = model.screws.iter().flat_map(|s| {
        s.slopes.iter().map(|l| {
            let slope = [l.slope_um_per_m, l.slope_u95_um_per_m].map(|x| format!("{x:.2}"));
            let [slope, u95] = slope;
            vec![s.axis.to_uppercase(), format!("{:.2}", l.screw_c), slope, u95]
        })
    });
    let slopes = List {
        title: "Slopes of the screws".into(),
        head: ["", "Screw, °C", "Slope, µm/m", "U (95 %)"].map(String::from).into(),
        rows: slopes.collect(),
    };
    let rises = model.head.iter().flat_map(|h| &h.coefficients).map(|c| {
        let [low, high] = c.range_c.map(|t| format!("{t:.1}"));
        vec![c.sensor.to_string(), low, high]
    });
    let rises = List {
        title: "Rises of the head that were calibrated".into(),
        head: ["Sensor", "from, °C", "to, °C"].map(String::from).into(),
        rows: rises.collect(),
    };
    [slopes, rises].into_iter().filter(|list| !list.rows.is_empty()).collect()
}

/// The slopes over temperature with the laws through them.
pub fn figure(result: &Value) -> Option<Figure> {
    model(result).filter(|m| !m.screws.is_empty()).map(|m| m.figure())
}

/// What to do next.
pub fn next() -> Vec<String> {
    vec![
        "Correct by the model: pivotsight thermal compensate --model FILE, with this result as FILE.".into(),
        "Check it on rows that it has not seen, warming up and cooling down: pivotsight thermal compensate --model FILE --table CSV.".into(),
    ]
}
