//! The one error type: every message says what is wrong, where, and what to do about it.

use std::path::{Path, PathBuf};

/// What can go wrong. `Display` gives the message a user reads.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused to read or write a file.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: "read", "write", "create".
        action: &'static str,
        /// The system's own words.
        source: std::io::Error,
    },
    /// A file could be read, but what it holds is not usable as a whole.
    #[error("{}: {reason}; {fix}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// What to do.
        fix: String,
    },
    /// One line or field of a file is wrong.
    #[error("{}{}: {field}: {reason}; {fix}", path.display(), line.map(|l| format!(":{l}")).unwrap_or_default())]
    Field {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1, where it is known.
        line: Option<u64>,
        /// The column, key or word.
        field: String,
        /// What is wrong.
        reason: String,
        /// What to do.
        fix: String,
    },
    /// An option or argument is out of range or does not fit the others.
    #[error("{option}: {reason}; {fix}")]
    Option {
        /// The option as the user writes it.
        option: String,
        /// What is wrong.
        reason: String,
        /// What to do.
        fix: String,
    },
    /// The input is well formed, but what was asked for cannot be measured in it.
    #[error("{subject}: {reason}; {fix}")]
    Measure {
        /// The picture or data set.
        subject: String,
        /// What could not be measured, and why.
        reason: String,
        /// What to do.
        fix: String,
    },
}

/// Shorthand used everywhere.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A system error on `path` while trying to `action`.
    pub fn io(path: impl AsRef<Path>, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), action, source }
    }

    /// A file that is unusable as a whole.
    pub fn file(path: impl AsRef<Path>, reason: impl Into<String>, fix: impl Into<String>) -> Self {
        Self::File { path: path.as_ref().to_owned(), reason: reason.into(), fix: fix.into() }
    }

    /// A wrong line or field of a file.
    pub fn field(
        path: impl AsRef<Path>,
        line: Option<u64>,
        field: impl Into<String>,
        reason: impl Into<String>,
        fix: impl Into<String>,
    ) -> Self {
        Self::Field {
            path: path.as_ref().to_owned(),
            line,
            field: field.into(),
            reason: reason.into(),
            fix: fix.into(),
        }
    }

    /// An option that is out of range or does not fit.
    pub fn option(
        option: impl Into<String>,
        reason: impl Into<String>,
        fix: impl Into<String>,
    ) -> Self {
        Self::Option { option: option.into(), reason: reason.into(), fix: fix.into() }
    }

    /// Something that cannot be measured in otherwise good input.
    pub fn measure(
        subject: impl Into<String>,
        reason: impl Into<String>,
        fix: impl Into<String>,
    ) -> Self {
        Self::Measure { subject: subject.into(), reason: reason.into(), fix: fix.into() }
    }
}
