//! SHA-256 of files, in hexadecimal: how records know a picture and a calibration again.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::error::Result;
use crate::input;

/// Of bytes.
pub fn of_bytes(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// Of a file's content.
pub fn of_file(path: impl AsRef<Path>) -> Result<String> {
    input::bytes(path, input::MOST_PICTURE).map(|bytes| of_bytes(&bytes))
}
