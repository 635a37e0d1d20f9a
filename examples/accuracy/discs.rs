//! Blurred discs and quarter arcs with pixel noise against the Cramer-Rao bound.

use std::f64::consts::{FRAC_PI_2, PI, SQRT_2};

use nalgebra::{DMatrix, Vector2, Vector3};
use pivotsight::camera::{Calibration, Mapping, View};
use pivotsight::fit::Circle;
use pivotsight::frame::{Frame, Gray};
use pivotsight::measure::{points, ring, rod};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::stats::quantile;

/// Counts of the 16-bit frame in one count of contrast and noise: rounding is no part of this table.
const SCALE: f64 = 100.0;
const LEVEL: f64 = 110.0;
/// Size of a pixel where the rod is measured, which knows how good rods are.
const MM_PER_PX: f64 = 0.01;

const RADII: [f64; 4] = [20.0, 65.3, 300.0, 800.0];
const BLURS: [f64; 4] = [0.8, 2.0, 4.0, 6.0];
const CONTRASTS: [(f64, f64); 4] = [(200.0, 1.0), (120.0, 2.0), (60.0, 4.0), (30.0, 8.0)];

/// One cell of the table.
struct Cell {
    radius_px: f64,
    blur_px: f64,
    contrast: f64,
    noise: f64,
    profile: Profile,
}

/// A blurred disc's level over the distance from its middle.
struct Profile {
    start_px: f64,
    values: Vec<f64>,
}

impl Profile {
    const STEP_PX: f64 = 0.02;

    /// Exact: the Gaussian's share on each chord of the disc, integrated over the chords. `s`² is a chord's distance from
    /// the rim, which keeps the integrand smooth there.
    fn of_disc(radius: f64, blur: f64) -> Self {
        let start_px = (radius - 8.0 * blur).max(0.0);
        let count = ((radius + 8.0 * blur - start_px) / Self::STEP_PX) as usize;
        let density = |x: f64| (-0.5 * (x / blur).powi(2)).exp() / (blur * (2.0 * PI).sqrt());
        let value = |r: f64| {
            let last = (radius - r + 8.0 * blur).clamp(0.0, 2.0 * radius).sqrt();
            let first = (radius - r - 8.0 * blur).max(0.0).sqrt();
            let n = 800;
            let width = (last - first) / f64::from(n);
            (0..n)
                .map(|i| first + (f64::from(i) + 0.5) * width)
                .map(|s| {
                    let half_chord = (s * s * (2.0 * radius - s * s)).max(0.0).sqrt();
                    let inside = 1.0 - 2.0 * normal_tail(half_chord / blur);
                    density(r - radius + s * s) * inside * 2.0 * s * width
                })
                .sum()
        };
        let at = |i: usize| start_px + Self::STEP_PX * i as f64;
        Self { start_px, values: (0..count).into_par_iter().map(|i| value(at(i))).collect() }
    }

    fn at(&self, r: f64) -> f64 {
        let x = ((r - self.start_px) / Self::STEP_PX).clamp(0.0, self.values.len() as f64 - 1.001);
        let (i, f) = (x as usize, x.fract());
        self.values[i] * (1.0 - f) + self.values[i + 1] * f
    }

    /// What a unit of angle of the edge tells of its place along the normal, in squared noise per contrast: ∫ P'² r dr.
    fn information(&self) -> f64 {
        let slope = |w: &[f64]| (w[1] - w[0]) / Self::STEP_PX;
        let r = |i: usize| self.start_px + Self::STEP_PX * (i as f64 + 0.5);
        self.values.windows(2).enumerate().map(|(i, w)| slope(w).powi(2) * r(i)).sum::<f64>()
            * Self::STEP_PX
    }
}

impl Cell {
    fn new(radius_px: f64, blur_px: f64, contrast: f64, noise: f64) -> Self {
        let profile = Profile::of_disc(radius_px, blur_px);
        Self { radius_px, blur_px, contrast, noise, profile }
    }

    /// Cells share no noise.
    fn seed(&self, run: u64) -> u64 {
        let own = self.radius_px + 1e4 * self.blur_px + 1e6 * self.contrast;
        own as u64 * 1_000_000 + run
    }

    /// Standard deviation of the place of a piece of edge that spans one radian.
    fn radian_sd_px(&self) -> f64 {
        self.noise / self.contrast / self.profile.information().sqrt()
    }

