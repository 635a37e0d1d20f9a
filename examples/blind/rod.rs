//! Hidden effects in edge points of a check rod: the real edge is traced point by point into pixels.

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

use pivotsight::camera::{Calibration, Lens, Mapping};
use pivotsight::diagnose::data::rod::RodExperiment;
use pivotsight::diagnose::experiment::{Experiment, PlannedCapture};

use crate::Case;
use crate::plans::{gauss, shuffled};
use crate::score::Sort;
use crate::sealed::{Size, Truth};

const CAPTURES: usize = 60;
const RADIUS: f64 = 3.0;
const FOCAL_PX: f64 = 3520.0;
const MM_PER_UNIT: f64 = 30.0;
const NOISE_MM: f64 = 0.001;
const JITTER_MM: f64 = 0.0005;
const CENTRE: [f64; 2] = [12.4, -7.9];

#[derive(Clone)]
struct Capture {
    x: f64,
    y: f64,
    c: f64,
    t: f64,
    temp: f64,
    dir_x: f64,
    dir_y: f64,
    approach: f64,
}

/// What is wrong with one point: rod centre and radius, machine place, and the camera as a map of plane offsets.
#[derive(Clone, Copy, Default)]
struct Wrong {
    centre: [f64; 2],
    radius: f64,
    place: [f64; 2],
    seen: [f64; 2],
}

/// (capture, edge angle, plane offset, size) → what is wrong.
type Effect = Box<dyn Fn(&Capture, f64, [f64; 2], f64) -> Wrong>;

const NAMES: &[&str] = &[
    "pixel-scale",
    "pixel-aspect",
    "camera-rotation",
    "camera-shear",
    "camera-tilt",
    "lens-radial",
    "lens-radial-5",
    "lens-decentring",
    "edge-bias-light",
    "shutter-skew",
    "scale-x",
    "scale-y",
    "squareness-xy",
    "backlash-x",
    "backlash-y",
    "cyclic-x",
    "cyclic-y",
    "rod-eccentricity",
    "rod-oval",
    "rod-three-lobe",
    "c-radial-2x",
    "drift-time",
    "drift-temperature",
    "rod-growth",
];

fn plan(sort: &Sort, rng: &mut impl Rng) -> Vec<Capture> {
    let mut list = Vec::new();
    for i in 0..CAPTURES {
        let c: f64 = if sort.poor {
            0.0
        } else {
            (i as f64 * 6.0 + rng.random_range(-2.0..2.0)).to_radians()
        };
        list.push((
            CENTRE[0] + rng.random_range(-3.0..3.0),
            CENTRE[1] + rng.random_range(-2.0..2.0),
            c,
        ));
    }
    let order = if sort.poor { (0..CAPTURES).collect() } else { shuffled(CAPTURES, rng) };
    let mut captures: Vec<Capture> = Vec::new();
    for (k, i) in order.into_iter().enumerate() {
        let t = 40.0 * k as f64 + rng.random_range(0.0..9.0);
        let temp =
            20.0 + 5.0 * (1.0 - (-t / 1200.0).exp()) + 1.2 * (t / 350.0).sin() + 0.02 * gauss(rng);
        let mut side = || if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let (x, y, c) = list[i];
        captures.push(Capture {
            x,
            y,
            c,
            t,
            temp,
            dir_x: side(),
            dir_y: side(),
            approach: rng.random_range(1.0..20.0),
        });
    }
    for _ in 0..sort.repeats {
        let at = rng.random_range(0..captures.len());
        let mut again = captures[at].clone();
        again.t += 5.0;
        captures.insert(at + 1, again);
    }
    captures
}

