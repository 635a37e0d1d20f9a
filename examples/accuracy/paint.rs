//! A small painter of test pictures, sharing nothing with `pivotsight::render`: light on a grid of samples, blurred, smeared, read.

use nalgebra::Vector2;
use pivotsight::frame::Picture;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Light on the sensor: 1 fills a pixel. Places are in pixels, (0, 0) being the middle of the top-left pixel.
#[derive(Clone)]
pub struct Canvas {
    width: usize,
    height: usize,
    /// Samples along a pixel's side.
    fine: usize,
    light: Vec<f32>,
}

/// From light to counts.
#[derive(Debug, Clone, Copy)]
pub struct Sensor {
    /// Standard deviation of the noise, part of full scale.
    pub noise: f64,
    /// Exponent of the output curve: value = light^(1/gamma).
    pub gamma: f64,
    /// 8 or 16.
    pub bits: u32,
}

impl Canvas {
    /// An evenly lit canvas.
    pub fn new(width: usize, height: usize, fine: usize, light: f64) -> Self {
        let count = width * height * fine * fine;
        Self { width, height, fine, light: vec![light as f32; count] }
    }

    /// Replaces the light of every sample.
    pub fn paint(&mut self, mut colour: impl FnMut(Vector2<f64>, f64) -> f64) {
        let middle = Vector2::new(self.width as f64, self.height as f64) / 2.0;
        self.paint_near(middle, middle.norm(), &mut colour);
    }

    /// Replaces the light of the samples in the square of half side `reach_px` about a place.
    pub fn paint_near(
        &mut self,
        middle_px: Vector2<f64>,
        reach_px: f64,
        mut colour: impl FnMut(Vector2<f64>, f64) -> f64,
    ) {
        let fine = self.fine as f64;
        let (columns, rows) = (self.width * self.fine, self.height * self.fine);
        let index = |px: f64| ((px + 0.5) * fine - 0.5).max(0.0);
        let span = |middle: f64, count: usize| {
            let first = index(middle - reach_px).floor() as usize;
            first.min(count)..(index(middle + reach_px).ceil() as usize + 1).min(count)
        };
        for j in span(middle_px.y, rows) {
            for i in span(middle_px.x, columns) {
                let p = Vector2::new(i as f64 + 0.5, j as f64 + 0.5) / fine;
                let value = &mut self.light[j * columns + i];
                *value = colour(p - Vector2::new(0.5, 0.5), f64::from(*value)) as f32;
            }
        }
    }

