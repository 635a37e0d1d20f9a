//! Hostile pictures: a burn on brushed metal, or none, and what may be taken for one.

use font8x8::UnicodeFonts;
use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::paint::{Brush, Canvas, Sensor, Wave, inside, ppm};

/// Size of a pixel in the plane.
pub const MM_PER_PX: f64 = 0.01;
const WIDTH: usize = 880;
const HEIGHT: usize = 660;

/// What is wrong with a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Sort {
    NoRing,
    HalfRing,
    MissingArcs,
    Defocus,
    Motion,
    OtherCircles,
    Text,
    Screws,
    Glare,
    DoubleRing,
    TwoBurns,
    TwoBurnsNear,
    Pale,
    Colour,
    SpotOff,
    SpotOnEdge,
}

/// All sorts, in the order in which a table draws them.
pub const SORTS: [Sort; 16] = [
    Sort::NoRing,
    Sort::HalfRing,
    Sort::MissingArcs,
    Sort::Defocus,
    Sort::Motion,
    Sort::OtherCircles,
    Sort::Text,
    Sort::Screws,
    Sort::Glare,
    Sort::DoubleRing,
    Sort::TwoBurns,
    Sort::TwoBurnsNear,
    Sort::Pale,
    Sort::Colour,
    Sort::SpotOff,
    Sort::SpotOnEdge,
];

impl Sort {
    /// What the tables call it.
    pub fn words(self) -> &'static str {
        match self {
            Self::NoRing => {
                "no ring (bare, text, screws, holes, a lone spot or ring): any number is wrong"
            }
            Self::HalfRing => "half of the ring missing",
            Self::MissingArcs => "up to 40 % of the ring missing",
            Self::Defocus => "defocus, 4-16 px",
            Self::Motion => "motion blur, 6-40 px",
            Self::OtherCircles => "other circles beside the burn",
            Self::Text => "text on and beside it",
            Self::Screws => "screws beside it",
            Self::Glare => "glare over up to a fifth",
            Self::DoubleRing => "a second, paler ring",
            Self::TwoBurns => "two test burns: any number is wrong",
            Self::TwoBurnsNear => "two test burns, one named by its place",
            Self::Pale => "ring of 3 % contrast",
            Self::Colour => "ring in one colour channel only",
            Self::SpotOff => "spot off by up to half the ring's radius",
            Self::SpotOnEdge => "spot on the ring's inner edge",
        }
    }
}

/// A picture and what is true of it.
pub struct Plate {
    /// A portable graymap or pixmap.
    pub file: Vec<u8>,
    /// Spot minus ring in the plane; `None` where no burn is to be measured.
    pub offset_mm: Option<Vector2<f64>>,
    /// Where the ring is, about, where the picture has two.
    pub near_mm: Option<[f64; 2]>,
}

/// Random numbers of a scene.
struct Dice(ChaCha8Rng);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    fn chance(&mut self, part: f64) -> bool {
        self.0.random::<f64>() < part
    }

    fn heading(&mut self) -> Vector2<f64> {
        let (s, c) = self.between(0.0, std::f64::consts::TAU).sin_cos();
        Vector2::new(c, s)
    }

    fn place(&mut self) -> Vector2<f64> {
        Vector2::new(self.between(0.0, WIDTH as f64), self.between(0.0, HEIGHT as f64))
    }
}

/// A burn in pixels.
#[derive(Clone)]
struct Burn {
    center: Vector2<f64>,
    radius: f64,
    /// Inner radius, 0 of a disc.
    hollow: f64,
    level: f64,
    soft: f64,
    outer_wave: Wave,
    inner_wave: Wave,
    halo: f64,
    /// Directions and half angles of missing arcs.
    gaps: Vec<(f64, f64)>,
    spot: Vector2<f64>,
    spot_radius: f64,
    spot_level: f64,
    spot_soft: f64,
    spot_wave: Wave,
}

