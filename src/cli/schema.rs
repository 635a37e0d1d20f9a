//! `pivotsight schema`: the JSON Schema of every output, made from the types that are written.

use schemars::{JsonSchema, Schema, SchemaGenerator, generate::SchemaSettings};
use serde_json::{Map, Value, json};

use super::Outcome;
use crate::error::{Error, Result};
use crate::measure::{burn, circles};
use crate::output::Document;
use crate::{batch, regress, store};

/// Print the JSON Schema of a command's output
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The command; without one, the commands that have a schema are listed
    command: Option<String>,
}

#[derive(JsonSchema)]
#[allow(dead_code)] // Only described, never made: the command builds the same keys.
struct History {
    drift: Vec<store::drift::Drift>,
    records: Vec<store::Record>,
}

#[derive(JsonSchema)]
#[allow(dead_code)]
struct Regress {
    passed: bool,
    cases: Vec<regress::Case>,
}

type Make = fn(&mut SchemaGenerator) -> Schema;

/// Every output with a schema. A new one is a line here.
const SCHEMAS: &[(&str, Make)] = &[
    ("batch", |g| g.root_schema_for::<batch::Summary>()),
    ("burn", |g| g.root_schema_for::<burn::Report>()),
    ("circles", |g| g.root_schema_for::<circles::Report>()),
    ("history", |g| g.root_schema_for::<History>()),
    ("regress", |g| g.root_schema_for::<Regress>()),
];

/// Runs the command.
pub fn run(args: &Args) -> Result<Outcome> {
    let names: Vec<&str> = SCHEMAS.iter().map(|s| s.0).collect();
    let Some(command) = &args.command else {
        let json = json!({ "schemas": names });
        return Ok(Outcome::good(Document::single(json, names.join("\n"))));
    };
    let Some((name, make)) = SCHEMAS.iter().find(|s| s.0 == command) else {
        return Err(Error::option(
            "COMMAND",
            format!("'{command}' has no schema"),
            format!("there are: {}", names.join(", ")),
        ));
    };
    let schema = with_envelope(
        name,
        make(&mut SchemaSettings::draft2020_12().for_serialize().into_generator()),
    );
    let text = format!("{schema:#}\n");
    Ok(Outcome::good(Document::single(schema, text)))
}

/// Adds the keys every result begins with.
fn with_envelope(name: &str, schema: Schema) -> Value {
    let mut schema = schema.to_value();
    let id = format!("pivotsight.{name}/1");
    schema["$id"] = format!("https://pivotsight.github.io/schema/{name}-1.json").into();
    schema["title"] = id.clone().into();
    let mut properties = Map::new();
    properties.insert("schema".into(), json!({ "const": id }));
    properties.insert("version".into(), json!({ "type": "string" }));
    properties.insert("input".into(), json!({ "description": "What the result was made from." }));
    properties.insert("warnings".into(), json!({ "type": "array", "items": { "type": "string" } }));
    if let Some(Value::Object(own)) = schema.get_mut("properties") {
        let own = std::mem::take(own);
        properties.extend(own);
    }
    schema["properties"] = properties.into();
    let own = schema.get("required").and_then(Value::as_array).cloned().unwrap_or_default();
    let all = ["schema", "version", "input", "warnings"].map(Value::from).into_iter().chain(own);
    schema["required"] = all.collect();
    schema
}
