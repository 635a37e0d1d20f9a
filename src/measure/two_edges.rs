//! Whether what was measured as one circle is gathered from two: light from one side shows a hole's own edge on one side and its
//! chamfer's on the other, and a circle drawn through both is neither.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::fit::Circle;
use crate::fit::robust::median;
use crate::measure::ring::Ring;
use crate::measure::round::form;

/// Windows of a third of the circumference from which a circle is grown.
const WINDOWS: usize = 12;
const ROUNDS: usize = 6;
/// Sectors belong to a circle from which they are no farther than so many steps between neighbours, or such a part of the whole's form.
const NEAR_STEPS: f64 = 3.0;
const NEAR_FORM: f64 = 0.35;
/// The other edge is as far from the first all along, but for this part of it: an oval goes away slowly.
const ALIKE: f64 = 0.3;
/// Least shares of the sectors on the first circle, on the second, and on either.
const FIRST: f64 = 0.35;
const SECOND: f64 = 0.15;
const BOTH: f64 = 0.75;
/// How much better two circles explain the edge than one (ratio of the standard deviations).
const BETTER: f64 = 2.5;

/// Form over radius of what is drawn through two edges; less is a part's own form.
const LEAST_FORM: f64 = 0.004;
/// Two edges lie at least so far from each other, px and in softnesses: nearer ones are one.
const APART_PX: f64 = 1.5;
const APART: f64 = 1.0;

/// The two circles that the edge lies on, in the plane; `None` where one explains it.
pub(super) fn two_edges(ring: &Ring, pixel_mm: f64) -> Option<[Circle; 2]> {
    let circle = |c: Vector3<f64>| Circle {
        center: ring.circle.center + Vector2::new(c.x, c.y),
        radius: ring.circle.radius + c.z,
    };
    if form(ring) < LEAST_FORM {
        return None;
    }
    let both = parted(&ring.residuals)?;
    let apart_px = (both[0].z - both[1].z).abs() / pixel_mm;
    (apart_px > APART_PX.max(APART * ring.softness_px)).then(|| both.map(circle))
}

/// The same of what the sectors' edges leave over (angle, distance outwards), as corrections of their circle's centre and radius.
fn parted(residuals: &[(f64, f64)]) -> Option<[Vector3<f64>; 2]> {
    let sector = |(angle, off): &(f64, f64)| (Vector3::new(angle.cos(), angle.sin(), 1.0), *off);
    let sectors: Vec<Sector> = residuals.iter().map(sector).collect();
    let n = sectors.len();
    if n < 3 * WINDOWS {
        return None;
    }
    let share = |list: &[usize]| list.len() as f64 / n as f64;
    let rms = (sectors.iter().map(|s| s.1 * s.1).sum::<f64>() / n as f64).sqrt();
    let step = |i: usize| (sectors[i].1 - sectors[(i + 1) % n].1).abs();
    let near = NEAR_STEPS * median(&mut (0..n).map(step).collect::<Vec<_>>());
    let near = near.min(NEAR_FORM * rms);
    let grown = (0..WINDOWS).filter_map(|window| {
        let third = (0..n / 3).map(|i| (window * n / WINDOWS + i) % n);
        grow(&sectors, third.collect(), near)
    });
    let (first, on_first) = grown.max_by_key(|(_, on)| on.len())?;
    let rest: Vec<usize> = (0..n).filter(|i| !on_first.contains(i)).collect();
    if share(&on_first) < FIRST || share(&rest) < SECOND {
        return None;
    }
    let away = |&i: &usize| distance(&sectors[i], &first);
    let apart = median(&mut rest.iter().map(away).collect::<Vec<_>>());
    let on_second: Vec<usize> =
        rest.into_iter().filter(|i| (away(i) - apart).abs() < ALIKE * apart.abs()).collect();
    if share(&on_second) < SECOND || share(&on_first) + share(&on_second) < BOTH {
        return None;
    }
    let second = through(&sectors, &on_second)?;
    let squares = |on: &[usize], of: &Vector3<f64>| -> f64 {
        on.iter().map(|&i| distance(&sectors[i], of).powi(2)).sum()
    };
    let both = (on_first.len() + on_second.len()) as f64;
    let left = ((squares(&on_first, &first) + squares(&on_second, &second)) / both).sqrt();
    // Half a circle tells its centre badly: a chamfer's is its hole's, about.
    let concentric = first + Vector3::new(0.0, 0.0, apart);
    (BETTER * left < rms && apart.abs() > 2.0 * near).then_some([first, concentric])
}

/// Where a sector lies (cos, sin, 1), and how far its edge is outside the ring's circle, mm.
type Sector = (Vector3<f64>, f64);

/// How far a sector's edge is outside a circle.
fn distance(sector: &Sector, circle: &Vector3<f64>) -> f64 {
    sector.1 - sector.0.dot(circle)
}

/// The circle through some of the sectors.
fn through(sectors: &[Sector], on: &[usize]) -> Option<Vector3<f64>> {
    let normal: Matrix3<f64> = on.iter().map(|&i| sectors[i].0 * sectors[i].0.transpose()).sum();
    let right: Vector3<f64> = on.iter().map(|&i| sectors[i].0 * sectors[i].1).sum();
    Some(normal.try_inverse()? * right)
}

/// A circle through some sectors, and then through all that are near it.
fn grow(sectors: &[Sector], mut on: Vec<usize>, near: f64) -> Option<(Vector3<f64>, Vec<usize>)> {
    let mut circle = through(sectors, &on)?;
    for _ in 0..ROUNDS {
        let all = 0..sectors.len();
        on = all.filter(|&i| distance(&sectors[i], &circle).abs() < near).collect();
        circle = through(sectors, &on)?;
    }
    Some((circle, on))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A step between two sides is two edges, concentric or not quite; lobes and noise are one.
    #[test]
    fn a_step_is_two_edges_and_lobes_are_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let mut two = |noise: f64, edge: &dyn Fn(f64) -> f64| {
            let angles = (0..72).map(|i| f64::from(i).to_radians() * 5.0);
            let noisy = angles.map(|a| {
                let n: f64 = StandardNormal.sample(&mut rng);
                (a, edge(a) + noise * n)
            });
            let mut seen: Vec<(f64, f64)> = noisy.collect();
            // As the circle through all of them leaves it.
            let sectors: Vec<Sector> =
                seen.iter().map(|(a, r)| (Vector3::new(a.cos(), a.sin(), 1.0), *r)).collect();
            let circle = through(&sectors, &(0..72).collect::<Vec<_>>()).unwrap();
            seen.iter_mut().zip(&sectors).for_each(|(seen, s)| seen.1 = distance(s, &circle));
            parted(&seen)
        };
        for noise in [0.003, 0.01, 0.03] {
            let half = two(noise, &|a| 0.5 * (8.0 * a.cos()).tanh()).unwrap();
            assert!(((half[0].z - half[1].z).abs() - 1.0).abs() < 0.2, "{half:?}");
            assert!(
                two(noise, &|a| 0.5 * (1.0 + 0.2 * a.sin()) * (8.0 * a.cos()).tanh()).is_some()
            );
            assert!(two(noise, &|a| (5.0 * (a.cos() - 0.5)).tanh()).is_some());
            for lobes in [2.0, 3.0, 4.0, 5.0] {
                assert!(two(noise, &|a| (lobes * a).cos()).is_none(), "{lobes} {noise}");
            }
        }
        assert!((0..50).all(|_| two(1.0, &|_| 0.0).is_none()));
    }
}
