//! Rays from a likely centre: at which radii do most directions see an edge of the same sense?

use nalgebra::Vector2;

use crate::find::look::{Look, directions, values_along};
use crate::find::refine::refine;
use crate::find::{Candidate, Options};
use crate::fit::Circle;

/// Directions looked into.
pub(super) const RAYS: usize = 64;
/// Circles taken from one centre and scale.
pub(super) const CIRCLES: usize = 8;

/// Slopes along rays: those of all rays at one radius, then at the next; NaN outside the picture.
pub(super) struct Rays {
    pub(super) slope: Vec<[f32; RAYS]>,
}

/// A circle that rays from a centre suggest, in reduced pixels.
pub(super) struct Hint {
    /// How well the directions agree, 0 to 1.
    pub(super) agreement: f64,
    pub(super) scale: usize,
    pub(super) circle: Circle,
    pub(super) sense: f64,
}

impl Hint {
    /// Of circles on which directions agree about as well, the longer is the less likely by chance.
    pub(super) fn weight(&self) -> f64 {
        self.agreement * self.circle.radius.sqrt()
    }
}

/// What the rays from a centre (reduced pixels) suggest.
pub(super) fn hints(look: &Look, center: Vector2<f64>, options: Options) -> Vec<Hint> {
    let k = look.factor as f64;
    let (near, far) = (options.least_radius_px / k, options.most_radius_px / k);
    let mut list = Vec::new();
    for scale in 0..look.scales.len() {
        let rays = Rays::cast(look, scale, center, far + 4.0);
        for (agreement, radius, sense) in rays.radii(near, far, look.scales[scale].0) {
            list.push(Hint { agreement, scale, circle: Circle { center, radius }, sense });
        }
    }
    list
}

/// The same from a centre that is known, in the sharpest picture.
pub(super) fn hints_about(look: &Look, center: Vector2<f64>, options: Options) -> Vec<Hint> {
    let k = look.factor as f64;
    let (near, far) = (options.least_radius_px / k, options.most_radius_px / k);
    let rays = Rays::cast(look, 0, center, far + 4.0);
    let hint = |(agreement, radius, sense)| {
        let circle = Circle { center, radius };
        Hint { agreement, scale: 0, circle, sense }
    };
    rays.crests(near, far).into_iter().map(hint).collect()
}

/// The circle that a hint leads to; none where it leads nowhere, or to what is well known already.
pub(super) fn follow(
    look: &Look,
    hint: &Hint,
    options: Options,
    known: &[Candidate],
) -> Option<Candidate> {
    let k = look.factor as f64;
    let (center, radius_px) = (look.full(hint.circle.center), hint.circle.radius * k);
    let seen = |c: &Candidate| {
        let near_px = 0.02 * c.circle.radius + 1.5 * k;
        c.step * hint.sense > 0.0
            && c.coverage > 0.8
            && (c.circle.center - center).norm() < near_px
            && (c.circle.radius - radius_px).abs() < near_px
    };
    if known.iter().any(seen) {
        return None;
    }
    let blur = look.scales[hint.scale].0;
    let window = (0.15 * hint.circle.radius).clamp(3.0, 10.0) + blur;
    refine(look, hint, (window, 3.0 + blur), options)
}

/// The circle that a hint from its very centre leads to, clear of others about that centre.
pub(super) fn nearby(look: &Look, hint: &Hint, options: Options) -> Option<Candidate> {
    let window = 1.5 + look.scales[hint.scale].0;
    refine(look, hint, (window, window), options)
}

impl Rays {
    fn cast(look: &Look, scale: usize, center: Vector2<f64>, far: f64) -> Self {
        let image = &look.scales[scale].1;
        let length = far.ceil() as usize + 2;
        let mut slope = vec![[f32::NAN; RAYS]; length + 1];
        let mut values = Vec::with_capacity(length + 2);
        for (i, along) in directions::<RAYS>().into_iter().enumerate() {
            values_along(image, center, along, length + 2, &mut values);
            for (row, around) in slope[1..].iter_mut().zip(values.windows(3)) {
                row[i] = 0.5 * (around[2] - around[0]);
            }
        }
        Self { slope }
    }

