//! Hidden effects in `ballbar`, `thermal` and `burn` data; `ballbar2` has a second path whose cup lies aside, `thermal3` three axes
//! with head coefficients of their own and effects on all of them or on one.

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

use pivotsight::diagnose::data::plain::PlainExperiment;
use pivotsight::diagnose::experiment::{Experiment, PlannedCapture};
use pivotsight::machine::{Head, Machine, Table as Origin};
use pivotsight::table::Table;

use crate::Case;
use crate::plans::{gauss, length_beyond};
use crate::score::Sort;
use crate::sealed::{Size, Truth};

/// A row's numbers, in the order of the kind's columns.
type Row = Vec<f64>;
/// What an effect of a size adds to each output.
type Effect = Box<dyn Fn(&Row, f64) -> [f64; 2]>;

const BURN: &[&str] = &[
    "beam-tilt-x",
    "beam-tilt-y",
    "nozzle-offset",
    "head-sag",
    "pointing-drift",
    "thermal-lens",
    "camera-tilt",
];
const THERMAL: &[&str] = &[
    "head-lag",
    "head-constant",
    "head-nonlinear",
    "screw-nonlinear",
    "position-quadratic",
    "heating-hysteresis",
    "drift-time",
];
/// What shows in the plane of a path with the cup in it.
const BALLBAR: &[&str] = &[
    "b-backlash",
    "z-backlash",
    "b-pitch-error",
    "cyclic-z",
    "thermal-growth",
    "pivot-offset-x",
    "pivot-length",
    "scale-z",
    "squareness-xz",
];

/// height, power, B, time
fn burn_plan(rng: &mut impl Rng) -> Vec<Row> {
    (0..80)
        .map(|k| {
            let height = [10.0, 20.0, 30.0, 40.0, 50.0][rng.random_range(0..5usize)];
            let power = [100.0, 250.0, 500.0, 750.0][rng.random_range(0..4usize)];
            vec![height, power, f64::from(rng.random_range(-6..=6)) * 15.0, 45.0 * f64::from(k)]
        })
        .collect()
}

fn burn_effect(name: &str, rng: &mut impl Rng) -> Effect {
    let phase: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let (c, s) = (phase.cos(), phase.sin());
    let rise = rng.random_range(1000.0..5000.0);
    match name {
        "beam-tilt-x" => Box::new(|r, a| [r[0] * (a / 50.0).tan(), 0.0]),
        "beam-tilt-y" => Box::new(|r, a| [0.0, r[0] * (a / 50.0).tan()]),
        "nozzle-offset" => Box::new(move |_, a| [a * c, a * s]),
        "head-sag" => Box::new(|r, a| [a * r[2].to_radians().sin(), 0.0]),
        "pointing-drift" => Box::new(move |r, a| {
            let d = a * (1.0 - (-r[3] / rise).exp());
            [d * c, d * s]
        }),
        "thermal-lens" => Box::new(move |r, a| [a * c * r[1] / 500.0, a * s * r[1] / 500.0]),
        _ => Box::new(move |r, a| {
            let ring = 0.5 + 0.02 * r[0];
            [a * c * ring * ring, a * s * ring * ring]
        }),
    }
}

/// Head coefficients (mm per °C) of the axes.
const HEADS: [[f64; 2]; 3] = [[0.003, -0.0015], [-0.001, 0.002], [0.0005, 0.001]];

/// position, screw, head 1, head 2, time, lagged head 1, warming (±1), axis
fn thermal_plan(axes: usize, rng: &mut impl Rng) -> Vec<Row> {
    let (mut lagged, mut last) = (0.0, [0.0; 3]);
    let lag = rng.random_range(400.0..1500.0);
    let late = rng.random_range(0.2..0.9);
    (0..180)
        .map(|k| {
            let t = 60.0 * f64::from(k);
            let power = |t: f64| 0.5 + 0.5 * (t / 1300.0).sin() * (t / 3100.0).cos();
            let h1 = 12.0 * (1.0 - (-t / 1500.0).exp()) * power(t);
            let h2 = 7.0 * (1.0 - (-t / 3000.0).exp()) * power(t - 700.0 * late);
            let axis = k as usize % axes;
            let period = [1700.0, 2300.0, 1300.0][axis];
            let screw = |t: f64| 20.0 + 7.0 * (1.0 - (t / period).cos());
            lagged += (h1 - lagged) * (1.0 - (-60.0_f64 / lag).exp());
            let warming = f64::signum(screw(t) - last[axis]);
            last[axis] = screw(t);
            let place = f64::from(rng.random_range(0..=10)) * 100.0;
            vec![place, screw(t), h1, h2, t, lagged, warming, axis as f64]
        })
        .collect()
}

