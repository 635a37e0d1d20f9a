//! The machine file that `solve` writes: the numbers found, and all that the file held beside them.

use std::path::Path;

use super::Session;
use super::solve::Solved;
use crate::error::{Error, Result};
use crate::machine::{Machine, is_entered};
use crate::uncertainty::Verdict;

/// The machine to write to `path`: the one that the session says the control was set from, with the numbers of `found`; `found` alone where it
/// names none. `None` where the check touch fails: numbers that are wrong are not to be kept. `warnings` tell of what is not written.
///
/// # Errors
/// A file at `path` that holds more than numbers, which would be lost.
pub fn to_write(
    session: &Session,
    solved: &Solved,
    found: Machine,
    path: &Path,
    warnings: &mut Vec<String>,
) -> Result<Option<Machine>> {
    if solved.check.is_some_and(|c| c.verdict == Verdict::Fail) {
        warnings.push(format!("{}: not written, because the check touch fails", path.display()));
        return Ok(None);
    }
    let Some(now) = session.control.as_ref().filter(|c| c.from_file) else {
        keeps_more(path)?;
        return Ok(Some(found));
    };
    let gone = now.machine.effects.iter().filter(|e| is_entered(e));
    warnings.extend(
        gone.map(|e| format!("{} is not in the file written: the number is measured anew", e.name)),
    );
    Ok(Some(found.within(&now.machine)))
}

/// Refuses to write numbers over a machine file that holds more than numbers.
fn keeps_more(path: &Path) -> Result<()> {
    let there = path.is_file().then(|| Machine::read(path).ok()?.more_than_numbers()).flatten();
    match there {
        Some(parts) => Err(Error::option(
            "--write-machine",
            format!("{} holds {parts}, which would be lost", path.display()),
            "name it in the session ([control] machine = \"...\") and write a new file: what it holds beside the numbers is kept there",
        )),
        None => Ok(()),
    }
}