    /// How well the directions agree at each radius of a range on an edge, and on its sense; 0 elsewhere.
    fn agreement(&self, range: std::ops::RangeInclusive<usize>) -> Vec<f64> {
        const LANES: usize = 8;
        // Every few of them know what is typical.
        const EVERY: usize = 5;
        let mut sizes: Vec<f32> = (self.slope.as_flattened().iter().step_by(EVERY))
            .filter(|v| v.is_finite())
            .map(|v| v.abs())
            .collect();
        if sizes.len() < RAYS / EVERY {
            return vec![0.0; self.slope.len()];
        }
        // Typical slope anywhere on the rays: what an edge is measured against.
        let middle = sizes.len() / 2;
        let typical = *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
        // On a clean picture nearly all slopes are tiny: then a part of the strongest ones is the measure.
        let high = sizes.len() * 98 / 100;
        let strong = *sizes.select_nth_unstable_by(high, f32::total_cmp).1;
        let unit = 1.0 / (4.0 * typical).max(0.05 * strong).max(1e-6);
        let whole = 1.0 / strong.max(1e-6);
        let last = self.slope.len() - 1;
        (0..=last)
            .map(|r| {
                if !range.contains(&r) {
                    return 0.0;
                }
                // The edge may be a little nearer or farther in this direction.
                let mut best = [f32::NAN; RAYS];
                for slopes in &self.slope[r.saturating_sub(2)..=(r + 2).min(last)] {
                    for (best, v) in best.iter_mut().zip(slopes) {
                        let weaker = v.abs() <= best.abs() || v.is_nan();
                        *best = if weaker { *best } else { *v };
                    }
                }
                // Side by side, as the processor adds several at once.
                let (mut sums, mut sizes, mut counts) =
                    ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
                for lanes in best.as_chunks::<LANES>().0 {
                    for i in 0..LANES {
                        let (v, count) =
                            if lanes[i].is_nan() { (0.0, 0.0) } else { (lanes[i], 1.0) };
                        counts[i] += count;
                        sums[i] += (v * unit).clamp(-1.0, 1.0);
                        sizes[i] += (v * whole).clamp(-1.0, 1.0);
                    }
                }
                let total = |lanes: [f32; LANES]| lanes.iter().sum::<f32>();
                let (sum, size, n) = (total(sums), total(sizes), total(counts));
                // Where all directions agree over several radii, the steepest one is the edge.
                if n >= 0.15 * RAYS as f32 {
                    f64::from((sum + 0.05 * size) / n * (n / RAYS as f32).sqrt())
                } else {
                    0.0
                }
            })
            .collect()
    }

    /// Agreements, radii and senses at which edges agree over the directions.
    fn radii(&self, near: f64, far: f64, blur: f64) -> Vec<(f64, f64, f64)> {
        let (first, last) = (0.8 * near, 1.1 * far);
        let agree = self.agreement((first as usize).saturating_sub(1)..=last as usize + 2);
        let mut list: Vec<(f64, f64, f64)> = Vec::new();
        for r in 1..agree.len() - 1 {
            let v = agree[r].abs();
            let inside = (first..=last).contains(&(r as f64));
            if inside && v > 0.12 && v >= agree[r - 1].abs() && v > agree[r + 1].abs() {
                list.push((v, r as f64, agree[r].signum()));
            }
        }
        list.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept: Vec<(f64, f64, f64)> = Vec::new();
        for (v, r, s) in list {
            if kept.len() < CIRCLES
                && kept.iter().all(|(_, q, t)| (q - r).abs() > 2.0 + blur || t != &s)
            {
                kept.push((v, r, s));
            }
        }
        kept
    }
}
