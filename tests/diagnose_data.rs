//! Diagnosis of data as others make them: ball bar cups anywhere, slipped readings, zeros of their own.

#[path = "common/diagnose.rs"]
mod common;

use std::fmt::Write as _;
use std::path::Path;

use common::{BAR, answer, class, diagnose, normal, run};
use serde_json::Value;

/// `docs/effects.md` names every effect with its parameters as this build has them; `PIVOTSIGHT_WRITE=1` makes it anew.
#[test]
fn the_page_of_effects_is_this_builds() {
    let page = pivotsight::diagnose::catalogue::markdown().unwrap();
    if std::env::var_os("PIVOTSIGHT_WRITE").is_some() {
        std::fs::write("docs/effects.md", &page).unwrap();
    }
    let written = std::fs::read_to_string("docs/effects.md").unwrap().replace("\r\n", "\n");
    assert!(written == page, "make docs/effects.md anew: the test's header says how");
    for name in pivotsight::diagnose::effects::NAMES {
        assert!(page.contains(&format!("| `{name}` |")), "{name}");
    }
}

/// The source's second path, whose cup lies beside the plane of motion; then the same with names and a zero of Z of one's own.
#[test]
fn ball_bar_cups_are_found_wherever_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("machine.toml"), BAR).unwrap();
    for (errors, expected) in [(None, None), (Some("X0B=0.1"), Some("pivot-offset-x"))] {
        let plan = ["ballbar", "simulate", "--path", "zb,zbk-y150", "--steps", "60"];
        let noise = ["--noise-mm", "0.0008", "--format", "csv", "--out", "data.csv"];
        let hidden = errors.map_or(vec![], |e| vec!["--error", e]);
        assert!(run(&[&plan[..], &noise, &hidden].concat(), folder).status.success());
        let text = std::fs::read_to_string(folder.join("data.csv")).unwrap();
        let mut own = String::from("path,b_deg,z_mm,length_mm\n");
        for line in text.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let z: f64 = cells[3].parse().unwrap();
            let name = if cells[0] == "zb" { "near" } else { "far" };
            writeln!(own, "{name},{},{},{}", cells[1], 612.5 - z, cells[4]).unwrap();
        }
        for csv in [text, own] {
            std::fs::write(folder.join("data.csv"), csv).unwrap();
            let report = diagnose("ballbar", folder);
            match expected {
                None => assert_eq!(report["verdict"], "consistent", "{}", report["gap"]),
                Some(name) => assert!(class(&report).contains(&name), "{}", report["effects"]),
            }
            let untested = report["untested"].as_array().unwrap();
            assert!(!untested.iter().any(|u| u.to_string().contains("squareness-yz")));
        }
    }
}

/// A large tilt shows where the cup's own place cannot stand for it: a narrow valley, whose end the fit must reach.
#[test]
fn a_tilt_nearly_the_cups_own_is_fitted_to_the_noise() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("machine.toml"), BAR.replace("400.0", "200.0")).unwrap();
    let plan = "ballbar simulate --path zb,zb-y150 --pivot-mm 200 --below-mm 200 --from-deg -45 --to-deg 45 --steps 240";
    let errors = "--error A0B=0.48 --noise-mm 0.0004 --format csv --out data.csv";
    let words: Vec<&str> = plan.split(' ').chain(errors.split(' ')).collect();
    assert!(run(&words, folder).status.success());
    let data = ["diagnose", "ballbar", "--model", "machine.toml", "--data", "data.csv"];
    let output = run(&[&data[..], &["--noise-mm", "0.0004", "--format", "json"]].concat(), folder);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["verdict"], "named", "{}", report["unnamed"]);
    assert!(class(&report).contains(&"b-axis-tilt-x"), "{}", report["effects"]);
    let after = report["gap"]["after_rms_mm"].as_f64().unwrap();
    assert!((3.8e-4..4.2e-4).contains(&after), "{}", report["gap"]);
}

