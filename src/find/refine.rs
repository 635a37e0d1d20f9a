//! From a rough circle to the one through the edges near it, and how strong and soft its edge is.

use nalgebra::Vector2;

use crate::find::look::{Look, directions, value_at, values_along};
use crate::find::rays::{Hint, RAYS};
use crate::find::{Candidate, Options};
use crate::fit::Circle;
use crate::fit::circle;
use crate::frame::Gray;

/// A circle through the edges near a rough one, looked for within the first of `windows` (reduced pixels), less and less until the
/// other.
pub(super) fn refine(
    look: &Look,
    hint: &Hint,
    windows: (f64, f64),
    options: Options,
) -> Option<Candidate> {
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
    let around: [Vector2<f64>; RAYS] = directions();
    let mut crossings = Crossings::new(*blur);
    let mut rough_yet = true;
    for round in 0..6 {
        // Half of the directions will do for a small circle.
        let every = if rough_yet || guess.radius < 0.4 * RAYS as f64 { 2 } else { 1 };
        let rays = (RAYS / every) as f64;
        crossings.look(image, guess, sense, window, around.iter().step_by(every));
        let points = &crossings.points;
        if crossings.visible < 0.12 * rays || points.len() < 8 {
            return None;
        }
        let weights = crossings.weights();
        let fitted = circle::reweighted(points, &weights, guess, 0.35, REWEIGHTED)?;
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
        let coverage = hits / rays;
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

/// The steepest slopes along rays across a circle, in reduced pixels.
struct Crossings {
    /// Where they are, one a ray that has one.
    points: Vec<Vector2<f64>>,
    slopes: Vec<f64>,
    /// Rays that lie in the picture.
    visible: f64,
    /// Step along a ray, and over how many of them slopes are taken.
    step: f64,
    reach: usize,
    profile: Vec<f32>,
    nearness: Vec<f32>,
}

impl Crossings {
    fn new(blur: f64) -> Self {
        // Blurred pictures hold no finer detail; slopes are taken over two pixels or the least there is.
        let step = (0.4 * blur).clamp(0.5, 1.5);
        let reach = (1.0 / step).round().max(1.0) as usize;
        let (points, slopes) = (Vec::new(), Vec::new());
        Self {
            points,
            slopes,
            visible: 0.0,
            step,
            reach,
            profile: Vec::new(),
            nearness: Vec::new(),
        }
    }

    /// Looks for edges of a sense within a window about the circle.
    fn look<'a>(
        &mut self,
        image: &Gray<f32>,
        about: Circle,
        sense: f64,
        window: f64,
        rays: impl Iterator<Item = &'a Vector2<f64>>,
    ) {
        let Self { points, slopes, visible, step, reach, profile, nearness } = self;
        let (step, reach) = (*step, *reach);
        points.clear();
        slopes.clear();
        *visible = 0.0;
        let from = (about.radius - window).max(1.0);
        let steps = ((about.radius + window - from) / step) as usize;
        // Nearer edges are preferred to farther ones of about the same strength.
        nearness.clear();
        nearness.extend((0..=steps).map(|j| {
            let away = (from + step * j as f64 - about.radius) / window;
            (0.5 * sense * (1.0 - 0.5 * away * away)) as f32
        }));
        for along in rays {
            let start = about.center + from * along;
            values_along(image, start, step * along, steps + 1, profile);
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
                *visible += 1.0;
            }
            if best > 0.0 {
                let inner = place > reach && place + reach < steps;
                let between =
                    if inner { crest(slope(place - 1), best, slope(place + 1)) } else { 0.0 };
                let r = from + step * (place as f64 + between);
                points.push(about.center + r * along);
                slopes.push(f64::from(best));
            }
        }
    }

    /// 0 for directions with hardly any slope, which say nothing of the edge; 1 for the others.
    fn weights(&self) -> Vec<f64> {
        let mut sorted = self.slopes.clone();
        let at = sorted.len() * 7 / 10;
        let strong = *sorted.select_nth_unstable_by(at, f64::total_cmp).1;
        self.slopes.iter().map(|s| if *s > 0.25 * strong { 1.0 } else { 0.0 }).collect()
    }
}

/// Where a parabola through three neighbouring values, the middle one the largest, is highest: -0.5 to 0.5.
fn crest(before: f32, top: f32, after: f32) -> f64 {
    let bend = 2.0 * top - before - after;
    if bend > 0.0 { f64::from(0.5 * (after - before) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Step and softness of the median profile across a circle.
fn step_across(image: &Gray<f32>, circle: Circle, sense: f64, blur: f64) -> Option<(f64, f64)> {
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
