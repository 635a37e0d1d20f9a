//! Which edge is the rod? A chamfer's inner edge is often the stronger one, and on one side of the light the only
//! strong one: a circle through the rim on one side and the chamfer on the other looks nearly as good.
//!
//! Every capture lists its edges near the circle that was found; circles through the lists of any three captures
//! are tried, and the outermost that nearly as many captures support as any is the rod.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::View;
use crate::edge::{Band, Contour, Profiles, scan_frame};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::rod::Capture;
use crate::measure::rod::joint::Joint;

/// How far outside and inside edges are looked for: wider than any chamfer.
const OUTSIDE_MM: f64 = 1.2;
const INSIDE_MM: f64 = 0.7;
/// Width of a bin of distance.
const BIN_PX: f64 = 2.0;
/// Sectors along each arc.
const SECTORS: usize = 32;
/// A capture sees an edge where its sectors agree to this many standard errors.
const CLEAR: f64 = 4.5;
/// Most edges a capture may list.
const LISTED: usize = 6;

/// The edges of one capture.
struct Sight {
    /// Direction of the arc's middle from the centre.
    toward: Vector2<f64>,
    /// Distance from the circle and how clearly it is seen.
    edges: Vec<(f64, f64)>,
}

/// The rod's circle (centre shift and radius) near the one that was found, with the edge next inside it.
pub(super) fn rim(
    captures: &[Capture],
    angle_of: &[usize],
    frames: &[(Frame, View)],
    fitted: &Joint,
) -> Option<(Vector2<f64>, f64, Option<f64>)> {
    let pixel = frames.iter().map(|(_, v)| v.pixel_mm()).sum::<f64>() / frames.len() as f64;
    let sights: Vec<Sight> = captures
        .iter()
        .zip(angle_of)
        .zip(frames)
        .filter_map(|((c, &a), (frame, view))| {
            let about = Circle { center: fitted.centers[a] - c.position_mm, radius: fitted.radius };
            sight(frame, view, about, pixel)
        })
        .collect();
    let tolerance = 5.0 * pixel;
    let mut found: Vec<(f64, Vector2<f64>, f64)> = Vec::new();
    for h in hypotheses(&sights) {
        let (shift, grown) = (Vector2::new(h.x, h.y), h.z);
        if shift.norm() > 0.5 || !(-INSIDE_MM..=OUTSIDE_MM).contains(&grown) {
            continue;
        }
        let support: f64 = sights
            .iter()
            .map(|s| {
                let expected = s.toward.dot(&shift) + grown;
                let near = s.edges.iter().filter(|e| (e.0 - expected).abs() < tolerance);
                near.map(|e| (e.1 / 12.0).min(1.0)).fold(0.0, f64::max)
            })
            .sum();
        found.push((support, shift, grown));
    }
    let most = found.iter().map(|f| f.0).fold(0.0, f64::max);
    if most < 0.5 * sights.len() as f64 {
        return None;
    }
    let good: Vec<_> = found.iter().filter(|f| f.0 >= 0.65 * most).collect();
    // Of the well-supported circles, those about the best-supported one's centre; the outermost is the rod.
    let best = good.iter().max_by(|a, b| (a.0 + 0.02 * a.2).total_cmp(&(b.0 + 0.02 * b.2)))?;
    let outer = good
        .iter()
        .filter(|f| (f.1 - best.1).norm() < 2.0 * tolerance)
        .max_by(|a, b| a.2.total_cmp(&b.2))?;
    let inner = good
        .iter()
        .filter(|f| (f.1 - outer.1).norm() < 2.0 * tolerance && f.2 < outer.2 - 4.0 * tolerance)
        .max_by(|a, b| a.2.total_cmp(&b.2))
        .map(|f| fitted.radius + f.2);
    Some((outer.1, fitted.radius + outer.2, inner))
}

/// Shifts and growths that bring the circle through listed edges of three captures in different directions.
fn hypotheses(sights: &[Sight]) -> Vec<Vector3<f64>> {
    let mut list = Vec::new();
    if sights.len() < 3 {
        for s in sights {
            list.extend(s.edges.iter().map(|e| Vector3::new(0.0, 0.0, e.0)));
        }
        return list;
    }
    for i in 0..sights.len() {
        for j in i + 1..sights.len() {
            for k in j + 1..sights.len() {
                let three = [&sights[i], &sights[j], &sights[k]];
                let m = Matrix3::from_fn(|r, c| match c {
                    0 => three[r].toward.x,
                    1 => three[r].toward.y,
                    _ => 1.0,
                });
                if m.determinant().abs() < 0.4 {
                    continue;
                }
                let Some(inverse) = m.try_inverse() else { continue };
                for a in &three[0].edges {
                    for b in &three[1].edges {
                        for c in &three[2].edges {
                            list.push(inverse * Vector3::new(a.0, b.0, c.0));
                        }
                    }
                }
            }
        }
    }
    list
}

fn sight(frame: &Frame, view: &View, about: Circle, pixel: f64) -> Option<Sight> {
    let contour = Contour::of_circle(view, about.center, about.radius)?;
    let inside = (INSIDE_MM / pixel).min(300.0);
    let band = Band {
        inside_px: inside,
        outside_px: (OUTSIDE_MM / pixel).min(500.0),
        bin_px: BIN_PX,
        sectors: SECTORS,
    };
    let z = agreement(&scan_frame(frame, &contour, band), 3);
    let mut edges: Vec<(f64, f64)> = (1..z.len().saturating_sub(1))
        .filter(|&b| {
            z[b].abs() > CLEAR && z[b].abs() >= z[b - 1].abs() && z[b].abs() > z[b + 1].abs()
        })
        .map(|b| (((b as f64 + 0.5) * BIN_PX - inside) * pixel, z[b].abs()))
        .collect();
    edges.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for e in edges {
        if kept.len() < LISTED && kept.iter().all(|k| (k.0 - e.0).abs() > 8.0 * pixel) {
            kept.push(e);
        }
    }
    let middle = contour.point(contour.start_rad + 0.5 * contour.span_rad, 0.0);
    let toward = (view.to_plane(middle) - about.center).normalize();
    (!kept.is_empty()).then_some(Sight { toward, edges: kept })
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
