//! A finished picture and its PNG file.

use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::error::{Error, Result};
use crate::output::write_whole;

/// Pixels as a camera delivers them, row by row, channels interleaved.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Width.
    pub width_px: usize,
    /// Height.
    pub height_px: usize,
    /// 1 (gray) or 3 (red, green, blue).
    pub channels: usize,
    /// 8, 12 or 16: values reach 2^bits - 1.
    pub bits: u8,
    /// width · height · channels values.
    pub values: Vec<u16>,
}

impl Picture {
    /// One channel as numbers between 0 and 1, full scale of its bits.
    pub fn channel(&self, channel: usize) -> Vec<f32> {
        let full = f32::from(u16::MAX >> (16 - self.bits));
        self.values
            .iter()
            .skip(channel)
            .step_by(self.channels)
            .map(|&v| f32::from(v) / full)
            .collect()
    }

    /// The picture as PNG: 8 bits as such, 12 and 16 bits in 16.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let encoder =
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
        let (data, colour): (Vec<u8>, _) = match (self.bits, self.channels) {
            (8, c) => {
                let colour = if c == 3 { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 };
                (self.values.iter().map(|&v| v.min(255) as u8).collect(), colour)
            }
            (_, c) => {
                let colour = if c == 3 { ExtendedColorType::Rgb16 } else { ExtendedColorType::L16 };
                // The encoder takes 16-bit samples in the machine's own byte order.
                (self.values.iter().flat_map(|v| v.to_ne_bytes()).collect(), colour)
            }
        };
        encoder.write_image(&data, self.width_px as u32, self.height_px as u32, colour).map_err(
            |e| Error::measure("picture", format!("cannot be encoded ({e})"), "report this"),
        )?;
        Ok(bytes)
    }

    /// Writes the picture as PNG, whole or not at all.
    pub fn write_png(&self, path: impl AsRef<Path>) -> Result<()> {
        write_whole(path, &self.png()?)
    }
}
