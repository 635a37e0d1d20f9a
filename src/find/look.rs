//! The reduced picture in which circles are looked for, blurred at a few scales.

use nalgebra::Vector2;

use crate::find::light::Light;
use crate::frame::{Frame, Gray, MOST_JOINED};

/// The reduced picture's longer side, about.
const SIDE_PX: usize = 420;
/// Blurs (standard deviations in reduced pixels) at which gradients are taken: sharp, soft and very soft edges.
pub(super) const BLURS: [f64; 3] = [1.0, 2.2, 5.0];

/// Pixels of a part of a picture below which nothing is looked for in it.
const LEAST_PART: usize = 8;

/// A reduced picture, blurred at several scales.
#[derive(Debug, Clone)]
pub struct Look {
    /// How many pixels of the full picture make one here.
    pub factor: usize,
    /// The full picture's pixel at which it begins: it may be of a part.
    corner: Vector2<f64>,
    /// The blurred pictures with their blur, sharpest first.
    pub scales: Vec<(f64, Gray<f32>)>,
    /// Typical random difference of neighbouring pixels at the sharpest scale, counts.
    pub noise: f64,
    /// What has been taken out of it of the light's fall-off.
    pub(crate) light: Option<Light>,
}

impl Look {
    /// Reduces and blurs, by the first few of the scales.
    pub fn new(frame: &Frame, scales: usize) -> Self {
        Self::reduced_by(Self::factor(frame), frame, scales)
    }

    /// The same without the light's smooth fall-off.
    pub fn evenly(frame: &Frame, scales: usize) -> Self {
        let factor = Self::within(Self::factor(frame), frame);
        let mut base = frame.reduce(factor);
        let light = Light::of(&base, factor);
        if let Some(light) = &light {
            light.even_out(&mut base);
        }
        Self { light, ..Self::of(&base, factor, scales) }
    }

    fn factor(frame: &Frame) -> usize {
        frame.width().max(frame.height()).div_ceil(SIDE_PX).clamp(1, MOST_JOINED)
    }

    /// Less where little would be left of a narrow strip.
    fn within(factor: usize, frame: &Frame) -> usize {
        factor.min(frame.width().min(frame.height()) / LEAST_PART).max(1)
    }

    /// The same of what lies within `reach_px` of a place, each way; `None` where hardly any of it is in the picture.
    pub fn part(frame: &Frame, middle: Vector2<f64>, reach_px: f64, scales: usize) -> Option<Self> {
        let (part, corner) = frame.part(middle, reach_px);
        let seen = part.width().min(part.height()) >= LEAST_PART;
        seen.then(|| Self { corner, ..Self::new(&part, scales) })
    }

    /// Reduces by `factor`, less where little would be left of a narrow strip, and blurs, by the first few of the scales.
    pub fn reduced_by(factor: usize, frame: &Frame, scales: usize) -> Self {
        let factor = Self::within(factor, frame);
        Self::of(&frame.reduce(factor), factor, scales)
    }

    fn of(base: &Gray<f32>, factor: usize, scales: usize) -> Self {
        let noise = texture(base);
        let scales = BLURS.iter().take(scales).map(|&b| (b, blur(base, b))).collect();
        Self { factor, corner: Vector2::zeros(), scales, noise, light: None }
    }

    /// Full-picture pixel → reduced pixel.
    pub fn reduced(&self, p: Vector2<f64>) -> Vector2<f64> {
        let k = self.factor as f64;
        (p - self.corner - Vector2::repeat((k - 1.0) / 2.0)) / k
    }

    /// Reduced pixel → full-picture pixel.
    pub fn full(&self, p: Vector2<f64>) -> Vector2<f64> {
        let k = self.factor as f64;
        p * k + Vector2::repeat((k - 1.0) / 2.0) + self.corner
    }

    /// Width and height of the reduced picture.
    pub fn size(&self) -> (usize, usize) {
        (self.scales[0].1.width, self.scales[0].1.height)
    }
}

/// Bilinear value; NaN outside the picture.
#[inline]
pub(super) fn value_at(image: &Gray<f32>, x: f64, y: f64) -> f32 {
    if !(x >= 0.0 && y >= 0.0 && x < (image.width - 1) as f64 && y < (image.height - 1) as f64) {
        return f32::NAN;
    }
    let (i, j) = (x as usize, y as usize);
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let at = j * image.width + i;
    let (top, low) = (&image.data[at..at + 2], &image.data[at + image.width..at + image.width + 2]);
    let (top, low) = (top[0] + fx * (top[1] - top[0]), low[0] + fx * (low[1] - low[0]));
    top + fy * (low - top)
}

/// Directions evenly all round.
pub(super) fn directions<const N: usize>() -> [Vector2<f64>; N] {
    std::array::from_fn(|i| {
        let (s, c) = (std::f64::consts::TAU * i as f64 / N as f64).sin_cos();
        Vector2::new(c, s)
    })
}

