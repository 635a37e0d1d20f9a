//! How a blank lies: truth from a tilted one, which way the path goes, intervals that hold, bad touches named.

#![allow(clippy::unwrap_used)]

#[path = "common/blank.rs"]
mod blank;

use std::fmt::Write;

use assert_cmd::Command;
use blank::{IDEAL, fitted, touches};
use nalgebra::{Rotation3, Vector3};
use pivotsight::align::{Touches, fit};
use pivotsight::table::Table;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};

/// One touch of five that is 5 mm off leaves a tilt that nobody should cut by, and says so.
#[test]
fn a_touch_far_off_the_face_is_told() {
    let good = touches(0.3, -0.2, Vector3::zeros(), 5, 0.003, 3);
    let fit = |csv: &str| {
        let table = Table::parse("t.csv", csv.as_bytes(), &["kind", "x_mm", "y_mm", "z_mm"], &[]);
        let mut told = Vec::new();
        let alignment = fit(&Touches::from_table(&table.unwrap()).unwrap(), &IDEAL, &mut told);
        told.extend(alignment.unwrap().doubts());
        told
    };
    assert!(fit(&good).is_empty());
    let wrong: Vec<String> = good
        .lines()
        .enumerate()
        .map(|(i, line)| match (i, line.rsplit_once(',')) {
            (2, Some((head, z))) => format!("{head},{}", z.parse::<f64>().unwrap() + 5.0),
            _ => line.to_owned(),
        })
        .collect();
    let told = fit(&wrong.join("\n")).join("; ");
    assert!(told.contains("off their plane") && told.contains("° only"), "{told}");
}

#[test]
fn sides_touched_at_different_heights_give_one_axis() {
    let (a, b) = (0.8f64.to_radians(), (-1.3f64).to_radians());
    let level = Rotation3::from_axis_angle(&Vector3::y_axis(), b)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), a);
    let mut csv = String::from("kind,x_mm,y_mm,z_mm\n");
    for (x, y) in [(-90.0, -90.0), (90.0, -90.0), (0.0, 90.0)] {
        let p = level.inverse() * Vector3::new(x, y, 50.0);
        writeln!(csv, "face,{:.9},{:.9},{:.9}", p.x, p.y, p.z).unwrap();
    }
    let axis = level.inverse() * Vector3::new(5.0, 2.0, 0.0);
    let up = level.inverse() * Vector3::z();
    let at = |z: f64| axis + up * ((z - axis.z) / up.z);
    for side in [-150.0, 150.0] {
        let (x, y) = (at(20.0), at(-80.0));
        writeln!(csv, "side_x,{:.9},{:.9},{:.9}", x.x + side, x.y, x.z).unwrap();
        writeln!(csv, "side_y,{:.9},{:.9},{:.9}", y.x, y.y + side, y.z).unwrap();
    }
    let alignment = fitted(&csv, &IDEAL);
    let (center, expected) = (alignment.center_mm.unwrap(), at(alignment.center_z_mm));
    assert!((center[0] - expected.x).abs() < 1e-6 && (center[1] - expected.y).abs() < 1e-6);
}

#[test]
fn the_path_lands_on_the_tilted_blank_and_not_on_its_mirror_image() {
    let shift = Vector3::new(3.0, -2.0, 1.5);
    let alignment = fitted(&touches(0.8, -1.3, shift, 3, 0.0, 0), &IDEAL);
    assert!((alignment.a_deg - 0.8).abs() < 1e-7 && (alignment.b_deg + 1.3).abs() < 1e-7);
    // A point of the part, where the program has it, must come to lie where the blank has it.
    let level = Rotation3::from_axis_angle(&Vector3::y_axis(), (-1.3f64).to_radians())
        * Rotation3::from_axis_angle(&Vector3::x_axis(), 0.8f64.to_radians());
    for p in [Vector3::new(0.0, 0.0, 50.0), Vector3::new(70.0, -40.0, 10.0)] {
        let on_blank = level.inverse() * p + shift;
        let moved = alignment.motion() * nalgebra::Point3::from(p);
        assert!((moved.coords - on_blank).norm() < 1e-6, "{moved} {on_blank}");
    }
}