fn effect(name: &str, captures: &[Capture], rng: &mut impl Rng) -> Effect {
    let phase: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let (cp, sp) = (phase.cos(), phase.sin());
    let span = captures.last().map_or(1.0, |c| c.t);
    let rise = rng.random_range(0.3..1.5) * span;
    let wide = MM_PER_UNIT;
    let seen = |f: fn([f64; 2]) -> [f64; 2]| -> Effect {
        Box::new(move |_, _, w, a| {
            let s = f(w);
            Wrong { seen: [a * s[0], a * s[1]], ..Wrong::default() }
        })
    };
    match name {
        "pixel-scale" => seen(|w| [-w[0] / (1.0 + 1e-4), -w[1] / (1.0 + 1e-4)]),
        "pixel-aspect" => seen(|w| [0.0, -w[1]]),
        "camera-rotation" => seen(|w| [w[1], -w[0]]),
        "camera-shear" => seen(|w| [w[1], 0.0]),
        "camera-tilt" => Box::new(move |_, _, w, a| {
            let k = a * (cp * w[0] + sp * w[1]);
            Wrong { seen: [w[0] * k / (1.0 - k), w[1] * k / (1.0 - k)], ..Wrong::default() }
        }),
        // The division model instead of the polynomial.
        "lens-radial" => Box::new(move |_, _, w, a| {
            let r2 = (w[0] * w[0] + w[1] * w[1]) / wide / wide;
            let f = 1.0 / (1.0 - a * r2) - 1.0;
            Wrong { seen: [w[0] * f, w[1] * f], ..Wrong::default() }
        }),
        "lens-radial-5" => Box::new(move |_, _, w, a| {
            let r2 = (w[0] * w[0] + w[1] * w[1]) / wide / wide;
            Wrong { seen: [w[0] * a * r2 * r2, w[1] * a * r2 * r2], ..Wrong::default() }
        }),
        "lens-decentring" => Box::new(move |_, _, w, a| {
            let (x, y) = (w[0] / wide, w[1] / wide);
            let (p1, p2, r2) = (a * cp, a * sp, x * x + y * y);
            Wrong {
                seen: [
                    wide * (2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)),
                    wide * (p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y),
                ],
                ..Wrong::default()
            }
        }),
        "edge-bias-light" => Box::new(move |_, _, w, a| Wrong {
            radius: a * (cp * w[0] + sp * w[1]),
            ..Wrong::default()
        }),
        "shutter-skew" => Box::new(|c, _, w, a| Wrong {
            seen: [a * c.dir_x * w[1], a * c.dir_y * w[1]],
            ..Wrong::default()
        }),
        "scale-x" => Box::new(|c, _, _, a| Wrong { place: [a * c.x, 0.0], ..Wrong::default() }),
        "scale-y" => Box::new(|c, _, _, a| Wrong { place: [0.0, a * c.y], ..Wrong::default() }),
        "squareness-xy" => {
            Box::new(|c, _, _, a| Wrong { place: [-a * c.y, 0.0], ..Wrong::default() })
        }
        "backlash-x" => Box::new(|c, _, _, a| Wrong {
            place: [-a * c.dir_x * (1.0 - 0.6 * (-c.approach / 4.0).exp()), 0.0],
            ..Wrong::default()
        }),
        "backlash-y" => Box::new(|c, _, _, a| Wrong {
            place: [0.0, -a * c.dir_y * (1.0 - 0.6 * (-c.approach / 4.0).exp())],
            ..Wrong::default()
        }),
        "cyclic-x" => Box::new(move |c, _, _, a| Wrong {
            place: [
                a * ((c.x / 2.0 * std::f64::consts::TAU + phase).sin()
                    + 0.1 * (c.x * std::f64::consts::TAU).sin()),
                0.0,
            ],
            ..Wrong::default()
        }),
        "cyclic-y" => Box::new(move |c, _, _, a| Wrong {
            place: [
                0.0,
                a * ((c.y / 2.0 * std::f64::consts::TAU + phase).sin()
                    + 0.1 * (c.y * std::f64::consts::TAU).sin()),
            ],
            ..Wrong::default()
        }),
        "rod-eccentricity" => Box::new(move |c, _, _, a| Wrong {
            centre: [a * (c.c + phase).cos(), a * (c.c + phase).sin()],
            ..Wrong::default()
        }),
        // An ellipse, not a cosine.
        "rod-oval" => Box::new(move |c, phi, _, a| {
            let p = phi - c.c - phase;
            let e = a / RADIUS;
            Wrong {
                radius: RADIUS * ((1.0 - e * e) / (1.0 - 2.0 * e * (2.0 * p).cos() + e * e)).sqrt()
                    - RADIUS,
                ..Wrong::default()
            }
        }),
        "rod-three-lobe" => Box::new(move |c, phi, _, a| Wrong {
            radius: a * (3.0 * (phi - c.c) - phase).cos(),
            ..Wrong::default()
        }),
        "c-radial-2x" => {
            let ratio = rng.random_range(0.3..1.0);
            let second: f64 = rng.random_range(0.0..6.0);
            Box::new(move |c, _, _, a| Wrong {
                centre: [a * (2.0 * c.c + phase).cos(), a * ratio * (2.0 * c.c + second).sin()],
                ..Wrong::default()
            })
        }
        "drift-time" => Box::new(move |c, _, _, a| {
            let s = a * (1.0 - (-c.t / rise).exp());
            Wrong { centre: [cp * s, sp * s], ..Wrong::default() }
        }),
        "drift-temperature" => Box::new(move |c, _, _, a| Wrong {
            centre: [a * cp * (c.temp - 22.0), a * sp * (c.temp - 22.0)],
            ..Wrong::default()
        }),
        _ => Box::new(|c, _, _, a| Wrong { radius: a * (c.temp - 20.0), ..Wrong::default() }),
    }
}

