//! One radius and one centre per table angle through the edge points of all captures; then the C axis.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use crate::fit::Circle;
use crate::fit::correlated::{self, Fit, Rows};
use crate::fit::least_squares;
use crate::measure::ring::Points;

/// The edge points of one capture in machine coordinates.
#[derive(Debug, Clone)]
pub(super) struct Arc {
    pub points: Points,
    pub position_mm: Vector2<f64>,
    /// Index of the capture's table angle.
    pub angle: usize,
    /// Index of the capture.
    pub capture: usize,
}

impl Arc {
    /// A point in machine coordinates.
    pub fn machine(&self, i: usize) -> Vector2<f64> {
        self.points.place_mm[i] + self.position_mm
    }
}

/// The joint solution.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub centers: Vec<Vector2<f64>>,
    pub radius: f64,
    /// Weight of each point of each arc, 0 for rejected ones.
    pub weights: Vec<Vec<f64>>,
}

/// Robust joint fit by iterated reweighting: all arcs share the radius, arcs of one angle share the centre.
pub(super) fn robust(arcs: &[Arc], start: &Joint, rounds: usize) -> Option<Joint> {
    let mut centers = start.centers.clone();
    let angles = centers.len();
    let mut radius = start.radius;
    let mut weights: Vec<Vec<f64>> = arcs.iter().map(|a| own_weights(&a.points)).collect();
    let own = weights.clone();
    let mut first = true;
    for _ in 0..rounds {
        let mut normal = DMatrix::<f64>::zeros(2 * angles + 1, 2 * angles + 1);
        let mut right = DVector::<f64>::zeros(2 * angles + 1);
        let mut sizes = Vec::new();
        for (k, arc) in arcs.iter().enumerate() {
            for (i, own) in own[k].iter().enumerate() {
                if *own > 0.0 {
                    sizes.push((distance(arc, i, &centers, radius)).abs());
                }
            }
        }
        if sizes.len() < 10 {
            return None;
        }
        let middle = sizes.len() / 2;
        let scale = 1.4826 * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
        let scale = scale.max(1e-7);
        for (k, arc) in arcs.iter().enumerate() {
            for i in 0..arc.points.place_mm.len() {
                let d = distance(arc, i, &centers, radius);
                let cut = if first { 3.0 * scale } else { scale };
                let w = own[k][i] * crate::fit::circle::tukey(d / cut);
                weights[k][i] = w;
                if w > 0.0 {
                    let n = (arc.machine(i) - centers[arc.angle]).normalize();
                    let at = 2 * arc.angle;
                    let row = [(at, n.x), (at + 1, n.y), (2 * angles, 1.0)];
                    for (r, a) in row {
                        right[r] += w * a * d;
                        for (c, b) in row {
                            normal[(r, c)] += w * a * b;
                        }
                    }
                }
            }
        }
        first = false;
        let scale_of = normal.trace();
        for i in 0..normal.nrows() {
            normal[(i, i)] += 1e-12 * scale_of;
        }
        let step = normal.cholesky()?.solve(&right);
        for (a, c) in centers.iter_mut().enumerate() {
            *c += Vector2::new(step[2 * a], step[2 * a + 1]);
        }
        radius += step[2 * angles];
        if !(radius.is_finite() && radius > 0.0) {
            return None;
        }
        if step.norm() < 1e-9 {
            break;
        }
    }
    Some(Joint { centers, radius, weights })
}

fn distance(arc: &Arc, i: usize, centers: &[Vector2<f64>], radius: f64) -> f64 {
    (arc.machine(i) - centers[arc.angle]).norm() - radius
}

fn own_weights(points: &Points) -> Vec<f64> {
    crate::measure::ring::robust_weights(points)
}

