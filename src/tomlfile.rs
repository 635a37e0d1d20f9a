//! Strict TOML files: unknown keys are errors that name them, unless they begin with `x_` or `x-`.

use std::path::Path;

use serde::de::DeserializeOwned;

use crate::error::{Error, Result};

/// The largest TOML file accepted, in bytes; a guard against feeding the wrong file.
const MAX_BYTES: u64 = 16 << 20;

/// Reads `path` into `T`. `T` should carry `#[serde(deny_unknown_fields)]`.
pub fn read<T: DeserializeOwned>(path: impl AsRef<Path>) -> Result<T> {
    let path = path.as_ref();
    let size = std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?.len();
    if size > MAX_BYTES {
        return Err(Error::file(path, format!("is {size} bytes long"), "give a TOML file"));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let text = String::from_utf8(bytes)
        .map_err(|_| Error::file(path, "is not UTF-8 text", "give a TOML file"))?;
    parse(path, &text)
}

/// As [`read`], from text; `path` is only the name used in messages.
pub fn parse<T: DeserializeOwned>(path: impl AsRef<Path>, text: &str) -> Result<T> {
    let path = path.as_ref();
    let fail = |e: toml::de::Error| {
        let line =
            e.span().map(|s| 1 + text[..s.start.min(text.len())].matches('\n').count() as u64);
        Error::field(path, line, "TOML", e.message().trim().replace('\n', " "), "correct the file")
    };
    match toml::from_str::<T>(text) {
        Ok(value) => Ok(value),
        // Only where extension keys may be the cause is the file read again without them.
        Err(first) if text.contains("x_") || text.contains("x-") => {
            let mut table: toml::Table = toml::from_str(text).map_err(fail)?;
            strip_extensions(&mut table);
            table.try_into().map_err(|second: toml::de::Error| {
                if second.message() == first.message() {
                    fail(first)
                } else {
                    Error::field(path, None, "TOML", second.message(), "correct the file")
                }
            })
        }
        Err(first) => Err(fail(first)),
    }
}

fn strip_extensions(table: &mut toml::Table) {
    table.retain(|key, _| !key.starts_with("x_") && !key.starts_with("x-"));
    for (_, value) in table.iter_mut() {
        match value {
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
}
