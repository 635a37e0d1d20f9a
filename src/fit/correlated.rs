//! Linear least squares whose residuals are correlated along an edge.
//!
//! A burnt or machined edge wanders: neighbouring points err together, and treating them as independent
//! makes the uncertainty far too small. The residual covariance is modelled as white noise plus a wandering
//! part, C = s² [(1 - φ) V + φ A K(ℓ) A], with K exponential or Gaussian in the distance between the points and A
//! the same everywhere (a ragged edge) or as V has it (brushed metal disturbs some arcs more than others). φ, ℓ
//! and the kernel's kind are averaged over a grid, weighted by their restricted likelihood (Patterson &
//! Thompson 1971), so that the answer also carries the uncertainty of the correlation itself.
//!
//! A group as a whole may also lie elsewhere than said (a machine's position is not exact): a random displacement,
//! as large in all directions, whose size is one more dimension of the grid.

mod covariance;
mod displaced;

use nalgebra::{DMatrix, DVector, Vector2};

pub use covariance::groups;
use covariance::{Kernel, Shape, Wandering, alike, kernels, parts};
use displaced::{Solved, Whitened};

/// What one edge has taught about how edges wander here, to judge a shorter edge of the same kind by.
#[derive(Debug, Clone, Default)]
pub struct Wander {
    /// Probability of no wander at all.
    white: f64,
    /// Kernel, correlation length and probability.
    kernels: Vec<(Kernel, f64, f64)>,
}

/// Rows to fit: `y ≈ design · β`.
#[derive(Debug, Clone)]
pub struct Rows {
    /// One row of coefficients an observation.
    pub design: DMatrix<f64>,
    /// The observations.
    pub y: DVector<f64>,
    /// Relative variance of each observation's white part.
    pub variance: Vec<f64>,
    /// The same with what observations have in common, where that is known; for one group only.
    pub covariance: Option<DMatrix<f64>>,
    /// Where each observation lies, for the distance between two of them.
    pub place: Vec<Vector2<f64>>,
    /// Observations of different groups (pictures) are independent. Groups are consecutive.
    pub group: Vec<usize>,
    /// How much an observation grows when its group is displaced by one in x, in y; `None` where groups stay in place.
    pub displacement: Option<Vec<Vector2<f64>>>,
    /// How much wider the interval of an edge that only wanders is than that of a stationary one: real wander is not stationary, arcs
    /// differ, texture leans one way.
    pub unsteady: f64,
    /// Whether that goes for long wander alone, of which an edge shows little.
    pub unsteady_if_long: bool,
}

/// The fitted coefficients and what is known of them.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The coefficients.
    pub beta: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// What the coefficients leave of each observation.
    pub residuals: DVector<f64>,
    /// Observations minus coefficients.
    pub dof: f64,
    /// Share of the wandering part in the residual variance, averaged over the grid.
    pub wander_share: f64,
    /// What this edge teaches about another one.
    pub wander: Wander,
    /// For every coefficient, the rows' weights in its estimate at the most likely grid point (p × n).
    pub influence: DMatrix<f64>,
    /// Residual covariance at the most likely grid point, of each group's rows: groups are independent.
    pub row_covariance: Vec<DMatrix<f64>>,
    /// The part of that which wander makes.
    pub wander_covariance: Vec<DMatrix<f64>>,
    /// Probability that groups are displaced at all.
    pub displaced: f64,
    /// Most likely standard deviation of a displacement, in x as in y.
    pub displacement_sd: f64,
    /// The part of the residuals that the groups' most likely displacements make.
    pub moved: DVector<f64>,
}

/// No wander; without a share any kernel and length have no say.
const WHITE: Wandering = Wandering {
    share: 0.0,
    length: 1.0,
    kernel: Kernel { shape: Shape::Exponential, as_noise: false },
};

/// Wander this long, in parts of the edge's extent, is long.
const LONG: f64 = 0.2;

/// Shares of the wandering part tried.
const SHARES: [f64; 6] = [0.15, 0.35, 0.6, 0.8, 0.92, 0.98];

