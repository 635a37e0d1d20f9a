//! What `solve` promises: the method's formulas, intervals that hold, B's sense from the readings, and a check that
//! fails loudly.

#![allow(clippy::unwrap_used)] // a test that cannot go on should stop

use std::path::Path;

use assert_cmd::Command;
use nalgebra::Vector3;
use pivotsight::machine::Machine;
use pivotsight::rtcp::Session;
use pivotsight::rtcp::solve::{Readings, Solved, solve};
use pivotsight::uncertainty::{K95, Measured, Verdict};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::Value;

const DX: f64 = 0.283;
const R: f64 = 214.7;

fn m(value: f64, u: f64) -> Measured {
    Measured { value, u }
}

/// Where the nozzle touches, from the geometry of the chain and a disc against a cylinder, not from the solver's formula.
fn touch_x(told_deg: f64, error_rad: f64, sense: f64, rod_x: f64, diameter: f64, rim: f64) -> f64 {
    let b = sense * (told_deg.to_radians() + error_rad);
    let swing = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), b);
    let face = swing * Vector3::new(DX, 0.0, -R) - Vector3::new(DX, 0.0, -R);
    // The nozzle leaves the rod on the side it points away from: the rim's points nearest the rod.
    let side = b.sin().signum();
    let rim_x = [-rim, rim].map(|r| (swing * Vector3::new(r, 0.0, 0.0)).x);
    let nearest = if side > 0.0 { rim_x[0].min(rim_x[1]) } else { rim_x[0].max(rim_x[1]) };
    rod_x + side * diameter / 2.0 - face.x - nearest
}

fn table_z(error_rad: f64, table_z: f64, rim: f64) -> f64 {
    let swing = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), error_rad);
    let face = swing * Vector3::new(DX, 0.0, -R) - Vector3::new(DX, 0.0, -R);
    let lowest = [-rim, rim].map(|r| (swing * Vector3::new(r, 0.0, 0.0)).z);
    table_z - face.z - lowest[0].min(lowest[1])
}

/// Readings of a machine at (412.3, -87.6, -310.2) with unit-normal draws in place of the errors.
fn readings(sense: f64, rim: f64, draws: &[f64; 12]) -> Readings {
    let (u_axis, u_rod, u_d, u_x, zero, position) = (0.0015, 0.002, 0.001, 0.0012, 5e-4, 2e-4);
    let [n0, n1, n2, n3, n4, n5, n6, n7, n8, n9, n10, n11] = draws;
    let rod = 412.3 + u_rod * n2;
    let touch = |deg: f64, n: f64| touch_x(deg, zero * n8 + position * n, sense, rod, 20.0, rim);
    Readings {
        axis_center_mm: [m(412.3 + u_axis * n0, u_axis), m(-87.6 + u_axis * n1, u_axis)],
        axis_from_seen_mm: m(0.0, 0.0),
        rod_offset_mm: m(0.0, u_rod),
        offset_follows: [0.0; 2],
        diameter_mm: m(20.0 + u_d * n3, u_d),
        x1_mm: m(touch(90.0, *n9) + u_x * n4, u_x),
        x2_mm: m(touch(-90.0, *n10) + u_x * n5, u_x),
        z_table_mm: m(table_z(sense * zero * n8, -310.2, rim) + u_x * n6, u_x),
        b1_rad: 90f64.to_radians(),
        b2_rad: (-90f64).to_radians(),
        check_touch: Some((45f64.to_radians(), m(touch(45.0, *n11) + u_x * n7, u_x))),
        b_zero_u_rad: zero,
        b_position_u_rad: position,
        nozzle_rim_radius_mm: rim,
    }
}

fn values(s: &Solved) -> [Measured; 6] {
    [s.xb_mm, s.zb_mm, s.xc_mm, s.yc_mm, s.delta_x_mm, s.r_mm]
}

#[test]
fn exact_readings_give_the_machine_back_whichever_way_b_turns() {
    for (sense, b_sense) in [(1.0, 1), (-1.0, -1)] {
        for rim in [0.0, 2.5] {
            let s = solve(&readings(sense, rim, &[0.0; 12])).unwrap();
            assert!((s.delta_x_mm.value - DX).abs() < 1e-9 && (s.r_mm.value - R).abs() < 1e-9);
            assert!((s.xb_mm.value - 412.3 - DX).abs() < 1e-9);
            assert_eq!(s.b_sense, b_sense);
            let check = s.check.unwrap();
            assert!(check.difference_mm.value.abs() < 1e-9, "{check:?}");
            assert_eq!(check.verdict, Verdict::Pass);
            // The machine it makes touches where the readings say.
            let chain = s.machine("cell", 1, 0.0).chain().unwrap();
            let b = 90f64.to_radians();
            let face = chain.tool(&[0.0, 0.0, 0.0, b, 0.0]).translation.vector;
            assert!((face.x + sense * (R + sense * DX)).abs() < 1e-9, "{face}");
        }
    }
}

