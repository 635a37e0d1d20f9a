//! Holds a result against the schema that the program prints for it.

use std::process::Command;

use serde_json::{Value, json};

/// The schema of a command's result.
pub fn schema(name: &str) -> Value {
    let program = assert_cmd::cargo::cargo_bin!("pivotsight");
    let output = Command::new(program).args(["schema", name]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What in a result is not as its schema says, down to keys it does not describe; nothing where all is well.
pub fn unlike_its_schema(result: &Value) -> Vec<String> {
    let id = result["schema"].as_str().unwrap_or_default();
    let Some(name) = id.strip_prefix("pivotsight.").and_then(|id| id.strip_suffix("/1")) else {
        return vec![format!("'{id}' is no schema's name")];
    };
    let validator = jsonschema::validator_for(&closed(schema(name))).unwrap();
    let told = |e: jsonschema::ValidationError| {
        let what = e.to_string().chars().take(300).collect::<String>();
        format!("{}: {what}", e.instance_path())
    };
    validator.iter_errors(result).map(told).collect()
}

/// The schema with every object closed: a key it does not describe is then a failure. What `anyOf` chooses from
/// stays open, since the envelope's keys stand beside it.
fn closed(mut schema: Value) -> Value {
    let open: Vec<String> = schema["anyOf"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|s| Some(s["$ref"].as_str()?.trim_start_matches("#/$defs/").to_owned()))
        .collect();
    schema["unevaluatedProperties"] = json!(false);
    if let Some(Value::Object(parts)) = schema.get_mut("$defs") {
        for (name, part) in parts {
            if part.get("properties").is_some() && !open.contains(name) {
                part["unevaluatedProperties"] = json!(false);
            }
        }
    }
    schema
}
