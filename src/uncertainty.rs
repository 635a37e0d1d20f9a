//! Values with uncertainty: intervals, the ISO 14253-1 verdict, and distances near zero.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use crate::fit::tails::f_quantile;

/// Half-width of a 95 % interval of a normal distribution, in standard deviations.
pub const K95: f64 = 1.959_963_984_540_054;

/// Half-width of a 95 % interval of Student's t with `dof` degrees of freedom, of which there is one at least.
///
/// Cornish-Fisher expansion (Abramowitz & Stegun 26.7.5), error below 0.2 %; below three degrees from the tail itself.
pub fn k95(dof: f64) -> f64 {
    if !dof.is_finite() {
        return K95;
    }
    if dof < 3.0 {
        return f_quantile(0.05f64.ln(), 1.0, dof.max(1.0)).sqrt();
    }
    let z = K95;
    let g1 = (z.powi(3) + z) / 4.0;
    let g2 = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let g3 = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    let g4 = (79.0 * z.powi(9) + 776.0 * z.powi(7) + 1482.0 * z.powi(5)
        - 1920.0 * z.powi(3)
        - 945.0 * z)
        / 92160.0;
    z + g1 / dof + g2 / dof.powi(2) + g3 / dof.powi(3) + g4 / dof.powi(4)
}

/// Whether a standard deviation seen with `dof` degrees of freedom is larger than one that is told, beyond chance.
pub fn scatters_more(seen: f64, dof: f64, told: f64) -> bool {
    /// How seldom that happens by chance.
    const SELDOM: f64 = 0.01;
    seen > told * f_quantile(SELDOM.ln(), dof, f64::INFINITY).sqrt()
}

/// Last digits that lengths in mm may have been rounded to. Coarser ones are of round numbers, not of a probe or an indicator.
const COARSE_STEPS_MM: [f64; 5] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// Scales are divided in fives and twos, too: parts of a digit, and from how many readings on such a division is no chance.
const DIVISIONS: [(f64, usize); 3] = [(1.0, 0), (0.5, 3), (0.2, 7)];

/// The step between readings' values, in their unit: 0 where it is too small to matter.
pub fn last_digit(readings: &[f64]) -> f64 {
    let whole = |steps: f64| (steps - steps.round()).abs() < 1e-4;
    let is_step = |step: &f64| readings.iter().all(|v| whole(v / step));
    let divided = |digit: f64| {
        let parts = DIVISIONS.iter().filter(|(_, least)| readings.len() >= *least);
        parts.map(move |(part, _)| part * digit)
    };
    COARSE_STEPS_MM.into_iter().flat_map(divided).find(is_step).unwrap_or(0.0)
}

/// Standard uncertainty of lengths by their last digit alone, mm: readings that agree to it tell no more.
pub fn rounding_mm(readings: &[f64]) -> f64 {
    last_digit(readings) / 12.0f64.sqrt()
}

/// A value and its standard uncertainty, in the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measured {
    /// The best estimate.
    pub value: f64,
    /// The standard uncertainty.
    pub u: f64,
}

impl Measured {
    /// A value taken as known.
    pub fn exact(value: f64) -> Self {
        Self { value, u: 0.0 }
    }

    /// Half-width of the 95 % interval (normal distribution).
    pub fn u95(&self) -> f64 {
        K95 * self.u
    }
}

/// Whether a measured value keeps a limit, given its uncertainty (ISO 14253-1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The value keeps the limit whatever the true value within the interval.
    Pass,
    /// The value breaks the limit whatever the true value within the interval.
    Fail,
    /// The limit lies inside the interval: measure again, or better.
    Undecided,
}

impl Verdict {
    /// `pass` if value + u95 ≤ limit, `fail` if value - u95 > limit, else `undecided`.
    pub fn of(value: f64, u95: f64, limit: f64) -> Self {
        if value + u95 <= limit {
            Self::Pass
        } else if value - u95 > limit {
            Self::Fail
        } else {
            Self::Undecided
        }
    }

    /// The worst of several: one fail fails all, one undecided leaves all undecided; `None` of none.
    pub fn worst(verdicts: impl IntoIterator<Item = Self>) -> Option<Self> {
        let rank = |v: &Self| match v {
            Self::Pass => 0,
            Self::Undecided => 1,
            Self::Fail => 2,
        };
        verdicts.into_iter().max_by_key(rank)
    }

    /// The word used in every output.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::Undecided => "undecided",
        }
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.word())
    }
}

/// A source's part in the uncertainty of a value.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Contribution {
    /// The key of the value it adds to.
    pub of: String,
    /// Where it comes from.
    pub source: String,
    /// The standard uncertainty it alone would give the value.
    pub u_mm: f64,
    /// Share of the value's variance.
    pub share_percent: f64,
}

