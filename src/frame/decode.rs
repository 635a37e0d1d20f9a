//! Decodes PNG, JPEG, TIFF, BMP and PNM by content, within limits, to one gray channel.

use std::borrow::Cow;
use std::io::{BufReader, Cursor};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageReader, Limits};

use crate::error::{Error, Result};
use crate::frame::{Frame, Gray, grays, jpeg};
use crate::input;

/// Largest side of a picture accepted, in pixels.
const MAX_SIDE_PX: u32 = 32_768;
/// Largest decoded picture accepted, in bytes; a guard against decompression bombs.
const MAX_DECODED_BYTES: u64 = 1 << 30;
/// Smallest side in which anything can be measured, in pixels.
const MIN_SIDE_PX: u32 = 16;

/// Which part of a colour picture is measured.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Default,
    clap::ValueEnum,
    serde::Serialize,
    serde::Deserialize,
    schemars::JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Channel {
    /// The channel that shows the circles best; the choice is reported
    #[default]
    Auto,
    /// 0.2126 R + 0.7152 G + 0.0722 B
    Luminance,
    /// The red channel
    Red,
    /// The green channel
    Green,
    /// The blue channel
    Blue,
}

impl Channel {
    /// The word used in files and outputs.
    pub fn word(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Luminance => "luminance",
            Self::Red => "red",
            Self::Green => "green",
            Self::Blue => "blue",
        }
    }
}

/// A decoded picture, gray or colour.
#[derive(Debug, Clone)]
pub struct Picture {
    pixels: Pixels,
    colour: bool,
    more_pages: bool,
}

/// Pixels as they were stored: gray ones are measured where they are.
#[derive(Debug, Clone)]
enum Pixels {
    Gray(Frame),
    Other(DynamicImage),
}

