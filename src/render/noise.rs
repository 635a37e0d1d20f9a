//! Correlated randomness: brushed surfaces and ragged contours.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{PI, TAU};

/// Smooth noise of zero mean and unit variance over the plane, stretched along one direction.
#[derive(Debug, Clone)]
pub struct Grain {
    seed: u64,
    cos: f64,
    sin: f64,
    along_per_mm: f64,
    across_per_mm: f64,
}

impl Grain {
    /// Grain with these sizes along and across `direction_rad`.
    pub fn new(seed: u64, along_mm: f64, across_mm: f64, direction_rad: f64) -> Self {
        let (sin, cos) = direction_rad.sin_cos();
        Self { seed, cos, sin, along_per_mm: 1.0 / along_mm, across_per_mm: 1.0 / across_mm }
    }

    /// The grain's value at a point: values at the knots of a lattice, smoothly joined.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.knots(
            (self.cos * x + self.sin * y) * self.along_per_mm,
            (self.cos * y - self.sin * x) * self.across_per_mm,
        )
    }

    /// As [`Grain::at`] with the lattice coordinates given: `s_mm` along, `t_mm` across.
    pub fn along_across(&self, s_mm: f64, t_mm: f64) -> f64 {
        self.knots(s_mm * self.along_per_mm, t_mm * self.across_per_mm)
    }

    fn knots(&self, a: f64, b: f64) -> f64 {
        let (ia, ib) = (floor(a), floor(b));
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (fa, fb) = (smooth(a - ia as f64), smooth(b - ib as f64));
        let knot = |i: i64, j: i64| hash_unit(self.seed, i, j);
        let low = knot(ia, ib) * (1.0 - fa) + knot(ia + 1, ib) * fa;
        let high = knot(ia, ib + 1) * (1.0 - fa) + knot(ia + 1, ib + 1) * fa;
        // Joining the knots keeps 0.7429 of the variance in each direction.
        (low * (1.0 - fb) + high * fb) / 0.742_857
    }
}

/// The next whole number below, without the call that `f64::floor` is on plain x86-64.
fn floor(x: f64) -> i64 {
    let whole = x as i64;
    whole - i64::from(x < whole as f64)
}

