//! Which records are looked at.

use std::path::Path;

use super::{Record, Store};
use crate::clock;
use crate::error::{Error, Result};

/// Which records to read; empty reads all.
#[derive(Debug, Clone, Default)]
pub struct Filter {
    /// Only of this command.
    pub command: Option<String>,
    /// Only inputs that contain this text.
    pub input: Option<String>,
    /// Only with this verdict.
    pub verdict: Option<String>,
    /// Not before this time (a date will do).
    pub since: Option<String>,
    /// Before this time.
    pub until: Option<String>,
    /// Only the newest so many.
    pub last: Option<usize>,
}

/// The records that fit.
#[derive(Debug, Clone)]
pub struct Selected {
    /// Oldest first.
    pub records: Vec<Record>,
    /// What the file holds where none fits.
    pub warnings: Vec<String>,
}

/// Reads records of an existing file.
///
/// # Errors
/// Times that are none or in the wrong order; no records at `path`.
pub fn select(path: &Path, filter: &Filter) -> Result<Selected> {
    filter.check()?;
    let store = Store::open_existing(path)?;
    let records = store.read(filter)?;
    let mut warnings = Vec::new();
    if records.is_empty() {
        let held: Vec<String> =
            store.commands()?.iter().map(|(command, n)| format!("{command} {n}")).collect();
        if !held.is_empty() {
            warnings.push(format!("none of the records fits; the file holds: {}", held.join(", ")));
        }
    }
    Ok(Selected { records, warnings })
}

impl Filter {
    /// Whether its times are times, the earlier one first.
    fn check(&self) -> Result<()> {
        for (option, time) in [("--since", &self.since), ("--until", &self.until)] {
            if time.as_ref().is_some_and(|t| clock::parse(t).is_none()) {
                return Err(Error::option(
                    option,
                    "is not a date",
                    "write 2026-11-21 or 2026-11-21T03:35:10Z",
                ));
            }
        }
        if let (Some(since), Some(until)) = (&self.since, &self.until)
            && clock::parse(since) >= clock::parse(until)
        {
            let reason = format!("{until} is not after --since {since}");
            return Err(Error::option("--until", reason, "exchange them"));
        }
        Ok(())
    }
}
