//! Which files of a folder are meant, by their names; what a file really is, its content says.

use std::path::Path;

/// How the names of pictures end, in any case.
pub const PICTURES: [&str; 10] =
    ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "pgm", "ppm", "pnm", "pbm"];

/// Whether a folder's file is meant by its name: it ends in one of these, in any case, and is not hidden.
pub fn is_one_of(path: &Path, endings: &[&str]) -> bool {
    // A copy's name often begins with a dot until it is whole.
    ends_in(path, endings)
        && path.file_name().is_some_and(|name| !name.as_encoded_bytes().starts_with(b"."))
}

/// Whether a file's name ends in one of these, in any case.
pub fn ends_in(path: &Path, endings: &[&str]) -> bool {
    path.extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| endings.iter().any(|x| x.eq_ignore_ascii_case(e)))
}