impl Burn {
    fn draw(dice: &mut Dice, metal: f64, size: f64) -> Self {
        let radius = dice.between(140.0, 240.0) * size;
        let hollow = if dice.chance(0.6) { radius * dice.between(0.55, 0.78) } else { 0.0 };
        let spot_radius = radius * dice.between(0.13, 0.22);
        let rms = if dice.chance(0.3) { 0.0 } else { dice.between(0.2, 1.5) };
        let finest = dice.between(10.0, 30.0);
        let center = Vector2::new(
            WIDTH as f64 / 2.0 + dice.between(-60.0, 60.0),
            HEIGHT as f64 / 2.0 + dice.between(-40.0, 40.0),
        );
        // Bare metal about the spot, or burnt: it must stand out from either.
        let level = metal * dice.between(0.25, 0.5);
        let about = if hollow > 0.0 { metal } else { level };
        let bright = (0.9f64).min(about + 0.35);
        let spot_level = if about > 0.35 { dice.between(0.03, 0.12) } else { bright };
        let mut wave = |rms: f64, radius: f64| Wave::new(&mut dice.0, rms, finest, radius.max(9.0));
        let (outer_wave, inner_wave) = (wave(rms, radius), wave(rms, hollow));
        let spot_wave = wave(0.7 * rms, spot_radius);
        let off = dice.heading() * dice.between(0.0, 0.05 * radius);
        Self {
            center,
            radius,
            hollow,
            level,
            soft: dice.between(0.5, 3.0),
            outer_wave,
            inner_wave,
            halo: if dice.chance(0.5) { dice.between(0.0, 0.12) } else { 0.0 },
            gaps: Vec::new(),
            spot: center + off,
            spot_radius,
            spot_level,
            spot_soft: dice.between(0.5, 2.5),
            spot_wave,
        }
    }

    fn paint_ring(&self, canvas: &mut Canvas) {
        canvas.paint_near(self.center, 1.7 * self.radius, |p, metal| {
            let d = p - self.center;
            let r = d.norm();
            let mut cover = inside(r - self.radius - self.outer_wave.at(d), self.soft);
            if self.hollow > 0.0 {
                cover *= 1.0 - inside(r - self.hollow - self.inner_wave.at(d), self.soft);
            }
            let turn = d.y.atan2(d.x);
            let mut there = 1.0;
            for (middle, half) in &self.gaps {
                let away = wrap(turn - middle).abs() - half;
                there *= 1.0 - inside(away * self.radius, 4.0);
            }
            let tint = (-(r - self.radius).max(0.0) / (0.12 * self.radius)).exp();
            let metal = metal * (1.0 - self.halo * tint * there);
            metal + (self.level - metal) * cover * there
        });
    }

    fn paint_spot(&self, canvas: &mut Canvas) {
        canvas.paint_near(self.spot, 2.0 * self.spot_radius + 20.0, |p, old| {
            let d = p - self.spot;
            let edge = d.norm() - self.spot_radius - self.spot_wave.at(d);
            old + (self.spot_level - old) * inside(edge, self.spot_soft)
        });
    }

    /// Spot minus ring; v runs down, Y up.
    fn offset_mm(&self) -> Vector2<f64> {
        let d = (self.spot - self.center) * MM_PER_PX;
        Vector2::new(d.x, -d.y)
    }
}

fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle - turn * (angle / turn).round()
}

