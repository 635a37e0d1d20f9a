//! Spot minus ring: the distance, the verdict and what to turn. Of one burn test, or of several at one setting.
//!
//! Signs (`docs/conventions.md`): the beam leaves the nozzle along `Ry(B)·(0, 0, -1)`, so a B that stands too far by β moves
//! a mark burnt from height h by `-h tan β` in X; the spot, burnt from nearer, lies `+H tan β` from the ring (`H` the
//! difference of the heights). The correction turns B by `-β`. In Y a head turned by α about X moves the marks
//! by `+h tan α`: the offset is `-H tan α`, and the shims have to turn the head by `-α`.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::fit::tails::ln_chi2_tail;
use crate::measure::burn::{Options, ToleranceKind};
use crate::uncertainty::{K95, Verdict, distance, k95};

/// How to turn B and the head so that the next burn is concentric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Correction {
    /// Turn B by this much (add it to the B zero's actual position).
    pub b_deg: f64,
    /// Half-width of its 95 % interval.
    pub b_u95_deg: f64,
    /// Turn the head about X by this much with shims under its flange.
    pub shim_deg: f64,
    /// Half-width of its 95 % interval.
    pub shim_u95_deg: f64,
    /// Thickness of shims over the flange's length; null where that length is not given.
    pub shim_mm: Option<f64>,
    /// Half-width of its 95 % interval.
    pub shim_u95_mm: Option<f64>,
}

impl Correction {
    /// Whether either turn is larger than its uncertainty.
    pub fn is_significant(&self) -> bool {
        self.b_way().or(self.shim_way()).is_some()
    }

    /// Where the nozzle has to swing as B turns; `None` where the angle is within its uncertainty.
    pub fn b_way(&self) -> Option<&'static str> {
        let way = if self.b_deg > 0.0 { "-X" } else { "+X" };
        (self.b_deg.abs() > self.b_u95_deg).then_some(way)
    }

    /// Where the nozzle has to swing as shims turn the head; `None` where the angle is within its uncertainty.
    pub fn shim_way(&self) -> Option<&'static str> {
        let way = if self.shim_deg > 0.0 { "+Y" } else { "-Y" };
        (self.shim_deg.abs() > self.shim_u95_deg).then_some(way)
    }
}

/// How far the spot lies from the ring, and what that asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Offset {
    /// Spot minus ring.
    pub offset_mm: [f64; 2],
    /// Half-widths of its 95 % intervals.
    pub offset_u95_mm: [f64; 2],
    /// Its covariance.
    pub offset_cov_mm2: [[f64; 2]; 2],
    /// The part of it that is the calibration's: the same in all pictures of the camera, so that no mean lessens it.
    #[serde(default)]
    pub offset_calibration_cov_mm2: [[f64; 2]; 2],
    /// Distance between the centres.
    pub distance_mm: f64,
    /// Half-width of its 95 % interval.
    pub distance_u95_mm: f64,
    /// ISO 1101 concentricity zone: twice the distance.
    pub zone_mm: f64,
    /// Half-width of its 95 % interval.
    pub zone_u95_mm: f64,
    /// The limit.
    pub tolerance_mm: f64,
    /// What the limit applies to.
    pub tolerance_kind: ToleranceKind,
    /// Whether it is kept.
    pub verdict: Verdict,
    /// What to turn.
    pub correction: Correction,
}

impl Offset {
    /// Judges an offset with its covariance, known with so many degrees of freedom, and the part of it that is the calibration's.
    pub(super) fn judge(
        offset: Vector2<f64>,
        covariance: Matrix2<f64>,
        of_calibration: Matrix2<f64>,
        dof: f64,
        options: &Options,
    ) -> Self {
        let k = k95(dof);
        // As normal distributions of the same 95 % intervals.
        let stated = |c: Matrix2<f64>| {
            let c = c * (k / K95).powi(2);
            [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]]
        };
        let (distance_mm, distance_u95_mm) = distance(offset, covariance, dof);
        let factor = match options.tolerance_kind {
            ToleranceKind::Distance => 1.0,
            ToleranceKind::Zone => 2.0,
        };
        let u95 = [0, 1].map(|i| k * covariance[(i, i)].max(0.0).sqrt());
        let limit = options.tolerance_mm;
        Self {
            offset_mm: offset.into(),
            offset_u95_mm: u95,
            offset_cov_mm2: stated(covariance),
            offset_calibration_cov_mm2: stated(of_calibration),
            distance_mm,
            distance_u95_mm,
            zone_mm: 2.0 * distance_mm,
            zone_u95_mm: 2.0 * distance_u95_mm,
            tolerance_mm: limit,
            tolerance_kind: options.tolerance_kind,
            verdict: Verdict::of(factor * distance_mm, factor * distance_u95_mm, limit),
            correction: correction(offset, u95, options),
        }
    }
}

