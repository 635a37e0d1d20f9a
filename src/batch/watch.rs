//! Which files of a watched folder are complete: a camera may still be writing the others.

use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// A file whose format says that its end is missing gets this many settling times before it is measured
/// all the same, and so becomes a failure with its reason.
const PATIENCE: u32 = 30;

/// Remembers when each file last changed.
#[derive(Debug)]
pub struct Settling {
    settle: Duration,
    seen: HashMap<PathBuf, (u64, Option<SystemTime>, Instant)>,
}

impl Settling {
    /// A file is complete when neither its size nor its time changed for `settle` and its format's end is there.
    pub fn new(settle: Duration) -> Self {
        Self { settle, seen: HashMap::new() }
    }

    /// Whether the file is complete now. To be asked again and again.
    pub fn is_complete(&mut self, path: &Path) -> bool {
        let Ok(meta) = std::fs::metadata(path) else { return false };
        let now = (meta.len(), meta.modified().ok());
        let entry = self.seen.entry(path.to_owned()).or_insert((now.0, now.1, Instant::now()));
        if (entry.0, entry.1) != now {
            *entry = (now.0, now.1, Instant::now());
        }
        let quiet = entry.2.elapsed();
        let complete = quiet >= self.settle && has_end(path).unwrap_or(false)
            || quiet >= self.settle * PATIENCE;
        if complete {
            self.seen.remove(path);
        }
        complete
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
        assert!(!settling.is_complete(&path));
        std::thread::sleep(settle * 2);
        assert!(!settling.is_complete(&path), "the end mark is missing");
        std::fs::write(&path, [&body[..], b"\0\0\0\0IEND\xaeB`\x82"].concat()).unwrap();
        assert!(!settling.is_complete(&path), "it has just changed");
        std::thread::sleep(settle * 2);
        assert!(settling.is_complete(&path));
    }
}
