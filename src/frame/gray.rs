//! Gray pixels of any depth, and pictures reduced by averaging blocks.

use std::ops::{AddAssign, Range};

use nalgebra::Vector2;

/// A pixel value that measures as a number.
pub trait Sample: Copy + Send + Sync + 'static {
    /// The value in the file's own counts.
    fn value(self) -> f32;
}

impl Sample for u8 {
    fn value(self) -> f32 {
        f32::from(self)
    }
}

impl Sample for u16 {
    fn value(self) -> f32 {
        f32::from(self)
    }
}

impl Sample for f32 {
    fn value(self) -> f32 {
        self
    }
}

/// A camera's pixel, which can be joined with others.
pub trait Pixel: Sample {
    /// Holds the sum of [`MOST_JOINED`] pixels; the narrower, the more of them are added at once.
    type Sum: Copy + Default + AddAssign + From<Self> + Into<u32>;
}

impl Pixel for u8 {
    type Sum = u16;
}

impl Pixel for u16 {
    type Sum = u32;
}

/// Most pixels that are joined each way.
pub const MOST_JOINED: usize = 256;

/// A gray picture, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Gray<T> {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width · height` values.
    pub data: Vec<T>,
}

impl<T: Sample> Gray<T> {
    /// One row of pixels.
    pub fn row(&self, v: usize) -> &[T] {
        &self.data[v * self.width..(v + 1) * self.width]
    }

    fn part(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        let (width, height) = (columns.len(), rows.len());
        let mut data = Vec::with_capacity(width * height);
        rows.for_each(|v| data.extend_from_slice(&self.row(v)[columns.clone()]));
        Self { width, height, data }
    }
}

impl<T: Pixel> Gray<T> {
    /// The mean of each `factor`×`factor` block, a factor of [`MOST_JOINED`] at most; an incomplete block at the right or bottom is left out.
    /// Pixel (i, j) of the result is centred on `factor·i + (factor - 1)/2` of this picture.
    pub fn reduce(&self, factor: usize) -> Gray<f32> {
        let factor = factor.clamp(1, MOST_JOINED);
        let (width, height) = (self.width / factor, self.height / factor);
        let mut data = Vec::with_capacity(width * height);
        let mut columns = Vec::new();
        for j in 0..height {
            self.blocks(factor, j, 0..width, &mut columns, &mut data);
        }
        Gray { width, height, data }
    }

    /// Appends the means of blocks `range` of row `j` of the reduced picture to `means`. `columns` is room to work in.
    pub(crate) fn blocks(
        &self,
        factor: usize,
        j: usize,
        range: std::ops::Range<usize>,
        columns: &mut Vec<T::Sum>,
        means: &mut Vec<f32>,
    ) {
        let part = range.start * factor..range.end * factor;
        if factor == 1 {
            means.extend(self.row(j)[part].iter().map(|p| p.value()));
            return;
        }
        columns.clear();
        columns.resize(part.len(), T::Sum::default());
        for v in j * factor..(j + 1) * factor {
            for (sum, p) in columns.iter_mut().zip(&self.row(v)[part.clone()]) {
                *sum += T::Sum::from(*p);
            }
        }
        match factor {
            2 => joined::<2, _>(columns, means),
            3 => joined::<3, _>(columns, means),
            4 => joined::<4, _>(columns, means),
            5 => joined::<5, _>(columns, means),
            6 => joined::<6, _>(columns, means),
            7 => joined::<7, _>(columns, means),
            8 => joined::<8, _>(columns, means),
            10 => joined::<10, _>(columns, means),
            _ => {
                let scale = 1.0 / (factor * factor) as f32;
                let sum = |block: &[T::Sum]| block.iter().map(|&s| s.into()).sum::<u32>();
                means.extend(columns.chunks_exact(factor).map(|b| scale * sum(b) as f32));
            }
        }
    }
}

/// Appends the means of blocks of `N`² pixels to `means`, from the sums of their columns; a number that is known is several times as fast.
fn joined<const N: usize, S: Copy + Into<u32>>(columns: &[S], means: &mut Vec<f32>) {
    let scale = 1.0 / (N * N) as f32;
    let blocks = columns.as_chunks::<N>().0;
    means.extend(blocks.iter().map(|b| scale * b.iter().map(|&s| s.into()).sum::<u32>() as f32));
}