/// Several burn tests at one setting, taken together.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Mean {
    /// How many.
    pub tests: usize,
    /// Their weighted mean.
    #[serde(flatten)]
    pub offset: Offset,
    /// How much farther apart they lie than their uncertainties say: 1 or less where they agree. The mean's uncertainty has been
    /// multiplied by it where it is more.
    pub spread: f64,
    /// The chance of as much spread or more between tests that agree.
    pub p_agree: f64,
}

/// Below this chance tests do not agree.
const DISAGREE: f64 = 0.01;

impl Mean {
    /// What a user should know.
    pub fn warning(&self) -> Option<String> {
        (self.p_agree < DISAGREE).then(|| {
            format!(
                "the {} tests lie {:.1} times as far apart as their uncertainties say (chance {:.1e}): was anything turned \
                 between them, or one of them disturbed?",
                self.tests, self.spread, self.p_agree
            )
        })
    }
}

/// The mean of burn tests at one setting, each weighted by its covariance; where they lie farther apart than their
/// uncertainties say, the mean's are larger by as much (Birge's ratio), and where they do not agree it is they that tell it. The
/// calibration's part is common to all. Each test needs a fresh place on the plate: what disturbs all of them alike is not
/// averaged away.
///
/// # Errors
/// Fewer than two tests, or one whose covariance is none.
pub fn mean(tests: &[Offset], options: &Options) -> Result<Mean> {
    if tests.len() < 2 {
        return Err(Error::measure(
            "the mean",
            format!("needs at least two measured burn tests, not {}", tests.len()),
            "burn again at the same setting, and give the pictures of all tests",
        ));
    }
    let inverse = |covariance: Matrix2<f64>| {
        let known = |w: &Matrix2<f64>| w.iter().all(|v| v.is_finite()) && w.cholesky().is_some();
        covariance.try_inverse().filter(known).ok_or_else(|| {
            Error::measure(
                "the mean",
                "an offset's covariance is not a valid covariance matrix",
                "measure it again",
            )
        })
    };
    let matrix = |[[xx, xy], [yx, yy]]: [[f64; 2]; 2]| Matrix2::new(xx, xy, yx, yy);
    let (mut weight, mut sum) = (Matrix2::zeros(), Vector2::zeros());
    let mut weights = Vec::new();
    let mut common = Matrix2::zeros();
    for test in tests {
        let of_calibration = matrix(test.offset_calibration_cov_mm2);
        common += of_calibration / tests.len() as f64;
        let w = inverse(matrix(test.offset_cov_mm2) - of_calibration)?;
        weight += w;
        sum += w * Vector2::from(test.offset_mm);
        weights.push(w);
    }
    let covariance = inverse(weight)?;
    let offset = covariance * sum;
    let apart = |t: &Offset| Vector2::from(t.offset_mm) - offset;
    let chi2: f64 = tests.iter().zip(&weights).map(|(t, w)| apart(t).dot(&(w * apart(t)))).sum();
    let others = tests.len() - 1;
    let dof = (2 * others) as f64;
    let spread = (chi2 / dof).sqrt();
    let p_agree = ln_chi2_tail(chi2, dof).exp();
    let few = if p_agree < DISAGREE { (k95(dof) / K95).powi(2) } else { 1.0 };
    let covariance = covariance * spread.max(1.0).powi(2) * few + common;
    Ok(Mean {
        tests: tests.len(),
        offset: Offset::judge(offset, covariance, common, f64::INFINITY, options),
        spread,
        p_agree,
    })
}

