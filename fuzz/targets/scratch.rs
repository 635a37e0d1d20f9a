//! A file that holds what is fed, for functions that read files.

use std::path::PathBuf;

/// Where a file of this name lies; the folder is this process' own.
pub fn place(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("pivotsight-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for scratch files");
    folder.join(name)
}

/// The file, written.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = place(name);
    std::fs::write(&path, bytes).expect("a scratch file");
    path
}
