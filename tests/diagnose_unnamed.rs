//! Diagnosis of what has no name: it is told as a shape, takes no name in vain, and hides none.

#[path = "common/diagnose.rs"]
mod common;

use std::fmt::Write as _;

use common::{BAR, answer, class, normal, run};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

/// The answer to a sweep over B and C.
fn sweep(csv: &str) -> Value {
    answer("rtcp", &format!("{BAR}[target]\nposition_mm = [60.0, -15.0, 40.0]\n"), csv)
}

/// What happens at one of five angles, or beyond one of them, is no sum of tilts.
#[test]
fn five_angles_are_enough_for_a_step_and_a_bump() {
    let step = |b: f64| if b > 20.0 { 0.015 } else { 0.0 };
    let bump = |b: f64| if b == 45.0 { 0.01 } else { 0.0 };
    let shapes: [(&dyn Fn(f64) -> f64, &str); 2] = [(&step, "step"), (&bump, "bump")];
    let mut normal = normal();
    for (hidden, shape) in shapes {
        for again in 0..4 {
            let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
            for k in 0..70 {
                let (b, c) = (45.0 * f64::from(k % 5) - 90.0, f64::from(k / 5 % 7) * 47.0);
                let mut noise = || 0.002 * normal();
                let d = [noise(), hidden(b) + noise(), noise()];
                writeln!(csv, "{b},{c},{:.6},{:.6},{:.6}", d[0], d[1], d[2]).unwrap();
            }
            let report = sweep(&csv);
            assert_eq!(report["verdict"], "unknown", "{shape} {again}: {}", report["effects"]);
            let told = &report["unnamed"][0];
            assert_eq!((&told["output"], &told["versus"]), (&"dy_mm".into(), &"b_deg".into()));
            assert!(told["shape"].as_str().unwrap().starts_with(shape), "{told}");
            assert_eq!(report["where"][0]["output"], "dy_mm", "{}", report["where"]);
        }
    }
}

/// What goes on and off by itself eight to ten times in a run has no name.
#[test]
fn what_comes_and_goes_with_time_is_no_name() {
    let mut normal = normal();
    for times in [8.2, 9.0, 9.7, 10.4] {
        let mut csv = String::from("b_deg,c_deg,t_s,dx_mm,dy_mm,dz_mm\n");
        for k in 0..156 {
            let (b, c) = (30.0 * f64::from(k % 7) - 90.0, f64::from(k / 7) * 16.0);
            let on = (times * f64::from(k) / 156.0).fract() < 0.35;
            let mut noise = || 0.002 * normal();
            let d = [noise() + if on { 0.0055 } else { 0.0 }, noise(), noise()];
            writeln!(csv, "{b},{c},{},{:.6},{:.6},{:.6}", 20 * k, d[0], d[1], d[2]).unwrap();
        }
        let report = sweep(&csv);
        assert_eq!(report["verdict"], "unknown", "{times}: {}", report["effects"]);
        let told = &report["unnamed"][0];
        assert_eq!((&told["output"], &told["versus"]), (&"dx_mm".into(), &"t_s".into()));
    }
}

