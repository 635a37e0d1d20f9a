//! A head calibration's rows in blocks: which sensors to use, whether a constant is needed, and blocked cross-validation.
//!
//! Thermal runs are slow, so neighbouring rows are nearly copies. Cross-validation therefore leaves out whole
//! blocks of consecutive rows, and where sensors are selected, the selection is repeated inside every fold.

use nalgebra::DVector;

use super::head::Data;
use super::sums::{Sums, select, sum_of, with_constant};
use crate::fit::serial;

/// Blocks of consecutive rows left out in turn.
pub(super) const BLOCKS: usize = 5;

/// A calibration's rows in blocks that follow one another.
pub(super) struct Blocks<'a> {
    data: &'a Data,
    blocks: Vec<Sums>,
    live: Vec<usize>,
    /// How many sensors are chosen at most; `None`: all that live are used.
    most: Option<usize>,
}

impl<'a> Blocks<'a> {
    /// Takes the rows apart.
    pub(super) fn new(data: &'a Data, live: Vec<usize>, most: Option<usize>) -> Self {
        let mut blocks = vec![Sums::empty(data.sensors()); BLOCKS];
        let rows = data.displacement_mm.len();
        for (i, (rises, &y)) in data.rises_c.iter().zip(&data.displacement_mm).enumerate() {
            blocks[i * BLOCKS / rows].add_row(rises, y);
        }
        Self { data, blocks, live, most }
    }

    /// Sums of all rows.
    pub(super) fn total(&self) -> Sums {
        sum_of(&self.blocks, |_| true)
    }

    /// The sensors to use.
    pub(super) fn chosen(&self, constant: bool) -> Vec<usize> {
        self.choose(&self.blocks, constant)
    }

    /// The sensors to use, by what some of the blocks say.
    fn choose(&self, blocks: &[Sums], constant: bool) -> Vec<usize> {
        match self.most {
            Some(most) => select(blocks, &self.live, most, constant),
            None => self.live.clone(),
        }
    }

    /// Whether the readings are no rises above the cold state.
    pub(super) fn needs_constant(&self, warnings: &mut Vec<String>) -> bool {
        if self.data.looks_absolute {
            warnings.push(
                "the readings look like temperatures, not rises above the cold state: a constant is fitted; give --cold-c, or \
                 --constant no"
                    .to_owned(),
            );
            return true;
        }
        let total = self.total();
        let columns = with_constant(self.chosen(true), self.data.sensors(), true);
        let Some(s) = total.solve(&columns) else { return false };
        let last = columns.len() - 1;
        let (widen, _) = correlation(self.data, &columns, &s.coefficients);
        let s2 = s.left / (self.data.displacement_mm.len() - columns.len()).max(1) as f64;
        let u = (s2 * widen * s.inverse[(last, last)]).sqrt();
        // 4.5 standard errors: a chance finding in one of 100 000 calibrations.
        let needed = s.coefficients[last].abs() > (4.5 * u).max(1e-4)
            && s2 < total_left(&total, &self.chosen(false));
        if needed {
            warnings.push(format!(
                "a constant of {:.4} mm is significant and is fitted: the readings are no rises above the cold \
                 state; give --cold-c, or --constant no",
                s.coefficients[last]
            ));
        }
        needed
    }

    /// Sum of squares left on blocks that fit and selection have not seen.
    pub(super) fn held_out(&self, constant: bool) -> f64 {
        let left = |k: usize| {
            let others = (0..BLOCKS).filter(|&j| j != k);
            let seen: Vec<Sums> = others.map(|j| self.blocks[j].clone()).collect();
            let columns =
                with_constant(self.choose(&seen, constant), self.data.sensors(), constant);
            let coefficients = sum_of(&seen, |_| true)
                .solve(&columns)
                .map_or_else(|| DVector::zeros(columns.len()), |s| s.coefficients);
            self.blocks[k].left(&columns, &coefficients)
        };
        (0..BLOCKS).map(left).sum()
    }
}

/// Mean square left by a fit without a constant; infinite where there is none.
fn total_left(total: &Sums, columns: &[usize]) -> f64 {
    let rows = total.at(total.constant_column(), total.constant_column());
    total.solve(columns).map_or(f64::INFINITY, |s| s.left / (rows - columns.len() as f64).max(1.0))
}

/// How much consecutive residuals repeat each other: the factor on variances (1 + ρ)/(1 - ρ), and ρ.
pub(super) fn correlation(
    data: &Data,
    columns: &[usize],
    coefficients: &DVector<f64>,
) -> (f64, f64) {
    let residuals: Vec<f64> = data
        .rises_c
        .iter()
        .zip(&data.displacement_mm)
        .map(|(row, y)| {
            let model: f64 = columns
                .iter()
                .zip(coefficients.iter())
                .map(|(&i, c)| c * row.get(i).copied().unwrap_or(1.0))
                .sum();
            y - model
        })
        .collect();
    serial::widening(&residuals, columns.len())
}