/// Generalised least squares about the robust solution. Coefficients: centre x, y of every angle, then the radius.
pub(super) fn refine(arcs: &[Arc], angles: usize, joint: &Joint) -> Option<(Fit, Vec<usize>)> {
    let mut design = Vec::new();
    let (mut y, mut variance, mut place, mut group) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (k, arc) in arcs.iter().enumerate() {
        let about =
            Circle { center: joint.centers[arc.angle] - arc.position_mm, radius: joint.radius };
        let rows =
            crate::measure::ring::group_rows(&arc.points, &joint.weights[k], about, GROUPS_PER_ARC);
        for i in 0..rows.y.len() {
            let mut row = vec![0.0; 2 * angles + 1];
            row[2 * arc.angle] = rows.design[(i, 0)];
            row[2 * arc.angle + 1] = rows.design[(i, 1)];
            row[2 * angles] = 1.0;
            design.extend(row);
            y.push(rows.y[i]);
            variance.push(rows.variance[i]);
            place.push(rows.place[i]);
            group.push(k);
        }
    }
    let rows = Rows {
        design: DMatrix::from_row_slice(y.len(), 2 * angles + 1, &design),
        y: DVector::from_vec(y),
        variance,
        place,
        group: group.clone(),
    };
    let mut fit = correlated::fit(&rows, None)?;
    for rows in correlated::groups(&group) {
        let moved = fit.influence.columns(rows.start, rows.len()).column_sum();
        let place_mm = PLACE_PX * arcs[group[rows.start]].points.pixel_mm;
        fit.covariance += &moved * moved.transpose() * (place_mm * place_mm);
    }
    Some((fit, group))
}

/// An arc as a whole is out of place by this much (standard deviation): how pixels integrate light and where the
/// counts are rounded shows in no residual. Noiseless renderings of two makers scatter by 0.002 to 0.004 px.
const PLACE_PX: f64 = 0.0035;

/// Groups of edge points of one arc in the correlated fit.
const GROUPS_PER_ARC: usize = 30;

/// The C axis from the rod's centres.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub center: Vector2<f64>,
    pub covariance: Matrix2<f64>,
    pub eccentricity: Vector2<f64>,
    pub eccentricity_covariance: Matrix2<f64>,
    /// From the centres to the axis (2 × 2n).
    pub gain: DMatrix<f64>,
    /// Sum of squares of the normalised residuals, and their degrees of freedom.
    pub chi2: f64,
    pub dof: usize,
}

/// Fits `centre(C) = axis + Rz(sense·C)·e` to the centres with their covariance. Two angles at least.
pub(super) fn axis(
    centers: &[Vector2<f64>],
    covariance: &DMatrix<f64>,
    c_deg: &[f64],
    sense: f64,
) -> Option<Axis> {
    let n = 2 * centers.len();
    let l = covariance.clone().cholesky()?.unpack();
    let mut design = DMatrix::zeros(n, 4);
    let mut y = DVector::zeros(n);
    for (i, c) in centers.iter().enumerate() {
        let (s, k) = (sense * c_deg[i]).to_radians().sin_cos();
        design.view_mut((2 * i, 0), (2, 4)).copy_from_slice(&[1.0, 0.0, 0.0, 1.0, k, s, -s, k]);
        (y[2 * i], y[2 * i + 1]) = (c.x, c.y);
    }
    let mut x = design;
    if !l.solve_lower_triangular_mut(&mut x) || !l.solve_lower_triangular_mut(&mut y) {
        return None;
    }
    let (cov, rank) = least_squares::covariance(&x, 1e-9);
    if rank < 4 {
        return None;
    }
    let beta = &cov * x.tr_mul(&y);
    let chi2 = (&y - &x * &beta).norm_squared();
    let gain =
        (&cov * x.tr_mul(&l.solve_lower_triangular(&DMatrix::identity(n, n))?)).rows(0, 2).into();
    Some(Axis {
        center: Vector2::new(beta[0], beta[1]),
        covariance: cov.fixed_view::<2, 2>(0, 0).into(),
        eccentricity: Vector2::new(beta[2], beta[3]),
        eccentricity_covariance: cov.fixed_view::<2, 2>(2, 2).into(),
        gain,
        chi2,
        dof: n - 4,
    })
}
