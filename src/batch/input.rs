//! Which files a batch measures: a folder, a pattern, a CSV manifest or one file.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::burns::{self, Burnt};
use crate::error::{Error, Result};
use crate::frame::named;
use crate::output::identity;
use crate::table::Table;

/// What a folder is searched for where the job measures tables of captures.
const TABLES: [&str; 1] = ["csv"];

/// What a job measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One picture of a burn test, one result.
    Burns,
    /// One picture, one result.
    Pictures,
    /// One table of captures, one result.
    Tables,
}

/// One thing to measure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Item {
    /// How results call it; no two items share a name.
    pub name: String,
    /// Where it is.
    pub path: PathBuf,
    /// A calibration of its own, where the manifest gives one.
    pub calib: Option<PathBuf>,
    /// How a burn was made, where the manifest tells.
    pub(super) burnt: Burnt,
    /// What looks wrong about that.
    pub(super) doubt: Option<String>,
    /// The manifest's columns of the user's own (`x_serial`), for the results.
    pub(super) own: Map<String, Value>,
}

impl Item {
    fn new(name: String, path: PathBuf) -> Self {
        Self { name, path, calib: None, burnt: Burnt::new(), doubt: None, own: Map::new() }
    }
}

/// Lists what `input` stands for: folders and patterns sorted by name, manifests in their own order.
pub fn list(input: &str, kind: Kind) -> Result<Vec<Item>> {
    let path = Path::new(input);
    let items = if path.is_dir() {
        folder(path, kind)?
    } else if path.is_file() && kind != Kind::Tables && named::ends_in(path, &TABLES) {
        manifest(path, kind)?
    } else if path.is_file() {
        vec![Item::new(input.to_owned(), path.to_owned())]
    } else if input.contains(PATTERN) {
        pattern(input, kind)?
    } else {
        return Err(Error::file(
            path,
            "does not exist",
            "give a folder, a 'pattern' or a CSV manifest",
        ));
    };
    if items.is_empty() {
        return Err(Error::file(
            path,
            "holds nothing to measure",
            format!("names must end in {}", endings(kind).join(", ")),
        ));
    }
    Ok(items)
}

/// Where an input is, however it is written and wherever it is seen from; names of a pattern's pictures begin as it is written.
pub(super) fn place(input: &str) -> String {
    let whole = std::path::absolute(input).unwrap_or_else(|_| input.into());
    let place = identity(&whole.components().collect::<PathBuf>()).display().to_string();
    let named_within = Path::new(input).is_dir() || named::ends_in(Path::new(input), &TABLES);
    if named_within { place } else { format!("{place}, as {input}") }
}

/// Whether pictures may come yet where there are none: a pattern's, or a folder's that is there.
pub(super) fn may_fill(input: &str) -> bool {
    Path::new(input).is_dir() || input.contains(PATTERN)
}

/// What makes a pattern of a name.
const PATTERN: [char; 3] = ['*', '?', '['];

/// Whether a folder's file is one to measure.
pub fn belongs(path: &Path, kind: Kind) -> bool {
    named::is_one_of(path, endings(kind))
}

fn endings(kind: Kind) -> &'static [&'static str] {
    if kind == Kind::Tables { &TABLES } else { &named::PICTURES }
}

/// A name as results tell it, in JSON. Of one that is no text the odd bytes are told by number: two such names must not read alike.
fn text(name: &OsStr) -> String {
    let mut told = String::new();
    for chunk in name.as_encoded_bytes().utf8_chunks() {
        told.push_str(&chunk.valid().replace("\\x", "\\\\x"));
        chunk.invalid().iter().for_each(|byte| told.push_str(&format!("\\x{byte:02X}")));
    }
    told
}

fn folder(path: &Path, kind: Kind) -> Result<Vec<Item>> {
    let mut items = Vec::new();
    for entry in std::fs::read_dir(path).map_err(|e| Error::io(path, "read", e))? {
        let entry = entry.map_err(|e| Error::io(path, "read", e))?.path();
        if belongs(&entry, kind) {
            let name = text(entry.file_name().unwrap_or_default());
            items.push(Item::new(name, entry));
        }
    }
    items.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(items)
}

/// What a folder holds that looks as if it were meant, and is not measured: pictures in folders inside it, and of kinds that are not read; `out` is
/// the batch's own.
pub fn passed_over(input: &str, out: &Path, kind: Kind) -> Option<String> {
    /// Pictures of other kinds.
    const OTHERS: [&str; 12] =
        ["webp", "heic", "heif", "avif", "gif", "jp2", "dng", "cr2", "cr3", "nef", "arw", "raw"];
    let within = |folder: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect()
    };
    let counted = |count: usize, one: &str, several: &str| match count {
        0 => None,
        1 => Some(one.to_owned()),
        n => Some(format!("{n} {several}")),
    };
    let all = within(Path::new(input));
    let is_filled = |p: &&PathBuf| {
        p.as_path() != out && p.is_dir() && within(p).iter().any(|inner| belongs(inner, kind))
    };
    let folders = all.iter().filter(is_filled).count();
    let others = all.iter().filter(|p| kind != Kind::Tables && named::is_one_of(p, &OTHERS));
    let files =
        counted(others.count(), "a picture of a kind that is", "pictures of kinds that are");
    let said: Vec<String> = counted(folders, "a folder with more inside it", "folders inside it")
        .into_iter()
        .chain(files.map(|files| format!("{files} not read (convert to PNG)")))
        .collect();
    (!said.is_empty()).then(|| format!("{input}: not measured: {}", said.join(", and ")))
}

