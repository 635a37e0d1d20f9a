//! From a scene to a picture: area sampling through the lens, optical blur, light fall-off, sensor.
//!
//! The frame is cut into tiles. A tile without sharp edges is sampled once a pixel, others up to 4 × 4
//! times, less where the blur is wide. One kernel, the pixel's area convolved with the optical blur, takes the samples to pixels, so
//! blur and area sampling are exact to well under a thousandth of a pixel. Every row draws its noise
//! from a stream of its own: the picture does not depend on the number of threads.

use nalgebra::Vector2;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::camera::{Camera, Sensor};
use super::draw::{Dice, stream_rng};
use super::picture::Picture;
use super::surface::Shade;
use crate::camera::View;
use crate::error::Result;

/// Side of a tile.
const TILE_PX: usize = 64;
/// First random stream used for sensor noise; below it are the scene's own streams.
const NOISE_STREAM: u64 = 1000;

/// What differs between gray and the colour channels.
#[derive(Debug, Clone, Copy)]
pub struct Band {
    /// Part of a mark's contrast to the surface that is seen.
    pub contrast: f64,
    /// Strength of the heat tint.
    pub tint: f64,
}

/// Gray sees everything as the scene says.
const GRAY: [Band; 1] = [Band { contrast: 1.0, tint: 1.0 }];
/// Oxide and soot stand out most in blue.
const COLOURS: [Band; 3] = [
    Band { contrast: 0.45, tint: 0.3 },
    Band { contrast: 0.75, tint: 1.0 },
    Band { contrast: 1.0, tint: 1.8 },
];

/// A round piece of the plane that encloses a tile.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Its middle.
    pub middle_mm: Vector2<f64>,
    /// Its radius.
    pub radius_mm: f64,
    /// Size of a pixel there.
    pub pixel_mm: f64,
}

/// Something that can be photographed, in plane millimetres.
pub trait Scene: Sync {
    /// What of the scene concerns one tile.
    type Local;
    /// What varies from pixel to pixel but not within one.
    type Ground: Copy;

    /// Picks what concerns a tile, and how often a pixel must be sampled along each side (1, 2 or 4).
    fn local(&self, patch: Patch) -> (Self::Local, usize);
    /// Texture and glare at a pixel's centre.
    fn ground(&self, point_mm: Vector2<f64>) -> Self::Ground;
    /// Radiance (white surface: 1) of a sample of size `sample_mm` at a point.
    fn radiance(
        &self,
        local: &Self::Local,
        ground: Self::Ground,
        point_mm: Vector2<f64>,
        sample_mm: f64,
        band: Band,
    ) -> f64;
}

/// A sensor with its numbers drawn.
#[derive(Debug, Clone)]
struct Readout {
    bits: u8,
    exposure: f64,
    full_well_e: f64,
    read_noise_e: f64,
    black: f64,
    gamma: f64,
}

impl Readout {
    fn draw(sensor: &Sensor, dice: &mut Dice) -> Result<Self> {
        if ![8, 12, 16].contains(&sensor.bits) {
            return Err(dice.fault(
                "sensor.bits",
                format!("is {}", sensor.bits),
                "choose 8, 12 or 16",
            ));
        }
        Ok(Self {
            bits: sensor.bits,
            exposure: dice.roll("sensor.exposure", &sensor.exposure, 0.01..=10.0)?,
            full_well_e: dice.roll("sensor.full_well_e", &sensor.full_well_e, 100.0..=1e9)?,
            read_noise_e: dice.roll("sensor.read_noise_e", &sensor.read_noise_e, 0.0..=1e6)?,
            black: dice.roll("sensor.black", &sensor.black, 0.0..=0.5)?,
            gamma: dice.roll("sensor.gamma", &sensor.gamma, 0.2..=5.0)?,
        })
    }

    /// The number read for a pixel that receives `light` (part of full scale).
    fn read(&self, light: f64, normal: f64) -> u16 {
        let electrons = light.max(0.0) * self.full_well_e;
        // Above some ten electrons Poisson noise is as good as normal.
        let noise = (electrons + self.read_noise_e * self.read_noise_e).sqrt() * normal;
        let mut value = ((electrons + noise) / self.full_well_e + self.black).clamp(0.0, 1.0);
        if self.gamma != 1.0 {
            value = value.powf(1.0 / self.gamma);
        }
        (value * f64::from(u16::MAX >> (16 - self.bits))).round() as u16
    }
}