/// The budget of the value `of` from its independent sources, the largest first; sources that add nothing are left out.
pub fn budget<S: Into<String>>(
    of: &str,
    sources: impl IntoIterator<Item = (S, f64)>,
) -> Vec<Contribution> {
    let mut parts: Vec<Contribution> = sources
        .into_iter()
        .filter(|(_, u)| *u > 0.0)
        .map(|(source, u_mm)| Contribution {
            of: of.into(),
            source: source.into(),
            u_mm,
            share_percent: 0.0,
        })
        .collect();
    let variance: f64 = parts.iter().map(|p| p.u_mm * p.u_mm).sum();
    parts.iter_mut().for_each(|p| p.share_percent = 100.0 * p.u_mm * p.u_mm / variance);
    parts.sort_by(|a, b| b.u_mm.total_cmp(&a.u_mm));
    parts
}

/// `value ± u95` for people, with two figures of the uncertainty (3 to 6 decimals).
pub fn text(value: f64, u95: f64) -> String {
    let places = if u95 > 0.0 && u95.is_finite() {
        (1.0 - u95.log10().floor()).clamp(3.0, 6.0) as usize
    } else {
        4
    };
    format!("{value:.places$} ± {u95:.places$}")
}

/// Length of a measured offset and the half-width of its 95 % interval, from the offset's covariance.
///
/// Far from zero only the variance along the offset counts (factor `k95(dof)`). Near zero the length of an
/// offset is biased upwards and Rayleigh distributed (factor 2.448 for equal variances); in between the factor
/// goes over smoothly. Checked by Monte Carlo in the tests.
pub fn distance(offset: Vector2<f64>, covariance: Matrix2<f64>, dof: f64) -> (f64, f64) {
    let length = offset.norm();
    let total = (0.5 * covariance.trace()).max(0.0).sqrt();
    let widest = covariance.symmetric_eigenvalues().max().max(0.0).sqrt();
    if length == 0.0 || total == 0.0 {
        return (length, widest * 2.448 * k95(dof) / K95);
    }
    let n = offset / length;
    let along = n.dot(&(covariance * n)).max(0.0).sqrt();
    let near = 1.0 / (1.0 + (length / (3.0 * total)).powi(4));
    let u = (near * (widest * 2.448).powi(2) + (1.0 - near) * (along * K95).powi(2)).sqrt();
    (length, u * k95(dof) / K95)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_factors_match_tables() {
        for (dof, k) in
            [(1.0, 12.706), (1.5, 6.017), (2.0, 4.303), (3.0, 3.182), (5.0, 2.571), (10.0, 2.228)]
        {
            assert!((k95(dof) / k - 1.0).abs() < 5e-3, "dof {dof}: {}", k95(dof));
        }
        assert_eq!(k95(f64::INFINITY), K95);
    }

    #[test]
    fn the_step_of_a_scale_is_seen_in_its_readings() {
        let read = |step: f64| [3, 11, -7, 2, 0, 5, 19, 8].map(|k| step * f64::from(k));
        for step in [0.01, 0.005, 0.002, 0.001, 0.0005, 1e-5] {
            assert!((last_digit(&read(step)) / step - 1.0).abs() < 1e-9, "{step}");
        }
        // A few even ones are chance.
        assert_eq!(last_digit(&[0.002, 0.004, 0.012]), 0.001);
        assert_eq!(last_digit(&[0.001_234_567_8]), 0.0);
    }

    #[test]
    fn the_interval_of_a_distance_holds_near_zero_and_far_from_it() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for ratio in [1.0, 3.0] {
            let covariance = Matrix2::new(1.0, 0.0, 0.0, ratio * ratio);
            for truth in [0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 50.0] {
                let runs = 20_000;
                let inside = (0..runs)
                    .filter(|_| {
                        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
                        let seen = Vector2::new(truth + normal(), ratio * normal());
                        let (d, u) = distance(seen, covariance, f64::INFINITY);
                        (d - truth).abs() <= u
                    })
                    .count();
                let share = inside as f64 / f64::from(runs);
                assert!((0.925..0.998).contains(&share), "ratio {ratio} truth {truth}: {share}");
            }
        }
    }

    #[test]
    fn verdict_needs_the_whole_interval_on_one_side() {
        assert_eq!(Verdict::of(0.008, 0.002, 0.010), Verdict::Pass);
        assert_eq!(Verdict::of(0.009, 0.002, 0.010), Verdict::Undecided);
        assert_eq!(Verdict::of(0.013, 0.002, 0.010), Verdict::Fail);
    }
}