/// Log likelihood below the best at which a grid point does not count.
const NEGLIGIBLE: f64 = 12.0;

struct Candidate {
    beta: DVector<f64>,
    covariance: DMatrix<f64>,
    log_likelihood: f64,
    wandering: Wandering,
    scale: f64,
    /// Variance of the displacement, before scaling.
    displacement: f64,
}

/// Fits. `None` where the rows do not determine the coefficients. `known` is what a longer edge of the same kind
/// has taught: wander about as long as the edge itself looks like a shifted centre, so a short edge alone
/// cannot tell.
pub fn fit(rows: &Rows, known: Option<&Wander>) -> Option<Fit> {
    let (n, p) = rows.design.shape();
    if n <= p {
        return None;
    }
    let mean_variance = rows.variance.iter().sum::<f64>() / n as f64;
    if mean_variance.is_nan() || mean_variance <= 0.0 {
        return None;
    }
    let (candidates, white) = search(rows, mean_variance, grid(rows, known));
    let best = candidates.iter().max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood))?;
    let (_, extent) = spacing_and_extent(rows);
    let unsteady = |w: &Wandering| {
        let long = (w.length / (LONG * extent)).min(1.0);
        rows.unsteady * w.share * if rows.unsteady_if_long { long } else { 1.0 }
    };
    let (mut total, mut beta, mut share, mut wider) = (0.0, DVector::zeros(p), 0.0, 0.0);
    let weight = |c: &Candidate| (c.log_likelihood - best.log_likelihood).exp();
    for c in &candidates {
        let w = weight(c);
        total += w;
        beta += &c.beta * w;
        share += c.wandering.share * w;
        wider += unsteady(&c.wandering) * w;
    }
    beta /= total;
    let mut covariance = DMatrix::zeros(p, p);
    for c in &candidates {
        let d = &c.beta - &beta;
        covariance += (&c.covariance + &d * d.transpose()) * (weight(c) / total);
    }
    covariance *= (1.0 + wider / total).powi(2);
    let sum = |list: &[Candidate]| list.iter().map(weight).sum::<f64>() / total;
    let mut wander = Wander { white: sum(&candidates[..white]), kernels: Vec::new() };
    for c in &candidates[white..] {
        let Wandering { kernel, length, .. } = c.wandering;
        match wander.kernels.last_mut() {
            Some((k, l, sum)) if *k == kernel && *l == length => *sum += weight(c) / total,
            _ => wander.kernels.push((kernel, length, weight(c) / total)),
        }
    }
    let displaced = candidates.iter().filter(|c| c.displacement > 0.0).map(weight).sum::<f64>();
    let residuals = &rows.y - &rows.design * &beta;
    let (mut row_covariance, mut wander_covariance) = parts(rows, mean_variance, best.wandering);
    let moved = displaced::most_likely(rows, &row_covariance, &residuals, best.displacement);
    displaced::add(rows, best.displacement, &mut row_covariance);
    for block in row_covariance.iter_mut().chain(&mut wander_covariance) {
        *block *= best.scale;
    }
    let influence = influence(rows, &row_covariance)?;
    Some(Fit {
        beta,
        covariance,
        residuals,
        dof: (n - p) as f64,
        wander_share: share / total,
        wander,
        influence,
        row_covariance,
        wander_covariance,
        displaced: displaced / total,
        displacement_sd: (best.displacement * best.scale).sqrt(),
        moved,
    })
}

/// The rows' weights in the coefficients of generalised least squares (p × n).
fn influence(rows: &Rows, covariance: &[DMatrix<f64>]) -> Option<DMatrix<f64>> {
    let mut solved = rows.design.clone();
    for (range, block) in groups(&rows.group).into_iter().zip(covariance) {
        block.clone().cholesky()?.solve_mut(&mut solved.rows_range_mut(range));
    }
    Some(rows.design.tr_mul(&solved).try_inverse()? * solved.transpose())
}

