//! The numbers of a result: characteristics with nominal, deviation and tolerance; lists; the uncertainty budget.

use serde_json::{Map, Value};

use super::words;
use crate::batch::limits::{number, u95_key};
use crate::output::flatten;
use crate::uncertainty::{K95, Verdict};

/// Rows of a list beyond this many stay in the result's file.
const MAX_ROWS: usize = 200;

/// One line of the results table.
pub struct Characteristic {
    name: String,
    unit: &'static str,
    nominal: Option<f64>,
    actual: f64,
    tolerance: String,
    u95: Option<f64>,
    verdict: Option<Verdict>,
}

impl Characteristic {
    /// Its cells, in the table's order.
    pub fn cells(&self) -> Vec<String> {
        let digits = digits(self.u95);
        let text = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.digits$}"));
        vec![
            if self.unit.is_empty() {
                self.name.clone()
            } else {
                format!("{}, {}", self.name, self.unit)
            },
            text(self.nominal),
            text(Some(self.actual)),
            self.nominal.map_or(String::new(), |n| format!("{:+.digits$}", self.actual - n)),
            self.tolerance.clone(),
            self.u95.map_or(String::new(), |u| format!("{u:.digits$}")),
            self.verdict.map_or(String::new(), |v| v.word().to_owned()),
        ]
    }
}

/// As many decimals as show the uncertainty with two digits, four to six where there is none or it is coarse.
fn digits(u95: Option<f64>) -> usize {
    let u95 = u95.filter(|u| *u > 0.0);
    u95.map_or(4, |u| (1.0 - u.log10().floor()).clamp(3.0, 6.0) as usize)
}

/// Every number that states its uncertainty, with nominal and tolerance where the result knows them, and
/// every limit that was judged.
pub fn characteristics(command: &str, result: &Value) -> Vec<Characteristic> {
    let Some(map) = result.as_object() else { return Vec::new() };
    let mut rows: Vec<Characteristic> = flatten(result)
        .into_iter()
        .filter_map(|(key, value)| {
            if key.starts_with("limits.")
                || key.starts_with("statistics.")
                || key.starts_with("rows.")
            {
                return None;
            }
            let u95 = u95_key(&key).and_then(|k| number(map, &k))?;
            let actual = value.as_f64()?;
            let tolerance = (command == "burn" && key == judged_key(map))
                .then(|| number(map, "tolerance_mm"))
                .flatten();
            Some(Characteristic {
                name: label(&key),
                unit: unit(&key),
                nominal: nominal(command, map, &key),
                actual,
                tolerance: tolerance.map_or(String::new(), |t| format!("≤ {t}")),
                u95: Some(u95),
                verdict: tolerance
                    .and_then(|_| serde_json::from_value(map.get("verdict")?.clone()).ok()),
            })
        })
        .collect();
    let judged = map.get("limits").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    rows.extend(judged.iter().filter_map(|limit| {
        let key = limit.get("key")?.as_str()?;
        let bound = |name: &str| limit.get(name).and_then(Value::as_f64);
        Some(Characteristic {
            name: format!("limit on {}", label(key)),
            unit: unit(key),
            nominal: None,
            actual: bound("value")?,
            tolerance: match (bound("min"), bound("max")) {
                (Some(min), Some(max)) => format!("{min} … {max}"),
                (Some(min), None) => format!("≥ {min}"),
                (None, max) => max.map_or(String::new(), |max| format!("≤ {max}")),
            },
            u95: bound("u95").filter(|u| *u > 0.0),
            verdict: serde_json::from_value(limit.get("verdict")?.clone()).ok(),
        })
    }));
    rows
}

/// Which of a burn's two readings of concentricity the tolerance is held against.
fn judged_key(map: &Map<String, Value>) -> &'static str {
    match map.get("tolerance_kind").and_then(Value::as_str) {
        Some("zone") => "zone_mm",
        _ => "distance_mm",
    }
}

fn nominal(command: &str, map: &Map<String, Value>, key: &str) -> Option<f64> {
    match (command, key) {
        ("burn", "offset_mm.0" | "offset_mm.1" | "distance_mm" | "zone_mm") => Some(0.0),
        ("rod", "diameter_mm") => number(map, "nominal_diameter_mm"),
        ("circles", _) if key.ends_with(".diameter_mm") => {
            number(map, &key.replace("diameter_mm", "expect_mm"))
        }
        ("circles", _) if key.starts_with("pairs.") => Some(0.0),
        _ => None,
    }
}

fn unit(key: &str) -> &'static str {
    let head = key.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('.');
    ["mm2", "mm", "deg", "rad", "px", "c", "s"]
        .into_iter()
        .find(|u| head.ends_with(&format!("_{u}")))
        .unwrap_or("")
}

