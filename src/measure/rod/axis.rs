//! The C axis, and with it the radius: the rod turns with the table, so its centres at all angles lie on one circle about the axis.
//!
//! An arc by itself hardly tells a larger radius from a centre farther inside it. Centres that are tied to the axis cannot all move at will:
//! of three angles and more, arcs in place tell the radius as arcs all round one centre do.

use nalgebra::{DMatrix, DVector, Matrix2, Rotation2, Vector2};

use crate::fit::least_squares;
use crate::fit::robust::median;

/// Some values and the radius, which is the last, with all that they have in common.
#[derive(Debug, Clone)]
pub(super) struct Known {
    /// The values, mm.
    pub values: DVector<f64>,
    /// Their covariance, mm².
    pub covariance: DMatrix<f64>,
    /// From the free fit's centres and radius to them.
    pub gain: DMatrix<f64>,
}

impl Known {
    /// The radius, mm.
    pub fn radius(&self) -> f64 {
        self.values[self.values.len() - 1]
    }

    /// Its variance, mm².
    pub fn radius_variance(&self) -> f64 {
        self.covariance[(self.values.len() - 1, self.values.len() - 1)]
    }

    /// Value `i` and the next one.
    pub fn pair(&self, i: usize) -> Vector2<f64> {
        self.values.fixed_rows::<2>(i).into()
    }

    /// Covariance of that pair.
    pub fn pair_covariance(&self, i: usize) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(i, i).into()
    }

    /// The gain of the first pair and of the radius (3 × (2n + 1)).
    pub fn first_and_radius(&self) -> DMatrix<f64> {
        self.gain.select_rows(&[0, 1, self.values.len() - 1])
    }

    /// Makes the radius less sure by what has nothing to do with the other values.
    pub fn widen_radius(&mut self, variance: f64) {
        let last = self.values.len() - 1;
        self.covariance[(last, last)] += variance;
    }

    /// Takes over another's radius, which is as good and better; the other values follow.
    pub fn take_radius(&mut self, other: &Known) {
        let last = self.values.len() - 1;
        let follow = self.covariance.column(last) / self.radius_variance();
        self.values += &follow * (other.radius() - self.radius());
        self.covariance +=
            &follow * follow.transpose() * (other.radius_variance() - self.radius_variance());
        let change = other.gain.row(other.values.len() - 1) - self.gain.row(last);
        self.gain += follow * change;
    }

    /// One more observation of the radius.
    pub fn observe_radius(&mut self, radius_mm: f64, variance: f64) {
        let last = self.values.len() - 1;
        let total = self.radius_variance() + variance;
        let follow = self.covariance.column(last) / total;
        self.values += &follow * (radius_mm - self.radius());
        self.covariance -= &follow * follow.transpose() * total;
        let before = self.gain.row(last).into_owned();
        self.gain -= follow * before;
    }
}

/// The C axis with the rod's radius.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    /// Axis x, y, eccentricity x, y, radius.
    pub known: Known,
    /// Sum of squares of the residuals over what the pixels tell of them, and their degrees of freedom.
    pub chi2: f64,
    pub dof: usize,
    /// The part of the numbers' variances that is known from those misses alone.
    from_misses: DVector<f64>,
    /// Variance of a centre's place that the pixels of its arcs do not tell, each axis, mm².
    out_of_place_mm2: f64,
    /// Restricted log likelihood, but for a constant.
    log_likelihood: f64,
}

impl Axis {
    /// Degrees of freedom of number `i` (Welch-Satterthwaite): few misses tell badly how large they are.
    pub fn dof_of(&self, i: usize) -> f64 {
        let share = self.from_misses[i] / self.known.covariance[(i, i)].max(f64::MIN_POSITIVE);
        self.dof as f64 / share.clamp(0.0, 1.0).powi(2)
    }

    /// The rod's centre at a table angle.
    pub fn center(&self, c_deg: f64, sense: f64) -> Vector2<f64> {
        self.known.pair(0) + Rotation2::new((sense * c_deg).to_radians()) * self.known.pair(2)
    }

