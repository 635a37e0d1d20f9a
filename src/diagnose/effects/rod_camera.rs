//! Effects of the camera and the light in the edge points of a check rod.

use crate::diagnose::data::rod::Rod;
use crate::diagnose::effects::rod::{CameraError, L};
use crate::diagnose::effects::{Words, words};
use crate::diagnose::experiment::Parameter;

fn camera(
    l: &mut L,
    names: &[&'static str],
    typical: f64,
    set: impl Fn(&mut CameraError, &[f64]) + Send + Sync + 'static,
) {
    let parameters = names.iter().map(|n| Parameter::linear(*n, typical)).collect();
    l.form(parameters, move |_, p, errors| errors.iter_mut().for_each(|e| set(&mut e.camera, p)));
}

/// Captures that show what the camera does.
const OFF: &str = "the rod in all corners of the frame, with a certified diameter";

/// Adds them, with what `data` cannot test marked.
pub(super) fn effects(l: &mut L, data: &Rod) {
    pixels(l);
    tilt(l);
    lens(l, data);
    light(l);
    shutter(l, data);
}

fn pixels(l: &mut L) {
    // What is said is of the camera: larger pixels show a place nearer to the axis, a camera turned one way shows it turned the other way.
    l.effect(
        words(
            "pixel-scale",
            "a pixel is larger than the calibration says",
            "the rod's apparent place against its place in the frame",
            OFF,
        ),
        None,
    );
    camera(l, &["um_per_m"], 300.0, |c, p| {
        c.linear[0][0] -= p[0] * 1e-6;
        c.linear[1][1] -= p[0] * 1e-6;
    });
    l.effect(
        words(
            "pixel-aspect",
            "pixels are not square: larger by so much than the calibration says, along u or along v",
            "twice round the edge, fixed to the camera",
            OFF,
        ),
        None,
    );
    camera(l, &["v_um_per_m"], 300.0, |c, p| c.linear[1][1] -= p[0] * 1e-6);
    camera(l, &["um_per_m"], 300.0, |c, p| {
        c.linear[0][0] -= 0.5e-6 * p[0];
        c.linear[1][1] += 0.5e-6 * p[0];
    });
    camera(l, &["u_um_per_m"], 300.0, |c, p| c.linear[0][0] -= p[0] * 1e-6);
    l.effect(
        words(
            "camera-rotation",
            "the camera is turned about its axis, counter-clockwise seen from above",
            "the rod's apparent place across its place in the frame",
            OFF,
        ),
        None,
    );
    camera(l, &["angle_deg"], 0.02, |c, p| {
        let a = p[0].to_radians();
        c.linear[0][1] += a;
        c.linear[1][0] -= a;
    });
    l.effect(
        words(
            "camera-shear",
            "the picture's rows and columns are not square to each other",
            "twice round the edge at 45 degrees",
            OFF,
        ),
        None,
    );
    camera(l, &["um_per_m"], 300.0, |c, p| c.linear[0][1] += p[0] * 1e-6);
    camera(l, &["both_um_per_m"], 300.0, |c, p| {
        c.linear[0][1] += 0.5e-6 * p[0];
        c.linear[1][0] += 0.5e-6 * p[0];
    });
    camera(l, &["rows_um_per_m"], 300.0, |c, p| c.linear[1][0] += p[0] * 1e-6);
}

fn tilt(l: &mut L) {
    l.effect(
        words(
            "camera-tilt",
            "the camera looks at the plane at an angle (perspective)",
            "scale that changes over the frame",
            OFF,
        ),
        None,
    );
    camera(l, &["u_per_m", "v_per_m"], 0.1, |c, p| {
        c.tilt[0] += p[0] * 1e-3;
        c.tilt[1] += p[1] * 1e-3;
    });
    // A lens that shows a tilted plane unshortened (its sensor tilted too), or a distance that is not what the calibration says.
    let mut flat: Vec<Parameter> =
        ["u_per_m", "v_per_m"].map(|n| Parameter::linear(n, 0.1)).to_vec();
    flat.push(Parameter::switch("unshortened", 1.0));
    l.form(flat, |_, p, errors| {
        for e in errors {
            e.camera.unshortened[0] += p[0] * 1e-3;
            e.camera.unshortened[1] += p[1] * 1e-3;
        }
    });
}

fn lens(l: &mut L, data: &Rod) {
    let lens = (!data.has_lens()).then(|| "the calibration has no lens, only a scale".into());
    let wide = "the rod's edge out to the frame's corners";
    let lens_words = |l: &mut L, name, meaning, varies_with: &'static [&'static str]| {
        l.effect(
            Words {
                name,
                meaning,
                evidence: "towards the frame's corners",
                best: wide,
                varies_with,
            },
            lens.clone(),
        );
    };
    lens_words(
        l,
        "lens-radial",
        "the lens bends lines more than the calibration says (k1)",
        &["frame_radius_mm"],
    );
    camera(l, &["k1"], 0.01, |c, p| c.lens[0] += p[0]);
    lens_words(
        l,
        "lens-radial-5",
        "the lens' fifth-order distortion is off (k2)",
        &["frame_radius_mm"],
    );
    camera(l, &["k2"], 0.1, |c, p| c.lens[1] += p[0]);
    lens_words(
        l,
        "lens-decentring",
        "the lens' elements are off their axis (p1, p2)",
        &["frame_radius_mm"],
    );
    camera(l, &["p1", "p2"], 1e-3, |c, p| {
        c.lens[2] += p[0];
        c.lens[3] += p[1];
    });
}

