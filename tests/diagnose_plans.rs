//! Diagnosis on plans as they are measured in practice: the table turned under one place, few angles, a slipped reading, two lengths wrong at once.

#![allow(clippy::unwrap_used)]

#[path = "common/json.rs"]
mod json;

use std::fmt::Write;
use std::path::Path;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::Value;

const MACHINE: &str = "schema = 1\n[head]\ndelta_x_mm = -1.3\nr_mm = 301.1\n[target]\nposition_mm = [60.0, -15.0, 40.0]\n";

fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    move || StandardNormal.sample(&mut random)
}

/// Diagnoses `csv`; with the file `other` where the kind needs one.
fn diagnose(kind: &str, csv: &str, other: Option<(&str, &str)>, more: &[&str]) -> (Value, String) {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| -> String {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().into()
    };
    let data = file("data.csv", csv);
    let mut arguments = vec!["diagnose", kind, "--data", &data];
    let path = other.map(|(_, text)| file("other.toml", text));
    if let (Some((option, _)), Some(path)) = (other, &path) {
        arguments.extend([option, path]);
    }
    arguments.extend(more);
    let (report, code, words) = json::run(&arguments);
    assert_eq!(code, Some(0), "{words}");
    (report, words)
}

/// Edge points of a rod that turns under a camera at one place, `off` its axis, C counting by `sense`.
fn turned(off_mm: f64, sense: f64) -> String {
    let mut normal = normal(7);
    let mut csv = String::from("capture,x_mm,y_mm,c_deg,u_px,v_px\n");
    for k in 0..20 {
        let c = f64::from(k * 7 % 20) * 18.0;
        let (s, co) = (sense * c).to_radians().sin_cos();
        for p in 0..60 {
            let (sin, cos) = (f64::from(p) * 6.0_f64).to_radians().sin_cos();
            let r = 3.0 + 0.0008 * normal();
            let at = [0.015 + off_mm * co + r * cos, -0.01 + off_mm * s + r * sin];
            let (u, v) = (at[0] / 0.008 + 800.0, -at[1] / 0.008 + 600.0);
            writeln!(csv, "{k},412.31,-87.6,{c},{u:.4},{v:.4}").unwrap();
        }
    }
    csv
}

#[test]
fn a_rod_turned_under_the_camera_is_no_unknown_and_tells_which_way_it_turns() {
    let calib = Some(("--calib", "schema = 1\nname = \"plain\"\n[scale]\nmm_per_px = 0.008\n"));
    let (report, words) = diagnose("rod", &turned(0.0, 1.0), calib, &[]);
    assert_eq!(report["verdict"], "consistent", "{}", report["unnamed"]);
    assert!(!words.contains("against C"), "{words}");
    let (report, words) = diagnose("rod", &turned(0.05, 1.0), calib, &[]);
    assert_eq!(report["effects"][0]["name"], "rod-eccentricity", "{}", report["unnamed"]);
    assert!(!words.contains("against C"), "{words}");
    let (_, words) = diagnose("rod", &turned(0.05, -1.0), calib, &[]);
    assert!(words.contains("goes round against C"), "{words}");
}

#[test]
fn a_slipped_reading_chooses_no_baseline_for_a_screw() {
    for slipped in [12, 33, 54, 75, 96] {
        let mut normal = normal(slipped);
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
        for k in 0..108_u64 {
            let (warm, position) = (f64::from((k / 9) as u32), 100.0 * f64::from((k % 9) as u32));
            let (rise, head) = (0.9 * warm, 6.0 * (1.0 - (-warm / 4.0).exp()));
            let error = 1.1e-5 * rise * (position - 120.0) + 0.002 * head + 0.001 * normal();
            let error = error + if k == slipped { 0.05 } else { 0.0 };
            writeln!(csv, "{},x,{position},{error:.6},{:.3},{head:.3}", 60 * k, 20.0 + rise)
                .unwrap();
        }
        let (report, _) = diagnose("thermal", &csv, None, &[]);
        assert_eq!(report["verdict"], "consistent", "{slipped}: {}", report["effects"]);
        assert_eq!(report["outliers"].as_array().unwrap().len(), 1, "{}", report["outliers"]);
    }
}