/// Fits with every wander that may count; how many of them, the first ones, have none.
fn search(rows: &Rows, mean_variance: f64, grid: Wander) -> (Vec<Candidate>, usize) {
    let mut candidates = at_grid_point(rows, mean_variance, WHITE, &[], grid.white);
    let white = candidates.len();
    let likeliest = |list: &[Candidate]| {
        list.iter().map(|c| c.log_likelihood).fold(f64::NEG_INFINITY, f64::max)
    };
    // Kernels that differ in size alone stand side by side.
    let (mut of, mut how_alike) = (None, Vec::new());
    let mut best = likeliest(&candidates);
    let mut start = SHARES.len() / 2;
    for (kernel, length, probability) in grid.kernels {
        if of != Some((kernel.shape, length)) {
            (of, how_alike) = (Some((kernel.shape, length)), alike(rows, kernel.shape, length));
        }
        // From the share that was likeliest so far both ways, until nothing comes that would count.
        let mut here = [f64::NEG_INFINITY; SHARES.len()];
        let up = (start..SHARES.len()).map(|i| (i, i.wrapping_sub(1)));
        let down = (0..start).rev().map(|i| (i, i + 1));
        for way in [up.collect::<Vec<_>>(), down.collect()] {
            for (i, before) in way {
                let wandering = Wandering { share: SHARES[i], length, kernel };
                let probability = probability / SHARES.len() as f64;
                let found = at_grid_point(rows, mean_variance, wandering, &how_alike, probability);
                here[i] = likeliest(&found);
                best = best.max(here[i]);
                candidates.extend(found);
                if i != start && here[i] < here[before] && here[i] < best - NEGLIGIBLE {
                    break;
                }
            }
        }
        start = (0..SHARES.len()).max_by(|&a, &b| here[a].total_cmp(&here[b])).unwrap_or(start);
    }
    (candidates, white)
}

/// The kernels to try, with their prior probabilities.
fn grid(rows: &Rows, known: Option<&Wander>) -> Wander {
    let (spacing, extent) = spacing_and_extent(rows);
    let mut own = Vec::new();
    let mut length = spacing;
    while length < 0.25 * extent {
        own.extend(kernels(Shape::Exponential).map(|k| (k, length, spacing / length)));
        if length < 0.15 * extent {
            own.extend(kernels(Shape::Gaussian).map(|k| (k, length, spacing / length)));
        }
        length *= 2.0;
    }
    let total: f64 = own.iter().map(|k| k.2).sum();
    own.iter_mut().for_each(|k| k.2 *= 0.5 / total);
    let Some(known) = known else {
        return Wander { white: if own.is_empty() { 1.0 } else { 0.5 }, kernels: own };
    };
    // Mostly as the longer edge says, with some room for this one to differ.
    let room = 0.2;
    own.iter_mut().for_each(|k| k.2 *= room);
    // Wander as long as the edge itself cannot be told from its place and size: it would make both meaningless.
    let longest = |kernel: Kernel| match kernel.shape {
        Shape::Exponential => 0.5 * extent,
        Shape::Gaussian => 0.25 * extent,
    };
    let fits = |k: &&(Kernel, f64, f64)| k.2 > 1e-3 && k.1 < longest(k.0) && k.1 > 0.5 * spacing;
    let told = known.kernels.iter().filter(fits);
    own.extend(told.map(|&(kernel, length, p)| (kernel, length, p * (1.0 - room))));
    Wander { white: 0.5 * room + (known.white + 1e-3) * (1.0 - room), kernels: own }
}

/// Median distance between neighbours in a group, and the largest distance within a group.
fn spacing_and_extent(rows: &Rows) -> (f64, f64) {
    let mut gaps = Vec::new();
    let mut extent: f64 = 0.0;
    let mut start = 0;
    for i in 1..rows.y.len() {
        if rows.group[i] == rows.group[i - 1] {
            gaps.push((rows.place[i] - rows.place[i - 1]).norm());
            extent = extent.max((rows.place[i] - rows.place[start]).norm());
        } else {
            start = i;
        }
    }
    gaps.sort_by(f64::total_cmp);
    (gaps.get(gaps.len() / 2).copied().unwrap_or(1.0), extent)
}

