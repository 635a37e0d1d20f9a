//! Captures of a check rod's rim: a bright end face, a chamfer lit from one side, a table in shadow.

use std::path::Path;

use nalgebra::{Rotation2, Vector2};
use serde::Serialize;
use serde_json::{Map, Value};

use super::camera::Camera;
use super::draw::Dice;
use super::expose::{Band, Patch, Scene, expose};
use super::mark::{Contour, Dot, Fade, Profile};
use super::noise::{Around, Grain, grain_seed};
use super::picture::Picture;
pub use super::plan::Captures;
use super::plan::plan;
pub use super::rod_scene::{Axis, Rod, RodScene};
use super::surface::{Glare, Metal};
use crate::camera::View;
use crate::error::Result;
use crate::output::write_whole;

/// One picture of the rim.
#[derive(Debug, Clone)]
pub struct Capture {
    /// The picture.
    pub picture: Picture,
    /// Machine coordinates that the control shows, to its last digit (1 µm).
    pub machine_mm: [f64; 2],
    /// C angle.
    pub c_deg: f64,
}

/// The rod's centre at one C angle.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct RodCenter {
    /// C angle.
    pub c_deg: f64,
    /// Machine coordinates.
    pub center_mm: [f64; 2],
}

/// What is true of a rendered rod.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct RodTruth {
    /// The seed it was drawn with.
    pub seed: u64,
    /// The C axis in machine coordinates.
    pub axis_center_mm: [f64; 2],
    /// The rod's centre at each C angle.
    pub rod_centers: Vec<RodCenter>,
    /// Distance of the rod's centre from the C axis.
    pub eccentricity_mm: f64,
    /// Nominal diameter of the outer edge.
    pub diameter_mm: f64,
    /// Every number of the scene as drawn.
    pub drawn: Map<String, Value>,
}

/// All captures of one rod, their camera and their truth.
#[derive(Debug, Clone)]
pub struct RenderedRod {
    /// The pictures with what the control showed.
    pub captures: Vec<Capture>,
    /// The camera that took them.
    pub camera: Camera,
    /// What is true of them.
    pub truth: RodTruth,
}

impl RenderedRod {
    /// Writes the pictures as `NAME-01.png` and so on, and the captures table `NAME.csv`, whose name is handed
    /// back.
    pub fn write(&self, folder: &Path, name: &str) -> Result<String> {
        let mut table = String::from("image,x_mm,y_mm,c_deg\n");
        for (i, capture) in self.captures.iter().enumerate() {
            let image = format!("{name}-{:02}.png", i + 1);
            capture.picture.write_png(folder.join(&image))?;
            let [x, y] = capture.machine_mm;
            table += &format!("{image},{x:.3},{y:.3},{}\n", capture.c_deg);
        }
        let file = format!("{name}.csv");
        write_whole(folder.join(&file), table.as_bytes())?;
        Ok(file)
    }
}

/// Renders the rod that `seed` draws from the scene, camera included.
pub fn render(scene: &RodScene, seed: u64) -> Result<RenderedRod> {
    render_with(scene, &scene.draw_camera(seed)?, seed)
}

