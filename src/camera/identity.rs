//! Which calibration a result rests on.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Calibration;
use crate::error::Result;
use crate::hash;

/// A calibration file as results name it.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Identity {
    /// The name given in the file.
    pub name: String,
    /// The file.
    pub file: PathBuf,
    /// Of the file, in hexadecimal.
    pub sha256: String,
}

impl Calibration {
    /// Reads a calibration file and says which one it is.
    pub fn identified(path: impl AsRef<Path>) -> Result<(Self, Identity)> {
        let calibration = Self::read(&path)?;
        let identity = Identity {
            name: calibration.name.clone(),
            file: path.as_ref().to_owned(),
            sha256: hash::of_file(&path)?,
        };
        Ok((calibration, identity))
    }
}