/// A rod that grows as nothing in the library does hides no lens behind the two ways of saying how large it is.
#[test]
fn a_lens_is_named_beside_a_rod_that_grows_in_a_way_without_a_name() {
    const CALIB: &str = "schema = 1\nname = \"lens\"\n[camera]\nwidth_px = 1600\nheight_px = 1200\nfx_px = 3200\nfy_px = 3200\n\
                         cx_px = 799.5\ncy_px = 599.5\ndistortion = [-0.015, 0, 0, 0, 0]\n[plane]\n\
                         homography_mm = [[28, 0.1, 0], [0.1, -28, 0], [-0.004, -0.003, 1]]\n";
    let to_plane = [[28.0, 0.1, 0.0], [0.1, -28.0, 0.0], [-0.004, -0.003, 1.0]];
    let to_image = Matrix3::from_fn(|r, c| to_plane[r][c]).try_inverse().unwrap();
    let mut normal = normal();
    for again in 0..3 {
        let mut csv = String::from("capture,x_mm,y_mm,c_deg,t_s,u_px,v_px\n");
        for k in 0..36_u32 {
            let (i, t) = (f64::from(k * 7 % 36), 40.0 * f64::from(k));
            let grown = 0.007 * (5.5 * (t / 1400.0 - 1.0)).exp();
            let (sin, cos) = (10.0 * i).to_radians().sin_cos();
            let camera = [1.7 * cos + 0.5 * (2.0 * i).sin(), 1.7 * sin + 0.5 * (3.0 * i).cos()];
            for p in 0..30 {
                let (sin, cos) = (10.0 * i + 11.0 * f64::from(p)).to_radians().sin_cos();
                let r = 3.4 + grown + 0.001 * normal();
                let seen = to_image * Vector3::new(r * cos - camera[0], r * sin - camera[1], 1.0);
                let (x, y) = (seen.x / seen.z, seen.y / seen.z);
                let (p1, p2) = (0.0012, -0.0008);
                let square = x * x + y * y;
                let radial = 1.0 - 0.015 * square;
                let x2 = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x);
                let y2 = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y;
                let (u, v) = (3200.0 * x2 + 799.5, 3200.0 * y2 + 599.5);
                let c = 45.0 * f64::from(k % 8);
                writeln!(csv, "{k},{:.4},{:.4},{c},{t},{u:.3},{v:.3}", camera[0], camera[1])
                    .unwrap();
            }
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("calib.toml"), CALIB).unwrap();
        std::fs::write(folder.path().join("data.csv"), csv).unwrap();
        let files = ["diagnose", "rod", "--calib", "calib.toml", "--data", "data.csv"];
        let output = run(&[&files[..], &["--format", "json"]].concat(), folder.path());
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["verdict"], "partly", "{again}: {report:#}");
        assert_eq!(class(&report), ["lens-decentring"], "{}", report["effects"]);
        let unnamed = &report["unnamed"][0];
        assert_eq!(unnamed["output"], "radius", "{unnamed}");
        assert!(!unnamed["formula"].as_str().unwrap().contains("*1"), "{unnamed}");
    }
}

