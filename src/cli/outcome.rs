//! What a command hands back: the result to print, in the form every result has, and the exit code.

use std::process::ExitCode;

use crate::output::Document;

/// What a command hands back: something to print, and how it went.
#[derive(Debug)]
pub struct Outcome {
    /// The result; `None` where the command already wrote what it makes.
    pub document: Option<Document>,
    /// The exit code's meaning.
    pub status: Status,
}

/// The meaning of an exit code (`docs/conventions.md`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// 0: measured, within tolerance or no tolerance applies.
    Good,
    /// 1: measured, and the verdict is `fail` or `undecided`.
    OutOfTolerance,
    /// 3: several inputs, and some of them failed.
    SomeFailed,
    /// 2: nothing measured.
    BadInput,
}

impl Outcome {
    /// A result with no tolerance, or within it.
    pub fn good(document: Document) -> Self {
        Self { document: Some(document), status: Status::Good }
    }
}

impl Status {
    pub(super) fn number(self) -> u8 {
        match self {
            Self::Good => 0,
            Self::OutOfTolerance => 1,
            Self::BadInput => 2,
            Self::SomeFailed => 3,
        }
    }

    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::OutOfTolerance => "measured, not passed",
            Self::SomeFailed => "some failed",
            Self::BadInput => "nothing measured",
        }
    }

    pub(super) fn code(self) -> ExitCode {
        ExitCode::from(self.number())
    }
}

/// The keys every JSON result begins with; the command's own keys follow.
pub fn envelope(
    command: &str,
    input: impl serde::Serialize,
    warnings: &[String],
) -> serde_json::Map<String, serde_json::Value> {
    let mut map = serde_json::Map::new();
    map.insert("schema".into(), format!("pivotsight.{command}/1").into());
    map.insert("version".into(), env!("CARGO_PKG_VERSION").into());
    map.insert("input".into(), serde_json::to_value(input).unwrap_or_default());
    map.insert("warnings".into(), warnings.into());
    map
}

/// A whole JSON result: the envelope, then the keys of `body`.
pub fn result(
    command: &str,
    input: impl serde::Serialize,
    warnings: &[String],
    body: &impl serde::Serialize,
) -> serde_json::Value {
    let mut map = envelope(command, input, warnings);
    if let Ok(serde_json::Value::Object(keys)) = serde_json::to_value(body) {
        map.extend(keys);
    }
    map.into()
}

/// A list as the rows of a document.
pub fn rows(list: &[impl serde::Serialize]) -> Vec<serde_json::Value> {
    list.iter().map(|row| serde_json::to_value(row).unwrap_or_default()).collect()
}
