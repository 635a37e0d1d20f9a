//! What disturbs the profiles: pixel noise, sectors whose shape differs from the common one, and texture.
//!
//! Texture and shading err together over many bins. Taken for independent errors they would pull an edge that
//! is matched over a wide band; told apart by their correlation, only what is steeper than the texture counts.
//! Errors are modelled as √(v_a v_b) [(1 - φ) δ_ab + φ exp(-|a - b| / ℓ)] with v from the spread at each distance;
//! φ and ℓ have the highest restricted likelihood over all sectors. A filter (Kalman, one state) makes the
//! errors independent in one pass along a profile.

use crate::edge::Template;
use crate::edge::levels::median;
use crate::edge::sector::{Bin, Match, PARAMETERS};
use crate::edge::template::Step;

/// Shares of the correlated part tried.
const SHARES: [f64; 6] = [0.3, 0.5, 0.7, 0.85, 0.93, 0.98];
/// Values in a row: those of the model's columns and the residual.
const WIDTH: usize = PARAMETERS + 1;

/// The model of the errors.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    /// Variance of one pixel.
    pub(super) pixel2: f64,
    /// Variance of the sectors' own shape at each node of the common profile.
    pub(super) shape2: Vec<f64>,
    /// Share φ of the correlated part.
    share: f64,
    /// Its correlation length ℓ.
    length_px: f64,
}

impl Noise {
    /// Independent errors of one size.
    pub(super) fn white(pixel2: f64, nodes: usize) -> Self {
        Self { pixel2, shape2: vec![0.0; nodes], share: 0.0, length_px: 1.0 }
    }

    /// Variance of a bin's mean.
    pub(super) fn variance(&self, bin: &Bin, node: usize) -> f64 {
        self.pixel2 / bin.count + self.shape2[node]
    }

    /// A filter for one profile.
    pub(super) fn filter(&self) -> Filter {
        Filter::new(self.share, self.length_px)
    }

    /// Learns the variances from what the matches leave over.
    pub(super) fn learn_sizes(
        &mut self,
        template: &Template,
        edge: &Step,
        sectors: &[Vec<Bin>],
        matches: &[Match],
        alive: &[f64],
    ) {
        let n = self.shape2.len();
        let mut sizes: Vec<Vec<f64>> = vec![Vec::new(); n];
        let mut counts = vec![0.0; n];
        for (s, bins) in sectors.iter().enumerate().filter(|(s, _)| alive[*s] > 0.0) {
            for b in bins {
                let i = template.node(b.distance - matches[s].shift);
                sizes[i].push(matches[s].residual(b, template, edge).abs());
                counts[i] += b.count;
            }
        }
        // Residual variance per node, and the variance of one pixel that would explain it.
        let spread: Vec<f64> = sizes
            .iter()
            .map(|list| {
                let ones = vec![1.0; list.len()];
                (1.4826 * median(list, &ones)).powi(2)
            })
            .collect();
        let mut pixel: Vec<f64> = (0..n)
            .filter(|&i| sizes[i].len() >= 12)
            .map(|i| spread[i] * counts[i] / sizes[i].len() as f64)
            .collect();
        self.shape2.fill(0.0);
        self.pixel2 = 0.0;
        if pixel.is_empty() {
            return;
        }
        pixel.sort_by(f64::total_cmp);
        self.pixel2 = pixel[pixel.len() * 2 / 5];
        for i in 0..n {
            let mean_count = (counts[i] / sizes[i].len().max(1) as f64).max(1.0);
            let excess = spread[i] - 1.6 * self.pixel2 / mean_count;
            self.shape2[i] = if sizes[i].len() >= 12 { excess.max(0.0) } else { 0.0 };
        }
    }

