//! The columns of `ballbar`, `thermal` and `burn` data by name.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::diagnose::data::cups::Cup;
use crate::diagnose::data::{need, show, thermal};
use crate::diagnose::experiment::Untestable;
use crate::error::Result;
use crate::fit::robust::range;
use crate::table::Table;

/// The columns of a file by name, with the head vector where the kind needs it.
#[derive(Debug, Clone, Default)]
pub struct Columns {
    /// Numbers by column name.
    pub numbers: BTreeMap<&'static str, Vec<f64>>,
    /// Number of the path or axis of each row.
    pub series: Vec<usize>,
    /// Names of the paths or axes.
    pub series_names: Vec<String>,
    /// Rises of the head's sensors above the cold state, sensor by sensor.
    pub head_c: Vec<Vec<f64>>,
    /// From the B axis to the tool point at B = 0.
    pub head: Vector3<f64>,
    /// Base cups of a ball bar's paths.
    pub cups: Vec<Cup>,
    /// Which way a ball bar's file counts Z: 1 upwards, -1 downwards.
    pub z_sense: f64,
    /// Coldest readings of the axes' screws.
    pub coldest: Vec<f64>,
    /// Where the slope of each axis' screw is zero.
    pub t0_c: Vec<f64>,
    /// What the data ask of the thermal baseline.
    pub thermal: thermal::Baseline,
}

impl Columns {
    /// From a table: the columns of these names that it has, and the rows' paths or axes from the column `series`.
    pub(super) fn read(table: &Table, names: &[&'static str], series: &str) -> Result<Self> {
        let mut data = Self::default();
        for name in names {
            if let Some(column) = table.optional_column(name)? {
                data.numbers.insert(name, column);
            }
        }
        for row in 0..table.rows() {
            let name = table.text(row, series);
            let known = data.series_names.iter().position(|n| n == name);
            data.series.push(known.unwrap_or_else(|| {
                data.series_names.push(name.to_owned());
                data.series_names.len() - 1
            }));
        }
        Ok(data)
    }

    /// A column, empty where it is missing.
    pub fn get(&self, name: &str) -> &[f64] {
        self.numbers.get(name).map_or(&[], Vec::as_slice)
    }

    fn present(&self) -> Vec<(&'static str, &[f64])> {
        self.numbers.iter().map(|(k, v)| (*k, v.as_slice())).collect()
    }

    /// Why an effect that needs these columns cannot be tested.
    pub fn needs(&self, names: &[&str]) -> Option<Untestable> {
        need(&self.present(), names)
    }

    /// Why an effect cannot be tested that shows wherever this column is not zero, though it may never change.
    pub fn shows(&self, name: &str) -> Option<Untestable> {
        show(&self.present(), name)
    }

    /// Rows of one path or axis.
    pub fn rows_of(&self, series: usize) -> Vec<usize> {
        (0..self.series.len()).filter(|row| self.series[*row] == series).collect()
    }

    /// Whether an axis stands still in these rows.
    pub fn stands_still(&self, name: &str, rows: &[usize]) -> bool {
        /// Readings of an axis that stands still differ by no more.
        const STANDS_MM: f64 = 0.01;
        let column = self.get(name);
        let own: Vec<f64> = rows.iter().filter_map(|row| column.get(*row)).copied().collect();
        let (low, high) = range(&own);
        own.is_empty() || high - low <= STANDS_MM
    }

    /// First and last time.
    pub fn times_s(&self) -> (f64, f64) {
        let t = self.get("t_s");
        if t.is_empty() { (0.0, 0.0) } else { range(t) }
    }
}