    /// Variance of a coordinate of a centre by itself, of which the pixels tell `pixels_mm2`, and its degrees of freedom.
    pub fn of_a_center(&self, pixels_mm2: f64) -> (f64, f64) {
        let variance = pixels_mm2 + self.out_of_place_mm2;
        let share = self.out_of_place_mm2 / variance.max(f64::MIN_POSITIVE);
        (variance, self.dof as f64 / share.clamp(0.0, 1.0).powi(2))
    }
}

/// The numbers of an [`Axis`].
const NUMBERS: usize = 5;

/// Fits `centre(C) = axis + Rz(sense·C)·e` to the centres, and the radius with them, by their covariance. Two angles at least. Each centre
/// may be out of place by more than the pixels of its arcs can tell (the machine's position, turning lines, dirt and rounding move an arc as a
/// whole), but with the probability `in_place`. By how much, the misses of their circle say, and few of them say it badly: all sizes count, by
/// their restricted likelihood.
pub(super) fn axis(rod: &Known, c_deg: &[f64], sense: f64, in_place: f64) -> Option<Axis> {
    let still = axis_if(rod, 0.0, c_deg, sense)?;
    let (chi2, dof) = (still.chi2, still.dof);
    if dof == 0 {
        return Some(still);
    }
    let if_still = still.known.covariance.diagonal();
    let own = (0..c_deg.len()).map(|i| rod.pair_covariance(2 * i).symmetric_eigenvalues().min());
    // A single arc tells its place one way, and hardly the other.
    let best_way = median(&mut own.collect::<Vec<f64>>()).max(0.0);
    let sizes: Vec<f64> = (0..SIZES).map(|i| LEAST * STEP.powi(i)).collect();
    let total: f64 = sizes.iter().map(|size| half_cauchy(*size)).sum();
    let moved = sizes.iter().filter_map(|size| {
        let mut axis = axis_if(rod, best_way * size * size, c_deg, sense)?;
        axis.log_likelihood += ((1.0 - in_place) * half_cauchy(*size) / total / in_place).ln();
        Some(axis)
    });
    let all: Vec<Axis> = std::iter::once(still).chain(moved).collect();
    let likeliest = all.iter().map(|a| a.log_likelihood).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = all.iter().map(|a| (a.log_likelihood - likeliest).exp()).collect();
    let total: f64 = weights.iter().sum();
    let mut known = Known {
        values: DVector::zeros(NUMBERS),
        covariance: DMatrix::zeros(NUMBERS, NUMBERS),
        gain: DMatrix::zeros(NUMBERS, rod.values.len()),
    };
    let mut out_of_place_mm2 = 0.0;
    for (one, weight) in all.iter().zip(&weights) {
        out_of_place_mm2 += one.out_of_place_mm2 * (weight / total);
        known.values += &one.known.values * (weight / total);
        known.gain += &one.known.gain * (weight / total);
    }
    for (one, weight) in all.iter().zip(&weights) {
        let apart = &one.known.values - &known.values;
        known.covariance += (&one.known.covariance + &apart * apart.transpose()) * (weight / total);
    }
    let from_misses = known.covariance.diagonal() - if_still;
    Some(Axis { known, chi2, dof, from_misses, out_of_place_mm2, log_likelihood: likeliest })
}

/// By how much a centre may be out of place, in its own standard deviation where it is surest: from so much in steps of such a ratio.
const LEAST: f64 = 0.5;
const STEP: f64 = 1.6;
const SIZES: i32 = 24;
/// Probability, before the centres are seen, that none is out of place: where some angle has a single arc, and where all have several, whose
/// disagreement has what moves one of them already.
pub(super) const IN_PLACE: [f64; 2] = [0.5, 0.9];

/// How likely a size is, before the centres are seen, as a part of a range of ratios (half-Cauchy, Gelman 2006): about the arcs' own scatter
/// or less, and far more where the centres say so. Were all ratios alike, those that few centres cannot refute would make the interval.
fn half_cauchy(size: f64) -> f64 {
    size / (1.0 + size * size)
}

