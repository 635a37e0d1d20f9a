//! Effects in RTCP deviations: `d = tool point really reached - target really there`, in the machine frame.
//!
//! With v the head vector and T the target (`docs/conventions.md`), the control cancels the nominal ones, so
//! `d = shift + H(B) - Ry(B) v - (H₀ - v) - (T_real - T_nominal)`, exactly. H is the head vector with its errors; H₀
//! the part of them that was present when the machine's datum was taken at B = 0 (`datum = 1`).

use nalgebra::Vector3;

use crate::diagnose::data::rtcp::Rtcp;
use crate::diagnose::effects::rtcp_pose::{HeadError, PoseError, Tilt};
use crate::diagnose::effects::{Library, Words, rtcp_slow, words};
use crate::diagnose::experiment::{Parameter, Untestable};

pub(super) type L = Library<Rtcp, PoseError>;

fn angle(name: &'static str) -> Parameter {
    Parameter::linear(name, 0.01)
}

pub(super) fn length(name: &'static str) -> Parameter {
    Parameter::linear(name, 0.02)
}

/// Adds an error of the head in two forms: as it is, and with the datum at B = 0 taken while it was there.
fn head(l: &mut L, parameter: Parameter, datum_first: bool, set: fn(&mut HeadError, f64)) {
    let mut add = |datum: bool| {
        let mut parameters = vec![parameter.clone()];
        if datum != datum_first {
            parameters.push(Parameter::switch("datum", f64::from(u8::from(datum))));
        }
        l.form(parameters, move |_, p, errors| {
            for e in errors {
                set(&mut e.head, p[0]);
                if datum {
                    set(&mut e.datum, p[0]);
                }
            }
        });
    };
    add(datum_first);
    add(!datum_first);
}

/// Adds a tilt of the C axis in two forms: it stays where it is at the table's surface, or at the target's height.
fn tilt(l: &mut L, data: &Rtcp, of: fn(&mut PoseError) -> &mut Tilt) {
    let mut add = |parameters: Vec<Parameter>, height_mm: f64| {
        l.form(parameters, move |_, p, errors| {
            for e in errors {
                let tilt = of(e);
                tilt.angle_rad += p[0].to_radians();
                tilt.height_mm = height_mm;
            }
        });
    };
    add(vec![angle("tilt_deg")], 0.0);
    let height_mm = data.geometry.target.z;
    if height_mm != 0.0 {
        add(vec![angle("tilt_deg"), Parameter::switch("at_target", 1.0)], height_mm);
    }
}

/// Fourier parameters of the given harmonics.
fn harmonics(orders: &[u32], unit: &str, typical: f64) -> Vec<Parameter> {
    orders
        .iter()
        .flat_map(|k| {
            [
                Parameter::linear(format!("cos{k}_{unit}"), typical),
                Parameter::linear(format!("sin{k}_{unit}"), typical),
            ]
        })
        .collect()
}

/// Σ a cos kx + b sin kx.
fn fourier(orders: &[u32], p: &[f64], angle_rad: f64) -> f64 {
    orders
        .iter()
        .zip(p.chunks_exact(2))
        .map(|(k, ab)| {
            let (s, c) = (f64::from(*k) * angle_rad).sin_cos();
            ab[0] * c + ab[1] * s
        })
        .sum()
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Rtcp) -> L {
    let mut l = L::default();
    head_constants(&mut l, data);
    b_readings(&mut l, data);
    head_sag(&mut l, data);
    table_effects(&mut l, data);
    rtcp_slow::time_effects(&mut l, data);
    rtcp_slow::linear_effects(&mut l, data);
    l
}

/// Where the B axis is and how it lies.
fn head_constants(l: &mut L, data: &Rtcp) {
    let moves = data.needs(&["b_deg"]);
    l.effect(
        words(
            "pivot-offset-x",
            "the nozzle is off the B axis by ΔX + this",
            "dz against sin B",
            "B from -90 to +90 at one C, with two very different tool lengths",
        ),
        moves.clone(),
    );
    head(l, length("delta_x_mm"), true, |e, v| e.dx += v);
    l.effect(
        words(
            "pivot-length",
            "the B axis is R + this above the nozzle",
            "dx against sin B",
            "B from -90 to +90 at one C, with two very different tool lengths",
        ),
        moves.clone(),
    );
    head(l, length("r_mm"), true, |e, v| e.dr += v);
    l.effect(
        words(
            "b-zero",
            "B reads zero where it is not",
            "dx at all B",
            "two very different tool lengths; a burn test",
        ),
        None,
    );
    head(l, angle("angle_deg"), false, |e, v| e.b += v.to_radians());
    l.effect(
        words(
            "b-axis-tilt-x",
            "the B axis is turned about X (A0B)",
            "dy against cos B",
            "B from -90 to +90 at one C",
        ),
        moves.clone(),
    );
    head(l, angle("tilt_deg"), true, |e, v| e.tilt_x += v.to_radians());
    l.effect(
        words(
            "b-axis-tilt-z",
            "the B axis is turned about Z (C0B)",
            "dy against sin B",
            "B from -90 to +90 at one C",
        ),
        moves,
    );
    head(l, angle("tilt_deg"), true, |e, v| e.tilt_z += v.to_radians());
}