#[test]
fn intervals_hold_in_a_monte_carlo() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let truth = [412.3 + DX, -310.2, 412.3, -87.6, DX, R];
    // Without a rim the propagation is linear: the spread is the stated one. With one it must still be covered.
    for rim in [0.0, 5.0] {
        let runs = 4000;
        let mut hits = [0usize; 7];
        let mut squares = [0.0; 7];
        for _ in 0..runs {
            let draws = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
            let s = solve(&readings(1.0, rim, &draws)).unwrap();
            let mut all: Vec<(Measured, f64)> = values(&s).into_iter().zip(truth).collect();
            all.push((s.check.unwrap().difference_mm, 0.0));
            // X_B is where the axis stands over the rod, and the rod stands off the C axis by what was drawn.
            all[0].1 += 0.002 * draws[2];
            for (i, (found, true_value)) in all.iter().enumerate() {
                let error = found.value - true_value;
                hits[i] += usize::from(error.abs() <= found.u95());
                squares[i] += (error / found.u).powi(2);
            }
        }
        for i in 0..7 {
            let coverage = hits[i] as f64 / f64::from(runs);
            let ratio = (squares[i] / f64::from(runs)).sqrt();
            println!("rim {rim}: output {i}: coverage {coverage:.3}, spread/stated {ratio:.3}");
            assert!((0.935..=0.999).contains(&coverage), "rim {rim}, output {i}: {coverage}");
            if rim == 0.0 && i > 0 {
                assert!((0.95..1.05).contains(&ratio), "rim {rim}, output {i}: {ratio}");
            }
        }
    }
}

#[test]
fn a_nozzle_five_millimetres_wide_and_a_tenth_of_a_degree_off_touches_nine_micrometres_early() {
    let early = touch_x(90.0, 0.1f64.to_radians(), 1.0, 0.0, 20.0, 5.0)
        - touch_x(90.0, 0.1f64.to_radians(), 1.0, 0.0, 20.0, 0.0);
    assert!((early - 0.0087).abs() < 5e-5, "{early}");
    let with = |rim: f64| {
        let r = Readings { b_zero_u_rad: 0.1f64.to_radians(), ..readings(1.0, rim, &[0.0; 12]) };
        solve(&r).unwrap()
    };
    let grown = (with(5.0).r_mm.u.powi(2) - with(0.0).r_mm.u.powi(2)).sqrt();
    assert!((grown - early).abs() < 3e-4, "R carries it: {grown}");
    assert!(with(5.0).xb_mm.u - with(0.0).xb_mm.u < 3e-4, "X_B hardly does");
}

fn command(session: &Path, more: &[&str]) -> (i32, Value, String) {
    let output = Command::cargo_bin("pivotsight")
        .unwrap()
        .args(["solve", "--format", "json"])
        .arg(session)
        .args(more)
        .output()
        .unwrap();
    let json = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code().unwrap(), json, String::from_utf8_lossy(&output.stderr).into_owned())
}

const SESSION: &str = "
[rod]
diameter_mm = 20.0
diameter_u_mm = 0.0005
center_mm = [412.3, -87.6]
center_u_mm = 0.001
[touch]
x1_mm = 637.283
x1_u_mm = 0.001
x2_mm = 187.883
x2_u_mm = 0.001
z_table_mm = -310.2
z_table_u_mm = 0.001
";

