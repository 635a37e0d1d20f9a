//! A ball bar's page: the errors its paths see, sums of those they do not, and which path would add the rest.

use serde_json::Value;

use super::lists::List;
use super::numbers::Characteristic;
use crate::ballbar::{Report, sum};

/// The result; none where it is not one.
fn report(result: &Value) -> Option<Report> {
    serde_json::from_value(result.clone()).ok()
}

/// The errors and sums with numbers, and what they leave of the lengths.
pub fn characteristics(result: &Value) -> Vec<Characteristic> {
    let Some(found) = report(result) else { return Vec::new() };
    let unit = |name: &str| if name == "deg" { "deg" } else { "mm" };
    let errors = found.visible.iter().map(|v| {
        let name = format!("{}, {}", v.name, what(&v.name));
        Characteristic::new(name, unit(&v.unit), v.value, Some(v.u95))
    });
    let sums = found
        .combinations
        .iter()
        .map(|c| Characteristic::new(sum(&c.terms), unit(&c.unit), c.value, Some(c.u95)));
    let lengths = [
        ("lengths off nominal, rms", found.before_rms_mm),
        ("what the errors leave of that, rms", found.after_rms_mm),
    ]
    .map(|(name, mm)| Characteristic::new(name.to_owned(), "mm", mm, None));
    errors.chain(sums).chain(lengths).collect()
}

/// What an error is.
fn what(name: &str) -> &'static str {
    match name {
        "X0B" => "B axis off in X",
        "Z0B" => "B axis off in Z",
        "A0B" => "B axis tilted about X",
        "C0B" => "B axis tilted about Z",
        "A0Z" => "Z axis tilted about X",
        "B0Z" => "Z axis tilted about Y",
        _ => "",
    }
}

/// The two methods side by side, and what changes no length.
pub fn lists(result: &Value) -> Vec<List> {
    let Some(found) = report(result) else { return Vec::new() };
    let methods = found.visible.iter().zip(&found.swarm).map(|(v, s)| {
        vec![
            format!("{}, {}", v.name, v.unit),
            format!("{:+.5}", v.value),
            format!("{:+.5}", s.value),
        ]
    });
    let methods = List {
        title: "Two methods".into(),
        head: ["", "Least squares", "Particle swarm"].map(String::from).into(),
        rows: methods.collect(),
    };
    let unseen = List {
        title: format!("Not visible on {}", found.paths.join(", ")),
        head: vec!["Amounts that together change no length".into()],
        rows: found.null_directions.iter().map(|n| vec![sum(n)]).collect(),
    };
    [methods, unseen].into_iter().filter(|list| !list.rows.is_empty()).collect()
}

/// What the paths see, in a sentence.
pub fn sentence(result: &Value) -> String {
    let Some(found) = report(result) else { return String::new() };
    let hidden = match found.not_visible.as_slice() {
        [] => String::new(),
        names => format!(" {} have no number of their own.", names.join(", ")),
    };
    format!(
        "{} lengths see {} independent sums of the six errors.{hidden}",
        found.points, found.rank
    )
}

/// What to do next.
pub fn next(result: &Value) -> Vec<String> {
    let hidden = |found: &Report| match (&found.would_add, found.not_visible.is_empty()) {
        (Some(path), _) => Some(format!(
            "Measure the path {path} as well, which shows more of {} (pivotsight ballbar plan --path {path}).",
            found.not_visible.join(", ")
        )),
        (None, false) => {
            Some(format!("No path of Z or X with B shows {} alone.", found.not_visible.join(", ")))
        }
        (None, true) => None,
    };
    let enter =
        "Adjust the machine or enter the errors that are larger than their U, and measure again.";
    report(result).as_ref().and_then(hidden).into_iter().chain([enter.to_owned()]).collect()
}