/// Edge points whose errors follow one another along the rim, in every capture anew: that is noise, whatever shape it has by chance.
#[test]
fn edges_that_wander_along_the_rim_are_noise() {
    let mut normal = normal();
    for whole in [true, false] {
        let mut csv = String::from("capture,x_mm,y_mm,c_deg,u_px,v_px\n");
        for k in 0..40_i32 {
            let around = f64::from(k * 17 % 40) * 9.0;
            let at = |deg: f64, r: f64| [r * deg.to_radians().cos(), r * deg.to_radians().sin()];
            let [x, y] = at(around, if whole { 0.5 } else { 8.0 });
            let mut error = normal();
            for p in 0..60 {
                error = 0.85 * error + (1.0_f64 - 0.85 * 0.85).sqrt() * normal();
                let round = if whole { 6.0 } else { 0.8 };
                let radius = if whole { 3.0 } else { 8.0 };
                let edge = at(around + round * (f64::from(p) - 29.5), radius + 0.002 * error);
                let (u, v) = (500.0 + (edge[0] - x) / 0.01, 500.0 - (edge[1] - y) / 0.01);
                writeln!(csv, "{k},{x:.6},{y:.6},{},{u:.5},{v:.5}", k * 83 % 360).unwrap();
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        std::fs::write(folder.join("calib.toml"), "schema = 1\n[scale]\nmm_per_px = 0.01\n")
            .unwrap();
        std::fs::write(folder.join("data.csv"), csv).unwrap();
        let files =
            ["diagnose", "rod", "--calib", "calib.toml", "--data", "data.csv", "--format", "json"];
        let output = run(&files, folder);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["verdict"], "consistent", "{}{}", report["effects"], report["unnamed"]);
        assert!(report["noise_source"].as_str().unwrap().contains("follow one another"));
    }
}

/// Three cycles a turn of C have no name; what goes once round beside them in the same output has one.
#[test]
fn a_runout_is_named_beside_another_harmonic() {
    let mut normal = normal();
    for again in 0..4 {
        let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
        for k in 0..156 {
            let (b, c) = (30.0 * f64::from(k % 7) - 90.0, f64::from(k / 7) * 16.0);
            let (sin, cos) = (c.to_radians() + f64::from(again)).sin_cos();
            let three = 0.004 * (3.0 * c.to_radians() + f64::from(again)).sin();
            let mut noise = || 0.002 * normal();
            let d = [0.003 * cos + noise(), three - 0.003 * sin + noise(), noise()];
            writeln!(csv, "{b},{c},{:.6},{:.6},{:.6}", d[0], d[1], d[2]).unwrap();
        }
        let report = sweep(&csv);
        let words = format!("{again}: {} {}", report["effects"], report["unnamed"]);
        assert_eq!(report["verdict"], "partly", "{words}");
        assert!(class(&report).contains(&"target-runout"), "{words}");
        assert_eq!(report["unnamed"][0]["shape"], "harmonic 3", "{words}");
    }
}

/// A wave over a ball bar's path, of cycles that are no harmonics of B, hides no length of the head.
#[test]
fn a_length_is_named_beside_a_wave_over_b() {
    let mut normal = normal();
    for again in 0..4 {
        let cycles = 2.3 + 0.4 * f64::from(again);
        let mut csv = String::from("b_deg,z_mm,dir,length_mm\n");
        for k in 0..300 {
            let part = f64::from(if k < 150 { k } else { 299 - k }) / 149.0;
            let b = (-60.0 * part).to_radians();
            let z = -800.0 * (1.0 - b.cos());
            let (x, up) = (-400.0 * b.sin(), -400.0 * b.cos() + z + 800.0);
            let length = (x - 0.02 * b.sin()).hypot(up - 0.02 * b.cos());
            let wave = 0.003 * (std::f64::consts::TAU * cycles * part + f64::from(again)).sin();
            let dir = if k < 150 { -1 } else { 1 };
            let read = length + wave + 0.0007 * normal();
            writeln!(csv, "{:.6},{z:.6},{dir},{read:.6}", b.to_degrees()).unwrap();
        }
        let report = answer("ballbar", BAR, &csv);
        let words = format!("{cycles}: {} {}", report["effects"], report["unnamed"]);
        assert_eq!(report["verdict"], "partly", "{words}");
        assert!(class(&report).contains(&"pivot-length"), "{words}");
        assert!(report["unnamed"][0]["shape"].as_str().unwrap().starts_with("wave"), "{words}");
    }
}

/// A scale that grows towards one end of its axis is that axis' scale, and no bump over C.
#[test]
fn a_curved_scale_keeps_its_name() {
    let mut normal = normal();
    for again in 0..3 {
        let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
        for k in 0..156 {
            let (b, c) = (30.0 * f64::from(k % 7) - 90.0, f64::from(k * 5 % 22) * 16.0);
            let (sin, cos) = c.to_radians().sin_cos();
            let y = 160.0 * sin - 15.0 * cos;
            let mut noise = || 0.002 * normal();
            let dy = 8e-5 * (y + 0.25 * y * y / 160.0) + noise();
            writeln!(csv, "{b},{c},{:.6},{dy:.6},{:.6}", noise(), noise()).unwrap();
        }
        let machine = format!("{BAR}[target]\nposition_mm = [160.0, -15.0, 40.0]\n");
        let report = answer("rtcp", &machine, &csv);
        let named = report["effects"].as_array().unwrap();
        assert!(
            report["verdict"] == "named" && named.len() == 1 && named[0]["name"] == "scale-y",
            "{again}: {} {}",
            report["effects"],
            report["unnamed"]
        );
    }
}

/// What happens about one pose alone, in B and in C, is told as that and hides no name.
#[test]
fn a_scale_is_named_beside_a_bump_about_one_pose() {
    let mut normal = normal();
    for (again, (b0, c0)) in [(34.0, 200.0), (-16.0, 150.0), (-40.0, 90.0)].into_iter().enumerate()
    {
        let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
        for k in 0..156 {
            let (b, c) = (30.0 * f64::from(k % 7) - 90.0, f64::from(k * 5 % 22) * 16.0);
            let (sin, cos) = c.to_radians().sin_cos();
            let (from_b, from_c): (f64, f64) = ((b - b0) / 35.0, (c - c0) / 60.0);
            let bump = 0.008 * (-0.5 * (from_b.powi(2) + from_c.powi(2))).exp();
            let mut noise = || 0.0015 * normal();
            let d = [bump + noise(), 5e-5 * (160.0 * sin - 15.0 * cos) + noise(), noise()];
            writeln!(csv, "{b},{c},{:.6},{:.6},{:.6}", d[0], d[1], d[2]).unwrap();
        }
        let machine = format!("{BAR}[target]\nposition_mm = [160.0, -15.0, 40.0]\n");
        let report = answer("rtcp", &machine, &csv);
        let words = format!("{again}: {} {}", report["effects"], report["unnamed"]);
        assert_eq!(report["effects"].as_array().unwrap().len(), 1, "{words}");
        assert!(class(&report).contains(&"scale-y"), "{words}");
        let told = &report["unnamed"][0];
        assert_eq!(told["versus"], "b_deg, c_deg", "{words}");
        assert!(told["shape"].as_str().unwrap().starts_with("bump"), "{words}");
    }
}
