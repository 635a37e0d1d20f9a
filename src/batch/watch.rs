//! A watched folder: its files are measured as they come, once they are complete; a camera may still be writing the others.

use std::collections::{HashMap, HashSet};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime};

use super::input::{self, Kind};
use super::journal::Journal;
use super::{Item, Meanwhile, Watch, lock, pending};
use crate::error::{Error, Result};

/// Of the folder `name` (its batch writes to `out`), gives what is complete to `measure`, with all that is there, until nothing comes any more or the batch is told to end; returns all that
/// is there.
pub(super) fn folder(
    (name, out): (&str, &Path),
    kind: Kind,
    watch: Watch,
    meanwhile: Meanwhile,
    journal: &Mutex<Journal>,
    measure: impl Fn(&[&Item], &[Item]) -> Result<()>,
) -> Result<Vec<Item>> {
    let (mut settling, mut last) = (Settling::new(watch.settle), Instant::now());
    let is_there = || Path::new(name).is_dir();
    let mut there = is_there();
    let changed = || std::fs::metadata(name).and_then(|meta| meta.modified()).ok();
    let (mut looked, mut passed_over) = (changed(), input::passed_over(name, out, kind));
    loop {
        if looked != changed() {
            looked = changed();
            let now = input::passed_over(name, out, kind);
            now.iter()
                .filter(|now| passed_over.as_ref() != Some(now))
                .cloned()
                .for_each(meanwhile.say);
            passed_over = now;
        }
        if there != is_there() {
            there = !there;
            // A share that is unmounted, a camera's card that is pulled.
            (meanwhile.say)(format!(
                "{name}: the folder is {}",
                if there { "there again" } else { "gone; waiting for it" }
            ));
        }
        let items = match input::list(name, kind) {
            Err(Error::File { .. }) => Vec::new(), // nothing there yet
            other => other?,
        };
        // What failed half written is no failure once it has grown.
        let failed = lock(journal).failed();
        let grown: HashSet<&str> = (items.iter())
            .filter(|i| failed.contains(&i.name) && settling.has_changed_since(&i.path))
            .map(|i| i.name.as_str())
            .collect();
        lock(journal).forget(|name, _| grown.contains(name));
        let idle = watch.idle.is_some_and(|idle| last.elapsed() >= idle);
        let (mut ready, mut growing) = (Vec::new(), false);
        for item in pending(&items, journal) {
            match settling.state(&item.path) {
                State::Complete => ready.push(item),
                State::Growing => growing = true,
                // Nothing more comes: it is a failure with its reason, not forgotten.
                State::CutShort { .. } if idle => ready.push(item),
                State::CutShort { news: false } => {}
                State::CutShort { news: true } => (meanwhile.say)(format!(
                    "{}: its end is missing; waiting for it, {:.0} s at most",
                    item.path.display(),
                    settling.patience().as_secs_f64().ceil()
                )),
            }
        }
        if !ready.is_empty() {
            ready.iter().for_each(|item| settling.take(&item.path));
            measure(&ready, &items)?;
            last = Instant::now();
        } else if idle && !growing {
            return Ok(items);
        }
        if meanwhile.is_stopped() {
            return Ok(items);
        }
        std::thread::sleep(watch.settle.min(Duration::from_millis(200)));
    }
}

/// A file whose format says that its end is missing gets this many settling times before it is measured
/// all the same, and so becomes a failure with its reason.
const PATIENCE: u32 = 30;

/// How far a file of a watched folder has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// It changed a moment ago.
    Growing,
    /// It stays as it is, and its format's end is missing. To be told once.
    CutShort {
        /// It has not been told yet.
        news: bool,
    },
    /// It may be measured.
    Complete,
}

/// Remembers when each file last changed.
#[derive(Debug)]
struct Settling {
    settle: Duration,
    seen: HashMap<PathBuf, Seen>,
    /// How those were that were measured.
    taken: HashMap<PathBuf, Stamp>,
}

