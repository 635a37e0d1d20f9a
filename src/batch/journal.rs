//! The journal of a batch: one JSON line a result, written whole, so that a killed run can go on.
//!
//! While a batch runs the lines stand in the order the results came in. A run that was killed, or that
//! filled the disk, leaves at most one incomplete line at the end, which the next opening cuts off.

use std::collections::{HashMap, HashSet};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Deserialize;

use crate::error::{Error, Result};
use crate::uncertainty::Verdict;

/// How often lines are forced onto the disk: what a power cut may cost.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// How long a lock is waited for: the system's lock ends with its process, but one that was killed takes a moment to go.
const PATIENCE: Duration = Duration::from_secs(2);

/// What one line says, as far as the batch itself needs it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Where the line begins.
    pub offset: u64,
    /// Its length with the newline.
    pub bytes: usize,
    /// Whether the item could not be measured.
    pub failed: bool,
    /// The verdict, where a limit applied.
    pub verdict: Option<Verdict>,
}

/// An open journal; nobody else can open it meanwhile.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    end: u64,
    synced: Instant,
    entries: HashMap<String, Entry>,
}

#[derive(Deserialize)]
struct Head {
    image: String,
    status: Status,
    #[serde(default)]
    verdict: Option<Verdict>,
}

/// Whether an item was measured.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize, schemars::JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// There is a result.
    Measured,
    /// There is a reason why not.
    Failed,
}

/// A result that the disk does not take.
pub(super) fn unwritten(path: &Path, e: std::io::Error) -> Error {
    let fix = "make room, then go on with --resume: nothing measured is lost";
    Error::file(path, format!("cannot write: {e}"), fix)
}

impl Journal {
    /// Opens or creates the journal, and once it is nobody else's and `may` says so, reads what is there and cuts an incomplete last
    /// line off.
    pub fn open(path: impl AsRef<Path>, may: impl FnOnce() -> Result<()>) -> Result<Self> {
        let path = path.as_ref().to_owned();
        let failed = |e| Error::io(&path, "open", e);
        let begun = Instant::now();
        let file = loop {
            // Opened anew each time: a batch that ends puts another file in its place.
            let file = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(failed)?;
            match file.try_lock() {
                Ok(()) => break file,
                Err(TryLockError::WouldBlock) if begun.elapsed() < PATIENCE => {
                    std::thread::sleep(PATIENCE / 40);
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::file(
                        &path,
                        "another batch is writing it",
                        "wait for it or choose another --out",
                    ));
                }
                Err(TryLockError::Error(e)) => return Err(failed(e)),
            }
        };
        may()?;
        let (entries, end) = read(&path, &file)?;
        file.set_len(end).map_err(failed)?;
        let mut journal = Self { path, file, end, synced: Instant::now(), entries };
        journal.file.seek(SeekFrom::Start(end)).map_err(|e| Error::io(&journal.path, "open", e))?;
        Ok(journal)
    }

    /// What has been measured, by the item's name.
    pub fn entries(&self) -> &HashMap<String, Entry> {
        &self.entries
    }

    /// Adds a line (without its newline).
    pub fn append(
        &mut self,
        name: &str,
        line: &str,
        failed: bool,
        verdict: Option<Verdict>,
    ) -> Result<()> {
        let text = format!("{line}\n");
        let error = |e| unwritten(&self.path, e);
        if let Err(e) = self.file.write_all(text.as_bytes()) {
            // No other thread may write behind half a line.
            let _ = self.file.set_len(self.end);
            let _ = self.file.seek(SeekFrom::Start(self.end));
            return Err(error(e));
        }
        if self.synced.elapsed() >= SYNC_EVERY {
            self.file.sync_data().map_err(error)?;
            self.synced = Instant::now();
        }
        let entry = Entry { offset: self.end, bytes: text.len(), failed, verdict };
        self.entries.insert(name.to_owned(), entry);
        self.end += text.len() as u64;
        Ok(())
    }

    /// The names of what could not be measured.
    pub fn failed(&self) -> HashSet<String> {
        let failed = self.entries.iter().filter(|(_, entry)| entry.failed);
        failed.map(|(name, _)| name.clone()).collect()
    }

    /// Forgets what the named items said, so that they are measured again.
    pub fn forget(&mut self, gone: impl Fn(&str, &Entry) -> bool) {
        self.entries.retain(|name, entry| !gone(name, entry));
    }

    /// The line of an entry, with its newline.
    pub fn line(&mut self, entry: Entry) -> Result<String> {
        let mut bytes = vec![0; entry.bytes];
        self.file
            .seek(SeekFrom::Start(entry.offset))
            .and_then(|_| self.file.read_exact(&mut bytes))
            .and_then(|()| self.file.seek(SeekFrom::Start(self.end)))
            .map_err(|e| Error::io(&self.path, "read", e))?;
        String::from_utf8(bytes)
            .map_err(|_| Error::file(&self.path, "is not UTF-8", "start the batch again"))
    }
}

/// The entries of every whole line and where the last of them ends. A later line about the same item wins.
fn read(path: &Path, file: &File) -> Result<(HashMap<String, Entry>, u64)> {
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let (mut entries, mut end, mut number) = (HashMap::new(), 0, 0);
    let mut line = Vec::new();
    loop {
        line.clear();
        number += 1;
        let bytes = reader.read_until(b'\n', &mut line).map_err(|e| Error::io(path, "read", e))?;
        if bytes == 0 || line.last() != Some(&b'\n') {
            return Ok((entries, end));
        }
        let head: Head = serde_json::from_slice(&line).map_err(|e| {
            Error::field(
                path,
                Some(number),
                "result",
                format!("is damaged ({e})"),
                "delete this line; its picture is then measured again",
            )
        })?;
        let failed = head.status == Status::Failed;
        entries.insert(head.image, Entry { offset: end, bytes, failed, verdict: head.verdict });
        end += bytes as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_incomplete_last_line_is_cut_off_wherever_it_ends() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let whole = "{\"image\":\"a\",\"status\":\"measured\",\"verdict\":\"pass\"}\n";
        let second = "{\"image\":\"b\",\"status\":\"failed\",\"reason\":\"ä\"}\n";
        for cut in 0..second.len() {
            std::fs::write(&path, [whole.as_bytes(), &second.as_bytes()[..cut]].concat()).unwrap();
            let mut journal = Journal::open(&path, || Ok(())).unwrap();
            assert_eq!(journal.entries().len(), 1);
            journal.append("b", second.trim_end(), true, None).unwrap();
            let entry = journal.entries()["b"];
            assert_eq!(journal.line(entry).unwrap(), second);
            drop(journal);
            assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("{whole}{second}"));
        }
    }

    #[test]
    fn a_second_writer_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let _first = Journal::open(&path, || Ok(())).unwrap();
        assert!(Journal::open(&path, || Ok(())).unwrap_err().to_string().contains("another batch"));
    }
}
