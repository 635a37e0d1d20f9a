//! RTCP sweeps: a target held while the rotary axes turn; what a machine would show, and what it
//! did show.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::error::Result;
use crate::machine::{AxisName, Chain};
use crate::repeats;
use crate::rtcp::deviation;
use crate::table::Table;

/// Columns a sweep may have beside its rotary axes, the directions they came from and the deviation.
const CONDITIONS: [&str; 5] = ["t_s", "temp_c", "x_mm", "y_mm", "z_mm"];
/// The deviation's columns.
pub const DEVIATION: [&str; 3] = ["dx_mm", "dy_mm", "dz_mm"];

/// A sweep as read from its file.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// The file, for the columns beyond these.
    pub table: Table,
    /// The rotary axes, in the order of the machine's joints.
    pub axes: [AxisName; 2],
    /// Their angles in each row, rad.
    pub rotary_rad: Vec<[f64; 2]>,
    /// Tool point reached - target, machine frame, where the file has it.
    pub deviation_mm: Option<Vec<Vector3<f64>>>,
}

impl Sweep {
    /// Reads the angles of the machine's rotary axes (`b_deg,c_deg`) and, where they are there, `dx_mm,dy_mm,dz_mm` and the conditions.
    pub fn read(path: impl AsRef<Path>, chain: &Chain) -> Result<Self> {
        let axes = chain.rotary_names();
        let (angles, conditions) = (axes.map(AxisName::column_deg), conditions(axes));
        let optional: Vec<&str> =
            DEVIATION.into_iter().chain(conditions.iter().map(String::as_str)).collect();
        Self::of(axes, Table::read(path, &angles.each_ref().map(String::as_str), &optional)?)
    }

    /// As [`Sweep::read`], but the deviation must be there, and copies of rows count once.
    pub fn read_measured(
        path: impl AsRef<Path>,
        chain: &Chain,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        let axes = chain.rotary_names();
        let (angles, conditions) = (axes.map(AxisName::column_deg), conditions(axes));
        let required: Vec<&str> = angles.iter().map(String::as_str).chain(DEVIATION).collect();
        let optional: Vec<&str> = conditions.iter().map(String::as_str).collect();
        let mut table = Table::read(path, &required, &optional)?;
        repeats::measured_once(&mut table, &DEVIATION, warnings);
        let sweep = Self::of(axes, table)?;
        for name in sweep.conditions() {
            let column = sweep.table.column(&name)?;
            if name.starts_with("dir_") {
                sweep.table.check_directions(&name, &column, warnings)?;
            }
        }
        Ok(sweep)
    }

    /// The names of the columns that say where and how the poses were, as far as the file has them.
    pub fn conditions(&self) -> Vec<String> {
        let angles = self.axes.map(AxisName::column_deg);
        let all = angles.into_iter().chain(conditions(self.axes));
        all.filter(|name| self.table.has(name)).collect()
    }

    fn of(axes: [AxisName; 2], table: Table) -> Result<Self> {
        let [b, c] = axes.map(|axis| table.column(&axis.column_deg()));
        let (b, c) = (b?, c?);
        let rotary_rad = b.iter().zip(&c).map(|(b, c)| [b.to_radians(), c.to_radians()]).collect();
        let deviation_mm = match DEVIATION.map(|name| table.optional_column(name)) {
            [Ok(Some(x)), Ok(Some(y)), Ok(Some(z))] => {
                Some((0..x.len()).map(|i| Vector3::new(x[i], y[i], z[i])).collect())
            }
            columns => {
                for column in columns {
                    column?;
                }
                None
            }
        };
        Ok(Self { table, axes, rotary_rad, deviation_mm })
    }
}

/// Columns beside the angles: `dir_b`, `dir_c`, and the rest.
fn conditions(axes: [AxisName; 2]) -> Vec<String> {
    let directions = axes.map(|axis| format!("dir_{}", axis.letter().to_ascii_lowercase()));
    directions.into_iter().chain(CONDITIONS.map(str::to_owned)).collect()
}

/// The deviations `real` shows when the control believes `control`, in parallel.
pub fn predict(
    control: &Chain,
    real: &Chain,
    target_mm: &Vector3<f64>,
    rotary_rad: &[[f64; 2]],
) -> Vec<Vector3<f64>> {
    rotary_rad
        .par_iter()
        .with_min_len(512)
        .map(|&r| deviation(control, real, target_mm, r))
        .collect()
}

/// Takes out what a wrong idea of the target's place explains, and returns it.
///
/// A target off by δ in the table frame adds `-R(C) δ` to each deviation, so δ is the mean of
/// `-R(C)ᵀ d`.
pub fn remove_target_offset(
    real: &Chain,
    rotary_rad: &[[f64; 2]],
    d: &mut [Vector3<f64>],
) -> Vector3<f64> {
    let turn = |r: &[f64; 2]| -> Matrix3<f64> {
        *real.work(&[0.0, 0.0, 0.0, r[0], r[1]]).rotation.matrix()
    };
    let count = rotary_rad.len().max(1) as f64;
    let sum: Vector3<f64> = rotary_rad.iter().zip(d.iter()).map(|(r, d)| -turn(r).tr_mul(d)).sum();
    let offset = sum / count;
    for (r, d) in rotary_rad.iter().zip(d) {
        *d += turn(r) * offset;
    }
    offset
}

/// How large deviations are.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, schemars::JsonSchema)]
pub struct Size {
    /// Root mean square of the deviation's length.
    pub rms_mm: f64,
    /// Root mean squares along X, Y, Z.
    pub rms_xyz_mm: [f64; 3],
    /// The largest length.
    pub worst_mm: f64,
}

impl Size {
    /// Of these deviations.
    pub fn of(d: &[Vector3<f64>]) -> Self {
        let count = d.len().max(1) as f64;
        let rms = |square: &dyn Fn(&Vector3<f64>) -> f64| {
            (d.iter().map(square).sum::<f64>() / count).sqrt()
        };
        Self {
            rms_mm: rms(&|d| d.norm_squared()),
            rms_xyz_mm: [0, 1, 2].map(|i| rms(&|d| d[i] * d[i])),
            worst_mm: d.iter().map(Vector3::norm).fold(0.0, f64::max),
        }
    }
}
