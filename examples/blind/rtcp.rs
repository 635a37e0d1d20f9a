//! Hidden effects in RTCP sweeps, from plain trigonometry rather than the library's rotations.

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

use pivotsight::diagnose::data::rtcp::RtcpExperiment;
use pivotsight::diagnose::experiment::{Experiment, PlannedCapture};
use pivotsight::machine::{Head, Machine, Table as TableOrigin, Target};

use crate::Case;
use crate::plans::{gauss, length_beyond, shuffled};
use crate::score::Sort;
use crate::sealed::{Size, Truth};

const DX: f64 = 0.283;
const R: f64 = 214.7;
const P: [f64; 3] = [80.0, 0.0, 100.0];
const NOISE_MM: f64 = 0.002;

struct Row {
    b: f64,
    c: f64,
    dir_b: f64,
    dir_c: f64,
    t: f64,
    temp: f64,
    approach: f64,
}

/// The plan: 13 B angles × 12 irregular C angles in random order.
fn plan(sort: &Sort, rng: &mut impl Rng) -> Vec<Row> {
    let cs: Vec<f64> = if sort.poor {
        vec![0.0, 72.0, 144.0, 216.0, 288.0]
    } else {
        (0..12).map(|i| f64::from(i) * 30.0 + rng.random_range(-9.0..9.0)).collect()
    };
    let mut poses = Vec::new();
    for b in 0..13 {
        for &c in &cs {
            poses.push((f64::from(b) * 15.0 - 90.0, c));
        }
    }
    let order: Vec<usize> =
        if sort.poor { (0..poses.len()).collect() } else { shuffled(poses.len(), rng) };
    let mut list: Vec<(f64, f64, bool)> =
        order.into_iter().map(|i| (poses[i].0, poses[i].1, false)).collect();
    for _ in 0..sort.repeats {
        let at = rng.random_range(1..list.len());
        list.insert(at, (list[at - 1].0, list[at - 1].1, true));
    }
    let heat = rng.random_range(3.0..8.0);
    let rise = rng.random_range(1500.0..4000.0);
    let mut rows: Vec<Row> = Vec::new();
    for (i, (b, c, repeat)) in list.into_iter().enumerate() {
        let t = i as f64 * 25.0 + rng.random_range(0.0..5.0);
        let cycle = 0.8 * (t / 900.0).sin();
        let temp = 20.0 + heat * (1.0 - (-t / rise).exp()) + cycle + 0.02 * gauss(rng);
        let mut side = || if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let (mut dir_b, mut dir_c) = if sort.poor { (1.0, 1.0) } else { (side(), side()) };
        let approach = rng.random_range(5.0..60.0);
        if let (true, Some(last)) = (repeat, rows.last()) {
            (dir_b, dir_c) = (last.dir_b, last.dir_c);
        }
        rows.push(Row { b: b.to_radians(), c: c.to_radians(), dir_b, dir_c, t, temp, approach });
    }
    rows
}

const NAMES: &[&str] = &[
    "pivot-offset-x",
    "pivot-length",
    "b-zero",
    "b-axis-tilt-x",
    "b-axis-tilt-z",
    "c-axis-tilt-x",
    "c-axis-tilt-y",
    "c-centre",
    "b-pitch-error",
    "c-pitch-error",
    "b-backlash",
    "c-backlash",
    "head-sag",
    "thermal-growth",
    "drift-time",
    "squareness-xy",
    "squareness-xz",
    "squareness-yz",
    "scale-x",
    "scale-y",
    "scale-z",
    "c-radial-2x",
    "c-axial",
    "target-runout",
];

type Effect = Box<dyn Fn(&Row, f64) -> [f64; 3]>;

