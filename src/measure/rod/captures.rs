//! The captures' table: one picture a row, with the machine's position.

use std::path::{Path, PathBuf};

use nalgebra::Vector2;

use crate::error::{Error, Result};
use crate::machine::apart_deg;
use crate::repeats;
use crate::table::Table;
use crate::units;

/// One capture.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// The picture as written in the table.
    pub image: String,
    /// Where the picture is: beside the table unless absolute.
    pub path: PathBuf,
    /// Machine X and Y at the capture.
    pub position_mm: Vector2<f64>,
    /// Table angle; 0 where the table does not say.
    pub c_deg: f64,
    /// Time, where known.
    pub t_s: Option<f64>,
    /// Temperature, where known.
    pub temp_c: Option<f64>,
    /// Sense of the last move of X and Y, where known.
    pub direction: Option<[f64; 2]>,
}

impl Capture {
    /// A capture whose picture is in memory already; `image` names it in messages.
    pub fn in_memory(image: impl Into<String>, position_mm: Vector2<f64>, c_deg: f64) -> Self {
        Self {
            image: image.into(),
            path: PathBuf::new(),
            position_mm,
            c_deg,
            t_s: None,
            temp_c: None,
            direction: None,
        }
    }
}

/// The columns of a table of captures: required, optional.
pub(super) const COLUMNS: (&[&str], &[&str]) =
    (&["image", "x_mm", "y_mm"], &["z_mm", "b_deg", "c_deg", "t_s", "temp_c", "dir_x", "dir_y"]);

/// Reads `CAPTURES.csv`: `image,x_mm,y_mm`, optionally `z_mm,b_deg,c_deg,t_s,temp_c,dir_x,dir_y`.
/// A picture that stands twice is left out once, with a warning.
pub fn read(path: impl AsRef<Path>, warnings: &mut Vec<String>) -> Result<Vec<Capture>> {
    from_table(&Table::read(path, COLUMNS.0, COLUMNS.1)?, warnings)
}

/// As [`read`], of a table that is read already.
pub(super) fn from_table(table: &Table, warnings: &mut Vec<String>) -> Result<Vec<Capture>> {
    let path = table.path();
    let optional = |row: usize, name: &str| -> Result<Option<f64>> {
        if table.has(name) { table.number(row, name).map(Some) } else { Ok(None) }
    };
    for name in ["z_mm", "b_deg"] {
        let column = table.optional_column(name)?.unwrap_or_default();
        let limit = if name == "z_mm" { 0.5 } else { 0.01 };
        if let Some(row) = column.iter().position(|v| (v - column[0]).abs() > limit) {
            return Err(table.error(
                row,
                name,
                format!("is {} where the first capture has {}", column[row], column[0]),
                "take all captures of the rim at one height with B at zero",
            ));
        }
    }
    if let Some(b) =
        table.optional_column("b_deg")?.map(|column| column[0]).filter(|b| b.abs() > 0.01)
    {
        warnings.push(format!(
            "{}: b_deg is {b} in all captures: a calibration holds for the head upright, with B at zero",
            path.display()
        ));
    }
    for name in ["dir_x", "dir_y"] {
        let column = table.optional_column(name)?.unwrap_or_default();
        table.check_directions(name, &column, warnings)?;
    }
    warnings.extend(units::angles("c_deg", &table.optional_column("c_deg")?.unwrap_or_default()));
    repeats::pictures_once(table, warnings)?
        .into_iter()
        .map(|(row, path)| {
            let position_mm = Vector2::new(table.number(row, "x_mm")?, table.number(row, "y_mm")?);
            let direction = match (optional(row, "dir_x")?, optional(row, "dir_y")?) {
                (Some(x), Some(y)) => Some([x, y]),
                (Some(x), None) => Some([x, 0.0]),
                (None, Some(y)) => Some([0.0, y]),
                (None, None) => None,
            };
            Ok(Capture {
                path,
                image: table.text(row, "image").to_owned(),
                position_mm,
                c_deg: optional(row, "c_deg")?.unwrap_or(0.0),
                t_s: optional(row, "t_s")?,
                temp_c: optional(row, "temp_c")?,
                direction,
            })
        })
        .collect::<Result<Vec<_>>>()
        .and_then(|captures| {
            let first = captures[0].position_mm;
            if captures.len() > 1 && captures.iter().all(|c| c.position_mm == first) {
                return Err(Error::file(
                    path,
                    "all captures have the same x_mm and y_mm",
                    "write the machine's X and Y at each capture",
                ));
            }
            Ok(captures)
        })
}

/// The different table angles, and which one each capture or point has.
pub(super) fn table_angles(c_deg: impl Iterator<Item = f64>) -> (Vec<f64>, Vec<usize>) {
    let mut angles: Vec<f64> = Vec::new();
    let index = c_deg
        .map(|c_deg| {
            let same = |a: &f64| apart_deg(*a, c_deg) < 1e-6;
            angles.iter().position(same).unwrap_or_else(|| {
                angles.push(c_deg);
                angles.len() - 1
            })
        })
        .collect();
    (angles, index)
}
