//! The line of names of a table: which columns there are, and what is wrong with those that are not known.

use std::collections::HashMap;
use std::path::Path;

use crate::error::{Error, Result, nearest};

/// The line of names, and which are known.
pub(super) struct Header<'a> {
    pub path: &'a Path,
    pub line: u64,
    pub required: &'a [&'a str],
    pub optional: &'a [&'a str],
}

impl Header<'_> {
    fn error(
        &self,
        field: impl Into<String>,
        reason: impl Into<String>,
        fix: impl Into<String>,
    ) -> Error {
        Error::field(self.path, Some(self.line), field, reason, fix)
    }

    fn known(&self) -> impl Iterator<Item = &str> {
        self.required.iter().chain(self.optional).copied()
    }

    /// The columns' names; empty ones at the end are none.
    pub fn names(&self, record: &csv::StringRecord) -> Result<Vec<String>> {
        let mut names: Vec<String> = record.iter().map(str::to_owned).collect();
        while names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        if names.is_empty() {
            return Err(Error::file(
                self.path,
                "the file is empty",
                format!("give it a header line with {}", self.required.join(",")),
            ));
        }
        if let [only] = names.as_slice()
            && let Some(separator) = only.chars().find(|c| [';', '\t', '|'].contains(c))
        {
            return Err(self.error(
                "header",
                format!("its columns are separated by {separator:?}"),
                "save the file with commas between columns and a point as the decimal mark",
            ));
        }
        Ok(names)
    }

    /// Where each name stands: all are known, once, and none is missing.
    pub fn index(&self, names: &[String]) -> Result<HashMap<String, usize>> {
        let known = |name: &String| self.known().any(|k| matches(k, name));
        let near = |name: &String| nearest(name, self.known()).is_some();
        if let [only] = names
            && !known(only)
            && !near(only)
        {
            return Err(self.error(
                "header",
                format!("'{only}' names no column"),
                format!(
                    "begin lines above the header with #; the header names columns: {}",
                    self.known().collect::<Vec<_>>().join(", ")
                ),
            ));
        }
        let mut index = HashMap::new();
        for (i, name) in names.iter().enumerate() {
            if name.is_empty() {
                let reason = format!("its column {} has no name", i + 1);
                return Err(self.error(
                    "header",
                    reason,
                    "name it; one that begins with x_ is ignored",
                ));
            }
            if !known(name) && !name.starts_with("x_") && !name.starts_with("x-") {
                return Err(self.unknown(name));
            }
            if index.insert(name.clone(), i).is_some() {
                let column = format!("column '{name}'");
                return Err(self.error(column, "stands twice in the header", "keep one of them"));
            }
        }
        match self.required.iter().find(|k| !names.iter().any(|n| matches(k, n))) {
            Some(missing) => Err(self.error(
                format!("column '{missing}'"),
                format!("is missing; the header has: {}", names.join(", ")),
                "add the column",
            )),
            None => Ok(index),
        }
    }

    fn unknown(&self, name: &str) -> Error {
        // Another unit is no slip of the pen: renaming the column would not turn its numbers.
        let unit = |name: &str| name.rsplit('_').next().unwrap_or("").to_lowercase();
        let near = nearest(name, self.known()).filter(|near| unit(near) == unit(name));
        let hint = near.map_or(String::new(), |near| format!("did you mean '{near}'? "));
        self.error(
            format!("column '{name}'"),
            "is not known here",
            format!(
                "{hint}known columns: {}; begin the name with x_ to have it ignored",
                self.known().collect::<Vec<_>>().join(", ")
            ),
        )
    }
}

/// Whether `name` is `pattern`, where one `*` in the pattern stands for anything.
fn matches(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((head, tail)) => {
            name.len() >= head.len() + tail.len() && name.starts_with(head) && name.ends_with(tail)
        }
    }
}