#[test]
fn the_command_gives_the_contracts_keys_and_a_machine_file() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s.toml");
    let machine = folder.path().join("machine.toml");
    std::fs::write(&session, SESSION).unwrap();
    let (code, json, _) = command(&session, &["--write-machine", machine.to_str().unwrap()]);
    assert_eq!(code, 0);
    assert_eq!(json["schema"], "pivotsight.solve/1");
    for (key, value) in
        [("xb", 412.583), ("zb", -310.2), ("xc", 412.3), ("yc", -87.6), ("delta_x", DX), ("r", R)]
    {
        assert!((json[format!("{key}_mm")].as_f64().unwrap() - value).abs() < 1e-9, "{key}");
        assert!(json[format!("{key}_u95_mm")].as_f64().unwrap() > 0.0, "{key}");
    }
    let near = |key: &str, expected: [f64; 3]| {
        let found: [f64; 3] = serde_json::from_value(json[key].clone()).unwrap();
        assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-9), "{key} {found:?}");
    };
    near("i1_mm", [DX, 0.0, -R]);
    near("i2_mm", [-DX, 0.0, R]);
    near("i3_mm", [412.3, -87.6, -310.2]);
    near("i4_mm", [-412.3, 87.6, 310.2]);
    let machine = Machine::read(&machine).unwrap();
    assert!((machine.head.r_mm - R).abs() < 1e-9 && machine.table.xc_mm == 412.3);
}

/// What a machine file says beside the numbers is kept where the session names it, and lost in no case.
#[test]
fn a_machine_file_keeps_its_target_its_travel_and_its_other_errors() {
    let folder = tempfile::tempdir().unwrap();
    let (session, machine) = (folder.path().join("s.toml"), folder.path().join("machine.toml"));
    let old = "schema = 1\nname = \"cell\"\n[head]\nr_mm = 214.6\n[target]\nposition_mm = [80.0, 0.0, 100.0]\n[axes.B]\nlimits_deg = [-95.0, 95.0]\n\
               [[effects]]\nname = \"pivot-length\"\nparameters = { r_mm = 0.1 }\n[[effects]]\nname = \"b-backlash\"\nparameters = { width_deg = 0.004 }\n";
    std::fs::write(&machine, old).unwrap();
    std::fs::write(&session, SESSION).unwrap();
    let write = ["--write-machine", machine.to_str().unwrap()];
    let (code, _, stderr) = command(&session, &write);
    assert!(code == 2 && stderr.contains("[target], limits of [axes], [[effects]]"), "{stderr}");
    assert_eq!(std::fs::read_to_string(&machine).unwrap(), old);
    std::fs::write(&session, format!("{SESSION}[control]\nmachine = \"machine.toml\"\n")).unwrap();
    let new = folder.path().join("new.toml");
    let (code, _, stderr) = command(&session, &["--write-machine", new.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let (old, new) = (Machine::read(&machine).unwrap(), Machine::read(&new).unwrap());
    assert!((new.head.r_mm - R).abs() < 1e-9 && new.table.xc_mm == 412.3);
    assert_eq!((new.target, &new.axes), (old.target, &old.axes));
    // R was measured anew: what was wrong with it is gone.
    let left: Vec<&str> = new.effects.iter().map(|e| e.name.as_str()).collect();
    assert_eq!(left, ["b-backlash"]);
}

#[test]
fn results_of_burn_and_rod_are_taken_from_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    // The rod stood 4 µm off the C axis, towards +X at C = 0 where the nozzle touched it.
    write(
        "rod.json",
        r#"{"schema":"pivotsight.rod/1","version":"0","input":"x","warnings":[],
        "rod_centers":[{"c_deg":0,"center_mm":[412.304,-87.6],"center_u95_mm":[0.001,0.001]},
                       {"c_deg":180,"center_mm":[412.296,-87.6],"center_u95_mm":[0.001,0.001]}],
        "axis_center_mm":[412.3,-87.6],"axis_center_u95_mm":[0.001,0.001],
        "eccentricity_mm":0.004,"diameter_mm":20.0,"diameter_u95_mm":0.002}"#,
    );
    write(
        "burn.json",
        r#"{"results":[{"offset_mm":[0.05,0.0],"offset_u95_mm":[0.002,0.002]},
        {"offset_mm":[0.012,0.0],"offset_u95_mm":[0.001,0.001]}]}"#,
    );
    // At an angle at which it was not seen it stands where the table turns it to.
    for (c_deg, x1, x2) in [(360.0, "637.287", "187.887"), (60.0, "637.285", "187.885")] {
        let touch = &SESSION[SESSION.find("[touch]").unwrap()..]
            .replace("637.283", x1)
            .replace("187.883", x2);
        write(
            "s.toml",
            &format!(
                "[burn]\nresult = \"burn.json\"\n[rod]\nresult = \"rod.json\"\n{touch}c_deg = {c_deg}\n"
            ),
        );
        let (code, json, _) = command(&folder.path().join("s.toml"), &[]);
        assert!((json["delta_x_mm"].as_f64().unwrap() - DX).abs() < 1e-9, "{json}");
        assert!(json["delta_x_u95_mm"].as_f64().unwrap() < 0.02, "{json}");
        assert_eq!(json["limits"][0]["verdict"], "fail", "12 µm is over the method's limit");
        assert_eq!((code, &json["verdict"]), (1, &json["limits"][0]["verdict"]));
        let doubt = json["warnings"].to_string();
        assert!(doubt.contains("holds 2 pictures, of which the last"), "{doubt}");
    }
    // Of tests burnt at one setting the mean counts.
    write(
        "burn.json",
        r#"{"results":[{"offset_mm":[0.05,0.0],"offset_u95_mm":[0.002,0.002]}, {"image":"b.png","error":"no ring"}],
        "mean":{"offset_mm":[0.004,0.0],"offset_u95_mm":[0.001,0.001]}}"#,
    );
    let (_, json, _) = command(&folder.path().join("s.toml"), &[]);
    assert_eq!(json["limits"][0]["value_mm"], 0.004);
    assert!(!json["warnings"].to_string().contains("pictures"), "{}", json["warnings"]);
    // Another command's result, or one of another form, is none of these.
    write(
        "burn.json",
        r#"{"schema":"pivotsight.circles/1","offset_mm":[0,0],"offset_u95_mm":[0,0]}"#,
    );
    let (code, _, stderr) = command(&folder.path().join("s.toml"), &[]);
    assert_eq!(code, 2);
    assert!(stderr.contains("pivotsight.circles/1"), "{stderr}");
}

