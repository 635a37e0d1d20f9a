//! What changes in a control when new numbers replace old ones: values, and lines that only a remark tells of.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Confidence, Export, Parameter};

/// What differs between two exports.
#[derive(Debug, Clone, PartialEq)]
pub struct Changes {
    /// The values that differ by more than the export's last decimal.
    pub values: Vec<Change>,
    /// Lines of the new files that change beside these values.
    pub lines: Vec<Line>,
}

/// A value that changes.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[allow(missing_docs)] // The names say it.
pub struct Change {
    /// As the control names it.
    pub name: String,
    /// `mm`, or empty for a code.
    pub unit: &'static str,
    pub old: f64,
    pub new: f64,
    pub change: f64,
    pub meaning: String,
    pub confidence: Confidence,
}

/// A line that changes in one of the files.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[allow(missing_docs)] // The names say it.
pub struct Line {
    pub file: String,
    pub line: String,
}

/// What changes when `new` replaces `old`.
pub fn changes(old: &Export, new: &Export) -> Changes {
    let pairs = differences(old, new);
    let lines = other_lines(old, new, &pairs);
    let values = pairs.into_iter().map(|(p, old, new)| Change {
        name: p.name,
        unit: p.unit,
        old,
        new,
        change: new - old,
        meaning: p.meaning,
        confidence: p.confidence,
    });
    Changes { values: values.collect(), lines }
}

/// The parameters whose values differ by more than the export's last decimal, each with the old and the new one.
fn differences(old: &Export, new: &Export) -> Vec<(Parameter, f64, f64)> {
    let of_old = |name: &str| old.parameters.iter().find(|p| p.name == name);
    new.parameters
        .iter()
        .filter_map(|p| of_old(&p.name).map(|o| (p.clone(), o.value, p.value)))
        .filter(|(_, o, n)| (o - n).abs() >= 0.5e-4)
        .collect()
}

/// Lines of the new files that are no line of the old ones with the changed values put in: a stand-off or a sense that only a remark
/// tells.
fn other_lines(old: &Export, new: &Export, changes: &[(Parameter, f64, f64)]) -> Vec<Line> {
    let of_value = |p: &Parameter, value: f64| Parameter { value, ..p.clone() }.text();
    let texts: Vec<(String, String)> =
        changes.iter().map(|(p, old, new)| (of_value(p, *old), of_value(p, *new))).collect();
    let explained = |before: &str, now: &str| {
        let (before, now) = (numbers_apart(before), numbers_apart(now));
        before.len() == now.len()
            && before.iter().zip(&now).all(|(b, n)| {
                b == n || texts.iter().any(|(old, new)| (old.as_str(), new.as_str()) == (*b, *n))
            })
    };
    let mut lines = Vec::new();
    for (name, text) in &new.files {
        let before = old.files.iter().find(|(n, _)| n == name).map_or("", |(_, text)| text);
        let is_new = |line: &&str| !before.lines().any(|b| explained(b, line));
        lines.extend(
            text.lines()
                .filter(is_new)
                .map(|line| Line { file: name.clone(), line: line.trim().to_owned() }),
        );
    }
    lines
}

/// A line cut into its numbers and what is between them.
fn numbers_apart(line: &str) -> Vec<&str> {
    let of_number = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
    let mut rest = line;
    std::iter::from_fn(|| {
        let first = of_number(rest.chars().next()?);
        let end = rest.find(|c| of_number(c) != first).unwrap_or(rest.len());
        let (part, left) = rest.split_at(end);
        rest = left;
        Some(part)
    })
    .collect()
}
