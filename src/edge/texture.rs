//! How a surface's texture errs together in two dimensions, and pictures made free of it.
//!
//! Brushed metal is bright and dark along lines: its power lies on one line of the frequency plane and a round mark's all over it. Where
//! the power is known, pictures are divided by its root (whitened): what is left of the texture is independent from
//! pixel to pixel, and least squares weighs each frequency by what it knows.
//!
//! A surface of the size of a mark does not tell its power frequency by frequency (weights learnt so follow its accidents). It tells a few
//! numbers: the covariance is taken for one or two of `a exp(-|u| / along - |v| / across)` over the distances u along the lines and v
//! across (long lines lie among short ones), and noise beside.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

/// Distances in pixels up to which the covariance is compared.
const REACH: usize = 14;
/// Directions tried, lengths along the lines (each twice the one before, from 1) and across (the same from 0.7).
const DIRECTIONS: usize = 16;
const ALONG: usize = 7;
const ACROSS: usize = 5;
/// Least noise as a part of the whole variance.
const LEAST: f64 = 0.02;
/// Most variance of the lines as a part of the whole: what was taken out as the level may have been theirs.
const MOST: f64 = 3.0;
/// Least part of two kinds of lines in which they differ.
const ALIKE: f64 = 1e-3;

/// The root of a texture's power, and how to divide square pictures by it.
pub(super) struct Texture {
    /// Pixels of a side, with room so that opposite borders do not meet.
    side: usize,
    /// What each frequency is multiplied by.
    filter: Vec<f64>,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl Texture {
    /// Learns from a square picture's residuals, 0 where nothing is known of them (`known` 0, else 1). `None` where too little
    /// is known.
    pub(super) fn learn(residuals: &DMatrix<f64>, known: &DMatrix<f64>) -> Option<Self> {
        let side = (residuals.nrows() + REACH).next_multiple_of(16);
        let mut planner = FftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(side), planner.plan_fft_inverse(side));
        let mut texture = Self { side, filter: Vec::new(), forward, inverse };
        // Sums of products, and their number, at every distance.
        let squares = |picture: &DMatrix<f64>| {
            let mut at = texture.spectrum(picture, None);
            at.iter_mut().for_each(|v| *v = Complex::new(v.norm_sqr(), 0.0));
            texture.back(at)
        };
        let (products, counts) = (squares(residuals), squares(known));
        let variance = products[0].re / counts[0].re;
        if !(variance.is_finite() && variance > 0.0) {
            return None;
        }
        let reach = REACH as isize;
        let far = |i: isize, j: isize| i * i + j * j > reach * reach || (j == 0 && i <= 0);
        let pairs = (0..=reach).flat_map(|j| (-reach..=reach).map(move |i| (i, j)));
        let lags: Vec<Lag> = pairs
            .filter(|&(i, j)| !far(i, j))
            .map(|(i, j)| {
                let at = j as usize * side + i.rem_euclid(side as isize) as usize;
                let count = counts[at].re / (side * side) as f64;
                Lag { x: i as f64, y: j as f64, count, value: products[at].re / counts[at].re }
            })
            .filter(|lag| lag.count > 50.0)
            .collect();
        let lines = Lines::of(&lags, variance)?;
        let step = TAU / side as f64;
        let frequency =
            |i: usize| step * if 2 * i < side { i as f64 } else { i as f64 - side as f64 };
        let scale = 1.0 / (side * side) as f64;
        let each = (0..side).flat_map(|x| (0..side).map(move |y| (x, y)));
        texture.filter =
            each.map(|(x, y)| scale / lines.power(frequency(x), frequency(y)).sqrt()).collect();
        Some(texture)
    }

    /// Both pictures whitened, pixel by pixel with some beyond their borders.
    pub(super) fn whiten(&self, a: &DMatrix<f64>, b: &DMatrix<f64>) -> (Vec<f64>, Vec<f64>) {
        // The filter is real and symmetric: real and imaginary part pass it side by side.
        let mut at = self.spectrum(a, Some(b));
        at.iter_mut().zip(&self.filter).for_each(|(v, f)| *v *= f);
        self.back(at).into_iter().map(|v| (v.re, v.im)).unzip()
    }

    /// The spectrum of `a + i b`, transposed.
    fn spectrum(&self, a: &DMatrix<f64>, b: Option<&DMatrix<f64>>) -> Vec<Complex<f64>> {
        let n = self.side;
        let mut at = vec![Complex::new(0.0, 0.0); n * n];
        for (j, column) in a.column_iter().enumerate() {
            for (i, v) in column.iter().enumerate() {
                at[j * n + i].re = *v;
            }
        }
        for (j, column) in b.iter().flat_map(|b| b.column_iter().enumerate()) {
            for (i, v) in column.iter().enumerate() {
                at[j * n + i].im = *v;
            }
        }
        self.forward.process(&mut at);
        let mut at = transposed(&at, n);
        self.forward.process(&mut at);
        at
    }

