//! Orthonormal bases of the diagnosis.

use nalgebra::{DMatrix, DVector};

/// An orthonormal basis of the columns; columns that lose all but `tolerance` of their length are dropped.
pub fn orthonormal(columns: &DMatrix<f64>, tolerance: f64) -> DMatrix<f64> {
    let mut basis: Vec<DVector<f64>> = Vec::with_capacity(columns.ncols());
    for c in 0..columns.ncols() {
        let mut v: DVector<f64> = columns.column(c).into_owned();
        let before = v.norm();
        if !(before.is_finite() && before > 0.0) {
            continue;
        }
        // Twice is enough (Kahan; Parlett).
        for _ in 0..2 {
            for b in &basis {
                let along = b.dot(&v);
                v.axpy(-along, b, 1.0);
            }
        }
        let after = v.norm();
        if after > tolerance * before {
            basis.push(v / after);
        }
    }
    if basis.is_empty() {
        return DMatrix::zeros(columns.nrows(), 0);
    }
    DMatrix::from_columns(&basis)
}

/// A root R of a positive semidefinite matrix RᵀR, with as many rows as its rank: a Cholesky factor with pivots, which ends where what is
/// left of the diagonal falls below `least`.
pub fn root(matrix: &DMatrix<f64>, least: f64) -> DMatrix<f64> {
    let n = matrix.nrows();
    let mut left = matrix.diagonal();
    let mut rows: Vec<DVector<f64>> = Vec::new();
    for _ in 0..n {
        let pivot = left.imax();
        if left[pivot] <= least {
            break;
        }
        let mut row = matrix.column(pivot).into_owned();
        for earlier in &rows {
            row.axpy(-earlier[pivot], earlier, 1.0);
        }
        row /= left[pivot].sqrt();
        left.iter_mut().zip(&row).for_each(|(left, r)| *left -= r * r);
        rows.push(row);
    }
    DMatrix::from_fn(rows.len(), n, |k, i| rows[k][i])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_has_as_many_rows_as_its_matrix_has_rank() {
        let columns = DMatrix::from_fn(4, 7, |r, c| ((3 * r + 5 * c) as f64).sin());
        let matrix = columns.tr_mul(&columns);
        let root = root(&matrix, 1e-12);
        // The sines of such a sum span two directions.
        assert_eq!(root.shape(), (2, 7));
        assert!((root.tr_mul(&root) - matrix).norm() < 1e-9);
    }
}
