//! Does C turn the way the machine file says? A rod off its axis tells.

use nalgebra::{DMatrix, DVector, Rotation2, Vector2};

use super::Rod;
use crate::diagnose::algebra::orthonormal;
use crate::diagnose::basis::distinct;

/// What the other sense has to leave of what this one leaves (root mean square) to be told.
const LEFT: f64 = 0.5;

/// A warning where a rod that turns with C explains the rim's places far better if C counts the other way.
pub(super) fn doubt(data: &Rod) -> Option<String> {
    // Two angles can be joined by a turn either way.
    if data.c_rad.is_empty() || distinct(&data.c_rad).len() < 3 {
        return None;
    }
    let [stated, other] = [1.0, -1.0].map(|sense| left_mm(data, sense));
    (other < LEFT * stated).then(|| {
        format!(
            "the rod's centre goes round against C: {:.1} µm are left of it, {:.1} µm if c_sense is the other one; give the machine with --model, \
             or correct its c_sense",
            1e3 * stated,
            1e3 * other
        )
    })
}

/// What a circle whose centre turns with C leaves of the edge points, root mean square, mm.
fn left_mm(data: &Rod, sense: f64) -> f64 {
    let n = data.points.len();
    let from: Vec<Vector2<f64>> = data.points.iter().map(|p| p - data.pole).collect();
    let columns = DMatrix::from_fn(n, 5, |i, k| {
        let normal = from[i].normalize();
        // A turned unit vector along the normal is that vector along the normal turned back.
        let back = Rotation2::new(-sense * data.c_rad[data.capture[i]]) * normal;
        [1.0, normal.x, normal.y, back.x, back.y][k]
    });
    let distances = DVector::from_iterator(n, from.iter().map(|p| p.norm()));
    let basis = orthonormal(&columns, 1e-9);
    let left = &distances - &basis * basis.tr_mul(&distances);
    (left.norm_squared() / n as f64).sqrt()
}
