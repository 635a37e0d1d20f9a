//! Burn marks: a ring (annulus or disc) and a spot within it, on bare metal.

use nalgebra::Vector2;
use serde::Serialize;
use serde_json::{Map, Value};

pub use super::beam::{Beam, Machine};
pub use super::burn_scene::{BurnScene, Ring, Spot};
use super::camera::Camera;
use super::draw::Dice;
use super::expose::{Band, Patch, Scene, expose};
use super::mark::{Contour, Dot, Fade};
use super::noise::{Around, Grain, grain_seed};
use super::picture::Picture;
use super::surface::{Glare, Metal};
use crate::camera::View;
use crate::error::Result;

/// A circle's true place.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct CircleTruth {
    /// Centre of the nominal contour in the plane.
    pub center_mm: [f64; 2],
    /// Its image.
    pub center_px: [f64; 2],
    /// Nominal diameter, on the contour where the mark is half as strong as inside.
    pub diameter_mm: f64,
}

/// What is true of a rendered burn.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct BurnTruth {
    /// The seed it was drawn with.
    pub seed: u64,
    /// The ring's outer edge.
    pub ring: CircleTruth,
    /// The spot.
    pub spot: CircleTruth,
    /// Spot minus ring.
    pub offset_mm: [f64; 2],
    /// Its length.
    pub distance_mm: f64,
    /// Every number of the scene as drawn.
    pub drawn: Map<String, Value>,
}

/// A picture of a burn, its camera and its truth.
#[derive(Debug, Clone)]
pub struct RenderedBurn {
    /// The picture.
    pub picture: Picture,
    /// The camera that took it.
    pub camera: Camera,
    /// What is true of it.
    pub truth: BurnTruth,
}

/// Renders the burn that `seed` draws from the scene, camera included.
pub fn render(scene: &BurnScene, seed: u64) -> Result<RenderedBurn> {
    render_with(scene, &scene.draw_camera(seed)?, seed)
}

/// As [`render`], seen by a given camera.
pub fn render_with(scene: &BurnScene, camera: &Camera, seed: u64) -> Result<RenderedBurn> {
    let mut dice = Dice::new(&scene.origin, seed, 1);
    let (width, height) = (scene.camera.width_px, scene.camera.height_px);
    let view = camera.calibration.view(width as usize, height as usize)?;
    let burn = Burn::draw(scene, &view, &mut dice)?;
    let shade = scene.light.shade(&mut dice, width, height)?;
    let picture = expose(&burn, camera, &scene.sensor, &shade, &mut dice, seed)?;
    let circle = |center: Vector2<f64>, radius_mm: f64| CircleTruth {
        center_mm: center.into(),
        center_px: view.to_pixel(center).into(),
        diameter_mm: 2.0 * radius_mm,
    };
    let offset = burn.spot_center - burn.center;
    let truth = BurnTruth {
        seed,
        ring: circle(burn.center, burn.outer.radius_mm),
        spot: circle(burn.spot_center, burn.spot.radius_mm),
        offset_mm: offset.into(),
        distance_mm: offset.norm(),
        drawn: dice.drawn,
    };
    Ok(RenderedBurn { picture, camera: camera.clone(), truth })
}

/// A burn with its numbers drawn.
struct Burn {
    metal: Metal,
    glare: Glare,
    center: Vector2<f64>,
    outer: Contour,
    inner: Option<Contour>,
    depth: Around,
    level: f64,
    mottle: f64,
    blotches: Grain,
    halo: f64,
    halo_mm: f64,
    wind: Vector2<f64>,
    spot_center: Vector2<f64>,
    spot: Contour,
    spot_level: f64,
    spatter: Vec<Dot>,
}

