//! Captures of a check rod by the second renderer: arcs of its rim from above, the table dark or bright below it.
//!
//! Everything is laid out in the rod's own frame, which turns with the table; the lamp and the camera do not turn. A point at `(x, y)`
//! of the camera's plane is at `(X + x, Y + y)` of the machine, and the rod's centre at axis + Rz(sense · C) eccentricity.

use nalgebra::{Rotation2, Vector2};
use pivotsight::camera::Calibration;

use super::contour::{Contour, Edge, Form, Profile, Raggedness};
use super::dice::{Dice, Level};
use super::dirt::Dirt;
use super::optics::{Camera, Photo, Scene, Sensor, Shading, WIDTH_PX, paint};
use super::texture::{Texture, Turned};

/// One capture.
pub struct Shot {
    pub photo: Photo,
    pub machine_mm: Vector2<f64>,
    pub c_deg: f64,
    /// The rod's true centre at this angle, in machine coordinates.
    pub rod_mm: Vector2<f64>,
}

/// The captures of one rod with what is true of them.
pub struct RodSet {
    pub shots: Vec<Shot>,
    pub camera: Camera,
    pub calibration: Calibration,
    /// Sense in which C turns the table.
    pub c_sense: f64,
    pub axis_mm: Vector2<f64>,
    pub radius_mm: f64,
    /// From 10 % to 90 % of the rim's edge.
    pub softness_mm: f64,
    pub mm_per_px: f64,
    pub has_several_angles: bool,
    /// What was drawn, for people.
    pub story: String,
}

/// The end face's finish.
enum Face {
    Ground(Texture),
    Turned(Turned),
}

/// A patch where grease or a reflection veils the rim.
struct Veil {
    centre_mm: Vector2<f64>,
    size_mm: f64,
    share: f64,
    level: f64,
}

/// The rod and what surrounds it, in the rod's frame.
struct Rod {
    rim: Edge,
    /// Where the end face goes over into the chamfer.
    inner: Option<Edge>,
    table: f64,
    face: f64,
    /// Light of the chamfer toward the lamp; away from it, it fades into the table.
    chamfer: f64,
    fading: f64,
    fading_power: f64,
    table_texture: Texture,
    chamfer_texture: Texture,
    finish: Face,
    veils: Vec<Veil>,
    grime: Vec<Grime>,
}

/// A chip, a speck or a fibre.
struct Grime {
    ends_mm: [Vector2<f64>; 2],
    half_width_mm: f64,
    change: f64,
}

/// The rod as one capture sees it.
struct View<'a> {
    rod: &'a Rod,
    /// From the machine's directions to the rod's.
    turn: Rotation2<f64>,
    /// Camera axis from the rod's centre, in machine directions.
    camera_mm: Vector2<f64>,
    /// The lamp's direction in the rod's frame.
    lamp: Vector2<f64>,
}

impl View<'_> {
    fn on_rod(&self, plane_mm: Vector2<f64>) -> Vector2<f64> {
        self.turn * (plane_mm + self.camera_mm)
    }

    fn on_plane(&self, rod_mm: Vector2<f64>) -> Vector2<f64> {
        self.turn.inverse() * rod_mm - self.camera_mm
    }
}

impl Scene for View<'_> {
    fn surface(&self, plane_mm: Vector2<f64>) -> [f64; 3] {
        let (rod, p) = (self.rod, self.on_rod(plane_mm));
        let outer = rod.rim.share(p);
        let inner = rod.inner.as_ref().map_or(outer, |edge| edge.share(p));
        let mut slope = rod.table;
        if outer > inner {
            let toward = 0.5 + 0.5 * p.dot(&self.lamp) / p.norm();
            let lit = rod.fading + (1.0 - rod.fading) * toward.powf(rod.fading_power);
            slope += (rod.chamfer - rod.table) * lit;
        }
        let mut light =
            rod.table * (1.0 - outer) + slope * (outer - inner).max(0.0) + rod.face * inner;
        for veil in &rod.veils {
            let away = (p - veil.centre_mm).norm_squared() / (veil.size_mm * veil.size_mm);
            light += veil.share * (-0.5 * away).exp() * (veil.level - light);
        }
        [light, outer, inner]
    }

    fn is_edge(&self, plane_mm: Vector2<f64>) -> bool {
        let p = self.on_rod(plane_mm);
        self.rod.rim.is_near(p) || self.rod.inner.as_ref().is_some_and(|edge| edge.is_near(p))
    }

    fn texture(&self, plane_mm: Vector2<f64>, [_, outer, inner]: &[f64; 3]) -> f64 {
        let (rod, p) = (self.rod, self.on_rod(plane_mm));
        let mut change = 0.0;
        if *outer < 0.999 {
            change += (1.0 - outer) * rod.table_texture.at(p);
        }
        if outer - inner > 0.001 {
            change += (outer - inner) * rod.chamfer_texture.at(p);
        }
        if *inner > 0.001 {
            change += inner
                * match &rod.finish {
                    Face::Ground(texture) => texture.at(p),
                    Face::Turned(rings) => rings.at(p, self.lamp),
                };
        }
        (1.0 + change).max(0.05)
    }
}

