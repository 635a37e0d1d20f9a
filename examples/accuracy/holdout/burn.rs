//! Burn pictures of the second renderer: ring and spot as discs, annuli or bumps on bright or brushed metal.
//!
//! The true offset is that of the circles the ragged contours are drawn about; their raggedness keeps its first harmonic. Softness is
//! the distance from 10 % to 90 % of an edge's profile.

use std::f64::consts::{LN_2, PI, TAU};

use nalgebra::Vector2;
use pivotsight::camera::Calibration;

use super::contour::{Contour, Edge, Form, Profile, Raggedness};
use super::dice::{Dice, Level};
use super::dirt::Dirt;
use super::optics::{Camera, HEIGHT_PX, Photo, Scene, Sensor, Shading, WIDTH_PX, paint};
use super::texture::Texture;

pub const MM_PER_PX: f64 = 0.008;
const MOST_SOFTNESS_MM: f64 = 0.3;

/// What a mark looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Filled to its edge.
    Disc,
    /// With an inner edge: for the spot, a crater with a lighter bottom.
    Annulus,
    /// A soft bump: for the ring a ridge, for the spot a dome.
    Bump,
}

/// A circle whose centre is known.
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    pub centre_mm: Vector2<f64>,
    pub radius_mm: f64,
    pub softness_mm: f64,
    pub kind: Kind,
}

/// A picture with what is true of it.
pub struct BurnPicture {
    pub photo: Photo,
    pub camera: Camera,
    pub calibration: Calibration,
    pub ring: Mark,
    pub spot: Mark,
    /// What was drawn, for people.
    pub story: String,
}

/// How much of a mark there is by distance from its contour.
enum Shape {
    Filled(Profile),
    /// Outer and inner edge, and what is left of the mark inside.
    Hollow(Profile, Edge, f64),
    /// Half as strong at `half_mm` from the ridge; inwards to a floor with its own half-width.
    Ridge {
        half_mm: f64,
        inner_half_mm: f64,
        power: f64,
        floor: f64,
    },
    Dome {
        power: f64,
    },
}

struct Marked {
    mark: Mark,
    contour: Contour,
    shape: Shape,
}

impl Marked {
    fn reach_mm(&self) -> f64 {
        3.0 * self.mark.softness_mm
    }

    fn strength(&self, plane_mm: Vector2<f64>) -> f64 {
        let from_centre = plane_mm - self.mark.centre_mm;
        let reach = match &self.shape {
            Shape::Ridge { inner_half_mm, .. } => self.reach_mm().max(4.0 * inner_half_mm),
            Shape::Dome { .. } => self.mark.radius_mm,
            _ => self.reach_mm(),
        };
        let outside = self.contour.outside_mm(from_centre, reach);
        let bump = |x: f64, power: f64| (-LN_2 * x.abs().powf(power)).exp();
        match &self.shape {
            Shape::Filled(profile) => profile.at(outside),
            Shape::Hollow(profile, inner, floor) => {
                profile.at(outside) * (1.0 - (1.0 - floor) * inner.share(from_centre))
            }
            Shape::Ridge { half_mm, inner_half_mm, power, floor } => {
                let x = outside + half_mm;
                if x >= 0.0 {
                    bump(x / half_mm, *power)
                } else {
                    floor + (1.0 - floor) * bump(x / inner_half_mm, *power)
                }
            }
            Shape::Dome { power } => bump((1.0 + outside / self.mark.radius_mm).max(0.0), *power),
        }
    }

    fn is_edge(&self, plane_mm: Vector2<f64>) -> bool {
        let r = (plane_mm - self.mark.centre_mm).norm();
        let near = (r - self.mark.radius_mm).abs() < self.reach_mm() + 0.05;
        near || matches!(&self.shape, Shape::Hollow(_, inner, _) if inner.is_near(plane_mm - self.mark.centre_mm))
    }
}

/// From 10 % to 90 % of exp(-ln2 x^p), in units of its half-width.
fn bump_softness(power: f64) -> f64 {
    let at = |share: f64| (-share.ln() / LN_2).powf(1.0 / power);
    at(0.1) - at(0.9)
}

/// A part of the ring that is not burnt.
struct Gap {
    middle: f64,
    half: f64,
    soft: f64,
    depth: f64,
}

