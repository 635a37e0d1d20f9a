//! Effects in the edge points of a check rod, seen over capture XY, C, direction, time and temperature.
//!
//! The real head stands at `(X, Y) + place`, the rod's centre at `centre + centre_shift`, its radius at angle φ is
//! `D/2 + radius(φ)`; a point seen at plane offset w is reported at `w + camera(w)`. Everything is evaluated at the
//! *predicted* point, never at the measured one.

use nalgebra::Vector2;

use crate::diagnose::data::rod::Rod;
use crate::diagnose::effects::cycles::{
    CYCLE_WAVES, PURE_WAVE, cycle, cycle_mm, levels, tells_cycle,
};
use crate::diagnose::effects::harmonics::Sideways;
use crate::diagnose::effects::{Library, Words, rod_camera, rod_slow, words};
use crate::diagnose::experiment::Parameter;

/// Errors of one capture.
#[derive(Debug, Clone, Default)]
pub struct CaptureError {
    /// Machine place reached, less commanded.
    pub place: Vector2<f64>,
    /// Shift of the rod's centre.
    pub centre: Vector2<f64>,
    /// Growth of the radius.
    pub radius: f64,
    /// Lobes: (order, cosine, sine), turning with C.
    pub lobes: Vec<(u32, f64, f64)>,
    /// What the camera gets wrong.
    pub camera: CameraError,
}

/// The camera's errors: a linear map of the plane offset, perspective, lens, and the light.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraError {
    /// Rows of the linear map, in the picture's own axes (along u, against v).
    pub linear: [[f64; 2]; 2],
    /// Perspective of a tilted camera, which also foreshortens, per mm.
    pub tilt: [f64; 2],
    /// Perspective alone, per mm.
    pub unshortened: [f64; 2],
    /// k1, k2, p1, p2 beyond the calibration.
    pub lens: [f64; 4],
    /// Edge shift outwards per mm along u and against v.
    pub light: [f64; 2],
}

pub(super) type L = Library<Rod, CaptureError>;

pub(super) const SIZE: f64 = 1e-3;

/// The library, with what `data` cannot test marked.
pub fn library(data: &Rod) -> L {
    let mut l = L::default();
    rod_camera::effects(&mut l, data);
    scales(&mut l, data);
    squareness(&mut l, data);
    backlash(&mut l, data);
    cycles(&mut l, data);
    rod_shape(&mut l, data);
    c_axis(&mut l, data);
    rod_slow::time_effects(&mut l, data);
    l
}

/// What would show scale and squareness better.
const LONGER: &str = "a longer artefact: the travel over a rod is short";
/// What shows the way the rod turns.
const IRREGULAR: &str = "seven or more irregular C angles in random order";

fn scales(l: &mut L, data: &Rod) {
    for (axis, (name, meaning)) in
        [("scale-x", "X goes too far (EXX)"), ("scale-y", "Y goes too far (EYY)")]
            .into_iter()
            .enumerate()
    {
        l.effect(
            words(name, meaning, "the rod's apparent place against the machine's", LONGER),
            data.needs(&[["x_mm", "y_mm"][axis]]),
        );
        l.form(vec![Parameter::linear("um_per_m", 20.0)], move |data, p, errors| {
            for (e, from_rod) in errors.iter_mut().zip(data.from_rod()) {
                e.place[axis] += p[0] * 1e-6 * from_rod[axis];
            }
        });
    }
}

fn squareness(l: &mut L, data: &Rod) {
    l.effect(
        words("squareness-xy", "Y is not square to X (C0Y)", "x against the machine's Y", LONGER),
        data.needs(&["y_mm"]),
    );
    l.form(vec![Parameter::linear("um_per_m", 20.0)], |data, p, errors| {
        for (e, from_rod) in errors.iter_mut().zip(data.from_rod()) {
            e.place.x -= p[0] * 1e-6 * from_rod.y;
        }
    });
    // The same with Y taken for the straight one: the machine's frame is turned.
    l.form(vec![Parameter::linear("other_leg_um_per_m", 20.0)], |data, p, errors| {
        for (e, from_rod) in errors.iter_mut().zip(data.from_rod()) {
            e.place.y -= p[0] * 1e-6 * from_rod.x;
        }
    });
}

