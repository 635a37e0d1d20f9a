//! Diagnosis from files: simulate, hide, diagnose, correct the model, simulate again; and what bad input is told.

use std::fmt::Write as _;
use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

const MACHINE: &str = "schema = 1\n[head]\ndelta_x_mm = 0.283\nr_mm = 214.7\n[target]\nposition_mm = [80.0, 0.0, 100.0]\n";

fn run(arguments: &[&str], folder: &Path) -> std::process::Output {
    let mut command = Command::cargo_bin("pivotsight").unwrap();
    command.current_dir(folder).args(arguments).output().unwrap()
}

fn json(arguments: &[&str], folder: &Path) -> Value {
    let output = run(arguments, folder);
    let problem = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{problem}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A sweep in scrambled order with both directions.
fn plan(folder: &Path) {
    let mut csv = String::from("b_deg,c_deg,dir_b,dir_c,t_s,temp_c\n");
    for k in 0..156 {
        let i = k * 61 % 156;
        let (b, c) = ((i / 12) as f64 * 15.0 - 90.0, (i % 12) as f64 * 31.0 + (i % 5) as f64);
        let side = |n: usize| if (k * n / 7).is_multiple_of(2) { 1 } else { -1 };
        let (t, temp) = (25.0 * k as f64, 20.0 + 4.0 * (1.0 - (-(k as f64) / 70.0).exp()));
        writeln!(csv, "{b},{c},{},{},{t},{temp:.3}", side(3), side(5)).unwrap();
    }
    std::fs::write(folder.join("plan.csv"), csv).unwrap();
    std::fs::write(folder.join("machine.toml"), MACHINE).unwrap();
}

fn simulate(effects: &str, more: &[&str], folder: &Path) {
    std::fs::write(folder.join("truth.toml"), format!("{MACHINE}{effects}")).unwrap();
    let arguments = [
        "simulate",
        "rtcp",
        "--model",
        "truth.toml",
        "--data",
        "plan.csv",
        "--noise-mm",
        "0.002",
        "--format",
        "csv",
        "--out",
        "data.csv",
    ];
    let output = run(&[&arguments[..], more].concat(), folder);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

const DIAGNOSE: [&str; 8] =
    ["diagnose", "rtcp", "--model", "machine.toml", "--data", "data.csv", "--format", "json"];

#[test]
fn two_effects_are_named_and_the_corrected_model_is_consistent() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    plan(folder);
    simulate(
        "[[effects]]\nname = \"b-backlash\"\nparameters = { width_deg = 0.0042 }\n\
         [[effects]]\nname = \"c-axis-tilt-x\"\nparameters = { tilt_deg = 0.006 }\n",
        &[],
        folder,
    );
    let arguments = [&DIAGNOSE[..], &["--write-model", "found.toml", "--report", "page"]].concat();
    let report = json(&arguments, folder);
    assert_eq!(report["schema"], "pivotsight.diagnose/1");
    assert_eq!(report["verdict"], "named");
    let effects = report["effects"].as_array().unwrap();
    assert_eq!(effects.len(), 2, "{effects:?}");
    let backlash = effects.iter().find(|e| e["name"] == "b-backlash").unwrap();
    let width = backlash["parameters"]["width_deg"].as_f64().unwrap();
    let u95 = backlash["parameters_u95"]["width_deg"].as_f64().unwrap();
    assert!((width - 0.0042).abs() < 1.6 * u95 && u95 < 4e-4, "{width} ± {u95}");
    let gap = |key: &str| report["gap"][key].as_f64().unwrap();
    assert!(gap("heldout_after_rms_mm") < 0.5 * gap("heldout_before_rms_mm"));
    assert!((gap("heldout_after_rms_mm") / gap("noise_rms_mm") - 1.0).abs() < 0.02);
    let page = std::fs::read_to_string(folder.join("page/index.html")).unwrap();
    assert!(page.contains("b-backlash") && page.contains("<svg"));
    let mut again = DIAGNOSE;
    again[3] = "found.toml";
    assert_eq!(json(&again, folder)["verdict"], "consistent");
}

#[test]
fn nothing_hidden_is_consistent() {
    let folder = tempfile::tempdir().unwrap();
    plan(folder.path());
    simulate("", &[], folder.path());
    let report = json(&DIAGNOSE, folder.path());
    assert_eq!(report["verdict"], "consistent");
    assert_eq!(report["effects"].as_array().unwrap().len(), 0);
    assert!((report["noise_mm"].as_f64().unwrap() / 0.002 - 1.0).abs() < 0.1);
}

#[test]
fn a_shape_outside_the_library_gets_no_name_but_a_place_in_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    plan(folder);
    simulate("", &[], folder);
    let text = std::fs::read_to_string(folder.join("data.csv")).unwrap();
    let mut lines = text.lines();
    let mut csv = format!("{}\n", lines.next().unwrap());
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let c: f64 = cells[1].parse().unwrap();
        let dz: f64 = cells[8].parse().unwrap();
        cells[8] = (dz + 0.004 * (6.0 * c.to_radians()).sin()).to_string();
        writeln!(csv, "{}", cells.join(",")).unwrap();
    }
    std::fs::write(folder.join("data.csv"), csv).unwrap();
    let arguments = [&DIAGNOSE[..], &["--write-model", "found.toml"]].concat();
    let report = json(&arguments, folder);
    assert_eq!(report["verdict"], "unknown");
    let unnamed = &report["unnamed"][0];
    assert_eq!(unnamed["output"], "dz_mm");
    assert_eq!(unnamed["versus"], "c_deg");
    let amplitude = unnamed["amplitude_mm"].as_f64().unwrap();
    assert!((amplitude - 0.004).abs() < unnamed["amplitude_u95_mm"].as_f64().unwrap());
    // The model predicts the shape all the same, in every command.
    let mut again = DIAGNOSE;
    again[3] = "found.toml";
    assert_eq!(json(&again, folder)["verdict"], "consistent");
    let noise = ["--noise-mm", "0.002", "--format", "json"];
    let verify =
        ["verify", "--machine", "found.toml", "--now", "machine.toml", "--data", "data.csv"];
    let compared = json(&[&verify[..], &noise[..]].concat(), folder);
    assert!(compared["after"]["worst_mm"].as_f64().unwrap() < 0.009, "{}", compared["after"]);
}

