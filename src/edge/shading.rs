//! Takes the light's slope out of a band: across a soft edge it would shift the edge towards the darker side.
//!
//! A linear shading multiplies everything by 1 + g·d. The levels well inside and well outside the edge, each on its own,
//! tell g: two means and one slope are fitted to their logarithms. What is left over moves an edge of softness σ
//! by about 2.5 g σ² level / contrast.

use nalgebra::{Matrix4, Vector2, Vector4};

use crate::edge::{Contour, Profiles};
use crate::fit::circle::tukey;
use crate::fit::robust::scatter;

/// A slope under this many of its own standard deviations is not taken out.
const SURE: f64 = 4.0;

/// Scatter of the logarithms of neighbouring sectors' levels below which one side is trusted no more than the other.
const EVEN: f64 = 0.005;

/// One level of one sector: place, side, logarithm and how much that scatters on its side.
struct Level {
    row: Vector4<f64>,
    log: f64,
    sd: f64,
}

/// Divides the slope out of the profiles of a closed contour, if there is one.
pub fn flatten(profiles: &mut Profiles, contour: &Contour, softness_px: f64) {
    if !contour.closed {
        return;
    }
    let mut levels = levels(profiles, contour, 2.5 * softness_px);
    for inside in [true, false] {
        learn_scatter(&mut levels, inside);
    }
    let Some(slope) = slope(&levels) else { return };
    for s in 0..profiles.sectors() {
        for i in profiles.range(s) {
            if profiles.count[i] > 0.0 {
                let at = contour.point(profiles.angle_rad[s], f64::from(profiles.distance_px[i]));
                let light = 1.0 + slope.dot(&(at - contour.origin_px));
                profiles.value[i] /= light.max(0.2) as f32;
            }
        }
    }
}

/// How much one side's levels scatter from sector to sector: near black their logarithms are mostly noise.
fn learn_scatter(levels: &mut [Level], inside: bool) {
    let of_side = |l: &Level| (l.row[0] > 0.0) == inside;
    let logs: Vec<f64> = levels.iter().filter(|l| of_side(l)).map(|l| l.log).collect();
    let mut steps: Vec<f64> = logs.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    if steps.is_empty() {
        return;
    }
    let sd = (scatter(&mut steps) / std::f64::consts::SQRT_2).max(EVEN);
    levels.iter_mut().filter(|l| of_side(l)).for_each(|l| l.sd = sd);
}

/// Mean levels of each sector beyond `clear_px` either side of the contour.
fn levels(profiles: &Profiles, contour: &Contour, clear_px: f64) -> Vec<Level> {
    let mut list = Vec::new();
    for s in 0..profiles.sectors() {
        for side in [-1.0, 1.0] {
            let (mut count, mut sum, mut distance) = (0.0, 0.0, 0.0);
            for i in profiles.range(s) {
                let d = f64::from(profiles.distance_px[i]);
                let n = f64::from(profiles.count[i]);
                if n > 0.0 && d * side > clear_px {
                    count += n;
                    sum += n * f64::from(profiles.value[i]);
                    distance += n * d;
                }
            }
            if count >= 4.0 && sum > 0.0 {
                let at = contour.point(profiles.angle_rad[s], distance / count);
                let place = at - contour.origin_px;
                let inside = f64::from(u8::from(side < 0.0));
                let row = Vector4::new(inside, 1.0 - inside, place.x, place.y);
                list.push(Level { row, log: (sum / count).ln(), sd: EVEN });
            }
        }
    }
    list
}

/// The slope per pixel, where it is sure.
fn slope(levels: &[Level]) -> Option<Vector2<f64>> {
    if levels.len() < 24 {
        return None;
    }
    let mut weights = vec![1.0; levels.len()];
    let mut result = None;
    for _ in 0..6 {
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for (l, w) in levels.iter().zip(&weights) {
            let w = w * (EVEN / l.sd).powi(2);
            normal += l.row * l.row.transpose() * w;
            right += l.row * (w * l.log);
        }
        // One side may be missing altogether.
        normal[(0, 0)] += 1e-6;
        normal[(1, 1)] += 1e-6;
        let inverse = normal.try_inverse()?;
        let fitted = inverse * right;
        let residual = |l: &Level| (l.log - l.row.dot(&fitted)) * (EVEN / l.sd);
        let mut sizes: Vec<f64> = levels.iter().map(|l| residual(l).abs()).collect();
        let sd = scatter(&mut sizes);
        if sd <= 0.0 {
            return None;
        }
        weights = levels.iter().map(|l| tukey(residual(l) / sd)).collect();
        result = Some((Vector2::new(fitted[2], fitted[3]), inverse, sd));
    }
    let (slope, inverse, sd) = result?;
    // Neighbouring sectors share their texture: about as many independent levels as a quarter of them.
    let unsure = 2.0 * sd * (inverse[(2, 2)] + inverse[(3, 3)]).sqrt();
    (slope.norm() > SURE * unsure / std::f64::consts::SQRT_2).then_some(slope)
}
