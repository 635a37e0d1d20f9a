//! Strict TOML files: unknown keys are errors that name them, unless they begin with `x_` or `x-`.

use std::path::Path;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

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
    let table = table_of(path, text)?;
    let error_in = |table: toml::Table| table.try_into::<T>().err().map(|e| e.message().to_owned());
    // Read from a table, an array that is too long is an error; read from the text, its surplus would be dropped.
    table.clone().try_into::<T>().map_err(|error| explained(path, text, table, &error, &error_in))
}

/// The table that a text means, without its extensions.
fn table_of(path: &Path, text: &str) -> Result<toml::Table> {
    let mut table: toml::Table = toml::from_str(text)
        .map_err(|e| failed(path, text, e.span().map(|s| s.start), "TOML", e.message()))?;
    strip_extensions(&mut table);
    Ok(table)
}

fn failed(path: &Path, text: &str, at: Option<usize>, field: &str, reason: &str) -> Error {
    let line = at.map(|at| 1 + text[..at.min(text.len())].matches('\n').count());
    let written = line.and_then(|n| text.lines().nth(n - 1)).unwrap_or("");
    let fix = match has_decimal_comma(written) {
        true => "write the decimal mark as a point",
        false => "correct the file",
    };
    Error::field(path, line.map(|n| n as u64), field, reason.trim().replace('\n', " "), fix)
}

/// What is wrong with a table, and where in its text; `error_in` is the message that a part of it makes.
fn explained(
    path: &Path,
    text: &str,
    table: toml::Table,
    error: &toml::de::Error,
    error_in: &dyn Fn(toml::Table) -> Option<String>,
) -> Error {
    let place = field_of(error);
    let field = place.as_deref().unwrap_or("TOML");
    let message = error.message();
    let reason = if message == "invalid type: unit variant, expected newtype variant" {
        let choice = table.get(field).and_then(toml::Value::as_str).unwrap_or("...");
        format!("is a table with options of its own: write [{field}.{choice}]")
    } else if let Some(length) = message.strip_suffix(", expected fewer elements in array") {
        format!("{length} is more than belongs there")
    } else {
        message.to_owned()
    };
    let keys = place.iter().flat_map(|place| place.split('.')).chain(unknown_key(message));
    let keys: Vec<&str> = keys.collect();
    let same = |table: &toml::Table| error_in(table.clone()).as_deref() == Some(message);
    failed(path, text, place_of(text, table, &keys, &same), field, &reason)
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

/// The key that a message says nobody knows.
fn unknown_key(message: &str) -> Option<&str> {
    message.strip_prefix("unknown field `")?.split('`').next()
}

/// Where in a text what `keys` lead to is written. Of an array, the element that alone makes the same error.
fn place_of(
    text: &str,
    mut table: toml::Table,
    keys: &[&str],
    same: &dyn Fn(&toml::Table) -> bool,
) -> Option<usize> {
    let text = DeTable::parse(text).ok()?;
    let (mut within, mut path, mut place) = (text.get_ref(), Vec::new(), None);
    for key in keys {
        let Some((written, mut value)) = within.get_key_value(*key) else { break };
        path.push(Some(*key));
        place = Some(written.span().start);
        while let DeValue::Array(items) = value.get_ref() {
            let array = at(&mut table, &path).and_then(toml::Value::as_array_mut);
            // Taken out: a long array is not copied for each of its elements.
            let elements = array.map(std::mem::take).unwrap_or_default();
            let found = elements.into_iter().zip(items.iter()).find_map(|(element, item)| {
                let mut alone = table.clone();
                *at(&mut alone, &path)? = toml::Value::Array(vec![element]);
                same(&alone).then_some((alone, item))
            });
            let Some(found) = found else { return place };
            (table, value) = found;
            place = Some(value.span().start);
            path.push(None);
        }
        let DeValue::Table(inner) = value.get_ref() else { break };
        within = inner;
    }
    place
}

/// What a path leads to: keys of tables, and nothing for the first of an array.
fn at<'a>(table: &'a mut toml::Table, path: &[Option<&str>]) -> Option<&'a mut toml::Value> {
    let (first, rest) = path.split_first()?;
    let start = table.get_mut((*first)?)?;
    rest.iter().try_fold(start, |value, step| match step {
        Some(key) => value.get_mut(*key),
        None => value.get_mut(0),
    })
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

    #[test]
    fn of_an_array_the_element_that_is_wrong_is_told() {
        #[derive(Debug, serde::Deserialize)]
        struct File {
            #[serde(rename = "touch")]
            _touches: Vec<Small>,
        }
        let text = "[[touch]]\na = 1\n[[touch]]\na = '2'\n[[touch]]\na = 3\n";
        let message = parse::<File>("f.toml", text).unwrap_err().to_string();
        assert!(message.starts_with("f.toml:4: touch.a: "), "{message}");
        let message = parse::<File>("f.toml", &text.replace("a = '2'", "b = 2")).unwrap_err();
        assert!(message.to_string().starts_with("f.toml:4: touch: "), "{message}");
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
