//! The waves of the level round a circle: what repeats itself all round has few of them.

use nalgebra::Vector2;

use crate::find::look::{Look, directions, value_at};

/// Share of the directions that must lie in the picture where a mean over them is taken.
const LEAST_SEEN: f64 = 0.4;

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

/// Mean levels about a centre over so many directions, at one radius after the other (reduced pixels), above that at the first: steps from
/// radius to radius, each over the directions that see both, as others begin elsewhere. They end where too few do.
pub(super) fn outward<const RAYS: usize>(
    look: &Look,
    center: Vector2<f64>,
    mut radii: impl Iterator<Item = f64>,
) -> impl Iterator<Item = f64> {
    let around = directions::<RAYS>();
    let mut before = radii.next().map(|first| levels(look, center, first, &around));
    let mut level = 0.0;
    radii.map_while(move |radius| {
        let now = levels(look, center, radius, &around);
        let (step, count) = mean_step(&before?, &now);
        before = Some(now);
        level += step;
        (count >= LEAST_SEEN * RAYS as f64).then_some(level)
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
