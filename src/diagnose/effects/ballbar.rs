//! Effects in ball bar runs: the distance from the base cup to the tool point while Z and B move together.

use nalgebra::{Rotation3, Vector3};

use crate::diagnose::data::ballbar::turned;
use crate::diagnose::data::columns::Columns;
use crate::diagnose::data::cups::Cup;
use crate::diagnose::effects::ballbar_ways::{since_turn_deg, slope_mm, speeds_rad_s, z_ways};
use crate::diagnose::effects::cycles::{CYCLE_WAVES, PURE_WAVE, cycle, cycle_mm, levels, pitches};
use crate::diagnose::effects::harmonics::{fourier, harmonics};
use crate::diagnose::effects::{Library, Words, lagged, risen, words};
use crate::diagnose::experiment::{Parameter, Untestable};
use crate::fit::robust::range;

type L = Library<Columns, Vector3<f64>>;

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

/// Runs that show what one path cannot.
const ASIDE: &str = "a second path with the cup shifted";
const OTHER_AXIS: &str = "a second path that moves X instead of Z (ballbar plan --path xb)";

fn one(name: &'static str, typical: f64) -> Vec<Parameter> {
    vec![Parameter::linear(name, typical)]
}

/// A vector of the head as B has turned it in a row.
fn at(data: &Columns, row: usize, v: Vector3<f64>) -> Vector3<f64> {
    turned(data.get("b_deg")[row].to_radians(), v)
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Columns) -> L {
    let mut l = L::default();
    head(&mut l, data);
    sideways(&mut l, data);
    backlash(&mut l, data);
    pitch(&mut l, data);
    slide(&mut l, data);
    servo(&mut l, data);
    growth(&mut l, data);
    l
}

fn head(l: &mut L, data: &Columns) {
    l.effect(
        words(
            "pivot-offset-x",
            "the nozzle is off the B axis by ΔX + this (X0B)",
            "length against B, odd",
            OTHER_AXIS,
        ),
        data.needs(&["b_deg"]),
    );
    term(l, one("delta_x_mm", 0.02), move |data, p, row| {
        at(data, row, Vector3::new(p[0], 0.0, 0.0))
    });
    l.effect(
        words(
            "pivot-length",
            "the B axis is R + this above the nozzle (Z0B)",
            "length against B, even",
            OTHER_AXIS,
        ),
        data.needs(&["b_deg"]),
    );
    term(l, one("r_mm", 0.02), move |data, p, row| at(data, row, Vector3::new(0.0, 0.0, -p[0])));
    l.effect(
        words("squareness-xz", "Z is not square to X (B0Z)", "length against Z", OTHER_AXIS),
        data.needs(&["z_mm"]),
    );
    term(l, one("um_per_m", 20.0), |data, p, row| {
        Vector3::new(p[0] * 1e-6 * data.get("z_mm")[row], 0.0, 0.0)
    });
}

/// Sideways errors change the length only where the cup lies beside the plane.
fn sideways(l: &mut L, data: &Columns) {
    let sideways = |columns: &[&str]| match data.cups.iter().any(Cup::is_beside) {
        true => data.needs(columns),
        false => Some(
            "the bar lies in the plane of the motion: sideways errors do not change its length"
                .into(),
        ),
    };
    let shifted = "length, once the cup is off the plane";
    for (name, meaning, axis) in [
        ("b-axis-tilt-x", "the B axis is turned about X (A0B)", Vector3::x_axis()),
        ("b-axis-tilt-z", "the B axis is turned about Z (C0B)", Vector3::z_axis()),
    ] {
        l.effect(words(name, meaning, shifted, ASIDE), sideways(&["b_deg"]));
        // The zero pose stays, as in `ballbar decouple`.
        term(l, one("tilt_deg", 0.01), move |data, p, row| {
            let tilt = Rotation3::from_axis_angle(&axis, p[0].to_radians());
            let untilted = tilt.inverse() * data.head;
            tilt * at(data, row, untilted) - at(data, row, data.head)
        });
    }
    l.effect(
        words("squareness-yz", "Z is not square to Y (A0Z)", shifted, ASIDE),
        sideways(&["z_mm"]),
    );
    term(l, one("um_per_m", 20.0), |data, p, row| {
        Vector3::new(0.0, -p[0] * 1e-6 * data.get("z_mm")[row], 0.0)
    });
}

fn backlash(l: &mut L, data: &Columns) {
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
        data.shows("dir"),
    );
    term(l, one("width_deg", 0.01), |data, p, row| {
        swung(data, row, -0.5 * data.get("dir")[row] * p[0].to_radians())
    });
    // Play is taken up over the first of the way back, where rows are near enough to the turn to show it.
    let taken_up_deg = [0.5, 1.0, 2.0, 4.0];
    let on_the_way = since_turn_deg(data).iter().filter(|d| **d < taken_up_deg[3]).count();
    if on_the_way >= 3 {
        // It pays by its own parameter: the plain form costs no more for it, nor is it ruled out any sooner.
        l.beforehand(std::f64::consts::LN_2);
        let play = [one("width_deg", 0.01), vec![Parameter::shape("taken_up_deg", &taken_up_deg)]];
        l.form(play.concat(), |data, p, errors| {
            for (row, (e, way_deg)) in errors.iter_mut().zip(since_turn_deg(data)).enumerate() {
                let taken = 2.0 * (way_deg / p[1]).min(1.0) - 1.0;
                *e += swung(data, row, -0.5 * taken * data.get("dir")[row] * p[0].to_radians());
            }
        });
    }
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
        z_one_way(data),
    );
    // Z turns back where B passes its middle; `dir` may also be Z's own. Where Z stands still nothing turns back.
    for (name, came) in [("width_mm", false), ("came_width_mm", true)] {
        l.form(one(name, 0.01), move |data, p, errors| {
            let dir = data.get("dir");
            for (row, (e, way)) in errors.iter_mut().zip(z_ways(data, came)).enumerate() {
                e.z -= 0.5 * p[0] * dir[row] * way;
            }
        });
    }
    l.form(one("own_dir_width_mm", 0.01), |data, p, errors| {
        let dir = data.get("dir");
        for (row, (e, way)) in errors.iter_mut().zip(z_ways(data, false)).enumerate() {
            e.z -= 0.5 * p[0] * dir[row] * way.abs();
        }
    });
}

