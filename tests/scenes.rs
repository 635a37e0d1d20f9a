//! Every key of a scene does to the picture what its description says, measured on the pixels alone.

#![allow(clippy::unwrap_used)]

#[path = "common/plain_disc.rs"]
mod plain_disc;

use std::f64::consts::TAU;

use nalgebra::Vector2;
use pivotsight::camera::Calibration;
use pivotsight::render::{BurnScene, Picture, Preset, RodScene, burn, rod};

use plain_disc::plain_disc;

const EXPOSURE: f64 = 0.85;
const METAL: f64 = 0.65 * EXPOSURE;
const BURNT: f64 = 0.2 * EXPOSURE;

/// A disc of 3 mm about the middle of the frame: 20 µm a pixel.
fn plain() -> BurnScene {
    let mut scene = plain_disc();
    scene.camera.blur_px = 0.8.into();
    scene.ring.center_mm = [0.0.into(), 0.0.into()];
    scene.ring.radius_mm = 3.0.into();
    scene.ring.level = 0.2.into();
    scene.spot.level = 0.2.into();
    scene
}

/// A picture that can be asked what it shows at a place of the plane.
struct Seen {
    picture: Picture,
    calibration: Calibration,
    values: Vec<f64>,
}

impl Seen {
    fn new(picture: Picture, calibration: Calibration) -> Self {
        let values = picture.channel(0).into_iter().map(f64::from).collect();
        Self { picture, calibration, values }
    }

    fn of(change: impl Fn(&mut BurnScene)) -> Self {
        let mut scene = plain();
        change(&mut scene);
        let made = burn::render(&scene, 5).unwrap();
        Self::new(made.picture, made.camera.calibration)
    }

    fn pixel(&self, u: usize, v: usize) -> f64 {
        self.values[v * self.picture.width_px + u]
    }

    /// Value of the pixel at a distance from the plane's origin in a direction.
    fn at(&self, r_mm: f64, angle: f64) -> f64 {
        let view = self.calibration.view(self.picture.width_px, self.picture.height_px).unwrap();
        let px = view.to_pixel(Vector2::new(r_mm * angle.cos(), r_mm * angle.sin()));
        self.pixel(px.x.round() as usize, px.y.round() as usize)
    }

    /// Values all round at a distance.
    fn round(&self, r_mm: f64) -> impl Iterator<Item = f64> {
        (0..720).map(move |k| self.at(r_mm, f64::from(k) * TAU / 720.0))
    }

    fn mean(&self, r_mm: f64) -> f64 {
        self.round(r_mm).sum::<f64>() / 720.0
    }

    /// Values of the upper left corner, where there is only metal.
    fn corner(&self) -> Vec<f64> {
        (0..80).flat_map(|v| (0..200).map(move |u| (u, v))).map(|(u, v)| self.pixel(u, v)).collect()
    }
}

fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, (squares / values.len() as f64).sqrt())
}

#[track_caller]
fn near(value: f64, wanted: f64, within: f64) {
    assert!((value - wanted).abs() <= within, "{value}, not {wanted} ± {within}");
}

#[test]
fn the_sensor_turns_light_into_values_as_it_says() {
    let plain = Seen::of(|_| {});
    near(plain.mean(2.0), BURNT, 1e-3);
    near(plain.corner()[0], METAL, 1e-3);
    let half = Seen::of(|s| s.sensor.exposure = 0.425.into());
    near(half.corner()[0], METAL / 2.0, 1e-3);
    let black = Seen::of(|s| s.sensor.black = 0.05.into());
    near(black.mean(2.0), BURNT + 0.05, 1e-3);
    let bent = Seen::of(|s| s.sensor.gamma = 2.0.into());
    near(bent.mean(2.0), BURNT.sqrt(), 1e-3);
    // Shot noise of the electrons and read noise, as parts of full scale.
    let noisy = Seen::of(|s| {
        s.sensor.full_well_e = 1e4.into();
        s.sensor.read_noise_e = 100.0.into();
    });
    let (mean, deviation) = mean_and_deviation(&noisy.corner());
    near(mean, METAL, 5e-4);
    near(deviation, (METAL * 1e4 + 1e4).sqrt() / 1e4, 4e-4);
    let few = Seen::of(|s| s.sensor.bits = 8);
    assert!(few.picture.values.iter().all(|v| *v <= 255));
    near(few.corner()[0], METAL, 0.5 / 255.0);
}

#[test]
fn light_and_surface_change_the_metal_as_they_say() {
    let shaded = Seen::of(|s| s.light.shading = 0.3.into());
    let corners = [(0, 0), (639, 0), (0, 479), (639, 479)].map(|(u, v)| shaded.pixel(u, v));
    let across = (corners[1] - corners[0]) / METAL;
    let down = (corners[2] - corners[0]) / METAL * 640.0 / 480.0;
    near(across.hypot(down), 0.3, 2e-3);
    let vignetted = Seen::of(|s| s.light.vignetting = 0.2.into());
    for (u, v) in [(0, 0), (639, 0), (0, 479), (639, 479)] {
        near(vignetted.pixel(u, v) / METAL, 0.8, 2e-3);
    }
    let plain = Seen::of(|_| {});
    let glaring = Seen::of(|s| {
        s.light.glare_count = 3.0.into();
        s.light.glare = 0.2.into();
    });
    let added: Vec<f64> = glaring.values.iter().zip(&plain.values).map(|(a, b)| a - b).collect();
    assert!(added.iter().all(|a| *a > -1e-4));
    let most = added.iter().copied().fold(0.0, f64::max);
    assert!((0.5..3.0).contains(&(most / (0.2 * EXPOSURE))), "{most}");
    // Lines as wide as ten pixels, or the pixels would even them out.
    let brushed = Seen::of(|s| {
        s.surface.texture = 0.08.into();
        s.surface.across_mm = 0.2.into();
    });
    let (mean, deviation) = mean_and_deviation(&brushed.corner());
    near(mean / METAL, 1.0, 0.06);
    near(deviation / METAL, 0.08, 0.03);
}

