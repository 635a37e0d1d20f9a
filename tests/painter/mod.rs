//! Pictures painted from a brightness that is known everywhere.

use nalgebra::Vector2;
use pivotsight::frame::Picture;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

/// A picture of what is `level` counts bright at a place, in 4×4 parts of each pixel, with ±1.5 counts of noise.
pub fn picture(level: impl Fn(Vector2<f64>) -> f64) -> Picture {
    let mut state = 7u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        3.0 * (f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5)
    };
    let gray = image::GrayImage::from_fn(WIDTH, HEIGHT, |u, v| {
        let part = |k: u32| {
            let at = |p: u32, k: u32| f64::from(p) + (f64::from(k) - 1.5) / 4.0;
            level(Vector2::new(at(u, k % 4), at(v, k / 4)))
        };
        let mean = (0..16).map(part).sum::<f64>() / 16.0;
        image::Luma([(mean + noise()).round().clamp(0.0, 255.0) as u8])
    });
    let mut png = std::io::Cursor::new(Vec::new());
    gray.write_to(&mut png, image::ImageFormat::Png).unwrap();
    Picture::decode("painted", png.get_ref()).unwrap()
}