/// Renders the captures of a seed.
pub fn render(level: Level, seed: u64) -> RodSet {
    let mut dice = Dice::new(seed, 10 + level as u64);
    let dice = &mut dice;
    let mm_per_px = dice.between((0.005, 0.006));
    let camera = Camera::draw(level, mm_per_px, dice);
    let sensor = Sensor::draw(level, dice);
    let shading = Shading::draw(level.of([0.0, 0.25, 0.4]), dice);
    let radius_mm = dice.between((6.0, 12.5));
    let blur_px = dice.between(level.of([(0.7, 1.5), (0.8, 2.5), (1.2, 4.5)]));
    // Of a Gaussian: 10 % to 90 % is 2.563 standard deviations.
    let softness_mm = 2.563 * blur_px * mm_per_px;
    let rod = draw_rod(level, radius_mm, softness_mm, dice);

    let count = dice.whole(4, 8);
    let angles = draw_angles(count, dice);
    let has_several_angles = angles.len() > 1;
    let c_sense = if dice.chance(0.75) { 1.0 } else { -1.0 };
    let axis_mm = Vector2::new(dice.between((-60.0, 60.0)), dice.between((-60.0, 60.0)));
    let (off_mm, way) = (dice.between((0.01, 0.4)), dice.angle());
    let eccentric_mm = Vector2::new(way.cos(), way.sin()) * off_mm;
    let (lamp_way, first_way) = (dice.angle(), dice.angle());
    let lamp = Vector2::new(lamp_way.cos(), lamp_way.sin());
    let looks_mm = camera.looks_mm();
    let mut shots = Vec::new();
    for k in 0..count {
        // Angles of the table one after another; at each, captures about the whole rim.
        let angle_of = |k: usize| k * angles.len() / count;
        let same = (0..count).filter(|other| angle_of(*other) == angle_of(k));
        let part = same.clone().filter(|other| *other < k).count() as f64 / same.count() as f64;
        let c_deg = angles[angle_of(k)];
        let way = first_way
            + (part + 0.13 * angle_of(k) as f64) * std::f64::consts::TAU
            + dice.between((-0.3, 0.3));
        let table = Rotation2::new(c_sense * c_deg.to_radians());
        let rod_mm = axis_mm + table * eccentric_mm;
        let aim_mm =
            rod_mm + Vector2::new(way.cos(), way.sin()) * (radius_mm + dice.between((-1.0, 0.8)));
        let machine_mm = aim_mm.map(|x| (x * 1e3).round() * 1e-3);
        let turn = table.inverse();
        let view = View { rod: &rod, turn, camera_mm: machine_mm - rod_mm, lamp: turn * lamp };
        let dirt = (!rod.grime.is_empty()).then(|| grime_on(&view, &camera, mm_per_px));
        let mut light = paint(&looks_mm, &view);
        for (i, value) in light.iter_mut().enumerate() {
            let clean = dirt.as_ref().map_or(f64::from(*value), |d| d.put_on(i, f64::from(*value)));
            *value = (clean * shading.at(i % WIDTH_PX, i / WIDTH_PX)) as f32;
        }
        shots.push(Shot { photo: sensor.expose(&light, dice), machine_mm, c_deg, rod_mm });
    }
    let story = format!(
        "D {:.3}, {count} captures, {} angles, sense {c_sense}, blur {blur_px:.1} px, chamfer {:.2} mm, face {:.2} {}, chamfer {:.2}, table {:.2}, fading {:.2}, {:?}",
        2.0 * radius_mm,
        angles.len(),
        rod.inner.as_ref().map_or(0.0, |edge| radius_mm - edge.contour.radius_mm),
        rod.face,
        if matches!(rod.finish, Face::Ground(_)) { "ground" } else { "turned" },
        rod.chamfer,
        rod.table,
        rod.fading,
        sensor.depth
    );
    let calibration = camera.calibration();
    RodSet {
        shots,
        camera,
        calibration,
        c_sense,
        axis_mm,
        radius_mm,
        softness_mm,
        mm_per_px,
        has_several_angles,
        story,
    }
}

/// One table angle for half of the sets; else two to four, at least two captures at each, well apart.
fn draw_angles(count: usize, dice: &mut Dice) -> Vec<f64> {
    let first = dice.between((-90.0, 90.0)).round();
    if dice.chance(0.5) {
        return vec![if dice.chance(0.5) { 0.0 } else { first }];
    }
    let angles = dice.whole(2, count / 2);
    let step = if angles == 2 { dice.between((90.0, 180.0)) } else { 360.0 / angles as f64 };
    (0..angles).map(|k| (first + step * k as f64 + dice.between((-10.0, 10.0))).round()).collect()
}