impl Picture {
    /// Reads a picture file. The format is told by content, never by name. A picture with an EXIF orientation
    /// other than upright is refused: a calibration holds for the sensor's own rows and columns.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        if path.is_dir() {
            return Err(Error::file(path, "is a folder", "give a picture file"));
        }
        // A pipe that nobody writes to would be waited for, for ever.
        if path.metadata().is_ok_and(|m| !m.is_file()) {
            return Err(Error::file(path, "is a pipe or a device", "give a picture file"));
        }
        let bytes = input::bytes(path, input::MOST_PICTURE)?;
        Self::decode(path, &bytes)
    }

    /// As [`Picture::read`], from bytes; `path` is only the name used in messages.
    pub fn decode(path: impl AsRef<Path>, bytes: &[u8]) -> Result<Self> {
        let path = path.as_ref();
        let fail = |e: ImageError| decode_error(path, e);
        if bytes.is_empty() {
            return Err(Error::file(path, "the file is empty", "capture the picture again"));
        }
        if jpeg::is_cut_short(bytes) {
            return Err(Error::file(
                path,
                "is cut short: it ends before the JPEG's end marker",
                "copy or capture the picture again",
            ));
        }
        let mut reader = ImageReader::new(BufReader::new(Cursor::new(bytes)))
            .with_guessed_format()
            .map_err(|e| Error::io(path, "read", e))?;
        if reader.format().is_none() {
            return Err(Error::file(
                path,
                "is not a picture in a known format",
                "give PNG, JPEG, TIFF, BMP, PGM or PNM",
            ));
        }
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_SIDE_PX);
        limits.max_image_height = Some(MAX_SIDE_PX);
        limits.max_alloc = Some(MAX_DECODED_BYTES);
        reader.limits(limits.clone());
        let mut decoder = reader.into_decoder().map_err(fail)?;
        let (width, height) = decoder.dimensions();
        if width < MIN_SIDE_PX || height < MIN_SIDE_PX {
            return Err(Error::file(
                path,
                format!("has only {width}×{height} px"),
                "give the camera's whole frame",
            ));
        }
        if decoder.total_bytes() > MAX_DECODED_BYTES || width.max(height) > MAX_SIDE_PX {
            return Err(too_large(path, width, height));
        }
        decoder.set_limits(limits).map_err(fail)?;
        if decoder.orientation().unwrap_or(Orientation::NoTransforms) != Orientation::NoTransforms {
            return Err(Error::file(
                path,
                "its EXIF orientation says that it is turned or mirrored",
                "save the sensor's own rows and columns without that tag",
            ));
        }
        let image = DynamicImage::from_decoder(decoder).map_err(fail)?;
        let colour = is_colour(&image);
        let (width, height) = (width as usize, height as usize);
        let pixels = match image {
            DynamicImage::ImageLuma8(b) => {
                Pixels::Gray(Frame::Eight(Gray { width, height, data: b.into_raw() }))
            }
            DynamicImage::ImageLuma16(b) => {
                Pixels::Gray(Frame::Sixteen(Gray { width, height, data: b.into_raw() }))
            }
            other => Pixels::Other(other),
        };
        Ok(Self { pixels, colour, more_pages: has_more_pages(bytes) })
    }

    /// Whether the channels differ anywhere.
    pub fn is_colour(&self) -> bool {
        self.colour
    }

    /// What a user should know of the file.
    pub fn doubts(&self) -> impl Iterator<Item = String> {
        let pages = self.more_pages.then(|| {
            "the file has more than one page: its first is measured; save each as a file of its own".to_owned()
        });
        let grays = self.few_grays().map(|count| {
            format!(
                "the picture has only {count} grays, far apart: between them its edges are lost and its intervals too narrow; save it with \
                 256 or more"
            )
        });
        pages.into_iter().chain(grays)
    }

    fn few_grays(&self) -> Option<usize> {
        match &self.pixels {
            Pixels::Gray(Frame::Eight(gray)) => grays::few(&gray.data),
            Pixels::Other(DynamicImage::ImageRgb8(rgb)) if !self.colour => grays::few(rgb.as_raw()),
            _ => None,
        }
    }

    /// Pixels a row and rows.
    pub fn size(&self) -> (usize, usize) {
        match &self.pixels {
            Pixels::Gray(frame) => (frame.width(), frame.height()),
            Pixels::Other(image) => (image.width() as usize, image.height() as usize),
        }
    }

    /// The channels worth trying for `choice`: one, or for a colour picture under `Auto` all of them.
    pub fn channels(&self, choice: Channel) -> Vec<Channel> {
        match choice {
            Channel::Auto if self.colour => {
                vec![Channel::Luminance, Channel::Red, Channel::Green, Channel::Blue]
            }
            Channel::Auto => vec![Channel::Luminance],
            other => vec![other],
        }
    }

    /// One channel as a gray frame, without a copy where the picture is one. `Auto` is luminance here.
    pub fn frame(&self, channel: Channel) -> Cow<'_, Frame> {
        match &self.pixels {
            Pixels::Gray(frame) => Cow::Borrowed(frame),
            Pixels::Other(image) => Cow::Owned(self.one(image, channel)),
        }
    }

    /// The same of a picture that is not needed any more.
    pub fn into_frame(self, channel: Channel) -> Frame {
        match self.pixels {
            Pixels::Gray(frame) => frame,
            Pixels::Other(ref image) => self.one(image, channel),
        }
    }

    fn one(&self, image: &DynamicImage, channel: Channel) -> Frame {
        let (width, height) = self.size();
        match image {
            other if deep(other) => {
                let rgb = other.to_rgb16();
                let data = rgb
                    .as_raw()
                    .chunks_exact(3)
                    .map(|p| pick(channel, p, self.colour) as u16)
                    .collect();
                Frame::Sixteen(Gray { width, height, data })
            }
            DynamicImage::ImageRgb8(b) => self.eight(b.as_raw(), channel),
            other => self.eight(other.to_rgb8().as_raw(), channel),
        }
    }

    fn eight(&self, rgb: &[u8], channel: Channel) -> Frame {
        let (width, height) = self.size();
        let pixels = rgb.chunks_exact(3);
        let data = match channel {
            // In whole numbers, 65536 to the one: sixteen times as fast as rounded floats.
            Channel::Auto | Channel::Luminance if self.colour => pixels
                .map(|p| {
                    let [r, g, b] = [p[0], p[1], p[2]].map(u32::from);
                    ((13_933 * r + 46_871 * g + 4_732 * b + 32_768) >> 16) as u8
                })
                .collect(),
            _ => pixels.map(|p| pick(channel, p, self.colour) as u8).collect(),
        };
        Frame::Eight(Gray { width, height, data })
    }
}

/// Whether a TIFF's first directory names another one.
fn has_more_pages(bytes: &[u8]) -> bool {
    let little = match bytes {
        [b'I', b'I', 42, 0, ..] => true,
        [b'M', b'M', 0, 42, ..] => false,
        _ => return false,
    };
    let number = |at: usize, size: usize| -> Option<usize> {
        let digits = bytes.get(at..at.checked_add(size)?)?.iter();
        let join = |n: usize, digit: &u8| n << 8 | usize::from(*digit);
        Some(if little { digits.rev().fold(0, join) } else { digits.fold(0, join) })
    };
    let next = number(4, 4).and_then(|directory| {
        let entries = number(directory, 2)?;
        number(directory + 2 + 12 * entries, 4)
    });
    next.is_some_and(|next| next != 0)
}

fn deep(image: &DynamicImage) -> bool {
    image.color().bytes_per_pixel() / image.color().channel_count() > 1
}

