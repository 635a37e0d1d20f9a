//! Pictures of discs, rings, bars and noise anywhere: circles and burns are measured in them or refused.
#![no_main]

use libfuzzer_sys::arbitrary::{self, Arbitrary};
use libfuzzer_sys::fuzz_target;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::frame::Picture;
use pivotsight::measure::{burn, circles};

/// One mark: a disc, a ring or a bar.
#[derive(Debug, Arbitrary)]
struct Mark {
    kind: u8,
    middle: [u8; 2],
    size: u8,
    width: u8,
    level: u8,
    softness: u8,
}

/// A picture, small, so that many can be tried.
#[derive(Debug, Arbitrary)]
struct Painted {
    sides: [u8; 2],
    ground: u8,
    noise: u8,
    seed: u32,
    marks: Vec<Mark>,
    pixels: Vec<(u16, u8)>,
}

impl Painted {
    fn picture(&self) -> (usize, usize, Vec<u8>) {
        let [w, h] = self.sides.map(|s| 16 + usize::from(s) % 112);
        let mut light = vec![f64::from(self.ground); w * h];
        for mark in self.marks.iter().take(6) {
            let [x, y] = mark.middle.map(f64::from);
            let (size, soft) = (f64::from(mark.size) / 1.5, 0.3 + f64::from(mark.softness) / 16.0);
            for (i, value) in light.iter_mut().enumerate() {
                let (dx, dy) = ((i % w) as f64 - x, (i / w) as f64 - y);
                let far = match mark.kind % 3 {
                    0 => dx.hypot(dy) - size,
                    1 => (dx.hypot(dy) - size).abs() - f64::from(mark.width) / 8.0,
                    _ => (dx * mark.width as f64 + dy * 64.0).abs() / 64.0 - size / 4.0,
                };
                let share = 1.0 / (1.0 + (far / soft).exp());
                *value += share * (f64::from(mark.level) - *value);
            }
        }
        let mut state = self.seed | 1;
        let mut bytes: Vec<u8> = light
            .into_iter()
            .map(|value| {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                let noise = f64::from(state % 255) / 127.0 - 1.0;
                (value + noise * f64::from(self.noise) / 8.0).round().clamp(0.0, 255.0) as u8
            })
            .collect();
        for (place, value) in self.pixels.iter().take(64) {
            let place = usize::from(*place) % bytes.len();
            bytes[place] = *value;
        }
        (w, h, bytes)
    }
}

fuzz_target!(|painted: Painted| {
    let (w, h, bytes) = painted.picture();
    let file = [format!("P5\n{w} {h}\n255\n").as_bytes(), &bytes].concat();
    let picture = Picture::decode("fed.pgm", &file).expect("a picture");
    let calibration = Calibration {
        name: "fed".into(),
        mapping: Mapping::Scale { mm_per_px: 0.01, rotation_deg: 0.0 },
        laser: None,
        gamma: 1.0,
    };
    let _ = burn::measure(&picture, &calibration, &burn::Options::default(), "fed");
    let size = f64::from(painted.marks.first().map_or(90, |m| m.size)) / 1.5;
    let expected =
        circles::Options { expect_mm: vec![0.02 * size.max(1.0)], channel: Default::default() };
    let _ = circles::measure(&picture, &calibration, &expected, "fed");
});
