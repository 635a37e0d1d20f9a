//! Does a ring's edge repeat itself many times all round, as the teeth of a gear and a knurl do? A burn's raggedness does not.

use nalgebra::Vector2;

use crate::find::Candidate;
use crate::find::look::{Look, directions};
use crate::find::waves;

/// Directions, and waves all round that they tell well.
const RAYS: usize = 256;
const WAVES: usize = 100;
/// Waves that raggedness and teeth have, and those that are counted as teeth: of few a ragged edge has some by chance.
const FINE: usize = 9;
const TEETH: std::ops::RangeInclusive<usize> = 16..=WAVES;
/// Radii that are looked at, and over how many the waves are added up, as parts of the ring's.
const BESIDE: std::ops::Range<f64> = 0.85..1.08;
const TOGETHER: f64 = 0.04;
/// What repeats must be so strong (rms of its waves) as a part of the ring's step, and have such a part of the power of all fine waves.
const STRENGTH: f64 = 0.1;
const SHARE: f64 = 0.6;

/// Whether the edge of a ring has teeth.
pub(crate) fn is_toothed(look: &Look, ring: &Candidate) -> bool {
    let radius = ring.circle.radius / look.factor as f64;
    let center = look.reduced(ring.circle.center);
    let around: [Vector2<f64>; RAYS] = directions();
    let powers: Vec<[f64; WAVES + 1]> = ((BESIDE.start * radius) as usize
        ..(BESIDE.end * radius) as usize)
        .map(|r| about_mean(waves::levels(look, center, r as f64, &around)))
        .map(|levels| waves::powers(&levels, &around, FINE))
        .collect();
    let together = ((TOGETHER * radius) as usize).max(2);
    powers.windows(together).any(|near| {
        let power = |wave: usize| near.iter().map(|p| p[wave]).sum::<f64>() / together as f64;
        let all: f64 = (FINE..=WAVES).map(power).sum();
        // Seen at an angle they are not quite even.
        let line = |wave: usize| (wave - 1..=(wave + 1).min(WAVES)).map(power).sum::<f64>();
        let repeats = |k: usize| line(k) + if 2 * k <= WAVES { line(2 * k) } else { 0.0 };
        all > (STRENGTH * ring.step).powi(2) && TEETH.into_iter().any(|k| repeats(k) > SHARE * all)
    })
}

/// Levels about their mean; what lies outside the picture counts as even.
fn about_mean(levels: [f64; RAYS]) -> [f64; RAYS] {
    let seen = levels.iter().filter(|v| v.is_finite());
    let (sum, count) = seen.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    let mean: f64 = sum / f64::max(count, 1.0);
    levels.map(|v| if v.is_finite() { v - mean } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Circle;
    use crate::frame::{Frame, Gray};

    /// A disc whose rim lies at a part of 150 px that depends on the direction.
    fn toothed(rim: impl Fn(f64) -> f64) -> bool {
        let (width, height) = (480usize, 400usize);
        let middle = Vector2::new(240.0, 200.0);
        let circle = Circle { center: middle, radius: 150.0 };
        let at = |i: usize| {
            let d = Vector2::new((i % width) as f64, (i / width) as f64) - middle;
            if d.norm() < circle.radius * rim(d.y.atan2(d.x)) { 60 } else { 180 }
        };
        let data = (0..width * height).map(at).collect();
        let look = Look::new(&Frame::Eight(Gray { width, height, data }), 1);
        let (step, coverage, score) = (120.0, 1.0, 10.0);
        is_toothed(
            &look,
            &Candidate { circle, step, coverage, softness_px: 1.0, scatter_px: 0.5, score },
        )
    }

    #[test]
    fn gears_have_teeth_and_ragged_burns_have_none() {
        for teeth in [24.0, 40.0, 72.0] {
            assert!(toothed(|a| if (teeth * a).sin() > 0.0 { 1.03 } else { 0.97 }), "{teeth}");
        }
        assert!(!toothed(|_| 1.0));
        for turn in [0.4, 1.3, 2.2, 3.1, 4.0] {
            let wave = |k: i32, a: f64| (f64::from(k) * a + turn * f64::from(k * k)).sin();
            assert!(!toothed(|a| {
                1.0 + 0.06 * (2..60).map(|k| wave(k, a) / f64::from(k)).sum::<f64>()
            }));
        }
    }
}