#[test]
fn a_rod_seen_at_one_angle_and_touched_at_another_may_have_moved_twice_its_eccentricity() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("rod.json"),
        r#"{"rod_centers":[{"c_deg":0,"center_mm":[412.3,-87.6],"center_u95_mm":0.001}],"axis_separated":false,
        "axis_center_mm":[412.3,-87.6],"axis_center_u95_mm":0.001,"diameter_mm":20.0,"diameter_u95_mm":0.002}"#,
    )
    .unwrap();
    let touch = &SESSION[SESSION.find("[touch]").unwrap()..];
    let delta_x_u = |c_deg: f64| {
        let text = format!(
            "[rod]\nresult = \"rod.json\"\neccentricity_mm = 0.05\n{touch}c_deg = {c_deg}\n"
        );
        let path = folder.path().join("s.toml");
        std::fs::write(&path, text).unwrap();
        command(&path, &[]).1["delta_x_u95_mm"].as_f64().unwrap() / K95
    };
    // Two places on the circle differ by e rms along X; seen and touched at one angle they are one.
    assert!((delta_x_u(120.0) - 0.05).abs() < 1e-3, "{}", delta_x_u(120.0));
    assert!(delta_x_u(0.0) < 0.002, "{}", delta_x_u(0.0));
}

#[test]
fn a_wrong_check_touch_fails_loudly_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s.toml");
    let machine = folder.path().join("machine.toml");
    let right = 412.3 + 10.0 + DX * (1.0 - 0.5f64.sqrt()) + R * 0.5f64.sqrt();
    let wrong = right - 2.0 * DX * (1.0 - 0.5f64.sqrt()); // as if ΔX had the other sign
    for (x45, code) in [(right, 0), (wrong, 1)] {
        std::fs::write(&session, format!("{SESSION}x45_mm = {x45}\nx45_u_mm = 0.001\n")).unwrap();
        let (found, json, stderr) =
            command(&session, &["--write-machine", machine.to_str().unwrap()]);
        assert_eq!(found, code, "{stderr}");
        assert_eq!(machine.exists(), code == 0);
        assert_eq!(stderr.contains("CHECK FAILED"), code == 1);
        assert_eq!(json["check_touch"]["verdict"], if code == 0 { "pass" } else { "fail" });
        let _ = std::fs::remove_file(&machine);
    }
    // Beyond its interval and within the limit it passes, with a word.
    let (_, json, _) = command(&session, &[]);
    let u95 = json["check_touch"]["difference_u95_mm"].as_f64().unwrap();
    let x45 = right + 1.25 * u95;
    let micrometres = SESSION.replace("x1_u_mm = 0.001", "x1_u_mm = 1.0");
    std::fs::write(&session, format!("{SESSION}x45_mm = {x45}\nx45_u_mm = 0.001\n")).unwrap();
    let (code, json, stderr) = command(&session, &[]);
    let limit = json["check_touch"]["limit_mm"].as_f64().unwrap();
    assert!(code == 0 && limit > 1.25 * u95 && stderr.contains("one of twenty"), "{stderr}");
    std::fs::write(&session, micrometres).unwrap();
    assert!(command(&session, &[]).2.contains("if it is in micrometres, write 0.001000"));
}

