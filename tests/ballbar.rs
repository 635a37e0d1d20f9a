//! Ball bar: the source's ranks, truth from the machine model, intervals that hold, no number for what is not seen.

#![allow(clippy::unwrap_used)]

use assert_cmd::Command;
use pivotsight::ballbar::decouple::{Options, decouple};
use pivotsight::ballbar::{Data, ERRORS, Report};

const TRUTH: [(&str, f64); 6] = [
    ("X0B", 0.02),
    ("Z0B", -0.01),
    ("A0B", 0.004),
    ("C0B", -0.002),
    ("A0Z", 0.001),
    ("B0Z", 0.003),
];

fn ballbar(args: &[&str]) -> std::process::Output {
    let mut command = Command::cargo_bin("pivotsight").unwrap();
    command.args(["--quiet", "ballbar"]).args(args).output().unwrap()
}

/// Lengths on some paths with all six errors of [`TRUTH`].
fn simulated(paths: &str, noise_mm: f64, seed: u64, steps: usize) -> String {
    let errors = TRUTH.map(|(n, v)| format!("{n}={v}")).join(",");
    let out = ballbar(&[
        "simulate",
        "--path",
        paths,
        "--error",
        &errors,
        "--noise-mm",
        &noise_mm.to_string(),
        "--seed",
        &seed.to_string(),
        "--steps",
        &steps.to_string(),
        "--format",
        "csv",
    ]);
    String::from_utf8(out.stdout).unwrap()
}

fn solve(csv: &str, options: &Options) -> Report {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("d.csv");
    std::fs::write(&file, csv).unwrap();
    decouple(&Data::read(&file, options).unwrap(), options).unwrap()
}

fn names(report: &Report) -> Vec<&str> {
    report.visible.iter().map(|v| v.name.as_str()).collect()
}

#[test]
fn the_source_path_sees_three_errors_and_a_shifted_cup_raises_the_rank_to_five() {
    let known = Options::default();
    let one = solve(&simulated("zb", 0.0, 1, 600), &known);
    assert_eq!((one.rank, one.points), (3, 601));
    assert_eq!(names(&one), ["X0B", "Z0B", "B0Z"]);
    assert_eq!(one.not_visible, ["A0B", "C0B", "A0Z"]);
    assert!(one.combinations.is_empty() && one.would_add.is_some());

    let unknown = Options { unknown_cup: true, unknown_bar: true, ..Options::default() };
    assert_eq!(solve(&simulated("zb", 0.0, 1, 600), &unknown).rank, 2);

    let two = solve(&simulated("zb,zb-y150", 0.0, 1, 600), &known);
    assert_eq!(two.rank, 5);
    assert_eq!(two.not_visible, ["A0B", "A0Z"]);
    // A0B and A0Z change the length as A0B - 2 A0Z: the sum is told, the parts are not.
    let c = &two.combinations[0];
    assert!((c.terms[1].value / c.terms[0].value + 2.0).abs() < 1e-6);
    assert!((c.value - c.terms[0].value * (0.004 - 2.0 * 0.001)).abs() < 1e-4, "{}", c.value);

    let suggested = two.would_add.unwrap();
    let all = solve(&simulated(&format!("zb,zb-y150,{suggested}"), 0.0, 1, 600), &known);
    assert_eq!(all.rank, 6, "the path it names adds what was missing");
    for (v, (name, truth)) in all.visible.iter().zip(TRUTH) {
        assert_eq!(v.name, name);
        assert!((v.value - truth).abs() < 2e-5, "{name} {}", v.value);
    }
}

#[test]
fn stated_intervals_hold_and_the_swarm_agrees() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..60 {
        let report =
            solve(&simulated("zb,zb-y150,xbk-y150", 0.0008, seed, 100), &Options::default());
        for ((v, s), (name, truth)) in report.visible.iter().zip(&report.swarm).zip(TRUTH) {
            assert_eq!(v.name, name);
            all += 1;
            inside += usize::from((v.value - truth).abs() <= v.u95);
            assert!((v.value - s.value).abs() < 0.1 * v.u95, "{name}: {} {}", v.value, s.value);
        }
    }
    let percent = 100.0 * inside as f64 / f64::from(all);
    assert!((91.0..98.5).contains(&percent), "{percent} %");
}

