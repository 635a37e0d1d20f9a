//! Effects in ball bar runs: the distance from the base cup to the tool point while Z and B move together.

use nalgebra::{Rotation3, Vector3};

use crate::ballbar::Path;
use crate::diagnose::data::columns::Columns;
use crate::diagnose::data::cups::{Cup, find, straight_below};
use crate::diagnose::effects::{Library, Words, lagged};
use crate::diagnose::experiment::Parameter;
use crate::diagnose::generic::range;

type L = Library<Columns, Vector3<f64>>;

/// Completes the columns (Z from the path that keeps the bar's length, its sense from the data, each path's cup) and gives the
/// nuisances: cup of each path, and the bar's length.
pub fn prepare(data: &mut Columns, measured: &[f64], warnings: &mut Vec<String>) -> Vec<Parameter> {
    let linked: Vec<f64> = data.get("b_deg").iter().map(|b| linked_z(data, *b)).collect();
    let given = data.get("z_mm").to_vec();
    if given.is_empty() {
        warnings.push(
            "there is no column z_mm: Z is taken as linked to B, 2R (1 - cos B) downwards".into(),
        );
        data.numbers.insert("z_mm", linked);
    } else {
        // ISO 841 counts Z upwards; the method's own text counts the way down.
        let sense = |s: f64| {
            let mut other = data.clone();
            other.numbers.insert("z_mm", given.iter().map(|g| s * g).collect());
            let misses = other.find_cups(measured);
            let off = given.iter().zip(&linked).map(|(g, l)| (s * g - l).powi(2)).sum::<f64>();
            (other, misses, off)
        };
        let (up, down) = (sense(1.0), sense(-1.0));
        // Short paths fit either way.
        let alike = (0.5..2.0).contains(&(up.1 / down.1)) || up.1.max(down.1) < 0.1;
        let turned = if alike { down.2 < up.2 } else { down.1 < up.1 };
        *data = if turned { down.0 } else { up.0 };
    }
    data.find_cups(measured);
    let mut nuisances = Vec::new();
    let label = |name: &String| if name.is_empty() { String::new() } else { format!("{name}_") };
    let named = |cup: &Cup, name: &String, axis: usize| Parameter {
        start: cup.place_mm[axis],
        ..Parameter::linear(format!("{}cup_{}_mm", label(name), ["x", "y", "z"][axis]), 0.05)
    };
    for (cup, name) in data.cups.iter().zip(&data.series_names) {
        nuisances.extend([0, 2].map(|axis| named(cup, name, axis)));
    }
    for (cup, name) in data.cups.iter().zip(&data.series_names) {
        if is_beside(cup) {
            nuisances.push(named(cup, name, 1));
        }
        if cup.side_assumed {
            warnings.push(format!(
                "path '{name}': the cup lies {:.1} mm beside the plane of motion, on which side the lengths do not tell: taken as +Y \
                 (on the other side tilts and squareness-yz change their sign; a path named like zb-y-150 says it)",
                cup.place_mm.y
            ));
        }
    }
    nuisances.push(Parameter::linear("bar_mm", 0.05));
    nuisances
}

/// Whether a cup lies beside the plane of motion, so that sideways errors change the length.
fn is_beside(cup: &Cup) -> bool {
    cup.place_mm.y != 0.0
}

/// Z = 2R (1 - cos B) downwards keeps the bar's length over a cup 2R below the pivot (docs/diagnose.md).
fn linked_z(data: &Columns, b_deg: f64) -> f64 {
    -2.0 * data.head.norm() * (1.0 - b_deg.to_radians().cos())
}

/// The Z that keeps the bar's length on the first path.
pub fn next_z(data: &Columns, b_deg: f64) -> f64 {
    let Some(cup) = data.cups.first() else { return linked_z(data, b_deg) };
    let from_cup = turned(b_deg.to_radians(), data.head) - cup.place_mm;
    let rest = cup.bar_mm.powi(2) - from_cup.x.powi(2) - from_cup.y.powi(2);
    if rest < 0.0 { linked_z(data, b_deg) } else { rest.sqrt() - from_cup.z }
}

