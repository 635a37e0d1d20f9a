//! Circles through points: Taubin's algebraic start, the geometric least-squares solution, a robust one.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::fit::robust::scatter;

/// A circle in whatever plane its points live in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// The centre.
    pub center: Vector2<f64>,
    /// The radius, in the points' unit.
    pub radius: f64,
}

impl Circle {
    /// Signed distance of a point from the circle, outside positive.
    pub fn distance(&self, point: Vector2<f64>) -> f64 {
        (point - self.center).norm() - self.radius
    }

    /// How far another circle is from being this one: between the centres, and the radii.
    pub fn apart(&self, other: &Self) -> f64 {
        (self.center - other.center).norm() + (self.radius - other.radius).abs()
    }
}

/// Taubin's algebraic fit (1991) in Chernov's Newton form ("Circular and Linear Regression", 2010, 5.9).
/// `None` where fewer than three points carry weight or they lie on a line.
pub fn taubin(points: &[Vector2<f64>], weights: &[f64]) -> Option<Circle> {
    let total: f64 = weights.iter().sum();
    if weights.iter().filter(|w| **w > 0.0).count() < 3 {
        return None;
    }
    let mean = points.iter().zip(weights).map(|(p, w)| p * *w).sum::<Vector2<f64>>() / total;
    let (mut xx, mut yy, mut xy, mut xz, mut yz, mut zz) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (p, w) in points.iter().zip(weights) {
        let q = p - mean;
        let z = q.norm_squared();
        xx += w * q.x * q.x;
        yy += w * q.y * q.y;
        xy += w * q.x * q.y;
        xz += w * q.x * z;
        yz += w * q.y * z;
        zz += w * z * z;
    }
    for m in [&mut xx, &mut yy, &mut xy, &mut xz, &mut yz, &mut zz] {
        *m /= total;
    }
    let z = xx + yy;
    let cov = xx * yy - xy * xy;
    let var_z = zz - z * z;
    let a3 = 4.0 * z;
    let a2 = -3.0 * z * z - zz;
    let a1 = var_z * z + 4.0 * cov * z - xz * xz - yz * yz;
    let a0 = xz * (xz * yy - yz * xy) + yz * (yz * xx - xz * xy) - var_z * cov;
    let (mut x, mut y) = (0.0f64, a0);
    for _ in 0..100 {
        let slope = a1 + x * (2.0 * a2 + 3.0 * a3 * x);
        let next = x - y / slope;
        if !next.is_finite() || next == x {
            break;
        }
        let value = a0 + next * (a1 + next * (a2 + next * a3));
        if value.abs() >= y.abs() {
            break;
        }
        (x, y) = (next, value);
    }
    let det = x * x - x * z + cov;
    let center = Vector2::new(xz * (yy - x) - yz * xy, yz * (xx - x) - xz * xy) / (2.0 * det);
    let radius = (center.norm_squared() + z).sqrt();
    let circle = Circle { center: center + mean, radius };
    (det.abs() > 0.0 && circle.radius.is_finite() && circle.center.iter().all(|v| v.is_finite()))
        .then_some(circle)
}

/// The weighted sum of squared distances of points from a circle, its gradient and Gauss' approximation to its curvature.
struct Squares {
    sum: f64,
    gradient: Vector3<f64>,
    normal: Matrix3<f64>,
}

impl Squares {
    fn of(points: &[Vector2<f64>], weights: &[f64], circle: &Circle) -> Self {
        let (mut sum, mut g) = (0.0, [0.0; 3]);
        let (mut xx, mut xy, mut yy, mut x, mut y, mut total) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for (p, &w) in points.iter().zip(weights) {
            let q = p - circle.center;
            let distance = q.norm();
            let off = distance - circle.radius;
            let pull = w * off;
            sum += pull * off;
            let (u, v) = if distance > 0.0 { (q.x / distance, q.y / distance) } else { (0.0, 0.0) };
            g = [g[0] - u * pull, g[1] - v * pull, g[2] - pull];
            (xx, xy, yy) = (xx + w * u * u, xy + w * u * v, yy + w * v * v);
            (x, y, total) = (x + w * u, y + w * v, total + w);
        }
        Self { sum, gradient: g.into(), normal: Matrix3::new(xx, xy, x, xy, yy, y, x, y, total) }
    }
}