    /// Optical blur.
    pub fn blur(&mut self, sigma_px: f64) {
        let sigma = sigma_px * self.fine as f64;
        if sigma < 0.05 {
            return;
        }
        let half = (5.0 * sigma).ceil() as i64;
        let taps: Vec<f32> =
            (-half..=half).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32).collect();
        let sum: f32 = taps.iter().sum();
        let taps: Vec<f32> = taps.iter().map(|t| t / sum).collect();
        let (columns, rows) = (self.width * self.fine, self.height * self.fine);
        let mut padded = vec![0.0f32; columns.max(rows) + taps.len()];
        let mut smooth = |line: &mut [f32]| {
            let h = half as usize;
            padded[h..h + line.len()].copy_from_slice(line);
            padded[..h].fill(line[0]);
            padded[h + line.len()..2 * h + line.len()].fill(line[line.len() - 1]);
            line.fill(0.0);
            for (k, tap) in taps.iter().enumerate() {
                line.iter_mut().zip(&padded[k..]).for_each(|(out, x)| *out += tap * x);
            }
        };
        self.light.chunks_exact_mut(columns).for_each(&mut smooth);
        let mut turned = transposed(&self.light, columns);
        turned.chunks_exact_mut(rows).for_each(&mut smooth);
        self.light = transposed(&turned, rows);
    }

    /// Motion during the exposure: an even smear, symmetric about the place.
    pub fn smear(&mut self, along_px: Vector2<f64>) {
        let (columns, rows) = (self.width * self.fine, self.height * self.fine);
        let steps = (along_px.norm() * self.fine as f64).ceil().max(1.0) as i64;
        let mut sum = vec![0.0f32; self.light.len()];
        for k in 0..=steps {
            let t = k as f64 / steps as f64 - 0.5;
            // Rounded alike on both sides of the middle.
            let shift = along_px * (t * self.fine as f64);
            let (dx, dy) = (shift.x.round() as i64, shift.y.round() as i64);
            for j in 0..rows {
                let from = (j as i64 + dy).clamp(0, rows as i64 - 1) as usize * columns;
                for i in 0..columns {
                    let column = (i as i64 + dx).clamp(0, columns as i64 - 1) as usize;
                    sum[j * columns + i] += self.light[from + column];
                }
            }
        }
        let scale = 1.0 / (steps + 1) as f32;
        self.light = sum.into_iter().map(|s| s * scale).collect();
    }

    /// What the sensor reads: counts up to its full scale, pixel by pixel.
    pub fn read(&self, sensor: Sensor, rng: &mut ChaCha8Rng) -> Vec<u16> {
        let full = f64::from((1u32 << sensor.bits) - 1);
        let columns = self.width * self.fine;
        let share = 1.0 / (self.fine * self.fine) as f64;
        let mut counts = Vec::with_capacity(self.width * self.height);
        for v in 0..self.height {
            for u in 0..self.width {
                let mut sum = 0.0;
                for j in v * self.fine..(v + 1) * self.fine {
                    let start = j * columns + u * self.fine;
                    sum += self.light[start..start + self.fine].iter().sum::<f32>();
                }
                let normal: f64 = StandardNormal.sample(rng);
                let light = (f64::from(sum) * share + sensor.noise * normal).clamp(0.0, 1.0);
                counts.push((light.powf(1.0 / sensor.gamma) * full).round() as u16);
            }
        }
        counts
    }

    /// The gray picture that a sensor reads, as a portable graymap.
    pub fn pgm(&self, sensor: Sensor, rng: &mut ChaCha8Rng) -> Vec<u8> {
        portable("P5", self.width, self.height, sensor.bits, &self.read(sensor, rng))
    }

    /// As [`Canvas::pgm`], decoded.
    #[allow(dead_code)] // Not every program that shares this file needs it.
    pub fn picture(&self, sensor: Sensor, rng: &mut ChaCha8Rng) -> Picture {
        Picture::decode("painted", &self.pgm(sensor, rng)).expect("a graymap is a picture")
    }
}

/// The colour picture of three canvases, as a portable pixmap.
#[allow(dead_code)]
pub fn ppm(canvases: &[Canvas; 3], sensor: Sensor, rng: &mut ChaCha8Rng) -> Vec<u8> {
    let planes = canvases.each_ref().map(|c| c.read(sensor, rng));
    let mixed: Vec<u16> =
        (0..planes[0].len()).flat_map(|i| planes.each_ref().map(|p| p[i])).collect();
    portable("P6", canvases[0].width, canvases[0].height, sensor.bits, &mixed)
}

fn portable(kind: &str, width: usize, height: usize, bits: u32, counts: &[u16]) -> Vec<u8> {
    let mut bytes = format!("{kind}\n{width} {height}\n{}\n", (1u32 << bits) - 1).into_bytes();
    match bits {
        8 => bytes.extend(counts.iter().map(|&c| c as u8)),
        _ => bytes.extend(counts.iter().flat_map(|c| c.to_be_bytes())),
    }
    bytes
}

fn transposed(data: &[f32], columns: usize) -> Vec<f32> {
    let rows = data.len() / columns;
    let mut out = vec![0.0; data.len()];
    for (j, row) in data.chunks_exact(columns).enumerate() {
        row.iter().enumerate().for_each(|(i, &x)| out[i * rows + j] = x);
    }
    out
}