/// A bar read on the way: errors that follow one another (correlation 0.6) are no effect, and hide none that is larger.
#[test]
fn a_bars_errors_may_follow_one_another() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("machine.toml"), BAR).unwrap();
    let mut normal = normal();
    for offset in ["X0B=0", "X0B=0", "X0B=0", "X0B=0", "X0B=0.1"] {
        let plan =
            ["ballbar", "simulate", "--path", "zb,zbk-y150", "--steps", "80", "--error", offset];
        let into = ["--format", "csv", "--out", "data.csv"];
        assert!(run(&[&plan[..], &into].concat(), folder).status.success());
        let text = std::fs::read_to_string(folder.join("data.csv")).unwrap();
        let mut lines = text.lines();
        let mut own = format!("{}\n", lines.next().unwrap());
        let mut error = normal();
        for line in lines {
            let (place, length) = line.rsplit_once(',').unwrap();
            let length: f64 = length.parse().unwrap();
            error = 0.6 * error + 0.8 * normal();
            writeln!(own, "{place},{:.6}", length + 0.001 * error).unwrap();
        }
        std::fs::write(folder.join("data.csv"), own).unwrap();
        let report = diagnose("ballbar", folder);
        if offset == "X0B=0" {
            assert_eq!(report["verdict"], "consistent", "{}", report["unnamed"]);
        } else {
            assert_eq!(report["verdict"], "named", "{}", report["unnamed"]);
            assert!(class(&report).contains(&"pivot-offset-x"), "{}", report["effects"]);
        }
        let noise = report["noise_source"].to_string();
        assert!(noise.contains("follow one another"), "{noise}");
    }
}

/// Three readings that slipped by ten standard deviations are set aside and listed: nothing is missing.
#[test]
fn slipped_readings_are_no_effect() {
    let machine = "schema = 1\n[head]\nr_mm = 180.0\n[target]\nposition_mm = [70.0, 10.0, 90.0]\n";
    let mut normal = normal();
    let mut csv = String::from("b_deg,c_deg,t_s,dx_mm,dy_mm,dz_mm\n");
    for k in 0..140 {
        let i = k * 37 % 140;
        let (b, c) = ((i / 10) as f64 * 12.0 - 78.0, (i % 10) as f64 * 36.7);
        let mut d = [0.002 * normal(), 0.002 * normal(), 0.002 * normal()];
        if [17, 63, 101].contains(&k) {
            d[k % 3] += 0.02;
        }
        writeln!(csv, "{b},{c},{},{:.6},{:.6},{:.6}", 20 * k, d[0], d[1], d[2]).unwrap();
    }
    let report = answer("rtcp", machine, &csv);
    assert_eq!(report["verdict"], "consistent", "{}", report["unnamed"]);
    let set_aside = report["outliers"].as_array().unwrap();
    assert_eq!(set_aside.len(), 3, "{set_aside:?}");
    for o in set_aside {
        let k = o["row"].as_u64().unwrap() - 1;
        assert_eq!(o["column"], ["dx_mm", "dy_mm", "dz_mm"][k as usize % 3], "{set_aside:?}");
    }
}

/// A sweep of 120 poses, 24 of them once more from the other side, with what `hidden` adds (pose, direction of B).
fn sweep_with_returns(folder: &Path, mut hidden: impl FnMut(usize, f64, f64) -> [f64; 3]) {
    let machine = "schema = 1\n[head]\nr_mm = 180.0\n[target]\nposition_mm = [70.0, 10.0, 90.0]\n";
    std::fs::write(folder.join("machine.toml"), machine).unwrap();
    let mut normal = normal();
    let mut csv = String::from("b_deg,c_deg,dir_b,dx_mm,dy_mm,dz_mm\n");
    for k in 0..144_usize {
        let i = k % 120 * 37 % 120;
        let (b, c) = ((i / 10) as f64 * 12.0 - 66.0, (i % 10) as f64 * 36.7);
        let dir = if (k + k / 120).is_multiple_of(2) { 1.0 } else { -1.0 };
        let d = hidden(i, b.to_radians(), dir).map(|v| v + 0.002 * normal());
        writeln!(csv, "{b},{c},{dir},{:.6},{:.6},{:.6}", d[0], d[1], d[2]).unwrap();
    }
    std::fs::write(folder.join("data.csv"), csv).unwrap();
}

