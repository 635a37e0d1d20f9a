//! Surfaces of the second renderer: brushed, grainy and turned metal as random fields over the plane.

use nalgebra::{Rotation2, Vector2};

use super::dice::Dice;

/// Smallest pitch of a field; finer structure is lost in a pixel.
const PITCH_MM: f64 = 0.006;
/// Correlation in cells: what interpolation between the cells does not harm.
const CELLS_A_LENGTH: f64 = 1.6;
const MOST_CELLS: usize = 2048;

/// A field of mean 0 and standard deviation `size`, Gaussian-correlated along and across a direction. It repeats, far off.
struct Layer {
    size: f64,
    /// Turns the plane so that x runs along the streaks.
    turn: Rotation2<f64>,
    pitch_mm: [f64; 2],
    cells: [usize; 2],
    values: Vec<f32>,
}

impl Layer {
    fn new(size: f64, angle: f64, length_mm: [f64; 2], dice: &mut Dice) -> Self {
        let pitch_mm = length_mm.map(|l| (l / CELLS_A_LENGTH).max(PITCH_MM));
        // A power of two that covers the frame, so that places wrap with a mask.
        let mut cells =
            pitch_mm.map(|p| ((16.0 / p) as usize).next_power_of_two().clamp(16, MOST_CELLS));
        if cells[0] * cells[1] > MOST_CELLS * MOST_CELLS / 4 {
            cells = cells.map(|c| c / 2);
        }
        let mut values: Vec<f32> = (0..cells[0] * cells[1]).map(|_| dice.normal() as f32).collect();
        for axis in 0..2 {
            smooth(&mut values, cells, axis, length_mm[axis] / pitch_mm[axis]);
        }
        let square: f64 = values.iter().map(|v| f64::from(*v).powi(2)).sum();
        let unit = (values.len() as f64 / square).sqrt() as f32;
        values.iter_mut().for_each(|v| *v *= unit);
        Self { size, turn: Rotation2::new(-angle), pitch_mm, cells, values }
    }

    fn at(&self, plane_mm: Vector2<f64>) -> f64 {
        let p = self.turn * plane_mm;
        let (x, y) = (p.x / self.pitch_mm[0], p.y / self.pitch_mm[1]);
        let (i, j) = (x.floor(), y.floor());
        let (a, b) = ((x - i) as f32, (y - j) as f32);
        let (right, down) = (self.cells[0] - 1, self.cells[1] - 1);
        let (i, j) = (i as isize as usize, j as isize as usize);
        let columns = [i & right, i.wrapping_add(1) & right];
        let rows = [j & down, j.wrapping_add(1) & down].map(|r| r * self.cells[0]);
        let across = |r: usize| {
            let left = self.values[r + columns[0]];
            left + a * (self.values[r + columns[1]] - left)
        };
        let (top, bottom) = (across(rows[0]), across(rows[1]));
        self.size * f64::from(top + b * (bottom - top))
    }
}

/// Gaussian along one axis of a periodic grid.
fn smooth(values: &mut [f32], cells: [usize; 2], axis: usize, sigma_cells: f64) {
    let reach = (3.0 * sigma_cells).ceil() as isize;
    let weight = |k: isize| (-0.5 * (k as f64 / sigma_cells).powi(2)).exp() as f32;
    let weights: Vec<f32> = (-reach..=reach).map(weight).collect();
    let (count, step, lines, apart) = match axis {
        0 => (cells[0], 1, cells[1], cells[0]),
        _ => (cells[1], cells[0], cells[0], 1),
    };
    let mut line = vec![0.0_f32; count];
    for l in 0..lines {
        for (i, out) in line.iter_mut().enumerate() {
            let around = weights.iter().zip(-reach..).map(|(w, k)| {
                let from = (i as isize + k) as usize & (count - 1);
                w * values[l * apart + from * step]
            });
            *out = around.sum();
        }
        for (i, out) in line.iter().enumerate() {
            values[l * apart + i * step] = *out;
        }
    }
}