/// `only`: the one axis that has it.
fn thermal_effect(name: &str, only: Option<usize>) -> Effect {
    let one = |f: fn(&Row) -> f64| -> Effect {
        Box::new(move |r, a| {
            let has = only.is_none_or(|axis| axis as f64 == r[7]);
            [if has { a * f(r) } else { 0.0 }, 0.0]
        })
    };
    match name {
        "head-lag" => one(|r| r[5] - r[2]),
        "head-constant" => one(|_| 1.0),
        "head-nonlinear" => one(|r| r[2] * r[2] * (1.0 + 0.02 * r[2])),
        "screw-nonlinear" => one(|r| (r[1] - 20.0).powi(2) * r[0] / 1e4),
        "position-quadratic" => one(|r| (r[0] / 1000.0).powi(2)),
        "heating-hysteresis" => one(|r| r[6]),
        _ => one(|r| 1.0 - (-r[4] / 9000.0).exp()),
    }
}

/// B (rad), Z, direction, temperature, how far the cup lies aside, X
fn ballbar_plan(aside_mm: &[f64], rng: &mut impl Rng) -> Vec<Row> {
    let mut rows = Vec::new();
    for (aside, way) in aside_mm.iter().flat_map(|aside| [(aside, 1.0), (aside, -1.0)]) {
        for k in 0..150 {
            let k = if way > 0.0 { f64::from(k) } else { 149.0 - f64::from(k) };
            let b = (-60.0 * k / 149.0_f64).to_radians();
            let temp = 20.0 + 4.0 * rng.random_range(0.0..1.0);
            rows.push(vec![b, -800.0 * (1.0 - b.cos()), -way, temp, *aside, 0.0]);
        }
    }
    rows
}

/// Length of the bar with the tool off by `(x, z)`.
fn length_mm(r: &Row, x: f64, z: f64) -> f64 {
    let (tx, tz) = (r[5] - 400.0 * r[0].sin(), -400.0 * r[0].cos() + r[1] + 800.0);
    ((tx + x).powi(2) + (tz + z).powi(2) + r[4] * r[4]).sqrt()
}

/// The same less the nominal.
fn stretch(r: &Row, x: f64, z: f64) -> [f64; 2] {
    [length_mm(r, x, z) - length_mm(r, 0.0, 0.0), 0.0]
}

fn ballbar_effect(name: &str, rng: &mut impl Rng) -> Effect {
    let phase: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let order = f64::from(rng.random_range(2..=4u8));
    let swing = |r: &Row, e: f64| {
        (-400.0 * ((r[0] + e).sin() - r[0].sin()), -400.0 * ((r[0] + e).cos() - r[0].cos()))
    };
    match name {
        "b-backlash" => Box::new(move |r, a| {
            let (x, z) = swing(r, -a / 400.0 * r[2]);
            stretch(r, x, z)
        }),
        "z-backlash" => Box::new(|r, a| stretch(r, 0.0, -a * r[2])),
        "b-pitch-error" => Box::new(move |r, a| {
            let (x, z) = swing(r, a / 400.0 * (order * r[0] + phase).sin());
            stretch(r, x, z)
        }),
        "cyclic-z" => Box::new(move |r, a| {
            stretch(r, 0.0, a * (r[1] / 10.0 * std::f64::consts::TAU + phase).sin())
        }),
        "pivot-offset-x" => Box::new(|r, a| stretch(r, a * r[0].cos(), -a * r[0].sin())),
        "pivot-length" => Box::new(|r, a| stretch(r, -a * r[0].sin(), -a * r[0].cos())),
        "scale-z" => Box::new(|r, a| stretch(r, 0.0, a * r[1] / 400.0)),
        "squareness-xz" => Box::new(|r, a| stretch(r, a * r[1] / 400.0, 0.0)),
        _ => Box::new(|r, a| {
            let g = a * (r[3] - 20.0);
            stretch(r, -g * r[0].sin(), -g * r[0].cos())
        }),
    }
}