/// What follows nothing but the pose shows in poses measured again, from whichever side they were reached.
#[test]
fn a_pose_reached_from_the_other_side_is_a_repeat() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut normal = normal();
    let own: Vec<f64> = (0..120).map(|_| 0.005 * normal()).collect();
    sweep_with_returns(folder, |pose, _, _| [0.0, 0.0, own[pose]]);
    let report = diagnose("rtcp", folder);
    assert_eq!(report["verdict"], "unknown", "{}", report["noise_source"]);
    assert!(report["effects"].as_array().unwrap().is_empty(), "{}", report["effects"]);
    // All of it is noise to whoever says that the noise is larger.
    let loud = ["diagnose", "rtcp", "--model", "machine.toml", "--data", "data.csv"];
    let output = run(&[&loud[..], &["--noise-mm", "2"]].concat(), folder);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("consistent") && said.contains("is not told"), "{said}");
}

/// A zero of B that was set in one direction is right in it, and wrong by all of the backlash in the other: one cause, one name.
#[test]
fn a_backlash_may_count_from_one_direction() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let width_rad = 0.005_f64.to_radians();
    for zero_dir in [1.0, -1.0] {
        sweep_with_returns(folder, |_, b, dir| {
            let real = b - 0.5 * (dir - zero_dir) * width_rad;
            [-180.0 * (real.sin() - b.sin()), 0.0, -180.0 * (real.cos() - b.cos())]
        });
        let report = diagnose("rtcp", folder);
        let effects = report["effects"].as_array().unwrap();
        let names: Vec<&str> = effects.iter().filter_map(|e| e["name"].as_str()).collect();
        assert_eq!(names, ["b-backlash"]);
        let of = |key: &str| effects[0][key]["width_deg"].as_f64().unwrap();
        assert!((of("parameters") - 0.005).abs() < 1.5 * of("parameters_u95"));
    }
}

/// A target that runs out is seen on a table that turns clockwise too.
#[test]
fn run_out_is_seen_whichever_way_the_table_turns() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut plan = String::from("b_deg,c_deg\n");
    for i in 0..140 {
        writeln!(plan, "{},{}", (i / 10) * 12 - 78, (i % 10) as f64 * 36.7).unwrap();
    }
    std::fs::write(folder.join("plan.csv"), plan).unwrap();
    for sense in [1, -1] {
        let machine = format!(
            "schema = 1\nc_sense = {sense}\n[head]\nr_mm = 180.0\n[target]\nposition_mm = [70.0, 40.0, 90.0]\n"
        );
        std::fs::write(folder.join("machine.toml"), &machine).unwrap();
        let effect = "[[effects]]\nname = \"target-runout\"\nparameters = { cos_mm = 0.004, sin_mm = 0.003 }\n";
        std::fs::write(folder.join("truth.toml"), machine + effect).unwrap();
        let simulate = ["simulate", "rtcp", "--model", "truth.toml", "--data", "plan.csv"];
        let noise = ["--noise-mm", "0.001", "--format", "csv", "--out", "data.csv"];
        assert!(run(&[&simulate[..], &noise].concat(), folder).status.success());
        let report = diagnose("rtcp", folder);
        assert!(class(&report).contains(&"target-runout"), "{sense}: {}", report["effects"]);
    }
}