fn light(l: &mut L) {
    l.effect(
        Words {
            // Light does not fall off in a straight line, nor does an edge go on following it.
            varies_with: &["frame_u_mm", "frame_v_mm"],
            ..words(
                "edge-bias-light",
                "the edge is seen further out where the light is stronger",
                "the apparent radius against the place in the frame",
                "the lamp turned by 180 degrees",
            )
        },
        None,
    );
    camera(l, &["u_um_per_mm", "v_um_per_mm"], 0.1, |c, p| {
        c.light[0] += p[0] * 1e-3;
        c.light[1] += p[1] * 1e-3;
    });
}

fn shutter(l: &mut L, data: &Rod) {
    l.effect(
        words(
            "shutter-skew",
            "rows are exposed one after another while the axis still moves",
            "a shear that changes sign with the direction of travel",
            "each place approached from both sides; a longer wait",
        ),
        data.shows("dir_x").filter(|_| data.shows("dir_y").is_some()),
    );
    for axes in [[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]] {
        let name = match axes {
            [_, 0.0] => "x_um_per_mm",
            [0.0, _] => "y_um_per_mm",
            _ => "um_per_mm",
        };
        l.form(vec![Parameter::linear(name, 0.1)], move |data, p, errors| {
            for (g, e) in errors.iter_mut().enumerate() {
                let x = data.dir_x.get(g).copied().unwrap_or(0.0) * axes[0];
                let y = data.dir_y.get(g).copied().unwrap_or(0.0) * axes[1];
                e.camera.linear[0][1] += p[0] * 1e-3 * x;
                e.camera.linear[1][1] += p[0] * 1e-3 * y;
            }
        });
    }
    let each = ["each_x_um_per_mm", "each_y_um_per_mm"].map(|n| Parameter::linear(n, 0.1));
    l.form(each.to_vec(), |data, p, errors| {
        for (g, e) in errors.iter_mut().enumerate() {
            let of = |dir: &[f64]| 1e-3 * dir.get(g).copied().unwrap_or(0.0);
            e.camera.linear[0][1] += p[0] * of(&data.dir_x);
            e.camera.linear[1][1] += p[1] * of(&data.dir_y);
        }
    });
}
