//! Which files of a watched folder are complete: a camera may still be writing the others.

use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// A file whose format says that its end is missing gets this many settling times before it is measured
/// all the same, and so becomes a failure with its reason.
const PATIENCE: u32 = 30;

/// How far a file of a watched folder has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
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
pub struct Settling {
    settle: Duration,
    seen: HashMap<PathBuf, Seen>,
}

#[derive(Debug)]
struct Seen {
    size_and_time: (u64, Option<SystemTime>),
    since: Instant,
    told: bool,
}

impl Settling {
    /// A file is complete when neither its size nor its time changed for `settle` and its format's end is there.
    pub fn new(settle: Duration) -> Self {
        Self { settle, seen: HashMap::new() }
    }

    /// How far the file has come now. To be asked again and again.
    pub fn state(&mut self, path: &Path) -> State {
        let Ok(meta) = std::fs::metadata(path) else {
            // A link that leads nowhere is measured, and so told; what has gone is not.
            let there = std::fs::symlink_metadata(path).is_ok();
            return if there { State::Complete } else { State::Growing };
        };
        let now = (meta.len(), meta.modified().ok());
        let new = || Seen { size_and_time: now, since: Instant::now(), told: false };
        let entry = self.seen.entry(path.to_owned()).or_insert_with(new);
        if entry.size_and_time != now {
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
        self.seen.remove(path);
        State::Complete
    }

    /// How long a file that is cut short is waited for.
    pub fn patience(&self) -> Duration {
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