impl Plate {
    /// The picture of a sort that a seed draws.
    pub fn draw(sort: Sort, seed: u64) -> Self {
        let dice = &mut Dice(ChaCha8Rng::seed_from_u64(seed));
        let pale = sort == Sort::Pale;
        let metal = dice.between(0.45, 0.75);
        let brushed = if pale { 0.004 } else { dice.between(0.0, 0.06) };
        let brush = {
            let (length, width) = (dice.between(30.0, 200.0), dice.between(1.5, 4.0));
            Brush::new(&mut dice.0, length, width)
        };
        let slope = dice.heading() * dice.between(0.0, 1.5e-4);
        let mut canvas = Canvas::new(WIDTH, HEIGHT, 1, 0.0);
        canvas.paint(|p, _| metal * (1.0 + brushed * brush.at(p) + slope.dot(&p)));

        let two = matches!(sort, Sort::TwoBurns | Sort::TwoBurnsNear);
        let mut burn = Burn::draw(dice, metal, if two { 0.7 } else { 1.0 });
        let mut offset_mm = None;
        let mut near_mm = None;
        let mut blur_px = dice.between(0.6, 1.6);
        if sort == Sort::NoRing {
            no_burn(&mut canvas, dice, metal, &burn);
        } else {
            change(&mut burn, sort, dice, metal);
            if sort == Sort::DoubleRing {
                second_ring(&mut canvas, dice, &burn, metal);
            }
            if two {
                let mut other = Burn::draw(dice, metal, 0.7);
                burn.place(Vector2::new(dice.between(200.0, 240.0), dice.between(200.0, 460.0)));
                other.place(Vector2::new(dice.between(640.0, 680.0), dice.between(200.0, 460.0)));
                other.paint_ring(&mut canvas);
                other.paint_spot(&mut canvas);
            }
            if sort != Sort::Colour {
                burn.paint_ring(&mut canvas);
            }
            burn.paint_spot(&mut canvas);
            clutter(&mut canvas, sort, dice, &burn);
            offset_mm = (sort != Sort::TwoBurns).then(|| burn.offset_mm());
            near_mm = (sort == Sort::TwoBurnsNear).then(|| {
                let astray = dice.heading() * dice.between(0.0, 30.0);
                let d = burn.center + astray - middle();
                [d.x * MM_PER_PX, -d.y * MM_PER_PX]
            });
        }
        if dice.chance(0.4) && !pale {
            spatter(&mut canvas, dice, &burn);
        }
        if sort == Sort::Defocus {
            blur_px = dice.between(4.0, 16.0);
        }
        let smear = dice.heading() * dice.between(6.0, 40.0);
        let sensor = Sensor {
            noise: if pale { dice.between(0.002, 0.008) } else { dice.between(0.003, 0.02) },
            gamma: 1.0,
            bits: 8,
        };
        let finish = |mut canvas: Canvas| {
            canvas.blur(blur_px);
            if sort == Sort::Motion {
                canvas.smear(smear);
            }
            canvas
        };
        let file = if sort == Sort::Colour {
            let mut shown = canvas.clone();
            burn.paint_ring(&mut shown);
            burn.paint_spot(&mut shown);
            let blank = finish(canvas);
            let mut planes = [blank.clone(), blank.clone(), blank];
            planes[dice.0.random_range(0..3)] = finish(shown);
            ppm(&planes, sensor, &mut dice.0)
        } else {
            finish(canvas).pgm(sensor, &mut dice.0)
        };
        Self { file, offset_mm, near_mm }
    }
}

fn middle() -> Vector2<f64> {
    Vector2::new(WIDTH as f64 - 1.0, HEIGHT as f64 - 1.0) / 2.0
}

impl Burn {
    fn place(&mut self, center: Vector2<f64>) {
        self.spot += center - self.center;
        self.center = center;
    }
}