#[test]
fn a_session_without_a_check_touch_and_a_leap_of_a_value_are_doubted() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s.toml");
    let control = "[control]\ndelta_x_mm = 0.25\nr_mm = 214.65\nxc_mm = -87.6\nyc_mm = -87.61\n";
    std::fs::write(&session, format!("{SESSION}{control}")).unwrap();
    let (code, json, _) = command(&session, &[]);
    let warnings = json["warnings"].to_string();
    assert_eq!(code, 0);
    assert!(warnings.contains("no check touch"), "{warnings}");
    // zc_mm is not given: what it was before is not known, and no change of it is shown.
    let shown = json["change"]["values"].to_string();
    assert!(shown.contains("yc_mm") && !shown.contains("zc_mm"), "{shown}");
    assert_eq!(warnings.matches("mix-up").count(), 1, "{warnings}");
    assert!(warnings.contains("xc_mm changes by +499.9000 mm"), "{warnings}");
}

#[test]
fn bad_sessions_are_refused_with_the_key_to_correct() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s.toml");
    for (from, to, words) in [
        ("x1_mm = 637.283", "x1_in = 25.09", "x1_in"),
        ("x1_mm = 637.283", "x1_mm = nan", "touch.x1_mm"),
        ("x1_mm = 637.283", "x1_mm = 190.0", "less than the rod's diameter"),
        ("x1_u_mm = 0.001", "x1_u_mm = -1.0", "touch.x1_u_mm"),
        ("diameter_mm = 20.0", "", "rod.diameter_mm"),
        ("center_mm = [412.3, -87.6]", "result = \"none.json\"", "none.json"),
        ("center_mm = [412.3, -87.6]", "", "either result or center_mm"),
        ("[touch]", "[touch]\nb2_deg = 80.0", "same side"),
        ("[touch]", "[touch]\nb2_deg = -5.0", "too near"),
        ("[touch]", "[touch]\nb_zero_u_deg = 50.0", "touch.b_zero_u_deg"),
        ("[rod]", "[rod", "TOML"),
    ] {
        std::fs::write(&session, SESSION.replace(from, to)).unwrap();
        let (code, json, stderr) = command(&session, &[]);
        assert_eq!((code, json), (2, Value::Null), "{words}: {stderr}");
        assert!(stderr.contains(words), "{words}: {stderr}");
    }
}

/// Where no picture can be taken, points of the rim are aimed at by hand: `rod` finds the axis from them, and `solve` takes it.
#[test]
fn a_rim_aimed_at_by_hand_gives_the_axis() {
    let folder = tempfile::tempdir().unwrap();
    let (points, rod) = (folder.path().join("rim.csv"), folder.path().join("rod.json"));
    let mut csv = String::from("x_mm,y_mm,c_deg\n");
    for c in [0.0f64, 120.0, 240.0] {
        let center = [412.3 + 0.05 * c.to_radians().cos(), -87.6 + 0.05 * c.to_radians().sin()];
        for at in [10.0f64, 130.0, 250.0] {
            let (s, k) = at.to_radians().sin_cos();
            csv += &format!("{:.6},{:.6},{c}\n", center[0] + 10.0 * k, center[1] + 10.0 * s);
        }
    }
    std::fs::write(&points, &csv).unwrap();
    let run = |arguments: &[&str]| {
        let mut command = Command::cargo_bin("pivotsight").unwrap();
        command.arg("rod").arg(&points).args(arguments).output().unwrap()
    };
    let out = run(&["--aim-u-mm", "0.004", "--format", "json", "--out", rod.to_str().unwrap()]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let session = folder.path().join("s.toml");
    let text = SESSION
        .replace("center_mm = [412.3, -87.6]\ncenter_u_mm = 0.001\n", "result = \"rod.json\"\n");
    assert!(text.contains("rod.json"));
    std::fs::write(&session, text).unwrap();
    let (_, json, warnings) = command(&session, &[]);
    let value = |key: &str| json[key].as_f64().unwrap_or_else(|| panic!("{key}: {warnings}"));
    assert!((value("xc_mm") - 412.3).abs() < 1e-4 && (value("yc_mm") + 87.6).abs() < 1e-4);
    assert!(value("xc_u95_mm") > 0.001 && value("xc_u95_mm") < 0.01, "{json}");
    // The rod's run-out is twice what the three centres are off.
    let limits = json["limits"].as_array().unwrap();
    let run_out = limits.iter().find(|l| l["what"].as_str().unwrap().contains("run-out")).unwrap();
    assert!((run_out["value_mm"].as_f64().unwrap() - 0.1).abs() < 1e-3, "{run_out}");
    let out = run(&["--overlay", "pictures"]);
    assert!(String::from_utf8_lossy(&out.stderr).contains("--overlay: needs pictures"));
    // A table that comes through a pipe can be read once.
    if cfg!(unix) {
        let mut piped = Command::cargo_bin("pivotsight").unwrap();
        piped.args(["rod", "/dev/stdin"]).write_stdin(csv).assert().success();
    }
}

/// Values typed in say nothing of the sense of B: where they are the new ones already, nothing changes, whichever way it turns.
#[test]
fn values_that_are_in_the_control_already_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s.toml");
    for (x1, x2) in [(210.1, -209.9), (-209.9, 210.1)] {
        let text = format!(
            "[rod]\ndiameter_mm = 20\ncenter_mm = [0, 0]\n[touch]\nx1_mm = {x1}\nx2_mm = {x2}\nz_table_mm = 0\n\
             [control]\ndelta_x_mm = 0.1\nr_mm = 200\nxc_mm = 0\nyc_mm = 0\nzc_mm = 0\n"
        );
        std::fs::write(&session, text).unwrap();
        let (_, json, _) = command(&session, &[]);
        for astray in json["change"]["removes"].as_array().unwrap() {
            assert!(astray["dx_mm"].as_f64().unwrap().abs() < 1e-9, "{x1}: {astray}");
        }
    }
}