/// How much of a soft edge's inside is at this distance from it (outside positive): a logistic of 90-10 % width 4.4 `soft_px`.
pub fn inside(distance_px: f64, soft_px: f64) -> f64 {
    1.0 / (1.0 + (distance_px / soft_px).clamp(-40.0, 40.0).exp())
}

/// A closed curve's deviation from its circle, by angle: equally strong random harmonics up to a finest wave.
#[derive(Clone)]
pub struct Wave(Vec<f64>);

impl Wave {
    const PLACES: usize = 2048;

    /// Standard deviation `rms`, the finest wave `finest` long on a circle of this radius (same unit). The two lowest
    /// harmonics are size and place of the circle itself and take part.
    #[allow(dead_code)]
    pub fn new(rng: &mut ChaCha8Rng, rms: f64, finest: f64, radius: f64) -> Self {
        let most = ((std::f64::consts::TAU * radius / finest) as usize).clamp(2, 400);
        let scale = rms * (2.0 / (2 * most + 1) as f64).sqrt();
        let harmonics: Vec<(f64, f64)> = (0..=most)
            .map(|k| {
                let normal: f64 = StandardNormal.sample(rng);
                let size = if k == 0 { scale / 2f64.sqrt() * normal } else { 0.0 };
                let other: f64 = StandardNormal.sample(rng);
                if k == 0 { (size, 0.0) } else { (scale * normal, scale * other) }
            })
            .collect();
        let at = |i: usize| {
            let turn = std::f64::consts::TAU * i as f64 / Self::PLACES as f64;
            let wave = |(k, (a, b)): (usize, &(f64, f64))| {
                let (s, c) = (k as f64 * turn).sin_cos();
                a * c + b * s
            };
            harmonics.iter().enumerate().map(wave).sum()
        };
        Self((0..Self::PLACES).map(at).collect())
    }

    /// The deviation in a direction.
    #[allow(dead_code)]
    pub fn at(&self, direction: Vector2<f64>) -> f64 {
        let turn = direction.y.atan2(direction.x).rem_euclid(std::f64::consts::TAU);
        let place = turn / std::f64::consts::TAU * Self::PLACES as f64;
        let (i, f) = (place as usize % Self::PLACES, place.fract());
        self.0[i] * (1.0 - f) + self.0[(i + 1) % Self::PLACES] * f
    }
}

/// Lines of a brushed plate: random values at places across the brush, drawn out along it.
#[derive(Clone)]
pub struct Brush {
    values: Vec<f64>,
    along: Vector2<f64>,
    length_px: f64,
    width_px: f64,
}

impl Brush {
    const SIDE: usize = 128;

    /// Lines of this length and width in a random direction.
    #[allow(dead_code)]
    pub fn new(rng: &mut ChaCha8Rng, length_px: f64, width_px: f64) -> Self {
        let turn = rng.random::<f64>() * std::f64::consts::PI;
        let values = (0..Self::SIDE * Self::SIDE).map(|_| StandardNormal.sample(rng)).collect();
        Self { values, along: Vector2::new(turn.cos(), turn.sin()), length_px, width_px }
    }

    /// Zero mean, about unit variance.
    #[allow(dead_code)]
    pub fn at(&self, p: Vector2<f64>) -> f64 {
        let s = p.dot(&self.along) / self.length_px + 1000.0;
        let t = (p.x * self.along.y - p.y * self.along.x) / self.width_px + 1e5;
        let (row, column) = (t.floor(), s.floor());
        let value = |i: f64, j: f64| {
            // Neighbouring lines are shifted against each other.
            let (i, j) = (i as usize + 37 * j as usize, j as usize);
            self.values[(j % Self::SIDE) * Self::SIDE + i % Self::SIDE]
        };
        let (f, g) = (s - column, t - row);
        let line = |j: f64| value(column, j) * (1.0 - f) + value(column + 1.0, j) * f;
        1.5 * (line(row) * (1.0 - g) + line(row + 1.0) * g)
    }
}