/// A surface's texture: several layers.
pub struct Texture(Vec<Layer>);

impl Texture {
    pub fn none() -> Self {
        Self(Vec::new())
    }

    /// Streaks of several lengths and widths about one direction, with grain and clouds. `size` is the standard deviation.
    pub fn brushed(size: f64, angle: f64, dice: &mut Dice) -> Self {
        let mut layers = Vec::new();
        let streaks = [
            ([0.15, 0.5], [0.008, 0.014]),
            ([0.5, 1.5], [0.012, 0.03]),
            ([1.5, 5.0], [0.02, 0.09]),
        ];
        for ([short, long], [thin, wide]) in streaks {
            let length_mm = [dice.between_log((short, long)), dice.between_log((thin, wide))];
            let (part, way) = (dice.between((0.35, 0.75)), angle + 0.02 * dice.normal());
            layers.push(Layer::new(size * part, way, length_mm, dice));
        }
        let grain_mm = dice.between((0.008, 0.012));
        layers.push(Layer::new(size * dice.between((0.1, 0.4)), 0.0, [grain_mm; 2], dice));
        let cloud_mm = dice.between((0.3, 1.5));
        layers.push(Layer::new(size * dice.between((0.1, 0.4)), 0.0, [cloud_mm; 2], dice));
        Self(layers)
    }

    /// The same in all directions: grain and blotches.
    pub fn mottled(size: f64, length_mm: (f64, f64), dice: &mut Dice) -> Self {
        let lengths_mm = [dice.between_log(length_mm), dice.between_log(length_mm)];
        let layers = lengths_mm.map(|l| {
            let part = dice.between((0.5, 0.9));
            Layer::new(size * part, dice.angle(), [l; 2], dice)
        });
        Self(layers.into())
    }

    pub fn at(&self, plane_mm: Vector2<f64>) -> f64 {
        self.0.iter().map(|l| l.at(plane_mm)).sum()
    }
}

/// A faced or turned surface: rings about the lathe's centre, brightest across the lamp, and a bow-tie of light.
pub struct Turned {
    centre_mm: Vector2<f64>,
    /// Ring by radius, `PITCH_MM` apart.
    rings: Vec<f64>,
    bow_tie: f64,
}

impl Turned {
    pub fn new(size: f64, dice: &mut Dice) -> Self {
        let feed_mm = dice.between((0.03, 0.15));
        let phase = dice.angle();
        let rings = (0..4096).map(|i| {
            let r_mm = f64::from(i) * PITCH_MM;
            let cut = (std::f64::consts::TAU * r_mm / feed_mm + phase).sin();
            size * (0.8 * cut + 0.6 * dice.normal())
        });
        let rings: Vec<f64> = rings.collect();
        let rings = rings.windows(3).map(|w| 0.25 * w[0] + 0.5 * w[1] + 0.25 * w[2]).collect();
        let (away_mm, way) = (dice.between((0.0, 0.1)), dice.angle());
        Self {
            centre_mm: Vector2::new(way.cos(), way.sin()) * away_mm,
            rings,
            bow_tie: dice.between((0.5, 2.5)) * size,
        }
    }

    /// `lamp` is the direction the light comes from.
    pub fn at(&self, plane_mm: Vector2<f64>, lamp: Vector2<f64>) -> f64 {
        let p = plane_mm - self.centre_mm;
        let (x, r_mm) = (p.norm() / PITCH_MM, p.norm().max(1e-9));
        let i = (x as usize).min(self.rings.len() - 2);
        let ring = self.rings[i] + (x - i as f64).min(1.0) * (self.rings[i + 1] - self.rings[i]);
        let toward = p.dot(&lamp) / r_mm;
        let bow = 2.0 * toward * toward - 1.0;
        ring * (0.6 + 0.4 * bow) + self.bow_tie * bow
    }
}