/// A zero of B that would have to be off by degrees is no other name for a length, and makes no length unsure by millimetres.
#[test]
fn two_wrong_lengths_have_the_intervals_that_the_noise_gives_them() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let effects = "[[effects]]\nname = \"pivot-length\"\nparameters = { r_mm = 0.15 }\n\
                   [[effects]]\nname = \"pivot-offset-x\"\nparameters = { delta_x_mm = -0.07 }\n";
    std::fs::write(file("truth.toml"), format!("{MACHINE}{effects}")).unwrap();
    let mut plan = String::from("b_deg,c_deg\n");
    for k in 0..40 {
        writeln!(plan, "{},{}", f64::from(k % 8) * 22.3 - 78.0, f64::from(k / 8) * 71.0).unwrap();
    }
    std::fs::write(file("plan.csv"), plan).unwrap();
    let path = |name: &str| -> String { file(name).to_str().unwrap().into() };
    let [truth, plan, data] = ["truth.toml", "plan.csv", "data.csv"].map(path);
    let simulated = assert_cmd::Command::cargo_bin("pivotsight")
        .unwrap()
        .args(["simulate", "rtcp", "--model", &truth, "--data", &plan, "--noise-mm", "0.001"])
        .args(["--seed", "5", "--format", "csv", "--out", &data])
        .output()
        .unwrap();
    assert!(simulated.status.success(), "{}", String::from_utf8_lossy(&simulated.stderr));
    let csv = std::fs::read_to_string(Path::new(&data)).unwrap();
    let given = ["--noise-mm", "0.001"];
    let (report, _) = diagnose("rtcp", &csv, Some(("--model", MACHINE)), &given);
    for (name, size, key) in
        [("pivot-length", 0.15, "r_mm"), ("pivot-offset-x", -0.07, "delta_x_mm")]
    {
        let effects = report["effects"].as_array().unwrap();
        let effect = effects.iter().find(|e| e["name"] == name).unwrap();
        let value = effect["parameters"][key].as_f64().unwrap();
        let u95 = effect["parameters_u95"][key].as_f64().unwrap();
        assert!((value - size).abs() < 1.5 * u95 && u95 < 0.002, "{name} {value} ± {u95}");
    }
    // A noise that nothing measures is no noise.
    let (_, code, words) = json::run(&[
        "diagnose",
        "rtcp",
        "--model",
        &truth,
        "--data",
        &data,
        "--noise-mm",
        "1e-170",
    ]);
    assert!(code == Some(2) && words.contains("--noise-mm"), "{words}");
}

/// A B that counts the other way, as `solve` writes it, has the same lengths. The chain of axes, which knows no effects, predicts the data.
#[test]
fn a_b_that_counts_the_other_way_has_the_same_names() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| -> String {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().into()
    };
    let turned = format!("{MACHINE}[axes.B]\nsense = -1\n");
    let held = write("held.toml", &turned);
    let real = turned.replace("-1.3", "-1.25").replace("301.1", "301.0");
    let real = write("real.toml", &real);
    let mut plan = String::from("b_deg,c_deg\n");
    for k in 0..56 {
        writeln!(plan, "{},{}", f64::from(k % 8) * 22.3 - 78.0, f64::from(k / 8) * 51.0).unwrap();
    }
    let plan = write("plan.csv", &plan);
    let data = write("data.csv", "");
    let simulated = assert_cmd::Command::cargo_bin("pivotsight")
        .unwrap()
        .args(["simulate", "rtcp", "--model", &real, "--now", &held, "--data", &plan])
        .args(["--noise-mm", "0.001", "--seed", "5", "--format", "csv", "--out", &data])
        .output()
        .unwrap();
    assert!(simulated.status.success(), "{}", String::from_utf8_lossy(&simulated.stderr));
    let csv = std::fs::read_to_string(&data).unwrap();
    let (report, _) = diagnose("rtcp", &csv, Some(("--model", &turned)), &[]);
    assert_eq!(report["verdict"], "named", "{}", report["unnamed"]);
    let effects = report["effects"].as_array().unwrap();
    let length = effects.iter().find(|e| e["name"] == "pivot-length").unwrap();
    let value = length["parameters"]["r_mm"].as_f64().unwrap();
    let u95 = length["parameters_u95"]["r_mm"].as_f64().unwrap();
    assert!((value + 0.1).abs() < 1.5 * u95 && u95 < 0.002, "{value} ± {u95}");
    // A zero of B is the same to the data.
    let told = effects.iter().any(|e| e.to_string().contains("pivot-offset-x"));
    assert!(told && effects.len() == 2, "{effects:?}");
}