#[test]
fn stated_intervals_hold() {
    let shift = Vector3::new(0.4, -0.3, 0.2);
    let truth = fitted(&touches(0.3, 0.5, shift, 8, 0.0, 0), &IDEAL);
    let [cx, cy] = truth.center_mm.unwrap();
    for (touch_u_mm, face) in [(None, 8), (Some(0.003), 3)] {
        let (mut inside, mut all) = (0, 0);
        for seed in 0..300 {
            let options = fit::Options { touch_u_mm, ..IDEAL };
            let got = fitted(&touches(0.3, 0.5, shift, face, 0.003, seed), &options);
            let ([x, y], [ux, uy]) = (got.center_mm.unwrap(), got.center_u95_mm.unwrap());
            for (value, true_value, u95) in [
                (got.a_deg, truth.a_deg, got.a_u95_deg),
                (got.b_deg, truth.b_deg, got.b_u95_deg),
                (got.dz_mm, truth.dz_mm, got.dz_u95_mm),
                (x, cx, ux),
                (y, cy, uy),
            ] {
                all += 1;
                inside += usize::from((value - true_value).abs() <= u95);
            }
        }
        let percent = 100.0 * inside as f64 / all as f64;
        assert!((92.5..97.5).contains(&percent), "{percent} %");
    }
}

#[test]
fn the_command_measures_applies_and_names_bad_touches() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name);
    let command = || {
        let mut c = Command::cargo_bin("pivotsight").unwrap();
        c.args(["--quiet", "align"]);
        c
    };
    let out = command()
        .args(["docs/examples/blank.csv", "--z-ideal-mm", "50", "--format", "json"])
        .output()
        .unwrap();
    std::fs::write(file("a.json"), &out.stdout).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(json["schema"], "pivotsight.align/1");
    assert!((json["center_mm"][0].as_f64().unwrap() - 5.41).abs() < 1e-9);
    command()
        .arg("apply")
        .args(["--machine", "docs/examples/machine-ac.toml", "docs/examples/path.apt", "--align"])
        .arg(file("a.json"))
        .arg(file("p.nc"))
        .assert()
        .success();
    // A program as an editor on Windows saves it: read all the same, and its line ends kept.
    let path = std::fs::read_to_string("docs/examples/path.apt").unwrap();
    std::fs::write(file("w.apt"), format!("\u{feff}{}", path.replace('\n', "\r\n"))).unwrap();
    let mut windows = command();
    windows.args(["apply", "--machine", "docs/examples/machine-ac.toml", "--align"]);
    windows.args(["a.json", "w.apt", "w.nc"].map(file)).assert().success();
    let [unix, windows] = ["p.nc", "w.nc"].map(|name| std::fs::read_to_string(file(name)).unwrap());
    assert_eq!(unix.replace('\n', "\r\n"), windows);
    // Three numbers with decimal commas, or six without.
    std::fs::write(file("c.cl"), "10,0 20,0 0,1\n").unwrap();
    let mut comma = command();
    comma.args(["apply", "--machine", "docs/examples/machine-ac.toml", "--align"]);
    let out =
        comma.args(["a.json", "c.cl", "c.out"].map(file)).assert().code(2).get_output().clone();
    assert!(String::from_utf8(out.stderr).unwrap().contains("decimal points"));
    for (text, words) in [
        ("face,0,0,0\nface,1,1,0\n", "2 face points"),
        ("face,0,0,0\nface,10,10,0\nface,20,20,0\n", "on a line"),
        ("face,0,0,0\nface,0,10,0\nface,0,0,10\n", "45"),
        ("edge,0,0,0\n", "'edge'"),
        ("face,0,0,0\nface,9,0,0\nface,0,9,0\nside_x,5,0,0\n", "one side_x"),
        ("face,0,0,0\nface,9,0,0\nface,0,9,0\nside_x,5,0,0\nside_x,5,0,0\n", "one side"),
        ("face,0,0,0\nface,9,0,0\nface,0,9,0\nside_x,5,0,0\nside_x,5.1,9,0\n", "one side"),
    ] {
        std::fs::write(file("t.csv"), format!("kind,x_mm,y_mm,z_mm\n{text}")).unwrap();
        let out = command().arg(file("t.csv")).assert().code(2).get_output().clone();
        let message = String::from_utf8(out.stderr).unwrap();
        assert!(message.contains(words), "{words}: {message}");
    }
}

