//! The discs of the anchors' comparison as pictures, so that programs in other languages can measure the same ones.

use std::fmt::Write;
use std::path::Path;

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::Result;
use pivotsight::frame::{Channel, Picture};
use pivotsight::measure::circles;
use pivotsight::output::{create_folder, write_whole};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::paint::{Canvas, Sensor};

const RADIUS_PX: f64 = 65.3;
const SIDE: usize = 220;

/// Writes `count` discs of each difficulty as 8-bit graymaps, with `discs.csv`: file, difficulty, true centre and what the
/// program measures.
pub fn write(folder: &str, count: u64) -> Result<()> {
    let folder = Path::new(folder);
    create_folder(folder)?;
    let mapping = Mapping::Scale { mm_per_px: 1.0, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let options =
        circles::Options { expect_mm: vec![2.0 * RADIUS_PX], channel: Channel::default() };
    let mut table = "file,difficulty,u_px,v_px,own_u_px,own_v_px\n".to_owned();
    for (name, blur, contrast, noise) in [("easy", 1.2, 120.0, 2.0), ("hard", 4.0, 60.0, 6.0)] {
        for i in 0..count {
            let mut rng = ChaCha8Rng::seed_from_u64(i);
            let middle = SIDE as f64 / 2.0;
            let center = Vector2::new(middle + rng.random::<f64>(), middle + rng.random::<f64>());
            let mut canvas = Canvas::new(SIDE, SIDE, 8, 90.0 / 255.0);
            canvas.paint(|p, old| {
                let inside = 0.5 - 8.0 * ((p - center).norm() - RADIUS_PX);
                old + contrast / 255.0 * inside.clamp(0.0, 1.0)
            });
            canvas.blur(blur);
            let sensor = Sensor { noise: noise / 255.0, gamma: 1.0, bits: 8 };
            let file = canvas.pgm(sensor, &mut rng);
            let path = folder.join(format!("{name}-{i:03}.pgm"));
            write_whole(&path, &file)?;
            let picture = Picture::decode(&path, &file)?;
            let own = circles::measure(&picture, &calibration, &options, "disc")
                .map_or([f64::NAN; 2], |m| m.report.circles[0].circle.center_px);
            let _ = writeln!(
                table,
                "{name}-{i:03}.pgm,{name},{},{},{},{}",
                center.x, center.y, own[0], own[1]
            );
        }
    }
    write_whole(folder.join("discs.csv"), table.as_bytes())
}
