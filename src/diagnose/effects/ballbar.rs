//! Effects in ball bar runs: the distance from the base cup to the tool point while Z and B move together.

use nalgebra::{Rotation3, Vector3};

use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::{Library, Words, lagged};
use crate::diagnose::experiment::Parameter;

type L = Library<Columns, Vector3<f64>>;

/// Completes the columns (Z from the path that keeps the bar's length, its sense from the data) and gives the
/// nuisances: cup of each path, and the bar's length.
pub fn prepare(data: &mut Columns, measured: &[f64], warnings: &mut Vec<String>) -> Vec<Parameter> {
    let linked: Vec<f64> = data.get("b_deg").iter().map(|b| linked_z(data, *b)).collect();
    let given = data.get("z_mm").to_vec();
    let z = if given.is_empty() {
        warnings.push(
            "there is no column z_mm: Z is taken as linked to B, 2R (1 - cos B) downwards".into(),
        );
        linked.clone()
    } else {
        // ISO 841 counts Z upwards; the method's own text counts the way down.
        let fits =
            |s: f64| given.iter().zip(&linked).map(|(g, l)| (s * g - l).powi(2)).sum::<f64>();
        let sense = if fits(-1.0) < fits(1.0) { -1.0 } else { 1.0 };
        given.iter().map(|g| sense * g).collect()
    };
    data.numbers.insert("z_mm", z);
    let length = measured.iter().sum::<f64>() / measured.len().max(1) as f64;
    let tool0 = data.head;
    let mut nuisances = Vec::new();
    for name in &data.series_names {
        let label = if name.is_empty() { String::new() } else { format!("{name}_") };
        // The cup starts where a bar of the mean length ends straight below the tool's first place.
        for (axis, start) in [("x", tool0.x), ("z", tool0.z - length)] {
            nuisances.push(Parameter {
                start,
                ..Parameter::linear(format!("{label}cup_{axis}_mm"), 0.05)
            });
        }
    }
    nuisances.push(Parameter::linear("bar_mm", 0.05));
    nuisances
}

/// Z = 2R (1 - cos B) downwards keeps the bar's length over a cup 2R below the pivot (docs/diagnose.md).
pub fn linked_z(data: &Columns, b_deg: f64) -> f64 {
    -2.0 * data.head.norm() * (1.0 - b_deg.to_radians().cos())
}

/// The bar's length at a row.
pub fn predict(data: &Columns, nuisances: &[f64], row: usize, error: Vector3<f64>) -> [f64; 2] {
    let cup = &nuisances[2 * data.series[row]..];
    let tool = tool(data, row) + error;
    let bar = nuisances.last().copied().unwrap_or(0.0);
    let d = tool - Vector3::new(cup[0], 0.0, cup[1]);
    [d.norm() + bar, 0.0]
}

/// The tool point, from the pivot's place at Z = 0.
fn tool(data: &Columns, row: usize) -> Vector3<f64> {
    let b = data.get("b_deg")[row].to_radians();
    Rotation3::from_axis_angle(&Vector3::y_axis(), b) * data.head
        + Vector3::new(0.0, 0.0, data.get("z_mm")[row])
}

/// Adds parameters times a vector function of the row.
fn term(
    l: &mut L,
    parameters: Vec<Parameter>,
    f: impl Fn(&Columns, &[f64], usize) -> Vector3<f64> + Send + Sync + 'static,
) {
    l.form(parameters, move |data, p, errors| {
        errors.iter_mut().enumerate().for_each(|(row, e)| *e += f(data, p, row));
    });
}