struct BurnScene {
    ring: Marked,
    spot: Marked,
    plate: f64,
    /// Share of the plate's light that the ring's burn takes.
    ring_depth: f64,
    spot_level: f64,
    gaps: Vec<Gap>,
    /// Heat tint: change of light at the rim, how far it goes, and how much it leans to one side.
    tint: f64,
    tint_mm: f64,
    tint_lean: Vector2<f64>,
    plate_texture: Texture,
    burn_texture: Texture,
    /// How much of the plate's texture shows through a burn.
    showing: f64,
}

impl BurnScene {
    fn burnt(&self, plane_mm: Vector2<f64>) -> f64 {
        let strength = self.ring.strength(plane_mm);
        if self.gaps.is_empty() || strength == 0.0 {
            return strength;
        }
        let d = plane_mm - self.ring.mark.centre_mm;
        // A disc's heart is burnt all the same.
        let outer = match self.ring.mark.kind {
            Kind::Disc => {
                let x = ((d.norm() / self.ring.mark.radius_mm - 0.3) / 0.5).clamp(0.0, 1.0);
                x * x * (3.0 - 2.0 * x)
            }
            _ => 1.0,
        };
        let way = d.y.atan2(d.x);
        let left = self.gaps.iter().map(|gap| {
            let away = ((way - gap.middle + PI).rem_euclid(TAU) - PI).abs();
            1.0 - outer * gap.depth * (0.5 + 0.5 * ((gap.half - away) / gap.soft).tanh())
        });
        strength * left.product::<f64>()
    }
}

impl Scene for BurnScene {
    fn surface(&self, plane_mm: Vector2<f64>) -> [f64; 3] {
        let burnt = self.burnt(plane_mm);
        let mut light = self.plate * (1.0 - self.ring_depth * burnt);
        if self.tint != 0.0 {
            let d = plane_mm - self.ring.mark.centre_mm;
            let outside = d.norm() - self.ring.mark.radius_mm;
            let lean = 1.0 + self.tint_lean.dot(&d) / d.norm().max(0.1);
            let fade = (-outside.max(0.0) / self.tint_mm).exp();
            light *= 1.0 + self.tint * lean * fade * (1.0 - burnt) * smooth_step(outside);
        }
        let spot = self.spot.strength(plane_mm);
        [light + spot * (self.spot_level - light), burnt.max(spot), spot]
    }

    fn is_edge(&self, plane_mm: Vector2<f64>) -> bool {
        self.ring.is_edge(plane_mm) || self.spot.is_edge(plane_mm)
    }

    fn texture(&self, plane_mm: Vector2<f64>, [_, burnt, _]: &[f64; 3]) -> f64 {
        let plate = self.plate_texture.at(plane_mm) * (1.0 - burnt * (1.0 - self.showing));
        let burn = if *burnt > 1e-3 { self.burn_texture.at(plane_mm) * burnt } else { 0.0 };
        (1.0 + plate + burn).max(0.05)
    }
}

/// Heat tint begins about the rim: 0 well inside, 1 outside.
fn smooth_step(outside_mm: f64) -> f64 {
    0.5 + 0.5 * (outside_mm / 0.1).tanh()
}

/// Renders the picture of a seed.
pub fn render(level: Level, seed: u64) -> BurnPicture {
    let mut dice = Dice::new(seed, level as u64);
    let camera = Camera::draw(level, MM_PER_PX, &mut dice);
    let sensor = Sensor::draw(level, &mut dice);
    let scene = draw_scene(level, &mut dice);
    let shading = Shading::draw(level.of([0.0, 0.3, 0.45]), &mut dice);
    let dirt = (level == Level::Hard).then(|| draw_dirt(&scene, &camera, &mut dice));
    let mut light = paint(&camera.looks_mm(), &scene);
    for (i, value) in light.iter_mut().enumerate() {
        let shaded = f64::from(*value) * shading.at(i % WIDTH_PX, i / WIDTH_PX);
        *value = dirt.as_ref().map_or(shaded, |d| d.put_on(i, shaded)) as f32;
    }
    let photo = sensor.expose(&light, &mut dice);
    let (ring, spot) = (scene.ring.mark, scene.spot.mark);
    let story = format!(
        "ring {:?} r {:.2} soft {:.0} µm, spot {:?} {} r {:.2} soft {:.0} µm, {} gaps, {:?}",
        ring.kind,
        ring.radius_mm,
        1e3 * ring.softness_mm,
        spot.kind,
        if scene.spot_level > scene.plate * (1.0 - scene.ring_depth) { "light" } else { "dark" },
        spot.radius_mm,
        1e3 * spot.softness_mm,
        scene.gaps.len(),
        sensor.depth
    );
    BurnPicture { photo, calibration: camera.calibration(), camera, ring, spot, story }
}

