//! What a clipped bright side hides of an edge: its flank goes on, behind the clip, to a level of its own in every direction.
//!
//! The middle between the dark level and the clip lies lower on the flank where the light is stronger or the edge softer, so that a
//! picture lit from one side has its edges shifted towards the light, discs one way and holes the other. What
//! is clipped is no level: such bins are left out, and each sector's gain and stretch come from its flank alone. The common
//! profile goes on as the mirror image of its dark half about its steepest place, which the clip does not move. Where
//! the steepest place is itself too near the clip to be sure of, the clip is taken for the level, as it seems.

use crate::edge::scan::BACKGROUND;
use crate::edge::{Profiles, Template};

/// Bins brighter than this part of the clip may have lost light: their pixels are noisy, and no points.
const CUT: f32 = 0.96;
/// Share of the sectors that must know a node of the first guess: where fewer do they are the darker ones, or lie farther out.
const KNOWN: f64 = 0.5;
/// The slope must have fallen to this part of its peak before the flank is hidden, or nobody knows where the peak is.
const FALLEN: f64 = 0.95;

/// The side of a contour that is clipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Towards the contour's middle.
    Inside,
    /// Away from it.
    Outside,
}

/// The profiles without all that lies beyond each sector's flank on the clipped side. `None` where not just one side is clipped
/// nearly all round.
pub fn hide(profiles: &Profiles) -> Option<Profiles> {
    let top = profiles.clip()?;
    let clipped = |side: Side| {
        let last = |s: usize| {
            let seen = |i: &usize| profiles.count[*i] > 0.0;
            match side {
                Side::Inside => profiles.range(s).find(seen),
                Side::Outside => profiles.range(s).rev().find(seen),
            }
        };
        let lasts: Vec<usize> = (0..profiles.sectors()).filter_map(last).collect();
        let lost = lasts.iter().filter(|&&i| profiles.value[i] >= top * (1.0 - 1e-3)).count();
        lost as f64 >= BACKGROUND * lasts.len().max(1) as f64
    };
    let side = match (clipped(Side::Inside), clipped(Side::Outside)) {
        (true, false) => Side::Inside,
        (false, true) => Side::Outside,
        _ => return None,
    };
    let mut hidden = Profiles { hidden: Some(side), ..profiles.clone() };
    for s in 0..profiles.sectors() {
        let range = profiles.range(s);
        let bright = |i: &usize| profiles.count[*i] > 0.0 && profiles.value[*i] >= CUT * top;
        // From the dark end, so that nothing of a flank is left behind a bright speck.
        let lost = match side {
            Side::Inside => range.clone().rev().find(bright).map(|i| range.start..i + 1),
            Side::Outside => range.clone().find(bright).map(|i| i..range.end),
        };
        hidden.count[lost.unwrap_or(0..0)].fill(0.0);
    }
    Some(hidden)
}

/// Whether so many of the sectors make a node of the first guess known.
pub(super) fn is_known(seen: f64, alive: f64) -> bool {
    seen >= KNOWN * alive
}

impl Template {
    /// Goes on beyond the known nodes as the mirror image of the other side of its steepest place. `None` where that
    /// is not surely known.
    pub(super) fn mirror(&mut self, known: &[bool], side: Side) -> Option<()> {
        let n = self.values.len();
        // As if the outside were hidden.
        let turned = |i: usize| if side == Side::Outside { i } else { n - 1 - i };
        let last = (0..n).rev().find(|&i| known[turned(i)])?;
        let old: Vec<f64> = (0..n).map(|i| self.values[turned(i)]).collect();
        let mut smooth = Template { values: old[..=last].to_vec(), ..self.clone() };
        smooth.denoise();
        let v = &smooth.values;
        let slope: Vec<f64> = (1..last).map(|i| 0.5 * (v[i + 1] - v[i - 1])).collect();
        let (peak, most) = slope.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        if most <= 0.0 || slope[slope.len() - 1] > FALLEN * most {
            return None;
        }
        // A parabola through all slopes near the peak: as wide as they reach on the flank's hidden side.
        let reach = (slope.len() - 1 - peak).max(2);
        let wide =
            slope.iter().rev().skip(slope.len() - peak).take_while(|s| **s > 0.75 * most).count();
        let reach = reach.min(wide.max(2));
        let from = peak.checked_sub(reach)?;
        let middle = peak as f64 + vertex(slope.get(from..=peak + reach)?)? + 1.0;
        let at = |x: f64| {
            let x = x.max(0.0);
            let i = (x as usize).min(last.saturating_sub(1));
            let f = (x - i as f64).min(1.0);
            old[i] + f * (old[i + 1] - old[i])
        };
        let image = |i: usize| -at(2.0 * middle - i as f64);
        let join = old[last] - image(last);
        for i in last + 1..n {
            self.values[turned(i)] = image(i) + join;
        }
        Some(())
    }
}

/// The top of the parabola through an odd number of values, from their middle.
fn vertex(values: &[f64]) -> Option<f64> {
    let half = (values.len() / 2) as f64;
    let (mut x2, mut x4, mut y, mut xy, mut x2y) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (i, v) in values.iter().enumerate() {
        let x = i as f64 - half;
        (x2, x4, y, xy, x2y) = (x2 + x * x, x4 + x.powi(4), y + v, xy + x * v, x2y + x * x * v);
    }
    let n = values.len() as f64;
    let curve = (n * x2y - x2 * y) / (n * x4 - x2 * x2);
    let top = -0.5 * xy / x2 / curve;
    (curve < 0.0 && top.abs() <= half).then_some(top)
}
