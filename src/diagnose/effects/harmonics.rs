//! Errors that repeat with a turn: sums of harmonics of a rotary axis' angle.

use crate::diagnose::experiment::Parameter;

/// Harmonics of an angle's pitch error that come together: any one or two of the first four, or all. Were there none between one
/// and all of them, a zero that is off would make up for the second.
pub const PITCH_ORDERS: [&[u32]; 11] =
    [&[1], &[2], &[3], &[4], &[1, 2], &[1, 3], &[1, 4], &[2, 3], &[2, 4], &[3, 4], &[1, 2, 3, 4]];

/// Fourier parameters of the given harmonics.
pub fn harmonics(orders: &[u32], unit: &str, typical: f64) -> Vec<Parameter> {
    orders
        .iter()
        .flat_map(|k| {
            [
                Parameter::linear(format!("cos{k}_{unit}"), typical),
                Parameter::linear(format!("sin{k}_{unit}"), typical),
            ]
        })
        .collect()
}

/// Σ a cos kx + b sin kx.
pub fn fourier(orders: &[u32], p: &[f64], angle_rad: f64) -> f64 {
    orders
        .iter()
        .zip(p.chunks_exact(2))
        .map(|(k, ab)| {
            let (s, c) = (f64::from(*k) * angle_rad).sin_cos();
            ab[0] * c + ab[1] * s
        })
        .sum()
}