#[test]
fn bad_input_is_told_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    plan(folder);
    let few = "b_deg,c_deg,dx_mm,dy_mm,dz_mm\n0,0,0.1,0,0\n10,0,0,0.1,0\n";
    let radians: String = (0..40)
        .map(|k| {
            format!(
                "{:.4},{:.4},{},0.001,0.002\n",
                0.07 * k as f64 - 1.4,
                0.15 * k as f64,
                1e-3 * (k % 3) as f64
            )
        })
        .collect();
    for (name, text, code, words) in [
        ("few.csv", few.to_owned(), 2, "too few"),
        ("nan.csv", few.replace("0.1", "NaN"), 2, "not finite"),
        ("column.csv", few.replace("dx_mm", "dx_um"), 2, "dx_um"),
        ("way.csv", "b_deg,c_deg,dir_b\n0,0,3\n".to_owned(), 2, "direction"),
        ("radians.csv", format!("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n{radians}"), 0, "radians"),
    ] {
        std::fs::write(folder.join(name), text).unwrap();
        let output = run(&["diagnose", "rtcp", "--model", "machine.toml", "--data", name], folder);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{name}: {said}");
        assert!(said.contains(words), "{name}: {said}");
    }
    let output =
        run(&["diagnose", "rtcp", "--model", "machine.toml", "--data", "plan.csv"], folder);
    assert!(String::from_utf8_lossy(&output.stderr).contains("--plan-only"));
    let plan = [
        "diagnose",
        "rtcp",
        "--model",
        "machine.toml",
        "--data",
        "plan.csv",
        "--plan-only",
        "--noise-mm",
        "0.002",
        "--format",
        "json",
    ];
    assert_eq!(json(&plan, folder)["detectable"].as_array().unwrap().len(), 24);
}

