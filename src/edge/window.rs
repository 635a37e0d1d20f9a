//! A square of the picture about a small mark, in blocks of pixels, and where each block lies about the mark's contour.

use nalgebra::{DMatrix, Vector2};

use crate::edge::Contour;
use crate::frame::{Frame, Gray, Pixel};

/// A square part of the picture in blocks.
pub(super) struct Window {
    /// Middle of its first block, and pixels a block.
    start_px: Vector2<f64>,
    pub(super) factor: f64,
    /// The blocks' values, x by y; NaN outside the frame.
    pub(super) values: DMatrix<f64>,
}

impl Window {
    /// Blocks of `factor` pixels each way within `half_px` of a place. `None` where that is outside the frame.
    pub(super) fn read(
        frame: &Frame,
        factor: usize,
        middle: Vector2<f64>,
        half_px: f64,
    ) -> Option<Self> {
        match frame {
            Frame::Eight(g) => Self::of(g, factor, middle, half_px),
            Frame::Sixteen(g) => Self::of(g, factor, middle, half_px),
        }
    }

    fn of<T: Pixel>(
        image: &Gray<T>,
        factor: usize,
        middle: Vector2<f64>,
        half_px: f64,
    ) -> Option<Self> {
        let k = factor as f64;
        let size = (2.0 * half_px / k).ceil() as i64;
        let first = middle.map(|v| ((v - half_px) / k).floor() as i64);
        let within = |from: i64, limit: usize| {
            let clip = |v: i64| v.clamp(0, (limit / factor) as i64) as usize;
            clip(from)..clip(from + size)
        };
        let (columns, rows) = (within(first.x, image.width), within(first.y, image.height));
        if columns.is_empty() || rows.is_empty() {
            return None;
        }
        let mut values = DMatrix::from_element(size as usize, size as usize, f64::NAN);
        let (mut room, mut means) = (Vec::new(), Vec::new());
        for j in rows {
            means.clear();
            image.blocks(factor, j, columns.clone(), &mut room, &mut means);
            let x = (columns.start as i64 - first.x) as usize;
            let mut column = values.column_mut((j as i64 - first.y) as usize);
            column.iter_mut().skip(x).zip(&means).for_each(|(v, m)| *v = f64::from(*m));
        }
        let start_px = first.map(|v| v as f64 * k + 0.5 * (k - 1.0));
        Some(Self { start_px, factor: k, values })
    }

    /// Where each block lies about the contour; `None` where it does not count.
    pub(super) fn blocks(
        &self,
        contour: &Contour,
        places: usize,
        glare: Option<f32>,
        sides_px: (f64, f64),
        alive: &[bool],
    ) -> DMatrix<Option<Block>> {
        let size = self.values.nrows();
        let per_rad = places as f64 / std::f64::consts::TAU;
        DMatrix::from_fn(size, size, |i, j| {
            let value = self.values[(i, j)];
            let bright = glare.is_some_and(|g| value >= 0.99 * f64::from(g));
            if bright || value.is_nan() {
                return None;
            }
            let place =
                self.start_px + self.factor * Vector2::new(i as f64, j as f64) - contour.origin_px;
            let turn =
                (place.y.atan2(place.x) - contour.start_rad).rem_euclid(std::f64::consts::TAU);
            let (radius, cos) = contour.at(turn);
            let distance_px = (place.norm() - radius) * cos;
            let at = turn * per_rad;
            let (before, share) = (at as usize % places, at.fract());
            let after = (before + 1) % places;
            let within = distance_px > -sides_px.0 && distance_px < sides_px.1;
            (within && alive[before] && alive[after]).then_some(Block {
                distance_px,
                places: [(before, 1.0 - share), (after, share)],
                off: place / contour.mean_radius_px(),
            })
        })
    }
}

/// A block that counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Block {
    pub(super) distance_px: f64,
    /// The two places round the contour that it lies between, and its share of each.
    pub(super) places: [(usize, f64); 2],
    /// From the middle, in radii.
    pub(super) off: Vector2<f64>,
}