#[test]
fn the_ring_has_the_edge_the_gap_and_the_tint_that_are_asked_for() {
    let soft = Seen::of(|s| s.ring.softness_mm = 0.3.into());
    let part = |r: f64| (soft.mean(r) - BURNT) / (METAL - BURNT);
    for (r, wanted) in [(2.85, 0.1), (3.0, 0.5), (3.15, 0.9)] {
        near(part(r), wanted, 0.015);
    }
    let cut = Seen::of(|s| {
        s.ring.missing_arcs = 1.0.into();
        s.ring.missing_deg = 60.0.into();
    });
    let bright = cut.round(2.5).filter(|v| *v > 0.5 * (METAL + BURNT)).count();
    near(bright as f64 / 2.0, 60.0, 2.0);
    let tinted = Seen::of(|s| {
        s.ring.halo = 0.3.into();
        s.ring.halo_mm = 0.3.into();
    });
    let loss = |r: f64| 1.0 - tinted.mean(r) / METAL;
    near(loss(3.1), 0.2, 0.1);
    assert!(loss(4.6) < 0.01 && loss(3.4) < loss(3.1), "{} {}", loss(3.1), loss(4.6));
    let rough = Seen::of(|s| s.ring.ragged_rms_mm = 0.05.into());
    // Where the edge lies in each direction, to half a pixel.
    let edge = |k: u32| {
        let angle = f64::from(k) * TAU / 720.0;
        let dark = (0..100)
            .filter(|i| rough.at(2.5 + 0.01 * f64::from(*i), angle) < 0.5 * (METAL + BURNT));
        2.5 + 0.01 * dark.count() as f64
    };
    let (mean, deviation) = mean_and_deviation(&(0..720).map(edge).collect::<Vec<_>>());
    near(mean, 3.0, 0.03);
    near(deviation, 0.05, 0.02);
    let spattered = Seen::of(|s| {
        s.spatter.count = 60.0.into();
        s.spatter.radius_mm = 0.06.into();
    });
    let specks = spattered.round(3.6).filter(|v| *v < 0.8 * METAL).count();
    assert!((5..300).contains(&specks), "{specks}");
}

/// What a chamfer, a shadow and dirt change of a rod's picture lies within the rim, beyond it and anywhere.
#[test]
fn the_rod_has_its_chamfer_its_shadow_and_its_dirt_where_they_belong() {
    let made = |change: &dyn Fn(&mut RodScene)| {
        let mut scene = RodScene::preset(Preset::Clean).unwrap();
        scene.camera = scene.camera.binned(4);
        scene.camera.blur_px = 0.8.into();
        scene.sensor.full_well_e = 1e9.into();
        scene.sensor.read_noise_e = 0.0.into();
        scene.rod.diameter_mm = 16.0.into();
        scene.rod.chamfer_mm = 0.0.into();
        scene.captures.per_angle = 4.0.into();
        change(&mut scene);
        rod::render(&scene, 4).unwrap()
    };
    let plain = made(&|_| {});
    let rod = plain.truth.rod_centers[0].center_mm;
    // Distances beyond the rim of what has changed, over all captures.
    let changed = |change: &dyn Fn(&mut RodScene)| -> Vec<f64> {
        let other = made(change);
        let mut list = Vec::new();
        for (a, b) in plain.captures.iter().zip(&other.captures) {
            let picture = &a.picture;
            let (width, height) = (picture.width_px, picture.height_px);
            let view = plain.camera.calibration.view(width, height).unwrap();
            let place = Vector2::from(a.machine_mm) - Vector2::from(rod);
            for (k, (x, y)) in picture.channel(0).iter().zip(b.picture.channel(0)).enumerate() {
                if (x - y).abs() > 0.02 {
                    let px = Vector2::new((k % width) as f64, (k / width) as f64);
                    list.push((place + view.to_plane(px)).norm() - 8.0);
                }
            }
        }
        list
    };
    let chamfer = changed(&|s| s.rod.chamfer_mm = 0.5.into());
    assert!(chamfer.len() > 1000 && chamfer.iter().all(|d| (-0.6..0.1).contains(d)));
    let shadow = changed(&|s| {
        s.rod.shadow = 0.8.into();
        s.rod.shadow_mm = 0.5.into();
    });
    assert!(shadow.len() > 300 && shadow.iter().all(|d| (-0.1..0.6).contains(d)));
    let dirt = changed(&|s| {
        s.dirt.count = 20.0.into();
        s.dirt.radius_mm = 0.1.into();
    });
    assert!((100..40_000).contains(&dirt.len()), "{}", dirt.len());
}