impl Burn {
    fn draw(scene: &BurnScene, view: &View, dice: &mut Dice) -> Result<Self> {
        let ring = &scene.ring;
        let center: Vector2<f64> =
            dice.roll2("ring.center_mm", &ring.center_mm, -100.0..=100.0)?.into();
        let radius = dice.roll("ring.radius_mm", &ring.radius_mm, 0.05..=100.0)?;
        let inner_ratio = dice.roll("ring.inner_ratio", &ring.inner_ratio, 0.0..=0.98)?;
        let softness = dice.roll("ring.softness_mm", &ring.softness_mm, 0.0..=10.0)?;
        let rms = dice.roll("ring.ragged_rms_mm", &ring.ragged_rms_mm, 0.0..=1.0)?;
        let length = dice.roll("ring.ragged_length_mm", &ring.ragged_length_mm, 0.01..=100.0)?;
        let mut contour = |radius_mm: f64| Contour {
            radius_mm,
            form_mm: Around::ragged(&mut dice.rng, rms, length, radius_mm),
            fade: Fade::new(softness, ring.profile),
        };
        let outer = contour(radius);
        let inner = (inner_ratio > 0.0).then(|| contour(radius * inner_ratio));
        let depth = draw_depth(ring, radius, dice)?;
        let (spot_center, spot) = draw_spot(scene, center, dice)?;
        let half_mm = view.pixel_mm() * f64::from(scene.camera.height_px) / 2.0;
        Ok(Self {
            metal: scene.surface.metal(dice)?,
            glare: scene.light.glare(dice, center, half_mm)?,
            center,
            outer,
            inner,
            depth,
            level: dice.roll("ring.level", &ring.level, 0.0..=5.0)?,
            mottle: dice.roll("ring.mottle", &ring.mottle, 0.0..=1.0)?,
            blotches: Grain::new(grain_seed(&mut dice.rng), 0.1, 0.1, 0.0),
            halo: dice.roll("ring.halo", &ring.halo, 0.0..=1.0)?,
            halo_mm: dice.roll("ring.halo_mm", &ring.halo_mm, 0.01..=100.0)?,
            wind: dice.heading(),
            spot_center,
            spot,
            spot_level: dice.roll("spot.level", &scene.spot.level, 0.0..=5.0)?,
            spatter: scene.spatter.strew(dice, "spatter", |dice| {
                // Thrown outwards: dense at the ring, thinner far out.
                let r = radius * (0.4 + dice.between(0.0, 1.0) + dice.between(0.0, 0.6));
                center + dice.heading() * r
            })?,
        })
    }
}