#[test]
fn lengths_in_metres_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("machine.toml"), MACHINE).unwrap();
    let mut ballbar = String::from("b_deg,length_mm\n");
    let mut thermal = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
    for k in 0..60 {
        let noise = 1e-3 * f64::from(k * 7 % 13 - 6);
        writeln!(ballbar, "{},{:.7}", -k, 0.4 + 1e-3 * noise).unwrap();
        let (place, warm) = (0.1 * f64::from(k % 6), 20.0 + 0.1 * f64::from(k));
        writeln!(thermal, "{},x,{place},{noise},{warm},{}", 60 * k, warm - 20.0).unwrap();
    }
    for (kind, data, column) in
        [("ballbar", ballbar, "length_mm"), ("thermal", thermal, "position_mm")]
    {
        std::fs::write(folder.join("data.csv"), data).unwrap();
        let output =
            run(&["diagnose", kind, "--model", "machine.toml", "--data", "data.csv"], folder);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let told = |line: &str| line.contains(column) && line.contains("metres");
        assert!(said.lines().any(told), "{kind}: {said}");
    }
}

const HOSE: &str = r#"
schema = 1
[[effects]]
name = "hose-drag"
kind = "rtcp"
meaning = "the cooling hose pulls the head sideways, more as B swings over zero"
best = "B from -90 to +90 at one C"
[effects.parameters]
pull_mm = { typical = 0.01 }
[effects.outputs]
dy_mm = "pull_mm * tanh(b_deg / 20)"
dz_mm = "0.5 * pull_mm * abs(sin(b_deg * PI / 180))"
"#;

#[test]
fn an_effect_of_the_users_own_is_named_written_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    plan(folder);
    std::fs::write(folder.join("own.toml"), HOSE).unwrap();
    let truth = "[[effects]]\nname = \"hose-drag\"\nparameters = { pull_mm = 0.006 }\n";
    simulate(truth, &["--effects", "own.toml"], folder);
    let alone = json(&DIAGNOSE, folder);
    let known = |e: &Value| e["name"] == "hose-drag";
    assert!(!alone["effects"].as_array().unwrap().iter().any(known));

    let with = [&DIAGNOSE[..], &["--effects", "own.toml", "--write-model", "found.toml"]].concat();
    let report = json(&with, folder);
    assert_eq!(report["verdict"], "named");
    assert_eq!(report["effects"].as_array().unwrap().len(), 1, "{}", report["effects"]);
    let effect = &report["effects"][0];
    assert_eq!(effect["name"], "hose-drag");
    let value = effect["parameters"]["pull_mm"].as_f64().unwrap();
    let u95 = effect["parameters_u95"]["pull_mm"].as_f64().unwrap();
    assert!((value - 0.006).abs() < 1.6 * u95 && u95 < 6e-4, "{value} ± {u95}");
    let model = std::fs::read_to_string(folder.join("found.toml")).unwrap();
    assert!(model.contains("hose-drag") && model.contains("parameters_u95"), "{model}");

    let mut again = DIAGNOSE.to_vec();
    again[3] = "found.toml";
    again.extend(["--effects", "own.toml"]);
    assert_eq!(json(&again, folder)["verdict"], "consistent");
    // The formulas went into the model with it: whoever reads that needs no other file.
    again.truncate(8);
    assert_eq!(json(&again, folder)["verdict"], "consistent");
    let verify = ["verify", "--machine", "found.toml", "--now", "found.toml", "--data", "data.csv"];
    assert!(run(&verify, folder).status.success());
}

/// What an effect adds to a row does not hang on the other rows: a column that never changes cannot test it, but predicts it.
#[test]
fn effects_are_predicted_where_their_column_never_changes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let truth = "[[effects]]\nname = \"c-axis-tilt-x\"\nparameters = { tilt_deg = 0.05 }\n";
    std::fs::write(folder.join("truth.toml"), format!("{MACHINE}{truth}")).unwrap();
    let first = |poses: &str| -> Value {
        std::fs::write(folder.join("poses.csv"), format!("b_deg,c_deg\n{poses}")).unwrap();
        let simulate = ["simulate", "rtcp", "--model", "truth.toml", "--data", "poses.csv"];
        json(&[&simulate[..], &["--format", "json"]].concat(), folder)["rows"][0].clone()
    };
    let alone = first("0,90\n30,90\n");
    assert!(alone["dz_mm"].as_f64().unwrap().abs() > 0.05, "{alone}");
    assert_eq!(alone, first("0,90\n30,90\n0,0\n"));
}