    /// The picture of a transposed spectrum, times the number of pixels.
    fn back(&self, mut at: Vec<Complex<f64>>) -> Vec<Complex<f64>> {
        self.inverse.process(&mut at);
        let mut at = transposed(&at, self.side);
        self.inverse.process(&mut at);
        at
    }
}

fn transposed(at: &[Complex<f64>], side: usize) -> Vec<Complex<f64>> {
    (0..side).flat_map(|i| (0..side).map(move |j| at[j * side + i])).collect()
}

/// The covariance at one distance, and how many pairs of pixels tell it.
struct Lag {
    x: f64,
    y: f64,
    count: f64,
    value: f64,
}

/// One kind of lines: how long and how wide they are, and their variance.
#[derive(Debug, Clone, Copy)]
struct Kind {
    along: f64,
    across: f64,
    size: f64,
}

/// The covariance's numbers: up to two kinds of lines of one direction.
#[derive(Debug, Clone)]
struct Lines {
    direction_rad: f64,
    kinds: Vec<Kind>,
    noise: f64,
}

impl Lines {
    /// Those that fit best, a constant aside: what was taken out as the level is missing everywhere.
    fn of(lags: &[Lag], variance: f64) -> Option<Self> {
        let root = DVector::from_iterator(lags.len(), lags.iter().map(|l| l.count.sqrt()));
        let mean = root.normalize();
        let free = |v: DVector<f64>| &v - &mean * mean.dot(&v);
        let weighted = |f: &dyn Fn(&Lag) -> f64| {
            free(DVector::from_iterator(lags.len(), lags.iter().map(f)).component_mul(&root))
        };
        let seen = weighted(&|l| l.value);
        let lengths: Vec<(f64, f64)> = (0..ACROSS)
            .map(|i| 0.7 * 2f64.powi(i as i32))
            .flat_map(|across| (0..ALONG).map(move |i| (2f64.powi(i as i32), across)))
            .filter(|(along, across)| along >= across)
            .collect();
        let mut best: Option<(f64, Self)> = None;
        for direction in 0..DIRECTIONS {
            let direction_rad = PI * direction as f64 / DIRECTIONS as f64;
            let (s, c) = direction_rad.sin_cos();
            let shape = |&(along, across): &(f64, f64)| {
                weighted(&|l| {
                    let (u, v) = (c * l.x + s * l.y, c * l.y - s * l.x);
                    (-u.abs() / along - v.abs() / across).exp()
                })
            };
            let shapes: Vec<DVector<f64>> = lengths.iter().map(shape).collect();
            let squares: Vec<f64> = shapes.iter().map(DVector::norm_squared).collect();
            let products: Vec<f64> = shapes.iter().map(|e| e.dot(&seen)).collect();
            let mut offer = |explained: f64, found: &[(usize, f64)]| {
                if best.as_ref().is_none_or(|(most, _)| explained > *most) {
                    let total: f64 = found.iter().map(|(_, size)| size).sum();
                    let part = (MOST * variance / total).min(1.0);
                    let kind = |&(i, size): &(usize, f64)| {
                        let (along, across) = lengths[i];
                        Kind { along, across, size: part * size }
                    };
                    let kinds = found.iter().map(kind).collect();
                    let noise = (variance - part * total).max(LEAST * variance);
                    best = Some((explained, Self { direction_rad, kinds, noise }));
                }
            };
            for (i, e) in shapes.iter().enumerate() {
                let own = squares[i];
                if products[i] > 0.0 {
                    offer(products[i] * products[i] / own, &[(i, products[i] / own)]);
                }
                for (j, f) in shapes.iter().enumerate().skip(i + 1) {
                    let (other, both) = (squares[j], e.dot(f));
                    let left = own * other - both * both;
                    let a = (other * products[i] - both * products[j]) / left;
                    let b = (own * products[j] - both * products[i]) / left;
                    // Two that are nearly alike say nothing of either.
                    if left > ALIKE * own * other && a > 0.0 && b > 0.0 {
                        offer(a * products[i] + b * products[j], &[(i, a), (j, b)]);
                    }
                }
            }
        }
        best.map(|b| b.1)
    }

    /// Power at a frequency in radians a pixel.
    fn power(&self, x: f64, y: f64) -> f64 {
        let (s, c) = self.direction_rad.sin_cos();
        let one = |length: f64, frequency: f64| 2.0 * length / (1.0 + (length * frequency).powi(2));
        let of = |k: &Kind| k.size * one(k.along, c * x + s * y) * one(k.across, c * y - s * x);
        self.kinds.iter().map(of).sum::<f64>() + self.noise
    }
}
