//! `pivotsight schema`: the JSON Schema of every output, made from the types that are written.

use schemars::{Schema, SchemaGenerator, generate::SchemaSettings};
use serde_json::{Map, Value, json};

use super::Outcome;
use super::pictures::Pictures;
use crate::error::{Error, Result};
use crate::measure::{burn, circles};
use crate::output::Document;
use crate::render::series;
use crate::{align, ballbar, calib, demo, rotary, rtcp, thermal};

/// Print the JSON Schema of a command's output
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The command; without one, the commands that have a schema are listed
    command: Option<String>,
}

type Make = fn(&mut SchemaGenerator) -> Schema;

/// Every output with a schema. A new one is a line here.
const SCHEMAS: &[(&str, Make)] = &[
    ("align", |g| g.root_schema_for::<align::Alignment>()),
    ("align-apply", |g| g.root_schema_for::<align::apply::Report>()),
    ("ballbar-decouple", |g| g.root_schema_for::<ballbar::Report>()),
    ("ballbar-plan", |g| g.root_schema_for::<super::ballbar::Planned>()),
    ("ballbar-simulate", |g| g.root_schema_for::<ballbar::simulate::Simulated>()),
    ("batch", |g| g.root_schema_for::<super::batch::Output>()),
    ("burn", |g| g.root_schema_for::<Pictures<burn::Report>>()),
    ("calib-camera", |g| g.root_schema_for::<super::calib::camera::Output>()),
    ("calib-check", |g| g.root_schema_for::<super::calib::check::Output>()),
    ("calib-laser", |g| g.root_schema_for::<calib::laser::Report>()),
    ("calib-plane", |g| g.root_schema_for::<calib::plane::Report>()),
    ("calib-target", |g| g.root_schema_for::<super::calib::target::Output>()),
    ("capture", |g| g.root_schema_for::<super::capture::Output>()),
    ("center", |g| g.root_schema_for::<super::center::Output>()),
    ("circles", |g| g.root_schema_for::<Pictures<circles::Report>>()),
    ("config", |g| g.root_schema_for::<super::config::Output>()),
    ("demo", |g| g.root_schema_for::<demo::Report>()),
    ("demo-hidden-effect", |g| g.root_schema_for::<demo::HiddenReport>()),
    ("diagnose", |g| g.root_schema_for::<super::diagnose::Output>()),
    ("export", |g| g.root_schema_for::<super::export::Output>()),
    ("history", |g| g.root_schema_for::<super::history::Output>()),
    ("machine", |g| g.root_schema_for::<super::machine::Output>()),
    ("regress", |g| g.root_schema_for::<super::regress::Output>()),
    ("render-burn", |g| g.root_schema_for::<super::render::Output<series::Burn>>()),
    ("render-rod", |g| g.root_schema_for::<super::render::Output<series::Rod>>()),
    ("report", |g| g.root_schema_for::<super::report::Output>()),
    ("rod", |g| g.root_schema_for::<super::rod::Output>()),
    ("rotary", |g| g.root_schema_for::<rotary::Report>()),
    ("rtcp", |g| g.root_schema_for::<super::rtcp::Output>()),
    ("simulate", |g| g.root_schema_for::<super::simulate::Output>()),
    ("solve", |g| g.root_schema_for::<rtcp::report::Solution>()),
    ("thermal-compensate", |g| g.root_schema_for::<thermal::verify::Report>()),
    ("thermal-fit", |g| g.root_schema_for::<thermal::Model>()),
    ("verify", |g| g.root_schema_for::<super::verify::Output>()),
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
    let first = ["schema", "version", "input", "warnings"].map(Value::from);
    let own = own.into_iter().filter(|key| !first.contains(key)).collect::<Vec<_>>();
    schema["required"] = first.iter().cloned().chain(own).collect();
    schema
}
