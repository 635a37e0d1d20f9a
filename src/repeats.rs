//! What stands twice in a table counts once, and the user is told: a copy knows nothing new, and intervals that
//! count it are too narrow.

use std::collections::HashMap;
use std::hash::Hash;
use std::path::Path;

use crate::error::Result;
use crate::hash;
use crate::table::Table;

/// Lines named in a warning; the rest are counted.
const MOST_LINES: usize = 10;

/// For each item the first one with the same key, where it is not itself.
pub fn firsts<K: Eq + Hash>(keys: impl IntoIterator<Item = K>) -> Vec<Option<usize>> {
    let mut seen = HashMap::new();
    let first = |(i, key)| Some(*seen.entry(key).or_insert(i)).filter(|&first| first != i);
    keys.into_iter().enumerate().map(first).collect()
}

/// What a picture is known by: its bytes, or its path where it cannot be read. A pipe would be waited for.
pub fn content(path: &Path) -> String {
    let file = Some(path).filter(|p| p.is_file()).and_then(|p| hash::of_file(p).ok());
    file.unwrap_or_else(|| path.display().to_string())
}

/// The rows of a table that count: of rows that are alike in every column, the first. A warning names
/// the others.
pub fn rows_once(table: &Table, warnings: &mut Vec<String>) -> Vec<usize> {
    let firsts = firsts((0..table.rows()).map(|row| table.cells(row)));
    once(table, &firsts, "a row", warnings)
}

/// As [`rows_once`] for rows that each name a picture by `paths`: rows of one picture, or of a copy of it, count once
/// where all else is alike. One picture at two positions is refused; a copy there is told, and stays.
pub fn pictures_once(
    table: &Table,
    paths: &[impl AsRef<Path>],
    warnings: &mut Vec<String>,
) -> Result<Vec<usize>> {
    let mut firsts = firsts(paths.iter().map(|p| content(p.as_ref())));
    for (row, entry) in firsts.iter_mut().enumerate() {
        let Some(first) = *entry else { continue };
        let beside = |row: usize| table.cells(row).into_iter().filter(|(name, _)| *name != "image");
        if beside(row).eq(beside(first)) {
            continue;
        }
        let (image, line) = (table.text(row, "image"), table.line(first));
        if paths[row].as_ref() == paths[first].as_ref() {
            return Err(table.error(
                row,
                "image",
                format!(
                    "'{image}' is the picture of line {line}, there at another position or time"
                ),
                "give each row its own picture",
            ));
        }
        warnings.push(format!(
            "{}:{}: '{image}' is a copy of the picture of line {line}, there at another position or time: one is wrong",
            table.path().display(),
            table.line(row)
        ));
        *entry = None;
    }
    Ok(once(table, &firsts, "a picture", warnings))
}

fn once(
    table: &Table,
    firsts: &[Option<usize>],
    what: &str,
    warnings: &mut Vec<String>,
) -> Vec<usize> {
    let lines: Vec<String> = (0..firsts.len())
        .filter(|&row| firsts[row].is_some())
        .map(|row| table.line(row).to_string())
        .collect();
    if !lines.is_empty() {
        let more = if lines.len() > MOST_LINES { ", ..." } else { "" };
        warnings.push(format!(
            "{}: {} left out, {what} that stands twice counts once: line {}{more}",
            table.path().display(),
            lines.len(),
            lines[..lines.len().min(MOST_LINES)].join(", ")
        ));
    }
    (0..firsts.len()).filter(|&row| firsts[row].is_none()).collect()
}