fn draw_rod(level: Level, radius_mm: f64, softness_mm: f64, dice: &mut Dice) -> Rod {
    let forms = [Form::Gauss, Form::Bell, Form::Defocus, Form::Tanh];
    let form = dice.pick(&forms);
    // Grinding marks and handling: a fraction of a micrometre.
    let rough = Raggedness {
        rms_mm: dice.between(level.of([(0.0, 0.0), (0.0002, 0.0008), (0.0005, 0.0015)])),
        length_mm: dice.between((0.05, 0.3)),
        is_rough: true,
    };
    let edge = |radius_mm: f64, ragged: Raggedness, softness_mm: f64, dice: &mut Dice| Edge {
        contour: Contour::new(radius_mm, ragged, dice),
        profile: Profile::new(form, softness_mm),
    };
    let rim = edge(radius_mm, rough, softness_mm, dice);
    let inner = (level != Level::Clean).then(|| {
        let wide_mm = dice.between((0.15, 0.6)).max(2.5 * softness_mm);
        let ragged = Raggedness { rms_mm: 4.0 * rough.rms_mm, ..rough };
        edge(radius_mm - wide_mm, ragged, softness_mm * dice.between((1.0, 1.3)), dice)
    });
    // A rod brighter than the table, or before a bright one.
    let is_dark = dice.chance(0.2);
    let (table, face, chamfer) = if is_dark {
        (dice.between((0.6, 0.75)), dice.between((0.25, 0.4)), dice.between((0.08, 0.2)))
    } else {
        (dice.between((0.08, 0.3)), dice.between((0.45, 0.7)), dice.between((0.5, 0.85)))
    };
    let metal = dice.between(level.of([(0.0, 0.0), (0.01, 0.04), (0.03, 0.08)]));
    let is_clean = level == Level::Clean;
    let finish = if dice.chance(0.5) {
        let way = dice.angle();
        Face::Ground(if is_clean { Texture::none() } else { Texture::brushed(metal, way, dice) })
    } else {
        Face::Turned(Turned::new(metal, dice))
    };
    let (far, fine) = ((0.05, 0.6), (0.01, 0.08));
    let mut mottled = |size: f64, length_mm| {
        if is_clean { Texture::none() } else { Texture::mottled(size, length_mm, dice) }
    };
    let (table_texture, chamfer_texture) = (mottled(1.5 * metal, far), mottled(metal, fine));
    let is_hard = level == Level::Hard;
    Rod {
        rim,
        inner,
        table,
        face,
        chamfer,
        fading: dice.between(level.of([(1.0, 1.0), (0.1, 0.35), (0.0, 0.15)])),
        fading_power: dice.between((0.5, 1.3)),
        table_texture,
        chamfer_texture,
        finish,
        veils: if is_hard { draw_veils(radius_mm, dice) } else { Vec::new() },
        grime: if is_hard { draw_grime(radius_mm, dice) } else { Vec::new() },
    }
}

fn draw_veils(radius_mm: f64, dice: &mut Dice) -> Vec<Veil> {
    (0..dice.whole(1, 4))
        .map(|_| {
            let (way, r_mm) = (dice.angle(), radius_mm + dice.between((-1.0, 0.5)));
            Veil {
                centre_mm: Vector2::new(way.cos(), way.sin()) * r_mm,
                size_mm: dice.between((0.6, 2.0)),
                share: dice.between((0.3, 0.8)),
                level: dice.between((0.2, 0.5)),
            }
        })
        .collect()
}

/// Specks and chips, most of them about the rim, and a few fibres.
fn draw_grime(radius_mm: f64, dice: &mut Dice) -> Vec<Grime> {
    let place = |dice: &mut Dice, spread_mm: f64| {
        let (way, r_mm) = (dice.angle(), radius_mm + spread_mm * dice.normal());
        Vector2::new(way.cos(), way.sin()) * r_mm
    };
    let mut grime = Vec::new();
    for _ in 0..dice.whole(30, 150) {
        let spread_mm = if dice.chance(0.6) { 0.15 } else { 2.5 };
        let bright = dice.chance(0.25);
        grime.push(Grime {
            ends_mm: [place(dice, spread_mm); 2],
            half_width_mm: dice.between_log((0.008, 0.08)),
            change: if bright { dice.between((0.3, 1.0)) } else { dice.between((-0.8, -0.3)) },
        });
    }
    for _ in 0..dice.whole(0, 8) {
        let (mut from, mut way) = (place(dice, 1.0), dice.angle());
        for _ in 0..dice.whole(3, 12) {
            way += dice.between((-0.5, 0.5));
            let to = from + Vector2::new(way.cos(), way.sin()) * 0.15;
            let half_width_mm = 0.008;
            grime.push(Grime { ends_mm: [from, to], half_width_mm, change: -0.5 });
            from = to;
        }
    }
    grime
}

fn grime_on(view: &View, camera: &Camera, mm_per_px: f64) -> Dirt {
    let mut dirt = Dirt::new();
    for speck in &view.rod.grime {
        let ends_mm = speck.ends_mm.map(|end| view.on_plane(end));
        // What is far outside the frame would be seen through the distortion at a wrong place.
        if ends_mm.iter().all(|end| end.norm() < 7.0) {
            let ends_px = ends_mm.map(|end| camera.to_pixel(end));
            dirt.stroke(ends_px, speck.half_width_mm / mm_per_px, speck.change);
        }
    }
    dirt
}