/// Photographs a scene. `dice` draws the sensor's numbers, `seed` its noise.
pub fn expose<S: Scene>(
    scene: &S,
    camera: &Camera,
    sensor: &Sensor,
    shade: &Shade,
    dice: &mut Dice,
    seed: u64,
) -> Result<Picture> {
    let readout = Readout::draw(sensor, dice)?;
    let crate::camera::Mapping::Pinhole { lens, .. } = &camera.calibration.mapping else {
        return Err(dice.fault("camera", "is a plain scale", "render with a pinhole camera"));
    };
    let (width, height) = (lens.width_px as usize, lens.height_px as usize);
    let view = camera.calibration.view(width, height)?;
    let bands: &[Band] = if sensor.colour { &COLOURS } else { &GRAY };
    let kernels = [1, 2, 4].map(|s| Kernel::new(camera.blur_px, s));
    let strips: Vec<Vec<u16>> = (0..height.div_ceil(TILE_PX))
        .into_par_iter()
        .map(|strip| {
            let top = strip * TILE_PX;
            let rows = TILE_PX.min(height - top);
            let mut light = vec![0.0f32; rows * width * bands.len()];
            for left in (0..width).step_by(TILE_PX) {
                let tile = Tile { left, top, width: TILE_PX.min(width - left), height: rows };
                tile.sample(scene, &view, &kernels, bands, camera.blur_px, |x, y, band, value| {
                    light[(y * width + left + x) * bands.len() + band] = value;
                });
            }
            let mut values = Vec::with_capacity(light.len());
            for (y, row) in light.chunks_exact(width * bands.len()).enumerate() {
                let mut rng = stream_rng(seed, NOISE_STREAM + (top + y) as u64);
                for (i, &radiance) in row.iter().enumerate() {
                    let x = i / bands.len();
                    let light = f64::from(radiance) * shade.at(x, top + y) * readout.exposure;
                    values.push(readout.read(light, StandardNormal.sample(&mut rng)));
                }
            }
            values
        })
        .collect();
    Ok(Picture {
        width_px: width,
        height_px: height,
        channels: bands.len(),
        bits: readout.bits,
        values: strips.concat(),
    })
}

/// Weights that take samples to pixels, `samples` of them along a pixel's side.
struct Kernel {
    samples: usize,
    margin_px: usize,
    weights: Vec<f32>,
}

impl Kernel {
    fn new(blur_px: f64, samples: usize) -> Self {
        let margin_px = if blur_px == 0.0 { 0 } else { (4.0 * blur_px + 0.5).ceil() as usize };
        let spread = |t: f64| {
            if blur_px == 0.0 {
                return f64::from(t.abs() < 0.5);
            }
            // The pixel's area convolved with the blur, by the midpoint rule.
            let parts = 32;
            (0..parts)
                .map(|i| t + (f64::from(i) + 0.5) / f64::from(parts) - 0.5)
                .map(|d| (-0.5 * (d / blur_px).powi(2)).exp())
                .sum()
        };
        let count = (2 * margin_px + 1) * samples;
        let raw: Vec<f64> = (0..count)
            .map(|j| (j as f64 + 0.5) / samples as f64 - 0.5 - margin_px as f64)
            .map(spread)
            .collect();
        let sum: f64 = raw.iter().sum();
        Self { samples, margin_px, weights: raw.iter().map(|w| (w / sum) as f32).collect() }
    }
}

/// Samples along a pixel's side beyond which nothing is gained. Structure that sampling folds into the
/// picture (an edge's spectrum near one cycle a sample, where a sample's area lets little through) is
/// suppressed by the blur to below 2e-4 of the edge.
fn most_samples(blur_px: f64) -> usize {
    if blur_px >= 1.0 { 2 } else { 4 }
}

/// A rectangle of pixels.
struct Tile {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl Tile {
    fn sample<S: Scene>(
        &self,
        scene: &S,
        view: &View,
        kernels: &[Kernel; 3],
        bands: &[Band],
        blur_px: f64,
        mut put: impl FnMut(usize, usize, usize, f32),
    ) {
        let margin = kernels[0].margin_px as f64;
        let map = TileMap::new(
            view,
            [self.left as f64 - margin - 0.5, (self.left + self.width) as f64 + margin - 0.5],
            [self.top as f64 - margin - 0.5, (self.top + self.height) as f64 + margin - 0.5],
        );
        let (local, samples) = scene.local(map.patch());
        let samples = samples.min(most_samples(blur_px));
        let kernel = kernels.iter().find(|k| k.samples >= samples).unwrap_or(&kernels[2]);
        let samples = kernel.samples;
        let wide = self.width + 2 * kernel.margin_px;
        let high = self.height + 2 * kernel.margin_px;
        let sample_mm = map.patch().pixel_mm / samples as f64;
        let place = |i: usize| (i as f64 + 0.5) / samples as f64; // px from the tile's corner
        let grounds: Vec<S::Ground> = (0..high)
            .flat_map(|y| {
                let row = map.row(y as f64 + 0.5);
                (0..wide).map(move |x| row.at(x as f64 + 0.5))
            })
            .map(|p| scene.ground(p))
            .collect();
        let mut radiance = vec![0.0f32; wide * samples * high * samples];
        for (b, &band) in bands.iter().enumerate() {
            for (y, line) in radiance.chunks_exact_mut(wide * samples).enumerate() {
                let row = map.row(place(y));
                let grounds = &grounds[y / samples * wide..];
                for (x, value) in line.iter_mut().enumerate() {
                    let (point, ground) = (row.at(place(x)), grounds[x / samples]);
                    *value = scene.radiance(&local, ground, point, sample_mm, band) as f32;
                }
            }
            self.gather(&radiance, wide * samples, kernel, |x, y, value| put(x, y, b, value));
        }
    }

