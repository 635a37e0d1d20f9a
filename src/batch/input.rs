//! Which files a batch measures: a folder, a pattern, a CSV manifest or one file.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::frame::named;
use crate::table::Table;

/// What a folder is searched for where the job measures tables of captures.
const TABLES: [&str; 1] = ["csv"];

/// What a job measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
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
}

/// Lists what `input` stands for: folders and patterns sorted by name, manifests in their own order.
pub fn list(input: &str, kind: Kind) -> Result<Vec<Item>> {
    let path = Path::new(input);
    let items = if path.is_dir() {
        folder(path, kind)?
    } else if path.is_file() && kind == Kind::Pictures && named::ends_in(path, &TABLES) {
        manifest(path)?
    } else if path.is_file() {
        vec![Item { name: input.to_owned(), path: path.to_owned(), calib: None }]
    } else if input.contains(['*', '?', '[']) {
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

/// Whether a folder's file is one to measure.
pub fn belongs(path: &Path, kind: Kind) -> bool {
    named::is_one_of(path, endings(kind))
}

fn endings(kind: Kind) -> &'static [&'static str] {
    if kind == Kind::Pictures { &named::PICTURES } else { &TABLES }
}

/// A name as results tell it, in JSON: two names that are no text would read alike.
fn text(path: &Path, name: &OsStr) -> Result<String> {
    name.to_str().map(str::to_owned).ok_or_else(|| {
        Error::file(path, "has a name that is not UTF-8", "give the file another name")
    })
}

fn folder(path: &Path, kind: Kind) -> Result<Vec<Item>> {
    let mut items = Vec::new();
    for entry in std::fs::read_dir(path).map_err(|e| Error::io(path, "read", e))? {
        let entry = entry.map_err(|e| Error::io(path, "read", e))?.path();
        if belongs(&entry, kind) {
            let name = text(&entry, entry.file_name().unwrap_or_default())?;
            items.push(Item { name, path: entry, calib: None });
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
    let others = all.iter().filter(|p| kind == Kind::Pictures && named::is_one_of(p, &OTHERS));
    let files = counted(others.count(), "a picture of a kind", "pictures of kinds");
    let said: Vec<String> = counted(folders, "a folder with more inside it", "folders inside it")
        .into_iter()
        .chain(files.map(|files| format!("{files} that is not read (convert to PNG)")))
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
            items.push(Item { name: text(&path, path.as_os_str())?, path, calib: None });
        }
    }
    items.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(items)
}

/// Columns `image` and optionally `calib`; paths are relative to the manifest's folder.
fn manifest(path: &Path) -> Result<Vec<Item>> {
    let table = Table::read(path, &["image"], &["calib"])?;
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
            Ok(Item { path: base.join(&name), name, calib })
        })
        .collect()
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
            let message = list(dir.path().to_str().unwrap(), Kind::Pictures).unwrap_err();
            assert!(message.to_string().contains("not UTF-8"), "{message}");
        }
    }
}