fn pick<T: Copy + Into<f32>>(channel: Channel, p: &[T], colour: bool) -> f32 {
    match channel {
        Channel::Red => p[0].into(),
        Channel::Green => p[1].into(),
        Channel::Blue => p[2].into(),
        _ if !colour => p[0].into(),
        _ => (0.2126 * p[0].into() + 0.7152 * p[1].into() + 0.0722 * p[2].into()).round(),
    }
}

/// Gray pictures are often stored as colour (or with a palette): they count as gray.
fn is_colour(image: &DynamicImage) -> bool {
    match image {
        DynamicImage::ImageLuma8(_)
        | DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA8(_)
        | DynamicImage::ImageLumaA16(_) => false,
        DynamicImage::ImageRgb8(b) => {
            b.as_raw().chunks_exact(3).any(|p| p[0] != p[1] || p[1] != p[2])
        }
        DynamicImage::ImageRgba8(b) => {
            b.as_raw().chunks_exact(4).any(|p| p[0] != p[1] || p[1] != p[2])
        }
        other => {
            let rgb = other.to_rgb16();
            rgb.as_raw().chunks_exact(3).any(|p| p[0] != p[1] || p[1] != p[2])
        }
    }
}

fn too_large(path: &Path, width: u32, height: u32) -> Error {
    Error::file(
        path,
        format!("claims {width}×{height} px, more than this program takes in"),
        format!(
            "give frames of at most {MAX_SIDE_PX} px a side and {} MiB decoded",
            MAX_DECODED_BYTES >> 20
        ),
    )
}

fn decode_error(path: &Path, error: ImageError) -> Error {
    match error {
        ImageError::Limits(_) => Error::file(
            path,
            "is larger than this program takes in (or claims to be)",
            format!("give frames of at most {MAX_SIDE_PX} px a side"),
        ),
        ImageError::Unsupported(e) => Error::file(
            path,
            format!("cannot be decoded: {e}"),
            "give PNG, JPEG, TIFF, BMP, PGM or PNM",
        ),
        other => Error::file(
            path,
            format!("is damaged or cut short: {other}"),
            "copy or capture the picture again",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded(image: &DynamicImage, format: image::ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn formats_are_told_by_content_and_depth_is_kept() {
        let gray = DynamicImage::ImageLuma16(image::ImageBuffer::from_fn(20, 17, |x, y| {
            image::Luma([(x * 1000 + y) as u16])
        }));
        for format in [image::ImageFormat::Png, image::ImageFormat::Tiff, image::ImageFormat::Pnm] {
            let frame = Picture::decode("misnamed.jpg", &encoded(&gray, format))
                .unwrap()
                .into_frame(Channel::Auto);
            let Frame::Sixteen(g) = frame else { panic!("{format:?} lost its depth") };
            assert_eq!((g.width, g.height, g.data[21]), (20, 17, 1001), "{format:?}");
        }
        let colour = DynamicImage::ImageRgb8(image::ImageBuffer::from_fn(20, 17, |x, _| {
            image::Rgb([x as u8, 7, 9])
        }));
        let picture = Picture::decode("c.bmp", &encoded(&colour, image::ImageFormat::Bmp)).unwrap();
        assert!(picture.is_colour());
        let Frame::Eight(red) = &*picture.frame(Channel::Red) else { panic!() };
        assert_eq!(red.row(3)[5], 5);
    }

    #[test]
    fn further_pages_are_told() {
        let gray = DynamicImage::ImageLuma8(image::GrayImage::from_pixel(20, 17, image::Luma([9])));
        let mut tiff = encoded(&gray, image::ImageFormat::Tiff);
        assert_eq!(Picture::decode("p.tif", &tiff).unwrap().doubts().next(), None);
        let at = u32::from_le_bytes(tiff[4..8].try_into().unwrap()) as usize;
        let entries = usize::from(u16::from_le_bytes(tiff[at..at + 2].try_into().unwrap()));
        tiff[at + 2 + 12 * entries] = 8;
        assert!(
            Picture::decode("p.tif", &tiff).unwrap().doubts().next().unwrap().contains("first")
        );
    }

    #[test]
    fn bad_pictures_are_refused_with_their_name() {
        let gray =
            DynamicImage::ImageLuma8(image::ImageBuffer::from_pixel(40, 40, image::Luma([9])));
        let png = encoded(&gray, image::ImageFormat::Png);
        let mut bomb = png.clone();
        bomb[16..24].copy_from_slice(&[0, 1, 134, 160, 0, 1, 134, 160]); // 100 000 × 100 000
        for (bytes, words) in [
            (&b""[..], "empty"),
            (b"hello, this is text", "not a picture"),
            (&png[..png.len() / 2], "damaged or cut short"),
            (&bomb, ""),
        ] {
            let message = Picture::decode("p.png", bytes).unwrap_err().to_string();
            assert!(message.starts_with("p.png: ") && message.contains(words), "{message}");
        }
    }
}