fn run(arguments: &[&str]) {
    let output = assert_cmd::Command::cargo_bin("pivotsight").unwrap().args(arguments).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Sizes of one form add up, exponents do not: the written model predicts what was measured.
#[test]
fn an_effect_of_the_model_is_corrected_by_what_is_found_beside_it() {
    let lens = |x_mm: f64| {
        format!(
            "{BAR}[[effects]]\nname = \"thermal-lens\"\nparameters = {{ exponent = 2.0, x_mm_at_kw = {x_mm} }}\n"
        )
    };
    let mut plan = String::from("height_mm,power_w,b_deg,dx_mm,dy_mm\n");
    for k in 0..80 {
        let (height, power) = ([20.0, 50.0, 90.0][k % 3], 500 * (1 + k * 3 % 8));
        writeln!(plan, "{height},{power},{},0,0", 15 * (k as i32 * 5 % 13) - 90).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> String { folder.path().join(name).to_str().unwrap().into() };
    let [real, data, found] = ["real.toml", "data.csv", "found.toml"].map(path);
    std::fs::write(&real, lens(0.005)).unwrap();
    std::fs::write(&data, plan).unwrap();
    let noise = ["--noise-mm", "0.0005", "--format", "csv", "--out", &found];
    run(&[&["simulate", "burn", "--model", &real, "--data", &data][..], &noise].concat());
    let csv = std::fs::read_to_string(&found).unwrap();
    let (report, _) =
        diagnose("burn", &csv, Some(("--model", &lens(0.003))), &["--write-model", &found]);
    assert_eq!(report["effects"][0]["name"], "thermal-lens", "{report}");
    let written = std::fs::read_to_string(&found).unwrap();
    assert_eq!(written.matches("thermal-lens").count(), 2, "{written}");
    let (report, _) = diagnose("burn", &csv, Some(("--model", &written)), &[]);
    assert_eq!(report["verdict"], "consistent", "{}", report["effects"]);
}

/// A screw's error is seldom a pure wave: its second is its own, and a second run on the written model finds nothing.
#[test]
fn a_screw_with_a_second_wave_is_named_once() {
    let machine = "schema = 1\n[head]\ndelta_x_mm = 0.0\nr_mm = 400.0\n";
    let cycle = |amplitude_mm: f64, pitch_mm: f64| {
        format!(
            "[[effects]]\nname = \"cyclic-z\"\nparameters = {{ cos_mm = 0.0, sin_mm = {amplitude_mm}, pitch_mm = {pitch_mm} }}\n"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> String { folder.path().join(name).to_str().unwrap().into() };
    let [real, plan, data, found] = ["real.toml", "plan.csv", "data.csv", "found.toml"].map(path);
    std::fs::write(&real, format!("{machine}{}{}", cycle(0.001, 10.0), cycle(0.0003, 5.0)))
        .unwrap();
    run(&["ballbar", "plan", "--steps", "300", "--format", "csv", "--out", &plan]);
    let noise = ["--noise-mm", "0.0005", "--seed", "3", "--format", "csv", "--out", &data];
    run(&[&["simulate", "ballbar", "--model", &real, "--data", &plan][..], &noise].concat());
    let csv = std::fs::read_to_string(&data).unwrap();
    let (report, _) =
        diagnose("ballbar", &csv, Some(("--model", machine)), &["--write-model", &found]);
    let effects = report["effects"].as_array().unwrap();
    assert_eq!((effects.len(), &effects[0]["name"]), (1, &"cyclic-z".into()), "{report}");
    let parameters = &effects[0]["parameters"];
    let second =
        parameters["cos2_mm"].as_f64().unwrap().hypot(parameters["sin2_mm"].as_f64().unwrap());
    assert!((second - 0.0003).abs() < 0.00015, "{parameters}");
    let written = std::fs::read_to_string(&found).unwrap();
    let (report, _) = diagnose("ballbar", &csv, Some(("--model", &written)), &[]);
    assert_eq!(report["verdict"], "consistent", "{}", report["effects"]);
}

const BAR: &str = "schema = 1\n[head]\ndelta_x_mm = 0.0\nr_mm = 400.0\n";

/// A slipped reading among few burns is no bump at its place, and no step of the last one.
#[test]
fn a_shape_does_not_stand_on_one_reading() {
    let mut normal = normal(1);
    for slipped in [0, 11, 23] {
        let mut csv = String::from("height_mm,power_w,b_deg,t_s,dx_mm,dy_mm\n");
        for k in 0..24 {
            let (height, b) = ([20.0, 35.0, 47.0][k % 3], 15.0 * (k * 5 % 24) as f64 - 90.0);
            let [dx, mut dy] = [0.001 * normal(), 0.001 * normal()];
            if k == slipped {
                dy += 0.06;
            }
            let (power, t) = (100 + 50 * (k % 4), 90 * k);
            writeln!(csv, "{height},{power},{b},{t},{dx:.6},{dy:.6}").unwrap();
        }
        let (report, _) = diagnose("burn", &csv, Some(("--model", BAR)), &[]);
        assert_eq!(report["verdict"], "consistent", "{slipped}: {}", report["unnamed"]);
        assert_eq!(report["outliers"].as_array().unwrap().len(), 1, "{slipped}");
    }
}

/// On the way back a ball bar repeats the way there: what both show at each place is no noise, and no name for being seen twice.
#[test]
fn the_way_back_repeats_the_way_there() {
    let (there, _, _) = json::run(&["ballbar", "simulate", "--path", "zb,xb", "--steps", "60"]);
    let rows = there["rows"].as_array().unwrap();
    let mut normal = normal(2);
    let left: Vec<f64> = rows.iter().map(|_| 0.006 * normal()).collect();
    let mut csv = String::from("path,b_deg,x_mm,z_mm,dir,length_mm\n");
    for dir in [1, -1] {
        for (row, left) in rows.iter().zip(&left) {
            let length = row["length_mm"].as_f64().unwrap() + left + 0.001 * normal();
            let path = row["path"].as_str().unwrap();
            let [b, x, z] = ["b_deg", "x_mm", "z_mm"].map(|key| &row[key]);
            writeln!(csv, "{path},{b},{x},{z},{dir},{length:.6}").unwrap();
        }
    }
    let (report, _) = diagnose("ballbar", &csv, Some(("--model", BAR)), &[]);
    assert_eq!(report["verdict"], "unknown", "{}", report["effects"]);
}

/// 40 captures of 12 points of a rim: by how much each capture's place and each point's radius are off, mm.
fn rims(slipped_mm: impl Fn(i32) -> f64, dirt_mm: impl Fn(i32, i32) -> f64) -> String {
    let mut normal = normal(21);
    let mut csv = String::from("capture,x_mm,y_mm,c_deg,t_s,u_px,v_px\n");
    for k in 0..40_i32 {
        let place = [k * 7 % 40, k * 11 % 40].map(|n| f64::from(n) * 0.05 - 1.0);
        let off = [0, 1].map(|_| slipped_mm(k) + 0.0004 * normal());
        for p in 0..12 {
            let (sin, cos) = f64::from(p * 30).to_radians().sin_cos();
            let r = 2.0 + 0.0005 * normal() + dirt_mm(k, p);
            let at = [r * cos - place[0] + off[0], r * sin - place[1] + off[1]];
            let (u, v) = (at[0] / 0.008 + 800.0, -at[1] / 0.008 + 600.0);
            let c = k * 13 % 40 * 9;
            writeln!(csv, "{k},{:.4},{:.4},{c},{},{u:.4},{v:.4}", place[0], place[1], 30 * k)
                .unwrap();
        }
    }
    csv
}

const RIMS_CALIB: (&str, &str) = ("--calib", "schema = 1\n[scale]\nmm_per_px = 0.008\n");

/// Dirt on the rim at one point of four captures: those points are set aside, and no more.
#[test]
fn a_point_that_lies_apart_costs_no_capture() {
    let dirty = [(3, 5), (11, 0), (24, 7), (38, 10)];
    let csv = rims(|_| 0.0, |k, p| if dirty.contains(&(k, p)) { 0.02 } else { 0.0 });
    let (report, _) = diagnose("rod", &csv, Some(RIMS_CALIB), &[]);
    assert_eq!(report["verdict"], "consistent", "{}{}", report["effects"], report["unnamed"]);
    let rows = dirty.map(|(k, p)| serde_json::json!({"row": 12 * k + p + 1, "column": null}));
    assert_eq!(report["outliers"], serde_json::json!(rows));
}

/// A machine that did not stand where the table says for one of 40 captures: the capture is set aside as a whole, and nothing is said of the rest.
#[test]
fn a_capture_that_lies_apart_as_a_whole_is_no_effect() {
    let csv = rims(|k| if k == 17 { 0.012 } else { 0.0 }, |_, _| 0.0);
    let (report, words) = diagnose("rod", &csv, Some(RIMS_CALIB), &[]);
    assert_eq!(report["verdict"], "consistent", "{}{}", report["effects"], report["unnamed"]);
    let gone: Vec<_> =
        (205..217).map(|row| serde_json::json!({"row": row, "column": null})).collect();
    assert_eq!(report["outliers"], serde_json::json!(gone));
    assert!(words.contains("begin at row 205"), "{words}");
}

/// Where no cup lies in the plane of motion its distance from that and the bar's length are one: effects are seen all the same.
#[test]
fn a_ball_bar_beside_the_plane_shows_what_is_wrong() {
    let mut normal = normal(5);
    let machine = "schema = 1\n[head]\ndelta_x_mm = 0.0\nr_mm = 400.0\n";
    let mut csv = String::from("b_deg,length_mm,z_mm,path,dir\n");
    for turn in 0..4 {
        for i in 0..=60 {
            let (way, b) =
                if turn % 2 == 0 { (-1.0, -f64::from(i)) } else { (1.0, f64::from(i) - 60.0) };
            let b_rad = b.to_radians();
            // Z keeps the bar's length: the tool goes round a cup 400 mm below and 150 mm beside.
            let z = 800.0 * (b_rad.cos() - 1.0);
            let real = b_rad - way * 0.0015_f64.to_radians();
            let tool = [-400.0 * real.sin(), -400.0 * real.cos() + z];
            let length = tool[0].hypot(tool[1] + 800.0).hypot(150.0);
            writeln!(csv, "{b},{:.6},{z:.6},zb-y150,{way}", length + 0.001 * normal()).unwrap();
        }
    }
    let (report, _) = diagnose("ballbar", &csv, Some(("--model", machine)), &[]);
    let effect = &report["effects"][0];
    let rivals = effect["confusable_with"].as_array().into_iter().flatten();
    let names: Vec<&Value> = rivals.chain([&effect["name"]]).collect();
    assert!(names.iter().any(|name| **name == "b-backlash"), "{report:#}");
}

/// A table of captures, before there is a picture: it says what the edge points that it would give say, and a capture beside the rim is named.
#[test]
fn captures_that_are_only_planned_say_what_they_will_show() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut plan = String::from("image,x_mm,y_mm,c_deg\n");
    for k in 0..24 {
        let (sin, cos) = f64::from(k * 75).to_radians().sin_cos();
        let (x, y) = (412.31 + 10.0 * cos, -87.6 + 10.0 * sin);
        writeln!(plan, "{k}.png,{x:.3},{y:.3},{}", k * 83 % 360).unwrap();
    }
    std::fs::write(path("plan.csv"), &plan).unwrap();
    std::fs::write(path("beside.csv"), plan.clone() + "24.png,412.31,-87.6,0\n").unwrap();
    let [model, calib] = ["machine", "bench-camera"]
        .map(|name| format!("{}/calib/{name}.toml", env!("CARGO_MANIFEST_DIR")));
    let run = |command: &[&str], data: &str, more: &[&str]| {
        let files = ["--data", &path(data), "--model", &model, "--calib", &calib];
        json::run(&[command, &files, more].concat())
    };
    let plan_only = ["--plan-only", "--noise-mm", "0.001"];
    let planned = [&plan_only[..], &["--diameter-mm", "20"]].concat();
    let (planned_says, code, words) = run(&["diagnose", "rod"], "plan.csv", &planned);
    assert_eq!(code, Some(0), "{words}");

    let (simulated, _, words) = run(&["simulate", "rod"], "plan.csv", &["--diameter-mm", "20"]);
    let mut points = String::from("capture,x_mm,y_mm,c_deg,u_px,v_px\n");
    let rows = simulated["rows"].as_array().expect(&words);
    assert!(rows.len() > 24 * 12, "{} points", rows.len());
    for row in rows {
        let cell = |name: &str| row[name].to_string().replace('"', "");
        let cells = ["capture", "x_mm", "y_mm", "c_deg", "u_px", "v_px"].map(cell);
        writeln!(points, "{}", cells.join(",")).unwrap();
    }
    std::fs::write(path("points.csv"), points).unwrap();
    let (points_say, ..) = run(&["diagnose", "rod"], "points.csv", &plan_only);
    assert_eq!(names_and_reasons(&planned_says), names_and_reasons(&points_say));

    let (_, code, words) = run(&["diagnose", "rod"], "beside.csv", &planned);
    assert_eq!(code, Some(2));
    assert!(words.contains("beside.csv:26") && words.contains("does not see the rim"), "{words}");
    let (_, code, words) = run(&["diagnose", "rod"], "plan.csv", &plan_only);
    assert!(code == Some(2) && words.contains("--diameter-mm: is missing"), "{words}");
}

/// Which effects a plan can show, what they look like and why others cannot be tested.
fn names_and_reasons(planned: &Value) -> Vec<(&Value, &Value, &Value)> {
    let list = planned["detectable"].as_array().unwrap();
    list.iter().map(|d| (&d["name"], &d["untestable"], &d["aliases"])).collect()
}
