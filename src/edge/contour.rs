//! A circle of the measuring plane as it is seen in the picture, in polar form about a point of the picture.

use nalgebra::Vector2;

use crate::camera::View;
use crate::fit::circle;

/// Samples of the contour in the table; radius errors from linear interpolation stay under 1e-4 px.
const SAMPLES: usize = 2048;

/// The contour's radius over polar angle, in pixels. Angles are measured in the picture (v down).
#[derive(Debug, Clone)]
pub struct Contour {
    /// The point the polar angles are measured at.
    pub origin_px: Vector2<f64>,
    /// First polar angle of the table.
    pub start_rad: f64,
    /// Angle the table spans: 2π when closed.
    pub span_rad: f64,
    /// Whether the whole circle is in the table.
    pub closed: bool,
    radius_px: Vec<f64>,
    /// Cosine of the angle between the radius and the contour's normal.
    normal_cos: Vec<f64>,
    /// Samples of the table per radian.
    samples_per_rad: f64,
}

impl Contour {
    /// The visible part of a circle of the plane. `None` where no part of it is in the frame.
    pub fn of_circle(view: &View, center_mm: Vector2<f64>, radius_mm: f64) -> Option<Self> {
        let (width, height) = (view.width_px() as f64, view.height_px() as f64);
        let margin = 0.02 * width.max(height);
        let point = |t: f64| view.to_pixel(center_mm + radius_mm * Vector2::new(t.cos(), t.sin()));
        let inside = |p: Vector2<f64>| {
            p.x > -margin && p.y > -margin && p.x < width + margin && p.y < height + margin
        };
        const COARSE: usize = 720;
        let angle = |i: usize| std::f64::consts::TAU * i as f64 / COARSE as f64;
        let seen: Vec<bool> = (0..COARSE).map(|i| inside(point(angle(i)))).collect();
        let count = seen.iter().filter(|s| **s).count();
        if count == 0 || !radius_mm.is_finite() || radius_mm <= 0.0 {
            return None;
        }
        // The longest unseen run is left out of the table; a circle seen for the most part stays closed.
        let (gap_start, gap_length) = longest_gap(&seen);
        let closed = gap_length < COARSE / 3;
        let (first, span) = if closed {
            (0.0, std::f64::consts::TAU)
        } else {
            (angle(gap_start + gap_length), angle(COARSE - gap_length))
        };
        let pixels: Vec<Vector2<f64>> =
            (0..SAMPLES).map(|i| point(first + span * i as f64 / SAMPLES as f64)).collect();
        let origin_px = circle::taubin(&pixels, &[1.0; SAMPLES])?.center;
        Self::from_pixels(&pixels, origin_px, closed)
    }

    fn from_pixels(pixels: &[Vector2<f64>], origin_px: Vector2<f64>, closed: bool) -> Option<Self> {
        let mut polar: Vec<(f64, f64)> = Vec::with_capacity(pixels.len() + 1);
        for p in pixels {
            let q = p - origin_px;
            let mut angle = q.y.atan2(q.x);
            if let Some(&(last, _)) = polar.last() {
                angle = last + wrap(angle - last);
            }
            polar.push((angle, q.norm()));
        }
        if polar[polar.len() - 1].0 < polar[0].0 {
            polar.reverse();
        }
        if closed {
            polar.push((polar[0].0 + std::f64::consts::TAU, polar[0].1));
        }
        if polar.windows(2).any(|w| w[1].0 <= w[0].0) {
            return None; // The mapping folds over: nothing to measure there.
        }
        let start_rad = polar[0].0;
        let span_rad = polar[polar.len() - 1].0 - start_rad;
        let mut at = 0;
        let radius_px: Vec<f64> = (0..=SAMPLES)
            .map(|i| {
                let angle = start_rad + span_rad * i as f64 / SAMPLES as f64;
                while at + 2 < polar.len() && polar[at + 1].0 < angle {
                    at += 1;
                }
                let ((a0, r0), (a1, r1)) = (polar[at], polar[at + 1]);
                r0 + (r1 - r0) * (angle - a0) / (a1 - a0)
            })
            .collect();
        let step = span_rad / SAMPLES as f64;
        let normal_cos = (0..=SAMPLES)
            .map(|i| {
                let (lo, hi) = (i.saturating_sub(4), (i + 4).min(SAMPLES));
                let slope = (radius_px[hi] - radius_px[lo]) / (step * (hi - lo) as f64);
                1.0 / (1.0 + (slope / radius_px[i]).powi(2)).sqrt()
            })
            .collect();
        let samples_per_rad = SAMPLES as f64 / span_rad;
        Some(Self {
            origin_px,
            start_rad,
            span_rad,
            closed,
            radius_px,
            normal_cos,
            samples_per_rad,
        })
    }

    /// Radius and normal's cosine at an angle counted from `start_rad`.
    #[inline]
    pub(super) fn at(&self, from_start_rad: f64) -> (f64, f64) {
        let x = (from_start_rad * self.samples_per_rad).clamp(0.0, SAMPLES as f64 - 1e-9);
        let i = x as usize;
        let f = x - i as f64;
        (self.radius_px[i] + f * (self.radius_px[i + 1] - self.radius_px[i]), self.normal_cos[i])
    }

    /// The pixel at a polar angle and a distance from the contour along its normal.
    pub fn point(&self, angle_rad: f64, distance_px: f64) -> Vector2<f64> {
        let (radius, cos) = self.at((angle_rad - self.start_rad).rem_euclid(std::f64::consts::TAU));
        self.origin_px
            + (radius + distance_px / cos) * Vector2::new(angle_rad.cos(), angle_rad.sin())
    }

    /// The contour's mean radius.
    pub fn mean_radius_px(&self) -> f64 {
        self.radius_px.iter().sum::<f64>() / self.radius_px.len() as f64
    }

    /// The contour's length.
    pub fn length_px(&self) -> f64 {
        self.mean_radius_px() * self.span_rad
    }

    /// The largest radius of the table.
    pub(super) fn max_radius_px(&self) -> f64 {
        self.radius_px.iter().copied().fold(0.0, f64::max)
    }

    /// The smallest radius of the table.
    pub(super) fn min_radius_px(&self) -> f64 {
        self.radius_px.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// Start and length of the longest run of `false` in a ring.
fn longest_gap(seen: &[bool]) -> (usize, usize) {
    let n = seen.len();
    let (mut best, mut run) = ((0, 0), 0);
    for i in 0..2 * n {
        if seen[i % n] {
            run = 0;
        } else {
            run += 1;
            if run > best.1 && run <= n {
                best = ((i + 1 - run) % n, run);
            }
        }
    }
    best
}

/// An angle brought into (-π, π].
pub(crate) fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle - turn * (angle / turn).round()
}
