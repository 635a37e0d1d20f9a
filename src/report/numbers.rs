//! The numbers of a result: characteristics with nominal, deviation and tolerance; lists; the uncertainty budget.

use serde_json::{Map, Value};

use super::words;
use crate::batch::limits::{number, u95_key};
use crate::error::{Error, Result};
use crate::output::flatten;
use crate::uncertainty::Verdict;

/// Rows of a list beyond this many stay in the result's file.
const MAX_ROWS: usize = 200;
/// Poses of a sweep shown, the farthest astray first.
const MAX_POSES: usize = 12;
/// Sources of a budget shown, the largest first.
const MAX_SOURCES: usize = 12;

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

/// As many decimals as show the uncertainty with two digits, from three to six; four where there is none.
fn digits(u95: Option<f64>) -> usize {
    let u95 = u95.filter(|u| *u > 0.0);
    u95.map_or(4, |u| (1.0 - u.log10().floor()).clamp(3.0, 6.0) as usize)
}

/// Every number that states its uncertainty, with nominal and tolerance where the result knows them, and
/// every limit that was judged.
pub fn characteristics(command: &str, result: &Value) -> Vec<Characteristic> {
    let Some(map) = result.as_object() else { return Vec::new() };
    if command == "verify" {
        return verified(map);
    }
    let mut rows: Vec<Characteristic> = flatten(result)
        .into_iter()
        .filter_map(|(key, value)| {
            if ["limits.", "statistics.", "rows."].iter().any(|list| key.starts_with(list)) {
                return None;
            }
            let u95 = u95_key(&key).and_then(|k| number(map, &k))?;
            let actual = value.as_f64()?;
            let tolerance = (judged_key(command, map) == Some(key.as_str()))
                .then(|| number(map, "tolerance_mm"))
                .flatten();
            Some(Characteristic {
                name: axis_or_rod(result, label(&key)),
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
    if command == "diagnose" {
        rows.extend(gap(map));
    }
    let judged = map.get("limits").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    rows.extend(judged.iter().filter_map(|limit| {
        let bound = |name: &str| limit.get(name).and_then(Value::as_f64);
        if let Some(what) = limit.get("what").and_then(Value::as_str) {
            // A step of the method, not a key of the result.
            return Some(Characteristic {
                name: what.to_owned(),
                unit: "mm",
                nominal: None,
                actual: bound("value_mm")?,
                tolerance: format!("≤ {}", bound("limit_mm")?),
                u95: bound("u95_mm"),
                verdict: serde_json::from_value(limit.get("verdict")?.clone()).ok(),
            });
        }
        let key = limit.get("key")?.as_str()?;
        Some(Characteristic {
            name: format!("limit on {}", axis_or_rod(result, label(key))),
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

/// The characteristics of a picture that keep their limits not for sure, in words.
pub fn broken(row: &Value) -> Vec<String> {
    let command = if row.get("correction").is_some() { "burn" } else { "" };
    let rows = characteristics(command, row).into_iter();
    let broken = rows.filter(|c| c.verdict.is_some_and(|v| v != Verdict::Pass));
    broken
        .map(|c| {
            let digits = digits(c.u95);
            let u95 = c.u95.map_or(String::new(), |u| format!(" ± {u:.digits$}"));
            format!("{} {:.digits$}{u95} {}, limit {}", c.name, c.actual, c.unit, c.tolerance)
        })
        .collect()
}

/// The largest deviation of a sweep as measured, and what the machine's model leaves of it.
fn verified(map: &Map<String, Value>) -> Vec<Characteristic> {
    let row = |key: &str, name: &str| {
        Some(Characteristic {
            name: name.to_owned(),
            unit: "mm",
            nominal: Some(0.0),
            actual: number(map, key)?,
            tolerance: String::new(),
            u95: None,
            verdict: None,
        })
    };
    let judged =
        row("worst_mm", "largest true deviation of what is judged").map(|judged| Characteristic {
            tolerance: number(map, "tolerance_mm").map_or(String::new(), |t| format!("≤ {t}")),
            u95: number(map, "worst_u95_mm"),
            verdict: map.get("verdict").and_then(|v| serde_json::from_value(v.clone()).ok()),
            ..judged
        });
    let seen = row("before.worst_mm", "largest deviation measured");
    let left = row("after.worst_mm", "largest deviation the model leaves");
    [seen, left, judged].into_iter().flatten().collect()
}

/// The gap between simulation and measurement, before and after the named effects.
fn gap(map: &Map<String, Value>) -> Vec<Characteristic> {
    [
        ("gap.before_rms_mm", "gap before, rms"),
        ("gap.after_rms_mm", "gap with the named effects, rms"),
        ("gap.heldout_before_rms_mm", "gap before, on captures held out, rms"),
        ("gap.heldout_after_rms_mm", "gap with the named effects, on captures held out, rms"),
        ("noise_mm", "noise of one value"),
    ]
    .into_iter()
    .filter_map(|(key, name)| {
        Some(Characteristic {
            name: name.into(),
            unit: "mm",
            nominal: None,
            actual: number(map, key)?,
            tolerance: String::new(),
            u95: None,
            verdict: None,
        })
    })
    .collect()
}

/// Which of a burn's two readings of concentricity the tolerance is held against.
fn judged_key(command: &str, map: &Map<String, Value>) -> Option<&'static str> {
    match (command, map.get("tolerance_kind").and_then(Value::as_str)) {
        ("burn", Some("zone")) => Some("zone_mm"),
        ("burn", _) => Some("distance_mm"),
        ("rotary", _) => Some("summary.before_max_mm"),
        _ => None,
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
        ("solve", "check_touch.difference_mm") => Some(0.0),
        ("solve", _) => {
            // What the control holds now.
            let name = if key == "zb_mm" { "zc_mm" } else { key };
            let values = map.get("change")?.get("values")?.as_array()?;
            values.iter().find(|v| v.get("name").is_some_and(|n| n == name))?.get("now")?.as_f64()
        }
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

/// A length or an angle that is no number was not written by this program, and would be missing on the page.
pub fn refuse_text(key: &str, value: &Value) -> Result<()> {
    match value {
        Value::String(text) if matches!(unit(key), "mm" | "mm2" | "deg" | "px") => {
            Err(Error::measure(
                "report",
                format!("{key} is '{text}', not a number"),
                "give the result as the command wrote it",
            ))
        }
        Value::Array(list) => {
            list.iter().enumerate().try_for_each(|(i, v)| refuse_text(&format!("{key}.{i}"), v))
        }
        Value::Object(map) => {
            map.iter().try_for_each(|(k, v)| refuse_text(&format!("{key}.{k}"), v))
        }
        _ => Ok(()),
    }
}

/// At one table angle a rod's centre stands for the C axis, and is called what it is.
fn axis_or_rod(result: &Value, label: String) -> String {
    match result.get("axis_separated") {
        Some(Value::Bool(false)) => label.replacen("C axis", "rod's centre", 1),
        _ => label,
    }
}

/// `ring.center_mm.0` → `ring center X`; the method's own quantities as its text names them.
fn label(key: &str) -> String {
    match key {
        "xb_mm" => return "X_B, B axis over the rod".into(),
        "zb_mm" => return "Z_B, nozzle on the table".into(),
        "xc_mm" => return "X_C, C axis".into(),
        "yc_mm" => return "Y_C, C axis".into(),
        "delta_x_mm" => return "ΔX, B axis to optical axis".into(),
        "r_mm" => return "R, B axis to nozzle".into(),
        "r_focus_mm" => return "R + stand-off, B axis to focus".into(),
        "axis_center_mm.0" => return "C axis X".into(),
        "axis_center_mm.1" => return "C axis Y".into(),
        "axis_center_mm" => return "C axis".into(),
        "worst_mm" => return "largest true deviation".into(),
        "summary.before_max_mm" => return "largest deviation measured".into(),
        _ => {}
    }
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
pub fn lists(command: &str, result: &Value) -> Vec<List> {
    let shown = ["limits", "circles", "pairs", "budget", "results"];
    let Some(map) = result.as_object() else { return Vec::new() };
    let vectors: Vec<Vec<String>> = (1..=4)
        .filter_map(|i| {
            let vector = map.get(&format!("i{i}_mm"))?.as_array()?;
            let cells = vector.iter().map(|v| short("mm", Some(v)));
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
            let rows: Vec<Vec<String>> = items
                .iter()
                .map(|o| head.iter().map(|h| short(unit(h), o.get(h))).collect())
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
    vectors.into_iter().chain(others).collect()
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

/// A number with as many digits as its unit needs, anything else as words.
fn short(unit: &str, value: Option<&Value>) -> String {
    match value {
        Some(Value::Number(n)) if n.is_f64() => {
            let x = n.as_f64().unwrap_or(0.0);
            match unit {
                // Adding zero turns -0 into 0.
                "mm" => format!("{:.4}", (1e4 * x).round() / 1e4 + 0.0),
                "deg" => format!("{:.4}", (1e4 * x).round() / 1e4 + 0.0)
                    .trim_end_matches('0')
                    .trim_end_matches('.')
                    .to_owned(),
                _ if x != 0.0 && (x.abs() < 1e-3 || x.abs() >= 1e6) => format!("{x:.2e}"),
                _ => format!("{x:.4}"),
            }
        }
        Some(Value::Array(list)) => {
            list.iter().map(|v| short(unit, Some(v))).collect::<Vec<_>>().join(", ")
        }
        Some(Value::Object(map)) => {
            let pairs = map
                .iter()
                .map(|(k, v)| format!("{}: {}", heading(k), short(self::unit(k), Some(v))));
            pairs.collect::<Vec<_>>().join("; ")
        }
        other => words(other),
    }
}

/// The budget of one value: where its uncertainty comes from.
pub struct Budget {
    /// The value, in words.
    pub of: String,
    /// Source, standard uncertainty, share.
    pub rows: Vec<Vec<String>>,
}

/// The budgets a result states, one a value.
pub fn budgets(result: &Value) -> Vec<Budget> {
    let stated = result.get("budget").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let mut budgets: Vec<Budget> = Vec::new();
    for part in stated {
        let text = |key: &str| part.get(key).and_then(Value::as_str).unwrap_or("");
        let number = |key: &str| part.get(key).and_then(Value::as_f64).unwrap_or(f64::NAN);
        let of = axis_or_rod(result, label(text("of")));
        if budgets.last().is_none_or(|b| b.of != of) {
            budgets.push(Budget { of, rows: Vec::new() });
        }
        let rows = budgets.last_mut().map(|b| &mut b.rows);
        if let Some(rows) = rows.filter(|rows| rows.len() < MAX_SOURCES) {
            let u = format!("{:.5} mm", number("u_mm"));
            rows.push(vec![text("source").into(), u, format!("{:.0} %", number("share_percent"))]);
        }
    }
    budgets
}