/// As [`render`], seen by a given camera.
pub fn render_with(scene: &RodScene, camera: &Camera, seed: u64) -> Result<RenderedRod> {
    let mut dice = Dice::new(&scene.origin, seed, 1);
    let (width, height) = (scene.camera.width_px, scene.camera.height_px);
    let view = camera.calibration.view(width as usize, height as usize)?;
    let metal = Shape::draw(scene, &mut dice)?;
    let axis: Vector2<f64> =
        dice.roll2("axis.center_mm", &scene.axis.center_mm, -1e5..=1e5)?.into();
    let eccentricity =
        dice.roll("axis.eccentricity_mm", &scene.axis.eccentricity_mm, 0.0..=10.0)?;
    let toward =
        dice.roll("axis.eccentricity_deg", &scene.axis.eccentricity_deg, -360.0..=360.0)?;
    if scene.axis.c_sense.abs() != 1 {
        return Err(dice.fault("axis.c_sense", "is neither 1 nor -1", "choose one of them"));
    }
    let seat = Rotation2::new(toward.to_radians()) * Vector2::new(eccentricity, 0.0);
    let shade = scene.light.shade(&mut dice, width, height)?;
    let plan = plan(&scene.captures, axis, metal.outer.radius_mm, &mut dice)?;
    let mut captures = Vec::with_capacity(plan.len());
    let mut rod_centers: Vec<RodCenter> = Vec::new();
    for (i, shot) in plan.iter().enumerate() {
        let turn = (f64::from(scene.axis.c_sense) * shot.c_deg).to_radians();
        let center = axis + Rotation2::new(turn) * seat;
        if rod_centers.last().is_none_or(|r| r.c_deg != shot.c_deg) {
            rod_centers.push(RodCenter { c_deg: shot.c_deg, center_mm: center.into() });
        }
        let sight = Sight::draw(scene, &metal, &view, center - shot.camera, turn, &mut dice)?;
        let noise_seed = seed ^ ((i as u64 + 1) << 40);
        let picture = expose(&sight, camera, &scene.sensor, &shade, &mut dice, noise_seed)?;
        captures.push(Capture { picture, machine_mm: shot.shown.into(), c_deg: shot.c_deg });
    }
    let truth = RodTruth {
        seed,
        axis_center_mm: axis.into(),
        rod_centers,
        eccentricity_mm: eccentricity,
        diameter_mm: 2.0 * metal.outer.radius_mm,
        drawn: dice.drawn,
    };
    Ok(RenderedRod { captures, camera: camera.clone(), truth })
}

/// The rod itself, the same in every capture.
struct Shape {
    metal: Metal,
    turned: bool,
    outer: Contour,
    face: Contour,
    chamfer_lit: f64,
    chamfer_dark: f64,
    table: f64,
    table_mottle: f64,
    blotches: Grain,
    light: Vector2<f64>,
    shadow: f64,
    shadow_mm: f64,
}

impl Shape {
    fn draw(scene: &RodScene, dice: &mut Dice) -> Result<Self> {
        let rod = &scene.rod;
        let radius = dice.roll("rod.diameter_mm", &rod.diameter_mm, 0.5..=1000.0)? / 2.0;
        let chamfer = dice.roll("rod.chamfer_mm", &rod.chamfer_mm, 0.0..=100.0)?.min(0.9 * radius);
        let softness = dice.roll("rod.softness_mm", &rod.softness_mm, 0.0..=1.0)?;
        let rms = dice.roll("rod.form_rms_mm", &rod.form_rms_mm, 0.0..=0.5)?;
        let length = dice.roll("rod.form_length_mm", &rod.form_length_mm, 0.05..=1000.0)?;
        let mut contour = |radius_mm: f64| Contour {
            radius_mm,
            form_mm: Around::ragged(&mut dice.rng, rms, length, radius_mm),
            fade: Fade::new(softness, Profile::Gaussian),
        };
        let outer = contour(radius);
        let face = if chamfer > 0.0 { contour(radius - chamfer) } else { outer.clone() };
        let light = dice.roll("rod.light_deg", &rod.light_deg, -360.0..=360.0)?.to_radians();
        Ok(Self {
            metal: scene.surface.metal(dice)?,
            turned: rod.turned,
            outer,
            face,
            chamfer_lit: dice.roll("rod.chamfer_lit", &rod.chamfer_lit, 0.0..=5.0)?,
            chamfer_dark: dice.roll("rod.chamfer_dark", &rod.chamfer_dark, 0.0..=5.0)?,
            table: dice.roll("rod.table", &rod.table, 0.0..=5.0)?,
            table_mottle: dice.roll("rod.table_mottle", &rod.table_mottle, 0.0..=1.0)?,
            blotches: Grain::new(grain_seed(&mut dice.rng), 0.25, 0.25, 0.0),
            light: Vector2::new(light.cos(), light.sin()),
            shadow: dice.roll("rod.shadow", &rod.shadow, 0.0..=1.0)?,
            shadow_mm: dice.roll("rod.shadow_mm", &rod.shadow_mm, 0.001..=100.0)?,
        })
    }
}

/// The rod as one capture sees it.
struct Sight<'a> {
    rod: &'a Shape,
    center: Vector2<f64>,
    turn: f64,
    unturn: Rotation2<f64>,
    glare: Glare,
    dirt: Vec<Dot>,
}

