//! The one error type: every message says what is wrong, where, and what to do about it.

use std::path::{Path, PathBuf};

/// What can go wrong. `Display` gives the message a user reads.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused to read or write a file.
    #[error("{}: cannot {action}: {source}; {fix}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: "read", "write", "create".
        action: &'static str,
        /// The system's own words.
        source: std::io::Error,
        /// What to do.
        fix: String,
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

/// What helps against a system error.
fn remedy(path: &Path, error: &std::io::Error) -> String {
    use std::io::ErrorKind::{
        AlreadyExists, FileTooLarge, IsADirectory, NotADirectory, NotFound, PermissionDenied,
        QuotaExceeded, StorageFull,
    };
    match error.kind() {
        NotFound => missing(path),
        PermissionDenied => "ask for the rights to it, or give another name".into(),
        IsADirectory => "give a file, this is a folder".into(),
        AlreadyExists | NotADirectory => "a file is where a folder is due; correct the path".into(),
        StorageFull | QuotaExceeded | FileTooLarge => "make room, then run this again".into(),
        _ => "see that the disk is well, then run this again".into(),
    }
}

/// The first part of a path that is not there, and what is there that is written nearly the same.
pub fn missing(path: &Path) -> String {
    let whole = path.ancestors().take_while(|p| !p.as_os_str().is_empty());
    let Some(gone) = whole.filter(|p| !p.exists()).last() else {
        return "correct the path".into();
    };
    if let Ok(target) = gone.read_link() {
        let (link, target) = (gone.display(), target.display());
        return format!("'{link}' is a link to '{target}', which is not there: correct the link");
    }
    let wanted = gone.file_name().unwrap_or_default().to_string_lossy();
    if wanted.contains(['*', '?']) {
        return "no file is written so: a pattern is for 'batch', or for the shell (without quotes)".into();
    }
    let beside = gone.parent().unwrap_or(Path::new(""));
    let folder = if beside.as_os_str().is_empty() { Path::new(".") } else { beside };
    let names = std::fs::read_dir(folder).into_iter().flatten().take(MOST_NAMES).flatten();
    match nearest(&wanted, names.map(|e| e.file_name().to_string_lossy().into_owned())) {
        Some(name) => format!("did you mean '{}'?", beside.join(name).display()),
        _ if gone != path => format!("there is no '{}'; correct the path", gone.display()),
        _ => "correct the path".into(),
    }
}

/// Names of a folder that are looked at for a likely one.
const MOST_NAMES: usize = 10_000;

/// The name that is written nearly as the wanted one, if there is one.
pub fn nearest(wanted: &str, names: impl IntoIterator<Item = impl Into<String>>) -> Option<String> {
    let wanted = wanted.to_lowercase();
    let likely = 1 + wanted.chars().count() / 4;
    let names = names.into_iter().map(Into::into);
    let (edits, name) = names.map(|name| (edits(&wanted, &name.to_lowercase()), name)).min()?;
    (edits <= likely && edits < wanted.chars().count()).then_some(name)
}

/// Letters to insert, delete or replace to make one word of the other (Levenshtein).
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// Shorthand used everywhere.
pub type Result<T> = std::result::Result<T, Error>;

/// Refuses an option's number that is not finite or not above 0.
pub fn above_zero(option: &str, value: f64, fix: &str) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(Error::option(option, format!("{value} is not a number above 0"), fix))
}

impl Error {
    /// A system error on `path` while trying to `action`.
    pub fn io(path: impl AsRef<Path>, action: &'static str, source: std::io::Error) -> Self {
        let path = path.as_ref();
        Self::Io { path: path.to_owned(), action, fix: remedy(path, &source), source }
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

    /// The same of an option that stands for the one that is wrong.
    #[must_use]
    pub fn of_option(self, name: &str) -> Self {
        match self {
            Self::Option { reason, fix, .. } => Self::option(name, reason, fix),
            another => another,
        }
    }

    /// The same of a file that says what an option says elsewhere, or that the data are from.
    #[must_use]
    pub fn in_file(self, path: impl AsRef<Path>, line: Option<u64>) -> Self {
        let path = path.as_ref();
        match self {
            Self::Option { option, reason, fix } => {
                let key = option.trim_start_matches("--").replace('-', "_");
                Self::field(path, line, key, reason, fix)
            }
            Self::Measure { subject, reason, fix } => {
                Self::measure(format!("{}: {subject}", path.display()), reason, fix)
            }
            names_a_file => names_a_file,
        }
    }

    /// Says which file the data are from that cannot be measured; options stay options.
    pub fn measured_in(self, path: impl AsRef<Path>) -> Self {
        match self {
            Self::Measure { .. } => self.in_file(path, None),
            other => other,
        }
    }

    /// Says which line of a table names the file or picture that it is about.
    #[must_use]
    pub fn on_line(self, line: u64) -> Self {
        let told = |subject: String, reason, fix| {
            Self::measure(format!("line {line}: {subject}"), reason, fix)
        };
        match self {
            Self::Io { path, action, source, fix } => {
                told(path.display().to_string(), format!("cannot {action}: {source}"), fix)
            }
            Self::File { path, reason, fix } => told(path.display().to_string(), reason, fix),
            Self::Measure { subject, reason, fix } => told(subject, reason, fix),
            other => other,
        }
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
