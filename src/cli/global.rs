//! Options every command has, and what is said on standard error and in the log.

use std::io::Write;

use clap::Args;

use super::outfiles::{Files, OutFile};
use crate::clock;
use crate::output::Format;
use crate::store::keep::Taken;

/// Options every command has.
#[derive(Debug, Args)]
pub struct Global {
    /// How the result is printed
    #[arg(long, value_enum, default_value = "table", global = true)]
    pub format: Format,
    /// Write the result to FILE (whole or not at all) instead of standard output
    #[arg(long, value_name = "FILE", global = true)]
    pub out: Option<OutFile>,
    /// No progress and no warnings on standard error
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Append what is said on standard error, and how the run ended, to FILE
    #[arg(long, value_name = "FILE", global = true)]
    pub log: Option<OutFile>,
    /// Keep the result in the records FILE (see `pivotsight history`)
    #[arg(long, value_name = "FILE", global = true)]
    pub records: Option<OutFile>,
    /// When what is measured was captured, for the records: a time (2026-11-24 or 2026-11-24T10:30:00Z, UTC), or `file`,
    /// when each picture's file was last changed; the run's own time where left out
    #[arg(long, value_name = "TIME", global = true, requires = "records")]
    pub taken: Option<Taken>,
    /// Say on standard error how the command was understood, defaults included, how it ended and how long it took
    #[arg(long, short, action = clap::ArgAction::Count, global = true)]
    pub verbose: u8,
    /// What is written beside the result
    #[arg(skip)]
    pub(super) files: Files,
}

impl Global {
    /// Prints a progress line or warning on standard error unless `--quiet`.
    pub fn say(&self, message: impl std::fmt::Display) {
        if !self.quiet {
            complain(&message);
        }
        self.note(message);
    }

    /// Prints what the user must know even with `--quiet`.
    pub fn insist(&self, message: impl std::fmt::Display) {
        complain(&message);
        self.note(message);
    }

    /// Prints what only `--verbose` asks for; the log has it in its own words.
    pub(super) fn detail(&self, message: impl std::fmt::Display) {
        if self.verbose > 0 && !self.quiet {
            complain(message);
        }
    }

    /// Appends a line to the log, if there is one; a log that cannot be written never stops a measurement.
    pub(super) fn note(&self, message: impl std::fmt::Display) {
        let Some(path) = &self.log else { return };
        let line = format!("{} {message}\n", clock::utc(clock::now()));
        let file = std::fs::OpenOptions::new().append(true).create(true).open(path);
        if let Err(e) = file.and_then(|mut file| file.write_all(line.as_bytes())) {
            complain(format_args!("pivotsight: {}: cannot write the log: {e}", path.display()));
        }
    }
}

/// A line on standard error. Where that is full or closed nobody reads it, and the result must not be lost with it.
pub(super) fn complain(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