/// A pitch error of many harmonics fits a zero of B that is off, too: where one harmonic and the zero explain as much, they are named.
#[test]
fn many_harmonics_do_not_hide_a_second_name() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut plan = String::from("b_deg,c_deg\n");
    for b in (-90..=90).step_by(15) {
        for c in [0, 47, 95, 160, 214, 265, 310, 345] {
            writeln!(plan, "{b},{c}").unwrap();
        }
    }
    std::fs::write(folder.join("plan.csv"), plan).unwrap();
    let machine = "schema = 1\n[head]\nr_mm = 180.0\n[target]\nposition_mm = [70.0, 40.0, 90.0]\n";
    std::fs::write(folder.join("machine.toml"), machine).unwrap();
    let effects = "[[effects]]\nname = \"b-zero\"\nparameters = { angle_deg = 0.0012 }\n[[effects]]\nname = \"b-pitch-error\"\nparameters = { cos3_deg = 0.001, sin3_deg = 0.0015 }\n";
    std::fs::write(folder.join("truth.toml"), [machine, effects].concat()).unwrap();
    let simulate = ["simulate", "rtcp", "--model", "truth.toml", "--data", "plan.csv"];
    let noise = ["--noise-mm", "0.001", "--format", "csv", "--out", "data.csv"];
    assert!(run(&[&simulate[..], &noise].concat(), folder).status.success());
    let report = diagnose("rtcp", folder);
    let effects = report["effects"].as_array().unwrap();
    let names: Vec<_> = effects.iter().filter_map(|e| e["name"].as_str()).collect();
    assert_eq!(names, ["b-pitch-error", "b-zero"]);
    let off = effects[1]["parameters"]["angle_deg"].as_f64().unwrap() - 0.0012;
    assert!(off.abs() < 1.5 * effects[1]["parameters_u95"]["angle_deg"].as_f64().unwrap());
}

/// An error motion is a function of its own axis' angle, whichever way the table turns: of one model a sweep and a rod's captures say
/// the same.
#[test]
fn a_c_axis_motion_goes_by_c_as_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("poses.csv"), "b_deg,c_deg\n0,45\n").unwrap();
    let mut points = String::from("capture,x_mm,y_mm,c_deg,u_px,v_px\n");
    for i in 0..12 {
        let (s, c) = (f64::from(i) * std::f64::consts::TAU / 12.0).sin_cos();
        writeln!(points, "1,300,-200,45,{},{}", 800.0 + 400.0 * c, 800.0 - 400.0 * s).unwrap();
    }
    std::fs::write(folder.join("points.csv"), points).unwrap();
    std::fs::write(folder.join("calib.toml"), "schema = 1\n[scale]\nmm_per_px = 0.005\n").unwrap();
    let first = |arguments: &[&str], column: &str| {
        let command = [&["simulate"], arguments, &["--model", "machine.toml", "--format", "csv"]];
        let output = run(&command.concat(), folder);
        let text = String::from_utf8(output.stdout).unwrap();
        let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let at = rows.next().unwrap().iter().position(|name| *name == column).unwrap();
        rows.next().unwrap()[at].parse::<f64>().unwrap()
    };
    for sense in [1, -1] {
        for parameters in
            ["x_cos_mm = 0.0, x_sin_mm = 0.01", "turn_cos_mm = 0.0, turn_sin_mm = -0.01"]
        {
            let seen = |mm: f64| {
                let parameters = parameters.replace("0.01", &mm.to_string());
                let model = format!(
                    "schema = 1\nc_sense = {sense}\n[head]\nr_mm = 200.0\n[table]\nxc_mm = 300.0\nyc_mm = -200.0\n[target]\nposition_mm = [60.0, 0.0, 20.0]\n[[effects]]\nname = \"c-radial-2x\"\nparameters = {{ {parameters} }}\n"
                );
                std::fs::write(folder.join("machine.toml"), model).unwrap();
                let sweep = first(&["rtcp", "--data", "poses.csv"], "dx_mm");
                let rod = ["rod", "--data", "points.csv", "--calib", "calib.toml"];
                [sweep, first(&rod, "u_px")]
            };
            let (with, without) = (seen(0.01), seen(0.0));
            // At C = 45 the axis stands 0.01 mm to the right: the target too, and the rod's edge, two pixels.
            assert!((with[0] - without[0] + 0.01).abs() < 1e-6, "{sense}: {with:?} {without:?}");
            assert!((with[1] - without[1] - 2.0).abs() < 1e-3, "{sense}: {with:?} {without:?}");
        }
    }
}