    /// Weighs the samples of each pixel: down the columns first, then along the rows.
    fn gather(
        &self,
        samples: &[f32],
        stride: usize,
        kernel: &Kernel,
        mut put: impl FnMut(usize, usize, f32),
    ) {
        let mut line = vec![0.0f32; stride];
        for y in 0..self.height {
            line.fill(0.0);
            let first = y * kernel.samples * stride;
            for (row, &weight) in samples[first..].chunks_exact(stride).zip(&kernel.weights) {
                for (sum, &value) in line.iter_mut().zip(row) {
                    *sum += weight * value;
                }
            }
            for x in 0..self.width {
                let window = &line[x * kernel.samples..];
                put(x, y, dot(&window[..kernel.weights.len()], &kernel.weights));
            }
        }
    }
}

/// The sum of products, in eight lanes.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = a8.remainder().iter().zip(b8.remainder()).map(|(x, y)| x * y).sum();
    let mut lanes = [0.0f32; 8];
    for (x, y) in a8.zip(b8) {
        for ((lane, x), y) in lanes.iter_mut().zip(x).zip(y) {
            *lane += x * y;
        }
    }
    lanes.iter().sum::<f32>() + rest
}

/// Pixel → plane over one tile, by a polynomial of second order through 3 × 3 exact places (good to
/// about 1e-4 px at strong distortion).
struct TileMap {
    size: [f64; 2],
    knots: [[Vector2<f64>; 3]; 3],
}

/// One row of a [`TileMap`]: a parabola.
#[derive(Clone, Copy)]
struct RowMap {
    a: Vector2<f64>,
    b: Vector2<f64>,
    c: Vector2<f64>,
    scale: f64,
}

impl TileMap {
    fn new(view: &View, u: [f64; 2], v: [f64; 2]) -> Self {
        let at = |range: [f64; 2], i: usize| range[0] + (range[1] - range[0]) * i as f64 / 2.0;
        let knots = std::array::from_fn(|row| {
            std::array::from_fn(|col| view.to_plane(Vector2::new(at(u, col), at(v, row))))
        });
        Self { size: [u[1] - u[0], v[1] - v[0]], knots }
    }

    fn patch(&self) -> Patch {
        let k = &self.knots;
        let middle_mm = k[1][1];
        let corners = [k[0][0], k[0][2], k[2][0], k[2][2]];
        let radius_mm = corners.iter().map(|c| (c - middle_mm).norm()).fold(0.0, f64::max);
        let (across, down) = (k[1][2] - k[1][0], k[2][1] - k[0][1]);
        let area = (across.x * down.y - across.y * down.x).abs();
        Patch { middle_mm, radius_mm, pixel_mm: (area / (self.size[0] * self.size[1])).sqrt() }
    }

    /// The row `v` pixels below the tile's upper edge.
    fn row(&self, v: f64) -> RowMap {
        let t = 2.0 * v / self.size[1] - 1.0;
        let w = [t * (t - 1.0) / 2.0, 1.0 - t * t, t * (t + 1.0) / 2.0];
        let [p, q, r] = std::array::from_fn(|col| {
            self.knots[0][col] * w[0] + self.knots[1][col] * w[1] + self.knots[2][col] * w[2]
        });
        RowMap { a: q, b: (r - p) / 2.0, c: (p + r) / 2.0 - q, scale: 2.0 / self.size[0] }
    }
}

impl RowMap {
    /// The point `u` pixels right of the tile's left edge.
    fn at(&self, u: f64) -> Vector2<f64> {
        let t = u * self.scale - 1.0;
        self.a + (self.b + self.c * t) * t
    }
}
