//! Where a probe touched a blank.

use std::path::Path;

use nalgebra::Vector3;

use crate::error::{Error, Result};
use crate::repeats;
use crate::table::Table;
use crate::units;

/// Touches by kind.
#[derive(Debug, Clone, Default)]
pub struct Touches {
    /// Points of the end face, machine mm.
    pub(super) face: Vec<Vector3<f64>>,
    /// Points of the two sides across X, and across Y.
    pub(super) sides: [Vec<Vector3<f64>>; 2],
    /// What a user should know of the file.
    pub(super) warnings: Vec<String>,
}

impl Touches {
    /// Reads `kind,x_mm,y_mm,z_mm`.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_table(&Table::read(path, &["kind", "x_mm", "y_mm", "z_mm"], &[])?)
    }

    /// As [`Touches::read`], from a table.
    pub fn from_table(table: &Table) -> Result<Self> {
        let mut touches = Self::default();
        touches.warnings.extend(units::travel("x_mm", &table.column("x_mm")?));
        for row in repeats::rows_once(table, &mut touches.warnings) {
            let p = Vector3::new(
                table.number(row, "x_mm")?,
                table.number(row, "y_mm")?,
                table.number(row, "z_mm")?,
            );
            let list = match table.text(row, "kind") {
                "face" => &mut touches.face,
                "side_x" => &mut touches.sides[0],
                "side_y" => &mut touches.sides[1],
                other => {
                    let reason = format!("'{other}' is not known");
                    return Err(table.error(row, "kind", reason, "write face, side_x or side_y"));
                }
            };
            list.push(p);
        }
        if touches.face.len() < 3 {
            let reason = format!("has {} face points", touches.face.len());
            return Err(Error::file(
                table.path(),
                reason,
                "touch the end face at three points or more",
            ));
        }
        for (side, name) in touches.sides.iter().zip(["side_x", "side_y"]) {
            if side.len() == 1 {
                let fix = "touch both opposite sides";
                return Err(Error::file(table.path(), format!("has one {name} point"), fix));
            }
        }
        Ok(touches)
    }

    /// What the probe read along its own direction.
    pub(super) fn readings_mm(&self) -> Vec<f64> {
        let face = self.face.iter().map(|p| p.z);
        let sides = self.sides.iter().enumerate().flat_map(|(i, s)| s.iter().map(move |p| p[i]));
        face.chain(sides).collect()
    }
}