fn backlash(l: &mut L, data: &Rod) {
    for (axis, (name, column, meaning)) in [
        ("backlash-x", "dir_x", "X lags behind by half this width"),
        ("backlash-y", "dir_y", "Y lags behind by half this width"),
    ]
    .into_iter()
    .enumerate()
    {
        let varies_with = [&["x_mm", "t_s"][..], &["y_mm", "t_s"]][axis];
        l.effect(
            Words {
                name,
                meaning,
                evidence: "the two directions of travel",
                best: "each place approached from both sides",
                varies_with,
            },
            data.needs(&[column]),
        );
        l.form(vec![Parameter::linear("width_mm", 0.01)], move |data, p, errors| {
            for (g, e) in errors.iter_mut().enumerate() {
                let dir = [&data.dir_x, &data.dir_y][axis].get(g).copied().unwrap_or(0.0);
                e.place[axis] -= 0.5 * p[0] * dir;
            }
        });
    }
}

fn cycles(l: &mut L, data: &Rod) {
    for (axis, (name, column)) in
        [("cyclic-x", "x_mm"), ("cyclic-y", "y_mm")].into_iter().enumerate()
    {
        l.effect(
            words(
                name,
                "the axis goes wrong once per turn of its screw",
                "the rod's apparent place against the machine's, repeating",
                "places spread over several screw pitches",
            ),
            data.needs(&[column]),
        );
        let travel = data.travel_mm(axis);
        // A pitch longer than the travel is seen as a bend, no cycle.
        let longest = 1.2 * travel;
        let mut pitches =
            vec![1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5, 16.0, 20.0];
        pitches.retain(|p| *p < longest);
        let short = pitches.is_empty();
        let places = levels(data.place.iter().map(|p| p[axis]).collect(), 0.01 * travel);
        pitches.retain(|p| tells_cycle(&places, *p));
        if pitches.is_empty() {
            if let Some(info) = l.infos.last_mut() {
                info.untestable = Some(match short {
                    true => "the travel is shorter than a screw pitch".into(),
                    false => {
                        "too few places along the axis, or evenly spaced ones, tell no cycle".into()
                    }
                });
            }
            continue;
        }
        l.beforehand(PURE_WAVE);
        for waves in (1..=CYCLE_WAVES).filter(|waves| places.len() >= 3 * waves + 2) {
            l.form(cycle(waves, SIZE, &pitches), move |data, p, errors| {
                for (e, place) in errors.iter_mut().zip(&data.place) {
                    e.place[axis] += cycle_mm(p, place[axis], longest);
                }
            });
        }
    }
}

fn rod_shape(l: &mut L, data: &Rod) {
    l.effect(
        words(
            "rod-eccentricity",
            "the rod stands off the C axis",
            "the centre, once a turn of C",
            IRREGULAR,
        ),
        data.needs(&["c_deg"]),
    );
    l.form(
        vec![Parameter::linear("x_mm", 0.01), Parameter::linear("y_mm", 0.01)],
        |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(&data.c_rad) {
                let (s, c) = c.sin_cos();
                e.centre += Vector2::new(p[0] * c - p[1] * s, p[0] * s + p[1] * c);
            }
        },
    );
    for (name, order, meaning) in [
        ("rod-oval", 2, "the rod is oval: two lobes that turn with C"),
        ("rod-three-lobe", 3, "the rod has three lobes that turn with C"),
    ] {
        l.effect(
            words(name, meaning, "the radius round the edge, turning with C", IRREGULAR),
            None,
        );
        l.form(
            vec![Parameter::linear("cos_mm", SIZE), Parameter::linear("sin_mm", SIZE)],
            move |_, p, errors| {
                errors.iter_mut().for_each(|e| e.lobes.push((order, p[0], p[1])));
            },
        );
    }
}

fn c_axis(l: &mut L, data: &Rod) {
    l.effect(
        Words {
            varies_with: &["c_deg"],
            ..words(
                "c-radial-2x",
                "the C axis moves sideways twice a turn (EXC, EYC)",
                "the centre, twice a turn of C",
                IRREGULAR,
            )
        },
        data.needs(&["c_deg"]),
    );
    for way in Sideways::ways(&[2]) {
        l.form(way.parameters(SIZE), move |data, p, errors| {
            for (e, c) in errors.iter_mut().zip(data.c_read_rad()) {
                e.centre += way.at(p, c);
            }
        });
    }
}