/// Why a backlash of Z cannot be tested: it turns back where B passes its middle, even in a run driven one way; never where it stands.
fn z_one_way(data: &Columns) -> Option<Untestable> {
    let ways = z_ways(data, false);
    let both = |turn: fn(f64) -> f64| {
        let of_z = || data.get("dir").iter().zip(&ways).map(|(dir, way)| dir * turn(*way));
        of_z().any(|w| w > 0.0) && of_z().any(|w| w < 0.0)
    };
    if both(|way| way) || both(f64::abs) {
        return None;
    }
    let never = || Untestable { why: "Z never turns back".into(), predictable: true };
    Some(data.needs(&["dir"]).unwrap_or_else(never))
}

fn pitch(l: &mut L, data: &Columns) {
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
        data.needs(&["b_deg"]),
    );
    // One at a time: in the only output two would take much else for themselves.
    for order in [[1], [2], [3], [4]] {
        term(l, harmonics(&order, "deg", 0.01), move |data, p, row| {
            let b = data.get("b_deg")[row].to_radians();
            swung(data, row, fourier(&order, p, b).to_radians())
        });
    }
}

fn slide(l: &mut L, data: &Columns) {
    l.effect(
        words("scale-z", "Z goes too far (EZZ)", "length against Z", OTHER_AXIS),
        data.needs(&["z_mm"]),
    );
    term(l, one("um_per_m", 20.0), |data, p, row| {
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
    let usual_mm = [2.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0];
    let of_path = |path: usize| -> Vec<f64> {
        data.rows_of(path).iter().filter_map(|row| data.get("z_mm").get(*row)).copied().collect()
    };
    let travels_mm = (0..data.series_names.len()).map(|path| range(&of_path(path)));
    let travel_mm = travels_mm.map(|(low, high)| high - low).fold(0.0, f64::max);
    let any = pitches(&levels(data.get("z_mm").to_vec(), 1e-3 * travel_mm), travel_mm);
    l.beforehand(PURE_WAVE);
    for waves in 1..=CYCLE_WAVES {
        let mut wave = cycle(waves, 1e-3, &usual_mm);
        wave.iter_mut().filter(|p| !p.grid.is_empty()).for_each(|p| p.scan = any.clone());
        term(l, wave, |data, p, row| {
            Vector3::new(0.0, 0.0, cycle_mm(p, data.get("z_mm")[row], f64::INFINITY))
        });
    }
}

fn servo(l: &mut L, data: &Columns) {
    l.effect(
        words(
            "servo-mismatch",
            "one of the two axes runs ahead of the other",
            "length against the speeds' ratio, changing sign with direction",
            "the run at two speeds, in both directions",
        ),
        data.shows("dir"),
    );
    term(l, one("lead_deg", 0.01), |data, p, row| {
        // With B at constant speed, what Z runs ahead is its slope (mm per rad) times the angle that B goes in that time.
        let ahead_mm = p[0].to_radians() * slope_mm(data, row);
        Vector3::new(0.0, 0.0, data.get("dir")[row] * ahead_mm)
    });
    if data.needs(&["t_s"]).is_some() {
        return;
    }
    // At several speeds the axes are apart by a time, not by an angle.
    l.form(one("lead_s", 5e-3), |data, p, errors| {
        for (row, (e, speed_rad_s)) in errors.iter_mut().zip(speeds_rad_s(data)).enumerate() {
            e.z += p[0] * speed_rad_s * slope_mm(data, row);
        }
    });
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
    let times_s: Vec<f64> = match data.needs(&["t_s"]) {
        // A run is recorded in its order.
        Some(_) => (0..data.series.len()).map(|row| row as f64).collect(),
        None => data.get("t_s").to_vec(),
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
            along(data, row, p[0] * risen(elapsed, p[1]))
        });
        return;
    }
    // Counted from 20 °C, or from the first reading: as likely as one that is counted one way only.
    l.beforehand(std::f64::consts::LN_2);
    let timed = data.needs(&["t_s"]).is_none();
    for from_start in [false, true] {
        for lag in [false, true].into_iter().take(1 + usize::from(timed)) {
            let mut parameters = vec![Parameter::linear("mm_per_c", 0.005)];
            if lag {
                parameters.push(Parameter::shape("lag_s", &lags([0.05, 0.15, 0.5])));
            }
            if from_start {
                parameters.push(Parameter::switch("from_start", 1.0));
            }
            l.form(parameters, move |data, p, errors| {
                let now = data.get("temp_c");
                let warm = match lag {
                    true => lagged(data.get("t_s"), now, p[1].abs().max(1e-3)),
                    false => now.to_vec(),
                };
                let zero = if from_start { now.first().copied().unwrap_or(20.0) } else { 20.0 };
                for (row, e) in errors.iter_mut().enumerate() {
                    *e += along(data, row, p[0] * (warm[row] - zero));
                }
            });
        }
    }
}
