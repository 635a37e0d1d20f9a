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