/// Bilinear values at `count` places along a line from `start`, each by `step`; NaN outside the picture.
pub(super) fn values_along(
    image: &Gray<f32>,
    start: Vector2<f64>,
    step: Vector2<f64>,
    count: usize,
    values: &mut Vec<f32>,
) {
    values.clear();
    let (w, h) = (image.width, image.height);
    let columns = steps_within(start.x, step.x, count, w as f64 - 1.0);
    let rows = steps_within(start.y, step.y, count, h as f64 - 1.0);
    let inside = columns.start.max(rows.start)..columns.end.min(rows.end);
    if inside.is_empty() {
        values.resize(count, f32::NAN);
        return;
    }
    values.resize(inside.start, f32::NAN);
    // In whole numbers of a part of a pixel: places are found by adding.
    let first = start + step * inside.start as f64;
    let (mut u, mut v) = (fixed(first.x), fixed(first.y));
    let (along_u, along_v) = (fixed(step.x), fixed(step.y));
    values.extend(inside.map(|_| {
        let at = (v >> FRACTION) as usize * w + (u >> FRACTION) as usize;
        let part = |v: i32| (v & ((1 << FRACTION) - 1)) as f32 * (1.0 / (1 << FRACTION) as f32);
        let (fx, fy) = (part(u), part(v));
        (u, v) = (u + along_u, v + along_v);
        let near = &image.data[at..at + w + 2];
        let (top, low) = (&near[..2], &near[w..]);
        let (top, low) = (top[0] + fx * (top[1] - top[0]), low[0] + fx * (low[1] - low[0]));
        top + fy * (low - top)
    }));
    values.resize(count, f32::NAN);
}

/// Bits for the fraction of a place in whole numbers.
pub(super) const FRACTION: u32 = 16;

/// A place as a whole number of parts of a pixel or cell; reduced pictures are far less than 2^15 wide.
pub(super) fn fixed(place: f64) -> i32 {
    (place * f64::from(1 << FRACTION)) as i32
}

/// Which of `count` steps from `start` lie in 0..`limit`, clear of it by more than steps are rounded.
fn steps_within(start: f64, step: f64, count: usize, limit: f64) -> std::ops::Range<usize> {
    const CLEAR: f64 = 0.02;
    let (least, most) = (CLEAR, limit - CLEAR);
    if step == 0.0 {
        return if start >= least && start <= most { 0..count } else { 0..0 };
    }
    let (a, b) = ((least - start) / step, (most - start) / step);
    let (first, last) = (a.min(b).ceil(), a.max(b).floor() + 1.0);
    first.clamp(0.0, count as f64) as usize..last.clamp(0.0, count as f64) as usize
}

/// Gaussian blur in two passes, edges repeated.
pub(crate) fn blur(image: &Gray<f32>, sd: f64) -> Gray<f32> {
    let reach = (3.0 * sd).ceil() as usize;
    let mut kernel: Vec<f32> = (0..=2 * reach)
        .map(|i| (-0.5 * ((i as f64 - reach as f64) / sd).powi(2)).exp() as f32)
        .collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let (w, h) = (image.width, image.height);
    let mut across = vec![0.0f32; w * h];
    let mut padded = vec![0.0f32; w + 2 * reach];
    for v in 0..h {
        let row = image.row(v);
        padded[..reach].fill(row[0]);
        padded[reach..reach + w].copy_from_slice(row);
        padded[reach + w..].fill(row[w - 1]);
        let out = &mut across[v * w..(v + 1) * w];
        for (i, k) in kernel.iter().enumerate() {
            for (o, p) in out.iter_mut().zip(&padded[i..i + w]) {
                *o += k * p;
            }
        }
    }
    let mut data = vec![0.0f32; w * h];
    for v in 0..h {
        let out = &mut data[v * w..(v + 1) * w];
        for (i, k) in kernel.iter().enumerate() {
            let from = (v + i).saturating_sub(reach).min(h - 1);
            for (o, p) in out.iter_mut().zip(&across[from * w..(from + 1) * w]) {
                *o += k * p;
            }
        }
    }
    Gray { width: w, height: h, data }
}

/// Robust standard deviation of second differences, scaled to that of one pixel.
fn texture(image: &Gray<f32>) -> f64 {
    let mut list: Vec<f32> = Vec::new();
    let step = (image.data.len() / 20_000).max(1);
    for v in 1..image.height.saturating_sub(1) {
        let row = image.row(v);
        for u in (1..image.width.saturating_sub(1)).step_by(step) {
            list.push((2.0 * row[u] - row[u - 1] - row[u + 1]).abs());
        }
    }
    if list.is_empty() {
        return 0.0;
    }
    let middle = list.len() / 2;
    let median = f64::from(*list.select_nth_unstable_by(middle, f32::total_cmp).1);
    1.4826 * median / 6.0f64.sqrt()
}
