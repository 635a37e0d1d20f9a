//! What to measure next: of what is confusable a list that the machine can run, and what it promises comes true.

#[path = "common/diagnose.rs"]
mod common;

use std::fmt::Write as _;
use std::path::Path;

use common::{BAR, class, diagnose, normal, run};
use serde_json::Value;

/// What `real.toml` shows of a table of what is commanded.
fn simulated(folder: &Path, kind: &str, of: &str, noise_mm: &str, seed: &str) -> String {
    let files = ["simulate", kind, "--model", "real.toml", "--data", of, "--format", "csv"];
    let output = run(&[&files[..], &["--noise-mm", noise_mm, "--seed", seed]].concat(), folder);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The rows of a table in these columns.
fn rows(csv: &str, names: &[&str]) -> Vec<String> {
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let header = reader.headers().unwrap().clone();
    let at = |name: &&str| header.iter().position(|n| n == *name).unwrap();
    let places: Vec<usize> = names.iter().map(at).collect();
    let row =
        |row: csv::StringRecord| places.iter().map(|k| &row[*k]).collect::<Vec<_>>().join(",");
    reader.records().map(|record| row(record.unwrap())).collect()
}

/// Z's own errors and the pivot's are one on the path that moves Z: the sweep that moves X instead parts them.
#[test]
fn a_path_of_x_parts_what_one_of_z_confuses() {
    for (effect, parameters) in [
        ("pivot-offset-x", "delta_x_mm = 0.1"),
        ("squareness-xz", "um_per_m = 250.0"),
        ("pivot-length", "r_mm = 0.3"),
        ("scale-z", "um_per_m = 800.0"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        std::fs::write(folder.join("machine.toml"), BAR).unwrap();
        let effects =
            format!("[[effects]]\nname = \"{effect}\"\nparameters = {{ {parameters} }}\n");
        std::fs::write(folder.join("real.toml"), format!("{BAR}{effects}")).unwrap();
        let mut plan = String::from("path,b_deg,x_mm,z_mm,dir\n");
        for k in (0..=120).rev().chain(0..=120).enumerate() {
            let (dir, b) = (if k.0 <= 120 { 1 } else { -1 }, -0.5 * f64::from(k.1));
            let z = -800.0 * (1.0 - b.to_radians().cos());
            writeln!(plan, "zb,{b},0,{z:.6},{dir}").unwrap();
        }
        std::fs::write(folder.join("plan.csv"), &plan).unwrap();
        let before = simulated(folder, "ballbar", "plan.csv", "0.0006", "1");
        std::fs::write(folder.join("data.csv"), &before).unwrap();
        let report = diagnose("ballbar", folder);
        assert!(class(&report).len() > 1, "{effect}: {report}");
        let next = &report["next_measurement"];
        assert_eq!(next["resolves"], true, "{effect}: {}", next["text"]);

        let files = ["diagnose", "ballbar", "--model", "machine.toml", "--data", "data.csv"];
        assert!(
            run(&[&files[..], &["--write-next", "next.csv"]].concat(), folder).status.success()
        );
        let asked = std::fs::read_to_string(folder.join("next.csv")).unwrap();
        assert!(rows(&asked, &["path"]).iter().all(|path| path == "xb"), "{asked}");
        let names = ["path", "b_deg", "x_mm", "z_mm", "dir"];
        let all = [vec![names.join(",")], rows(&plan, &names), rows(&asked, &names)].concat();
        std::fs::write(folder.join("all.csv"), all.join("\n")).unwrap();
        let after = simulated(folder, "ballbar", "all.csv", "0.0006", "2");
        std::fs::write(folder.join("data.csv"), after).unwrap();
        let report = diagnose("ballbar", folder);
        assert_eq!(class(&report), [effect], "{report}");
    }
}

/// With B at one angle an error of the head is one and the same vector whatever its cause: all of them are in the class.
#[test]
fn what_one_angle_of_b_shows_may_be_any_error_of_the_head() {
    let machine = "schema = 1\n[head]\ndelta_x_mm = 0.283\nr_mm = 214.7\n[target]\nposition_mm = [80.0, 0.0, 100.0]\n";
    let mut normal = normal();
    let mut csv = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
    let angle = 0.004_f64.to_radians();
    for c in (0..72).map(|k| 5 * k) {
        let b = 40.0_f64.to_radians();
        // Turned by a little more than it reads about an axis 214.7 mm above the tool point.
        let (dx, dz) = (-214.7 * angle * b.cos(), 214.7 * angle * b.sin());
        let mut noise = || 0.001 * normal();
        let d = [dx + noise(), noise(), dz + noise()];
        writeln!(csv, "40,{c},{:.6},{:.6},{:.6}", d[0], d[1], d[2]).unwrap();
    }
    let report = common::answer("rtcp", machine, &csv);
    let class = class(&report);
    for name in ["b-zero", "pivot-offset-x"] {
        assert!(class.contains(&name), "{class:?}");
    }
    let untested = report["untested"].as_array().unwrap();
    let names: Vec<&Value> = untested.iter().map(|u| &u[0]).collect();
    assert!(!names.iter().any(|name| *name == "pivot-length"), "{names:?}");
}
