//! Charts made from the result itself.

use serde_json::{Map, Value};

use crate::batch::limits::{number, u95_key};
use crate::plot::{Figure, Panel};

/// The charts of a result.
pub fn of(command: &str, result: &Value) -> Vec<Figure> {
    let Some(map) = result.as_object() else { return Vec::new() };
    let mut figures = Vec::new();
    if command == "burn" {
        figures.extend(target(map));
    }
    figures.extend(sweep(map));
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

/// Rows over an angle or time: each number that states its uncertainty.
fn sweep(map: &Map<String, Value>) -> Option<Figure> {
    let rows: Vec<&Map<String, Value>> =
        map.get("rows")?.as_array()?.iter().filter_map(Value::as_object).collect();
    let first = rows.first()?;
    let over = ["angle_deg", "b_deg", "c_deg", "t_s", "position_mm"]
        .into_iter()
        .find(|k| first.contains_key(*k))?;
    let mut figure = Figure::new("");
    for key in first.keys() {
        let Some(u95) = u95_key(key).filter(|k| first.contains_key(k)) else { continue };
        let points: Vec<_> = rows
            .iter()
            .filter_map(|r| Some((number(r, over)?, number(r, key)?, number(r, &u95)?)))
            .collect();
        figure = figure.panel(
            Panel::new(over.replace('_', ", "), key.replace('_', " "))
                .points_with_bars(key.clone(), &points),
        );
    }
    Some(figure)
}
