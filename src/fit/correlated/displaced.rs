//! Groups that are displaced as a whole: rows whitened once, then solved for every size of the displacement.
//!
//! With M = C + q N Nᵀ for each group (C whitened to 1, N its rows' displacements) the inverse costs two rows and
//! columns (Woodbury), so that all sizes q together cost little more than one.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2xX, Vector2};

use super::Rows;
use super::covariance::{Wandering, block, groups};

/// Variances tried of a displacement, in those of a row's white part.
pub(super) const VARIANCES: [f64; 8] = [0.1, 1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6];

/// Rows whitened at one grid point of the wander.
pub(super) struct Whitened {
    x: DMatrix<f64>,
    y: DVector<f64>,
    normal: DMatrix<f64>,
    right: DVector<f64>,
    log_det: f64,
    groups: Vec<Group>,
}

/// What a displacement of one group has to do with all else.
struct Group {
    own: Matrix2<f64>,
    with_design: Matrix2xX<f64>,
    with_y: Vector2<f64>,
}

/// The answer for one size of the displacement.
pub(super) struct Solved {
    pub beta: DVector<f64>,
    pub covariance: DMatrix<f64>,
    pub scale: f64,
    pub log_likelihood: f64,
}

impl Whitened {
    /// Whitens; `alike` says for each group how alike its rows wander. `None` where the covariance is no covariance.
    pub fn new(
        rows: &Rows,
        mean_variance: f64,
        wandering: Wandering,
        alike: &[DMatrix<f64>],
    ) -> Option<Self> {
        let mut x = rows.design.clone();
        let mut y = rows.y.clone();
        let mut log_det = 0.0;
        let mut list = Vec::new();
        for (i, range) in groups(&rows.group).into_iter().enumerate() {
            let (at, len) = (range.start, range.len());
            let c = block(rows, range.clone(), alike.get(i), mean_variance, wandering);
            let l = c.cholesky()?.unpack();
            log_det += 2.0 * l.diagonal().iter().map(|d| d.ln()).sum::<f64>();
            let solved = l.solve_lower_triangular_mut(&mut x.rows_mut(at, len))
                && l.solve_lower_triangular_mut(&mut y.rows_mut(at, len));
            if !solved {
                return None;
            }
            if let Some(directions) = rows.displacement.as_ref() {
                let moved = l.solve_lower_triangular(&normals(&directions[range]))?;
                list.push(Group {
                    own: (moved.tr_mul(&moved)).fixed_view::<2, 2>(0, 0).into(),
                    with_design: Matrix2xX::from_iterator(
                        x.ncols(),
                        moved.tr_mul(&x.rows(at, len)).iter().copied(),
                    ),
                    with_y: moved.tr_mul(&y.rows(at, len)).fixed_view::<2, 1>(0, 0).into(),
                });
            }
        }
        let (normal, right) = (x.tr_mul(&x), x.tr_mul(&y));
        Some(Self { x, y, normal, right, log_det, groups: list })
    }

    /// Generalised least squares with displacements of that variance, 0 for none.
    pub fn solve(&self, variance: f64) -> Option<Solved> {
        let (mut normal, mut right) = (self.normal.clone(), self.right.clone());
        let mut log_det = self.log_det;
        let groups = || self.groups.iter().filter(|_| variance > 0.0);
        let mut inner = Vec::new();
        for group in groups() {
            let i = (Matrix2::identity() / variance + group.own).try_inverse()?;
            log_det += (Matrix2::identity() + group.own * variance).determinant().ln();
            normal -= group.with_design.tr_mul(&(i * &group.with_design));
            right -= group.with_design.tr_mul(&(i * group.with_y));
            inner.push(i);
        }
        let cholesky = normal.cholesky()?;
        let beta = cholesky.solve(&right);
        let mut squares = (&self.y - &self.x * &beta).norm_squared();
        for (group, i) in groups().zip(&inner) {
            let along = group.with_y - &group.with_design * &beta;
            squares -= along.dot(&(i * along));
        }
        let dof = (self.y.len() - beta.len()) as f64;
        let scale = squares / dof;
        let normal_det = 2.0 * cholesky.l().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        let log_likelihood = -0.5 * (dof * scale.max(1e-300).ln() + log_det + normal_det);
        log_likelihood.is_finite().then(|| Solved {
            covariance: cholesky.inverse() * scale,
            beta,
            scale,
            log_likelihood,
        })
    }
}

/// Rows' displacements as a matrix (n × 2).
fn normals(directions: &[Vector2<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(directions.len(), 2, |i, k| directions[i][k])
}

/// Adds the displacements' part to the covariance of the rows.
pub(super) fn add(rows: &Rows, variance: f64, covariance: &mut [DMatrix<f64>]) {
    let Some(directions) = &rows.displacement else { return };
    for (range, block) in groups(&rows.group).into_iter().zip(covariance) {
        let n = normals(&directions[range]);
        *block += &n * n.transpose() * variance;
    }
}

/// What the most likely displacement of each group makes of its residuals; `covariance` is that of each group's rows in
/// place.
pub(super) fn most_likely(
    rows: &Rows,
    covariance: &[DMatrix<f64>],
    residuals: &DVector<f64>,
    variance: f64,
) -> DVector<f64> {
    let mut moved = DVector::zeros(residuals.len());
    let Some(directions) = rows.displacement.as_ref().filter(|_| variance > 0.0) else {
        return moved;
    };
    for (range, block) in groups(&rows.group).into_iter().zip(covariance) {
        let n = normals(&directions[range.clone()]);
        let (start, len) = (range.start, range.len());
        let Some(solved) = block.clone().cholesky().map(|c| c.solve(&n)) else { continue };
        let inner = DMatrix::identity(2, 2) / variance + n.tr_mul(&solved);
        if let Some(inner) = inner.try_inverse() {
            let place = inner * solved.tr_mul(&residuals.rows(start, len));
            moved.rows_mut(start, len).copy_from(&(n * place));
        }
    }
    moved
}