/// A variable as it is read from the plan.
type Reading = Box<dyn Fn(&Capture, f64) -> f64>;

fn stranger(outside: bool, captures: &[Capture], rng: &mut impl Rng) -> (&'static str, Effect) {
    let output = rng.random_range(0..3usize);
    let span = captures.last().map_or(1.0, |c| c.t);
    let variable = rng.random_range(0..3u8);
    let (name, get): (&'static str, Reading) = match variable {
        0 => ("c_deg", Box::new(|c, _| c.c.to_degrees().rem_euclid(360.0))),
        1 => ("t_s", Box::new(move |c, _| 360.0 * c.t / span)),
        _ => ("rod_angle_deg", Box::new(|c, phi| (phi - c.c).to_degrees().rem_euclid(360.0))),
    };
    let output = if variable == 2 { 2 } else { output };
    let (at, phase): (f64, f64) = (rng.random_range(40.0..320.0), rng.random_range(0.0..360.0));
    let shape: Box<dyn Fn(f64) -> f64> = if outside {
        Box::new(move |x| ((x + phase) / 47.0).rem_euclid(1.0) - 0.5)
    } else {
        match (variable, rng.random_range(0..3u8)) {
            (0 | 2, 0) => {
                let k = f64::from(rng.random_range(5..=6u8));
                Box::new(move |x| (k * (x + phase).to_radians()).sin())
            }
            (_, 1) => Box::new(move |x| if x > at { 1.0 } else { 0.0 }),
            _ => {
                let width = rng.random_range(15.0..35.0);
                Box::new(move |x| (-((x - at) / width).powi(2)).exp())
            }
        }
    };
    let effect: Effect = Box::new(move |c, phi, _, a| {
        let s = a * shape(get(c, phi));
        match output {
            0 => Wrong { centre: [s, 0.0], ..Wrong::default() },
            1 => Wrong { centre: [0.0, s], ..Wrong::default() },
            _ => Wrong { radius: s, ..Wrong::default() },
        }
    });
    (name, effect)
}