/// A backlash cannot be told from the errors where B went one way: how far it would move them is said, and is true.
#[test]
fn what_a_backlash_does_to_rows_of_one_way_is_said() {
    let csv = simulated("zb", 0.0001, 3, 300);
    let known = Options::default();
    let plain = solve(&csv, &known);
    let said = plain.warnings.iter().find(|w| w.starts_with("B goes one way only")).unwrap();
    let word =
        |after: &str| said.split(after).nth(1).unwrap().split(' ').next().unwrap().to_owned();
    let (name, stated) = (word("1 µm moves "), word("by up to ").parse::<f64>().unwrap());
    let value = |report: &Report| report.visible.iter().find(|v| v.name == name).unwrap().value;
    let header: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let moved = |column: &str, by: f64| {
        let at = header.iter().position(|h| *h == column).unwrap();
        let rows = csv.lines().skip(1).map(|row| {
            let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
            cells[at] = (cells[at].parse::<f64>().unwrap() + by).to_string();
            cells.join(",") + "\n"
        });
        let text = header.join(",") + "\n" + &rows.collect::<String>();
        (value(&solve(&text, &known)) - value(&plain)).abs()
    };
    let (b, z) = (moved("b_deg", (1e-3f64 / 400.0).to_degrees()), moved("z_mm", 1e-3));
    assert!((b.max(z) / stated - 1.0).abs() < 0.02, "{said}: {b} and {z}");
    // Both ways, though no column says so.
    let again = simulated("zb", 0.0001, 4, 300);
    let rows: Vec<&str> = again.lines().skip(1).collect();
    let back: String = rows.iter().rev().map(|row| format!("{row}\n")).collect();
    let both = solve(&format!("{csv}{back}"), &known);
    assert!(!both.warnings.iter().any(|w| w.contains("one way")), "{:?}", both.warnings);
}

#[test]
fn z_may_be_missing_or_count_either_way() {
    let csv = simulated("zb", 0.0, 1, 60);
    let rows = || csv.lines().skip(1).map(|l| l.split(',').collect::<Vec<_>>());
    let without: String = rows().map(|r| format!("{},{}\n", r[1], r[4])).collect();
    let upwards: String =
        rows().map(|r| format!("{},{},{}\n", r[1], -r[3].parse::<f64>().unwrap(), r[4])).collect();
    let a = solve(&csv, &Options::default());
    for text in [format!("b_deg,length_mm\n{without}"), format!("b_deg,z_mm,length_mm\n{upwards}")]
    {
        let b = solve(&text, &Options::default());
        for (x, y) in a.visible.iter().zip(&b.visible) {
            assert!((x.value - y.value).abs() < 1e-9);
        }
    }
}

#[test]
fn the_plan_moves_at_constant_speed_and_bad_input_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let nc = dir.path().join("p.nc");
    let out = ballbar(&["plan", "--gcode", nc.to_str().unwrap(), "--format", "json"]);
    let json: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!((json["step_mm"].as_f64().unwrap() - 0.6981).abs() < 5e-5);
    assert_eq!(json["rows"].as_array().unwrap().len(), 601);
    let text = std::fs::read_to_string(nc).unwrap();
    assert!(text.contains("G93\nG1 X0.0000 Z-0.0012 B-0.1000 F716.1973\n"));
    assert!(text.contains("Z-400.0000 B-60.0000"));

    let data = dir.path().join("d.csv");
    std::fs::write(&data, "b_deg,length_mm\n0,0.001\n-1,0.002\n").unwrap();
    let data = data.to_str().unwrap();
    let misspelt = dir.path().join("m.csv");
    std::fs::write(&misspelt, "path,cup_y_mm,b_deg,length_mm\nzbk-y15O,-150,0,400\n").unwrap();
    let misspelt = misspelt.to_str().unwrap();
    for (args, words) in [
        (&["plan", "--path", "yb"][..], "'yb'"),
        (&["plan", "--to-deg", "-95", "--path", "zbk-y150"], "does not reach"),
        (&["plan", "--bar-mm", "NaN"], "--bar-mm"),
        (&["simulate", "--error", "Q0B=1"], "Q0B"),
        (&["decouple", "--data", data], "whole length of the bar"),
        (&["decouple", "--data", data, "--path", "2"], "NAME=PATH"),
        (&["decouple", "--data", misspelt], "y15O"),
    ] {
        let out = ballbar(args);
        let message = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{message}");
        assert!(message.contains(words), "{words}: {message}");
    }
    assert_eq!(ERRORS.len(), 6);
}
