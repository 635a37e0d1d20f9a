//! Input files read whole, but only so far: a device or pipe that never ends, or the wrong file, is refused instead of
//! filling the memory.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};

/// The largest file of settings or results, TOML or JSON, in bytes.
pub const MOST_SETTINGS: u64 = 64 << 20;
/// The largest table, in bytes.
pub const MOST_TABLE: u64 = 512 << 20;
/// The largest picture file, in bytes: what is decoded may have no more.
pub const MOST_PICTURE: u64 = 1 << 30;

/// Opens a file to read.
pub fn open(path: &Path) -> Result<File> {
    if is_named_pipe(path) {
        let reason = "is a named pipe, which would be waited for, perhaps for ever";
        return Err(Error::file(
            path,
            reason,
            "give a file; a table may also be piped into /dev/stdin",
        ));
    }
    File::open(path).map_err(|e| Error::io(path, "read", e))
}

/// What the file at `path` holds, `most` bytes at most.
pub fn bytes(path: impl AsRef<Path>, most: u64) -> Result<Vec<u8>> {
    let path = path.as_ref();
    let failed = |e| Error::io(path, "read", e);
    let file = open(path)?;
    let size = file.metadata().map_err(failed)?.len();
    let mut bytes = Vec::with_capacity(size.min(most) as usize);
    if size <= most {
        file.take(most + 1).read_to_end(&mut bytes).map_err(failed)?;
    }
    if size.max(bytes.len() as u64) > most {
        let reason = format!("is larger than the {} MiB that are taken in here", most >> 20);
        return Err(Error::file(path, reason, "see that it is the right file, or split it"));
    }
    Ok(bytes)
}

/// Not what the shell makes of `<(...)`: that is a link, and somebody writes to it.
fn is_named_pipe(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        path.symlink_metadata().is_ok_and(|m| m.file_type().is_fifo())
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

/// As [`bytes`], as text without a byte order mark.
pub fn text(path: impl AsRef<Path>, most: u64) -> Result<String> {
    let path = path.as_ref();
    utf8(path, bytes(path, most)?)
}

/// Bytes of `path` as text without a byte order mark.
pub fn utf8(path: &Path, bytes: Vec<u8>) -> Result<String> {
    let mut text = String::from_utf8(bytes).map_err(|e| {
        if image::guess_format(e.as_bytes()).is_ok() {
            return Error::file(
                path,
                "is a picture, not a text",
                "give the table or settings file that is wanted here",
            );
        }
        let line = Lines::new(e.as_bytes()).line_at(e.utf8_error().valid_up_to());
        Error::field(path, Some(line), "text", "is not UTF-8", "save the file as text in UTF-8")
    })?;
    if text.starts_with('\u{feff}') {
        text.drain(..'\u{feff}'.len_utf8());
    }
    Ok(text)
}

/// Counts lines, however they end, up to one place after the other.
#[derive(Debug)]
pub struct Lines<'b> {
    bytes: &'b [u8],
    at: usize,
    line: u64,
}

impl<'b> Lines<'b> {
    /// Starts on line 1.
    pub fn new(bytes: &'b [u8]) -> Self {
        Self { bytes, at: 0, line: 1 }
    }

    /// The line, counted from 1, on which a byte stands; bytes are asked for in their order.
    pub fn line_at(&mut self, byte: usize) -> u64 {
        let end = byte.min(self.bytes.len());
        while self.at < end {
            let ends_line = match self.bytes[self.at] {
                b'\n' => true,
                b'\r' => self.bytes.get(self.at + 1) != Some(&b'\n'),
                _ => false,
            };
            self.line += u64::from(ends_line);
            self.at += 1;
        }
        self.line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_never_ends_or_is_too_large_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("f.txt");
        std::fs::write(&path, "\u{feff}12345").unwrap();
        assert_eq!(text(&path, 8).unwrap(), "12345");
        assert!(bytes(&path, 7).unwrap_err().to_string().contains("is larger than"));
        if Path::new("/dev/zero").exists() {
            assert!(bytes("/dev/zero", 100).unwrap_err().to_string().contains("/dev/zero"));
        }
    }

    #[test]
    fn lines_are_counted_however_they_end() {
        let mut lines = Lines::new(b"a\r\nb\nc\rd");
        assert_eq!([0, 3, 5, 7, 99].map(|byte| lines.line_at(byte)), [1, 2, 3, 4, 4]);
    }
}