/// The bar's length at a row. Nuisances: each path's cup x and z, y of those beside the plane, the bar.
pub fn predict(data: &Columns, nuisances: &[f64], row: usize, error: Vector3<f64>) -> [f64; 2] {
    let path = data.series[row];
    let cup = &nuisances[2 * path..];
    let beside = |cups: &[Cup]| cups.iter().filter(|c| is_beside(c)).count();
    let y = match data.cups.get(path) {
        Some(cup) if is_beside(cup) => nuisances[2 * data.cups.len() + beside(&data.cups[..path])],
        _ => 0.0,
    };
    let bar = nuisances.last().copied().unwrap_or(0.0);
    let d = data.tool(row) + error - Vector3::new(cup[0], y, cup[1]);
    [d.norm() + bar, 0.0]
}

/// A vector of the head at a B angle.
fn turned(b_rad: f64, v: Vector3<f64>) -> Vector3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), b_rad) * v
}

impl Columns {
    /// The tool point at a row, from the pivot's place at zero.
    fn tool(&self, row: usize) -> Vector3<f64> {
        let x = self.get("x_mm").get(row).copied().unwrap_or(0.0);
        let b_rad = self.get("b_deg")[row].to_radians();
        turned(b_rad, self.head) + Vector3::new(x, 0.0, self.get("z_mm")[row])
    }

    /// Finds every path's cup and gives the root mean square of what the lengths then miss.
    fn find_cups(&mut self, measured: &[f64]) -> f64 {
        let (mut cups, mut squares) = (Vec::new(), 0.0);
        for (path, name) in self.series_names.iter().enumerate() {
            let rows: Vec<usize> =
                (0..self.series.len()).filter(|r| self.series[*r] == path).collect();
            let tools: Vec<Vector3<f64>> = rows.iter().map(|r| self.tool(*r)).collect();
            let lengths: Vec<f64> = rows.iter().filter_map(|r| measured.get(*r)).copied().collect();
            let mean = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
            if lengths.len() < tools.len() || mean <= 0.0 {
                let beside = Path::parse(name).map_or(0.0, |path| path.cup_y_mm);
                cups.push(straight_below(name, &self.head, self.head.norm().hypot(beside)));
                continue;
            }
            let cup = find(straight_below(name, &self.head, mean), &tools, &lengths);
            squares += cup.miss_mm(&tools, &lengths).powi(2) * rows.len() as f64;
            cups.push(cup);
        }
        self.cups = cups;
        (squares / self.series.len().max(1) as f64).sqrt()
    }
}

/// How far Z goes per radian of B where both together keep the bar's length.
fn slope_mm(data: &Columns, row: usize) -> f64 {
    let Some(cup) = data.cups.get(data.series[row]) else { return 0.0 };
    let along = data.tool(row) - cup.place_mm;
    let arm = turned(data.get("b_deg")[row].to_radians(), data.head);
    let swing = Vector3::new(arm.z, 0.0, -arm.x);
    // Where the bar is level, Z does nothing for its length.
    -along.dot(&swing) / along.z.abs().max(0.1 * cup.bar_mm).copysign(along.z)
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
    turned(b + extra_rad, data.head) - turned(b, data.head)
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Columns) -> L {
    let mut l = L::default();
    let words =
        |name, meaning, evidence, best| Words { name, meaning, evidence, best, varies_with: &[] };
    let swing = data.needs(&["b_deg"]);
    let second = "a second path with the cup shifted, or a bar of certified length";
    let one = |name: &'static str, typical: f64| vec![Parameter::linear(name, typical)];
    let at = |data: &Columns, row: usize, v| turned(data.get("b_deg")[row].to_radians(), v);
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
        at(data, row, Vector3::new(p[0], 0.0, 0.0))
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
        at(data, row, Vector3::new(0.0, 0.0, -p[0]))
    });
    l.effect(
        words("squareness-xz", "Z is not square to X (B0Z)", "length against Z", second),
        data.needs(&["z_mm"]),
    );
    term(&mut l, one("um_per_m", 20.0), |data, p, row| {
        Vector3::new(p[0] * 1e-6 * data.get("z_mm")[row], 0.0, 0.0)
    });
    // Sideways errors change the length only where the cup lies beside the plane.
    let sideways = |columns: &[&str]| match data.cups.iter().any(is_beside) {
        true => data.needs(columns),
        false => Some(
            "the bar lies in the plane of the motion: sideways errors do not change its length"
                .to_owned(),
        ),
    };
    let shifted = "length, once the cup is off the plane";
    for (name, meaning, axis) in [
        ("b-axis-tilt-x", "the B axis is turned about X (A0B)", Vector3::x_axis()),
        ("b-axis-tilt-z", "the B axis is turned about Z (C0B)", Vector3::z_axis()),
    ] {
        l.effect(words(name, meaning, shifted, second), sideways(&["b_deg"]));
        // The zero pose stays, as in `ballbar decouple`.
        term(&mut l, one("tilt_deg", 0.01), move |data, p, row| {
            let tilt = Rotation3::from_axis_angle(&axis, p[0].to_radians());
            let untilted = tilt.inverse() * data.head;
            tilt * at(data, row, untilted) - at(data, row, data.head)
        });
    }
    l.effect(
        words("squareness-yz", "Z is not square to Y (A0Z)", shifted, second),
        sideways(&["z_mm"]),
    );
    term(&mut l, one("um_per_m", 20.0), |data, p, row| {
        Vector3::new(0.0, -p[0] * 1e-6 * data.get("z_mm")[row], 0.0)
    });
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
    // Z turns back where B passes its middle; `dir` may also be Z's own.
    term(&mut l, one("width_mm", 0.01), |data, p, row| {
        let way = data.get("dir")[row] * slope_mm(data, row);
        Vector3::new(0.0, 0.0, if way == 0.0 { 0.0 } else { -0.5 * p[0] * way.signum() })
    });
    term(&mut l, one("own_dir_width_mm", 0.01), |data, p, row| {
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
        // A time by which B leads: with B at constant speed, Z's lag is its slope (mm per rad) times the lead.
        let lag_mm = p[0].to_radians() * slope_mm(data, row);
        Vector3::new(0.0, 0.0, data.get("dir")[row] * lag_mm)
    });
    growth(&mut l, data);
    l
}

