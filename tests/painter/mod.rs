//! Pictures painted from a brightness that is known everywhere.
#![allow(dead_code)] // Each test has its own use of it.

pub mod burn;

use nalgebra::Vector2;
use pivotsight::frame::Picture;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

/// A picture of what is `level` counts bright at a place, in 4×4 parts of each pixel, with ±1.5 counts of noise.
pub fn picture(level: impl Fn(Vector2<f64>) -> f64) -> Picture {
    let mut noise = noise();
    opened(image::GrayImage::from_fn(WIDTH, HEIGHT, |u, v| {
        image::Luma([seen(&level, u, v, &mut noise)])
    }))
}

/// The same in red, green and blue.
pub fn colour_picture(level: impl Fn(Vector2<f64>, usize) -> f64) -> Picture {
    let mut noise = noise();
    opened(image::RgbImage::from_fn(WIDTH, HEIGHT, |u, v| {
        image::Rgb([0, 1, 2].map(|channel| seen(&|p| level(p, channel), u, v, &mut noise)))
    }))
}

fn noise() -> impl FnMut() -> f64 {
    let mut state = 7u32;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        3.0 * (f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5)
    }
}

fn seen(
    level: &impl Fn(Vector2<f64>) -> f64,
    u: u32,
    v: u32,
    noise: &mut impl FnMut() -> f64,
) -> u8 {
    let part = |k: u32| {
        let at = |p: u32, k: u32| f64::from(p) + (f64::from(k) - 1.5) / 4.0;
        level(Vector2::new(at(u, k % 4), at(v, k / 4)))
    };
    let mean = (0..16).map(part).sum::<f64>() / 16.0;
    (mean + noise()).round().clamp(0.0, 255.0) as u8
}

/// A picture as it is read from a file.
pub fn opened<P: image::PixelWithColorType<Subpixel = u8>>(
    pixels: image::ImageBuffer<P, Vec<u8>>,
) -> Picture {
    let mut png = std::io::Cursor::new(Vec::new());
    pixels.write_to(&mut png, image::ImageFormat::Png).unwrap();
    Picture::decode("painted", png.get_ref()).unwrap()
}
