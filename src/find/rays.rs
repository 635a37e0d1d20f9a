//! Rays from a likely centre: at which radii do most directions see an edge of the same sense?

use nalgebra::Vector2;

use crate::find::look::{Look, directions, value_at, values_along};
use crate::find::{Candidate, Options};
use crate::fit::Circle;
use crate::fit::circle;

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
    scale: usize,
    circle: Circle,
    sense: f64,
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

/// A circle through the edges near a rough one, looked for within the first of `windows` (reduced pixels), less and less until the
/// other.
fn refine(look: &Look, hint: &Hint, windows: (f64, f64), options: Options) -> Option<Candidate> {
    /// A circle that shows so little of the coverage it needs, as a part, will not come to it.
    const HOPELESS: f64 = 0.6;
    /// How often points are weighed anew before they are looked for anew.
    const REWEIGHTED: usize = 3;
    /// Where a circle still moves by more, half of the directions tell where to; in reduced pixels.
    const ROUGH: f64 = 0.5;
    let Hint { circle: rough, sense, .. } = *hint;
    let (blur, image) = (&look.scales[hint.scale].0, &look.scales[hint.scale].1);
    let k = look.factor as f64;
    let mut guess = rough;
    let mut window = windows.0;
    let mut result = None;
    let (mut points, mut slopes, mut profile) = (Vec::new(), Vec::new(), Vec::<f32>::new());
    let mut nearness: Vec<f32> = Vec::new();
    let around: [Vector2<f64>; RAYS] = directions();
    // Blurred pictures hold no finer detail; slopes are taken over two pixels or the least there is.
    let step = (0.4 * blur).clamp(0.5, 1.5);
    let reach = (1.0 / step).round().max(1.0) as usize;
    let mut rough_yet = true;
    for round in 0..6 {
        points.clear();
        slopes.clear();
        let mut visible = 0.0;
        // Half of the directions will do for a small circle.
        let every = if rough_yet || guess.radius < 0.4 * RAYS as f64 { 2 } else { 1 };
        let rays = RAYS / every;
        let from = (guess.radius - window).max(1.0);
        let steps = ((guess.radius + window - from) / step) as usize;
        // Nearer edges are preferred to farther ones of about the same strength.
        nearness.clear();
        nearness.extend((0..=steps).map(|j| {
            let away = (from + step * j as f64 - guess.radius) / window;
            (0.5 * sense * (1.0 - 0.5 * away * away)) as f32
        }));
        for along in around.iter().step_by(every) {
            let start = guess.center + from * along;
            values_along(image, start, step * along, steps + 1, &mut profile);
            let slope = |j: usize| nearness[j] * (profile[j + reach] - profile[j - reach]);
            let (mut best, mut place) = (0.0f32, 0);
            let mut seen = false;
            for j in reach..(steps + 1).saturating_sub(reach) {
                let v = slope(j);
                seen |= !v.is_nan();
                if v > best {
                    (best, place) = (v, j);
                }
            }
            if seen {
                visible += 1.0;
            }
            if best > 0.0 {
                let inner = place > reach && place + reach < steps;
                let between =
                    if inner { crest(slope(place - 1), best, slope(place + 1)) } else { 0.0 };
                let r = from + step * (place as f64 + between);
                points.push(guess.center + r * along);
                slopes.push(f64::from(best));
            }
        }
        if visible < 0.12 * rays as f64 || points.len() < 8 {
            return None;
        }
        // Directions with hardly any slope say nothing of the edge.
        let mut sorted = slopes.clone();
        let at = sorted.len() * 7 / 10;
        let strong = *sorted.select_nth_unstable_by(at, f64::total_cmp).1;
        let weights: Vec<f64> =
            slopes.iter().map(|s| if *s > 0.25 * strong { 1.0 } else { 0.0 }).collect();
        let fitted = circle::reweighted(&points, &weights, guess, 0.35, REWEIGHTED)?;
        let r = fitted.circle.radius;
        if (r - rough.radius).abs() > 0.3 * rough.radius + 4.0
            || (fitted.circle.center - rough.center).norm() > 0.4 * rough.radius + 6.0
        {
            return None;
        }
        let moved = fitted.circle.apart(&guess);
        guess = fitted.circle;
        let close = 2.5 * fitted.scale.max(0.4) + 0.5;
        let hits = points
            .iter()
            .zip(&weights)
            .filter(|(p, w)| **w > 0.0 && guess.distance(**p).abs() < close.min(2.5 + blur))
            .count() as f64;
        let coverage = hits / rays as f64;
        if round > 0 && coverage < HOPELESS * options.least_coverage {
            return None;
        }
        result = Some((coverage, fitted.scale));
        window = (window * 0.7).max(windows.1);
        if moved < 0.05 && !rough_yet {
            break;
        }
        rough_yet &= moved > ROUGH && round < 3;
    }
    let (coverage, scale_px) = result?;
    let radius_px = guess.radius * k;
    if coverage < options.least_coverage
        || radius_px < options.least_radius_px
        || radius_px > options.most_radius_px
    {
        return None;
    }
    let (step, softness) = step_across(image, guess, sense, *blur)?;
    let noise = (look.noise / blur).max(1e-3);
    Some(Candidate {
        circle: Circle { center: look.full(guess.center), radius: radius_px },
        step: step * sense,
        coverage,
        softness_px: softness * k,
        scatter_px: scale_px * k,
        score: coverage.powi(2) * (step / noise).clamp(0.0, 400.0).sqrt()
            / (1.0 + 0.3 * scale_px / blur),
    })
}

/// Where a parabola through three neighbouring values, the middle one the largest, is highest: -0.5 to 0.5.
fn crest(before: f32, top: f32, after: f32) -> f64 {
    let bend = 2.0 * top - before - after;
    if bend > 0.0 { f64::from(0.5 * (after - before) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Step and softness of the median profile across a circle.
fn step_across(
    image: &crate::frame::Gray<f32>,
    circle: Circle,
    sense: f64,
    blur: f64,
) -> Option<(f64, f64)> {
    let reach = (4.0 * blur).max(6.0).min(0.9 * circle.radius);
    let around: [Vector2<f64>; RAYS] = directions();
    let mut profile: Vec<f64> = Vec::new();
    let count = (2.0 * reach) as usize;
    for j in 0..=count {
        let r = circle.radius - reach + j as f64;
        let at = |along: &Vector2<f64>| circle.center + r * along;
        let values = around.iter().map(|along| value_at(image, at(along).x, at(along).y));
        let mut values: Vec<f32> = values.filter(|v| !v.is_nan()).collect();
        if values.is_empty() {
            return None;
        }
        let middle = values.len() / 2;
        profile.push(f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1) * sense);
    }
    let n = profile.len();
    let middle = n / 2;
    let slope = |i: usize| profile[i + 1] - profile[i];
    let peak = (middle.saturating_sub(3)..(middle + 3).min(n - 1))
        .max_by(|&a, &b| slope(a).total_cmp(&slope(b)))?;
    let top = slope(peak);
    if top <= 0.0 {
        return None;
    }
    let (mut lo, mut hi) = (peak, peak);
    while lo > 0 && slope(lo - 1) > 0.1 * top {
        lo -= 1;
    }
    while hi + 2 < n && slope(hi + 1) > 0.1 * top {
        hi += 1;
    }
    let step = profile[hi + 1] - profile[lo];
    let soft = step / (top * (2.0 * std::f64::consts::PI).sqrt());
    // The blur of the reduced picture is not the edge's own.
    Some((step, (soft * soft - blur * blur).max(0.04).sqrt()))
}
