//! The files a command writes beside what it prints: none is also read, none is written twice, and they appear
//! together once the command has ended well.

use std::ffi::OsString;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use clap::ArgMatches;

use super::Global;
use crate::error::{Error, Result};
use crate::output::{Together, check_writable, create_folder, identity, is_device};

/// An option that names a file to write. A plain `PathBuf` is a file to read, or a folder.
#[derive(Debug, Clone)]
pub struct OutFile(PathBuf);

impl From<OsString> for OutFile {
    fn from(text: OsString) -> Self {
        Self(text.into())
    }
}

impl Deref for OutFile {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl AsRef<Path> for OutFile {
    fn as_ref(&self) -> &Path {
        &self.0
    }
}

/// Files that grow instead of being written anew.
const APPENDED: [&str; 2] = ["log", "records"];

/// What may be read and written as one file: `calib laser` adds to its calibration.
const IN_PLACE: [&str; 2] = ["calib", "write_calib"];

/// What one run writes.
#[derive(Debug, Default)]
pub struct Files {
    /// By option.
    planned: Vec<Named>,
    /// What is read: files by identity, and who names them.
    read: Mutex<Vec<(PathBuf, String)>>,
    /// Complete, not yet in their places.
    complete: Mutex<(Together, Vec<PathBuf>)>,
}

/// A path under the name of its option.
#[derive(Debug)]
struct Named {
    id: String,
    shown: String,
    path: PathBuf,
    /// `None` for a device, which may be named as often as one likes.
    identity: Option<PathBuf>,
}

impl Files {
    /// Looks at a whole command line before anything is done. `folder_out`: `--out` is a folder here.
    pub fn plan(
        mut command: &clap::Command,
        mut matches: &ArgMatches,
        folder_out: bool,
    ) -> Result<Self> {
        while let Some((name, inner)) = matches.subcommand() {
            let Some(found) = command.find_subcommand(name) else { break };
            (command, matches) = (found, inner);
        }
        let (mut planned, mut read) = (Vec::<Named>::new(), Vec::<Named>::new());
        for id in matches.ids().map(clap::Id::as_str) {
            let named = |path: &Path| Named {
                id: id.into(),
                shown: shown(command, id),
                path: path.into(),
                identity: (!is_device(path)).then(|| identity(path)),
            };
            // The kind of value tells outputs from inputs; `clap` refuses to hand one out as the other.
            if let Ok(Some(paths)) = matches.try_get_many::<OutFile>(id) {
                planned.extend(paths.map(|p| named(p)));
            } else if let Ok(Some(paths)) = matches.try_get_many::<PathBuf>(id) {
                read.extend(paths.map(|p| named(p)));
            }
        }
        if let Some(odd) = planned.iter().chain(&read).find(|n| n.path.to_str().is_none()) {
            // Results name their files, and JSON is UTF-8.
            return Err(Error::option(
                &odd.shown,
                format!("'{}' is not a name in UTF-8", odd.path.display()),
                "give the file another name",
            ));
        }
        for (i, output) in planned.iter().enumerate() {
            let same =
                |other: &&Named| output.identity.is_some() && other.identity == output.identity;
            if let Some(other) = planned[..i].iter().find(same) {
                return Err(one_file(output, &format!("what {} writes", other.shown)));
            }
            let in_place = |other: &Named| IN_PLACE == [&other.id, &output.id];
            if let Some(other) = read.iter().find(|o| same(o) && !in_place(o)) {
                return Err(one_file(output, &format!("what {} names", other.shown)));
            }
            let folder = folder_out && output.id == "out";
            if !folder && !APPENDED.contains(&output.id.as_str()) {
                check_writable(&output.path)?;
            }
        }
        let named = |r: Named| Some((r.identity?, format!("what {} names", r.shown)));
        let read = Mutex::new(read.into_iter().filter_map(named).collect());
        Ok(Self { planned, read, complete: Mutex::default() })
    }

    /// Completes a file.
    pub fn add(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        lock(&self.complete).0.add(path, bytes)
    }

    /// Puts what is complete in its place; the paths of what a command wrote beside its result.
    pub fn publish(&self) -> Result<Vec<PathBuf>> {
        let (together, paths) = std::mem::take(&mut *lock(&self.complete));
        together.publish().map(|()| paths)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // What a thread that broke had added is complete all the same.
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// An output that would replace something.
fn one_file(output: &Named, other: &str) -> Error {
    let reason = format!("'{}' is the same file as {other}", output.path.display());
    Error::option(&output.shown, reason, "give another name")
}

/// An argument as the user knows it.
fn shown(command: &clap::Command, id: &str) -> String {
    let Some(argument) = command.get_arguments().find(|a| a.get_id() == id) else {
        return format!("--{id}");
    };
    match (argument.get_long(), argument.get_value_names()) {
        (Some(long), _) => format!("--{long}"),
        (None, Some([name, ..])) => name.to_string(),
        (None, _) => id.to_uppercase(),
    }
}

impl Global {
    /// Refuses outputs that would replace `paths`, files that `table` names; before they are measured.
    pub fn reads<P: AsRef<Path>>(
        &self,
        table: &Path,
        paths: impl IntoIterator<Item = P>,
    ) -> Result<()> {
        let mut read = lock(&self.files.read);
        for path in paths {
            let identity = identity(path.as_ref());
            let who = format!("one that '{}' names", table.display());
            if let Some(output) =
                self.files.planned.iter().find(|o| o.identity.as_ref() == Some(&identity))
            {
                return Err(one_file(output, &who));
            }
            read.push((identity, who));
        }
        Ok(())
    }

    /// Refuses files to be written into the folder that `option` gives where they would replace what is read, or what another
    /// option writes; before anything is measured, and after [`Global::reads`].
    pub fn makes(
        &self,
        option: &str,
        folder: &Path,
        names: impl IntoIterator<Item = impl AsRef<Path>>,
    ) -> Result<()> {
        let read = lock(&self.files.read);
        for name in names {
            let path = folder.join(name);
            let own = identity(&path);
            let planned = self.files.planned.iter().filter(|o| o.identity.as_ref() == Some(&own));
            let mut written = planned.map(|o| format!("what {} writes", o.shown));
            let named = read.iter().find(|(r, _)| *r == own).map(|(_, who)| who.clone());
            if let Some(who) = named.or_else(|| written.next()) {
                return Err(Error::option(
                    option,
                    format!("'{}' would replace {who}", path.display()),
                    "give another folder",
                ));
            }
        }
        Ok(())
    }

    /// Writes a file beside the result: it appears once the command has ended well.
    pub fn write(&self, path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
        let mut complete = lock(&self.files.complete);
        complete.0.add(&path, bytes)?;
        complete.1.push(path.as_ref().to_owned());
        Ok(())
    }

    /// As [`Global::write`], into a folder that is created where it is missing.
    pub fn write_into(&self, folder: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf> {
        self.makes("DIR", folder, [name])?;
        create_folder(folder)?;
        let path = folder.join(name);
        self.write(&path, bytes)?;
        Ok(path)
    }
}