/// What `diagnose rod` says of a rod far from the machine's zero whose Y stretches by so much and whose pixels are larger than the
/// calibration has them: the first name, its size and its interval, um/m.
fn rod_told(y_um_per_m: f64, pixel_um_per_m: f64) -> (String, f64, f64) {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut normal = normal();
    let (rod, radius_mm, pixel_mm) = ([410.0, -185.0], 2.0, 0.005 * (1.0 + 1e-6 * pixel_um_per_m));
    let mut csv = String::from("capture,x_mm,y_mm,t_s,u_px,v_px\n");
    for k in 0..49_usize {
        let i = k * 20 % 49;
        let place = [i % 7, i / 7].map(|n| n as f64 * 0.5 - 1.5);
        let jitter = [0.0003 * normal(), 0.0003 * normal()];
        for p in 0..24 {
            let (s, c) = (f64::from(p) * std::f64::consts::TAU / 24.0).sin_cos();
            let real = (rod[1] + place[1]) * (1.0 + 1e-6 * y_um_per_m);
            let x = radius_mm * c - place[0] + jitter[0] + 0.0002 * normal();
            let y = rod[1] * (1.0 + 1e-6 * y_um_per_m) + radius_mm * s - real;
            let y = y + jitter[1] + 0.0002 * normal();
            let (u, v) = (800.0 + x / pixel_mm, 800.0 - y / pixel_mm);
            let (x, y) = (rod[0] + place[0], rod[1] + place[1]);
            writeln!(csv, "{k},{x:.4},{y:.4},{},{u:.4},{v:.4}", 20 * k).unwrap();
        }
    }
    std::fs::write(folder.join("data.csv"), csv).unwrap();
    std::fs::write(folder.join("calib.toml"), "schema = 1\n[scale]\nmm_per_px = 0.005\n").unwrap();
    let arguments = ["diagnose", "rod", "--calib", "calib.toml", "--data", "data.csv"];
    let output = run(&[&arguments[..], &["--format", "json"]].concat(), folder);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["verdict"], "named", "{report:#}");
    let effect = &report["effects"][0];
    let of = |key: &str| effect[key]["um_per_m"].as_f64().unwrap();
    (effect["name"].as_str().unwrap().to_owned(), of("parameters"), of("parameters_u95"))
}

/// A rod stands where the machine has it, far from the machine's zero: a scale about that zero shifts the rod by 0.4 mm besides what it
/// stretches.
#[test]
fn a_scale_is_named_far_from_the_machines_zero() {
    let (name, size, u95) = rod_told(2200.0, 0.0);
    assert_eq!(name, "scale-y");
    assert!((size - 2200.0).abs() < 1.5 * u95 && u95 < 200.0, "{size} ± {u95}");
}

/// Of the camera is said what it is: larger pixels, which show everything nearer to the axis.
#[test]
fn larger_pixels_are_said_to_be_larger() {
    let (name, size, u95) = rod_told(0.0, 900.0);
    assert_eq!(name, "pixel-scale");
    assert!((size - 900.0).abs() < 1.5 * u95 && u95 < 200.0, "{size} ± {u95}");
}

/// A C axis that is tilted about the height at which its centre was measured moves the target up and down, and hardly sideways: that is
/// no axial motion of the table.
#[test]
fn a_tilt_may_leave_the_axis_where_it_was_at_the_targets_height() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let tilt_deg: f64 = 0.005;
    sweep_with_returns(folder, |pose, _, _| {
        let (s, c) = ((pose % 10) as f64 * 36.7_f64).to_radians().sin_cos();
        [0.0, 0.0, tilt_deg.to_radians() * (70.0 * c - 10.0 * s)]
    });
    let report = diagnose("rtcp", folder);
    let effect = &report["effects"][0];
    assert_eq!(effect["name"], "c-axis-tilt-y", "{report:#}");
    assert_eq!(effect["parameters"]["at_target"], 1.0);
    let of = |key: &str| effect[key]["tilt_deg"].as_f64().unwrap();
    assert!((of("parameters") - tilt_deg).abs() < 1.5 * of("parameters_u95"), "{effect:#}");
}