/// Radial displacement of the seen edge, to first order, for sizing.
fn radial(e: &Effect, c: &Capture, phi: f64, size: f64) -> f64 {
    let n = [phi.cos(), phi.sin()];
    let w = [CENTRE[0] + RADIUS * n[0] - c.x, CENTRE[1] + RADIUS * n[1] - c.y];
    let x = e(c, phi, w, size);
    x.radius + (0..2).map(|k| n[k] * (x.centre[k] - x.place[k] + x.seen[k])).sum::<f64>()
}

/// Standard errors that a unit of an effect is worth, after centre and radius have been fitted.
fn worth(e: &Effect, captures: &[Capture], points: usize) -> f64 {
    let n = points as f64;
    let mut shifts = Vec::new();
    let mut rest = Vec::new();
    for c in captures {
        let r: Vec<f64> = (0..points)
            .map(|k| radial(e, c, k as f64 / n * std::f64::consts::TAU, 1e-6) / 1e-6)
            .collect();
        let phi = |k: usize| k as f64 / n * std::f64::consts::TAU;
        let s: [f64; 2] = [
            2.0 / n * (0..points).map(|k| r[k] * phi(k).cos()).sum::<f64>(),
            2.0 / n * (0..points).map(|k| r[k] * phi(k).sin()).sum::<f64>(),
        ];
        rest.extend((0..points).map(|k| r[k] - s[0] * phi(k).cos() - s[1] * phi(k).sin()));
        shifts.push(s);
    }
    let count = captures.len() as f64;
    let mut information = 0.0;
    for k in 0..2 {
        let mean = shifts.iter().map(|s| s[k]).sum::<f64>() / count;
        let spread: f64 = shifts.iter().map(|s| (s[k] - mean).powi(2)).sum();
        information += spread / (JITTER_MM.powi(2) + 2.0 * NOISE_MM.powi(2) / n);
    }
    let mean = rest.iter().sum::<f64>() / rest.len() as f64;
    information += rest.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / NOISE_MM.powi(2);
    information.sqrt()
}

/// The library's parameter of an effect that has its very form, and the value that a size stands for.
fn library_size(name: &str, size: f64) -> Option<(&'static str, f64)> {
    match name {
        "pixel-aspect" => Some(("v_um_per_m", 1e6 * size)),
        "pixel-scale" | "camera-shear" | "scale-x" | "scale-y" | "squareness-xy" => {
            Some(("um_per_m", 1e6 * size))
        }
        "camera-rotation" => Some(("angle_deg", size.to_degrees())),
        "rod-growth" => Some(("radius_mm_per_c", size)),
        _ => None,
    }
}