/// Numbers of the control that named effects correct are told, and are in what is exported.
#[test]
fn what_a_named_effect_makes_of_the_controls_numbers_is_told_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    plan(folder);
    simulate("[[effects]]\nname = \"pivot-length\"\nparameters = { r_mm = 0.12 }\n", &[], folder);
    let report = json(&[&DIAGNOSE[..], &["--write-model", "found.toml"]].concat(), folder);
    let told = &report["in_the_control"][0];
    assert_eq!((&told["key"], &told["effect"]), (&"head.r_mm".into(), &"pivot-length".into()));
    let (new, u95) = (told["new_mm"].as_f64().unwrap(), told["u95_mm"].as_f64().unwrap());
    assert!((new - 214.82).abs() < 1.6 * u95 && u95 < 0.01, "{told}");
    let export =
        ["export", "--machine", "found.toml", "--control", "sheet", "--write-machine", "new.toml"];
    let output = run(&export, folder);
    assert!(String::from_utf8_lossy(&output.stdout).contains(&format!("{new:.4} mm")));
    // The machine with those numbers is the machine with that effect.
    let verify = ["verify", "--machine", "new.toml", "--now", "machine.toml", "--data", "data.csv"];
    assert!(run(&verify, folder).status.success());
}

#[test]
fn a_bad_effects_file_is_told_where() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    plan(folder);
    simulate("", &[], folder);
    for (from, to, words) in [
        ("tanh(b_deg / 20)", "tanh(b_deg / 20", "outputs.dy_mm"),
        (
            "tanh(b_deg / 20)",
            "tanh(beta / 20)",
            "'beta' is neither a parameter nor one of the columns",
        ),
        ("tanh(b_deg / 20)", "ln(b_deg)", "gives no number"),
        ("dz_mm =", "length_mm =", "is not an output; there are dx_mm, dy_mm, dz_mm"),
        ("typical = 0.01", "typical = 0.0", "parameters.pull_mm"),
        ("hose-drag", "b-zero", "is a name of the library"),
        ("kind = \"rtcp\"", "kind = \"laser\"", "write rtcp, rod"),
        ("best =", "bset =", "bset"),
    ] {
        std::fs::write(folder.join("own.toml"), HOSE.replace(from, to)).unwrap();
        let output = run(&[&DIAGNOSE[..], &["--effects", "own.toml"]].concat(), folder);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words}: {said}");
        assert!(said.contains("own.toml") && said.contains(words), "{words}: {said}");
    }
    let order = "[kinematics]\norder = \"w b X Y Z C B t\"\n";
    std::fs::write(folder.join("machine.toml"), format!("{MACHINE}{order}")).unwrap();
    let said = String::from_utf8_lossy(&run(&DIAGNOSE, folder).stderr).into_owned();
    assert!(said.contains("B in the head and C in the table"), "{said}");
}

/// Burn tests have no baseline to fit: the model may be empty.
/// At one height and power an offset may be a tilt, the optics or the camera as well: nothing is named alone, and what parts them is listed.
#[test]
fn burns_of_one_height_name_a_class_and_what_would_part_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut csv = String::from("height_mm,power_w,b_deg,dx_mm,dy_mm\n");
    for k in 0..12 {
        let noise = |m: u32| 0.0005 * (f64::from(k * m % 13) - 6.0);
        writeln!(csv, "47,100,0,{:.4},{:.4}", 0.024 + noise(3), noise(5)).unwrap();
    }
    std::fs::write(folder.join("data.csv"), csv).unwrap();
    let diagnose = ["diagnose", "burn", "--data", "data.csv", "--format", "json"];
    let report = json(&[&diagnose[..], &["--write-next", "next.csv"]].concat(), folder);
    let effect = &report["effects"][0];
    let mut class: Vec<&str> =
        effect["confusable_with"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    class.push(effect["name"].as_str().unwrap());
    for name in ["beam-tilt-x", "nozzle-offset", "thermal-lens", "camera-tilt"] {
        assert!(class.contains(&name), "{class:?}");
    }
    let next = std::fs::read_to_string(folder.join("next.csv")).unwrap();
    let heights: Vec<&str> = next.lines().skip(1).map(|l| l.split(',').nth(1).unwrap()).collect();
    assert!(next.starts_with("b_deg,height_mm,power_w\n"), "{next}");
    assert!(heights.iter().any(|h| h.parse::<f64>().unwrap() < 40.0), "{next}");
}

