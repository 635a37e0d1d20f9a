//! How the light falls off over a picture, smoothly: taken out, so that no circle is seen in it, nor beside it taken for one.
//!
//! The logarithms of neighbouring blocks' levels differ as one polynomial does wherever no edge lies between them, on a plate as on a
//! mark that is darker all over. The polynomial with the least sum of absolute misses hardly heeds edges, as they are few.

use nalgebra::{SMatrix, SVector, Vector2};

use crate::fit::robust::range;
use crate::frame::Gray;

/// Blocks along the longer side.
const BLOCKS: usize = 36;
/// Powers of the polynomial in x and y, without the constant: a vignette's are of fourth order.
const POWERS: [(i32, i32); 14] = [
    (1, 0),
    (0, 1),
    (2, 0),
    (1, 1),
    (0, 2),
    (3, 0),
    (2, 1),
    (1, 2),
    (0, 3),
    (4, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 4),
];
type Coefficients = SVector<f64, 14>;
/// Rounds of weighting by the inverse of the misses.
const ROUNDS: usize = 8;
/// Levels under this part of the brightest are no light.
const DARK: f64 = 0.05;
/// Light that differs by less over the picture (logarithm) is even, and no more of it than so much is taken out.
const EVEN: f64 = 0.02;
const MOST: f64 = 1.2;
/// Neighbouring blocks that miss it by less than this part of its range (median) show it by themselves: a texture would move it.
const SMOOTH: f64 = 0.01;
/// By more than this part, and it is none.
const PLAIN: f64 = 0.04;

/// The light's logarithm over a picture, from its mean.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    coefficients: Coefficients,
    mean: f64,
    size: [usize; 2],
    /// Pixels of the full picture that make one of these.
    factor: f64,
    /// Whether the plate is so smooth that little else is seen: then an edge is measured in it, too.
    pub is_sure: bool,
}

impl Light {
    /// Divides it out of the picture it is of.
    pub(super) fn even_out(&self, image: &mut Gray<f32>) {
        for (y, row) in image.data.chunks_mut(image.width).enumerate() {
            let along = self.along(y as f64);
            for (x, value) in row.iter_mut().enumerate() {
                *value /= self.level(&along, x as f64) as f32;
            }
        }
    }

    /// The light at a full picture's pixel, as a part of its mean.
    pub fn at(&self, full: Vector2<f64>) -> f64 {
        let p = full.map(|v| (v - 0.5 * (self.factor - 1.0)) / self.factor);
        self.level(&self.along(p.y), p.x)
    }

    fn level(&self, along: &[f64; 5], x: f64) -> f64 {
        let u = scaled(x, self.size[0]);
        along.iter().rev().fold(0.0, |sum, c| sum * u + c).clamp(-MOST, MOST).exp()
    }

    /// None where it is even, or the picture too small to tell.
    pub(super) fn of(image: &Gray<f32>, factor: usize) -> Option<Self> {
        let size = [image.width, image.height];
        let side = size[0].max(size[1]).div_ceil(BLOCKS).max(1);
        let [columns, rows] = size.map(|s| s / side);
        if columns.min(rows) < 8 {
            return None;
        }
        let mut levels = vec![0.0f64; columns * rows];
        for (y, row) in image.data.chunks(size[0]).enumerate().take(rows * side) {
            for (cell, part) in
                levels[y / side * columns..].iter_mut().zip(row.chunks_exact(side)).take(columns)
            {
                *cell += f64::from(part.iter().sum::<f32>());
            }
        }
        let floor = DARK * levels.iter().copied().fold(0.0, f64::max);
        if floor <= 0.0 {
            return None;
        }
        let logs: Vec<f64> = levels.iter().map(|l| l.max(floor).ln()).collect();
        let middle = |i: usize| i as f64 * side as f64 + 0.5 * (side as f64 - 1.0);
        let powers: Vec<Coefficients> = (0..logs.len())
            .map(|i| powers([middle(i % columns), middle(i / columns)], size))
            .collect();
        let pairs = (0..logs.len()).flat_map(|i| {
            let right = (i % columns + 1 < columns).then_some((i, i + 1));
            let below = (i / columns + 1 < rows).then_some((i, i + columns));
            right.into_iter().chain(below)
        });
        let differences: Vec<(Coefficients, f64)> =
            pairs.map(|(a, b)| (powers[b] - powers[a], logs[b] - logs[a])).collect();
        let (coefficients, usual) = least_misses(&differences)?;
        let falls: Vec<f64> = powers.iter().map(|p| p.dot(&coefficients)).collect();
        let (low, high) = range(&falls);
        let mean = falls.iter().sum::<f64>() / falls.len() as f64;
        (high - low > EVEN && usual < PLAIN * (high - low)).then_some(Self {
            coefficients,
            mean,
            size,
            factor: factor as f64,
            is_sure: usual < SMOOTH * (high - low),
        })
    }

    /// A row's polynomial along it, from the constant on.
    fn along(&self, y: f64) -> [f64; 5] {
        let v = scaled(y, self.size[1]);
        let mut row = [-self.mean, 0.0, 0.0, 0.0, 0.0];
        for (c, (i, j)) in self.coefficients.iter().zip(POWERS) {
            row[i as usize] += c * v.powi(j);
        }
        row
    }
}

/// A place from -1 to 1 along one side.
fn scaled(place: f64, size: usize) -> f64 {
    2.0 * place / (size.max(2) - 1) as f64 - 1.0
}

fn powers(place: [f64; 2], size: [usize; 2]) -> Coefficients {
    let [u, v] = [0, 1].map(|i| scaled(place[i], size[i]));
    Coefficients::from_fn(|k, _| u.powi(POWERS[k].0) * v.powi(POWERS[k].1))
}

/// The coefficients with the least sum of absolute misses, by weights of their inverses, and the median miss.
fn least_misses(differences: &[(Coefficients, f64)]) -> Option<(Coefficients, f64)> {
    let (mut found, mut usual) = (Coefficients::zeros(), 0.0);
    for _ in 0..ROUNDS {
        let misses: Vec<f64> = differences.iter().map(|(p, d)| (d - p.dot(&found)).abs()).collect();
        let mut sorted = misses.clone();
        let at = sorted.len() / 2;
        usual = *sorted.select_nth_unstable_by(at, f64::total_cmp).1;
        let least = (0.3 * usual).max(1e-6);
        let mut normal = SMatrix::<f64, 14, 14>::identity() * 1e-9;
        let mut right = Coefficients::zeros();
        for ((p, d), miss) in differences.iter().zip(&misses) {
            let weight = 1.0 / miss.max(least);
            normal += p * p.transpose() * weight;
            right += p * (*d * weight);
        }
        found = normal.cholesky()?.solve(&right);
    }
    Some((found, usual))
}