/// Something that no library knows, and the variable it follows: a bump, or a wave of some periods.
fn stranger(kind: &str, rng: &mut impl Rng) -> (&'static str, Effect) {
    let (place, tau) = (rng.random_range(0.25..0.75), std::f64::consts::TAU);
    let (phase, turn) = (rng.random_range(0.0..tau), rng.random_range(0.0..tau));
    let periods = rng.random_range(2.2..4.8);
    let wave = rng.random_bool(0.5);
    let shape = move |part: f64| match wave {
        true => (periods * tau * part + phase).sin(),
        false => (-0.5 * ((part - place) / 0.08).powi(2)).exp(),
    };
    // Where each kind's variable stands in a row, its least value and its range.
    let (name, at, low, range) = match (kind, rng.random_bool(0.5)) {
        ("burn", true) => ("b_deg", 2, -90.0, 180.0),
        ("burn", false) => ("t_s", 3, 0.0, 3600.0),
        ("thermal", true) => ("position_mm", 0, 0.0, 1000.0),
        ("thermal", false) => ("t_s", 4, 0.0, 10_800.0),
        _ => ("b_deg", 0, -tau / 6.0, tau / 6.0),
    };
    let in_line = kind != "burn";
    let effect = move |r: &Row, a: f64| {
        let size = a * shape((r[at] - low) / range);
        if in_line { [size, 0.0] } else { [size * turn.cos(), size * turn.sin()] }
    };
    (name, Box::new(effect))
}

/// The library's parameter of an effect that has its very form, and the value that a size stands for.
fn library_size(name: &str, size: f64) -> Option<(&'static str, f64)> {
    match name {
        "beam-tilt-x" | "beam-tilt-y" => Some(("angle_deg", (size / 50.0).to_degrees())),
        "heating-hysteresis" => Some(("half_width_mm", size)),
        "b-backlash" => Some(("width_deg", (2.0 * size / 400.0).to_degrees())),
        "z-backlash" => Some(("width_mm", 2.0 * size)),
        "thermal-growth" => Some(("mm_per_c", size)),
        _ => None,
    }
}

/// What a kind's data are: those of several axes or paths (`thermal3`, `ballbar2`) are as those of one.
fn data(kind: &str) -> &str {
    kind.trim_end_matches(char::is_numeric)
}

