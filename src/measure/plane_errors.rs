//! What the plane's own uncertainty does to circles measured in it. It is the same for all of them: what moves them
//! together moves none against another.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::camera::View;
use crate::fit::Circle;
use crate::measure::ring::Ring;
use crate::uncertainty::{K95, k95};

/// How far each of the plane's independent errors moves a circle's centre x, y and radius, mm.
#[derive(Debug, Clone)]
pub(crate) struct PlaneErrors(Vec<Vector3<f64>>);

impl PlaneErrors {
    /// Of a ring.
    pub fn of(view: &View, ring: &Ring) -> Self {
        Self::at(view, ring.circle, ring.residuals.iter().map(|(angle, _)| *angle))
    }

    /// Of a circle whose edge was seen at these angles.
    pub fn at(view: &View, circle: Circle, angles: impl Iterator<Item = f64>) -> Self {
        let rows: Vec<Vector3<f64>> =
            angles.map(|angle| Vector3::new(angle.cos(), angle.sin(), 1.0)).collect();
        let normal: Matrix3<f64> = rows.iter().map(|row| row * row.transpose()).sum();
        // An edge seen at fewer than three angles has no centre to be moved.
        let inverse = normal.try_inverse().unwrap_or_else(Matrix3::zeros);
        let mut pulls: Vec<Vector3<f64>> = Vec::new();
        for row in &rows {
            let out = Vector2::new(row.x, row.y);
            let moved = view.plane_errors_mm(circle.center + out * circle.radius);
            for (i, moved) in moved.enumerate() {
                let pull = row * moved.dot(&out);
                match pulls.get_mut(i) {
                    Some(sum) => *sum += pull,
                    None => pulls.push(pull),
                }
            }
        }
        Self(pulls.into_iter().map(|pull| inverse * pull).collect())
    }

    /// What they do to one circle seen from another in the same plane.
    pub fn seen_from(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(own, other)| own - other).collect())
    }

    /// What they do to the mean of circles, which are all moved by the same ones.
    pub fn mean(circles: &[Self]) -> Self {
        let errors = circles.first().map_or(0, |first| first.0.len());
        let each = |i: usize| circles.iter().map(|c| c.0[i]).sum::<Vector3<f64>>();
        Self((0..errors).map(|i| each(i) / circles.len() as f64).collect())
    }

    /// The covariance to be added to one that is known with so many degrees of freedom, mm².
    pub fn covariance(&self, dof: f64) -> Matrix3<f64> {
        let sum: Matrix3<f64> = self.0.iter().map(|moved| moved * moved.transpose()).sum();
        sum * (K95 / k95(dof)).powi(2)
    }

    /// The same of the centre alone.
    pub fn center_covariance(&self, dof: f64) -> Matrix2<f64> {
        self.covariance(dof).fixed_view::<2, 2>(0, 0).into()
    }
}
