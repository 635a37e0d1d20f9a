//! The normal equations of a bundle adjustment: the lens, the views' poses, and the board's points, which are eliminated first.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, SMatrix, Vector2, Vector3};

use crate::camera::LENS_NUMBERS as LENS;

/// Numbers of a pose.
pub(super) const POSE: usize = 6;

/// One point of one view: what it says of the lens, the pose and the board's point.
pub(super) struct Sight {
    pub point: usize,
    pub residual: Vector2<f64>,
    pub by_lens: SMatrix<f64, LENS, 2>,
    pub by_pose: SMatrix<f64, POSE, 2>,
    pub by_point: SMatrix<f64, 3, 2>,
}

/// The normal equations after the board's points have been eliminated.
pub(super) struct Normal {
    /// Of lens and poses.
    matrix: DMatrix<f64>,
    pull: DVector<f64>,
    /// The board's points that were eliminated.
    pub points: Vec<OfPoint>,
}

/// One of the board's points in the normal equations.
pub(super) struct OfPoint {
    /// The inverse of its own block.
    pub own: Matrix3<f64>,
    pull: Vector3<f64>,
    /// Its blocks with the lens and with the poses of the views that see it, and where those begin.
    pub blocks: Vec<(usize, DMatrix<f64>)>,
}

impl Normal {
    /// Of all views' sights, without one of the views if asked for. `weight` is theirs, `prior` the weights of the board's points about
    /// their places on the grid, from which they are `off_mm`.
    pub fn of(
        sights: &[Vec<Sight>],
        without: Option<usize>,
        weight: f64,
        prior: &Vector3<f64>,
        off_mm: &[Vector3<f64>],
    ) -> Self {
        let size = LENS + POSE * sights.len();
        let mut matrix = DMatrix::<f64>::zeros(size, size);
        let mut pull = DVector::<f64>::zeros(size);
        let mut own = vec![(Matrix3::from_diagonal(prior), Vector3::zeros()); off_mm.len()];
        for (own, off) in own.iter_mut().zip(off_mm) {
            own.1 = prior.component_mul(off);
        }
        let mut with_lens = vec![SMatrix::<f64, LENS, 3>::zeros(); off_mm.len()];
        let mut with_pose: Vec<Vec<(usize, DMatrix<f64>)>> = vec![Vec::new(); off_mm.len()];
        for (v, view) in sights.iter().enumerate().filter(|(v, _)| Some(*v) != without) {
            let at = LENS + POSE * v;
            for s in view {
                let (l, p, o) = (s.by_lens * weight, s.by_pose * weight, s.by_point * weight);
                let mut add = |r: usize, c: usize, block: DMatrix<f64>| {
                    let mut place = matrix.view_mut((r, c), block.shape());
                    place += block;
                };
                let dynamic = |m: &[f64], rows: usize, columns: usize| {
                    DMatrix::from_column_slice(rows, columns, m)
                };
                let lp = l * s.by_pose.transpose();
                add(0, 0, dynamic((l * s.by_lens.transpose()).as_slice(), LENS, LENS));
                add(0, at, dynamic(lp.as_slice(), LENS, POSE));
                add(at, 0, dynamic(lp.transpose().as_slice(), POSE, LENS));
                add(at, at, dynamic((p * s.by_pose.transpose()).as_slice(), POSE, POSE));
                let mut head = pull.rows_mut(0, LENS);
                head += l * s.residual;
                let mut tail = pull.rows_mut(at, POSE);
                tail += p * s.residual;
                let own = &mut own[s.point];
                own.0 += o * s.by_point.transpose();
                own.1 += o * s.residual;
                with_lens[s.point] += l * s.by_point.transpose();
                let block = p * s.by_point.transpose();
                with_pose[s.point].push((at, dynamic(block.as_slice(), POSE, 3)));
            }
        }
        let mut points = Vec::with_capacity(off_mm.len());
        for ((own, lens), mut blocks) in own.into_iter().zip(with_lens).zip(with_pose) {
            blocks.push((0, DMatrix::from_column_slice(LENS, 3, lens.as_slice())));
            // Its prior makes it sure.
            let inverse = own.0.try_inverse().unwrap_or_else(Matrix3::zeros);
            for (r, a) in &blocks {
                let share = a * inverse;
                let mut rows = pull.rows_mut(*r, a.nrows());
                rows -= &share * own.1;
                for (c, b) in &blocks {
                    let mut place = matrix.view_mut((*r, *c), (a.nrows(), b.nrows()));
                    place -= &share * b.transpose();
                }
            }
            points.push(OfPoint { own: inverse, pull: own.1, blocks });
        }
        // What is held, or not seen, stands still.
        for i in 0..size {
            if matrix[(i, i)] <= 0.0 {
                matrix[(i, i)] = 1.0;
                pull[i] = 0.0;
            }
        }
        Self { matrix, pull, points }
    }

    /// Scaled to a unit diagonal before it is taken apart.
    fn scaled(&self) -> Option<(Cholesky<f64, Dyn>, DVector<f64>)> {
        let scale = self.matrix.diagonal().map(|v| v.max(0.0).sqrt().max(1e-300));
        let unit = DMatrix::from_fn(self.matrix.nrows(), self.matrix.ncols(), |r, c| {
            self.matrix[(r, c)] / (scale[r] * scale[c])
        });
        Some((unit.cholesky()?, scale))
    }

    /// The step to the minimum: lens first, then the poses. `None` where they are not determined.
    pub fn solve(&self) -> Option<DVector<f64>> {
        let (cholesky, scale) = self.scaled()?;
        Some(-cholesky.solve(&self.pull.component_div(&scale)).component_div(&scale))
    }

    /// The inverse: lens' and poses' covariance.
    pub fn inverse(&self) -> Option<DMatrix<f64>> {
        let (cholesky, scale) = self.scaled()?;
        let mut inverse = cholesky.inverse();
        for (r, c) in (0..scale.len()).flat_map(|r| (0..scale.len()).map(move |c| (r, c))) {
            inverse[(r, c)] /= scale[r] * scale[c];
        }
        Some(inverse)
    }

    /// How the board's points move with lens and poses.
    pub fn points_step(&self, step: &DVector<f64>) -> Vec<Vector3<f64>> {
        let of = |OfPoint { own, pull, blocks }: &OfPoint| {
            let mut all = *pull;
            for (r, block) in blocks {
                all += block.tr_mul(&step.rows(*r, block.nrows()));
            }
            -(own * all)
        };
        self.points.iter().map(of).collect()
    }

    /// What lens and poses add to a point's covariance.
    pub fn beyond(
        &self,
        inverse: &DMatrix<f64>,
        OfPoint { own, blocks, .. }: &OfPoint,
    ) -> Matrix3<f64> {
        let mut sum = Matrix3::zeros();
        for (r, a) in blocks {
            for (c, b) in blocks {
                let part = inverse.view((*r, *c), (a.nrows(), b.nrows()));
                sum += a.tr_mul(&(part * b));
            }
        }
        own * sum * own
    }
}
