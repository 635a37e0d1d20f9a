//! Errors that repeat with a turn: sums of harmonics of a rotary axis' angle.

use nalgebra::Vector2;

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

/// A rotary axis' motion across itself: sums of some orders of its angle.
#[derive(Clone, Copy)]
pub struct Sideways {
    orders: &'static [u32],
    way: Way,
}

#[derive(Clone, Copy)]
enum Way {
    /// In both directions.
    Free,
    /// As a whole with the angle (1) or against it (-1).
    Round(f64),
    /// Along X (0) or Y (1) alone.
    Along(usize),
}

impl Sideways {
    /// All ways of moving at these orders.
    pub fn ways(orders: &'static [u32]) -> [Self; 5] {
        [Way::Free, Way::Round(1.0), Way::Round(-1.0), Way::Along(0), Way::Along(1)]
            .map(|way| Self { orders, way })
    }

    /// Cosine and sine of each order; the usual order, the second, goes without saying.
    pub fn parameters(self, typical_mm: f64) -> Vec<Parameter> {
        let names: &[&str] = match self.way {
            Way::Free => &["x", "y"],
            Way::Round(sense) if sense > 0.0 => &["turn"],
            Way::Round(_) => &["back"],
            Way::Along(0) => &["x"],
            Way::Along(_) => &["y"],
        };
        let mut parameters = Vec::new();
        for name in names {
            for k in self.orders {
                let order = if *k == 2 { String::new() } else { k.to_string() };
                for wave in ["cos", "sin"] {
                    let name = format!("{name}_{wave}{order}_mm");
                    parameters.push(Parameter::linear(name, typical_mm));
                }
            }
        }
        parameters
    }

    /// Where the axis is at this angle.
    pub fn at(self, p: &[f64], angle_rad: f64) -> Vector2<f64> {
        match self.way {
            Way::Free => {
                let (x, y) = p.split_at(2 * self.orders.len());
                Vector2::new(fourier(self.orders, x, angle_rad), fourier(self.orders, y, angle_rad))
            }
            Way::Round(sense) => {
                let one = |(k, ab): (&u32, &[f64])| {
                    let (s, c) = (sense * f64::from(*k) * angle_rad).sin_cos();
                    Vector2::new(ab[0] * c - ab[1] * s, ab[0] * s + ab[1] * c)
                };
                self.orders.iter().zip(p.chunks_exact(2)).map(one).sum()
            }
            Way::Along(axis) => {
                let mut place = Vector2::zeros();
                place[axis] = fourier(self.orders, p, angle_rad);
                place
            }
        }
    }
}