/// Rotates the head vector of a row by a small extra B angle, exactly.
fn swung(data: &Columns, row: usize, extra_rad: f64) -> Vector3<f64> {
    let b = data.get("b_deg")[row].to_radians();
    let turn = |a: f64| Rotation3::from_axis_angle(&Vector3::y_axis(), a) * data.head;
    turn(b + extra_rad) - turn(b)
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Columns) -> L {
    let mut l = L::default();
    let words =
        |name, meaning, evidence, best| Words { name, meaning, evidence, best, varies_with: &[] };
    let swing = data.needs(&["b_deg"]);
    let second = "a second path with the cup shifted, or a bar of certified length";
    let one = |name: &'static str, typical: f64| vec![Parameter::linear(name, typical)];
    let turned = |data: &Columns, row: usize, v: Vector3<f64>| {
        Rotation3::from_axis_angle(&Vector3::y_axis(), data.get("b_deg")[row].to_radians()) * v
    };
    l.effect(
        words(
            "pivot-offset-x",
            "the nozzle is off the B axis by ΔX + this (X0B)",
            "length against B, odd",
            second,
        ),
        swing.clone(),
    );
    term(&mut l, one("delta_x_mm", 0.02), move |data, p, row| {
        turned(data, row, Vector3::new(p[0], 0.0, 0.0))
    });
    l.effect(
        words(
            "pivot-length",
            "the B axis is R + this above the nozzle (Z0B)",
            "length against B, even",
            second,
        ),
        swing.clone(),
    );
    term(&mut l, one("r_mm", 0.02), move |data, p, row| {
        turned(data, row, Vector3::new(0.0, 0.0, -p[0]))
    });
    l.effect(
        words("squareness-xz", "Z is not square to X (B0Z)", "length against Z", second),
        data.needs(&["z_mm"]),
    );
    term(&mut l, one("um_per_m", 20.0), |data, p, row| {
        Vector3::new(p[0] * 1e-6 * data.get("z_mm")[row], 0.0, 0.0)
    });
    let hidden = Some(
        "the bar lies in the plane of the motion: sideways errors do not change its length"
            .to_owned(),
    );
    for (name, meaning) in [
        ("b-axis-tilt-x", "the B axis is turned about X (A0B)"),
        ("b-axis-tilt-z", "the B axis is turned about Z (C0B)"),
        ("squareness-yz", "Z is not square to Y (A0Z)"),
    ] {
        l.effect(
            words(name, meaning, "length, once the cup is off the plane", second),
            hidden.clone(),
        );
    }
    let both = "the run in both directions";
    l.effect(
        Words {
            varies_with: &["b_deg"],
            ..words(
                "b-backlash",
                "B lags behind by half this width",
                "difference of the two directions",
                both,
            )
        },
        data.needs(&["dir"]),
    );
    term(&mut l, one("width_deg", 0.01), |data, p, row| {
        swung(data, row, -0.5 * data.get("dir")[row] * p[0].to_radians())
    });
    l.effect(
        Words {
            varies_with: &["z_mm"],
            ..words(
                "z-backlash",
                "Z lags behind by half this width",
                "difference of the two directions",
                both,
            )
        },
        data.needs(&["dir"]),
    );
    term(&mut l, one("width_mm", 0.01), |data, p, row| {
        Vector3::new(0.0, 0.0, -0.5 * data.get("dir")[row] * p[0])
    });
    l.effect(
        Words {
            varies_with: &["b_deg"],
            ..words(
                "b-pitch-error",
                "B stands at another angle than it reads, as a function of B (EBB)",
                "length against B",
                "B over its whole range in small steps",
            )
        },
        swing,
    );
    for order in 1..=4u32 {
        let k = f64::from(order);
        let names = [format!("cos{order}_deg"), format!("sin{order}_deg")];
        term(&mut l, names.map(|n| Parameter::linear(n, 0.01)).to_vec(), move |data, p, row| {
            let b = k * data.get("b_deg")[row].to_radians();
            swung(data, row, (p[0] * b.cos() + p[1] * b.sin()).to_radians())
        });
    }
    l.effect(
        words("scale-z", "Z goes too far (EZZ)", "length against Z", second),
        data.needs(&["z_mm"]),
    );
    term(&mut l, one("um_per_m", 20.0), |data, p, row| {
        Vector3::new(0.0, 0.0, p[0] * 1e-6 * data.get("z_mm")[row])
    });
    l.effect(
        words(
            "cyclic-z",
            "Z goes wrong once per turn of its screw",
            "length against Z, repeating",
            "small steps of Z over several pitches",
        ),
        data.needs(&["z_mm"]),
    );
    let pitch = Parameter::shape(
        "pitch_mm",
        &[2.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0],
    );
    term(
        &mut l,
        vec![Parameter::linear("cos_mm", 1e-3), Parameter::linear("sin_mm", 1e-3), pitch],
        |data, p, row| {
            let (s, c) = (std::f64::consts::TAU * data.get("z_mm")[row] / p[2]).sin_cos();
            Vector3::new(0.0, 0.0, p[0] * c + p[1] * s)
        },
    );
    l.effect(
        words(
            "servo-mismatch",
            "one of the two axes runs ahead of the other",
            "length against the speeds' ratio, changing sign with direction",
            "the run at two speeds, in both directions",
        ),
        data.needs(&["dir"]),
    );
    term(&mut l, one("lead_deg", 0.01), |data, p, row| {
        // A time by which B leads: with B at constant speed, Z's lag is its slope times the lead.
        let b = data.get("b_deg")[row].to_radians();
        let slope = -2.0 * data.head.norm() * b.sin();
        Vector3::new(0.0, 0.0, data.get("dir")[row] * p[0].to_radians() * slope)
    });
    l.effect(
        words(
            "thermal-growth",
            "the head grows longer with temperature, with a lag",
            "length against temperature",
            "the run repeated while the machine warms up",
        ),
        data.needs(&["temp_c"]),
    );
    term(&mut l, one("mm_per_c", 0.005), move |data, p, row| {
        turned(data, row, Vector3::new(0.0, 0.0, -p[0] * (data.get("temp_c")[row] - 20.0)))
    });
    let (start, end) = data.times_s();
    if end > start {
        let lags: Vec<f64> = [0.05, 0.15, 0.5].iter().map(|f| f * (end - start)).collect();
        l.form(
            vec![Parameter::linear("mm_per_c", 0.005), Parameter::shape("lag_s", &lags)],
            move |data, p, errors| {
                let warm = lagged(data.get("t_s"), data.get("temp_c"), p[1].abs().max(1e-3));
                for (row, e) in errors.iter_mut().enumerate() {
                    *e += turned(data, row, Vector3::new(0.0, 0.0, -p[0] * (warm[row] - 20.0)));
                }
            },
        );
    }
    l
}
