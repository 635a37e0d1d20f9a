//! What stands twice in a table counts once, and the user is told: a copy knows nothing new, and intervals that
//! count it are too narrow.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;
use std::path::{Path, PathBuf};

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

/// What each picture is known by: its bytes where another is as long, or its path. A pipe would be waited for.
pub fn contents(paths: &[impl AsRef<Path>]) -> Vec<String> {
    let length =
        |p: &Path| std::fs::metadata(p).ok().filter(std::fs::Metadata::is_file).map(|m| m.len());
    let lengths: Vec<Option<u64>> = paths.iter().map(|p| length(p.as_ref())).collect();
    let mut times = HashMap::new();
    lengths.iter().for_each(|l| *times.entry(l).or_insert(0) += 1);
    let content = |(path, length): (&Path, &Option<u64>)| {
        let hash = length.filter(|_| times[length] > 1).and_then(|_| hash::of_file(path).ok());
        hash.unwrap_or_else(|| path.display().to_string())
    };
    paths.iter().map(AsRef::as_ref).zip(&lengths).map(content).collect()
}

/// The rows of a table that count: of rows that are alike in every column, the first. A warning names
/// the others.
pub fn rows_once(table: &Table, warnings: &mut Vec<String>) -> Vec<usize> {
    let firsts = firsts((0..table.rows()).map(|row| table.cells(row)));
    once(table, &firsts, "a row", warnings)
}

/// Leaves out the copies among the rows of a measured run. Without a time that goes on equal rows may be repeats.
pub fn timed_once(table: &mut Table, warnings: &mut Vec<String>) {
    let times = (0..table.rows()).map(|row| table.text(row, "t_s"));
    if times.collect::<HashSet<_>>().len() > 1 {
        let rows = rows_once(table, warnings);
        table.keep(&rows);
    }
}

/// As [`rows_once`] for rows that each name a picture in the column `image`, with where it is: beside the table unless
/// absolute. Rows of one picture, or of a copy of it, count once where all else is alike. One picture at two positions is
/// refused; a copy there is told, and stays.
pub fn pictures_once(table: &Table, warnings: &mut Vec<String>) -> Result<Vec<(usize, PathBuf)>> {
    let folder = table.path().parent().unwrap_or(Path::new(""));
    let name = |row: usize| table.text(row, "image");
    if let Some(row) = (0..table.rows()).find(|&row| name(row).is_empty()) {
        return Err(table.error(row, "image", "is empty", "name a picture"));
    }
    let paths: Vec<PathBuf> = (0..table.rows()).map(|row| folder.join(name(row))).collect();
    let mut firsts = firsts(contents(&paths));
    for (row, entry) in firsts.iter_mut().enumerate() {
        let Some(first) = *entry else { continue };
        let beside = |row: usize| table.cells(row).into_iter().filter(|(name, _)| *name != "image");
        if beside(row).eq(beside(first)) {
            continue;
        }
        let (image, line) = (name(row), table.line(first));
        if paths[row] == paths[first] {
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
    let rows = once(table, &firsts, "a picture", warnings);
    Ok(rows.into_iter().map(|row| (row, paths[row].clone())).collect())
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