impl<'a> Sight<'a> {
    fn draw(
        scene: &RodScene,
        rod: &'a Shape,
        view: &View,
        center: Vector2<f64>,
        turn: f64,
        dice: &mut Dice,
    ) -> Result<Self> {
        let half =
            Vector2::new(view.width_px() as f64, view.height_px() as f64) / 2.0 * view.pixel_mm();
        let glare = scene.light.glare(dice, Vector2::zeros(), half.y)?;
        let dirt = scene.dirt.strew(dice, "dirt", |dice| {
            let p = Vector2::new(dice.between(-half.x, half.x), dice.between(-half.y, half.y));
            let from = p - center;
            if dice.between(0.0, 1.0) < 0.5 && from.norm() > 0.0 {
                center + from.normalize() * (rod.outer.radius_mm + dice.between(-0.15, 0.15))
            } else {
                p
            }
        })?;
        Ok(Self { rod, center, turn, unturn: Rotation2::new(-turn), glare, dirt })
    }
}

/// What of a rod concerns one tile.
struct Near {
    dots: Vec<Dot>,
}

/// Texture, table and glare at a pixel.
#[derive(Clone, Copy)]
struct Ground {
    face: f64,
    table: f64,
    glare: f64,
}

impl Scene for Sight<'_> {
    type Local = Near;
    type Ground = Ground;

    fn local(&self, patch: Patch) -> (Near, usize) {
        let r = (patch.middle_mm - self.center).norm();
        let samples = |c: &Contour| c.samples(r, patch.radius_mm, patch.pixel_mm);
        let touches = |d: &&Dot| d.touches(patch.middle_mm, patch.radius_mm);
        let dots: Vec<Dot> = self.dirt.iter().filter(touches).copied().collect();
        let most = samples(&self.rod.outer).max(samples(&self.rod.face)).max(if dots.is_empty() {
            1
        } else {
            2
        });
        (Near { dots }, most)
    }

    fn ground(&self, p: Vector2<f64>) -> Ground {
        let rod = self.rod;
        // The table and the rod turn together.
        let d = self.unturn * (p - self.center);
        let r = d.norm();
        let face = if r > rod.outer.radius_mm + 0.2 {
            1.0
        } else if rod.turned {
            rod.metal.turned(r, d.y.atan2(d.x))
        } else {
            rod.metal.texture(d)
        };
        let mottle = if rod.table_mottle == 0.0 {
            1.0
        } else {
            (1.0 + rod.table_mottle * rod.blotches.at(d.x, d.y)).max(0.1)
        };
        Ground { face, table: rod.table * mottle, glare: self.glare.at(p) }
    }

    fn radiance(&self, near: &Near, ground: Ground, p: Vector2<f64>, sample: f64, _: Band) -> f64 {
        let rod = self.rod;
        let d = p - self.center;
        let r = d.norm();
        let angle = || d.y.atan2(d.x) - self.turn;
        let on_rod = rod.outer.inside(r, angle, sample);
        let on_face = rod.face.inside(r, angle, sample);
        // Cosine of the angle between this place on the rim and the light.
        let facing = d.dot(&rod.light) / r.max(1e-9);
        let table = ground.table * (1.0 - rod.shadow * self.shadow(r, facing));
        let mut value = table;
        if on_rod > 0.0 {
            let lit = (0.5 + 0.5 * facing).powi(2);
            let chamfer = rod.chamfer_dark + (rod.chamfer_lit - rod.chamfer_dark) * lit;
            // What is not face is chamfer, what is not rod is table.
            value = table * (1.0 - on_rod)
                + chamfer * (0.5 + 0.5 * ground.face) * (on_rod - on_face).max(0.0)
                + rod.metal.level * ground.face * on_face;
        }
        value += ground.glare * (0.3 + 0.7 * on_rod);
        for dot in &near.dots {
            value += (dot.level - value) * dot.cover(p);
        }
        value.max(0.0)
    }
}

impl Sight<'_> {
    /// The rod's shadow on the table: deepest at the rim on the side away from the light.
    fn shadow(&self, r_mm: f64, facing: f64) -> f64 {
        let side = (-facing).max(0.0);
        let t = (1.0 - (r_mm - self.rod.outer.radius_mm).max(0.0) / self.rod.shadow_mm).max(0.0);
        side * t * t * (3.0 - 2.0 * t)
    }
}