/// Head vector turned by a B angle, then tilted by small angles about X and Z about the point it has at B = 0.
fn head(b: f64, dx: f64, r: f64) -> [f64; 3] {
    [dx * b.cos() - r * b.sin(), 0.0, -dx * b.sin() - r * b.cos()]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// The table's point turned by C.
fn turned(c: f64) -> [f64; 3] {
    [P[0] * c.cos() - P[1] * c.sin(), P[0] * c.sin() + P[1] * c.cos(), P[2]]
}

/// Where the control sends the linear axes.
fn place(row: &Row) -> [f64; 3] {
    minus(turned(row.c), minus(head(row.b, DX, R), head(0.0, DX, R)))
}

/// The effect of the given name and a size, in mm of deviation.
fn effect(name: &str, rows: &[Row], rng: &mut impl Rng) -> Effect {
    let phase: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let phase2: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let order = f64::from(rng.random_range(1..=4u8));
    let span = rows.last().map_or(1.0, |r| r.t);
    let lean = [gauss(rng), gauss(rng), gauss(rng)];
    match name {
        "pivot-offset-x" => {
            Box::new(|r, a| minus(minus(head(r.b, DX + a, R), head(r.b, DX, R)), [a, 0.0, 0.0]))
        }
        "pivot-length" => {
            Box::new(|r, a| minus(minus(head(r.b, DX, R + a), head(r.b, DX, R)), [0.0, 0.0, -a]))
        }
        "b-zero" => Box::new(|r, a| minus(head(r.b + a / R, DX, R), head(r.b, DX, R))),
        "b-axis-tilt-x" => Box::new(|r, a| {
            // Rotation about the axis (0, cos α, sin α) through the pivot, by Rodrigues' formula.
            let n = [0.0, (a / R).cos(), (a / R).sin()];
            minus(rodrigues(n, r.b, [DX, 0.0, -R]), head(r.b, DX, R))
        }),
        "b-axis-tilt-z" => Box::new(|r, a| {
            let n = [-(a / R).sin(), (a / R).cos(), 0.0];
            minus(rodrigues(n, r.b, [DX, 0.0, -R]), head(r.b, DX, R))
        }),
        "c-axis-tilt-x" => Box::new(|r, a| {
            let n = [0.0, -(a / 80.0).sin(), (a / 80.0).cos()];
            minus(turned(r.c), rodrigues(n, r.c, P))
        }),
        "c-axis-tilt-y" => Box::new(|r, a| {
            let n = [(a / 80.0).sin(), 0.0, (a / 80.0).cos()];
            minus(turned(r.c), rodrigues(n, r.c, P))
        }),
        "c-centre" => Box::new(move |_, a| [-a * phase.cos(), -a * phase.sin(), 0.0]),
        "b-pitch-error" => Box::new(move |r, a| {
            let e = a / R
                * ((order * r.b + phase).sin()
                    + 0.25 * (((order % 4.0) + 1.0) * r.b + phase2).sin());
            minus(head(r.b + e, DX, R), head(r.b, DX, R))
        }),
        "c-pitch-error" => Box::new(move |r, a| {
            let e = a / 80.0
                * ((order * r.c + phase).sin()
                    + 0.25 * (((order % 4.0) + 1.0) * r.c + phase2).sin());
            minus(turned(r.c), turned(r.c + e))
        }),
        "b-backlash" => Box::new(|r, a| {
            let lost = a / R * (1.0 - 0.6 * (-r.approach / 10.0).exp());
            minus(head(r.b - r.dir_b * lost, DX, R), head(r.b, DX, R))
        }),
        "c-backlash" => Box::new(|r, a| {
            let lost = a / 80.0 * (1.0 - 0.6 * (-r.approach / 10.0).exp());
            minus(turned(r.c), turned(r.c - r.dir_c * lost))
        }),
        "head-sag" => match rng.random_range(0..3u8) {
            // A beam bent by the part of its weight across it.
            0 => Box::new(|r, a| minus(head(r.b + a / R * r.b.sin(), DX, R), head(r.b, DX, R))),
            1 => Box::new(|r, a| [0.0, 0.0, -a * r.b.sin().abs()]),
            _ => Box::new(|r, a| [a * r.b.sin(), 0.0, 0.0]),
        },
        "thermal-growth" => {
            let lag = rng.random_range(60.0..900.0);
            let mut state = rows[0].temp;
            let mut last = rows[0].t;
            let mut warm = Vec::new();
            for r in rows {
                let steps = 20;
                for _ in 0..steps {
                    state += (r.temp - state) * ((r.t - last) / f64::from(steps) / lag);
                }
                last = r.t;
                warm.push((r.t, state - 20.0));
            }
            Box::new(move |r, a| {
                let i = warm.partition_point(|(t, _)| *t < r.t - 1e-9);
                // After the run: in balance with the air.
                let state = warm.get(i).map_or(r.temp - 20.0, |w| w.1);
                let g = a * 0.2 * state;
                [-g * r.b.sin(), 0.0, -g * r.b.cos()]
            })
        }
        "drift-time" => {
            let rise = rng.random_range(0.3..1.5) * span;
            Box::new(move |r, a| {
                let s = a * (1.0 - (-r.t / rise).exp());
                [lean[0] * s, lean[1] * s, lean[2] * s]
            })
        }
        "squareness-xy" => Box::new(|r, a| [-place(r)[1] * (a / 100.0).tan(), 0.0, 0.0]),
        "squareness-xz" => Box::new(|r, a| [place(r)[2] * (a / 100.0).tan(), 0.0, 0.0]),
        "squareness-yz" => Box::new(|r, a| [0.0, -place(r)[2] * (a / 100.0).tan(), 0.0]),
        "scale-x" => Box::new(|r, a| [place(r)[0] * a / 100.0, 0.0, 0.0]),
        "scale-y" => Box::new(|r, a| [0.0, place(r)[1] * a / 100.0, 0.0]),
        "scale-z" => Box::new(|r, a| [0.0, 0.0, place(r)[2] * a / 100.0]),
        "c-radial-2x" => {
            let ratio = rng.random_range(0.3..1.0);
            Box::new(move |r, a| {
                [-a * (2.0 * r.c + phase).cos(), -a * ratio * (2.0 * r.c + phase2).sin(), 0.0]
            })
        }
        "c-axial" => {
            let k = order.max(2.0);
            Box::new(move |r, a| [0.0, 0.0, -a * (k * r.c + phase).cos()])
        }
        _ => Box::new(move |r, a| [-a * (r.c + phase).cos(), 0.0, 0.0]),
    }
}

fn rodrigues(n: [f64; 3], angle: f64, v: [f64; 3]) -> [f64; 3] {
    let cross = [n[1] * v[2] - n[2] * v[1], n[2] * v[0] - n[0] * v[2], n[0] * v[1] - n[1] * v[0]];
    let dot = n[0] * v[0] + n[1] * v[1] + n[2] * v[2];
    let (s, c) = angle.sin_cos();
    std::array::from_fn(|i| v[i] * c + cross[i] * s + n[i] * dot * (1.0 - c))
}

/// A variable as it is read from the plan.
type Reading = Box<dyn Fn(&Row) -> f64>;

/// An effect in no library: one output, one variable.
fn stranger(outside: bool, rows: &[Row], rng: &mut impl Rng) -> (&'static str, Effect) {
    let output = rng.random_range(0..3usize);
    let variable = rng.random_range(0..3u8);
    let span = rows.last().map_or(1.0, |r| r.t);
    let (name, get): (&'static str, Reading) = match variable {
        0 => ("b_deg", Box::new(|r| r.b.to_degrees())),
        1 => ("c_deg", Box::new(|r| r.c.to_degrees().rem_euclid(360.0))),
        _ => ("t_s", Box::new(move |r| 360.0 * r.t / span)),
    };
    let at =
        if variable == 0 { rng.random_range(-70.0..70.0) } else { rng.random_range(40.0..320.0) };
    let phase: f64 = rng.random_range(0.0..360.0);
    let shape: Box<dyn Fn(f64) -> f64> = if outside {
        match rng.random_range(0..2u8) {
            0 => Box::new(move |x| ((x + phase) / 47.0).rem_euclid(1.0) - 0.5),
            _ => Box::new(
                move |x| if ((x + phase) / 33.0).rem_euclid(1.0) < 0.35 { 1.0 } else { 0.0 },
            ),
        }
    } else {
        match (variable, rng.random_range(0..3u8)) {
            (0 | 1, 0) => {
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
    let effect: Effect = Box::new(move |r, a| {
        let mut d = [0.0; 3];
        d[output] = a * shape(get(r));
        d
    });
    (name, effect)
}

/// The library's parameter of an effect that has its very form, and the value that a size stands for.
fn library_size(name: &str, size: f64) -> Option<(&'static str, f64)> {
    match name {
        "pivot-offset-x" => Some(("delta_x_mm", size)),
        "pivot-length" => Some(("r_mm", size)),
        "b-zero" => Some(("angle_deg", (size / R).to_degrees())),
        "b-axis-tilt-x" | "b-axis-tilt-z" => Some(("tilt_deg", (size / R).to_degrees())),
        "c-axis-tilt-x" | "c-axis-tilt-y" => Some(("tilt_deg", (size / 80.0).to_degrees())),
        _ if name.starts_with("squareness") || name.starts_with("scale") => {
            Some(("um_per_m", 1e4 * size))
        }
        _ => None,
    }
}

/// One case.
pub fn case(sort: &Sort, index: usize, mut own: ChaCha8Rng) -> (Case, Truth) {
    let rng = &mut own;
    let rows = plan(sort, rng);
    let mut truth = Truth::default();
    let mut hidden: Vec<Effect> = Vec::new();
    while truth.names.len() < sort.known {
        let skip = if sort.poor { ["b-backlash", "c-backlash"] } else { ["", ""] };
        let name = if truth.names.is_empty() {
            NAMES[index % NAMES.len()]
        } else {
            NAMES[rng.random_range(0..NAMES.len())]
        };
        let name = if skip.contains(&name) { "pivot-length" } else { name };
        if !truth.names.iter().any(|n| n == name) {
            truth.names.push(name.to_owned());
            hidden.push(effect(name, &rows, rng));
        }
    }
    if sort.unknown > 0 {
        let (variable, e) = stranger(sort.unknown == 2, &rows, rng);
        truth.unknown = Some(variable.to_owned());
        hidden.push(e);
    }
    let mut sizes = Vec::new();
    // The target's place: fixed to the table.
    let nuisance: Vec<Vec<f64>> = (0..3)
        .map(|k| {
            rows.iter()
                .flat_map(|r| {
                    let (s, c) = r.c.sin_cos();
                    [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]][k]
                })
                .collect()
        })
        .collect();
    for (nth, e) in hidden.iter().enumerate() {
        let unit: Vec<f64> = rows.iter().flat_map(|r| e(r, 1e-6)).collect();
        let seen = length_beyond(unit, &nuisance) / 1e-6;
        let z = sort.size(nth, hidden.len(), rng);
        let size = if seen > 1e-6 { z * NOISE_MM / seen } else { 0.05 };
        sizes.push(size);
    }
    let shift = [0.03 * gauss(rng), 0.03 * gauss(rng), 0.03 * gauss(rng)];
    truth.sizes = Size::list(&truth.names, &sizes, library_size);
    let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm,dir_b,dir_c,t_s,temp_c\n");
    let mut line = move |r: &Row| -> String {
        let total = hidden.iter().zip(&sizes).fold([0.0; 3], |d, (e, a)| plus(d, e(r, *a)));
        let (s, c) = r.c.sin_cos();
        let n = [c * shift[0] - s * shift[1], s * shift[0] + c * shift[1], shift[2]];
        let d: [f64; 3] = std::array::from_fn(|i| total[i] - n[i] + NOISE_MM * gauss(&mut own));
        format!(
            "{:.6},{:.6},{:.7},{:.7},{:.7},{},{},{:.2},{:.3}\n",
            r.b.to_degrees(),
            r.c.to_degrees(),
            d[0],
            d[1],
            d[2],
            r.dir_b,
            r.dir_c,
            r.t,
            r.temp
        )
    };
    for r in &rows {
        csv += &line(r);
    }
    let (mut t, temp) = rows.last().map_or((0.0, 20.0), |r| (r.t, r.temp));
    let more = move |captures: &[PlannedCapture]| -> String {
        let lines = captures.iter().map(|capture| {
            t += 25.0;
            let get = |name: &str| capture.number(name).unwrap_or(1.0);
            let temp = capture.number("temp_c").unwrap_or(temp);
            let (b, c) = (get("b_deg").to_radians(), get("c_deg").to_radians());
            let (dir_b, dir_c) = (get("dir_b"), get("dir_c"));
            line(&Row { b, c, dir_b, dir_c, t, temp, approach: 30.0 })
        });
        lines.collect()
    };
    (Case { csv, noise_mm: None, more: Box::new(more) }, truth)
}

/// The data as the diagnosis reads them.
pub fn read(csv: &str) -> Box<dyn Experiment> {
    let table = pivotsight::table::Table::parse(
        "blind.csv",
        csv.as_bytes(),
        &["b_deg", "c_deg"],
        &["dx_mm", "dy_mm", "dz_mm", "dir_b", "dir_c", "t_s", "temp_c"],
    )
    .expect("the generator writes good tables");
    let mut machine = Machine::head_b_table_c(
        Head { delta_x_mm: DX, r_mm: R, standoff_mm: 0.0 },
        TableOrigin::default(),
    );
    machine.target = Some(Target { position_mm: P });
    Box::new(RtcpExperiment::from_table(&table, &machine, &mut Vec::new()).expect("good data"))
}
