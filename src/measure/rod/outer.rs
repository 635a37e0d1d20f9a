//! Is there another edge outside the one that was found? A chamfer's inner edge is often the stronger one.

use crate::camera::View;
use crate::edge::{Band, Contour, Profiles, scan_frame};
use crate::frame::Frame;
use crate::measure::rod::joint::{Arc, Joint};

/// How far outside an edge is looked for: wider than any chamfer.
const REACH_MM: f64 = 1.2;
/// Width of a bin of distance.
const BIN_PX: f64 = 2.0;
/// Sectors along each arc.
const SECTORS: usize = 32;
/// A capture sees an edge where its sectors agree to this many standard errors.
const CLEAR: f64 = 5.0;

/// Radius of the outermost further edge on which at least half of the captures agree.
pub(super) fn edge(arcs: &[Arc], frames: &[(Frame, View)], fitted: &Joint) -> Option<f64> {
    let pixel = frames.iter().map(|(_, v)| v.pixel_mm()).sum::<f64>() / frames.len() as f64;
    let soft = arcs.iter().map(|a| a.points.located.step.softness_px).fold(0.0, f64::max).min(8.0);
    let clear_of_px = 3.0 * soft + 6.0;
    let reach_px = (REACH_MM / pixel).min(500.0);
    let step = ((1.5 * soft / BIN_PX) as usize).max(2);
    let each: Vec<Vec<f64>> = arcs
        .iter()
        .filter_map(|arc| {
            let (frame, view) = &frames[arc.capture];
            let center = fitted.centers[arc.angle] - arc.position_mm;
            let contour = Contour::of_circle(view, center, fitted.radius)?;
            let band =
                Band { inside_px: 0.0, outside_px: reach_px, bin_px: BIN_PX, sectors: SECTORS };
            Some(agreement(&scan_frame(frame, &contour, band), step))
        })
        .collect();
    let bins = each.iter().map(Vec::len).min()?;
    let first = (clear_of_px / BIN_PX) as usize + step;
    let votes = |b: usize| each.iter().filter(|z| z[b].abs() > CLEAR).count();
    let total = |b: usize| each.iter().map(|z| z[b].abs().min(3.0 * CLEAR)).sum::<f64>();
    let needed = each.len().div_ceil(2).max(2.min(each.len()));
    // Local maxima on which enough captures agree (an edge may fall between two bins).
    (first..bins.saturating_sub(1))
        .filter(|&b| {
            total(b) >= total(b - 1)
                && total(b) > total(b + 1)
                && (b - 1..=b + 1).map(votes).max() >= Some(needed)
        })
        .max()
        .map(|b| fitted.radius + (b as f64 + 0.5) * BIN_PX * pixel)
}

/// For every bin: mean step across it over the sectors, in standard errors of that mean.
fn agreement(profiles: &Profiles, step: usize) -> Vec<f64> {
    let bins = profiles.bins;
    (0..bins)
        .map(|b| {
            if b < step || b + step >= bins {
                return 0.0;
            }
            let mut steps: Vec<f64> = (0..profiles.sectors())
                .filter_map(|s| {
                    let at = s * bins;
                    let side = |range: std::ops::Range<usize>| {
                        let (mut n, mut sum) = (0.0, 0.0);
                        for i in range {
                            n += profiles.count[at + i];
                            sum += profiles.count[at + i] * profiles.value[at + i];
                        }
                        (n > 0.0).then(|| f64::from(sum / n))
                    };
                    Some(side(b + 1..b + 1 + step)? - side(b - step..b)?)
                })
                .collect();
            if steps.len() < 8 {
                return 0.0;
            }
            // A robust mean: glare and dirt in a few sectors must not speak for all of them.
            steps.sort_by(f64::total_cmp);
            let cut = steps.len() / 8;
            let kept = &steps[cut..steps.len() - cut];
            let n = kept.len() as f64;
            let mean = kept.iter().sum::<f64>() / n;
            let variance = kept.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
            mean / (2.0 * variance / n).sqrt().max(0.05)
        })
        .collect()
}
