//! Edges beside a rim: a fainter one farther out that may be the rod's, a stronger one inside that may be its chamfer's.

use nalgebra::Vector2;

use super::outer::{CHAMFER_MM, Captures, FAINTER, Search, peaks};
use super::sight::Sight;
use crate::fit::Circle;

/// Radii of the fainter edge outside a circle that was measured and of the stronger one inside: about each table angle's own centre, where
/// the rim of a rod far off the axis is one edge at all of them.
pub(super) fn beside(seen: Captures, centers: &[Vector2<f64>], radius_mm: f64) -> [Option<f64>; 2] {
    let bin_mm = seen.bin_mm();
    let center = centers.iter().sum::<Vector2<f64>>() / centers.len().max(1) as f64;
    let sights = seen.sights(Circle { center, radius: radius_mm }, bin_mm);
    let Some(first) = sights.first() else { return [None; 2] };
    let (here, inside_mm) = ((first.inside_mm / bin_mm) as usize, first.inside_mm);
    let all = Search { bin_mm, sights: sights.iter().collect() };
    let own = |sight: &Sight| centers[sight.angle] - center;
    let support = all.support(own, true);
    let least = FAINTER * support.iter().copied().fold(0.0, f32::max);
    let gap = (CHAMFER_MM / bin_mm).ceil() as usize;
    let fainter = peaks(&support, least).into_iter().rfind(|&b| b >= here + gap);
    let edges = [all.common_step(own, here).or(fainter), all.stronger_inside(own, here, gap)];
    edges.map(|edge| edge.map(|b| radius_mm + (b as f64 + 0.5) * bin_mm - inside_mm))
}

impl Search<'_> {
    /// A step outside the bin `outer` that most captures have, however faint each: a table's texture has its own in each.
    pub(super) fn common_step(
        &self,
        shift: impl Fn(&Sight) -> Vector2<f64>,
        outer: usize,
    ) -> Option<usize> {
        /// Step in standard errors, and as a multiple of the next one's.
        const LEAST: f32 = 1.5;
        const OTHERS: f32 = 2.2;
        const CAPTURES: usize = 3;
        if self.sights.len() < CAPTURES {
            return None;
        }
        let gap = (CHAMFER_MM / self.bin_mm).ceil() as usize;
        let clear = gap + gap / 2;
        let mut each = vec![vec![0.0f32; self.sights.first()?.bins]; self.sights.len()];
        for (sight, own) in self.sights.iter().zip(&mut each) {
            sight.evidence(shift(sight), true, self.bin_mm, own);
        }
        let usual: Vec<f32> = (outer + gap / 2..each[0].len())
            .map(|b| median(each.iter().map(|own| own[b]).collect()))
            .collect();
        // Shadows and vignetting slope slowly.
        let step = |i: usize| {
            let near = &usual[i.saturating_sub(clear)..(i + clear + 1).min(usual.len())];
            (usual[i] - median(near.to_vec())).abs()
        };
        let steps: Vec<f32> = (0..usual.len()).map(step).collect();
        let most = |list: &mut dyn Iterator<Item = usize>| {
            list.max_by(|&a, &b| steps[a].total_cmp(&steps[b]))
        };
        let best = most(&mut (clear..steps.len()))?;
        let next = most(&mut (clear / 2..steps.len()).filter(|i| i.abs_diff(best) > gap))?;
        (steps[best] > LEAST && steps[best] > OTHERS * steps[next])
            .then_some(outer + gap / 2 + best)
    }

    /// The strongest edge that lies `gap` bins and more inside one, where that one is faint beside it.
    pub(super) fn stronger_inside(
        &self,
        shift: impl Fn(&Sight) -> Vector2<f64>,
        outer: usize,
        gap: usize,
    ) -> Option<usize> {
        /// How many times as strong.
        const STRONGER: f32 = 3.0;
        let mut each = vec![vec![0.0f32; self.sights.first()?.bins]; self.sights.len()];
        for (sight, own) in self.sights.iter().zip(&mut each) {
            sight.step(shift(sight), self.bin_mm, own);
        }
        let step = |b: usize| median(each.iter().map(|own| own[b].abs()).collect());
        let inside = 0..outer.checked_sub(gap)?;
        let (strongest, most) = inside.map(|b| (b, step(b))).max_by(|a, b| a.1.total_cmp(&b.1))?;
        let own = (outer - 1..=outer + 1).map(step).fold(0.0, f32::max);
        (most > STRONGER * own).then_some(strongest)
    }
}

/// Median, between the two middle ones of an even number: of few captures the upper one would lean.
fn median(mut list: Vec<f32>) -> f32 {
    list.sort_by(f32::total_cmp);
    0.5 * (list[list.len() / 2] + list[(list.len() - 1) / 2])
}
