//! Diagnosis of readings as they come: rounded, and with one effect many times larger than another.

#[path = "common/diagnose.rs"]
mod common;

use std::fmt::Write as _;

use common::{BAR, answer, class, normal};
use serde_json::Value;

fn names(report: &Value) -> Vec<&str> {
    let effects = report["effects"].as_array().into_iter().flatten();
    let mut names: Vec<&str> = effects.filter_map(|e| e["name"].as_str()).collect();
    names.sort_unstable();
    names
}

/// A head that bends by a thirtieth of what its beam leans is no noise.
#[test]
fn a_small_effect_shows_beside_one_many_times_larger() {
    let mut normal = normal();
    for lean in [0.15, 0.3, 0.6] {
        let mut csv = String::from("height_mm,power_w,b_deg,dx_mm,dy_mm\n");
        for k in 0..45 {
            let i = k * 7 % 45;
            let (height, b) = ([20.0, 35.0, 47.0][i % 3], 45.0 * (i / 3 % 5) as f64 - 90.0);
            let dx = 0.02 * b.to_radians().sin() + 0.004 * normal();
            let dy = lean * height / 47.0 + 0.004 * normal();
            writeln!(csv, "{height},{},{b},{dx:.6},{dy:.6}", 100 + 50 * (i / 15)).unwrap();
        }
        let report = answer("burn", BAR, &csv);
        assert_eq!(report["verdict"], "named", "{lean}: {}", report["unnamed"]);
        assert_eq!(names(&report), ["beam-tilt-y", "head-sag"], "{lean}");
        let noise = report["noise_mm"].as_f64().unwrap();
        assert!((0.003..0.005).contains(&noise), "{lean}: {noise}");
    }
}

/// A sweep read to 0.01 mm with less noise than that, the target a little off; `y_um_per_m` is an error of Y's scale.
fn rounded_sweep(noise_mm: f64, y_um_per_m: f64, normal: &mut impl FnMut() -> f64) -> Value {
    let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
    for k in 0..156 {
        let (b, c) = (30.0 * f64::from(k % 7) - 90.0, f64::from(k * 5 % 22) * 16.0);
        let (sin, cos) = c.to_radians().sin_cos();
        let dy = 1e-6 * y_um_per_m * (160.0 * sin - 15.0 * cos);
        let moved = [0.013 * cos + 0.008 * sin, 0.013 * sin - 0.008 * cos + dy, 0.001];
        let [dx, dy, dz] = moved.map(|v: f64| ((v + noise_mm * normal()) / 0.01).round() * 0.01);
        writeln!(csv, "{b},{c},{dx:.2},{dy:.2},{dz:.2}").unwrap();
    }
    answer("rtcp", &format!("{BAR}[target]\nposition_mm = [160.0, -15.0, 40.0]\n"), &csv)
}

/// What rounding leaves is no effect, no shape and no outlier, however well the readings repeat; an effect larger than it keeps its name.
#[test]
fn rounding_is_no_effect() {
    let mut normal = normal();
    for noise_mm in [0.0005, 0.001, 0.002, 0.003] {
        let report = rounded_sweep(noise_mm, 0.0, &mut normal);
        let words = format!("{noise_mm}: {} {}", report["effects"], report["unnamed"]);
        assert_eq!(report["verdict"], "consistent", "{words}");
        assert!(report["warnings"].to_string().contains("rounded to 0.01 mm"), "{words}");
        assert_eq!(report["outliers"].as_array().map(Vec::len), Some(0), "{words}");
    }
    for noise_mm in [0.0015, 0.003] {
        let report = rounded_sweep(noise_mm, 200.0, &mut normal);
        let words = format!("{noise_mm}: {} {}", report["effects"], report["unnamed"]);
        assert_eq!(report["verdict"], "named", "{words}");
        assert!(class(&report).contains(&"scale-y"), "{words}");
    }
    let report = rounded_sweep(0.006, 0.0, &mut normal);
    assert!(!report["warnings"].to_string().contains("rounded"), "{}", report["warnings"]);
}