/// A gray frame as decoded.
#[derive(Debug, Clone, PartialEq)]
pub enum Frame {
    /// Up to 8 bits a pixel.
    Eight(Gray<u8>),
    /// Up to 16 bits a pixel.
    Sixteen(Gray<u16>),
}

impl Frame {
    /// Pixels a row.
    pub fn width(&self) -> usize {
        match self {
            Self::Eight(g) => g.width,
            Self::Sixteen(g) => g.width,
        }
    }

    /// Rows.
    pub fn height(&self) -> usize {
        match self {
            Self::Eight(g) => g.height,
            Self::Sixteen(g) => g.height,
        }
    }

    /// See [`Gray::reduce`].
    pub fn reduce(&self, factor: usize) -> Gray<f32> {
        match self {
            Self::Eight(g) => g.reduce(factor),
            Self::Sixteen(g) => g.reduce(factor),
        }
    }

    /// What lies within `reach_px` of a place, each way, and the place of its first pixel.
    pub fn part(&self, middle: Vector2<f64>, reach_px: f64) -> (Self, Vector2<f64>) {
        let span = |at: f64, size: usize| {
            let limit = |v: f64| v.clamp(0.0, size as f64) as usize;
            limit((at - reach_px).floor())..limit((at + reach_px).ceil() + 1.0)
        };
        let (columns, rows) = (span(middle.x, self.width()), span(middle.y, self.height()));
        let corner = Vector2::new(columns.start as f64, rows.start as f64);
        let part = match self {
            Self::Eight(g) => Self::Eight(g.part(columns, rows)),
            Self::Sixteen(g) => Self::Sixteen(g.part(columns, rows)),
        };
        (part, corner)
    }

    /// The light that a sensor has counted whose counts are proportional to its power of `1 / gamma`.
    pub fn linear(self, gamma: f64) -> Self {
        let light = |count: f64| (65535.0 * count.powf(gamma)).round() as u16;
        match self {
            Self::Eight(g) => {
                let table: Vec<u16> = (0..=255u8).map(|c| light(f64::from(c) / 255.0)).collect();
                let data = g.data.iter().map(|&c| table[usize::from(c)]).collect();
                Self::Sixteen(Gray { width: g.width, height: g.height, data })
            }
            Self::Sixteen(mut g) => {
                // Ten or twelve bits may lie in the lower ones.
                let most = g.data.iter().copied().max().unwrap_or(1).max(1);
                let full = u16::MAX >> most.leading_zeros();
                let table: Vec<u16> =
                    (0..=full).map(|c| light(f64::from(c) / f64::from(full))).collect();
                g.data.iter_mut().for_each(|c| *c = table[usize::from(*c)]);
                Self::Sixteen(g)
            }
        }
    }

    /// 8-bit copy for overlays, the picture's own range stretched where it holds more than 8 bits.
    pub fn to_eight(&self) -> Gray<u8> {
        match self {
            Self::Eight(g) => g.clone(),
            Self::Sixteen(g) => {
                let top = f32::from(g.data.iter().copied().max().unwrap_or(1).max(1));
                let data = g.data.iter().map(|&p| (f32::from(p) * 255.0 / top) as u8).collect();
                Gray { width: g.width, height: g.height, data }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_linear_in_whatever_bits_it_was_counted_and_black_stays_black() {
        let sixteen =
            |data: [u16; 2]| Frame::Sixteen(Gray { width: 2, height: 1, data: data.into() });
        assert_eq!(sixteen([0, 0]).linear(2.2), sixteen([0, 0]));
        assert_eq!(sixteen([0, 4095]).linear(2.2), sixteen([0, 65535]));
        let eight = Frame::Eight(Gray { width: 2, height: 1, data: vec![51, 255] });
        assert_eq!(eight.linear(2.0), sixteen([2621, 65535]));
    }

    #[test]
    fn reducing_averages_whole_blocks() {
        let g = Gray { width: 5, height: 2, data: vec![1u8, 3, 5, 7, 100, 1, 3, 5, 7, 100] };
        assert_eq!(g.reduce(2), Gray { width: 2, height: 1, data: vec![2.0, 6.0] });
    }
}