fn pattern(pattern: &str, kind: Kind) -> Result<Vec<Item>> {
    let paths = glob::glob(pattern).map_err(|e| {
        Error::option(
            "PATTERN",
            format!("'{pattern}' is not a pattern ({})", e.msg),
            "use *, ? and [..]",
        )
    })?;
    let mut items = Vec::new();
    for path in paths {
        let path = path.map_err(|e| {
            let place = e.path().to_owned();
            Error::io(place, "read", e.into())
        })?;
        if path.is_file() && belongs(&path, kind) {
            items.push(Item::new(text(path.as_os_str()), path));
        }
    }
    items.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(items)
}

/// Columns `image` and optionally `calib`, and of burns how they were made; paths are relative to the manifest's folder.
fn manifest(path: &Path, kind: Kind) -> Result<Vec<Item>> {
    let made = burns::columns().filter(|_| kind == Kind::Burns);
    let table = Table::read(path, &["image"], &made.chain(["calib"]).collect::<Vec<_>>())?;
    let base = path.parent().unwrap_or(Path::new(""));
    let mut seen = HashSet::new();
    (0..table.rows())
        .map(|row| {
            let name = table.text(row, "image").to_owned();
            if name.is_empty() {
                return Err(table.error(row, "image", "is empty", "name a picture"));
            }
            if !seen.insert(name.clone()) {
                return Err(table.error(
                    row,
                    "image",
                    format!("'{name}' stands twice"),
                    "keep one of them",
                ));
            }
            let calib =
                Some(table.text(row, "calib")).filter(|c| !c.is_empty()).map(|c| base.join(c));
            let own = table.names().iter().filter(|name| name.starts_with("x_"));
            let own = own.map(|name| (name.clone(), word(table.text(row, name)))).collect();
            let burnt = burns::made(&table, row)?;
            let doubt = burns::doubt(&table, row, &burnt);
            Ok(Item { path: base.join(&name), name, calib, burnt, doubt, own })
        })
        .collect()
}

/// A word on burns whose heights look wrong.
pub(super) fn doubt(items: &[Item]) -> Option<String> {
    let mut doubts = items.iter().filter_map(|item| item.doubt.as_ref());
    let first = doubts.next()?;
    let more = match doubts.count() {
        0 => String::new(),
        n => format!(" ({n} more rows are so)"),
    };
    Some(format!("warning: {first}{more}"))
}

/// A word on files that a manifest names and nobody will find.
pub fn not_there(items: &[Item]) -> Option<String> {
    let named = items.iter().flat_map(|item| std::iter::once(&item.path).chain(&item.calib));
    let missing: Vec<&PathBuf> = named.filter(|path| !path.is_file()).collect();
    let first = missing.first()?.display();
    Some(match missing.len() {
        1 => format!("{first} does not exist"),
        n => format!("{first} and {} more files do not exist", n - 1),
    })
}

/// A cell as results hold it: what can be written back the same way as a whole number is one, the rest is text.
fn word(cell: &str) -> Value {
    match cell.parse::<i64>() {
        Ok(number) if number.to_string() == cell => number.into(),
        _ if cell.is_empty() => Value::Null,
        _ => cell.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_a_pattern_and_a_manifest_list_the_same_pictures() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["b.PNG", "a.jpg", "note.txt", ".hidden.png"] {
            std::fs::write(dir.path().join(name), "x").unwrap();
        }
        let names = |input: &Path| -> Vec<String> {
            list(input.to_str().unwrap(), Kind::Pictures)
                .unwrap()
                .into_iter()
                .map(|i| i.path.file_name().unwrap().to_str().unwrap().to_owned())
                .collect()
        };
        assert_eq!(names(dir.path()), ["a.jpg", "b.PNG"]);
        assert_eq!(names(&dir.path().join("*")), ["a.jpg", "b.PNG"]);
        let manifest = dir.path().join("list.csv");
        std::fs::write(&manifest, "image,calib\nb.PNG,own.toml\na.jpg,\n").unwrap();
        assert_eq!(names(&manifest), ["b.PNG", "a.jpg"]);
        std::fs::write(&manifest, "image\na.jpg\na.jpg\n").unwrap();
        let message = list(manifest.to_str().unwrap(), Kind::Pictures).unwrap_err().to_string();
        assert!(message.contains("list.csv:3") && message.contains("stands twice"), "{message}");
        #[cfg(unix)]
        {
            let odd = std::os::unix::ffi::OsStrExt::from_bytes(b"lat\xe4.png");
            std::fs::write(dir.path().join::<&OsStr>(odd), "x").unwrap();
            let listed = list(dir.path().to_str().unwrap(), Kind::Pictures).unwrap();
            assert!(listed.iter().any(|item| item.name == "lat\\xE4.png"), "{listed:?}");
        }
    }
}
