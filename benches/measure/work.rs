//! Pictures to measure and how time is taken.

use std::hint::black_box;
use std::time::Instant;

use nalgebra::Vector2;
use pivotsight::camera::Calibration;
use pivotsight::error::Result;
use pivotsight::fit::Circle;
use pivotsight::frame::{Channel, Frame, Picture};
use pivotsight::measure::rod;
use pivotsight::render::camera::Optics;
use pivotsight::render::{self, BurnScene, Preset, RodScene};

use crate::decoded::{self, Shown};

/// Burns that are measured.
pub const BURNS: u64 = 6;
/// The presets' frames have 1600 pixels a row, these 4000.
const FINER: f64 = 2.5;

/// Milliseconds, the median of some runs.
pub fn median_ms<T>(runs: usize, mut job: impl FnMut() -> T) -> f64 {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            black_box(job());
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[runs / 2]
}

/// Runs on one thread.
pub fn one_thread<T: Send>(job: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    pool.install(job)
}

/// Time to copy the picture's frame to memory that is there already.
pub fn frame_copy_ms(picture: &Picture) -> f64 {
    let frame = picture.frame(Channel::Luminance);
    let Frame::Eight(gray) = &*frame else { return f64::NAN };
    let mut target = gray.data.clone();
    median_ms(25, || black_box(&mut target).copy_from_slice(black_box(&gray.data)))
}

/// The same view of the same size in the plane, in more and smaller pixels.
fn finer(optics: &mut Optics) {
    optics.width_px = (f64::from(optics.width_px) * FINER) as u32;
    optics.height_px = (f64::from(optics.height_px) * FINER) as u32;
    optics.pixel_mm = optics.pixel_mm.times(1.0 / FINER);
    optics.focal_px = optics.focal_px.times(FINER);
}

/// A burn's picture and truth.
pub struct Burn {
    /// The picture's file.
    pub png: Vec<u8>,
    /// Its camera's.
    pub calibration: Calibration,
    /// Spot minus ring.
    pub offset_mm: Vector2<f64>,
    /// Ring and spot in the plane.
    pub circles: [Circle; 2],
}

impl Burn {
    pub fn render(seed: u64) -> Result<Self> {
        let mut scene = BurnScene::preset(Preset::Typical)?;
        finer(&mut scene.camera);
        let made = render::burn::render(&scene, seed)?;
        let circle = |c: &render::burn::CircleTruth| Circle {
            center: c.center_mm.into(),
            radius: 0.5 * c.diameter_mm,
        };
        Ok(Self {
            png: made.picture.png()?,
            calibration: made.camera.calibration,
            offset_mm: made.truth.offset_mm.into(),
            circles: [circle(&made.truth.ring), circle(&made.truth.spot)],
        })
    }

    pub fn picture(&self) -> Result<Picture> {
        Picture::decode("bench", &self.png)
    }
}

/// A rod's captures, decoded.
pub struct Rod {
    pub captures: Vec<rod::Capture>,
    frames: Vec<Shown>,
}

impl Rod {
    pub fn render() -> Result<Self> {
        let mut scene = RodScene::preset(Preset::Typical)?;
        finer(&mut scene.camera);
        let made = render::rod::render(&scene, 1)?;
        let (captures, frames) = decoded::captures(&made)?;
        Ok(Self { captures, frames })
    }

    /// Whether it could be measured.
    pub fn measure(&self) -> bool {
        rod::measure_frames(&self.captures, &self.frames, &rod::Options::default()).is_ok()
    }
}
