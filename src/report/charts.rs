//! Charts made from the result itself.

use serde_json::{Map, Value};

use super::{history, thermal};
use crate::batch::limits::{number, u95_key};
use crate::plot::{Figure, Panel};

/// The charts of a result.
pub fn of(command: &str, result: &Value) -> Vec<Figure> {
    let Some(map) = result.as_object() else { return Vec::new() };
    let mut figures = Vec::new();
    if command == "history" {
        figures.extend(history::figure(result));
    }
    if command == "thermal-fit" {
        figures.extend(thermal::figure(result));
    }
    if command == "burn" {
        figures.extend(target(map));
    }
    if command == "verify" {
        figures.extend(poses(map));
    } else {
        figures.extend(sweep(map));
    }
    figures
}

/// The spot's centre seen from the ring's, with its interval and the limit's circle.
fn target(map: &Map<String, Value>) -> Option<Figure> {
    let [x, y, ux, uy] = ["offset_mm.0", "offset_mm.1", "offset_u95_mm.0", "offset_u95_mm.1"]
        .map(|k| number(map, k));
    let (x, y, ux, uy) = (x? * 1e3, y? * 1e3, ux? * 1e3, uy? * 1e3);
    let circle = |cx: f64, cy: f64, rx: f64, ry: f64| -> Vec<(f64, f64)> {
        (0..=90)
            .map(|i| (f64::from(i) * std::f64::consts::TAU / 90.0).sin_cos())
            .map(|(s, c)| (cx + rx * c, cy + ry * s))
            .collect()
    };
    let mut panel = Panel::new("X, µm", "Y, µm").equal_scale();
    if let Some(limit) = number(map, "tolerance_mm") {
        let zone = map.get("tolerance_kind").and_then(Value::as_str) == Some("zone");
        let radius = limit * 1e3 * if zone { 0.5 } else { 1.0 };
        panel = panel.line("limit", &circle(0.0, 0.0, radius, radius));
    }
    panel = panel
        .points("ring", &[(0.0, 0.0)])
        .points("spot", &[(x, y)])
        .line("95 % interval", &circle(x, y, ux, uy));
    Some(Figure::new("Spot seen from the ring").panel(panel))
}

/// The length of each pose's deviation over B, as measured and as the model leaves it.
fn poses(map: &Map<String, Value>) -> Option<Figure> {
    let rows = map.get("rows")?.as_array()?;
    let over_b = |key: &str| -> Vec<(f64, f64)> {
        let point = |row: &Map<String, Value>| {
            let part = |i: usize| number(row, &format!("{key}.{i}"));
            let length = part(0)?.hypot(part(1)?).hypot(part(2)?);
            Some((number(row, "b_deg")?, 1e3 * length))
        };
        rows.iter().filter_map(Value::as_object).filter_map(point).collect()
    };
    let (measured, left) = (over_b("measured_mm"), over_b("left_mm"));
    let ends = measured.iter().map(|p| p.0).fold(None, |ends: Option<(f64, f64)>, b| {
        ends.map_or(Some((b, b)), |(low, high)| Some((low.min(b), high.max(b))))
    })?;
    let mut panel = Panel::new("B, deg", "deviation, µm");
    if let Some(limit) = number(map, "tolerance_mm") {
        panel = panel.line("limit", &[(ends.0, 1e3 * limit), (ends.1, 1e3 * limit)]);
    }
    let panel = panel.points("measured", &measured).points("left by the model", &left);
    Some(Figure::new("Deviation of each pose").panel(panel))
}

/// Rows over an angle or time: each number that states its uncertainty.
fn sweep(map: &Map<String, Value>) -> Option<Figure> {
    let rows: Vec<&Map<String, Value>> =
        map.get("rows")?.as_array()?.iter().filter_map(Value::as_object).collect();
    let first = rows.first()?;
    let over = ["angle_deg", "b_deg", "c_deg", "t_s", "position_mm"]
        .into_iter()
        .find(|k| first.contains_key(*k))?;
    let mut figure = None;
    for key in first.keys() {
        let Some(u95) = u95_key(key).filter(|k| first.contains_key(k)) else { continue };
        let points: Vec<_> = rows
            .iter()
            .filter_map(|r| Some((number(r, over)?, number(r, key)?, number(r, &u95)?)))
            .collect();
        figure = Some(
            figure.unwrap_or_else(|| Figure::new("")).panel(
                Panel::new(over.replace('_', ", "), key.replace('_', " "))
                    .points_with_bars(key.clone(), &points),
            ),
        );
    }
    figure
}