/// What a sort does to the burn itself.
fn change(burn: &mut Burn, sort: Sort, dice: &mut Dice, metal: f64) {
    let turn = dice.between(-3.1, 3.1);
    match sort {
        Sort::HalfRing => burn.gaps.push((turn, dice.between(1.4, 1.75))),
        Sort::MissingArcs => {
            let arcs = dice.0.random_range(1..4);
            let each = dice.between(0.1, 0.4) * std::f64::consts::PI / f64::from(arcs);
            burn.gaps =
                (0..arcs).map(|k| (turn + f64::from(k) * dice.between(1.6, 2.1), each)).collect();
        }
        Sort::Pale => {
            burn.level = metal - 0.03;
            burn.halo = 0.0;
            burn.spot_level = dice.between(0.03, 0.12);
        }
        Sort::Colour => burn.halo = 0.0,
        Sort::SpotOff => {
            let off = dice.between(0.1, 0.5) * burn.radius;
            burn.spot = burn.center + dice.heading() * off;
        }
        Sort::SpotOnEdge => {
            burn.hollow = burn.radius * dice.between(0.5, 0.7);
            burn.level = metal * dice.between(0.35, 0.5);
            // Stands out from bare metal and from burnt.
            burn.spot_level = if dice.chance(0.5) { 0.03 } else { 0.95 };
            let off = burn.hollow + dice.between(-0.8, 0.8) * burn.spot_radius;
            burn.spot = burn.center + dice.heading() * off;
        }
        _ => {}
    }
}

/// A paler ring of another size, a little aside: an earlier test, a reflection.
fn second_ring(canvas: &mut Canvas, dice: &mut Dice, burn: &Burn, metal: f64) {
    let mut second = burn.clone();
    let larger = dice.chance(0.5);
    second.radius *= if larger { dice.between(1.12, 1.3) } else { dice.between(0.7, 0.85) };
    second.hollow = second.radius * dice.between(0.85, 0.95);
    second.level = metal + (burn.level - metal) * dice.between(0.15, 0.35);
    second.center += dice.heading() * dice.between(0.0, 0.1) * burn.radius;
    second.paint_ring(canvas);
}

/// What lies about the burn or on it.
fn clutter(canvas: &mut Canvas, sort: Sort, dice: &mut Dice, burn: &Burn) {
    match sort {
        Sort::OtherCircles => {
            for _ in 0..dice.0.random_range(2..8) {
                circle(canvas, dice, Some(burn));
            }
        }
        Sort::Text => (0..dice.0.random_range(1..5)).for_each(|_| text(canvas, dice)),
        Sort::Screws => {
            for _ in 0..dice.0.random_range(1..4) {
                screw(canvas, dice, Some(burn));
            }
        }
        Sort::Glare => glare(canvas, dice, burn),
        _ => {}
    }
}

/// No burn: things that may be taken for one.
fn no_burn(canvas: &mut Canvas, dice: &mut Dice, metal: f64, burn: &Burn) {
    match dice.0.random_range(0..6) {
        0 => {}
        1 => (0..4).for_each(|_| text(canvas, dice)),
        2 => (0..4).for_each(|_| screw(canvas, dice, None)),
        3 => (0..6).for_each(|_| circle(canvas, dice, None)),
        4 => burn.paint_spot(canvas),
        _ => {
            let mut ring = burn.clone();
            ring.hollow = ring.radius * 0.7;
            ring.level = 0.5 * metal;
            ring.paint_ring(canvas);
        }
    }
}

/// A free place for something of this radius, clear of the burn.
fn place(dice: &mut Dice, radius: f64, burn: Option<&Burn>) -> Option<Vector2<f64>> {
    (0..30)
        .map(|_| dice.place())
        .find(|p| burn.is_none_or(|b| (p - b.center).norm() > b.radius + radius + 12.0))
}

/// A drilled hole, a washer or a drawn circle.
fn circle(canvas: &mut Canvas, dice: &mut Dice, burn: Option<&Burn>) {
    let radius = dice.between(15.0, 110.0);
    let Some(center) = place(dice, radius, burn) else { return };
    let (level, soft) = (dice.between(0.0, 0.95), dice.between(0.4, 1.5));
    let hollow = radius * if dice.chance(0.5) { 0.0 } else { dice.between(0.5, 0.95) };
    canvas.paint_near(center, radius + 20.0, |p, old| {
        let r = (p - center).norm();
        let hole = if hollow > 0.0 { inside(r - hollow, soft) } else { 0.0 };
        old + (level - old) * inside(r - radius, soft) * (1.0 - hole)
    });
}

