//! Effects in RTCP deviations of the table: the C axis, how it turns, and the target on it.

use nalgebra::Vector3;

use crate::diagnose::data::rtcp::Rtcp;
use crate::diagnose::effects::harmonics::{PITCH_ORDERS, Sideways, fourier, harmonics};
use crate::diagnose::effects::rtcp::{L, angle, length};
use crate::diagnose::effects::rtcp_pose::{PoseError, Tilt};
use crate::diagnose::effects::{Words, words};
use crate::diagnose::experiment::{Parameter, Untestable};

/// Where the C axis is, how it lies, and how it moves as it turns.
pub fn effects(l: &mut L, data: &Rtcp) {
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
    for orders in PITCH_ORDERS {
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
    for way in [&[2][..], &[2, 3]].into_iter().flat_map(Sideways::ways) {
        l.form(way.parameters(0.02), move |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(&data.c_deg) {
                e.c_shift += way.at(p, c.to_radians()).push(0.0);
            }
        });
    }
    l.effect(
        words(
            "c-axial",
            "the C axis moves up and down as it turns (EZC)",
            "dz against 2C, 3C, 4C",
            "seven or more irregular C angles",
        ),
        turns.clone(),
    );
    for orders in [&[2][..], &[3], &[4], &[1], &[2, 3], &[2, 4], &[3, 4], &[2, 3, 4]] {
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
            "the target indicated in place; a run with a second target",
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