/// One case of a kind.
pub fn case(kind: &str, sort: &Sort, index: usize, mut own: ChaCha8Rng) -> (Case, Truth) {
    let rng = &mut own;
    let (rows, names, noise) = match kind {
        "burn" => (burn_plan(rng), BURN, 0.003),
        "thermal" => (thermal_plan(1, rng), THERMAL, 0.001),
        "thermal3" => (thermal_plan(3, rng), THERMAL, 0.001),
        "ballbar2" => (ballbar_plan(&[0.0, 150.0], rng), BALLBAR, 0.0008),
        _ => (ballbar_plan(&[0.0], rng), BALLBAR, 0.0008),
    };
    let outputs = if kind == "burn" { 2 } else { 1 };
    let only = (kind == "thermal3" && rng.random_bool(0.5)).then(|| rng.random_range(0..3));
    let kind = data(kind);
    let mut truth = Truth::default();
    let mut hidden = Vec::new();
    while truth.names.len() < sort.known {
        let at = if truth.names.is_empty() { index } else { rng.random_range(0..names.len()) };
        let name = names[at % names.len()];
        if !truth.names.iter().any(|n| n == name) {
            truth.names.push(name.to_owned());
            hidden.push(match kind {
                "burn" => burn_effect(name, rng),
                "thermal" => thermal_effect(name, only),
                _ => ballbar_effect(name, rng),
            });
        }
    }
    if sort.unknown > 0 {
        let (variable, effect) = stranger(kind, rng);
        truth.unknown = Some(variable.to_owned());
        hidden.push(effect);
    }
    let column = |f: &dyn Fn(&Row) -> f64| rows.iter().map(f).collect::<Vec<f64>>();
    let nuisances = match kind {
        "burn" => Vec::new(),
        "thermal" => (0..3)
            .flat_map(|axis| {
                let on = move |r: &Row| f64::from(u8::from(r[7] == f64::from(axis)));
                [
                    column(&|r| on(r) * r[2]),
                    column(&|r| on(r) * r[3]),
                    column(&|r| on(r) * (r[1] - 20.0) * r[0]),
                    column(&|r| on(r) * (r[1] - 20.0)),
                ]
            })
            .collect(),
        _ => [0.0, 150.0]
            .iter()
            .flat_map(|aside| {
                let on = move |r: &Row| f64::from(u8::from(r[4] == *aside));
                [column(&on), column(&|r| on(r) * r[0].sin()), column(&|r| on(r) * r[0].cos())]
            })
            .collect(),
    };
    let mut sizes = Vec::new();
    for (nth, e) in hidden.iter().enumerate() {
        let unit: Vec<f64> = rows
            .iter()
            .flat_map(|r| e(r, 1e-6).into_iter().take(outputs).collect::<Vec<_>>())
            .collect();
        let z = sort.size(nth, hidden.len(), rng);
        sizes.push(z * noise * 1e-6 / length_beyond(unit, &nuisances).max(1e-15));
    }
    truth.sizes = Size::list(&truth.names, &sizes, library_size);
    let mut csv = String::from(match kind {
        "burn" => "height_mm,power_w,b_deg,t_s,dx_mm,dy_mm\n",
        "thermal" => "t_s,axis,position_mm,screw_c,head_1_c,head_2_c,error_mm\n",
        _ => "b_deg,x_mm,z_mm,dir,temp_c,path,length_mm\n",
    });
    let (dx, dz) = (0.05 * gauss(rng), 0.05 * gauss(rng));
    let of = kind.to_owned();
    let mut line = move |r: &Row| -> String {
        let mut v = [0.0; 2];
        for (e, a) in hidden.iter().zip(&sizes) {
            let x = e(r, *a);
            v = [v[0] + x[0], v[1] + x[1]];
        }
        let mut random = || noise * gauss(&mut own);
        match of.as_str() {
            "burn" => {
                let (dx, dy) = (v[0] + random(), v[1] + random());
                format!("{},{},{},{},{dx:.7},{dy:.7}\n", r[0], r[1], r[2], r[3])
            }
            "thermal" => {
                let axis = r[7] as usize;
                let [a, b] = HEADS[axis];
                let base = a * r[2] + b * r[3] + 1e-5 * (r[1] - 20.0) * (r[0] - 150.0);
                let error = base + v[0] + random();
                let name = ["x", "y", "z"][axis];
                format!("{},{name},{},{:.5},{:.5},{:.5},{error:.7}\n", r[4], r[0], r[1], r[2], r[3])
            }
            _ => {
                let length = length_mm(r, dx, dz) + v[0] + random();
                let path = match (r[4] == 0.0, r[5] == 0.0) {
                    (true, true) => "1",
                    (true, false) => "xb",
                    _ => "2",
                };
                let (b_deg, x_mm) = (r[0].to_degrees(), r[5]);
                format!(
                    "{b_deg:.6},{x_mm:.6},{:.6},{},{:.3},{path},{length:.7}\n",
                    r[1], r[2], r[3]
                )
            }
        }
    };
    for r in &rows {
        csv += &line(r);
    }
    let mut last = rows[rows.len() - 1].clone();
    let of = kind.to_owned();
    let more = move |captures: &[PlannedCapture]| -> String {
        let lines = captures.iter().map(|capture| {
            let old = last.clone();
            let get = |name: &str, old: f64| capture.number(name).unwrap_or(old);
            last = match of.as_str() {
                "burn" => vec![
                    get("height_mm", old[0]),
                    get("power_w", old[1]),
                    get("b_deg", old[2]),
                    old[3] + 45.0,
                ],
                "thermal" => {
                    let screw = get("screw_c", old[1]);
                    let t = get("t_s", old[4] + 60.0);
                    // The head rests and cools, and follows its sensor late.
                    let after = |lag_s: f64| ((old[4] - t) / lag_s).exp();
                    let (head_1, head_2) = (old[2] * after(3000.0), old[3] * after(5000.0));
                    let lagged = head_1 + (old[5] - head_1) * after(570.0);
                    let warming = f64::signum(screw - old[1]);
                    vec![
                        get("position_mm", old[0]),
                        screw,
                        head_1,
                        head_2,
                        t,
                        lagged,
                        warming,
                        capture.name("axis").map_or(0.0, |axis| match axis {
                            "x" => 0.0,
                            "y" => 1.0,
                            _ => 2.0,
                        }),
                    ]
                }
                _ => {
                    let aside = if capture.name("path") == Some("2") { 150.0 } else { 0.0 };
                    let b = get("b_deg", 0.0).to_radians();
                    let z_mm = get("z_mm", -800.0 * (1.0 - b.cos()));
                    vec![b, z_mm, get("dir", old[2]), old[3], aside, get("x_mm", 0.0)]
                }
            };
            line(&last)
        });
        lines.collect()
    };
    (Case { csv, noise_mm: None, more: Box::new(more) }, truth)
}

/// The data as the diagnosis reads them.
pub fn read(kind: &str, csv: &str) -> Box<dyn Experiment> {
    let table = Table::parse("blind.csv", csv.as_bytes(), &[], &["*"])
        .expect("the generator writes good tables");
    let head = Head { delta_x_mm: 0.0, r_mm: 400.0, standoff_mm: 0.0 };
    let machine = Machine::head_b_table_c(head, Origin::default());
    let warnings = &mut Vec::new();
    Box::new(
        match data(kind) {
            "burn" => PlainExperiment::burn_table(&table, &machine, warnings),
            "thermal" => PlainExperiment::thermal_table(&table, &machine, warnings),
            _ => PlainExperiment::ballbar_table(&table, &machine, warnings),
        }
        .expect("good data"),
    )
}
