//! The waves of the level round a circle: what repeats itself all round has few of them.

use nalgebra::Vector2;

use crate::find::look::{Look, value_at};

/// Levels at a radius in some directions, reduced pixels; NaN outside the picture.
pub(super) fn levels<const RAYS: usize>(
    look: &Look,
    center: Vector2<f64>,
    radius: f64,
    around: &[Vector2<f64>; RAYS],
) -> [f64; RAYS] {
    let image = &look.scales[0].1;
    around.map(|along| {
        let p = center + radius * along;
        f64::from(value_at(image, p.x, p.y))
    })
}

/// Mean step from levels to others over the directions that see both, and how many do.
pub(super) fn mean_step(from: &[f64], to: &[f64]) -> (f64, f64) {
    let seen = from.iter().zip(to).map(|(a, b)| b - a).filter(|step| step.is_finite());
    let (sum, count) = seen.fold((0.0, 0.0), |(sum, count), step| (sum + step, count + 1.0));
    (sum / count, count)
}

/// Mean square of each wave of levels all round from the `first`, the ones before it as 0.
pub(super) fn powers<const RAYS: usize, const COUNT: usize>(
    levels: &[f64; RAYS],
    around: &[Vector2<f64>; RAYS],
    first: usize,
) -> [f64; COUNT] {
    let mut powers = [0.0; COUNT];
    for (wave, power) in powers.iter_mut().enumerate().skip(first) {
        let sum = (levels.iter().enumerate())
            .fold(Vector2::zeros(), |sum, (i, v)| sum + *v * around[wave * i % RAYS]);
        *power = 2.0 * sum.norm_squared() / (RAYS * RAYS) as f64;
    }
    powers
}