/// `ring.center_mm.0` → `ring center X`.
fn label(key: &str) -> String {
    let parts: Vec<String> = key
        .split('.')
        .enumerate()
        .map(|(i, part)| match part.parse::<usize>() {
            Ok(n) if i + 1 == key.split('.').count() && n < 3 => ["X", "Y", "Z"][n].to_owned(),
            Ok(n) => format!("{}", n + 1),
            Err(_) => match unit(part) {
                "" => part.replace('_', " "),
                u => part.trim_end_matches(&format!("_{u}")).replace('_', " "),
            },
        })
        .collect();
    parts.join(" ")
}

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
pub fn lists(result: &Value) -> Vec<List> {
    let Some(map) = result.as_object() else { return Vec::new() };
    map.iter()
        .filter(|(key, _)| {
            !["limits", "circles", "pairs", "budget", "results"].contains(&key.as_str())
        })
        .filter_map(|(key, value)| {
            let items = value.as_array().filter(|l| l.first().is_some_and(Value::is_object))?;
            let mut head: Vec<String> = Vec::new();
            let objects = || items.iter().filter_map(Value::as_object);
            for name in objects().flat_map(Map::keys) {
                if !head.contains(name) {
                    head.push(name.clone());
                }
            }
            let rows =
                objects().take(MAX_ROWS).map(|o| head.iter().map(|h| short(o.get(h))).collect());
            let more = if items.len() > MAX_ROWS {
                format!(" (the first {MAX_ROWS} of {})", items.len())
            } else {
                String::new()
            };
            let title = key.replace('_', " ");
            Some(List {
                title: title[..1].to_uppercase() + &title[1..] + &more,
                rows: rows.collect(),
                head,
            })
        })
        .collect()
}

/// A number with as many digits as a table needs, anything else as words.
fn short(value: Option<&Value>) -> String {
    match value {
        Some(Value::Number(n)) if n.is_f64() => {
            let x = n.as_f64().unwrap_or(0.0);
            if x != 0.0 && (x.abs() < 1e-4 || x.abs() >= 1e6) {
                format!("{x:.2e}")
            } else {
                format!("{x:.5}")
            }
        }
        Some(Value::Array(list)) => {
            list.iter().map(|v| short(Some(v))).collect::<Vec<_>>().join(", ")
        }
        other => words(other),
    }
}

/// One source of uncertainty.
pub struct Contribution {
    /// Where it comes from.
    pub source: String,
    /// Its standard uncertainty in the result.
    pub u: f64,
    /// Of `u`.
    pub unit: String,
    /// Share of the variance.
    pub share_percent: f64,
}

/// The budget a result states (`budget`: source, a `u_…` or `value_u…` number, perhaps a share), or for a burn the
/// ring's and the spot's parts of the offset.
pub fn budget(command: &str, result: &Value) -> Vec<Contribution> {
    let Some(map) = result.as_object() else { return Vec::new() };
    let mut parts: Vec<Contribution> = match map.get("budget").and_then(Value::as_array) {
        Some(list) => list.iter().filter_map(Value::as_object).filter_map(stated).collect(),
        None if command == "burn" => ["ring", "spot"]
            .into_iter()
            .filter_map(|mark| {
                let u = |axis: usize| number(map, &format!("{mark}.center_u95_mm.{axis}"));
                let u = u(0)?.hypot(u(1)?) / K95;
                Some(Contribution {
                    source: format!("edge of the {mark}"),
                    u,
                    unit: "mm".into(),
                    share_percent: f64::NAN,
                })
            })
            .collect(),
        None => Vec::new(),
    };
    let sum: f64 = parts.iter().map(|p| p.u * p.u).sum();
    let one_unit = parts.windows(2).all(|w| w[0].unit == w[1].unit);
    for part in parts.iter_mut().filter(|p| !p.share_percent.is_finite()) {
        if one_unit && sum > 0.0 {
            part.share_percent = 100.0 * part.u * part.u / sum;
        }
    }
    parts
}

fn stated(entry: &Map<String, Value>) -> Option<Contribution> {
    let (key, u) = entry.iter().find_map(|(k, v)| {
        let name = k == "u" || k.starts_with("u_") || k.contains("_u_");
        v.as_f64().filter(|_| name).map(|u| (k, u))
    })?;
    let words_of = |k: &str| entry.get(k).map(|v| words(Some(v)));
    Some(Contribution {
        source: words_of("source").or_else(|| words_of("name"))?,
        u,
        unit: unit(key).to_owned(),
        share_percent: entry.get("share_percent").and_then(Value::as_f64).unwrap_or(f64::NAN),
    })
}