/// A number of zero mean and unit variance from a lattice place (splitmix64's finaliser).
fn hash_unit(seed: u64, i: i64, j: i64) -> f64 {
    let mut z = seed
        ^ (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (j as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f).rotate_left(31);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    let uniform = (z >> 11) as f64 / (1u64 << 53) as f64;
    (uniform - 0.5) * 12f64.sqrt()
}

/// A periodic function of the polar angle, held as a table.
#[derive(Debug, Clone)]
pub struct Around {
    table: Vec<f32>,
    largest: f64,
}

/// Values in the table of an [`Around`].
const ANGLES: usize = 4096;

impl Around {
    /// The same value at every angle.
    pub fn constant(value: f64) -> Self {
        Self { table: vec![value as f32; ANGLES + 1], largest: value.abs() }
    }

    /// A Gaussian process along a circle of this radius: standard deviation `rms`, autocorrelation
    /// `exp(-π d²/ℓ²)` over the arc length d, so that 2πR/ℓ places are independent. Every harmonic takes
    /// part, the first too: it moves the contour's centre against the nominal one.
    pub fn ragged(rng: &mut ChaCha8Rng, rms: f64, length_mm: f64, radius_mm: f64) -> Self {
        if rms == 0.0 {
            return Self::constant(0.0);
        }
        let girth = TAU * radius_mm;
        // Its spectrum exp(-π f² ℓ²) is spent where f ℓ = 2.
        let harmonics = ((2.0 * girth / length_mm).ceil() as usize).clamp(1, ANGLES / 4);
        let power = |k: usize| (-PI * (k as f64 / girth * length_mm).powi(2)).exp();
        let total: f64 = power(0) + 2.0 * (1..=harmonics).map(power).sum::<f64>();
        let mut sums = vec![0.0f64; ANGLES];
        for k in 0..=harmonics {
            let scale = rms * (power(k) * if k == 0 { 1.0 } else { 2.0 } / total).sqrt();
            let a: f64 = StandardNormal.sample(rng);
            let b: f64 = StandardNormal.sample(rng);
            let (mut c, mut s) = (a * scale, b * scale);
            let (ds, dc) = (k as f64 * TAU / ANGLES as f64).sin_cos();
            for sum in &mut sums {
                *sum += c;
                (c, s) = (c * dc + s * ds, s * dc - c * ds);
            }
        }
        Self::from_values(sums)
    }

    /// Multiplies by a function of the angle.
    pub fn times(self, factor: impl Fn(f64) -> f64) -> Self {
        let angle = |i: usize| i as f64 * TAU / ANGLES as f64;
        let values = self.table[..ANGLES].iter().enumerate();
        Self::from_values(values.map(|(i, &v)| f64::from(v) * factor(angle(i))).collect())
    }

    fn from_values(values: Vec<f64>) -> Self {
        let mut table: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
        table.push(table[0]);
        let largest = table.iter().fold(0.0f32, |m, v| m.max(v.abs())).into();
        Self { table, largest }
    }

    /// The largest absolute value.
    pub fn largest(&self) -> f64 {
        self.largest
    }

    /// The value at an angle in (-π, π].
    pub fn at(&self, angle_rad: f64) -> f64 {
        let turn = angle_rad * (1.0 / TAU);
        let place = (turn - floor(turn) as f64) * ANGLES as f64;
        let i = (place as usize).min(ANGLES - 1);
        let f = (place - i as f64) as f32;
        f64::from(self.table[i] * (1.0 - f) + self.table[i + 1] * f)
    }
}

/// A new seed for a [`Grain`].
pub fn grain_seed(rng: &mut ChaCha8Rng) -> u64 {
    rng.random()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::draw::stream_rng;

    #[test]
    fn a_ragged_contour_moves_its_centre_as_theory_says() {
        // rms 20 µm, length 0.2 mm on a 3 mm circle: s √(2ℓ/(2πR)) = 2.9 µm for each coordinate.
        let mut rng = stream_rng(5, 0);
        let (mut shift, mut form) = (0.0, 0.0);
        let runs = 400;
        for _ in 0..runs {
            let ragged = Around::ragged(&mut rng, 0.020, 0.2, 3.0);
            let n = 720;
            let mut x = 0.0;
            for i in 0..n {
                let a = i as f64 * TAU / n as f64;
                x += 2.0 * ragged.at(a) * a.cos() / n as f64;
                form += ragged.at(a).powi(2) / (n * runs) as f64;
            }
            shift += x * x / runs as f64;
        }
        assert!((form.sqrt() / 0.020 - 1.0).abs() < 0.02, "{}", form.sqrt());
        assert!((shift.sqrt() / 0.002913 - 1.0).abs() < 0.1, "{}", shift.sqrt());
    }

    #[test]
    fn grain_has_unit_variance_and_its_direction() {
        let grain = Grain::new(3, 1.0, 0.05, 0.3);
        let (mut mean, mut square, mut along, mut across) = (0.0, 0.0, 0.0, 0.0);
        let n = 40_000;
        for i in 0..n {
            let (x, y) = ((i % 200) as f64 * 0.73, (i / 200) as f64 * 0.61);
            let v = grain.at(x, y);
            mean += v / n as f64;
            square += v * v / n as f64;
            along += v * grain.at(x + 0.1 * 0.3f64.cos(), y + 0.1 * 0.3f64.sin()) / n as f64;
            across += v * grain.at(x - 0.1 * 0.3f64.sin(), y + 0.1 * 0.3f64.cos()) / n as f64;
        }
        assert!(mean.abs() < 0.02 && (square - 1.0).abs() < 0.05, "{mean} {square}");
        assert!(along > 0.9 && across.abs() < 0.1, "{along} {across}");
    }
}
