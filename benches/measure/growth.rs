//! Time against pixels and against edge length.

use std::path::Path;

use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::Result;
use pivotsight::frame::Picture;
use pivotsight::measure::burn;
use pivotsight::output::write_whole;
use pivotsight::plot::{Figure, Panel};

use crate::work::{median_ms, one_thread};

/// Draws both plots to a file and prints the numbers.
pub fn plot(path: &str) -> Result<()> {
    let pixels: Vec<(f64, f64)> = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0f64]
        .into_iter()
        .map(|megapixels| {
            let height = (megapixels * 1e6 / (4.0 / 3.0)).sqrt();
            (megapixels, time(height, 0.3 * height))
        })
        .collect();
    let edges: Vec<(f64, f64)> = [300.0, 450.0, 600.0, 750.0, 900.0, 1050.0, 1200.0, 1350.0]
        .into_iter()
        // Two circles: the spot is a fourth of the ring.
        .map(|radius| (2.5e-3 * std::f64::consts::PI * radius, time(3000.0, radius)))
        .collect();
    let figure = Figure::new("Time of one measurement after decoding, one thread")
        .panel(panel("frame, megapixels", "ring's radius 0.3 of the height", &pixels))
        .panel(panel("edge of ring and spot, 1000 px", "12 megapixels", &edges));
    write_whole(Path::new(path), figure.to_svg().as_bytes())
}

/// Measured times, and the line in proportion through the last.
fn panel(x: &str, title: &str, points: &[(f64, f64)]) -> Panel {
    for (x, ms) in points {
        println!("{title}: {x:.2}: {ms:.1} ms");
    }
    let last = points[points.len() - 1];
    Panel::new(x, "ms")
        .title(title)
        .points("measured", points)
        .line("in proportion", &[(0.0, 0.0), last])
}

/// Time to measure a burn in a frame of this height; not a number where it cannot be.
fn time(height: f64, radius: f64) -> f64 {
    let picture = paint((height * 4.0 / 3.0) as usize, height as usize, radius);
    let mapping = Mapping::Scale { mm_per_px: 0.003, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let options = burn::Options::default();
    one_thread(|| match burn::measure(&picture, &calibration, &options, "bench") {
        Ok(_) => median_ms(5, || burn::measure(&picture, &calibration, &options, "bench")),
        Err(e) => {
            println!("height {height:.0} px, radius {radius:.0} px: {e}");
            f64::NAN
        }
    })
}

/// A dark disc with a bright spot, edges 2 px soft, with some noise.
fn paint(width: usize, height: usize, radius: f64) -> Picture {
    let (x0, y0) = (0.5 * width as f64 + 0.3, 0.5 * height as f64 - 0.2);
    let mut noise = 1u64;
    let mut bytes = format!("P5\n{width} {height}\n255\n").into_bytes();
    for v in 0..height {
        for u in 0..width {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let r = (u as f64 - x0).hypot(v as f64 - y0);
            let edge = |radius: f64| (0.5 - 0.25 * (r - radius)).clamp(0.0, 1.0);
            let level = 170.0 - 120.0 * edge(radius) + 140.0 * edge(0.25 * radius);
            bytes.push((level + (noise >> 61) as f64) as u8);
        }
    }
    Picture::decode("painted", &bytes).expect("a graymap is a picture")
}
