//! Files written whole or not at all, alone or together.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// Writes `bytes` to `path` so that a reader sees the old file or the new one, never a part. A device or pipe
/// (`/dev/stdout`) is written to as it is, not replaced by a file.
pub fn write_whole(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    let path = path.as_ref();
    write_streamed(path, |file| put(file, path, bytes))
}

/// As [`write_whole`], for files too large to hold in memory.
pub fn write_streamed(path: &Path, fill: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    if is_device(path) {
        return fill(&mut open_device(path)?);
    }
    let mut staged = Staged::new(path)?;
    fill(staged.file.as_file_mut())?;
    staged.publish()
}

/// Several files that are put in their places, one by one, once all of them are complete.
#[derive(Debug, Default)]
pub struct Together {
    devices: Vec<(PathBuf, Vec<u8>)>,
    files: Vec<Staged>,
}

impl Together {
    /// Writes a file beside its place.
    pub fn add(&mut self, path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
        let path = path.as_ref();
        if is_device(path) {
            self.devices.push((path.to_owned(), bytes.to_owned()));
            return Ok(());
        }
        let mut staged = Staged::new(path)?;
        put(staged.file.as_file_mut(), path, bytes)?;
        self.files.push(staged);
        Ok(())
    }

    /// Puts every file in its place; devices first, for they may still refuse.
    pub fn publish(self) -> Result<()> {
        for (path, bytes) in &self.devices {
            put(&mut open_device(path)?, path, bytes)?;
        }
        self.files.into_iter().try_for_each(Staged::publish)
    }
}

/// Whether a file can be written at `path`, as far as that can be told before.
pub fn check_writable(path: &Path) -> Result<()> {
    if is_device(path) { Ok(()) } else { Staged::new(path).map(drop) }
}

/// A new file beside the place it is for; gone if it is never put there.
#[derive(Debug)]
struct Staged {
    /// As the user wrote it.
    path: PathBuf,
    /// The same with links followed: the file is replaced, not the link.
    place: PathBuf,
    file: NamedTempFile,
}

impl Staged {
    fn new(path: &Path) -> Result<Self> {
        let failed = |e: std::io::Error| Error::io(path, "write", e);
        let old = fs::metadata(path).ok();
        if old.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(Error::file(path, "is a folder", "give the name of a file"));
        }
        if old.as_ref().is_some_and(|old| old.permissions().readonly()) {
            return Err(Error::file(
                path,
                "is write-protected",
                "give another name, or lift the protection",
            ));
        }
        let place = fs::canonicalize(path).unwrap_or_else(|_| end_of_links(path));
        let folder = folder_of(&place);
        if !folder.is_dir() {
            return Err(Error::file(
                path,
                format!("the folder '{}' does not exist", folder.display()),
                "create it or correct the path",
            ));
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(".pivotsight-");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // What the user's mask leaves of it, as for any new file.
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let file = builder.tempfile_in(folder).map_err(failed)?;
        if let Some(old) = old {
            file.as_file().set_permissions(old.permissions()).map_err(failed)?;
        }
        Ok(Self { path: path.to_owned(), place, file })
    }

    fn publish(self) -> Result<()> {
        let Self { path, place, file } = self;
        let failed = |e: std::io::Error| Error::io(&path, "write", e);
        file.as_file().sync_all().map_err(failed)?;
        file.persist(place).map_err(|e| failed(e.error))?;
        Ok(())
    }
}

fn put(file: &mut File, path: &Path, bytes: &[u8]) -> Result<()> {
    file.write_all(bytes).map_err(|e| Error::io(path, "write", e))
}

/// Where a link leads that leads to nothing yet.
fn end_of_links(path: &Path) -> PathBuf {
    const MOST: usize = 40;
    let mut place = path.to_owned();
    for _ in 0..MOST {
        let Ok(next) = fs::read_link(&place) else { break };
        place = folder_of(&place).join(next);
    }
    place
}

/// Whether something is there that is neither file nor folder.
pub fn is_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir())
}

fn open_device(path: &Path) -> Result<File> {
    OpenOptions::new().write(true).open(path).map_err(|e| Error::io(path, "write", e))
}

/// The folder a file is in.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// One name for a file, however its path is written; one that is not there yet is known by its folder.
pub fn identity(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| {
        let folder = fs::canonicalize(folder_of(path));
        folder.ok().zip(path.file_name()).map_or_else(|| path.to_owned(), |(f, name)| f.join(name))
    })
}

/// Creates a folder for results, with its parents.
pub fn create_folder(path: impl AsRef<Path>) -> Result<()> {
    fs::create_dir_all(&path).map_err(|e| Error::io(&path, "create", e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_write_into_a_missing_folder_says_so() {
        let message = write_whole("/no/such/folder/file.txt", b"x").unwrap_err().to_string();
        assert!(message.contains("does not exist"), "{message}");
    }

    #[test]
    fn files_written_together_appear_together_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let mut together = Together::default();
        together.add(at("a.txt"), b"a").unwrap();
        assert!(together.add(at("no/b.txt"), b"b").is_err());
        drop(together);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
        let mut together = Together::default();
        together.add(at("a.txt"), b"a").unwrap();
        together.add(at("b.txt"), b"b").unwrap();
        together.publish().unwrap();
        assert_eq!(fs::read(at("b.txt")).unwrap(), b"b");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_rights_stay_as_they_are() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real.txt"), dir.path().join("link.txt"));
        write_whole(&real, b"old").unwrap();
        fs::set_permissions(&real, fs::Permissions::from_mode(0o600)).unwrap();
        symlink(&real, &link).unwrap();
        write_whole(&link, b"new").unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::metadata(&real).unwrap().permissions().mode() & 0o777, 0o600);
        fs::set_permissions(&real, fs::Permissions::from_mode(0o444)).unwrap();
        let message = write_whole(&real, b"newer").unwrap_err().to_string();
        assert!(message.contains("is write-protected"), "{message}");
    }
}