/// The head's growth, with temperature where that was recorded, otherwise as time goes by.
fn growth(l: &mut L, data: &Columns) {
    let along = |data: &Columns, row: usize, mm: f64| {
        turned(data.get("b_deg")[row].to_radians(), Vector3::new(0.0, 0.0, -mm))
    };
    let warmth = data.needs(&["temp_c"]).is_none();
    l.effect(
        Words {
            name: "thermal-growth",
            meaning: "the head grows longer with temperature, with a lag",
            evidence: if warmth { "length against temperature" } else { "length against time" },
            best: "the run repeated while the machine warms up",
            varies_with: &[],
        },
        None,
    );
    let times_s: Vec<f64> = match data.get("t_s") {
        // A run is recorded in its order.
        [] => (0..data.series.len()).map(|row| row as f64).collect(),
        t => t.to_vec(),
    };
    let (start, end) = range(&times_s);
    let lags = |parts: [f64; 3]| parts.map(|part| part * (end - start));
    if !warmth {
        let elapsed: Vec<f64> = times_s.iter().map(|t| t - start).collect();
        let (steady, late) = (elapsed.clone(), elapsed);
        term(l, vec![Parameter::linear("mm_in_all", 0.01)], move |data, p, row| {
            along(data, row, p[0] * steady.get(row).copied().unwrap_or(end - start) / (end - start))
        });
        let rise = Parameter::shape("rise_s", &lags([0.1, 0.3, 0.8]));
        term(l, vec![Parameter::linear("mm", 0.01), rise], move |data, p, row| {
            let elapsed = late.get(row).copied().unwrap_or(end - start);
            along(data, row, p[0] * (1.0 - (-elapsed / p[1].abs().max(1e-3)).exp()))
        });
        return;
    }
    term(l, vec![Parameter::linear("mm_per_c", 0.005)], move |data, p, row| {
        along(data, row, p[0] * (data.get("temp_c")[row] - 20.0))
    });
    if end > start && !data.get("t_s").is_empty() {
        let lag = Parameter::shape("lag_s", &lags([0.05, 0.15, 0.5]));
        l.form(vec![Parameter::linear("mm_per_c", 0.005), lag], move |data, p, errors| {
            let warm = lagged(data.get("t_s"), data.get("temp_c"), p[1].abs().max(1e-3));
            for (row, e) in errors.iter_mut().enumerate() {
                *e += along(data, row, p[0] * (warm[row] - 20.0));
            }
        });
    }
}