/// The same where centres are out of place by that variance, each axis.
fn axis_if(rod: &Known, out_of_place: f64, c_deg: &[f64], sense: f64) -> Option<Axis> {
    let n = rod.values.len();
    let mut covariance = rod.covariance.clone();
    (0..n - 1).for_each(|i| covariance[(i, i)] += out_of_place);
    let l = covariance.cholesky()?.unpack();
    let mut x = DMatrix::zeros(n, NUMBERS);
    for (i, c) in c_deg.iter().enumerate() {
        let (s, k) = (sense * c).to_radians().sin_cos();
        x.view_mut((2 * i, 0), (2, 4)).copy_from_slice(&[1.0, 0.0, 0.0, 1.0, k, s, -s, k]);
    }
    x[(n - 1, NUMBERS - 1)] = 1.0;
    let mut y = rod.values.clone();
    if !l.solve_lower_triangular_mut(&mut x) || !l.solve_lower_triangular_mut(&mut y) {
        return None;
    }
    let (covariance, rank) = least_squares::covariance(&x, 1e-9);
    if rank < NUMBERS {
        return None;
    }
    let values = &covariance * x.tr_mul(&y);
    let chi2 = (&y - &x * &values).norm_squared();
    let log_det =
        2.0 * l.diagonal().iter().map(|d| d.ln()).sum::<f64>() - covariance.determinant().ln();
    let gain = &covariance * x.tr_mul(&l.solve_lower_triangular(&DMatrix::identity(n, n))?);
    Some(Axis {
        known: Known { values, covariance, gain },
        chi2,
        dof: n - NUMBERS,
        from_misses: DVector::zeros(NUMBERS),
        out_of_place_mm2: out_of_place,
        log_likelihood: -0.5 * (log_det + chi2),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uncertainty::k95;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// One arc at each table angle, known along its normal and hardly across: where arcs are out of place as a whole the axis and the
    /// centres know it, and where they are not the axis' interval is no wider for that.
    #[test]
    fn arcs_out_of_place_are_in_the_interval_of_the_axis() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let c_deg: Vec<f64> = (0..8).map(|i| 45.0 * f64::from(i)).collect();
        let [along_mm, across_mm]: [f64; 2] = [1e-4, 2e-3];
        for (out_of_place, held) in [(0.0, 0.92..=1.0), (2.5, 0.82..=0.97)] {
            let (mut inside, mut centers_inside, mut widths) = (0, 0, Vec::new());
            for _ in 0..300 {
                let mut covariance = DMatrix::identity(17, 17) * along_mm.powi(2);
                let mut values = DVector::zeros(17);
                for (i, c) in c_deg.iter().enumerate() {
                    let way = Rotation2::new(2.4 * i as f64);
                    let sizes = Matrix2::from_diagonal(&Vector2::new(along_mm, across_mm));
                    let part = way * sizes * sizes * way.inverse();
                    covariance.view_mut((2 * i, 2 * i), (2, 2)).copy_from(&part);
                    let own = way * Vector2::new(along_mm * normal(), across_mm * normal());
                    let moved = out_of_place * along_mm * Vector2::new(normal(), normal());
                    let turned = Rotation2::new(c.to_radians()) * Vector2::new(0.1, 0.0);
                    values.fixed_rows_mut::<2>(2 * i).copy_from(&(turned + own + moved));
                }
                let free = Known { values, covariance, gain: DMatrix::identity(17, 17) };
                let axis = axis(&free, &c_deg, 1.0, IN_PLACE[0]).unwrap();
                let u95_mm = k95(axis.dof_of(0)) * axis.known.covariance[(0, 0)].sqrt();
                inside += usize::from(axis.known.values[0].abs() < u95_mm);
                widths.push(u95_mm);
                let (variance, dof) = axis.of_a_center(free.covariance[(0, 0)]);
                let off_mm = (free.values[0] - 0.1).abs();
                centers_inside += usize::from(off_mm < k95(dof) * variance.sqrt());
            }
            let share = inside as f64 / 300.0;
            assert!(held.contains(&share), "{out_of_place}: {share}");
            let share = centers_inside as f64 / 300.0;
            assert!((0.92..=1.0).contains(&share), "centres, {out_of_place}: {share}");
            assert!(out_of_place > 0.0 || median(&mut widths) < 1.3 * 1.96 * 0.5 * along_mm);
        }
    }
}
