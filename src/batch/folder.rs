//! The folder of a batch: what it must not replace, and whether it may be gone on with.

use std::path::Path;

use serde_json::Value;

use super::{Item, Options, burns, run};
use crate::error::{Error, Result};
use crate::output::{identity, write_whole};

/// Refuses a folder for results in which they would replace what is measured, or be measured themselves later.
pub(super) fn keep_apart(out: &Path, items: &[Item]) -> Result<()> {
    let here = identity(out);
    let own = |item: &&Item| {
        let place = identity(&item.path);
        let folder = place.parent().unwrap_or(Path::new(""));
        folder == here && FILES.iter().any(|f| place.file_name().is_some_and(|n| n == *f))
            || folder == here.join(run::OVERLAYS)
    };
    match items.iter().find(own) {
        None => Ok(()),
        Some(item) => Err(Error::option(
            "--out",
            format!("the results would be written where '{}' is", item.path.display()),
            "name another folder",
        )),
    }
}

/// What a batch writes into its folder.
const FILES: [&str; 6] =
    ["batch.json", "results.jsonl", "results.csv", "results.parquet", "summary.json", burns::FILE];

/// Refuses a folder in which there are files of these names that no batch has made.
pub(super) fn is_ours_to_fill(out: &Path) -> Result<()> {
    if out.join("batch.json").exists() {
        return Ok(());
    }
    let holds = |name: &&&str| out.join(name).metadata().is_ok_and(|m| m.len() > 0);
    match FILES.iter().find(holds) {
        None => Ok(()),
        Some(name) => Err(Error::file(
            out,
            format!("holds a {name} that is no batch's: there is no batch.json beside it"),
            "choose another --out",
        )),
    }
}

/// Refuses to mix results of different jobs, and to touch results nobody asked to go on with.
pub(super) fn claim(options: &Options, identity: &Value) -> Result<()> {
    let path = options.out.join("batch.json");
    let Ok(old) = std::fs::read(&path) else {
        return write_whole(&path, format!("{identity:#}\n").as_bytes());
    };
    if !options.resume {
        return Err(Error::file(
            &options.out,
            "holds a batch already",
            "add --resume to go on with it, or choose another --out",
        ));
    }
    let old: Value = serde_json::from_slice(&old).map_err(|e| {
        Error::file(&path, format!("is damaged ({e})"), "start again in another --out")
    })?;
    let same = |key: &str| old.get(key) == identity.get(key);
    for (key, what) in [
        ("version", "the program's version"),
        ("input_path", "the input"),
        ("calib_sha256", "the calibration"),
        ("job", "the job"),
    ] {
        if !same(key) {
            // A hash says nothing to people.
            let was = old.get(key).and_then(Value::as_str).filter(|_| key != "calib_sha256");
            let was = was.map_or_else(String::new, |was| format!(" ({was})"));
            return Err(Error::file(
                &options.out,
                format!("{what} is not the one this batch was begun with{was}"),
                "go on with the same one, or start again in another --out",
            ));
        }
    }
    Ok(())
}