    /// Learns the correlation from what the matches leave over.
    pub(super) fn learn_correlation(
        &mut self,
        template: &Template,
        edge: &Step,
        sectors: &[Vec<Bin>],
        matches: &[Match],
        alive: &[f64],
    ) {
        let used: Vec<usize> = (0..sectors.len()).filter(|&s| alive[s] > 0.0).collect();
        // A few dozen sectors know as much of the texture as all of them.
        let every = used.len().div_ceil(30).max(1);
        let rows: Vec<Vec<(f64, [f64; WIDTH])>> = used
            .iter()
            .step_by(every)
            .map(|&s| {
                let row = |b: &Bin| (b.distance, matches[s].row(b, template, edge, self));
                sectors[s].iter().map(row).collect()
            })
            .collect();
        let step = template.step_px;
        let span = step * template.values.len() as f64;
        let mut best = (likelihood(&rows, 0.0, 1.0), 0.0, 1.0);
        let mut length = 2.0 * step;
        while length < 2.0 * span {
            for share in SHARES {
                let value = likelihood(&rows, share, length);
                if value > best.0 {
                    best = (value, share, length);
                }
            }
            length *= 2.0;
        }
        (self.share, self.length_px) = (best.1, best.2);
    }
}

/// Restricted log likelihood of the residuals (scale known), each profile's own parameters projected out.
fn likelihood(rows: &[Vec<(f64, [f64; WIDTH])>], share: f64, length_px: f64) -> f64 {
    use nalgebra::{SMatrix, SVector};
    let mut sum = 0.0;
    for profile in rows {
        let mut filter = Filter::new(share, length_px);
        let mut normal = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
        let mut right = SVector::<f64, PARAMETERS>::zeros();
        let (mut squares, mut log_det) = (0.0, 0.0);
        for (at, row) in profile {
            let (row, variance) = filter.next(*at, *row);
            let x = SVector::<f64, PARAMETERS>::from_column_slice(&row[..PARAMETERS]);
            normal += x * x.transpose();
            right += x * row[PARAMETERS];
            squares += row[PARAMETERS] * row[PARAMETERS];
            log_det += variance.ln();
        }
        for i in 0..PARAMETERS {
            normal[(i, i)] *= 1.0 + 1e-9;
            normal[(i, i)] += 1e-12;
        }
        let Some(cholesky) = normal.cholesky() else { continue };
        let left = squares - right.dot(&cholesky.solve(&right));
        let det = 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        // One odd sector must not decide for all.
        let dof = (profile.len() as f64 - PARAMETERS as f64).max(1.0);
        let scale = (left / dof).max(1e-12);
        sum += -0.5 * (dof * scale.ln() + log_det + det);
    }
    sum
}

/// Makes correlated values of unit variance independent, one after the other.
pub(super) struct Filter {
    share: f64,
    length_px: f64,
    at: Option<f64>,
    mean: [f64; WIDTH],
    variance: f64,
}

impl Filter {
    fn new(share: f64, length_px: f64) -> Self {
        Self { share, length_px, at: None, mean: [0.0; WIDTH], variance: share }
    }

    /// The next value's part that the earlier ones do not foretell, scaled to unit variance; and the variance it had.
    pub(super) fn next(&mut self, at: f64, mut row: [f64; WIDTH]) -> ([f64; WIDTH], f64) {
        if self.share == 0.0 {
            return (row, 1.0);
        }
        if let Some(last) = self.at {
            let fade = (-(at - last).abs() / self.length_px).exp();
            self.mean.iter_mut().for_each(|m| *m *= fade);
            self.variance = fade * fade * self.variance + self.share * (1.0 - fade * fade);
        }
        self.at = Some(at);
        let total = self.variance + 1.0 - self.share;
        let (gain, size) = (self.variance / total, 1.0 / total.sqrt());
        for (value, mean) in row.iter_mut().zip(&mut self.mean) {
            let surprise = *value - *mean;
            *mean += gain * surprise;
            *value = surprise * size;
        }
        self.variance *= 1.0 - gain;
        (row, total)
    }
}