/// Generalised least squares at one grid point of the wander and all of the displacement, with their restricted log
/// likelihoods (scale profiled out). Points that cannot be solved are left out.
fn at_grid_point(
    rows: &Rows,
    mean_variance: f64,
    wandering: Wandering,
    alike: &[DMatrix<f64>],
    probability: f64,
) -> Vec<Candidate> {
    let Some(whitened) = Whitened::new(rows, mean_variance, wandering, alike) else {
        return Vec::new();
    };
    let still = (0.0, probability * if rows.displacement.is_some() { 0.5 } else { 1.0 });
    let moved =
        |ratio: f64| (ratio * mean_variance, probability * 0.5 / displaced::VARIANCES.len() as f64);
    let tried = rows.displacement.iter().flat_map(|_| displaced::VARIANCES.map(moved));
    let solve = |(displacement, probability): (f64, f64)| {
        let Solved { beta, covariance, scale, log_likelihood } = whitened.solve(displacement)?;
        let log_likelihood = log_likelihood + probability.ln();
        Some(Candidate { beta, covariance, log_likelihood, wandering, scale, displacement })
    };
    std::iter::once(still).chain(tried).filter_map(solve).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A circle of radius `radius` whose edge wanders with a Gaussian correlation of length `length`.
    fn circle(radius: f64, length: f64, wander: f64, normal: &mut impl FnMut() -> f64) -> Rows {
        let n = 72;
        let angles: Vec<f64> =
            (0..n).map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(n)).collect();
        let sd = |k: i32| (-0.25 * (f64::from(k) * length / radius).powi(2)).exp();
        let power: f64 = 0.5 * sd(0).powi(2) + (1..36).map(|k| sd(k).powi(2)).sum::<f64>();
        let waves: Vec<(f64, f64, f64)> =
            (1..36).map(|k| (f64::from(k), sd(k) * normal(), sd(k) * normal())).collect();
        let y = DVector::from_iterator(
            angles.len(),
            angles.iter().map(|t| {
                let w: f64 =
                    waves.iter().map(|(k, a, b)| a * (k * t).cos() + b * (k * t).sin()).sum();
                normal() + wander * w / power.sqrt()
            }),
        );
        let design = DMatrix::from_fn(angles.len(), 3, |i, c| match c {
            0 => angles[i].cos(),
            1 => angles[i].sin(),
            _ => 1.0,
        });
        Rows {
            design,
            y,
            variance: vec![1.0; angles.len()],
            place: angles.iter().map(|t| Vector2::new(t.cos(), t.sin()) * radius).collect(),
            group: vec![0; angles.len()],
            displacement: None,
            covariance: None,
            unsteady: 0.4,
            unsteady_if_long: true,
        }
    }

    /// The stated 95 % interval of the centre holds the truth and is not much wider than it must be.
    #[test]
    fn intervals_hold_for_wandering_edges() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        for (radius, length, wander, told) in [
            (3.0, 0.2, 0.0, false),
            (3.0, 0.2, 3.0, false),
            (0.5, 0.2, 0.0, true),
            (0.5, 0.2, 3.0, true),
        ] {
            let runs = 200;
            let (mut inside, mut stated, mut real) = (0, Vec::new(), Vec::new());
            for _ in 0..runs {
                let ring = fit(&circle(3.0, length, wander, &mut normal), None).unwrap();
                let fit =
                    fit(&circle(radius, length, wander, &mut normal), told.then_some(&ring.wander))
                        .unwrap();
                let u = crate::uncertainty::k95(fit.dof) * fit.covariance[(0, 0)].sqrt();
                inside += usize::from(fit.beta[0].abs() <= u);
                stated.push(u);
                real.push(fit.beta[0].abs());
            }
            stated.sort_by(f64::total_cmp);
            real.sort_by(f64::total_cmp);
            let share = inside as f64 / f64::from(runs);
            let width = stated[runs as usize / 2] / real[runs as usize * 95 / 100];
            assert!((0.91..=1.0).contains(&share), "{radius} {length} {wander}: {share}");
            assert!((0.8..2.2).contains(&width), "{radius} {length} {wander}: {width}");
        }
    }
}
