//! Blurred discs with pixel noise against the Cramer-Rao bound.

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::fit::Circle;
use pivotsight::frame::{Frame, Gray};
use pivotsight::measure::ring;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Counts of the 16-bit frame in one count of contrast and noise: rounding is no part of this table.
const SCALE: f64 = 100.0;

/// One cell of the table.
#[derive(Clone, Copy)]
struct Cell {
    radius_px: f64,
    blur_px: f64,
    contrast: f64,
    noise: f64,
}

/// Prints the table: rms of the centre over the bound, bias of the radius, how often the interval holds.
pub fn table(runs: u64) {
    println!(
        "| radius px | blur px | contrast | noise | rms / bound | radius bias / rms | u95 holds | runs |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (radius_px, blur_px, contrast, noise) in [
        (20.0, 0.8, 120.0, 2.0),
        (20.0, 2.0, 60.0, 4.0),
        (65.3, 1.2, 120.0, 2.0),
        (65.3, 4.0, 60.0, 6.0),
        (300.0, 0.8, 120.0, 2.0),
        (300.0, 6.0, 30.0, 8.0),
        (400.0, 2.0, 200.0, 1.0),
        (800.0, 1.2, 200.0, 4.0),
    ] {
        row(Cell { radius_px, blur_px, contrast, noise }, runs);
    }
}

fn row(cell: Cell, runs: u64) {
    let Cell { radius_px, blur_px, contrast, noise } = cell;
    let found: Vec<(Vector2<f64>, f64, usize)> =
        (0..runs).into_par_iter().filter_map(|seed| measure(cell, seed)).collect();
    let n = found.len().max(1) as f64;
    let rms = (found.iter().map(|f| f.0.norm_squared()).sum::<f64>() / (2.0 * n)).sqrt();
    let bias = found.iter().map(|f| f.1).sum::<f64>() / n;
    let inside: usize = found.iter().map(|f| f.2).sum();
    let bound =
        noise / contrast * (2.0 * blur_px / (std::f64::consts::PI.sqrt() * radius_px)).sqrt();
    println!(
        "| {radius_px} | {blur_px} | {contrast} | {noise} | {:.2} | {:+.2} | {:.0} % | {} of {runs} |",
        rms / bound,
        bias / rms,
        100.0 * inside as f64 / (2.0 * n),
        found.len()
    );
}

/// Error of centre and radius (px), and in how many components the interval holds.
fn measure(cell: Cell, seed: u64) -> Option<(Vector2<f64>, f64, usize)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let Cell { radius_px, blur_px, contrast, noise } = cell;
    let size = (2.0 * (radius_px + 4.0 * blur_px) + 60.0) as usize;
    let middle = size as f64 / 2.0;
    let mut draw = || rng.random::<f64>();
    let center = Vector2::new(middle + draw(), middle + draw());
    let astray = Vector2::new(draw() - 0.5, draw() - 0.5) * 4.0;
    // A blurred disc is an error function about a rim drawn in by σ²/2R (to second order).
    let rim = radius_px - blur_px * blur_px / (2.0 * radius_px);
    let data = (0..size * size)
        .map(|i| {
            let p = Vector2::new((i % size) as f64, (i / size) as f64);
            let x = ((p - center).norm() - rim) / blur_px;
            let shot: f64 = StandardNormal.sample(&mut rng);
            let value = 110.0 + contrast * normal_tail(x) + noise * shot;
            (value * SCALE).round().clamp(0.0, 65535.0) as u16
        })
        .collect();
    let frame = Frame::Sixteen(Gray { width: size, height: size, data });
    let mapping = Mapping::Scale { mm_per_px: 1.0, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None };
    let view = calibration.view(size, size).ok()?;
    let truth = view.to_plane(center);
    let rough = Circle { center: truth + astray, radius: radius_px + 1.0 };
    let search = ring::Search {
        reach_px: 6.0,
        inside_limit_px: 0.9 * radius_px,
        outside_limit_px: 30.0 + 4.0 * blur_px,
        softness_px: 2.0,
    };
    let ring = ring::measure(&frame, &view, rough, search, None)?;
    let error = ring.circle.center - truth;
    let k = pivotsight::uncertainty::k95(ring.dof);
    let holds = |i: usize| usize::from(error[i].abs() <= k * ring.covariance[(i, i)].sqrt());
    Some((error, ring.circle.radius - radius_px, holds(0) + holds(1)))
}

/// The share of a normal distribution above `x` (Abramowitz & Stegun 7.1.26 is too coarse: here by series of erfc
/// after Numerical Recipes, good to 1e-7).
fn normal_tail(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
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