/// Where B stands when it reads an angle.
fn b_readings(l: &mut L, data: &Rtcp) {
    l.effect(
        Words {
            name: "b-pitch-error",
            meaning: "B stands at another angle than it reads, as a function of B (EBB)",
            evidence: "dx and dz together, as B's angle times the head vector",
            best: "B in steps of 5 degrees over its whole range",
            varies_with: &["b_deg"],
        },
        data.needs(&["b_deg"]),
    );
    for orders in [&[1][..], &[2], &[3], &[4], &[1, 2], &[1, 2, 3, 4]] {
        l.form(harmonics(orders, "deg", 0.01), move |data, p, errors| {
            for (e, b) in errors.iter_mut().zip(&data.b_deg) {
                e.head.b += fourier(orders, p, b.to_radians()).to_radians();
            }
        });
    }
    l.effect(
        Words {
            name: "b-backlash",
            meaning: "B lags behind by half this width, whichever way it came",
            evidence: "difference of the two directions of B",
            best: "each B angle approached from both sides",
            varies_with: &["b_deg", "t_s", "approach_b_deg"],
        },
        data.shows_dir_b(),
    );
    // B's zero may stand midway, or be right for the one direction it was set in: then the other one is off by all of the width.
    for zero_dir in [0.0, 1.0, -1.0] {
        let mut parameters = vec![angle("width_deg")];
        if zero_dir != 0.0 {
            parameters.push(Parameter::switch("zero_dir", zero_dir));
        }
        l.form(parameters, move |data, p, errors| {
            for (e, dir) in errors.iter_mut().zip(&data.dir_b) {
                e.head.b -= 0.5 * (dir - zero_dir) * p[0].to_radians();
            }
        });
    }
}

/// The head bends as it swings.
fn head_sag(l: &mut L, data: &Rtcp) {
    l.effect(
        Words {
            name: "head-sag",
            meaning: "the head bends under its weight as it swings",
            evidence: "dx and dz growing with |B|",
            best: "B from -90 to +90, with z measured",
            varies_with: &["b_deg"],
        },
        data.needs(&["b_deg"]),
    );
    l.form(vec![length("sag_mm")], |data, p, errors| {
        let arm = data.geometry.head.norm().max(1e-9);
        for (e, b) in errors.iter_mut().zip(&data.b_deg) {
            // Weight pulls the tip down, B back towards zero.
            e.head.b -= p[0] / arm * b.to_radians().sin();
        }
    });
    l.form(vec![length("down_mm")], |data, p, errors| {
        for (e, b) in errors.iter_mut().zip(&data.b_deg) {
            e.shift.z -= p[0] * b.to_radians().sin().abs();
        }
    });
    l.form(vec![length("down_squared_mm")], |data, p, errors| {
        for (e, b) in errors.iter_mut().zip(&data.b_deg) {
            e.shift.z -= p[0] * b.to_radians().sin().powi(2);
        }
    });
    l.form(vec![length("side_mm")], |data, p, errors| {
        for (e, b) in errors.iter_mut().zip(&data.b_deg) {
            e.shift.x += p[0] * b.to_radians().sin();
        }
    });
}

