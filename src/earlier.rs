//! A result that a command wrote before, with `--format json`, read again.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::error::{Error, Result};
use crate::input;

/// What a command puts about its result.
const ENVELOPE: [&str; 4] = ["schema", "version", "input", "warnings"];

/// A file that a command made, and how to get it.
#[derive(Debug, Clone, Copy)]
pub struct Earlier<'p> {
    /// The file.
    pub path: &'p Path,
    /// The command's name in the result's schema.
    pub command: &'p str,
    /// What to do where it is another file.
    pub fix: &'p str,
}

impl Earlier<'_> {
    /// The file's JSON object, which must be the command's where it says whose it is.
    pub fn json(&self) -> Result<Value> {
        let text = input::text(self.path, input::MOST_SETTINGS)?;
        let json: Value =
            serde_json::from_str(&text).map_err(|e| self.wrong(format!("is not JSON ({e})")))?;
        let wanted = format!("pivotsight.{}/1", self.command);
        match json.get("schema") {
            Some(schema) if *schema != *wanted => {
                Err(self.wrong(format!("is {schema}, not the {wanted} that this program reads")))
            }
            _ => Ok(json),
        }
    }

    /// A result, or a part of one, in its type.
    pub fn shape<T: DeserializeOwned>(&self, json: Value) -> Result<T> {
        serde_json::from_value(json)
            .map_err(|e| self.wrong(format!("is not the expected result ({e})")))
    }

    /// The whole result without its envelope and a user's own keys, `x_...`.
    pub fn result<T: DeserializeOwned>(&self) -> Result<T> {
        let mut json = self.json()?;
        if let Some(map) = json.as_object_mut() {
            map.retain(|key, _| {
                let own = key.starts_with("x_") || key.starts_with("x-");
                !own && !ENVELOPE.contains(&key.as_str())
            });
        }
        self.shape(json)
    }

    /// The file is wrong.
    pub fn wrong(&self, reason: impl Into<String>) -> Error {
        Error::file(self.path, reason.into(), self.fix)
    }
}
