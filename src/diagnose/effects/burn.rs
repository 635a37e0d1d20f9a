//! Effects in burn tests: `offset = spot - ring` over the height difference, power, B, time.

use nalgebra::Vector3;

use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::{Library, Words, risen};
use crate::diagnose::experiment::Parameter;
use crate::fit::robust::range;

type L = Library<Columns, Vector3<f64>>;

/// Adds parameters times a function of a row's columns to an output each.
fn along(
    l: &mut L,
    names: [&'static str; 2],
    typical: f64,
    axes: &'static [usize],
    f: impl Fn(&Columns, usize) -> f64 + Send + Sync + 'static,
) {
    let linear = axes.iter().map(|a| Parameter::linear(names[*a], typical));
    added(l, linear.collect(), axes, move |data, row, _| f(data, row));
}

/// As [`along`], with a function that has a parameter of its form, and the values at which that is tried.
fn bent(
    l: &mut L,
    names: [&'static str; 2],
    axes: &'static [usize],
    (shape, grid): (&'static str, &[f64]),
    f: impl Fn(&Columns, usize, f64) -> f64 + Send + Sync + 'static,
) {
    let linear = axes.iter().map(|a| Parameter::linear(names[*a], 0.01));
    let parameters = linear.chain([Parameter::shape(shape, grid)]).collect();
    added(l, parameters, axes, move |data, row, p| f(data, row, p[axes.len()]));
}

/// A form that adds its first parameters times a function of the row and of all of them to an output each.
fn added(
    l: &mut L,
    parameters: Vec<Parameter>,
    axes: &'static [usize],
    f: impl Fn(&Columns, usize, &[f64]) -> f64 + Send + Sync + 'static,
) {
    l.form(parameters, move |data, p, errors| {
        for (row, e) in errors.iter_mut().enumerate() {
            let size = f(data, row, p);
            axes.iter().zip(p).for_each(|(a, p)| e[*a] += p * size);
        }
    });
}

/// Height of the ring's burn over the spot's, m.
fn height_m(data: &Columns, row: usize) -> f64 {
    1e-3 * data.get("height_mm")[row]
}

/// Captures that show what depends on the height.
const HEIGHTS: &str = "heights from the least to the greatest at one power";

/// Outputs that an effect may move: both, or one alone.
const ALL: [&[usize]; 3] = [&[0, 1], &[0], &[1]];

fn words(
    name: &'static str,
    meaning: &'static str,
    evidence: &'static str,
    best: &'static str,
    varies_with: &'static [&'static str],
) -> Words {
    Words { name, meaning, evidence, best, varies_with }
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Columns) -> L {
    let mut l = L::default();
    tilt(&mut l, data);
    nozzle(&mut l);
    sag(&mut l, data);
    drift(&mut l, data);
    power(&mut l, data);
    camera(&mut l, data);
    l
}

fn tilt(l: &mut L, data: &Columns) {
    l.effect(
        words(
            "beam-tilt-x",
            "the beam leans in X: turn B",
            "dx against height",
            HEIGHTS,
            &["height_mm"],
        ),
        data.shows("height_mm"),
    );
    l.form(vec![Parameter::linear("angle_deg", 0.01)], |data, p, errors| {
        errors
            .iter_mut()
            .zip(data.get("height_mm"))
            .for_each(|(e, h)| e.x += h * p[0].to_radians().tan());
    });
    l.effect(
        words(
            "beam-tilt-y",
            "the beam leans in Y: shim the flange",
            "dy against height",
            HEIGHTS,
            &["height_mm"],
        ),
        data.shows("height_mm"),
    );
    l.form(vec![Parameter::linear("angle_deg", 0.01)], |data, p, errors| {
        errors
            .iter_mut()
            .zip(data.get("height_mm"))
            .for_each(|(e, h)| e.y += h * p[0].to_radians().tan());
    });
}

fn nozzle(l: &mut L) {
    l.effect(
        words(
            "nozzle-offset",
            "ring and spot lie apart by the same at every height",
            "mean of dx and dy",
            HEIGHTS,
            &[],
        ),
        None,
    );
    for axes in ALL {
        along(l, ["x_mm", "y_mm"], 0.01, axes, |_, _| 1.0);
    }
}

fn sag(l: &mut L, data: &Columns) {
    l.effect(
        words(
            "head-sag",
            "the head bends under its weight as it swings",
            "dx against sin B",
            "burns on a tilted plate over all B",
            &["b_deg"],
        ),
        data.shows("b_deg"),
    );
    let sin = |data: &Columns, row: usize| data.get("b_deg")[row].to_radians().sin();
    along(l, ["side_mm", ""], 0.01, &[0], sin);
    l.form(vec![Parameter::linear("angle_deg", 0.01)], move |data, p, errors| {
        for (row, e) in errors.iter_mut().enumerate() {
            e.x += data.get("height_mm")[row] * p[0].to_radians() * sin(data, row);
        }
    });
    along(l, ["level_mm", ""], 0.01, &[0], |data, row| {
        1.0 - data.get("b_deg")[row].to_radians().cos()
    });
    along(l, ["both_ways_mm", ""], 0.01, &[0], move |data, row| sin(data, row).abs());
}

fn drift(l: &mut L, data: &Columns) {
    let (start, end) = data.times_s();
    l.effect(
        words(
            "pointing-drift",
            "the beam wanders as time goes by",
            "dx and dy against time",
            "the same burn repeated through the run",
            &["t_s"],
        ),
        data.needs(&["t_s"]),
    );
    let from_start = move |data: &Columns, row: usize| (data.get("t_s")[row] - start) / 3600.0;
    let middle_s = 0.5 * (start + end);
    let from_middle = move |data: &Columns, row: usize| (data.get("t_s")[row] - middle_s) / 3600.0;
    let rises: Vec<f64> = [0.1, 0.25, 0.6].iter().map(|f| f * (end - start)).collect();
    for axes in ALL {
        along(l, ["x_mm_per_h", "y_mm_per_h"], 0.01, axes, from_start);
        let names = ["x_from_middle_mm_per_h", "y_from_middle_mm_per_h"];
        along(l, names, 0.01, axes, from_middle);
        bent(l, ["x_mm", "y_mm"], axes, ("rise_s", &rises), move |data, row, rise_s| {
            risen(data.get("t_s")[row] - start, rise_s)
        });
        // The same as an angle of the beam.
        along(l, ["x_mm_per_h_m", "y_mm_per_h_m"], 0.1, axes, move |data, row| {
            from_start(data, row) * height_m(data, row)
        });
        let names = ["x_from_middle_mm_per_h_m", "y_from_middle_mm_per_h_m"];
        along(l, names, 0.1, axes, move |data, row| from_middle(data, row) * height_m(data, row));
        bent(
            l,
            ["x_mm_per_m", "y_mm_per_m"],
            axes,
            ("rise_s", &rises),
            move |data, row, rise_s| {
                risen(data.get("t_s")[row] - start, rise_s) * height_m(data, row)
            },
        );
    }
}

fn power(l: &mut L, data: &Columns) {
    l.effect(
        words(
            "thermal-lens",
            "the optics bend the beam with power",
            "dx and dy against power",
            "powers from the least to the greatest at one height",
            &["power_w"],
        ),
        data.shows("power_w"),
    );
    for axes in ALL {
        along(l, ["x_mm_per_kw", "y_mm_per_kw"], 0.01, axes, |data, row| {
            data.get("power_w")[row] / 1000.0
        });
    }
    let (least_w, most_w) = range(data.get("power_w"));
    for (from_w, names) in [
        (least_w, ["x_from_least_mm_per_kw", "y_from_least_mm_per_kw"]),
        (0.5 * (least_w + most_w), ["x_from_middle_mm_per_kw", "y_from_middle_mm_per_kw"]),
    ] {
        for axes in ALL {
            along(l, names, 0.01, axes, move |data, row| {
                (data.get("power_w")[row] - from_w) / 1000.0
            });
        }
    }
    for axes in ALL {
        along(l, ["x_mm_per_kw_m", "y_mm_per_kw_m"], 0.1, axes, |data, row| {
            data.get("power_w")[row] / 1000.0 * height_m(data, row)
        });
    }
    // What grows faster or slower than the power.
    let exponent = ("exponent", &[0.5, 1.5, 2.0][..]);
    let risen = |data: &Columns, row: usize, exponent: f64| {
        (data.get("power_w")[row] / 1000.0).max(0.0).powf(exponent)
    };
    for axes in ALL {
        bent(l, ["x_mm_at_kw", "y_mm_at_kw"], axes, exponent, risen);
        bent(l, ["x_mm_per_m_at_kw", "y_mm_per_m_at_kw"], axes, exponent, move |data, row, e| {
            risen(data, row, e) * height_m(data, row)
        });
    }
}

fn camera(l: &mut L, data: &Columns) {
    l.effect(
        words(
            "camera-tilt",
            "the camera looks at the plate at an angle: a larger ring is seen further off",
            "dx and dy against the square of the height, as the ring grows with it",
            "the same burns photographed with the plate turned by 180° under the camera: what the camera does stays, what the beam did turns with the plate",
            &["height_mm"],
        ),
        data.shows("height_mm"),
    );
    for axes in ALL {
        along(l, ["x_per_m", "y_per_m"], 0.01, axes, |data, row| {
            1e-3 * data.get("height_mm")[row].powi(2)
        });
    }
    // The ring has a size of its own where the beam is narrowest.
    let zeros = ("ring_zero_mm", &[5.0, 12.0, 25.0, 50.0][..]);
    for axes in ALL {
        bent(l, ["x_per_m", "y_per_m"], axes, zeros, |data, row, zero_mm| {
            1e-3 * (data.get("height_mm")[row] + zero_mm).powi(2)
        });
    }
}
