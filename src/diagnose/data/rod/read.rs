//! A table of edge points read as the captures that they are of.

use std::collections::HashMap;

use nalgebra::Vector2;

use super::Rod;
use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::fit::circle::{Circle, taubin};
use crate::fit::robust::range;
use crate::machine::Machine;
use crate::table::Table;
use crate::units;

/// Which rows are of one capture.
pub(super) struct Captures<'a> {
    table: &'a Table,
    /// Capture of each row.
    of_row: Vec<usize>,
    first_rows: Vec<usize>,
}

impl<'a> Captures<'a> {
    /// Captures by the names in the table, in the order of their first rows.
    pub(super) fn of(table: &'a Table) -> Self {
        let mut index: HashMap<&str, usize> = HashMap::new();
        let mut first_rows = Vec::new();
        let of_row = (0..table.rows())
            .map(|r| {
                let next = index.len();
                *index.entry(table.text(r, "capture")).or_insert_with(|| {
                    first_rows.push(r);
                    next
                })
            })
            .collect();
        Self { table, of_row, first_rows }
    }

    /// A column that is the same within a capture; empty where it is missing.
    pub(super) fn column(&self, name: &str) -> Result<Vec<f64>> {
        let Some(all) = self.table.optional_column(name)? else { return Ok(Vec::new()) };
        let differs = |&r: &usize| (all[r] - all[self.first_rows[self.of_row[r]]]).abs() > 1e-9;
        if let Some(r) = (0..all.len()).find(differs) {
            let capture = self.table.text(r, "capture");
            return Err(self.table.error(
                r,
                name,
                format!("differs within capture '{capture}'"),
                "give every row of a capture the same value",
            ));
        }
        Ok(self.first_rows.iter().map(|&r| all[r]).collect())
    }

    /// The direction from which an axis came.
    fn direction(&self, name: &str, warnings: &mut Vec<String>) -> Result<Vec<f64>> {
        let column = self.column(name)?;
        if !column.is_empty() {
            self.table.check_directions(name, &self.table.column(name)?, warnings)?;
        }
        Ok(column)
    }
}

/// The captures, and the circle through all of their points.
pub(super) fn rod(
    captures: &Captures,
    c_deg: &[f64],
    calibration: &Calibration,
    machine: Option<&Machine>,
    warnings: &mut Vec<String>,
) -> Result<(Rod, Circle)> {
    let (x, y) = (captures.column("x_mm")?, captures.column("y_mm")?);
    warnings.extend(units::swept_angles("c_deg", c_deg));
    let dir_x = captures.direction("dir_x", warnings)?;
    let dir_y = captures.direction("dir_y", warnings)?;
    let table = captures.table;
    let (u, v) = (table.column("u_px")?, table.column("v_px")?);
    let view = view_of(table, calibration, &u, &v, warnings)?;
    let place: Vec<Vector2<f64>> = x.iter().zip(&y).map(|(x, y)| Vector2::new(*x, *y)).collect();
    let points: Vec<Vector2<f64>> = (0..table.rows())
        .map(|r| place[captures.of_row[r]] + view.to_plane(Vector2::new(u[r], v[r])))
        .collect();
    let rim = taubin(&points, &vec![1.0; points.len()]).ok_or_else(|| {
        Error::file(table.path(), "its points lie on no circle", "check x_mm, y_mm, u_px, v_px")
    })?;
    let c_sense = machine.map_or(1.0, |m| f64::from(m.c_sense));
    let eu = view.mm_per_px(view.axis_px()).column(0).normalize();
    let data = Rod {
        distance_mm: calibration.lens_size().map(|_| view.distance_mm()),
        axes: [eu, Vector2::new(-eu.y, eu.x)],
        c_sense,
        c_rad: c_deg.iter().map(|c| c_sense * c.to_radians()).collect(),
        t_s: captures.column("t_s")?,
        temp_c: captures.column("temp_c")?,
        place,
        dir_x,
        dir_y,
        capture: captures.of_row.clone(),
        rays: points.iter().map(|p| (p - rim.center).normalize()).collect(),
        points,
        pole: rim.center,
        view,
    };
    Ok((data, rim))
}

/// The camera's view; warns of points that it cannot have seen.
fn view_of(
    table: &Table,
    calibration: &Calibration,
    u: &[f64],
    v: &[f64],
    warnings: &mut Vec<String>,
) -> Result<View> {
    let Some((width, height)) = calibration.lens_size() else {
        // A plain scale turns about the frame's middle, which only shifts the rod's centre.
        let side = |values: &[f64]| {
            let (low, high) = range(values);
            (low + high).max(1.0) as usize + 1
        };
        return calibration.view(side(u), side(v));
    };
    let inside = |at: f64, size: usize| (-0.5..=size as f64 - 0.5).contains(&at);
    let is_outside = |r: &usize| !(inside(u[*r], width) && inside(v[*r], height));
    let outside: Vec<usize> = (0..table.rows()).filter(is_outside).collect();
    if let Some(first) = outside.first() {
        warnings.push(format!(
            "{}: {} points lie outside of the {width}×{height} px that the calibration covers, the first on line {}: is it this camera's?",
            table.path().display(),
            outside.len(),
            table.line(*first)
        ));
    }
    calibration.view(width, height)
}
