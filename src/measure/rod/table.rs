//! The table that a rod is measured from: captures, or points of its rim that were aimed at by hand.

use std::path::{Path, PathBuf};

use super::aimed::{self, RimPoint};
use super::captures::{self, Capture};
use crate::error::Result;
use crate::input;
use crate::table::Table;

/// A table, read once; what it holds is checked when it is asked for.
#[derive(Debug, Clone)]
pub struct RodTable {
    path: PathBuf,
    bytes: Vec<u8>,
    has_points: bool,
}

impl RodTable {
    /// Reads a table and tells what it holds by its columns: points where there are `x_mm,y_mm` and at most `c_deg` beside them, else captures.
    ///
    /// # Errors
    /// A file that cannot be read, or is no table with `x_mm,y_mm`.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = input::bytes(path, input::MOST_TABLE)?;
        let (required, _) = aimed::COLUMNS;
        let any = Table::parse(path, bytes.as_slice(), required, &["*"])?;
        let of_point = |name: &String| name.starts_with("x_") || name == "y_mm" || name == "c_deg";
        let has_points = any.names().iter().all(of_point);
        Ok(Self { path: path.to_owned(), bytes, has_points })
    }

    /// Whether it holds points that were aimed at by hand.
    pub fn has_points(&self) -> bool {
        self.has_points
    }

    /// The points. Rows that stand twice count once, with a warning.
    ///
    /// # Errors
    /// Columns that points do not have, cells that are no numbers.
    pub fn points(&self, warnings: &mut Vec<String>) -> Result<Vec<RimPoint>> {
        aimed::from_table(self.parsed(aimed::COLUMNS)?, warnings)
    }

    /// The captures, as [`super::read_captures`] reads them.
    ///
    /// # Errors
    /// As that function.
    pub fn captures(&self, warnings: &mut Vec<String>) -> Result<Vec<Capture>> {
        captures::from_table(&self.parsed(captures::COLUMNS)?, warnings)
    }

    fn parsed(&self, (required, optional): (&[&str], &[&str])) -> Result<Table> {
        Table::parse(&self.path, self.bytes.as_slice(), required, optional)
    }
}