/// Far from the angles at which the rod was seen an error of the axis is twice one of where the rod stood.
#[test]
fn the_place_of_a_rod_turned_far_has_an_interval_that_holds() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut draw = || 0.001 * Distribution::<f64>::sample(&StandardNormal, &mut random);
    let (mut held, runs) = (0, 200);
    for _ in 0..runs {
        let angles = [0.0f64, 30.0, 60.0];
        let turned = |c: f64| [0.02 * c.to_radians().cos(), 0.02 * c.to_radians().sin()];
        let seen = angles.map(|c| turned(c).map(|v| v + draw()));
        // Axis and eccentricity by least squares, as `rod` has them.
        let design = nalgebra::DMatrix::from_fn(6, 4, |r, k| {
            let (sin, cos) = angles[r / 2].to_radians().sin_cos();
            [[1.0, 0.0, cos, -sin], [0.0, 1.0, sin, cos]][r % 2][k]
        });
        let normal = (design.transpose() * &design).try_inverse().unwrap();
        let axis =
            &normal * design.transpose() * nalgebra::DVector::from_fn(6, |r, _| seen[r / 2][r % 2]);
        let u95 = K95 * 0.001 * normal[(0, 0)].sqrt();
        let centers: Vec<String> = (0..3)
            .map(|i| {
                format!(
                    r#"{{"c_deg":{},"center_mm":{:?},"center_u95_mm":[0.00196,0.00196]}}"#,
                    angles[i], seen[i]
                )
            })
            .collect();
        let rod = format!(
            r#"{{"schema":"pivotsight.rod/1","version":"0","input":"x","warnings":[],"rod_centers":[{}],
            "axis_center_mm":[{},{}],"axis_center_u95_mm":[{u95},{u95}],"eccentricity_mm":0.02,"axis_separated":true,
            "diameter_mm":20.0,"diameter_u95_mm":0.0001}}"#,
            centers.join(","),
            axis[0],
            axis[1]
        );
        std::fs::write(folder.path().join("rod.json"), rod).unwrap();
        let [there, _] = turned(200.0);
        let session = format!(
            "[rod]\nresult = \"rod.json\"\n[touch]\nc_deg = 200\nx1_mm = {}\nx1_u_mm = 1e-5\nx2_mm = {}\nx2_u_mm = 1e-5\n\
             z_table_mm = 0\nnozzle_rim_radius_mm = 0\nb_zero_u_deg = 0\n",
            there + 225.0,
            there - 225.0
        );
        std::fs::write(folder.path().join("s.toml"), session).unwrap();
        let read = Session::read(folder.path().join("s.toml")).unwrap();
        let delta_x = solve(&read.readings).unwrap().delta_x_mm;
        held += usize::from(delta_x.value.abs() < delta_x.u95());
    }
    let share = f64::from(held as u32) / f64::from(runs);
    assert!((0.91..0.985).contains(&share), "{share}");
}
