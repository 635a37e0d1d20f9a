//! Small helpers of the generators: Gaussian noise, projection, shuffling.

use rand::{Rng, RngExt};

/// A standard normal number (Marsaglia's polar method).
pub fn gauss(rng: &mut impl Rng) -> f64 {
    loop {
        let (a, b) = (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        let s: f64 = a * a + b * b;
        if s > 0.0 && s < 1.0 {
            return a * (-2.0 * s.ln() / s).sqrt();
        }
    }
}

/// A random order of `0..n`.
pub fn shuffled(n: usize, rng: &mut impl Rng) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order
}

/// Length of `v` after the span of `columns` has been taken out.
pub fn length_beyond(mut v: Vec<f64>, columns: &[Vec<f64>]) -> f64 {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let take = |v: &mut Vec<f64>, basis: &[Vec<f64>]| {
        for _ in 0..2 {
            for b in basis {
                let along = dot(v, b);
                v.iter_mut().zip(b).for_each(|(x, y)| *x -= along * y);
            }
        }
    };
    for column in columns {
        let mut c = column.clone();
        take(&mut c, &basis);
        let norm = dot(&c, &c).sqrt();
        if norm > 1e-9 {
            c.iter_mut().for_each(|x| *x /= norm);
            basis.push(c);
        }
    }
    take(&mut v, &basis);
    dot(&v, &v).sqrt()
}
