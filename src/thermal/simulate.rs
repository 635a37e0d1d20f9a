//! A laser machine that warms up, with known thermal errors: calibration runs and a working day as CSV text.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// The truth behind the data.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Displacement for each degree of rise of each head sensor.
    pub head_mm_per_c: Vec<f64>,
    /// Temperature of the cold machine; head sensors give rises if it is 0.
    pub cold_c: f64,
    /// For each axis: name, T0 in °C, slope in 1/°C, P0 in mm, travel in mm.
    pub screws: Vec<(String, f64, f64, f64, f64)>,
    /// Noise of displacement sensor and interferometer.
    pub noise_mm: f64,
    /// Noise of the thermometers.
    pub noise_c: f64,
}

impl Truth {
    /// A head of some sensors with the first four at work, and three axes.
    pub fn sample(sensors: usize) -> Self {
        let known = [0.0021, -0.0008, 0.0013, 0.0005];
        Self {
            head_mm_per_c: (0..sensors).map(|i| known.get(i).copied().unwrap_or(0.0)).collect(),
            cold_c: 0.0,
            screws: vec![
                ("x".into(), 20.0, 10.5e-6, 0.0, 1500.0),
                ("y".into(), 20.5, 11.5e-6, 200.0, 3000.0),
                ("z".into(), 20.0, 9.0e-6, 50.0, 400.0),
            ],
            noise_mm: 0.0008,
            noise_c: 0.02,
        }
    }

    /// True displacement of the head for true rises.
    pub fn head_mm(&self, rises_c: &[f64]) -> f64 {
        self.head_mm_per_c.iter().zip(rises_c).map(|(a, t)| a * t).sum()
    }

    /// True rises under two loads that change (laser power, motion); each sensor has its own share and lag.
    fn rises(&self, rows: usize, random: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
        let n = self.head_mm_per_c.len();
        let mut state = vec![0.0; n];
        let mut loads = [1.0, 1.0];
        (0..rows)
            .map(|row| {
                if row % (rows / 12).max(1) == 0 {
                    loads = [random.random_range(0.0..1.0), random.random_range(0.0..1.0)];
                }
                for (i, state) in state.iter_mut().enumerate() {
                    // Constants of the machine: the same on every day.
                    let share = (0.5 + 0.381_966 * i as f64).fract();
                    let lag_rows =
                        rows as f64 * (0.01 + 0.08 * (0.1 + 0.618_034 * i as f64).fract());
                    let gain_c = 8.0 + 14.0 * (0.3 + 0.754_878 * i as f64).fract();
                    let drive = gain_c * (share * loads[0] + (1.0 - share) * loads[1]);
                    *state += (drive - *state) * (1.0 - (-1.0 / lag_rows).exp());
                }
                state.clone()
            })
            .collect()
    }

    /// `HEAD.csv`.
    pub fn head_csv(&self, rows: usize, seed: u64) -> String {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let rises = self.rises(rows, &mut random);
        let mut out =
            (1..=self.head_mm_per_c.len()).map(|i| format!("head_{i}_c,")).collect::<String>();
        out.push_str("displacement_mm\n");
        for row in rises {
            for t in &row {
                out.push_str(&format!(
                    "{:.3},",
                    self.cold_c + t + normal(self.noise_c, &mut random)
                ));
            }
            out.push_str(&format!(
                "{:.6}\n",
                self.head_mm(&row) + normal(self.noise_mm, &mut random)
            ));
        }
        out
    }

    /// `SCREW.csv`: a run of each axis at each rise above its T0.
    pub fn screw_csv(&self, rises_c: &[f64], positions: usize, seed: u64) -> String {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut out = String::from("axis,screw_c,position_mm,error_mm\n");
        for (axis, t0, slope, p0, travel) in &self.screws {
            for rise in rises_c {
                for i in 0..positions {
                    let p = travel * i as f64 / (positions - 1).max(1) as f64;
                    let error = slope * rise * (p - p0) + normal(self.noise_mm, &mut random);
                    out.push_str(&format!("{axis},{:.3},{p:.3},{error:.6}\n", t0 + rise));
                }
            }
        }
        out
    }

    /// A working day: `axis,position_mm,screw_c,head_*_c,error_mm`, the error to be corrected.
    pub fn day_csv(&self, rows: usize, seed: u64) -> String {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let rises = self.rises(rows, &mut random);
        let mut out = String::from("axis,position_mm,screw_c,");
        out.push_str(
            &(1..=self.head_mm_per_c.len()).map(|i| format!("head_{i}_c,")).collect::<String>(),
        );
        out.push_str("error_mm\n");
        for (i, row) in rises.iter().enumerate() {
            let (axis, t0, slope, p0, travel) = &self.screws[i % self.screws.len()];
            let rise = 18.0 * (i as f64 / rows as f64).sqrt();
            let p = travel * random.random_range(0.0..1.0);
            let error =
                self.head_mm(row) + slope * rise * (p - p0) + normal(self.noise_mm, &mut random);
            out.push_str(&format!("{axis},{p:.3},{:.3},", t0 + rise));
            for t in row {
                out.push_str(&format!(
                    "{:.3},",
                    self.cold_c + t + normal(self.noise_c, &mut random)
                ));
            }
            out.push_str(&format!("{error:.6}\n"));
        }
        out
    }
}

fn normal(sd: f64, random: &mut ChaCha8Rng) -> f64 {
    Normal::new(0.0, sd).map_or(0.0, |n| n.sample(random))
}