fn draw_scene(level: Level, dice: &mut Dice) -> BurnScene {
    let centre_mm = Vector2::new(dice.between((-0.9, 0.9)), dice.between((-0.6, 0.6)));
    let kind = dice.pick(&[Kind::Disc, Kind::Annulus, Kind::Bump]);
    let soft = level.of([(0.03, 0.2), (0.03, 0.25), (0.08, MOST_SOFTNESS_MM)]);
    let softness_mm = dice.between_log(soft).max(if kind == Kind::Bump { 0.1 } else { 0.0 });
    let ring = Mark { centre_mm, radius_mm: dice.between((2.2, 3.4)), softness_mm, kind };
    let (away_mm, way) = (dice.between((0.0, 0.15)), dice.angle());
    let mut spot = Mark {
        centre_mm: centre_mm + Vector2::new(way.cos(), way.sin()) * away_mm,
        radius_mm: dice.between((0.25, 0.6)),
        softness_mm: 0.0,
        kind: dice.pick(&[Kind::Disc, Kind::Annulus, Kind::Bump]),
    };
    spot.softness_mm = dice.between_log(soft).min(0.7 * spot.radius_mm);
    let ragged = Raggedness {
        rms_mm: dice.between(level.of([(0.0, 0.0), (0.001, 0.005), (0.008, 0.02)])),
        length_mm: dice.between((0.1, 0.4)),
        is_rough: dice.chance(0.5),
    };
    let spot_ragged = Raggedness { rms_mm: ragged.rms_mm * dice.between((0.6, 1.0)), ..ragged };
    let (ring, ring_floor) = draw_ring(ring, ragged, dice);
    let spot = draw_spot(spot, spot_ragged, dice);
    let plate = dice.between((0.5, 0.75));
    let ring_depth = dice.between(level.of([(0.35, 0.65), (0.35, 0.65), (0.25, 0.6)]));
    let inside = plate * (1.0 - ring_depth * ring_floor);
    let spot_level = if dice.chance(0.5) {
        inside * dice.between(level.of([(0.3, 0.6), (0.35, 0.65), (0.4, 0.75)]))
    } else {
        (inside * dice.between(level.of([(1.5, 2.0), (1.4, 1.9), (1.3, 1.7)]))).min(0.93)
    };
    let is_hard = level == Level::Hard;
    let metal = dice.between(level.of([(0.0, 0.0), (0.012, 0.04), (0.03, 0.07)]));
    let brush = dice.angle();
    let clean = level == Level::Clean;
    BurnScene {
        ring,
        spot,
        plate,
        ring_depth,
        spot_level,
        gaps: if is_hard { draw_gaps(dice) } else { Vec::new() },
        tint: if is_hard { dice.between((-0.2, 0.12)) } else { 0.0 },
        tint_mm: dice.between((0.1, 0.6)),
        tint_lean: Vector2::new(dice.between((-0.2, 0.2)), dice.between((-0.2, 0.2))),
        plate_texture: if clean { Texture::none() } else { Texture::brushed(metal, brush, dice) },
        burn_texture: if clean {
            Texture::none()
        } else {
            Texture::mottled(metal * dice.between((0.4, 1.0)), (0.02, 0.2), dice)
        },
        showing: dice.between((0.2, 0.8)),
    }
}

const FORMS: [Form; 5] = [Form::Gauss, Form::Tanh, Form::Bell, Form::TailOut, Form::TailIn];