fn table_effects(l: &mut L, data: &Rtcp) {
    let turns = data.needs(&["c_deg"]);
    l.effect(
        words(
            "c-axis-tilt-x",
            "the C axis is turned about X (A0C)",
            "dz against C, and dy",
            "C all round with the target far out",
        ),
        turns.clone(),
    );
    tilt(l, data, |e| &mut e.tilt_cx);
    l.effect(
        words(
            "c-axis-tilt-y",
            "the C axis is turned about Y (B0C)",
            "dz against C, and dx",
            "C all round with the target far out",
        ),
        turns.clone(),
    );
    tilt(l, data, |e| &mut e.tilt_cy);
    l.effect(
        words(
            "c-centre",
            "the C axis is elsewhere (X0C, Y0C)",
            "mean of dx and dy over C",
            "C all round: the target's place turns, the centre does not",
        ),
        turns.clone(),
    );
    l.form(vec![length("x_mm"), length("y_mm")], |_, p, errors| {
        errors.iter_mut().for_each(|e| e.c_shift += Vector3::new(p[0], p[1], 0.0));
    });
    l.form(vec![length("x_mm")], |_, p, errors| {
        errors.iter_mut().for_each(|e| e.c_shift.x += p[0]);
    });
    l.form(vec![length("y_mm")], |_, p, errors| {
        errors.iter_mut().for_each(|e| e.c_shift.y += p[0]);
    });
    l.effect(
        Words {
            name: "c-pitch-error",
            meaning: "C stands at another angle than it reads, as a function of C (ECC)",
            evidence: "the deviation across the radius, against C",
            best: "seven or more irregular C angles with the target far out",
            varies_with: &["c_deg"],
        },
        turns.clone(),
    );
    for orders in [&[1][..], &[2], &[3], &[4], &[1, 2], &[1, 2, 3, 4]] {
        l.form(harmonics(orders, "deg", 0.01), move |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(&data.c_deg) {
                e.c_angle += fourier(orders, p, c.to_radians()).to_radians();
            }
        });
    }
    l.effect(
        Words {
            name: "c-backlash",
            meaning: "C lags behind by half this width, whichever way it came",
            evidence: "difference of the two directions of C",
            best: "each C angle approached from both sides",
            varies_with: &["c_deg", "t_s", "approach_c_deg"],
        },
        data.needs(&["dir_c"]),
    );
    l.form(vec![angle("width_deg")], |data, p, errors| {
        for (e, dir) in errors.iter_mut().zip(&data.dir_c) {
            e.c_angle -= 0.5 * dir * p[0].to_radians();
        }
    });
    c_motion(l, turns);
}

/// Error motions of the C axis, two cycles a turn and up, and the target's run-out.
fn c_motion(l: &mut L, turns: Option<Untestable>) {
    let words = |name, meaning, evidence, best| Words {
        name,
        meaning,
        evidence,
        best,
        varies_with: &["c_deg"],
    };
    l.effect(
        words(
            "c-radial-2x",
            "the C axis moves sideways twice a turn (EXC, EYC)",
            "dx and dy against 2C",
            "seven or more irregular C angles",
        ),
        turns.clone(),
    );
    radial(l, &[2]);
    radial(l, &[2, 3]);
    l.effect(
        words(
            "c-axial",
            "the C axis moves up and down as it turns (EZC)",
            "dz against 2C, 3C, 4C",
            "seven or more irregular C angles",
        ),
        turns.clone(),
    );
    for orders in [&[2][..], &[3], &[4], &[1], &[2, 3], &[2, 3, 4]] {
        l.form(harmonics(orders, "mm", 0.01), move |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(&data.c_deg) {
                e.c_shift.z += fourier(orders, p, c.to_radians());
            }
        });
    }
    l.effect(
        words(
            "target-runout",
            "the target runs out as the table turns, beyond its place",
            "dx and dy against C, turning backwards",
            "the target indicated in place; a second target",
        ),
        turns,
    );
    l.form(vec![length("cos_mm"), length("sin_mm")], |data, p, errors| {
        for (e, c) in errors.iter_mut().zip(&data.c_deg) {
            let (s, c) = (data.geometry.c_sense * c.to_radians()).sin_cos();
            e.c_shift += Vector3::new(p[0] * c + p[1] * s, p[1] * c - p[0] * s, 0.0);
        }
    });
}

/// The C axis' sideways motions of these orders: in both directions, turning with C as it is read or against it, and along one axis alone.
fn radial(l: &mut L, orders: &'static [u32]) {
    // The usual order goes without saying.
    let named = |of: &str| -> Vec<Parameter> {
        let pair = |k: &u32| {
            let order = if *k == 2 { String::new() } else { k.to_string() };
            ["cos", "sin"].map(|wave| Parameter::linear(format!("{of}_{wave}{order}_mm"), 0.02))
        };
        orders.iter().flat_map(pair).collect()
    };
    let count = 2 * orders.len();
    l.form([named("x"), named("y")].concat(), move |data, p, errors| {
        for (e, c) in errors.iter_mut().zip(&data.c_deg) {
            let c = c.to_radians();
            let (x, y) = (fourier(orders, &p[..count], c), fourier(orders, &p[count..], c));
            e.c_shift += Vector3::new(x, y, 0.0);
        }
    });
    for (sense, name) in [(1.0, "turn"), (-1.0, "back")] {
        l.form(named(name), move |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(&data.c_deg) {
                for (k, p) in orders.iter().zip(p.chunks_exact(2)) {
                    let (s, c) = (sense * f64::from(*k) * c.to_radians()).sin_cos();
                    e.c_shift += Vector3::new(p[0] * c - p[1] * s, p[0] * s + p[1] * c, 0.0);
                }
            }
        });
    }
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        l.form(named(name), move |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(&data.c_deg) {
                e.c_shift[axis] += fourier(orders, p, c.to_radians());
            }
        });
    }
}
