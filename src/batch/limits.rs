//! Limits on any key of a result, judged with its uncertainty where the result has one.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::uncertainty::Verdict;

/// What a value has to keep; at least one bound.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// Least allowed value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Largest allowed value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

/// Limits by key: nested keys joined with `.`, list items by number (`pairs.0.distance_mm`).
pub type Limits = BTreeMap<String, Limit>;

/// A value held against its limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Judged {
    /// The key.
    pub key: String,
    /// Its value; `null` where the pictures do not tell it, as one angle does not tell an eccentricity.
    pub value: Option<f64>,
    /// Half-width of its 95 % interval; zero where the result states none.
    pub u95: f64,
    /// The limit.
    #[serde(flatten)]
    pub limit: Limit,
    /// ISO 14253-1.
    pub verdict: Verdict,
}

impl Limit {
    /// The verdict on a value: the worse of its two bounds.
    pub fn judge(&self, value: f64, u95: f64) -> Verdict {
        let upper = self.max.map(|max| Verdict::of(value, u95, max));
        let lower = self.min.map(|min| Verdict::of(-value, u95, -min));
        Verdict::worst(upper.into_iter().chain(lower)).unwrap_or(Verdict::Pass)
    }
}

/// Holds a result against the limits: what it leaves open is undecided. A key the result does not have is named in the error.
pub fn judge(limits: &Limits, result: &Map<String, Value>) -> Result<Vec<Judged>, String> {
    limits
        .iter()
        .map(|(key, limit)| {
            let value = match place(result, key) {
                Some(Value::Null) => None,
                there => Some(there.and_then(Value::as_f64).ok_or_else(|| key.clone())?),
            };
            let u95 = u95_key(key).and_then(|k| number(result, &k)).unwrap_or(0.0);
            let verdict = value.map_or(Verdict::Undecided, |value| limit.judge(value, u95));
            Ok(Judged { key: key.clone(), value, u95, limit: *limit, verdict })
        })
        .collect()
}

/// The number under a path such as `ring.center_mm.0`.
pub fn number(result: &Map<String, Value>, path: &str) -> Option<f64> {
    place(result, path)?.as_f64()
}

fn place<'r>(result: &'r Map<String, Value>, path: &str) -> Option<&'r Value> {
    let mut parts = path.split('.');
    let mut value = result.get(parts.next()?)?;
    for part in parts {
        value = match value {
            Value::Object(map) => map.get(part)?,
            Value::Array(list) => list.get(part.parse::<usize>().ok()?)?,
            _ => return None,
        };
    }
    Some(value)
}

/// Where the uncertainty of `offset_mm.0` stands: `offset_u95_mm.0`.
pub fn u95_key(path: &str) -> Option<String> {
    let (head, tail) = match path.rsplit_once('.') {
        Some((head, tail)) if tail.parse::<usize>().is_ok() => (head, format!(".{tail}")),
        _ => (path, String::new()),
    };
    let (name, unit) = head.rsplit_once('_')?;
    (!name.ends_with("_u95")).then(|| format!("{name}_u95_{unit}{tail}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_use_the_uncertainty_beside_the_value() {
        let result = serde_json::json!({"pairs": [{"distance_mm": 0.009, "distance_u95_mm": 0.002}], "offset_mm": [0.001, -0.02], "offset_u95_mm": [0.001, 0.001]});
        let mut limits = Limits::new();
        limits.insert("pairs.0.distance_mm".into(), Limit { min: None, max: Some(0.010) });
        limits.insert("offset_mm.1".into(), Limit { min: Some(-0.01), max: Some(0.01) });
        let judged = judge(&limits, result.as_object().unwrap()).unwrap();
        let verdicts: Vec<_> = judged.iter().map(|j| (j.u95, j.verdict)).collect();
        assert_eq!(verdicts, [(0.001, Verdict::Fail), (0.002, Verdict::Undecided)]);
        let open = serde_json::json!({"eccentricity_mm": null});
        let one = Limits::from([("eccentricity_mm".into(), Limit { min: None, max: Some(1.0) })]);
        let judged = judge(&one, open.as_object().unwrap()).unwrap();
        assert_eq!((judged[0].value, judged[0].verdict), (None, Verdict::Undecided));
        limits.insert("gone_mm".into(), Limit { min: None, max: Some(1.0) });
        assert_eq!(judge(&limits, result.as_object().unwrap()).unwrap_err(), "gone_mm");
    }
}
