//! Smooth functions of one variable, of which shapes over one and two variables are made, and its distinct values and ranges of them.

use crate::diagnose::experiment::Variable;
use crate::diagnose::shape::DEGREES;
use crate::fit::robust::range;

/// Highest harmonic of a surface round a turn.
const SURFACE_HARMONICS: u32 = 3;

/// A smooth function of one variable.
#[derive(Debug, Clone, Copy)]
pub(super) enum Basis {
    /// Legendre polynomial over the variable's range.
    Legendre(u32),
    /// Cosine of so many cycles a turn.
    Cos(u32),
    /// Sine of so many cycles a turn.
    Sin(u32),
}

impl Basis {
    pub(super) fn values(self, x: &[f64]) -> Vec<f64> {
        let (mid, half) = middle(x);
        let of = |x: &f64| match self {
            Self::Legendre(k) => legendre(k, (x - mid) / half),
            Self::Cos(k) => (f64::from(k) * x.to_radians()).cos(),
            Self::Sin(k) => (f64::from(k) * x.to_radians()).sin(),
        };
        x.iter().map(of).collect()
    }
}

/// Middle and half width of the range of some values.
pub(super) fn middle(values: &[f64]) -> (f64, f64) {
    let (low, high) = range(values);
    ((low + high) / 2.0, ((high - low) / 2.0).max(1e-12))
}

/// The constant and the lowest orders that the values of a variable can carry: harmonics round a whole turn,
/// polynomials otherwise.
pub(super) fn smooth(variable: &Variable) -> Vec<Basis> {
    let all = (0..=orders(variable)).flat_map(|k| of_order(variable, k));
    all.collect()
}

/// The highest order of a smooth function of a variable.
pub(super) fn orders(variable: &Variable) -> u32 {
    let most = distinct(&variable.values).len() as u32 - 1;
    if goes_round(variable.angle, &variable.values) {
        SURFACE_HARMONICS.min(most / 2)
    } else {
        DEGREES.min(most)
    }
}

/// The functions of one order: cosine and sine round a whole turn, one polynomial otherwise.
pub(super) fn of_order(variable: &Variable, k: u32) -> Vec<Basis> {
    match k {
        1.. if goes_round(variable.angle, &variable.values) => vec![Basis::Cos(k), Basis::Sin(k)],
        _ => vec![Basis::Legendre(k)],
    }
}

/// Whether values are those of an angle that goes round: what it shows closes on itself.
pub(super) fn goes_round(angle: bool, values: &[f64]) -> bool {
    let (low, high) = range(values);
    angle && high - low > 270.0
}

/// Legendre polynomial.
pub fn legendre(degree: u32, x: f64) -> f64 {
    let (mut a, mut b) = (1.0, x);
    if degree == 0 {
        return a;
    }
    for k in 1..degree {
        let k = f64::from(k);
        (a, b) = (b, ((2.0 * k + 1.0) * x * b - k * a) / (k + 1.0));
    }
    b
}

/// The distinct values of a variable, rising.
pub(super) fn distinct(values: &[f64]) -> Vec<f64> {
    let mut distinct = values.to_vec();
    distinct.sort_by(f64::total_cmp);
    let tolerance = 1e-6 * (distinct[distinct.len() - 1] - distinct[0]);
    distinct.dedup_by(|a, b| (*a - *b).abs() <= tolerance);
    distinct
}

/// Upper edges of ranges that hold about as many distinct values each.
pub(super) fn level_edges(values: &[f64], count: usize) -> Vec<f64> {
    let distinct = distinct(values);
    (1..count)
        .map(|k| {
            let i = (k * distinct.len() / count).clamp(1, distinct.len() - 1);
            0.5 * (distinct[i - 1] + distinct[i])
        })
        .collect()
}
