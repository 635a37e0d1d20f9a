//! The lists of a result as tables: rows of a sweep, effects of a diagnosis, vectors, statistics of a batch.

use serde_json::{Map, Value};

use super::numbers::unit;
use super::{ballbar, history, thermal, words};
use crate::uncertainty::text;

/// Rows of a list beyond this many stay in the result's file.
pub const MAX_ROWS: usize = 200;
/// Poses of a sweep shown, the farthest astray first.
const MAX_POSES: usize = 12;

/// Decimals of a length in mm.
const PLACES: usize = 4;

/// A list of a result as a table.
pub struct List {
    /// Its heading.
    pub title: String,
    /// Its columns.
    pub head: Vec<String>,
    /// Its rows.
    pub rows: Vec<Vec<String>>,
}

/// The lists of objects in a result: rows of a sweep, effects of a diagnosis, statistics of a batch.
pub fn lists(command: &str, result: &Value) -> Vec<List> {
    let shown = ["limits", "circles", "pairs", "budget", "results", "records"];
    match command {
        "ballbar-decouple" => return ballbar::lists(result),
        "thermal-fit" => return thermal::lists(result),
        _ => {}
    }
    let sized = (command == "diagnose").then(|| with_uncertainties(result));
    let Some(map) = sized.as_ref().unwrap_or(result).as_object() else { return Vec::new() };
    let vectors: Vec<Vec<String>> = (1..=4)
        .filter_map(|i| {
            let vector = map.get(&format!("i{i}_mm"))?.as_array()?;
            let cells = vector.iter().map(|v| short("mm", PLACES, Some(v)));
            Some(std::iter::once(format!("I{i}")).chain(cells).collect())
        })
        .collect();
    let vectors = (!vectors.is_empty()).then(|| List {
        title: "Vectors".into(),
        head: ["", "X, mm", "Y, mm", "Z, mm"].map(String::from).into(),
        rows: vectors,
    });
    let nested = map.get("change").and_then(Value::as_object).into_iter().flatten();
    let others = map
        .iter()
        .filter(|(key, _)| !shown.contains(&key.as_str()))
        .chain(nested)
        .filter_map(|(key, value)| {
            let mut items: Vec<&Map<String, Value>> =
                value.as_array()?.iter().filter_map(Value::as_object).collect();
            let all = items.len();
            let most = if (command, key.as_str()) == ("verify", "rows") {
                items.sort_by(|a, b| length(b.get("left_mm")).total_cmp(&length(a.get("left_mm"))));
                MAX_POSES
            } else {
                MAX_ROWS
            };
            items.truncate(most);
            let mut head: Vec<String> = Vec::new();
            for name in items.iter().flat_map(|item| item.keys()) {
                if !head.contains(name) {
                    head.push(name.clone());
                }
            }
            let places: Vec<usize> = head.iter().map(|h| places(&items, h)).collect();
            let rows: Vec<Vec<String>> = items
                .iter()
                .map(|o| {
                    head.iter().zip(&places).map(|(h, &p)| short(unit(h), p, o.get(h))).collect()
                })
                .collect();
            let head: Vec<String> = head.iter().map(|h| heading(h)).collect();
            let title = match (command, key.as_str()) {
                ("verify", "rows") => "Poses farthest astray".to_owned(),
                ("solve", "values") => "What changes in the control".to_owned(),
                ("solve", "removes") => {
                    "Error of the tool point with the present values, seen from B = 0".to_owned()
                }
                ("diagnose", "where") => "Where simulation and data disagree most".to_owned(),
                ("simulate", _) => "Predicted".to_owned(),
                _ => capital(&key.replace('_', " ")),
            };
            let more =
                if all > items.len() { format!(" ({most} of {all})") } else { String::new() };
            (!rows.is_empty()).then(|| List { title: title + &more, head, rows })
        });
    let records = (command == "history").then(|| history::list(result));
    vectors.into_iter().chain(others).chain(records).collect()
}

/// A diagnosis with each parameter's uncertainty beside it, in as many digits as that has.
fn with_uncertainties(result: &Value) -> Value {
    let mut result = result.clone();
    for effect in result.get_mut("effects").and_then(Value::as_array_mut).into_iter().flatten() {
        let Some(effect) = effect.as_object_mut() else { continue };
        let u95 = effect.shift_remove("parameters_u95").unwrap_or_default();
        let Some(Value::Object(parameters)) = effect.get_mut("parameters") else { continue };
        for (name, value) in parameters {
            let sure = value.as_f64().zip(u95.get(name).and_then(Value::as_f64));
            if let Some((number, u95)) = sure {
                *value = text(number, u95).into();
            }
        }
    }
    result
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// `left_mm` → `left, mm`.
fn heading(key: &str) -> String {
    match unit(key) {
        "" => key.replace('_', " "),
        u => format!("{}, {u}", key.trim_end_matches(&format!("_{u}")).replace('_', " ")),
    }
}

fn length(vector: Option<&Value>) -> f64 {
    let parts = vector.and_then(Value::as_array).into_iter().flatten();
    parts.filter_map(Value::as_f64).map(|x| x * x).sum::<f64>().sqrt()
}

/// Decimals of a column: more where all of its lengths are small.
fn places(items: &[&Map<String, Value>], key: &str) -> usize {
    fn largest(value: &Value) -> f64 {
        match value {
            Value::Array(list) => list.iter().map(largest).fold(0.0, f64::max),
            _ => value.as_f64().map_or(0.0, f64::abs),
        }
    }
    match items.iter().filter_map(|o| o.get(key)).map(largest).fold(0.0, f64::max) {
        x if x >= 0.02 => PLACES,
        x if x >= 0.002 => PLACES + 1,
        _ => PLACES + 2,
    }
}

/// A number with as many digits as its unit needs, lengths with so many decimals, anything else as words.
fn short(unit: &str, places: usize, value: Option<&Value>) -> String {
    match value {
        Some(Value::Number(n)) if n.is_f64() => {
            let x = n.as_f64().unwrap_or(0.0);
            match unit {
                "mm" => {
                    let unit = 10f64.powi(places as i32);
                    // Adding zero turns -0 into 0.
                    format!("{:.places$}", (unit * x).round() / unit + 0.0)
                }
                "deg" => format!("{:.4}", (1e4 * x).round() / 1e4 + 0.0)
                    .trim_end_matches('0')
                    .trim_end_matches('.')
                    .to_owned(),
                _ if x != 0.0 && (x.abs() < 1e-3 || x.abs() >= 1e6) => format!("{x:.2e}"),
                _ => format!("{x:.4}"),
            }
        }
        // An axis without limits has two that are null.
        Some(Value::Array(list)) if list.iter().all(Value::is_null) => String::new(),
        Some(Value::Array(list)) => {
            list.iter().map(|v| short(unit, places, Some(v))).collect::<Vec<_>>().join(", ")
        }
        Some(Value::Object(map)) => {
            let pairs = map
                .iter()
                .map(|(k, v)| format!("{}: {}", heading(k), short(self::unit(k), PLACES, Some(v))));
            pairs.collect::<Vec<_>>().join("; ")
        }
        other => words(other),
    }
}
