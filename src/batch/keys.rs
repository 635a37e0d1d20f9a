//! Which keys of a result a limit may name: the numbers that its JSON Schema describes.

use schemars::{JsonSchema, generate::SchemaSettings};
use serde_json::Value;

use crate::error::nearest;

/// The numbers of a result of type `R`.
pub struct Keys(Value);

impl Keys {
    /// Of a report as it is written.
    pub fn of<R: JsonSchema>() -> Self {
        let generator = SchemaSettings::draft2020_12().for_serialize().into_generator();
        Self(generator.into_root_schema_for::<R>().to_value())
    }

    /// Whether a key such as `pairs.0.distance_mm` is a number.
    pub fn has(&self, key: &str) -> bool {
        let mut nodes = vec![&self.0];
        for part in key.split('.') {
            nodes = nodes.into_iter().flat_map(|node| self.child(node, part)).collect();
        }
        nodes.iter().any(|node| self.all(node).iter().any(|n| is_number(n)))
    }

    /// A key that is written nearly so.
    pub fn nearest(&self, key: &str) -> Option<String> {
        let mut all = Vec::new();
        self.numbers(&self.0, String::new(), &mut all);
        nearest(key, all)
    }

    /// A schema and those it is put together of.
    fn all<'s>(&'s self, node: &'s Value) -> Vec<&'s Value> {
        let mut all = vec![node];
        if let Some(name) = node.get("$ref").and_then(Value::as_str) {
            all.extend(
                self.0
                    .pointer(name.trim_start_matches('#'))
                    .map(|n| self.all(n))
                    .into_iter()
                    .flatten(),
            );
        }
        for key in ["anyOf", "oneOf", "allOf"] {
            let parts = node.get(key).and_then(Value::as_array).into_iter().flatten();
            all.extend(parts.flat_map(|part| self.all(part)));
        }
        all
    }

    fn child<'s>(&'s self, node: &'s Value, part: &str) -> Vec<&'s Value> {
        let index = part.parse::<u64>().ok();
        let of = |n: &&'s Value| -> Option<&'s Value> {
            let most = n.get("maxItems").and_then(Value::as_u64).unwrap_or(u64::MAX);
            match index {
                Some(i) => n.get("items").filter(|_| i < most),
                None => n.get("properties")?.get(part),
            }
        };
        self.all(node).iter().filter_map(of).collect()
    }

    fn numbers(&self, node: &Value, path: String, into: &mut Vec<String>) {
        for n in self.all(node) {
            if is_number(n) {
                into.push(path.clone());
            }
            let beneath = |part: &str| match path.as_str() {
                "" => part.to_owned(),
                path => format!("{path}.{part}"),
            };
            if let Some(items) = n.get("items") {
                let most = n.get("maxItems").and_then(Value::as_u64).unwrap_or(1);
                (0..most).for_each(|i| self.numbers(items, beneath(&i.to_string()), into));
            }
            for (name, inner) in
                n.get("properties").and_then(Value::as_object).into_iter().flatten()
            {
                self.numbers(inner, beneath(name), into);
            }
        }
    }
}

fn is_number(node: &Value) -> bool {
    let number = |t: &Value| t == "number" || t == "integer";
    match node.get("type") {
        Some(Value::Array(several)) => several.iter().any(number),
        one => one.is_some_and(number),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::{burn, circles};

    #[test]
    fn numbers_of_a_report_are_known_and_near_misses_named() {
        let keys = Keys::of::<burn::Report>();
        for key in ["distance_mm", "ring.center_mm.1", "correction.shim_mm", "ring.edge_points"] {
            assert!(keys.has(key), "{key}");
        }
        for key in ["distance", "ring", "ring.center_mm", "ring.center_mm.2", "verdict", ""] {
            assert!(!keys.has(key), "{key}");
        }
        assert_eq!(keys.nearest("distnace_mm").as_deref(), Some("distance_mm"));
        assert!(Keys::of::<circles::Report>().has("circles.3.diameter_mm"));
    }
}
