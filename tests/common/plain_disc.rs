//! A scene with nothing in it but a mark.

use pivotsight::render::{BurnScene, Preset};

/// A dark disc without spot, texture or noise to speak of.
pub fn plain_disc() -> BurnScene {
    let mut scene = BurnScene::preset(Preset::Clean).unwrap();
    scene.camera.width_px = 640;
    scene.camera.height_px = 480;
    scene.camera.pixel_mm = 0.02.into();
    scene.sensor.bits = 16;
    scene.sensor.full_well_e = 1e9.into();
    scene.sensor.read_noise_e = 0.0.into();
    scene.sensor.black = 0.0.into();
    scene.ring.inner_ratio = 0.0.into();
    scene.ring.level = 0.1.into();
    scene.spot.level = 0.1.into();
    scene.ring.softness_mm = 0.0.into();
    scene.ring.ragged_rms_mm = 0.0.into();
    scene
}
