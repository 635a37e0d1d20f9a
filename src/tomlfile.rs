//! Strict TOML files: unknown keys are errors that name them, unless they begin with `x_` or `x-`.

use std::path::Path;

use serde::de::DeserializeOwned;

use crate::error::{Error, Result};
use crate::input;

/// Reads `path` into `T`. `T` should carry `#[serde(deny_unknown_fields)]`.
pub fn read<T: DeserializeOwned>(path: impl AsRef<Path>) -> Result<T> {
    let path = path.as_ref();
    let text = input::text(path, input::MOST_SETTINGS)?;
    parse(path, &text)
}

/// As [`read`], from text; `path` is only the name used in messages.
pub fn parse<T: DeserializeOwned>(path: impl AsRef<Path>, text: &str) -> Result<T> {
    let path = path.as_ref();
    let line_of = |span: Option<std::ops::Range<usize>>| {
        span.map(|s| 1 + text[..s.start.min(text.len())].matches('\n').count() as u64)
    };
    let fail = |line: Option<u64>, field: &str, reason: &str| {
        let at = line.and_then(|n| text.lines().nth(n as usize - 1)).unwrap_or("");
        let fix = match has_decimal_comma(at) {
            true => "write the decimal mark as a point",
            false => "correct the file",
        };
        Error::field(path, line, field, reason.trim().replace('\n', " "), fix)
    };
    let mut table: toml::Table =
        toml::from_str(text).map_err(|e| fail(line_of(e.span()), "TOML", e.message()))?;
    strip_extensions(&mut table);
    // Read from a table, an array that is too long is an error; read from the text, its surplus is dropped.
    let error = match table.try_into::<T>() {
        Ok(value) => return Ok(value),
        Err(error) => error,
    };
    let field = field_of(&error).unwrap_or_else(|| "TOML".into());
    // The text knows lines, where it meets the same error.
    let in_text = toml::from_str::<T>(text).err().filter(|e| e.message() == error.message());
    let line = in_text.map_or_else(|| line_with(text, &field), |e| line_of(e.span()));
    let message = error.message();
    let reason = if message == "invalid type: unit variant, expected newtype variant" {
        let written = toml::from_str::<toml::Table>(text).unwrap_or_default();
        let choice = written.get(&field).and_then(toml::Value::as_str).unwrap_or("...");
        format!("is a table with options of its own: write [{field}.{choice}]")
    } else if let Some(length) = message.strip_suffix(", expected fewer elements in array") {
        format!("{length} is more than belongs there")
    } else {
        message.to_owned()
    };
    Err(fail(line, &field, &reason))
}

/// Whether a line gives a key a number with a comma for its decimal mark.
fn has_decimal_comma(line: &str) -> bool {
    let value = line.split_once('=').map_or("", |(_, value)| value.trim());
    let mut parts = value.splitn(2, ',').map(str::trim);
    let digits = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_digit());
    let whole = |text: &str| digits(text.trim_start_matches(['-', '+']));
    parts.next().is_some_and(whole) && parts.next().is_some_and(digits)
}

/// The key at which an error lies, such as `camera.distortion`.
fn field_of(error: &toml::de::Error) -> Option<String> {
    let text = error.to_string();
    let key = text.lines().last()?.strip_prefix("in `")?.strip_suffix('`')?;
    Some(key.to_owned())
}

/// The only line that gives a key its value.
fn line_with(text: &str, field: &str) -> Option<u64> {
    let key = field.rsplit('.').next()?;
    let gives = |line: &str| line.split_once('=').is_some_and(|(name, _)| name.trim() == key);
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| gives(line)).map(|(n, _)| n);
    lines.next().filter(|_| lines.next().is_none())
}

/// Tables whose keys are names of the user's or the effects library's: one that begins with `x_`, such as `x_mm`, is no extension.
const OF_NAMES: [&str; 3] = ["parameters", "parameters_u95", "outputs"];

fn strip_extensions(table: &mut toml::Table) {
    table.retain(|key, _| !key.starts_with("x_") && !key.starts_with("x-"));
    strip_within(table);
}

fn strip_within(table: &mut toml::Table) {
    for (key, value) in table.iter_mut() {
        match value {
            toml::Value::Table(names) if OF_NAMES.contains(&key.as_str()) => strip_within(names),
            toml::Value::Table(inner) => strip_extensions(inner),
            toml::Value::Array(items) => {
                items.iter_mut().filter_map(toml::Value::as_table_mut).for_each(strip_extensions)
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Small {
        a: f64,
    }

    #[test]
    fn unknown_keys_are_named_with_their_line_and_extensions_pass() {
        assert_eq!(parse::<Small>("f.toml", "a = 1.0\nx_who = 'me'\n").unwrap().a, 1.0);
        let message = parse::<Small>("f.toml", "a = 1.0\nbb = 2\n").unwrap_err().to_string();
        assert!(message.starts_with("f.toml:2:") && message.contains("bb"), "{message}");
    }

    #[test]
    fn a_choice_with_options_is_asked_for_as_a_table() {
        #[derive(Debug, serde::Deserialize)]
        #[serde(rename_all = "lowercase")]
        #[allow(dead_code)]
        enum Method {
            Burn(Small),
        }
        #[derive(Debug, serde::Deserialize)]
        struct Job {
            #[serde(rename = "measure")]
            _measure: Method,
        }
        let error =
            parse::<Job>("job.toml", "measure = \"burn\" # the test\n").unwrap_err().to_string();
        assert!(error.starts_with("job.toml:1: measure: is a table"), "{error}");
        assert!(error.contains("write [measure.burn]"), "{error}");
    }

    #[test]
    fn a_parameter_may_be_called_as_an_extension_is() {
        #[derive(serde::Deserialize)]
        struct Effect {
            parameters: std::collections::BTreeMap<String, f64>,
        }
        let text = "x_who = 'me'\n[parameters]\nx_mm = 0.01\ny_mm = 0.02\n";
        assert_eq!(parse::<Effect>("f.toml", text).unwrap().parameters["x_mm"], 0.01);
    }

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        inner: Inner,
    }

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        place_mm: [f64; 2],
    }

    #[test]
    fn an_array_must_have_the_length_that_belongs_there() {
        let read = |text: &str| parse::<Outer>("f.toml", text);
        assert_eq!(read("[inner]\nplace_mm = [1, 2]\n").unwrap().inner.place_mm, [1.0, 2.0]);
        for wrong in ["[1, 2, 3]", "[1]"] {
            let message =
                read(&format!("\n[inner]\nplace_mm = {wrong}\n")).unwrap_err().to_string();
            assert!(message.starts_with("f.toml:3: inner.place_mm: "), "{message}");
        }
    }
}
