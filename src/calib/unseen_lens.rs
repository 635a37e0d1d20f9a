//! How far off the mapping may be where no lens file says how the lens distorts: what the positions show of it, and what they
//! leave open.

use nalgebra::Vector2;

use crate::calib::homography::{Fit, map, solve};
use crate::camera::{Lens, View};
use crate::uncertainty::k95;

/// Radial distortion before anything is known (standard deviation; `r` in lengths of the frame's longer side): 1.5 % at the corner.
const BEFOREHAND: f64 = 0.04;
/// Rounds of the parabola through three fits; each is narrower by this.
const ROUNDS: usize = 3;
const NARROWER: f64 = 0.2;

/// A lens without distortion for a camera of which only the frame's size is known. Its focal length is a mere unit.
pub(super) fn ideal(width: usize, height: usize) -> Lens {
    let focal = width.max(height) as f64;
    Lens {
        width_px: width as u32,
        height_px: height as u32,
        fx_px: focal,
        fy_px: focal,
        cx_px: (width as f64 - 1.0) / 2.0,
        cy_px: (height as f64 - 1.0) / 2.0,
        distortion: [0.0; 5],
    }
}

/// What an unknown distortion does to the corners.
pub(super) struct UnseenLens {
    /// The largest error of a corner that the positions show, mm.
    pub(super) seen_mm: f64,
    /// Half-width of the 95 % interval of that, mm.
    pub(super) u95_mm: f64,
}

/// Tries radial distortion in the sightings' fit. `seen` are the mark's places in the picture and the machine's positions. `None`
/// where there are too few of them.
pub(super) fn unseen_lens(
    lens: &Lens,
    seen: &[(Vector2<f64>, Vector2<f64>)],
    straight: &Fit,
) -> Option<UnseenLens> {
    let bent = |k1: f64| {
        let lens = Lens { distortion: [k1, 0.0, 0.0, 0.0, 0.0], ..lens.clone() };
        let view = lens.normalised();
        let all: Vec<usize> = (0..seen.len()).collect();
        let fit = solve(&all, &|i| (view.to_plane(seen[i].0), seen[i].1)).ok()?;
        Some((view, fit))
    };
    let chi2 = |k1: f64| bent(k1).map(|(_, fit)| fit.variance * fit.dof);
    let (mut at, mut step, mut curvature) = (0.0, BEFOREHAND, 0.0);
    for _ in 0..ROUNDS {
        let (low, mid, high) = (chi2(at - step)?, chi2(at)?, chi2(at + step)?);
        curvature = (low - 2.0 * mid + high) / (2.0 * step * step);
        if curvature <= 0.0 {
            return None;
        }
        at += ((low - high) / (4.0 * curvature * step)).clamp(-step, step);
        step *= NARROWER;
    }
    let dof = straight.dof - 1.0;
    if dof < 1.0 {
        return None;
    }
    let variance = chi2(at)? / dof / curvature;
    let sure = BEFOREHAND.powi(2) / (BEFOREHAND.powi(2) + variance);
    let (k1, sd) = (sure * at, (sure * variance).sqrt());
    let of = |view: &View, fit: &Fit| corners_px(lens).map(|px| map(&fit.p, view.to_plane(px)));
    let corner_mm = |k1: f64| bent(k1).map(|(view, fit)| of(&view, &fit));
    let none = of(&lens.normalised(), straight);
    let (likely, farther) = (corner_mm(k1)?, corner_mm(k1 + k95(dof) * sd)?);
    let largest = |a: &[Vector2<f64>; 4], b: &[Vector2<f64>; 4]| {
        a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
    };
    Some(UnseenLens { seen_mm: largest(&none, &likely), u95_mm: largest(&likely, &farther) })
}

/// The picture's corners.
pub(super) fn corners_px(lens: &Lens) -> [Vector2<f64>; 4] {
    let (right, low) = (f64::from(lens.width_px) - 1.0, f64::from(lens.height_px) - 1.0);
    [(0.0, 0.0), (right, 0.0), (0.0, low), (right, low)].map(|(u, v)| Vector2::new(u, v))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera of 0.01 mm a pixel that looks at a mark from a grid of nine positions.
    fn unseen(k1: f64, noise_px: f64) -> UnseenLens {
        let lens = ideal(1600, 1200);
        let real = Lens { distortion: [k1, 0.0, 0.0, 0.0, 0.0], ..lens.clone() }.normalised();
        let seen: Vec<(Vector2<f64>, Vector2<f64>)> = (0..9)
            .map(|i| {
                let at = Vector2::new(f64::from(i % 3) - 1.0, f64::from(i / 3) - 1.0);
                let at = at.component_mul(&Vector2::new(6.0, 4.0));
                let noise =
                    Vector2::new(f64::from(i * 7 % 5), f64::from(i * 3 % 5)) - Vector2::repeat(2.0);
                (real.to_pixel(-at / 16.0) + noise * 0.7 * noise_px, at)
            })
            .collect();
        let all: Vec<usize> = (0..9).collect();
        let view = lens.normalised();
        let straight = solve(&all, &|i| (view.to_plane(seen[i].0), seen[i].1)).unwrap();
        unseen_lens(&lens, &seen, &straight).unwrap()
    }

    #[test]
    fn a_bent_lens_shows_in_the_positions_and_a_straight_one_is_known_to_be() {
        let bent = unseen(-0.02, 0.02);
        assert!(bent.seen_mm > 0.03, "{}", bent.seen_mm);
        let straight = unseen(0.0, 0.02);
        assert!(straight.seen_mm < 0.002, "{}", straight.seen_mm);
        assert!(straight.u95_mm < 0.003, "{}", straight.u95_mm);
    }
}