    /// A frame with noise in the band that can be looked at, and none elsewhere.
    fn frame(&self, side: usize, center: Vector2<f64>, rng: &mut ChaCha8Rng) -> Frame {
        let reach = 10.0 * self.blur_px + 30.0;
        let data = (0..side * side)
            .map(|i| {
                let p = Vector2::new((i % side) as f64, (i / side) as f64);
                let r = (p - center).norm();
                let mut value = LEVEL + self.contrast * self.profile.at(r);
                if (r - self.radius_px).abs() < reach {
                    let shot: f64 = StandardNormal.sample(rng);
                    value += self.noise * shot;
                }
                (value * SCALE).round().clamp(0.0, 65535.0) as u16
            })
            .collect();
        Frame::Sixteen(Gray { width: side, height: side, data })
    }
}

fn view(side: usize, mm_per_px: f64) -> View {
    let mapping = Mapping::Scale { mm_per_px, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    calibration.view(side, side).expect("a scale suits every frame")
}

/// Prints both tables: rms of the centre over the bound, biases, how often the interval holds.
pub fn table(runs: u64) {
    println!(
        "| radius px | blur px | contrast | noise | rms / bound | centre bias / rms | radius bias / rms | u95 holds | runs |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for radius in RADII {
        for blur in BLURS {
            for (contrast, noise) in CONTRASTS {
                row(&Cell::new(radius, blur, contrast, noise), runs);
            }
        }
    }
    println!(
        "\n| quarter arcs, shared radius px | blur px | contrast | noise | rms / bound | 90 % / bound | u95 holds | runs |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (radius, blur, contrast, noise) in
        [(150.0, 1.2, 120.0, 2.0), (300.0, 2.0, 60.0, 4.0), (300.0, 4.0, 60.0, 6.0)]
    {
        arcs(&Cell::new(radius, blur, contrast, noise), runs);
    }
}

fn row(cell: &Cell, runs: u64) {
    let Cell { radius_px, blur_px, contrast, noise, .. } = cell;
    let found: Vec<(Vector2<f64>, f64, usize)> =
        (0..runs).into_par_iter().filter_map(|seed| measure(cell, cell.seed(seed))).collect();
    let n = found.len().max(1) as f64;
    let rms = (found.iter().map(|f| f.0.norm_squared()).sum::<f64>() / (2.0 * n)).sqrt();
    let center = found.iter().map(|f| f.0).sum::<Vector2<f64>>() / n;
    let bias = found.iter().map(|f| f.1).sum::<f64>() / n;
    let inside: usize = found.iter().map(|f| f.2).sum();
    // Over the whole circle x gets half of what every piece of edge tells.
    let bound = cell.radian_sd_px() / PI.sqrt();
    println!(
        "| {radius_px} | {blur_px} | {contrast} | {noise} | {:.2} | {:.2} | {:+.2} | {:.1} % | {} of {runs} |",
        rms / bound,
        center.amax() / rms,
        bias / rms,
        100.0 * inside as f64 / (2.0 * n),
        found.len()
    );
}

/// Error of centre and radius (px), and in how many components the interval holds.
fn measure(cell: &Cell, seed: u64) -> Option<(Vector2<f64>, f64, usize)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let Cell { radius_px, blur_px, .. } = cell;
    let side = (2.0 * (radius_px + 4.0 * blur_px) + 60.0) as usize;
    let middle = side as f64 / 2.0;
    let mut draw = || rng.random::<f64>();
    let center = Vector2::new(middle + draw(), middle + draw());
    let astray = Vector2::new(draw() - 0.5, draw() - 0.5) * 4.0;
    let frame = cell.frame(side, center, &mut rng);
    let view = view(side, 1.0);
    let truth = view.to_plane(center);
    let rough = Circle { center: truth + astray, radius: radius_px + 1.0 };
    let search = points::Search {
        reach_px: 6.0,
        inside_limit_px: 0.9 * radius_px,
        outside_limit_px: 30.0 + 4.0 * blur_px,
        softness_px: 2.0,
        tinted: false,
        light: None,
    };
    let ring = ring::measure(&frame, &view, rough, search, None)?;
    let error = ring.circle.center - truth;
    let k = pivotsight::uncertainty::k95(ring.dof);
    let holds = |i: usize| usize::from(error[i].abs() <= k * ring.covariance[(i, i)].sqrt());
    Some((error, ring.circle.radius - radius_px, holds(0) + holds(1)))
}

/// Four table angles, one quarter of the rim seen at each, one radius for all.
fn arcs(cell: &Cell, runs: u64) {
    let Cell { radius_px, blur_px, contrast, noise, .. } = cell;
    let found: Vec<(f64, usize)> = (0..runs)
        .into_par_iter()
        .filter_map(|seed| four_quarters(cell, cell.seed(seed)))
        .flatten()
        .collect();
    let n = found.len().max(1) as f64;
    let bound = arcs_bound(cell);
    let rms = (found.iter().map(|f| f.0 * f.0).sum::<f64>() / (2.0 * n)).sqrt();
    let sizes: Vec<f64> = found.iter().map(|f| f.0).collect();
    // The 90 % quantile of a vector of two equal components is 2.146 times their standard deviation.
    let nine = quantile(&sizes, 0.9) / 2.146;
    let inside: usize = found.iter().map(|f| f.1).sum();
    println!(
        "| {radius_px} | {blur_px} | {contrast} | {noise} | {:.2} | {:.2} | {:.1} % | {} of {runs} |",
        rms / bound,
        nine / bound,
        100.0 * inside as f64 / (2.0 * n),
        found.len() / 4
    );
}

/// Rms of the centres' components that the noise allows: four centres and a radius, a quarter of a circle for each centre.
fn arcs_bound(cell: &Cell) -> f64 {
    let mut normal = DMatrix::<f64>::zeros(9, 9);
    let steps = 400;
    for quarter in 0..4 {
        for i in 0..steps {
            let angle = FRAC_PI_2 * ((f64::from(i) + 0.5) / f64::from(steps) - 0.5);
            let row = Vector3::new(angle.cos(), angle.sin(), 1.0);
            let place = [2 * quarter, 2 * quarter + 1, 8];
            for a in 0..3 {
                for b in 0..3 {
                    normal[(place[a], place[b])] += row[a] * row[b] * FRAC_PI_2 / f64::from(steps);
                }
            }
        }
    }
    let variance = normal.try_inverse().map_or(f64::NAN, |c| c.diagonal().rows(0, 8).mean());
    cell.radian_sd_px() * variance.sqrt()
}

/// Length of each centre's error, and in how many of its components the interval holds.
fn four_quarters(cell: &Cell, seed: u64) -> Option<Vec<(f64, usize)>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let radius = cell.radius_px;
    // The chord of a quarter fits the frame exactly.
    let side = (SQRT_2 * radius) as usize;
    let middle = Vector2::repeat((side as f64 - 1.0) / 2.0);
    let (mut captures, mut frames, mut truths) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..4 {
        let draw = Vector2::new(rng.random::<f64>(), rng.random::<f64>()) * 2.0;
        let c_deg = 90.0 * f64::from(k);
        let turned = nalgebra::Rotation2::new(c_deg.to_radians()) * Vector2::new(4.0, 1.0);
        // The rod stands a little beside the C axis; its rim's right side is in the frame's middle. All in pixels.
        let truth = turned;
        let position = truth + Vector2::new(0.85 * radius, 0.0) + draw;
        let seen = truth - position;
        let center = middle + Vector2::new(seen.x, -seen.y);
        frames.push((cell.frame(side, center, &mut rng), view(side, MM_PER_PX)));
        captures.push(rod::Capture::in_memory(format!("capture {k}"), position * MM_PER_PX, c_deg));
        truths.push(truth);
    }
    let options = rod::Options {
        diameter_mm: Some(2.0 * radius * MM_PER_PX),
        diameter_u_mm: 1e3,
        ..rod::Options::default()
    };
    let report = rod::measure_frames(&captures, &frames, &options).ok()?.report;
    let error = |(c, truth): (&rod::RodCenter, &Vector2<f64>)| {
        let error = Vector2::from(c.center_mm) / MM_PER_PX - truth;
        let holds = |i: usize| usize::from(error[i].abs() <= c.center_u95_mm[i] / MM_PER_PX);
        (error.norm(), holds(0) + holds(1))
    };
    Some(report.rod_centers.iter().zip(&truths).map(error).collect())
}

/// The share of a normal distribution above `x` (Abramowitz & Stegun 7.1.26 is too coarse: here by series of erfc
/// after Numerical Recipes, good to 1e-7).
fn normal_tail(x: f64) -> f64 {
    let z = x.abs() / SQRT_2;
    let t = 1.0 / (1.0 + 0.5 * z);
    let series = [
        -1.26551223,
        1.00002368,
        0.37409196,
        0.09678418,
        -0.18628806,
        0.27886807,
        -1.13520398,
        1.48851587,
        -0.82215223,
        0.17087277,
    ];
    let power = series.iter().rev().fold(0.0, |sum, c| sum * t + c);
    let erfc = t * (-z * z + power).exp();
    if x >= 0.0 { 0.5 * erfc } else { 1.0 - 0.5 * erfc }
}