/// The turn of B and of the head that makes the next burn concentric. See the module's signs.
fn correction(offset: Vector2<f64>, u95: [f64; 2], options: &Options) -> Correction {
    let height = options.ring_height_mm - options.spot_height_mm;
    let slope = |d: f64| (1.0 / (1.0 + (d / height).powi(2)) / height).to_degrees();
    let shim = (offset.y / height).atan();
    Correction {
        b_deg: -(offset.x / height).atan().to_degrees(),
        b_u95_deg: u95[0] * slope(offset.x),
        shim_deg: shim.to_degrees(),
        shim_u95_deg: u95[1] * slope(offset.y),
        shim_mm: options.flange_mm.map(|l| l * shim.tan()),
        shim_u95_mm: options.flange_mm.map(|l| l * u95[1] / height),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Three tests of which the second is known less well along a slanted line, each off by what its covariance says and
    /// `by_hand_mm` more in the last.
    fn three(
        rng: &mut rand_chacha::ChaCha8Rng,
        truth: Vector2<f64>,
        by_hand_mm: f64,
    ) -> Vec<Offset> {
        let roots = [[2e-3, 0.0, 2e-3], [4e-3, 3e-3, 1e-3], [1e-3, -1e-3, 3e-3]];
        let mut tests: Vec<Offset> = roots
            .map(|[a, b, c]| {
                let root = Matrix2::new(a, 0.0, b, c);
                let normal = Vector2::from_fn(|_, _| StandardNormal.sample(rng));
                let covariance = root * root.transpose();
                let none = Matrix2::zeros();
                Offset::judge(truth + root * normal, covariance, none, 1e6, &Options::default())
            })
            .into();
        tests[2].offset_mm[0] += by_hand_mm;
        tests
    }

    #[test]
    fn the_mean_of_repeats_holds_the_truth_and_says_when_they_disagree() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let truth = Vector2::new(3e-3, -1e-3);
        let (mut held, mut agreed, mut narrower) = (0, 0, 0);
        const CASES: usize = 4000;
        for _ in 0..CASES {
            let tests = three(&mut rng, truth, 0.0);
            let m = mean(&tests, &Options::default()).unwrap();
            let off = Vector2::from(m.offset.offset_mm) - truth;
            held += (0..2).filter(|i| off[*i].abs() <= m.offset.offset_u95_mm[*i]).count();
            agreed += usize::from(m.warning().is_none());
            let least = tests.iter().map(|t| t.offset_u95_mm[0]).fold(f64::INFINITY, f64::min);
            narrower += usize::from(m.offset.offset_u95_mm[0] < least);
        }
        let share = |n: usize, of: usize| n as f64 / of as f64;
        // Birge's ratio only ever widens: a little above 95 %.
        assert!((0.95..0.985).contains(&share(held, 2 * CASES)), "{}", share(held, 2 * CASES));
        assert!((0.985..0.995).contains(&share(agreed, CASES)), "{}", share(agreed, CASES));
        assert!(share(narrower, CASES) > 0.6, "{}", share(narrower, CASES));
        let turned = three(&mut rng, truth, 0.05);
        let m = mean(&turned, &Options::default()).unwrap();
        assert!(m.spread > 3.0 && m.warning().unwrap().contains("turned"), "{m:?}");
        assert!(mean(&turned[..1], &Options::default()).is_err());
    }

    #[test]
    fn no_mean_lessens_the_calibrations_part() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
        let (own, common) = (1e-3, 3e-3);
        let square = |sd: f64| Matrix2::from_diagonal_element(sd * sd);
        let mut held = 0;
        const CASES: usize = 2000;
        for _ in 0..CASES {
            let mut drawn = || -> f64 { StandardNormal.sample(&mut rng) };
            let mut normal = |sd: f64| Vector2::from_fn(|_, _| sd * drawn());
            let shared = normal(common);
            let test = |_| {
                let covariance = square(own) + square(common);
                Offset::judge(
                    shared + normal(own),
                    covariance,
                    square(common),
                    1e6,
                    &Options::default(),
                )
            };
            let m =
                mean(&(0..6).map(test).collect::<Vec<_>>(), &Options::default()).unwrap().offset;
            held += (0..2).filter(|i| m.offset_mm[*i].abs() <= m.offset_u95_mm[*i]).count();
        }
        let share = held as f64 / (2 * CASES) as f64;
        assert!((0.94..0.965).contains(&share), "{share}");
    }
}
