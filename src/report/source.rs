//! The result that a page is made of: a command's JSON, or the folder of a batch.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Options, page};
use crate::error::{Error, Result};
use crate::{batch, input};

/// Rows of a batch shown on its page; all are in the tables.
const MAX_ROWS: usize = 50;

/// Where a result is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Its JSON file.
    pub path: PathBuf,
    /// The folder of the batch it is the summary of.
    folder: Option<PathBuf>,
}

impl Source {
    /// The result in a file, or in the folder of a batch.
    pub fn of(given: &Path) -> Self {
        match given.is_dir() {
            true => Self { path: given.join("summary.json"), folder: Some(given.to_owned()) },
            false => Self { path: given.to_owned(), folder: None },
        }
    }

    /// Its page. `options` say what the user wants on it; the folder that names of pictures count from, and a batch's rows that want looking
    /// at, are the result's own.
    ///
    /// # Errors
    /// A folder without a summary, a file that is no result, a result that holds nothing to show.
    pub fn page(&self, options: Options) -> Result<String> {
        let Self { path, folder } = self;
        if let Some(folder) = folder.as_ref().filter(|_| !path.exists()) {
            return Err(Error::file(
                folder,
                "is not the folder of a batch that has measured: it holds no summary.json",
                "give the folder that `batch --out` named, or a result's file",
            ));
        }
        let text = input::text(path, input::MOST_TABLE)?;
        let result: Value = serde_json::from_str(&text).map_err(|e| {
            Error::file(
                path,
                format!("is not a JSON result ({e})"),
                "give what a command wrote with --format json",
            )
        })?;
        let rows = folder.as_deref().map(worth_a_look).transpose()?.unwrap_or_default();
        let base = path.parent().unwrap_or(Path::new("")).to_owned();
        page(&result, &Options { base, rows, ..options }).map_err(|e| e.in_file(path, None))
    }
}

/// The first rows of a batch that were not measured or not passed.
fn worth_a_look(folder: &Path) -> Result<Vec<Value>> {
    let good = |row: &Value| {
        row.get("status").is_some_and(|s| s == "measured")
            && row.get("verdict").is_none_or(|v| v == "pass" || v.is_null())
    };
    let mut list = Vec::new();
    for row in batch::rows(folder)? {
        let row = row?;
        if !good(&row) {
            list.push(row);
        }
        if list.len() == MAX_ROWS {
            break;
        }
    }
    Ok(list)
}