/// Minimises the weighted sum of squared distances by Levenberg-Marquardt: at most so many steps down, until one is no longer than
/// `least_step`. `None` where the points do not determine a circle.
fn descend(
    points: &[Vector2<f64>],
    weights: &[f64],
    start: Circle,
    least_step: f64,
    most_steps: usize,
) -> Option<Circle> {
    let (mut circle, mut damping) = (start, 1e-9);
    let mut here = Squares::of(points, weights, &circle);
    for _ in 0..most_steps {
        let mut moved = None;
        while damping < 1e9 {
            let damped = here.normal + Matrix3::from_diagonal(&(here.normal.diagonal() * damping));
            let step = -(damped.try_inverse()? * here.gradient);
            let trial = Circle {
                center: circle.center + Vector2::new(step.x, step.y),
                radius: circle.radius + step.z,
            };
            let there = Squares::of(points, weights, &trial);
            if there.sum.is_finite() && there.sum <= here.sum {
                moved = Some((trial, there, step.norm()));
                damping = (damping * 0.1).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        let Some((trial, there, step)) = moved else { break };
        (circle, here) = (trial, there);
        if step <= least_step {
            break;
        }
    }
    (circle.radius.is_finite() && circle.radius > 0.0).then_some(circle)
}

/// A circle and which points it rests on.
#[derive(Debug, Clone)]
pub struct Robust {
    /// The circle.
    pub circle: Circle,
    /// Tukey weight of each point times its own, 0 for outliers.
    pub weights: Vec<f64>,
    /// Robust standard deviation of the distances.
    pub scale: f64,
}

/// Iteratively reweighted geometric fit (Tukey's biweight at 4.685 robust standard deviations), starting from
/// `start` or, without it, from Taubin's. `least_scale` keeps perfect data from rejecting points.
pub fn robust(
    points: &[Vector2<f64>],
    weights: &[f64],
    start: Option<Circle>,
    least_scale: f64,
) -> Option<Robust> {
    let start = match start {
        Some(circle) => circle,
        None => taubin(points, weights)?,
    };
    reweighted(points, weights, start, least_scale, 12)
}

/// The same from a circle that is near, in a few rounds at most.
pub(crate) fn reweighted(
    points: &[Vector2<f64>],
    weights: &[f64],
    start: Circle,
    least_scale: f64,
    rounds: usize,
) -> Option<Robust> {
    /// Steps to the circle between two looks at the weights: a short arc's may be long, and the weights will change.
    const STEPS: usize = 4;
    let mut circle = start;
    let mut result: Option<Robust> = None;
    for round in 0..rounds {
        let distances: Vec<f64> = points.iter().map(|p| circle.distance(*p)).collect();
        let scale = robust_scale(&distances, weights).max(least_scale);
        let new: Vec<f64> =
            distances.iter().zip(weights).map(|(d, w)| w * tukey(d / scale)).collect();
        if new.iter().filter(|w| **w > 0.0).count() < 3 {
            return result;
        }
        // Weights and circle settle together.
        let next = descend(points, &new, circle, 0.1 * scale, STEPS)?;
        let moved = (next.center - circle.center).norm() + (next.radius - circle.radius).abs();
        circle = next;
        result = Some(Robust { circle, weights: new, scale });
        if round > 1 && moved < (1e-3 * scale).max(0.02 * least_scale) {
            break;
        }
    }
    result
}

/// Tukey's biweight at 95 % efficiency: `d` in standard deviations.
pub fn tukey(d: f64) -> f64 {
    let t = 1.0 - (d / 4.685).powi(2);
    if t > 0.0 { t * t } else { 0.0 }
}

/// Normalised median absolute value of the distances whose weight is not zero.
fn robust_scale(distances: &[f64], weights: &[f64]) -> f64 {
    let mut sizes: Vec<f64> =
        distances.iter().zip(weights).filter(|(_, w)| **w > 0.0).map(|(d, _)| d.abs()).collect();
    if sizes.is_empty() {
        return 0.0;
    }
    scatter(&mut sizes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check_points() -> Vec<Vector2<f64>> {
        [(1., 7.), (2., 6.), (5., 8.), (7., 7.), (9., 5.), (3., 7.)]
            .map(|(x, y)| Vector2::new(x, y))
            .to_vec()
    }

    #[test]
    fn published_check_values() {
        let points = check_points();
        let t = taubin(&points, &[1.0; 6]).unwrap();
        assert!((t.center - Vector2::new(4.613933, 2.795209)).norm() < 1e-5, "{t:?}");
        assert!((t.radius - 4.879213).abs() < 1e-5);
        let g = descend(&points, &[1.0; 6], t, 1e-11, 60).unwrap();
        assert!((g.center - Vector2::new(4.73978241, 2.98353269)).norm() < 1e-7, "{g:?}");
        assert!((g.radius - 4.71422604).abs() < 1e-7);
        let sum: f64 = points.iter().map(|p| g.distance(*p).powi(2)).sum();
        assert!((sum - 1.2275990782).abs() < 1e-9);
    }

    #[test]
    fn outliers_do_not_move_the_robust_circle() {
        let mut points: Vec<_> = (0..60)
            .map(|i| f64::from(i) * 0.1)
            .map(|t| Vector2::new(3.0 + 5.0 * t.cos(), -2.0 + 5.0 * t.sin()))
            .collect();
        for p in points.iter_mut().step_by(4) {
            *p += Vector2::new(0.7, 0.2);
        }
        let r = robust(&points, &[1.0; 60], None, 1e-6).unwrap();
        assert!((r.circle.center - Vector2::new(3.0, -2.0)).norm() < 1e-6, "{r:?}");
    }

    #[test]
    fn points_on_a_line_make_no_circle() {
        let line: Vec<_> = (0..9).map(|i| Vector2::new(f64::from(i), 2.0 * f64::from(i))).collect();
        assert!(taubin(&line, &[1.0; 9]).is_none_or(|c| c.radius > 1e6));
    }
}
