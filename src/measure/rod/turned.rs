//! Turning lines end at the rim and go round with it: no residual shows them. What all captures share inside the rim tells how high they are.

use super::finish::mean;
use super::joint::Arc;
use crate::measure::points::Points;

/// Softnesses inside the rim's middle where its edge has ended.
const ENDED: f64 = 3.5;
/// Places inside the rim at which captures are held beside each other.
const PLACES: usize = 64;

/// How far turning lines may have moved the rim all round (standard deviation). As high as the others inside it, one that ends half covered moves
/// what the pixels have there by half its height, and one where the edge has risen the middle between the levels by as much again: both over
/// a blurred step's slope.
pub(super) fn turned_mm(arcs: &[Arc]) -> f64 {
    let all: Vec<&Points> = arcs.iter().map(|a| &a.points).collect();
    let softness_mm = |p: &Points| p.located.step.softness_px * p.pixel_mm;
    let near_mm = ENDED * all.iter().map(|p| softness_mm(p)).fold(0.0, f64::max);
    let far_mm = all.iter().map(|p| reach_mm(p)).fold(0.0, f64::max);
    let place_mm = |k: usize| near_mm + (far_mm - near_mm) * k as f64 / PLACES as f64;
    let lines: Vec<Vec<f64>> = all.iter().map(|p| lines(p, &place_mm)).collect();
    // What two captures have in common is no chance: the mean of their products, over all pairs.
    let (mut shared, mut pairs) = (0.0, 0.0);
    for k in 0..PLACES {
        let here: Vec<f64> = lines.iter().filter_map(|l| l.get(k)).copied().collect();
        let (sum, squares) = here.iter().fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
        shared += sum * sum - squares;
        pairs += (here.len() * here.len().saturating_sub(1)) as f64;
    }
    let height = (shared / pairs.max(1.0)).max(0.0).sqrt();
    std::f64::consts::PI.sqrt() * height * mean(arcs, softness_mm)
}

/// How far inside its rim a capture was looked at.
fn reach_mm(points: &Points) -> f64 {
    let located = &points.located;
    (located.step.distance_px - located.template.start_px) * points.pixel_mm
}

/// How far the common profile inside the rim lies off the rim's inner level, as parts of the step, as far as it reaches.
fn lines(points: &Points, place_mm: &impl Fn(usize) -> f64) -> Vec<f64> {
    let (step, template) = (&points.located.step, &points.located.template);
    let reach_mm = reach_mm(points);
    let at = |inside_mm: f64| {
        let px = step.distance_px - inside_mm / points.pixel_mm - template.start_px;
        let (i, part) = ((px / template.step_px) as usize, (px / template.step_px).fract());
        let value = |i: usize| template.values[i.min(template.values.len() - 1)];
        let level = value(i) + part * (value(i + 1) - value(i));
        (level - step.inner) / step.contrast().abs().max(1e-300)
    };
    (0..PLACES).map(place_mm).take_while(|mm| *mm < reach_mm).map(at).collect()
}