/// A screw's head: bright, with a dark rim and a slot, a cross or a hexagon.
fn screw(canvas: &mut Canvas, dice: &mut Dice, burn: Option<&Burn>) {
    let radius = dice.between(40.0, 100.0);
    let Some(center) = place(dice, radius, burn) else { return };
    let (along, drive) = (dice.heading(), dice.0.random_range(0..3));
    let level = dice.between(0.6, 0.95);
    canvas.paint_near(center, radius + 20.0, |p, old| {
        let d = p - center;
        let (s, t) = (d.dot(&along), d.x * along.y - d.y * along.x);
        let bar = |a: f64, b: f64| (a.abs() - 0.7 * radius).max(b.abs() - 0.1 * radius);
        let socket = match drive {
            0 => bar(s, t),
            1 => bar(s, t).min(bar(t, s)),
            _ => {
                let turned = |deg: f64| {
                    let (sin, cos) = deg.to_radians().sin_cos();
                    (cos * s + sin * t).abs()
                };
                turned(0.0).max(turned(60.0)).max(turned(120.0)) - 0.45 * radius
            }
        };
        let rim = inside((d.norm() - 0.97 * radius).abs() - 0.04 * radius, 0.8);
        let head = old + (level - old) * inside(d.norm() - radius, 0.8);
        let head = head + (0.08 - head) * rim;
        head + (0.05 - head) * inside(socket, 0.8)
    });
}

/// A stamped or written word anywhere.
fn text(canvas: &mut Canvas, dice: &mut Dice) {
    let (scale, level) = (dice.between(2.0, 9.0), dice.between(0.0, 1.0));
    let mut corner = dice.place() - Vector2::new(100.0, 20.0);
    for _ in 0..dice.0.random_range(3..9) {
        let letter = b"ABCDEFGHKMNOPQRS0123456789"[dice.0.random_range(0..26)];
        if let Some(rows) = font8x8::BASIC_FONTS.get(char::from(letter)) {
            let from = corner;
            canvas.paint_near(from + Vector2::repeat(4.0 * scale), 4.5 * scale, |p, old| {
                let q = (p - from) / scale;
                let there = q.x >= 0.0 && q.y >= 0.0 && q.x < 8.0 && q.y < 8.0;
                let on = there && rows[q.y as usize] >> (q.x as usize) & 1 == 1;
                if on { 0.3 * old + 0.7 * level } else { old }
            });
        }
        corner.x += 8.0 * scale;
    }
}

/// A saturated reflection across the ring's rim.
fn glare(canvas: &mut Canvas, dice: &mut Dice, burn: &Burn) {
    let middle = burn.center + dice.heading() * burn.radius * dice.between(0.8, 1.2);
    let (long, wide) = (burn.radius * dice.between(0.2, 0.6), burn.radius * dice.between(0.1, 0.4));
    let (along, strength) = (dice.heading(), dice.between(0.5, 2.0));
    canvas.paint(|p, old| {
        let d = p - middle;
        let (s, t) = (d.dot(&along) / long, (d.x * along.y - d.y * along.x) / wide);
        old + strength * (-(s * s + t * t)).exp()
    });
}

/// Bright and dark droplets about the rim.
fn spatter(canvas: &mut Canvas, dice: &mut Dice, burn: &Burn) {
    for _ in 0..dice.0.random_range(5..80) {
        let center = burn.center + dice.heading() * burn.radius * dice.between(0.5, 1.6);
        let radius = dice.between(1.0, 6.0);
        let level = if dice.chance(0.6) { 0.1 } else { 0.9 };
        canvas.paint_near(center, radius + 6.0, |p, old| {
            old + (level - old) * inside((p - center).norm() - radius, 0.7)
        });
    }
}