/// A beam that leans and a nozzle beside it, 45 burns: `hidden` of the height, mm.
fn burns(folder: &Path, hidden: impl Fn(f64) -> [f64; 2]) -> (Value, Vec<String>) {
    std::fs::write(folder.join("machine.toml"), BAR).unwrap();
    let mut normal = normal();
    let mut csv = String::from("height_mm,power_w,b_deg,dx_mm,dy_mm\n");
    for k in 0..45 {
        let i = k * 7 % 45;
        let (height, b) = ([20.0, 35.0, 47.0][i % 3], 45.0 * (i / 3 % 5) as f64 - 90.0);
        let [dx, dy] = hidden(height).map(|v| v + 0.004 * normal());
        writeln!(csv, "{height},{},{b},{dx:.6},{dy:.6}", 100 + 50 * (i / 15)).unwrap();
    }
    std::fs::write(folder.join("data.csv"), csv).unwrap();
    let report = diagnose("burn", folder);
    let effects = report["effects"].as_array().into_iter().flatten();
    let mut names: Vec<String> =
        effects.filter_map(|e| e["name"].as_str().map(String::from)).collect();
    names.sort_unstable();
    (report, names)
}

/// In one output the two are a line over the height, whatever the other output's noise; in an output each the larger one must not
/// make the other small.
#[test]
fn a_tilt_beside_an_offset_is_two_names() {
    let folder = tempfile::tempdir().unwrap();
    for beside in [-0.0014, 0.0, 0.0012] {
        let (report, names) = burns(folder.path(), |h| [0.018 - 0.0006 * h, beside]);
        assert_eq!(report["verdict"], "named", "{beside}: {}", report["unnamed"]);
        assert_eq!(names, ["beam-tilt-x", "nozzle-offset"], "{beside}");
    }
    for offset in [0.04, 0.1] {
        let (report, names) = burns(folder.path(), |h| [offset, -0.0015 * h]);
        assert_eq!(report["verdict"], "named", "{offset}: {}", report["unnamed"]);
        assert_eq!(names, ["beam-tilt-y", "nozzle-offset"], "{offset}");
    }
}

/// Given noise that the data do not have is in no gap; and another machine's geometry is told from an effect.
#[test]
fn noise_and_sizes_that_no_machine_has_are_not_believed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let plan = ["ballbar", "simulate", "--steps", "60", "--noise-mm", "0.001", "--seed", "2"];
    assert!(
        run(&[&plan[..], &["--format", "csv", "--out", "data.csv"]].concat(), folder)
            .status
            .success()
    );
    let held_out = |report: &Value| report["gap"]["heldout_before_rms_mm"].as_f64().unwrap();
    std::fs::write(folder.join("machine.toml"), BAR).unwrap();
    let estimated = diagnose("ballbar", folder);

    for given in ["0.001", "0.1"] {
        let arguments = ["diagnose", "ballbar", "--model", "machine.toml", "--data", "data.csv"];
        let more = ["--noise-mm", given, "--format", "json"];
        let output = run(&[&arguments[..], &more].concat(), folder);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let ratio = held_out(&report) / held_out(&estimated);
        assert!((ratio - 1.0).abs() < 0.02, "{given}: {ratio}");
    }
    std::fs::write(folder.join("machine.toml"), BAR.replace("400.0", "215.0")).unwrap();
    let warnings = diagnose("ballbar", folder)["warnings"].to_string();
    assert!(
        warnings.contains("scale-z adds up to 57")
            && warnings.contains("more than any machine shows"),
        "{warnings}"
    );
}
