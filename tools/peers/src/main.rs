//! Times decoding, colour to gray and reducing with what Pivotsight uses and with kornia, on one thread. Medians in ms.

use std::hint::black_box;
use std::time::Instant;

use image::{ExtendedColorType, ImageEncoder};
use kornia_image::color_spaces::{Gray8, Rgb8};
use kornia_image::{Image, ImageSize};
use kornia_imgproc::interpolation::InterpolationMode;
use pivotsight::frame::{Channel, Gray, Picture};
use pivotsight::live::Shot;

const W: usize = 4000;
const H: usize = 3000;

fn time<T>(name: &str, mut job: impl FnMut() -> T) {
    let mut times: Vec<f64> = (0..9)
        .map(|_| {
            let start = Instant::now();
            black_box(job());
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("{name:<58} {:7.1}", times[times.len() / 2]);
}

fn main() {
    // A ring on noisy metal: compresses as real frames do.
    let gray: Vec<u8> = (0..W * H)
        .map(|i| {
            let (x, y) = ((i % W) as f64 - 2000.0, (i / W) as f64 - 1500.0);
            let noise = ((i as u64).wrapping_mul(6364136223846793005) >> 60) as f64 - 7.5;
            let edge = 1.0 / (1.0 + ((x.hypot(y) - 800.0) / 3.0).exp());
            (190.0 - 140.0 * edge + 0.6 * noise) as u8
        })
        .collect();
    let rgb: Vec<u8> = gray.iter().flat_map(|&g| [g, g, g.saturating_sub(5)]).collect();
    let png = |data: &[u8], kind| {
        let mut bytes = Vec::new();
        image::codecs::png::PngEncoder::new(&mut bytes).write_image(data, W as u32, H as u32, kind).unwrap();
        bytes
    };
    let jpeg = |data: &[u8], kind| {
        let mut bytes = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90)
            .encode(data, W as u32, H as u32, kind)
            .unwrap();
        bytes
    };
    let size = ImageSize { width: W, height: H };
    let (png_gray, png_rgb) = (png(&gray, ExtendedColorType::L8), png(&rgb, ExtendedColorType::Rgb8));
    let (jpeg_gray, jpeg_rgb) = (jpeg(&gray, ExtendedColorType::L8), jpeg(&rgb, ExtendedColorType::Rgb8));
    let mut mono = Gray8::from_size_val(size, 0).unwrap();
    let mut colour = Rgb8::from_size_val(size, 0).unwrap();
    println!("{W}×{H}, one thread, median of 9, ms");
    time("PNG gray      image (used)", || Picture::decode("p", &png_gray).unwrap());
    time("PNG gray      kornia-io", || kornia_io::png::decode_image_png_mono8(&png_gray, &mut mono).unwrap());
    time("PNG colour    image (used)", || image::load_from_memory(&png_rgb).unwrap());
    time("PNG colour    kornia-io", || kornia_io::png::decode_image_png_rgb8(&png_rgb, &mut colour).unwrap());
    time("JPEG gray     image (used for files)", || Picture::decode("p", &jpeg_gray).unwrap());
    time("JPEG gray     kornia-io", || kornia_io::jpeg::decode_image_jpeg_mono8(&jpeg_gray, &mut mono.0).unwrap());
    time("JPEG colour   image (used for files)", || image::load_from_memory(&jpeg_rgb).unwrap());
    time("JPEG colour   kornia-io", || kornia_io::jpeg::decode_image_jpeg_rgb8(&jpeg_rgb, &mut colour.0).unwrap());
    let shot = Shot::Encoded(jpeg_rgb.clone(), None);
    time("JPEG colour to luma   zune-jpeg (used live)", || shot.frame().unwrap());
    let picture = Picture::decode("p", &png_rgb).unwrap();
    time("colour to gray        Pivotsight (used)", || picture.frame(Channel::Luminance));
    let image = Image::<u8, 3>::new(size, rgb.clone()).unwrap();
    let mut out = Image::<u8, 1>::from_size_val(size, 0).unwrap();
    time("colour to gray        kornia-imgproc", || {
        kornia_imgproc::color::gray_from_rgb_u8(&image, &mut out).unwrap();
    });
    let ours = Gray { width: W, height: H, data: gray.clone() };
    time("reduce 10 ×, mean of blocks   Pivotsight (used)", || ours.reduce(10));
    let source = Image::<u8, 1>::new(size, gray).unwrap();
    let mut small = Image::<u8, 1>::from_size_val(ImageSize { width: W / 10, height: H / 10 }, 0).unwrap();
    for (name, mode) in [("bilinear", InterpolationMode::Bilinear), ("cubic, antialiased", InterpolationMode::Bicubic)] {
        time(&format!("reduce 10 ×, {name}   kornia-imgproc"), || {
            kornia_imgproc::resize::resize_fast_mono(&source, &mut small, mode).unwrap();
        });
    }
}