/// How deep the burn is around the ring: 1 where it is whole, 0 in a missing arc.
fn draw_depth(ring: &Ring, radius_mm: f64, dice: &mut Dice) -> Result<Around> {
    let uneven = dice.roll("ring.uneven", &ring.uneven, 0.0..=1.0)?;
    let arcs = dice.roll("ring.missing_arcs", &ring.missing_arcs, 0.0..=20.0)?.round();
    let mut missing = Vec::new();
    for _ in 0..arcs as usize {
        let half =
            dice.roll("ring.missing_deg", &ring.missing_deg, 0.0..=350.0)?.to_radians() / 2.0;
        missing.push((dice.direction(), half));
    }
    let blotch = Around::ragged(&mut dice.rng, uneven, 1.5, radius_mm);
    // The burn gives out over some tenths of a millimetre at both ends of a missing arc.
    let end = 0.3 / radius_mm;
    Ok(Around::constant(1.0).times(|angle| {
        missing.iter().fold((1.0 + blotch.at(angle)).clamp(0.0, 1.5), |depth, (middle, half)| {
            let away = (angle - middle + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                - std::f64::consts::PI;
            let t = ((away.abs() - half) / end + 0.5).clamp(0.0, 1.0);
            depth * t * t * (3.0 - 2.0 * t)
        })
    }))
}

fn draw_spot(
    scene: &BurnScene,
    ring_center: Vector2<f64>,
    dice: &mut Dice,
) -> Result<(Vector2<f64>, Contour)> {
    let spot = &scene.spot;
    let offset = match (&scene.machine, &spot.offset_mm) {
        (Some(_), Some(_)) => {
            return Err(dice.fault(
                "spot.offset_mm",
                "is given, and [machine] too, which also places the spot",
                "remove one of them",
            ));
        }
        (Some(machine), None) => {
            let degrees = -10.0..=10.0;
            let beam = Beam {
                b_error_deg: dice.roll(
                    "machine.b_error_deg",
                    &machine.b_error_deg,
                    degrees.clone(),
                )?,
                flange_tilt_deg: dice.roll(
                    "machine.flange_tilt_deg",
                    &machine.flange_tilt_deg,
                    degrees,
                )?,
            };
            let ring =
                dice.roll("machine.ring_height_mm", &machine.ring_height_mm, 0.1..=1000.0)?;
            let spot =
                dice.roll("machine.spot_height_mm", &machine.spot_height_mm, 0.1..=1000.0)?;
            beam.offset_mm(ring, spot)
        }
        (None, given) => {
            let default = [[-0.05, 0.05].into(), [-0.05, 0.05].into()];
            dice.roll2("spot.offset_mm", given.as_ref().unwrap_or(&default), -10.0..=10.0)?.into()
        }
    };
    let radius_mm = dice.roll("spot.radius_mm", &spot.radius_mm, 0.01..=50.0)?;
    let softness = dice.roll("spot.softness_mm", &spot.softness_mm, 0.0..=10.0)?;
    let rms = dice.roll("spot.ragged_rms_mm", &spot.ragged_rms_mm, 0.0..=1.0)?;
    let length = dice.roll("spot.ragged_length_mm", &spot.ragged_length_mm, 0.01..=100.0)?;
    let form_mm = Around::ragged(&mut dice.rng, rms, length, radius_mm);
    let contour = Contour { radius_mm, form_mm, fade: Fade::new(softness, spot.profile) };
    Ok((ring_center + offset, contour))
}

/// What of a burn concerns one tile.
struct Near {
    ring: bool,
    spot: bool,
    dots: Vec<Dot>,
}

/// Texture and glare at a pixel.
#[derive(Clone, Copy)]
struct Ground {
    texture: f64,
    mottle: f64,
    glare: f64,
}

impl Scene for Burn {
    type Local = Near;
    type Ground = Ground;

    fn local(&self, patch: Patch) -> (Near, usize) {
        let r = (patch.middle_mm - self.center).norm();
        let r_spot = (patch.middle_mm - self.spot_center).norm();
        let samples = |c: &Contour, r: f64| c.samples(r, patch.radius_mm, patch.pixel_mm);
        let reach = self.outer.fade.reach_mm(patch.pixel_mm) + self.outer.form_mm.largest();
        let halo = if self.halo > 0.0 { 7.0 * self.halo_mm } else { 0.0 };
        let near = Near {
            ring: r - patch.radius_mm < self.outer.radius_mm + reach + halo,
            spot: r_spot - patch.radius_mm
                < self.spot.radius_mm
                    + self.spot.fade.reach_mm(patch.pixel_mm)
                    + self.spot.form_mm.largest(),
            dots: self
                .spatter
                .iter()
                .filter(|d| d.touches(patch.middle_mm, patch.radius_mm))
                .copied()
                .collect(),
        };
        let most = samples(&self.outer, r)
            .max(self.inner.as_ref().map_or(1, |c| samples(c, r)))
            .max(samples(&self.spot, r_spot))
            .max(if near.dots.is_empty() { 1 } else { 2 });
        (near, most)
    }

    fn ground(&self, p: Vector2<f64>) -> Ground {
        let mottle =
            if self.mottle == 0.0 { 1.0 } else { 1.0 + self.mottle * self.blotches.at(p.x, p.y) };
        Ground { texture: self.metal.texture(p), mottle, glare: self.glare.at(p) }
    }

    fn radiance(
        &self,
        near: &Near,
        ground: Ground,
        p: Vector2<f64>,
        sample: f64,
        band: Band,
    ) -> f64 {
        let seen = |level: f64| self.metal.level + (level - self.metal.level) * band.contrast;
        let mut value = self.metal.level * ground.texture;
        let mut burnt = 0.0;
        // Burnt metal keeps some of the brush lines.
        let grain = ground.mottle * (0.7 + 0.3 * ground.texture);
        if near.ring {
            let d = p - self.center;
            let r = d.norm();
            let angle = d.y.atan2(d.x);
            let outer = self.outer.inside(r, || angle, sample);
            let inner = self.inner.as_ref().map_or(0.0, |c| c.inside(r, || angle, sample));
            let mut depth = self.depth.at(angle);
            if self.inner.is_none() {
                // A disc is whole in its middle whatever its rim lacks.
                let t = (2.5 * r / self.outer.radius_mm - 0.75).clamp(0.0, 1.0);
                depth = 1.0 + (depth - 1.0) * t;
            }
            if self.halo > 0.0 {
                value *= 1.0 - self.tint(r, d) * self.depth.at(angle) * band.tint;
            }
            burnt = (outer * (1.0 - inner) * depth).min(1.2);
            value += (seen(self.level) * grain - value) * burnt;
        }
        if near.spot {
            let d = p - self.spot_center;
            let spot = self.spot.inside(d.norm(), || d.y.atan2(d.x), sample);
            value += (seen(self.spot_level) * grain - value) * spot;
            burnt = burnt.max(spot);
        }
        value += ground.glare * (1.0 - 0.7 * burnt.min(1.0));
        for dot in &near.dots {
            value += (dot.level - value) * dot.cover(p);
        }
        value.max(0.0)
    }
}

impl Burn {
    /// Heat tint outside the ring and inside an annulus: oxide colours in bands that fade outwards,
    /// stronger where the gas blew.
    fn tint(&self, r_mm: f64, d: Vector2<f64>) -> f64 {
        let out = r_mm - self.outer.radius_mm;
        let inside = self.inner.as_ref().map_or(f64::NEG_INFINITY, |c| c.radius_mm - r_mm);
        let away = out.max(inside).max(0.0) / self.halo_mm;
        if away > 7.0 {
            return 0.0;
        }
        let bands = 0.75 + 0.25 * (away * 4.0).cos();
        let blown = 1.0 + 0.4 * d.dot(&self.wind) / r_mm.max(1e-9);
        self.halo * (-away).exp() * bands * blown / 1.4
    }
}