/// One case, with this many edge points in each capture.
pub fn case(sort: &Sort, index: usize, points: usize, mut own: ChaCha8Rng) -> (Case, Truth) {
    let rng = &mut own;
    let captures = plan(sort, rng);
    let mut truth = Truth::default();
    let mut hidden: Vec<Effect> = Vec::new();
    while truth.names.len() < sort.known {
        let at = if truth.names.is_empty() { index } else { rng.random_range(0..NAMES.len()) };
        let name = NAMES[at % NAMES.len()];
        // Nothing turns in the poor plan: what needs C cannot be hidden in it.
        let name = if sort.poor && ["rod-eccentricity", "c-radial-2x"].contains(&name) {
            "rod-oval"
        } else {
            name
        };
        if !truth.names.iter().any(|n| n == name) {
            truth.names.push(name.to_owned());
            hidden.push(effect(name, &captures, rng));
        }
    }
    if sort.unknown > 0 {
        let (variable, e) = stranger(sort.unknown == 2, &captures, rng);
        truth.unknown = Some(variable.to_owned());
        hidden.push(e);
    }
    let sizes: Vec<f64> = hidden
        .iter()
        .enumerate()
        .map(|(nth, e)| sort.size(nth, hidden.len(), rng) / worth(e, &captures, points).max(1e-9))
        .collect();
    truth.sizes = Size::list(&truth.names, &sizes, library_size);
    let mut csv = String::from("capture,x_mm,y_mm,c_deg,t_s,temp_c,dir_x,dir_y,u_px,v_px\n");
    let mut lines = move |k: usize, c: &Capture| -> String {
        let mut csv = String::new();
        let rng = &mut own;
        let jitter = [JITTER_MM * gauss(rng), JITTER_MM * gauss(rng)];
        for p in 0..points {
            let phi =
                (p as f64 + rng.random_range(-0.3..0.3)) / points as f64 * std::f64::consts::TAU;
            let n = [phi.cos(), phi.sin()];
            let rough = [CENTRE[0] + RADIUS * n[0] - c.x, CENTRE[1] + RADIUS * n[1] - c.y];
            let mut w = Wrong::default();
            for (e, a) in hidden.iter().zip(&sizes) {
                let x = e(c, phi, rough, *a);
                for i in 0..2 {
                    w.centre[i] += x.centre[i];
                    w.place[i] += x.place[i];
                    w.seen[i] += x.seen[i];
                }
                w.radius += x.radius;
            }
            let noise = NOISE_MM * gauss(rng);
            let at: [f64; 2] = std::array::from_fn(|i| {
                let edge = CENTRE[i] + w.centre[i] + jitter[i] + (RADIUS + w.radius + noise) * n[i];
                edge - [c.x, c.y][i] - w.place[i] + w.seen[i]
            });
            let (u, v) =
                (799.5 + FOCAL_PX * at[0] / MM_PER_UNIT, 599.5 - FOCAL_PX * at[1] / MM_PER_UNIT);
            csv += &format!(
                "{k},{:.6},{:.6},{:.5},{:.2},{:.3},{},{},{u:.5},{v:.5}\n",
                c.x,
                c.y,
                c.c.to_degrees(),
                c.t,
                c.temp,
                c.dir_x,
                c.dir_y
            );
        }
        csv
    };
    for (k, c) in captures.iter().enumerate() {
        csv += &lines(k, c);
    }
    let (mut count, mut last) = (captures.len(), captures[captures.len() - 1].clone());
    let more = move |planned: &[PlannedCapture]| -> String {
        let measured = planned.iter().map(|p| {
            let get = |name: &str| p.number(name).unwrap_or(0.0);
            last.t += 40.0;
            last.approach = 10.0;
            (last.x, last.y, last.c) = (get("x_mm"), get("y_mm"), get("c_deg").to_radians());
            (last.dir_x, last.dir_y) = (get("dir_x"), get("dir_y"));
            count += 1;
            lines(count - 1, &last)
        });
        measured.collect()
    };
    (Case { csv, noise_mm: None, more: Box::new(more) }, truth)
}

/// The data as the diagnosis reads them.
pub fn read(csv: &str) -> Box<dyn Experiment> {
    let table = pivotsight::table::Table::parse(
        "blind.csv",
        csv.as_bytes(),
        &["capture", "x_mm", "y_mm", "u_px", "v_px"],
        &["c_deg", "t_s", "temp_c", "dir_x", "dir_y"],
    )
    .expect("the generator writes good tables");
    let lens = Lens {
        width_px: 1600,
        height_px: 1200,
        fx_px: FOCAL_PX,
        fy_px: FOCAL_PX,
        cx_px: 799.5,
        cy_px: 599.5,
        distortion: [0.0; 5],
    };
    let homography_mm =
        nalgebra::Matrix3::new(MM_PER_UNIT, 0.0, 0.0, 0.0, -MM_PER_UNIT, 0.0, 0.0, 0.0, 1.0);
    let calibration = Calibration {
        name: String::new(),
        mapping: Mapping::Pinhole { lens, homography_mm, covariance: None, mirrored: false },
        laser: None,
        gamma: 1.0,
    };
    Box::new(
        RodExperiment::from_table(&table, &calibration, None, &mut Vec::new()).expect("good data"),
    )
}
