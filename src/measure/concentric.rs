//! Two edges of one mark share a centre: an annulus is burnt in one turn, so its inner edge tells where the outer
//! one is centred, and halves what texture and raggedness do to the answer.

use nalgebra::{Matrix2, RowVector2, SymmetricEigen, Vector2};

use crate::camera::View;
use crate::measure::ring::Ring;

/// Squared distance between the two centres, in standard deviations, beyond which they are not one (0.1 %).
const SAME: f64 = 13.8;

/// The outer edge with its centre improved by the inner one; unchanged where the two disagree.
pub(super) fn join(mut outer: Ring, inner: &Ring, view: &View) -> Ring {
    let (a, b) = (outer.center_covariance(), inner.center_covariance());
    let share = correlation(&outer.residuals, &inner.residuals);
    let (root_a, root_b) = (root(a), root(b));
    let cross: Matrix2<f64> = root_a * root_b * share;
    let apart: Vector2<f64> = inner.circle.center - outer.circle.center;
    let spread = a + b - cross - cross.transpose();
    let Some(inverse) = spread.try_inverse() else { return outer };
    if apart.dot(&(inverse * apart)) > SAME {
        return outer;
    }
    // The best linear mean of two correlated estimates.
    let gain = (a - cross) * inverse;
    let step = gain * apart;
    let covariance = a - gain * (a - cross).transpose();
    // The radius follows its centre.
    let toward_radius = outer.covariance.fixed_view::<1, 2>(2, 0).into_owned();
    let follows = a.try_inverse().map_or(RowVector2::zeros(), |inverse| toward_radius * inverse);
    outer.circle.center += step;
    outer.center_px = view.to_pixel(outer.circle.center);
    outer.circle.radius += (follows * step)[0];
    let radius_center = follows * covariance;
    outer.covariance[(2, 2)] -= (follows * (a - covariance) * follows.transpose())[0];
    outer.covariance.fixed_view_mut::<2, 2>(0, 0).copy_from(&covariance);
    outer.covariance.fixed_view_mut::<1, 2>(2, 0).copy_from(&radius_center);
    outer.covariance.fixed_view_mut::<2, 1>(0, 2).copy_from(&radius_center.transpose());
    outer.dof += inner.dof;
    outer.edge_points += inner.edge_points;
    outer.trace.extend(inner.trace.iter().copied());
    outer
}

/// How much the two edges wander together: correlation of their residuals at the same angles, never negative.
fn correlation(a: &[(f64, f64)], b: &[(f64, f64)]) -> f64 {
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for &(angle, x) in a {
        let away = |t: f64| crate::edge::wrap(t - angle).abs();
        let Some(&(near, y)) = b.iter().min_by(|p, q| away(p.0).total_cmp(&away(q.0))) else {
            return 0.0;
        };
        if away(near) < 0.1 {
            aa += x * x;
            bb += y * y;
            ab += x * y;
        }
    }
    if aa * bb > 0.0 { (ab / (aa * bb).sqrt()).clamp(0.0, 0.95) } else { 0.0 }
}

/// The symmetric square root of a covariance.
fn root(covariance: Matrix2<f64>) -> Matrix2<f64> {
    let eigen = SymmetricEigen::new(covariance);
    let sizes = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
    eigen.eigenvectors * Matrix2::from_diagonal(&sizes) * eigen.eigenvectors.transpose()
}