/// The ring, and how strongly its inside is burnt.
fn draw_ring(mark: Mark, ragged: Raggedness, dice: &mut Dice) -> (Marked, f64) {
    let contour = Contour::new(mark.radius_mm, ragged, dice);
    let form = dice.pick(&FORMS);
    let profile = Profile::new(form, mark.softness_mm);
    let floor = dice.between((0.0, 0.4));
    let (shape, inside) = match mark.kind {
        Kind::Disc => (Shape::Filled(profile), 1.0),
        Kind::Annulus => {
            let wide_mm = dice.between((0.35, 1.0)).max(2.5 * mark.softness_mm);
            let soft_mm = mark.softness_mm * dice.between((0.7, 1.5));
            let inner = Edge {
                contour: Contour::new(mark.radius_mm - wide_mm, ragged, dice),
                profile: Profile::new(dice.pick(&FORMS), soft_mm),
            };
            (Shape::Hollow(profile, inner, floor), floor)
        }
        Kind::Bump => {
            let power = dice.between((1.6, 4.0));
            let half_mm = mark.softness_mm / bump_softness(power);
            let inner_half_mm = half_mm * dice.between((0.8, 2.5));
            (Shape::Ridge { half_mm, inner_half_mm, power, floor }, floor)
        }
    };
    (Marked { mark, contour, shape }, inside)
}

fn draw_spot(mut mark: Mark, ragged: Raggedness, dice: &mut Dice) -> Marked {
    let contour = Contour::new(mark.radius_mm, ragged, dice);
    let profile = Profile::new(dice.pick(&FORMS), mark.softness_mm);
    let shape = match mark.kind {
        Kind::Disc => Shape::Filled(profile),
        Kind::Annulus => {
            let inner = Edge {
                contour: Contour::new(0.4 * mark.radius_mm, ragged, dice),
                profile: Profile::new(Form::Gauss, 0.25 * mark.radius_mm),
            };
            Shape::Hollow(profile, inner, dice.between((0.3, 0.8)))
        }
        Kind::Bump => {
            let mut power = dice.between((3.0, 10.0));
            while mark.radius_mm * bump_softness(power) > MOST_SOFTNESS_MM {
                power *= 1.1;
            }
            mark.softness_mm = mark.radius_mm * bump_softness(power);
            Shape::Dome { power }
        }
    };
    Marked { mark, contour, shape }
}

/// Up to three gaps, 10 % to 40 % of the ring together.
fn draw_gaps(dice: &mut Dice) -> Vec<Gap> {
    let count = dice.whole(1, 3);
    let half = PI * dice.between((0.1, 0.32)) / count as f64;
    let first = dice.angle();
    let gap = |k: usize| Gap {
        middle: first + TAU * k as f64 / count as f64 + dice.between((-0.4, 0.4)),
        half: half * dice.between((0.75, 1.25)),
        soft: dice.between((0.04, 0.2)),
        depth: dice.between((0.7, 1.0)),
    };
    (0..count).map(gap).collect()
}

/// Spatter thrown about the ring, scratches, one to three patches of glare.
fn draw_dirt(scene: &BurnScene, camera: &Camera, dice: &mut Dice) -> Dirt {
    let mut dirt = Dirt::new();
    let ring = &scene.ring.mark;
    for _ in 0..dice.whole(15, 70) {
        let (way, r_mm) = (dice.angle(), ring.radius_mm * dice.between((0.05, 1.5)));
        let at = ring.centre_mm + Vector2::new(way.cos(), way.sin()) * r_mm;
        let half_px = dice.between_log((0.008, 0.07)) / MM_PER_PX;
        let change =
            if dice.chance(0.7) { dice.between((-0.7, -0.3)) } else { dice.between((0.3, 0.8)) };
        dirt.stroke([camera.to_pixel(at); 2], half_px, change);
    }
    let (wide, high) = (WIDTH_PX as f64, HEIGHT_PX as f64);
    for _ in 0..dice.whole(3, 15) {
        let at = Vector2::new(dice.between((0.0, wide)), dice.between((0.0, high)));
        let (way, long) = (dice.angle(), dice.between((50.0, 900.0)));
        let end = at + Vector2::new(way.cos(), way.sin()) * long;
        dirt.stroke([at, end], dice.between((0.3, 2.0)), dice.between((-0.3, 0.3)));
    }
    for _ in 0..dice.whole(1, 3) {
        let at = Vector2::new(dice.between((0.1, 0.9)) * wide, dice.between((0.1, 0.9)) * high);
        let short = dice.between_log((25.0, 100.0));
        let half_px = [short * dice.between((1.0, 3.5)), short];
        dirt.glare(at, half_px, dice.angle(), dice.between_log((0.1, 0.9)));
    }
    dirt
}
