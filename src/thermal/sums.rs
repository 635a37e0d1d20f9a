//! Least squares from sums of products: any subset of sensors, any set of blocks, at no new pass over the data.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Sums of products of sensors, the constant and the displacement: all that least squares needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sums {
    /// Rows behind the sums, after what consecutive rows repeat of each other is taken off.
    pub effective_rows: f64,
    /// All products of two, row by row, over (sensors.., 1, displacement).
    products: Vec<f64>,
    size: usize,
}

impl Sums {
    /// No rows yet.
    pub fn empty(sensors: usize) -> Self {
        let size = sensors + 2;
        Self { effective_rows: 0.0, products: vec![0.0; size * size], size }
    }

    /// Adds one row.
    pub fn add_row(&mut self, rises_c: &[f64], displacement_mm: f64) {
        let row: Vec<f64> = rises_c.iter().copied().chain([1.0, displacement_mm]).collect();
        for i in 0..self.size {
            for j in 0..self.size {
                self.products[i * self.size + j] += row[i] * row[j];
            }
        }
        self.effective_rows += 1.0;
    }

    /// Adds another's rows.
    pub fn add(&mut self, other: &Self) {
        self.products.iter_mut().zip(&other.products).for_each(|(a, b)| *a += b);
        self.effective_rows += other.effective_rows;
    }

    /// Sum of products of two columns.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        self.products[i * self.size + j]
    }

    /// The column of ones.
    pub fn constant_column(&self) -> usize {
        self.size - 2
    }

    /// The displacement's column.
    pub fn displacement_column(&self) -> usize {
        self.size - 1
    }

    /// Whether the numbers are usable (a model file may have been edited).
    pub fn valid(&self, sensors: usize) -> bool {
        self.size == sensors + 2
            && self.products.len() == self.size * self.size
            && self.products.iter().all(|p| p.is_finite())
            && self.effective_rows.is_finite()
            && self.effective_rows > 0.0
    }

    /// Sum of squares left by `coefficients` on `columns`.
    pub fn left(&self, columns: &[usize], coefficients: &DVector<f64>) -> f64 {
        let y = self.displacement_column();
        let mut sum = self.at(y, y);
        for (a, &i) in columns.iter().enumerate() {
            sum -= 2.0 * coefficients[a] * self.at(i, y);
            for (b, &j) in columns.iter().enumerate() {
                sum += coefficients[a] * coefficients[b] * self.at(i, j);
            }
        }
        sum.max(0.0)
    }

    /// Least squares on some columns; `None` where they do not determine the coefficients.
    pub fn solve(&self, columns: &[usize]) -> Option<Solved> {
        let y = self.displacement_column();
        let scale: Vec<f64> = columns.iter().map(|&i| self.at(i, i).sqrt()).collect();
        if scale.iter().any(|&s| s <= 0.0) {
            return None;
        }
        let n = columns.len();
        let normal =
            DMatrix::from_fn(n, n, |a, b| self.at(columns[a], columns[b]) / (scale[a] * scale[b]));
        let right = DVector::from_fn(n, |a, _| self.at(columns[a], y) / scale[a]);
        let eigen = normal.clone().symmetric_eigen();
        if eigen.eigenvalues.min() < 1e-11 * eigen.eigenvalues.max() {
            return None;
        }
        let inverse = normal.cholesky()?.inverse();
        let coefficients = DVector::from_fn(n, |a, _| (inverse.row(a) * &right)[0] / scale[a]);
        let inverse = DMatrix::from_fn(n, n, |a, b| inverse[(a, b)] / (scale[a] * scale[b]));
        let left = self.left(columns, &coefficients);
        Some(Solved { coefficients, inverse, left })
    }
}

/// A least-squares solution from sums.
pub struct Solved {
    /// In the order of the columns.
    pub coefficients: DVector<f64>,
    /// Inverse of the normal matrix.
    pub inverse: DMatrix<f64>,
    /// Sum of squares left.
    pub left: f64,
}

/// The sums of the blocks to keep.
pub fn sum_of(blocks: &[Sums], keep: impl Fn(usize) -> bool) -> Sums {
    let mut total = Sums {
        products: vec![0.0; blocks[0].products.len()],
        effective_rows: 0.0,
        size: blocks[0].size,
    };
    blocks.iter().enumerate().filter(|(k, _)| keep(*k)).for_each(|(_, b)| total.add(b));
    total
}

/// The sensors' columns, and the constant's if there is one.
pub fn with_constant(mut columns: Vec<usize>, sensors: usize, constant: bool) -> Vec<usize> {
    if constant {
        columns.push(sensors);
    }
    columns
}

/// Adds the sensor that helps most on left-out blocks, one by one; then takes the smallest set whose error is
/// within one standard error of the best (Breiman's rule), so that sensors that only fit noise stay out.
pub fn select(blocks: &[Sums], live: &[usize], most: usize, constant: bool) -> Vec<usize> {
    let sensors = blocks[0].size - 2;
    let error = |set: &[usize]| -> Option<Vec<f64>> {
        let columns = with_constant(set.to_vec(), sensors, constant);
        (0..blocks.len())
            .map(|k| {
                let solved = sum_of(blocks, |j| j != k).solve(&columns)?;
                let rows = blocks[k].at(sensors, sensors).max(1.0);
                Some(blocks[k].left(&columns, &solved.coefficients) / rows)
            })
            .collect()
    };
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let mut set: Vec<usize> = Vec::new();
    let mut path: Vec<(Vec<usize>, Vec<f64>)> = Vec::new();
    while set.len() < most.min(live.len()) {
        let best = live
            .iter()
            .filter(|i| !set.contains(i))
            .filter_map(|&i| {
                let trial: Vec<usize> = set.iter().copied().chain([i]).collect();
                error(&trial).map(|e| (i, e))
            })
            .min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)));
        let Some((i, errors)) = best else { break };
        set.push(i);
        path.push((set.clone(), errors));
    }
    let Some(best) = path.iter().min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1))) else {
        return live.iter().copied().take(1).collect();
    };
    let m = mean(&best.1);
    let n = best.1.len() as f64;
    let spread =
        (best.1.iter().map(|e| (e - m).powi(2)).sum::<f64>() / (n - 1.0).max(1.0) / n).sqrt();
    let mut chosen = path
        .iter()
        // The source's model has at least two sensors.
        .find(|(set, errors)| mean(errors) <= m + spread && set.len() >= 2.min(live.len()))
        .map_or_else(|| best.0.clone(), |(set, _)| set.clone());
    chosen.sort_unstable();
    chosen
}