#[test]
fn burns_with_nothing_wrong_are_consistent() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut csv = String::from("height_mm,power_w,b_deg,t_s,dx_mm,dy_mm\n");
    for k in 0..60 {
        let wave = |f: f64| 0.002 * ((k * k) as f64 * f).sin();
        let (height, b) = (10 * (1 + k % 5), 30 * (k * 7 % 7) - 90);
        writeln!(csv, "{height},{},{b},{},{},{}", 100 * (1 + k % 3), 40 * k, wave(1.7), wave(2.3))
            .unwrap();
    }
    std::fs::write(folder.join("burn.csv"), csv).unwrap();
    let report = json(&["diagnose", "burn", "--data", "burn.csv", "--format", "json"], folder);
    assert_eq!(report["verdict"], "consistent", "{report}");
}

/// Captures of short arcs of a large rod with tool marks: the marks turn with the rod, Y lags behind by half of 8 µm.
#[test]
fn short_arcs_of_a_rod_with_tool_marks_name_the_backlash() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = 12_345_u64;
    let mut uniform = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let mut gauss = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    let marks: Vec<f64> = (0..180).map(|_| 0.0006 * gauss()).collect();
    let mark = |degrees: f64| {
        let at = degrees.rem_euclid(360.0) / 2.0;
        let (i, f) = (at as usize % 180, at.fract());
        marks[i] * (1.0 - f) + marks[(i + 1) % 180] * f
    };
    let mut csv = String::from("capture,x_mm,y_mm,c_deg,t_s,dir_x,dir_y,u_px,v_px\n");
    for k in 0..40_usize {
        let i = k * 17 % 40;
        let (c, around) = ((i % 9) as f64 * 41.0 + (i % 4) as f64, i as f64 * 9.0);
        let side = |n: usize| if (k * n / 7).is_multiple_of(2) { 1.0 } else { -1.0 };
        let (dir_x, dir_y) = (side(3), side(5));
        let at =
            |degrees: f64, r: f64| [r * degrees.to_radians().cos(), r * degrees.to_radians().sin()];
        let [x, y] = at(around, 8.0);
        let shift = [0.0003 * gauss(), -0.004 * dir_y + 0.0003 * gauss()];
        for p in 0..60 {
            let angle = around - 25.0 + f64::from(p) * 50.0 / 59.0;
            let edge = at(angle, 8.0 + mark(angle - c) + 0.0003 * gauss());
            let (u, v) = ((edge[0] - x + shift[0]) / 0.01, -(edge[1] - y + shift[1]) / 0.01);
            writeln!(
                csv,
                "{k},{x:.6},{y:.6},{c},{},{dir_x},{dir_y},{:.5},{:.5}",
                20 * k,
                u + 400.0,
                v + 300.0
            )
            .unwrap();
        }
    }
    std::fs::write(folder.path().join("points.csv"), csv).unwrap();
    std::fs::write(
        folder.path().join("calib.toml"),
        "schema = 1\nname = \"plain\"\n[scale]\nmm_per_px = 0.01\n",
    )
    .unwrap();
    let diagnose = ["diagnose", "rod", "--calib", "calib.toml", "--data", "points.csv"];
    let diagnosed =
        |more: &[&str]| json(&[&diagnose[..], &["--format", "json"], more].concat(), folder.path());
    // Nothing need be known of the head, and nothing is made up in the model that is written.
    let report = diagnosed(&["--write-model", "corrected.toml"]);
    let again = diagnosed(&["--model", "corrected.toml"]);
    assert_eq!(again["verdict"], "consistent", "{again:#}");
    assert_eq!(report["verdict"], "named", "{report:#}");
    let effects = report["effects"].as_array().unwrap();
    assert_eq!(effects.len(), 1, "{effects:#?}");
    assert_eq!(effects[0]["name"], "backlash-y");
    let of = |key: &str| effects[0][key]["width_mm"].as_f64().unwrap();
    let (width, u95) = (of("parameters"), of("parameters_u95"));
    assert!((width.abs() - 0.008).abs() < 1.5 * u95 && u95 < 0.001, "{width} ± {u95}");
}
