//! Readings of an indicator for a rotary axis whose angle errors are known.

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

/// An axis with known errors and a person reading an indicator.
#[derive(Debug, Clone)]
pub struct Truth<F: Fn(f64, i8) -> f64> {
    /// Angle error in degrees at an angle, coming from direction +1 or -1.
    pub error_deg: F,
    /// True distance from axis to tool point.
    pub pivot_mm: f64,
    /// Standard deviation of a reading.
    pub noise_mm: f64,
    /// Standard deviation of a whole run's shift.
    pub run_shift_mm: f64,
}

impl<F: Fn(f64, i8) -> f64> Truth<F> {
    /// A sweep as CSV text: `angle_deg,deviation_mm,dir,run`, the same for the same seed.
    pub fn sweep(&self, angles_deg: &[f64], dirs: &[i8], runs: usize, seed: u64) -> String {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |sd: f64| Normal::new(0.0, sd).map_or(0.0, |n| n.sample(&mut random));
        let mut out = String::from("angle_deg,deviation_mm,dir,run\n");
        for run in 1..=runs {
            let shift = draw(self.run_shift_mm);
            for &dir in dirs {
                for &angle in angles_deg {
                    let error = (self.error_deg)(angle, dir).to_radians();
                    let y = self.pivot_mm * error.tan() + shift + draw(self.noise_mm);
                    out.push_str(&format!(
                        "{angle},{y},{},{run}\n",
                        if dir < 0 { '-' } else { '+' }
                    ));
                }
            }
        }
        out
    }
}