/// A file's size and the time of its last change.
type Stamp = (u64, Option<SystemTime>);

fn stamp(meta: &std::fs::Metadata) -> Stamp {
    (meta.len(), meta.modified().ok())
}

#[derive(Debug)]
struct Seen {
    stamp: Stamp,
    since: Instant,
    told: bool,
}

impl Settling {
    /// A file is complete when neither its size nor its time changed for `settle` and its format's end is there.
    fn new(settle: Duration) -> Self {
        Self { settle, seen: HashMap::new(), taken: HashMap::new() }
    }

    /// How far the file has come now. To be asked again and again.
    fn state(&mut self, path: &Path) -> State {
        let Ok(meta) = std::fs::metadata(path) else {
            // A link that leads nowhere is measured, and so told; what has gone is not.
            let there = std::fs::symlink_metadata(path).is_ok();
            return if there { State::Complete } else { State::Growing };
        };
        let now = stamp(&meta);
        let new = || Seen { stamp: now, since: Instant::now(), told: false };
        let entry = self.seen.entry(path.to_owned()).or_insert_with(new);
        if entry.stamp != now {
            *entry = new();
        }
        let quiet = entry.since.elapsed();
        if quiet < self.settle {
            return State::Growing;
        }
        // What cannot be opened is measured, and so told.
        if !has_end(path).unwrap_or(true) && quiet < self.settle * PATIENCE {
            let news = !std::mem::replace(&mut entry.told, true);
            return State::CutShort { news };
        }
        State::Complete
    }

    /// Notes how a file is that is measured now.
    fn take(&mut self, path: &Path) {
        self.seen.remove(path);
        if let Ok(meta) = std::fs::metadata(path) {
            self.taken.insert(path.to_owned(), stamp(&meta));
        }
    }

    /// Whether a file that was measured is no longer what it was.
    fn has_changed_since(&self, path: &Path) -> bool {
        let now = || std::fs::metadata(path).ok().map(|meta| stamp(&meta));
        self.taken.get(path).is_some_and(|was| now().is_some_and(|now| now != *was))
    }

    /// How long a file that is cut short is waited for.
    fn patience(&self) -> Duration {
        self.settle * PATIENCE
    }
}

/// Whether the last bytes are those with which the format ends. Formats without an end mark pass.
fn has_end(path: &Path) -> std::io::Result<bool> {
    let mut file = std::fs::File::open(path)?;
    let size = file.metadata()?.len();
    let (mut head, mut tail) = ([0; 4], Vec::new());
    if size < 16 {
        return Ok(false);
    }
    file.read_exact(&mut head)?;
    file.seek(SeekFrom::Start(size - 12))?;
    file.read_to_end(&mut tail)?;
    Ok(match head {
        [0x89, b'P', b'N', b'G'] => tail.windows(4).any(|w| w == b"IEND"),
        [0xff, 0xd8, ..] => tail.windows(2).any(|w| w == [0xff, 0xd9]),
        _ => true,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_still_growing_or_cut_short_is_not_complete() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let settle = Duration::from_millis(30);
        let mut settling = Settling::new(settle);
        let body = b"\x89PNG\r\n\x1a\nxxxxxxxxxxxxxxxxxxxx";
        std::fs::write(&path, body).unwrap();
        assert_eq!(settling.state(&path), State::Growing);
        std::thread::sleep(settle * 2);
        assert_eq!(settling.state(&path), State::CutShort { news: true });
        assert_eq!(settling.state(&path), State::CutShort { news: false });
        std::fs::write(&path, [&body[..], b"\0\0\0\0IEND\xaeB`\x82"].concat()).unwrap();
        assert_eq!(settling.state(&path), State::Growing, "it has just changed");
        std::thread::sleep(settle * 2);
        assert_eq!(settling.state(&path), State::Complete);
    }
}
