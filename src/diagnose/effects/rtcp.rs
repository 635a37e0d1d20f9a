//! Effects in RTCP deviations: `d = tool point really reached - target really there`, in the machine frame.
//!
//! With v the head vector and T the target (`docs/conventions.md`), the control cancels the nominal ones, so
//! `d = shift + H(B) - Ry(B) v - (H₀ - v) - (T_real - T_nominal)`, exactly. H is the head vector with its errors; H₀
//! the part of them that was present when the machine's datum was taken at B = 0 (`datum = 1`).

use crate::diagnose::data::rtcp::Rtcp;
use crate::diagnose::effects::harmonics::{PITCH_ORDERS, fourier, harmonics};
use crate::diagnose::effects::rtcp_pose::{HeadError, PoseError};
use crate::diagnose::effects::{Library, Words, rtcp_slow, rtcp_table, words};
use crate::diagnose::experiment::Parameter;

pub(super) type L = Library<Rtcp, PoseError>;

pub(super) fn angle(name: &'static str) -> Parameter {
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

/// The library, with what `data` cannot test marked.
pub fn library(data: &Rtcp) -> L {
    let mut l = L::default();
    head_constants(&mut l);
    b_readings(&mut l, data);
    head_sag(&mut l, data);
    rtcp_table::effects(&mut l, data);
    rtcp_slow::time_effects(&mut l, data);
    rtcp_slow::linear_effects(&mut l, data);
    l
}

/// Where the B axis is and how it lies.
fn head_constants(l: &mut L) {
    l.effect(
        words(
            "pivot-offset-x",
            "the nozzle is off the B axis by ΔX + this",
            "dz against sin B",
            "B from -90 to +90 at one C, in runs with two very different tool lengths",
        ),
        None,
    );
    head(l, length("delta_x_mm"), true, |e, v| e.dx += v);
    l.effect(
        words(
            "pivot-length",
            "the B axis is R + this above the nozzle",
            "dx against sin B",
            "B from -90 to +90 at one C, in runs with two very different tool lengths",
        ),
        None,
    );
    head(l, length("r_mm"), true, |e, v| e.dr += v);
    l.effect(
        words(
            "b-zero",
            "B reads zero where it is not",
            "dx at all B",
            "runs with two very different tool lengths; a burn test",
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
        None,
    );
    head(l, angle("tilt_deg"), true, |e, v| e.tilt_x += v.to_radians());
    l.effect(
        words(
            "b-axis-tilt-z",
            "the B axis is turned about Z (C0B)",
            "dy against sin B",
            "B from -90 to +90 at one C",
        ),
        None,
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
        data.shows("b_deg"),
    );
    for orders in PITCH_ORDERS {
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
        data.shows("dir_b"),
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
        data.shows("b_deg"),
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
