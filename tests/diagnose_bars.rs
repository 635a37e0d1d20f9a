//! Ball bars on paths as the program plans them: which axis moves, where the cup is, what a screw of any pitch does.

#[path = "common/diagnose.rs"]
mod common;

use std::fmt::Write as _;
use std::path::Path;

use common::{BAR, answer, class, diagnose, normal, run};

/// Rows of a path that the program plans: its name, B, X, Z and the bar's length.
fn planned(folder: &Path, path: &str, more: &[&str]) -> Vec<String> {
    let plan = ["ballbar", "plan", "--path", path, "--format", "csv", "--out", "plan.csv"];
    assert!(run(&[&plan[..], more].concat(), folder).status.success());
    let text = std::fs::read_to_string(folder.join("plan.csv")).unwrap();
    assert!(text.starts_with("path,b_deg,x_mm,z_mm,length_mm"), "{text}");
    text.lines().skip(1).map(str::to_owned).collect()
}

/// Simulates `data.csv` in its place and gives the lengths before and after.
fn simulated(folder: &Path, model: &str, noise_mm: &str) -> [Vec<f64>; 2] {
    std::fs::write(folder.join("real.toml"), model).unwrap();
    let lengths = || -> Vec<f64> {
        let text = std::fs::read_to_string(folder.join("data.csv")).unwrap();
        let at = text.lines().next().unwrap().split(',').position(|n| n == "length_mm").unwrap();
        let cell = |line: &str| line.split(',').nth(at).unwrap().parse().unwrap();
        text.lines().skip(1).map(cell).collect()
    };
    let before = lengths();
    let files = ["simulate", "ballbar", "--model", "real.toml", "--data", "data.csv"];
    let out = ["--noise-mm", noise_mm, "--format", "csv", "--out", "simulated.csv"];
    let output = run(&[&files[..], &out].concat(), folder);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    std::fs::rename(folder.join("simulated.csv"), folder.join("data.csv")).unwrap();
    [before, lengths()]
}

/// A bar keeps its length on every path that was planned for it, through B = 0 and on short ones too.
#[test]
fn every_path_is_simulated_as_it_was_planned() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for path in ["zb", "zb-y150", "zbk-y150", "xb", "xb-y-80", "xbk-y150", "xbk-y-80"] {
        for [from, to] in [["30", "-40"], ["0", "-15"], ["-10", "-50"]] {
            let rows =
                planned(folder, path, &["--from-deg", from, "--to-deg", to, "--steps", "40"]);
            let csv = format!("path,b_deg,x_mm,z_mm,length_mm\n{}\n", rows.join("\n"));
            std::fs::write(folder.join("data.csv"), csv).unwrap();
            let [plan, lengths] = simulated(folder, BAR, "0");
            let off = plan.iter().zip(&lengths).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-4, "{path} {from}..{to}: {off} mm");
        }
    }
}

/// A short arc about a cup beside the plane is one about a cup within it, seen with a longer bar: nothing is missing, whichever way Z
/// counts.
#[test]
fn a_short_arc_of_no_name_has_its_cup_beside() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let machine = BAR.replace("400.0", "280.0");
    for [from, to] in [["0", "-15"], ["10", "-10"], ["-5", "-20"]] {
        let bar = ["--pivot-mm", "280", "--below-mm", "680", "--from-deg", from, "--to-deg", to];
        let rows = planned(folder, "zb-y150", &[&bar[..], &["--steps", "80"]].concat());
        let mut normal = normal();
        let mut csv = String::from("b_deg,z_mm,dir,length_mm\n");
        for (row, dir) in rows.iter().map(|r| (r, -1)).chain(rows.iter().rev().map(|r| (r, 1))) {
            let cells: Vec<&str> = row.split(',').collect();
            let [z, length] = [3, 4].map(|i: usize| cells[i].parse::<f64>().unwrap());
            writeln!(csv, "{},{},{dir},{:.6}", cells[1], -z, length + 0.0007 * normal()).unwrap();
        }
        let report = answer("ballbar", &machine, &csv);
        assert_eq!(report["verdict"], "consistent", "{from}..{to}: {}", report["effects"]);
    }
}

/// Where Z stands still it does not turn back.
#[test]
fn a_path_of_x_shows_no_backlash_of_z() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let effect = "[[effects]]\nname = \"z-backlash\"\nparameters = { width_mm = 0.01 }\n";
    for (path, most_mm) in [("xbk-y150", 0.0), ("xb", 0.0), ("zb", 0.005)] {
        let rows = planned(folder, path, &["--steps", "40"]);
        let mut csv = String::from("dir,path,b_deg,x_mm,z_mm,length_mm\n");
        for (row, dir) in rows.iter().map(|r| (r, -1)).chain(rows.iter().rev().map(|r| (r, 1))) {
            writeln!(csv, "{dir},{row}").unwrap();
        }
        std::fs::write(folder.join("data.csv"), csv).unwrap();
        let [_, without] = simulated(folder, BAR, "0");
        let [_, with] = simulated(folder, &format!("{BAR}{effect}"), "0");
        let most = without.iter().zip(&with).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!((most - most_mm).abs() < 1e-4, "{path}: {most} mm");
    }
}

