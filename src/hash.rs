//! SHA-256 of files, in hexadecimal: how records know a picture and a calibration again.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::error::{Error, Result};

/// Of bytes.
pub fn of_bytes(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// Of a file's content.
pub fn of_file(path: impl AsRef<Path>) -> Result<String> {
    let path = path.as_ref();
    std::fs::read(path).map(|bytes| of_bytes(&bytes)).map_err(|e| Error::io(path, "read", e))
}
