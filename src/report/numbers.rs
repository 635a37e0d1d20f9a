//! The numbers of a result: characteristics with nominal, deviation and tolerance; the uncertainty budget.

use serde_json::{Map, Value};

use super::{ballbar, thermal};
use crate::batch::limits::{number, u95_key};
use crate::error::{Error, Result};
use crate::output::flatten;
use crate::uncertainty::Verdict;

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
    /// What was measured, with neither nominal nor limit.
    pub fn new(name: String, unit: &'static str, actual: f64, u95: Option<f64>) -> Self {
        let tolerance = String::new();
        Self { name, unit, nominal: None, actual, tolerance, u95, verdict: None }
    }

    /// Its cells, in the table's order.
    pub fn cells(&self) -> Vec<String> {
        let digits = digits(self.u95, self.actual);
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

/// As many decimals as show the uncertainty with two digits, three at least; where there is none, the value itself, four at least.
fn digits(u95: Option<f64>, actual: f64) -> usize {
    const MOST: f64 = 9.0;
    let two_of = |x: f64, least: f64| (1.0 - x.abs().log10().floor()).clamp(least, MOST) as usize;
    match u95.filter(|u| *u > 0.0) {
        Some(u95) => two_of(u95, 3.0),
        None if actual != 0.0 => two_of(actual, 4.0),
        None => 4,
    }
}

/// Every number that states its uncertainty, with nominal and tolerance where the result knows them, and
/// every limit that was judged.
pub fn characteristics(command: &str, result: &Value) -> Vec<Characteristic> {
    let Some(map) = result.as_object() else { return Vec::new() };
    match command {
        "verify" => return verified(map),
        "ballbar-decouple" => return ballbar::characteristics(result),
        "thermal-fit" => return thermal::characteristics(result),
        _ => {}
    }
    let mut rows: Vec<Characteristic> = flatten(result)
        .into_iter()
        .filter_map(|(key, value)| {
            if ["limits.", "statistics.", "rows.", "records.", "drift."]
                .iter()
                .any(|list| key.starts_with(list))
            {
                return None;
            }
            let u95 = u95_key(&key).and_then(|k| number(map, &k))?;
            let actual = value.as_f64()?;
            let (tolerance, verdict) = judged(command, map, &key);
            Some(Characteristic {
                name: name_of(result, &key),
                unit: unit(&key),
                nominal: nominal(command, map, &key),
                actual,
                tolerance: tolerance.map_or(String::new(), |t| format!("≤ {t}")),
                u95: Some(u95),
                verdict,
            })
        })
        .collect();
    match command {
        "diagnose" => rows.extend(gap(map)),
        "calib-plane" => rows.extend(plane(map)),
        "calib-camera" => rows.extend(
            [("rms_px", "rms of all corners"), ("coverage", "part of the frame seen")]
                .into_iter()
                .filter_map(|(key, name)| plain(map, key, name)),
        ),
        "center" => rows.extend(moves(map)),
        _ => {}
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
            name: format!("limit on {}", name_of(result, key)),
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
            let digits = digits(c.u95, c.actual);
            let u95 = c.u95.map_or(String::new(), |u| format!(" ± {u:.digits$}"));
            format!("{} {:.digits$}{u95} {}, limit {}", c.name, c.actual, c.unit, c.tolerance)
        })
        .collect()
}

