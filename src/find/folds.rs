//! Does what lies within a ring repeat itself all round, as the recess of a screw, a nut, the balls of a bearing or the lines of a target
//! do? A burn does not.

use nalgebra::Vector2;

use crate::find::Candidate;
use crate::find::look::{Look, directions};
use crate::find::waves;

/// Directions, and waves all round that they tell well.
const RAYS: usize = 96;
const WAVES: usize = 24;
/// How often such things repeat. Three gaps may lie evenly about a burn, and two glares on either side.
const FOLDS: std::ops::RangeInclusive<usize> = 4..=12;
/// Radii that are looked at, and over how many the waves are added up, as parts of the ring's.
const WITHIN: std::ops::Range<f64> = 0.1..0.9;
const TOGETHER: f64 = 0.05;
/// What repeats must be so strong (rms of its waves) as a part of the ring's step.
const STRENGTH: f64 = 0.1;
/// And have such a part of the power of all waves but the first, which a light from one side makes: of random ones a quarter repeats, and
/// a burn's gaps, glare and spot have it to six tenths at most.
const SHARE: f64 = 0.7;

/// Whether what lies within a ring repeats itself four to twelve times all round.
pub(crate) fn is_folded(look: &Look, ring: &Candidate) -> bool {
    let radius = ring.circle.radius / look.factor as f64;
    let center = look.reduced(ring.circle.center);
    let around: [Vector2<f64>; RAYS] = directions();
    // Of circles that lie wholly in the picture.
    let powers: Vec<[f64; WAVES + 1]> = ((WITHIN.start * radius).ceil() as usize
        ..(WITHIN.end * radius) as usize)
        .map(|r| waves::levels(look, center, r as f64, &around))
        .filter(|levels| levels.iter().all(|v| v.is_finite()))
        .map(|levels| waves::powers(&levels, &around, 2))
        .collect();
    let together = ((TOGETHER * radius) as usize).max(3);
    powers.windows(together).any(|near| {
        let power = |wave: usize| near.iter().map(|p| p[wave]).sum::<f64>() / together as f64;
        let all: f64 = (2..=WAVES).map(power).sum();
        let repeats = |folds: usize| (folds..=WAVES).step_by(folds).map(power).sum::<f64>();
        all > (STRENGTH * ring.step).powi(2) && FOLDS.into_iter().any(|k| repeats(k) > SHARE * all)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Circle;
    use crate::frame::{Frame, Gray};

    /// A disc of radius 150 about the middle, `level` within it.
    fn folded(level: impl Fn(Vector2<f64>) -> u8) -> bool {
        let (width, height) = (480usize, 400usize);
        let middle = Vector2::new(240.0, 200.0);
        let circle = Circle { center: middle, radius: 150.0 };
        let at = |i: usize| {
            let d = Vector2::new((i % width) as f64, (i / width) as f64) - middle;
            if d.norm() < circle.radius { level(d) } else { 180 }
        };
        let data = (0..width * height).map(at).collect();
        let look = Look::new(&Frame::Eight(Gray { width, height, data }), 1);
        let ring = Candidate {
            circle,
            step: 80.0,
            coverage: 1.0,
            softness_px: 1.0,
            scatter_px: 0.5,
            score: 10.0,
        };
        is_folded(&look, &ring)
    }

    #[test]
    fn recesses_repeat_and_a_burn_with_gaps_and_a_spot_off_its_centre_does_not() {
        let cross = |d: Vector2<f64>| d.x.abs().min(d.y.abs()) < 12.0 && d.norm() < 80.0;
        assert!(folded(|d| if cross(d) { 30 } else { 100 }));
        let hexagon = |d: Vector2<f64>| {
            let turn = (d.y.atan2(d.x) + 0.2).rem_euclid(std::f64::consts::FRAC_PI_3);
            d.norm() * (turn - std::f64::consts::FRAC_PI_6).cos() < 60.0
        };
        assert!(folded(|d| if hexagon(d) { 30 } else { 100 }));
        let balls = |d: Vector2<f64>| {
            let turn = (d.y.atan2(d.x)).rem_euclid(std::f64::consts::TAU / 9.0)
                - std::f64::consts::PI / 9.0;
            (d.norm() * turn).hypot(d.norm() - 110.0) < 16.0
        };
        assert!(folded(|d| if balls(d) { 160 } else { 100 }));
        for off in [0.0, 8.0, 20.0, 50.0] {
            let spot = Vector2::new(off, 0.3 * off);
            assert!(!folded(|d| if (d - spot).norm() < 25.0 { 30 } else { 100 }), "{off}");
        }
        let gap = |d: Vector2<f64>| {
            let turn = d.y.atan2(d.x);
            d.norm() > 60.0 && [0.3, 2.2, -1.9].iter().any(|t| (turn - t).abs() < 0.3)
        };
        assert!(!folded(|d| if gap(d) { 180 } else { 100 }));
    }
}