/// A screw has whatever pitch it has: those that no list has are found too, and told closely.
#[test]
fn a_screw_of_any_pitch_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("machine.toml"), BAR).unwrap();
    for pitch_mm in [7.0, 9.1, 14.0, 18.2] {
        let rows = planned(folder, "zb", &["--steps", "220"]);
        let csv = format!("path,b_deg,x_mm,z_mm,length_mm\n{}\n", rows.join("\n"));
        std::fs::write(folder.join("data.csv"), csv).unwrap();
        let cycle = format!(
            "[[effects]]\nname = \"cyclic-z\"\nparameters = {{ cos_mm = 0.0008, sin_mm = 0.0005, pitch_mm = {pitch_mm} }}\n"
        );
        simulated(folder, &format!("{BAR}{cycle}"), "0.0008");
        let report = diagnose("ballbar", folder);
        let effects = report["effects"].as_array().unwrap();
        assert_eq!((report["verdict"].as_str(), effects.len()), (Some("named"), 1), "{report}");
        assert_eq!(class(&report).last(), Some(&"cyclic-z"), "{pitch_mm}");
        let found = effects[0]["parameters"]["pitch_mm"].as_f64().unwrap();
        assert!((found / pitch_mm - 1.0).abs() < 0.01, "{found}, not {pitch_mm}");
    }
}

/// Where B passes its middle Z has come up and not yet turned back: what it lags behind is still all there.
#[test]
fn z_lags_behind_where_it_turns_back_too() {
    let folder = tempfile::tempdir().unwrap();
    let bar = ["--from-deg", "60", "--to-deg", "-60", "--steps", "40"];
    let rows = planned(folder.path(), "zb", &bar);
    let mut normal = normal();
    let mut csv = String::from("b_deg,z_mm,dir,length_mm\n");
    for (row, dir) in rows.iter().map(|r| (r, -1.0)).chain(rows.iter().rev().map(|r| (r, 1.0))) {
        let [b, z, length] =
            [1, 3, 4].map(|i: usize| row.split(',').nth(i).unwrap().parse::<f64>().unwrap());
        let upwards = if b.abs() < 1e-6 || b * dir < 0.0 { 1.0 } else { -1.0 };
        // The bar leans as far as B does: Z moves its end by the cosine along it.
        let lag = -0.5 * 0.006 * upwards * b.to_radians().cos();
        writeln!(csv, "{b},{z},{dir},{:.6}", length + lag + 0.0004 * normal()).unwrap();
    }
    let report = answer("ballbar", BAR, &csv);
    assert_eq!(report["verdict"], "named", "{}", report["unnamed"]);
    assert_eq!(report["effects"][0]["name"], "z-backlash", "{}", report["effects"]);
    let width = &report["effects"][0]["parameters"]["came_width_mm"];
    assert!((width.as_f64().unwrap() - 0.006).abs() < 4e-4, "{width}");
}

/// Rows of two paths there and back, `turns` times, with what their bars' lengths are wrong by and noise.
fn two_paths(folder: &Path, off_mm: [f64; 2], noise_mm: f64, turns: usize) -> String {
    let mut normal = normal();
    let mut csv = String::from("path,b_deg,x_mm,z_mm,length_mm,dir\n");
    for (path, off_mm) in ["zb", "zb-y150"].into_iter().zip(off_mm) {
        let rows = planned(folder, path, &["--steps", "60"]);
        for _ in 0..turns {
            for (row, dir) in rows.iter().map(|r| (r, -1)).chain(rows.iter().rev().map(|r| (r, 1)))
            {
                let (place, length) = row.rsplit_once(',').unwrap();
                let length = length.parse::<f64>().unwrap() + off_mm + noise_mm * normal();
                writeln!(csv, "{place},{length:.6},{dir}").unwrap();
            }
        }
    }
    csv
}

/// A longer path has another bar, whose length is wrong by itself.
#[test]
fn each_bar_is_off_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let report = answer("ballbar", BAR, &two_paths(folder.path(), [0.003, -0.003], 0.0003, 2));
    assert_eq!(report["verdict"], "consistent", "{}", report["effects"]);
}

/// Two backlashes that undo each other show together alone.
#[test]
fn names_that_hide_each_other_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("data.csv"), two_paths(folder, [0.0; 2], 0.0, 3)).unwrap();
    let effects = "[[effects]]\nname = \"b-backlash\"\nparameters = { width_deg = 0.00025 }\n\n\
                   [[effects]]\nname = \"z-backlash\"\nparameters = { width_mm = 0.0018 }\n";
    simulated(folder, &format!("{BAR}{effects}"), "0.001");
    let csv = std::fs::read_to_string(folder.join("data.csv")).unwrap();
    let report = answer("ballbar", BAR, &csv);
    let effects = report["effects"].as_array().unwrap();
    let is_named = |name: &str| {
        let rivals = |e: &serde_json::Value| e["confusable_with"].as_array().unwrap().clone();
        effects.iter().any(|e| e["name"] == name || rivals(e).iter().any(|r| r == name))
    };
    assert!(is_named("b-backlash") && is_named("z-backlash"), "{effects:?}");
}
