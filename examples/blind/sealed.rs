//! The sealed truths: a file without a name, so that nothing can open it while the diagnosis runs; scoring reads it afterwards.

use std::fs::File;
use std::io::{BufRead, BufReader, Seek, Write};

use serde::{Deserialize, Serialize};

/// A hidden truth: what was put into the data.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Library names hidden.
    pub names: Vec<String>,
    /// Variable of an effect outside the library.
    pub unknown: Option<String>,
    /// Sizes, where the library's parameter is the generator's.
    pub sizes: Vec<Size>,
}

/// A hidden effect's size as the library measures it, whatever its sign.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// The effect.
    pub name: String,
    /// The parameter.
    pub parameter: String,
    /// Its value.
    pub value: f64,
}

impl Size {
    /// Of the hidden names, each with the generator's size, as `of` tells them in the library's parameters.
    pub fn list(
        names: &[String],
        sizes: &[f64],
        of: fn(&str, f64) -> Option<(&'static str, f64)>,
    ) -> Vec<Self> {
        let known = names.iter().zip(sizes).filter_map(|(name, size)| {
            let (parameter, value) = of(name, *size)?;
            Some(Self { name: name.clone(), parameter: parameter.into(), value })
        });
        known.collect()
    }
}

/// Truths in the order of their cases.
pub struct Sealed(File);

impl Sealed {
    /// An empty file that has no path.
    pub fn new() -> std::io::Result<Self> {
        tempfile::tempfile().map(Self)
    }

    /// Puts a truth away.
    pub fn put(&mut self, truth: Truth) -> std::io::Result<()> {
        serde_json::to_writer(&mut self.0, &truth)?;
        writeln!(self.0)
    }

    /// Breaks the seal.
    pub fn open(mut self) -> std::io::Result<Vec<Truth>> {
        self.0.rewind()?;
        BufReader::new(self.0).lines().map(|l| Ok(serde_json::from_str(&l?)?)).collect()
    }
}