/// Sides that are rougher than the face say so by themselves, and four points of a face may agree by chance.
#[test]
fn rough_sides_and_few_points_have_intervals_that_hold() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(6);
    let mut draw = |sd: f64| Normal::new(0.0, sd).unwrap().sample(&mut random);
    let (mut held, mut worst): (usize, f64) = (0, 0.0);
    for _ in 0..100 {
        let mut out = String::from("kind,x_mm,y_mm,z_mm\n");
        for (x, y) in [(-50, -50), (50, -50), (50, 50), (-50, 50), (0, 10), (20, -30), (-30, 0)] {
            writeln!(out, "face,{x},{y},{:.6}", 50.0 + draw(0.001)).unwrap();
        }
        for side in [-60.0, 60.0] {
            for along in [-40.0, -20.0, 0.0, 20.0, 40.0] {
                writeln!(out, "side_x,{:.6},{along},30", side + draw(0.004)).unwrap();
                writeln!(out, "side_y,{along},{:.6},30", side + draw(0.004)).unwrap();
            }
        }
        let found = fitted(&out, &IDEAL);
        held += usize::from(found.center_mm.unwrap()[0].abs() < found.center_u95_mm.unwrap()[0]);
        let mut few = String::from("kind,x_mm,y_mm,z_mm\n");
        for (x, y) in [(-50, -50), (50, -50), (50, 50), (-50, 50)] {
            writeln!(few, "face,{x},{y},{:.6}", 50.0 + draw(0.002)).unwrap();
        }
        let found = fitted(&few, &IDEAL);
        worst = worst.max(found.dz_mm.abs() / found.dz_u95_mm);
    }
    assert!(held > 90, "{held} of 100");
    assert!(worst < 3.0, "{worst}");
}

/// Touches of a level face all round the same way: more of them make their height no surer than the digit.
#[test]
fn coarse_readings_that_agree_are_no_surer_than_their_digit() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    let (mut high, mut across) = (0, 0);
    for _ in 0..200 {
        let coarse = |mm: f64| (100.0 * mm).round() / 100.0;
        let noise = Normal::new(0.0, 0.0005).unwrap();
        let [z, x, y, tilt] = std::array::from_fn(|_| random.random_range(-0.01..0.01));
        let mut draw = || noise.sample(&mut random);
        let mut out = String::from("kind,x_mm,y_mm,z_mm\n");
        for at in [[-50, -50], [50, -50], [50, 50], [-50, 50], [0, 10], [20, -30], [-30, 0]] {
            let height = 50.0 + z + 0.005 * tilt * f64::from(at[0]) + draw();
            writeln!(out, "face,{},{},{:.2}", at[0], at[1], coarse(height)).unwrap();
        }
        for side in [-60.0, 60.0] {
            for along in [-20, 0, 20] {
                writeln!(out, "side_x,{:.2},{along},30", coarse(side + x + draw())).unwrap();
                writeln!(out, "side_y,{along},{:.2},30", coarse(side + y + draw())).unwrap();
            }
        }
        let found = fitted(&out, &IDEAL);
        let (center, u95) = (found.center_mm.unwrap(), found.center_u95_mm.unwrap());
        high += usize::from((found.dz_mm - z).abs() < found.dz_u95_mm);
        across += usize::from((center[0] - x).abs() < u95[0]);
    }
    assert!(high >= 184 && across >= 184, "{high} and {across} of 200");
}