/// The largest deviation of a sweep as measured, and what the machine's model leaves of it.
fn verified(map: &Map<String, Value>) -> Vec<Characteristic> {
    let row = |key: &str, name: &str| {
        Some(Characteristic { nominal: Some(0.0), ..plain(map, key, name)? })
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
fn gap(map: &Map<String, Value>) -> impl Iterator<Item = Characteristic> {
    let rows = [
        ("gap.before_rms_mm", "gap before, rms"),
        ("gap.after_rms_mm", "gap with the named effects, rms"),
        ("gap.heldout_before_rms_mm", "gap before, on captures held out, rms"),
        ("gap.heldout_after_rms_mm", "gap with the named effects, on captures held out, rms"),
        ("noise_mm", "noise of one value"),
    ];
    rows.into_iter().filter_map(|(key, name)| plain(map, key, name))
}

/// The scale of a plane, and how far its map may be off in the frame.
fn plane(map: &Map<String, Value>) -> impl Iterator<Item = Characteristic> {
    let of = |key: &str, u95: &str, name: &str| {
        Some(Characteristic { u95: number(map, u95), ..plain(map, key, name)? })
    };
    let scale = of("mm_per_px", "mm_per_px_u95", "scale on the axis");
    let aspect = of("aspect", "aspect_u95", "aspect, Y's scale beyond X's");
    let error = plain(map, "field_u95_mm", "95 % of the map's error, at most in the frame");
    let left = plain(map, "residual_rms_mm", "residuals, rms");
    [scale, aspect, error, left].into_iter().flatten()
}

/// How far to go to be over the centre, and what that rests on.
fn moves(map: &Map<String, Value>) -> impl Iterator<Item = Characteristic> {
    let of = |k: usize| {
        let name = format!("move {} by", ["X", "Y"][k]);
        let row = plain(map, &format!("move_mm.{k}"), &name)?;
        Some(Characteristic { u95: number(map, &format!("offset_u95_mm.{k}")), ..row })
    };
    let diameter = plain(map, "diameter_mm", "diameter in the last frame");
    [of(0), of(1), diameter].into_iter().flatten()
}

/// A number as it stands, with neither nominal nor limit.
fn plain(map: &Map<String, Value>, key: &str, name: &str) -> Option<Characteristic> {
    Some(Characteristic::new(name.to_owned(), unit(key), number(map, key)?, None))
}

/// The limit that a value is held against, and whether it keeps it: of a burn's two readings of concentricity one.
fn judged(command: &str, map: &Map<String, Value>, key: &str) -> (Option<f64>, Option<Verdict>) {
    let (limit, verdict) = match (command, map.get("tolerance_kind").and_then(Value::as_str), key) {
        ("burn", Some("zone"), "zone_mm") => ("tolerance_mm", map.get("verdict")),
        ("burn", None | Some("distance"), "distance_mm")
        | ("rotary", _, "summary.before_max_mm") => ("tolerance_mm", map.get("verdict")),
        ("solve", _, "check_touch.difference_mm") => {
            ("check_touch.limit_mm", map.get("check_touch").and_then(|c| c.get("verdict")))
        }
        _ => return (None, None),
    };
    let limit = number(map, limit);
    let verdict = verdict.and_then(|v| serde_json::from_value(v.clone()).ok());
    (limit, verdict.filter(|_| limit.is_some()))
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

/// The unit that a key ends in; empty where there is none.
pub fn unit(key: &str) -> &'static str {
    let head = key.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('.');
    if head.ends_with("mm_per_px") {
        return "mm/px";
    }
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

/// What a key's value is called: circles by their numbers, and at one table angle, where a rod's centre stands for the C axis, as the
/// rod's.
fn name_of(result: &Value, key: &str) -> String {
    let mut parts = key.splitn(3, '.');
    match [parts.next(), parts.next(), parts.next()] {
        [Some("circles"), Some(n), Some(of)] => format!("circle {n} {}", label(of)),
        [Some("pairs"), Some(n), Some(of)] => {
            let pair = n.parse::<usize>().ok().and_then(|n| result.get("pairs")?.get(n));
            let end = |key: &str| pair.and_then(|p| p.get(key)?.as_u64()).unwrap_or_default();
            format!("circle {} to {}: {}", end("a"), end("b"), label(of))
        }
        _ => match result.get("axis_separated") {
            Some(Value::Bool(false)) => label(key).replacen("C axis", "rod's centre", 1),
            _ => label(key),
        },
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
        "a_deg" => return "A, turn about X that levels the blank".into(),
        "b_deg" => return "B, turn about Y that levels the blank".into(),
        "tilt_deg" => return "tilt in all".into(),
        "dz_mm" => return "ΔZ, levelled face above the ideal".into(),
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
        let of = name_of(result, text("of"));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(command: &str, result: Value) -> Vec<String> {
        characteristics(command, &result).iter().map(|c| c.cells().join("|")).collect()
    }

    #[test]
    fn a_page_shows_what_a_calibration_and_a_centering_are_for() {
        let plane = serde_json::json!({"mm_per_px": 0.0200007385, "mm_per_px_u95": 2.12e-7,
            "field_u95_mm": 0.000403, "residual_rms_mm": 5.7e-5});
        let rows = cells("calib-plane", plane);
        assert_eq!(rows[0], "scale on the axis, mm/px||0.02000074|||0.00000021|");
        assert!(
            rows[1].ends_with("mm||0.00040||||") && rows[2].ends_with("mm||0.000057||||"),
            "{rows:?}"
        );
        let center = serde_json::json!({"move_mm": [0.1234, -2.0], "offset_u95_mm": [0.0012, 0.0012], "frames_used": 3});
        let rows = cells("center", center);
        assert_eq!(rows, ["move X by, mm||0.1234|||0.0012|", "move Y by, mm||-2.0000|||0.0012|"]);
    }
}
