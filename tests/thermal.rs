//! Thermal model: truth from a simulated machine, intervals that hold, flags in place of silent numbers, speed.

#![allow(clippy::unwrap_used)]

use assert_cmd::Command;
use pivotsight::thermal::compensate::{Compensator, Options};
use pivotsight::thermal::simulate::Truth;
use pivotsight::thermal::{Model, fit, head, screw};

fn thermal() -> Command {
    let mut command = Command::cargo_bin("pivotsight").unwrap();
    command.args(["--quiet", "thermal"]);
    command
}

/// Writes the calibration of `truth` and fits it.
fn fitted(truth: &Truth, rows: usize, seed: u64, options: &head::Options) -> (Model, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let (h, s) = (dir.path().join("head.csv"), dir.path().join("screw.csv"));
    std::fs::write(&h, truth.head_csv(rows, seed)).unwrap();
    std::fs::write(&s, truth.screw_csv(&[0.0, 6.0, 12.0, 18.0], 9, seed + 1000)).unwrap();
    let head = head::Data::read(&h, &options.cold_c).unwrap();
    let screw = screw::Data::read(&s).unwrap();
    let mut warnings = Vec::new();
    let model = fit(
        Some((&head, options)),
        Some((&screw, &screw::Options::default())),
        Vec::new(),
        &mut warnings,
    );
    (model.unwrap(), warnings)
}

#[test]
fn stated_intervals_hold_for_coefficients_slopes_and_corrections() {
    let truth = Truth { noise_c: 0.0, ..Truth::sample(4) };
    let mut hits = [(0, 0); 4];
    let mut count = |which: usize, inside: bool| {
        hits[which].0 += usize::from(inside);
        hits[which].1 += 1;
    };
    for seed in 0..120 {
        let (model, _) = fitted(&truth, 120, seed, &head::Options::default());
        let head = model.head.as_ref().unwrap();
        for (c, a) in head.coefficients.iter().zip(&truth.head_mm_per_c) {
            count(0, (c.mm_per_c - a).abs() <= c.mm_per_c_u95);
        }
        for (s, (_, t0, slope, p0, _)) in model.screws.iter().zip(&truth.screws) {
            count(1, (s.t0_c - t0).abs() <= s.t0_u95_c);
            count(1, (s.p0_mm - p0).abs() <= s.p0_u95_mm);
            let tk = 1e6 * slope * (s.t_max_c - t0);
            count(2, (s.tk_max_um_per_m - tk).abs() <= s.tk_max_u95_um_per_m);
        }
        // A correction covers the error that an instrument with the same noise would read.
        let rises = [5.0, 3.0, 8.0, 4.0];
        let mut at_work = Compensator::new(model, Options::default());
        let line = r#"{"position_mm":{"y":1200},"screw_c":{"y":30.5},"head_c":[5,3,8,4]}"#;
        let answer = at_work.answer_line(line);
        let expected = truth.head_mm(&rises) + 11.5e-6 * 10.0 * 1000.0;
        assert!(answer.flags.is_empty(), "{:?}", answer.flags);
        count(
            3,
            (answer.correction_mm["y"].unwrap() + expected).abs() <= answer.correction_u95_mm["y"],
        );
    }
    let percent: Vec<f64> = hits.iter().map(|h| 100.0 * h.0 as f64 / h.1 as f64).collect();
    assert!(percent[..3].iter().all(|p| (92.0..98.0).contains(p)), "{percent:?}");
    assert!(percent[3] >= 95.0, "{percent:?}");
}

#[test]
fn intervals_of_the_law_hold_where_each_runs_thermometer_is_off() {
    let truth = Truth::sample(4);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("screw.csv");
    let (mut inside, mut all) = (0.0, 0.0);
    for seed in 0..120u64 {
        // Each run reads its screw off by up to 0.2 °C.
        let mut text = String::new();
        for line in truth.screw_csv(&[0.0, 5.0, 10.0, 15.0, 20.0], 11, seed).lines() {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if let Ok(t) = cells[1].parse::<f64>() {
                let run = (t / 5.0).floor() as u64 + 7 * u64::from(cells[0].as_bytes()[0]);
                let draw = (seed * 1009 + run).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
                cells[1] = format!("{:.3}", t + 0.4 * (draw as f64 / 16_777_216.0 - 0.5));
            }
            text.push_str(&format!("{}\n", cells.join(",")));
        }
        std::fs::write(&path, text).unwrap();
        let data = screw::Data::read(&path).unwrap();
        for (s, (_, t0, slope, ..)) in
            screw::fit(&data, &screw::Options::default(), &mut Vec::new())
                .unwrap()
                .iter()
                .zip(&truth.screws)
        {
            let tk = 1e6 * slope * (s.t_max_c - t0);
            inside += f64::from((s.t0_c - t0).abs() <= s.t0_u95_c);
            inside += f64::from((s.tk_max_um_per_m - tk).abs() <= s.tk_max_u95_um_per_m);
            all += 2.0;
        }
    }
    let percent = 100.0 * inside / all;
    assert!((88.0..99.0).contains(&percent), "{percent} %");
}

#[test]
fn selection_finds_few_sensors_and_its_error_is_told_on_rows_not_seen() {
    let truth = Truth::sample(25);
    let (model, _) = fitted(&truth, 400, 5, &head::Options::default());
    let head = model.head.unwrap();
    assert!((2..=10).contains(&head.coefficients.len()));
    assert!(head.held_out_rms_mm < 0.0012 && head.before_rms_mm > 0.01, "{}", head.held_out_rms_mm);
    // Sensors that show nothing but noise: held-out error must not claim an improvement.
    let mut noise = String::from("head_1_c,head_2_c,head_3_c,displacement_mm\n");
    let blind = Truth { head_mm_per_c: vec![0.0; 3], noise_mm: 0.01, ..Truth::sample(3) };
    noise.push_str(blind.head_csv(100, 3).split_once('\n').unwrap().1);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("h.csv");
    std::fs::write(&path, noise).unwrap();
    let data = head::Data::read(&path, &[]).unwrap();
    let head = head::fit(&data, &head::Options::default(), &mut Vec::new()).unwrap();
    assert!(head.held_out_rms_mm > 0.97 * head.before_rms_mm);
}

#[test]
fn absolute_temperatures_are_noticed_and_a_cold_state_can_be_given() {
    let truth = Truth { cold_c: 21.0, ..Truth::sample(3) };
    let (model, warnings) = fitted(&truth, 300, 8, &head::Options::default());
    let noticed = model.head.unwrap();
    assert!(
        noticed.has_constant && warnings.iter().any(|w| w.contains("--cold-c")),
        "{warnings:?}"
    );
    let cold = head::Options { cold_c: vec![21.0; 3], ..head::Options::default() };
    let (model, warnings) = fitted(&truth, 300, 8, &cold);
    let given = model.head.unwrap();
    assert!(!given.has_constant && warnings.is_empty(), "{warnings:?}");
    assert!(given.held_out_rms_mm < 0.0010 && noticed.held_out_rms_mm < 0.0010);
}

#[test]
fn a_table_that_is_pasted_twice_counts_once() {
    let dir = tempfile::tempdir().unwrap();
    let mut rows = String::new();
    for k in 0..60 {
        let t = f64::from(k);
        let (rise, wander) = (12.0 * (1.0 - (-t / 20.0).exp()), 0.0004 * (1.7 * t).sin());
        rows += &format!("{rise:.3},{:.5}\n", 0.004 * rise + wander);
    }
    let [once, twice] = [1, 2].map(|times| {
        let path = dir.path().join(format!("{times}.csv"));
        std::fs::write(&path, format!("head_1_c,displacement_mm\n{}", rows.repeat(times))).unwrap();
        let mut thermal = Command::cargo_bin("pivotsight").unwrap();
        thermal.args(["thermal", "fit", "--head"]).arg(&path).output().unwrap()
    });
    assert_eq!(once.stdout, twice.stdout);
    let said = String::from_utf8(twice.stderr).unwrap();
    assert!(said.contains("2.csv: 60 left out"), "{said}");
}

#[test]
fn a_model_of_the_head_alone_corrects_the_head() {
    let truth = Truth::sample(2);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("head.csv");
    std::fs::write(&path, truth.head_csv(200, 5)).unwrap();
    let options = head::Options::default();
    let data = head::Data::read(&path, &options.cold_c).unwrap();
    let model = fit(Some((&data, &options)), None, Vec::new(), &mut Vec::new()).unwrap();
    let answer = Compensator::new(model, Options::default())
        .answer_line(r#"{"position_mm":{"x":100},"head_c":[3,3]}"#);
    assert_eq!(answer.flags, [""; 0]);
    assert!(answer.correction_mm["x"].unwrap().abs() > 1e-4, "{answer:?}");
}

#[test]
fn a_screw_that_goes_on_warming_is_fitted() {
    // 10 µm/m for each degree above 20 °C, positions cycled while the screw warms from 20 to 38 °C.
    let mut csv = "axis,screw_c,position_mm,error_mm\n".to_owned();
    for i in 0..300 {
        let (t, p) = (20.0 + 0.06 * f64::from(i), 250.0 * f64::from(i % 5));
        let noise = 2e-4 * (f64::from(i) * 2.399).sin();
        csv += &format!("x,{t:.3},{p},{:.6}\n", 1e-5 * (t - 20.0) * p + noise);
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("screw.csv");
    std::fs::write(&path, csv).unwrap();
    let data = screw::Data::read(&path).unwrap();
    let options = screw::Options::default();
    let model = fit(None, Some((&data, &options)), Vec::new(), &mut Vec::new()).unwrap();
    let x = &model.screws[0];
    assert!((x.t0_c - 20.0).abs() < x.t0_u95_c.max(0.05), "{x:?}");
    let per_degree = x.tk_max_um_per_m / (x.t_max_c - x.t0_c);
    assert!((per_degree - 10.0).abs() < 0.1, "{per_degree}");
}

#[test]
fn what_lies_outside_the_calibration_is_flagged_and_held() {
    let (model, _) = fitted(&Truth::sample(4), 300, 2, &head::Options::default());
    let mut at_work = Compensator::new(model, Options { stuck_c: Some(4.0) });
    let mut ask = |text: &str| at_work.answer_line(text);
    let at = |x: f64, t: f64| {
        format!(r#"{{"position_mm":{{"x":{x}}},"screw_c":{{"x":{t}}},"head_c":[2,2,2,2]}}"#)
    };
    let inside = ask(&at(900.0, 38.0));
    assert!(inside.flags.is_empty(), "{:?}", inside.flags);
    let hot = ask(&at(900.0, 55.0));
    assert_eq!(hot.flags, ["screw-above-tmax:x"]);
    assert!((hot.correction_mm["x"].unwrap() - inside.correction_mm["x"].unwrap()).abs() < 1e-9);
    // What the law would add beyond the limit is not corrected: the interval has it.
    assert!(hot.correction_u95_mm["x"] > 2.0 * inside.correction_u95_mm["x"], "{hot:?}");
    let cold = ask(&at(900.0, 10.0));
    assert_eq!(cold.flags, ["screw-below-t0:x"]);
    assert_eq!(ask(&at(5000.0, 30.0)).flags, ["position-out-of-range:x"]);
    for (text, flag, known) in [
        (
            r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[3,null,3,3]}"#,
            "head-dead:2",
            true,
        ),
        (
            r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[3,-273,3,3]}"#,
            "head-dead:2",
            true,
        ),
        (
            r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[null,null,null,null]}"#,
            "head-unknown",
            false,
        ),
        (r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[3]}"#, "head-sensors", false),
        (r#"{"position_mm":{"x":1},"screw_c":{},"head_c":[3,3,3,3]}"#, "screw-missing:x", false),
        (
            r#"{"position_mm":{"x":1},"screw_c":{"x":-127},"head_c":[3,3,3,3]}"#,
            "screw-dead:x",
            false,
        ),
        (
            r#"{"position_mm":{"q":1},"screw_c":{"q":30},"head_c":[3,3,3,3]}"#,
            "axis-not-calibrated:q",
            false,
        ),
    ] {
        let answer = ask(text);
        assert!(answer.flags.iter().any(|f| f.starts_with(flag)), "{flag}: {:?}", answer.flags);
        assert_eq!(answer.correction_mm.values().next().unwrap().is_some(), known, "{text}");
    }
    for text in [
        "",
        "{",
        "[1]",
        r#"{"position_mm":{"x":"a"}}"#,
        r#"{"position_mm":{"x":1},"screw":{}}"#,
        r#"{"position_mm":{"x":1,"X":2}}"#,
        r#"{"position_mm":{"x":1},"screw_c":{"x":30,"x":31}}"#,
    ] {
        let answer = ask(text);
        assert!(
            answer.correction_mm.is_empty() && answer.flags[0].starts_with("bad-line"),
            "{text}"
        );
        // Words for who wrote the line, none of how this program is built.
        assert!(!answer.flags[0].contains("struct"), "{:?}", answer.flags);
    }
    assert!(ask("7").flags[0].contains("position_mm"));
    // The working sensors take over: a dead sensor costs accuracy and says so.
    let all = ask(r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[3,3,3,3]}"#);
    let three = ask(r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[3,3,null,3]}"#);
    assert!(three.correction_u95_mm["x"] > all.correction_u95_mm["x"]);
    ask(r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[3,3,3.5,3]}"#);
    let stuck = ask(r#"{"position_mm":{"x":1},"screw_c":{"x":30},"head_c":[9,2.9,3.5,3.1]}"#);
    assert_eq!(stuck.flags, ["head-stuck:3"]);
}

#[test]
fn the_command_fits_writes_its_model_answers_lines_and_removes_the_error() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name);
    thermal().arg("simulate").arg(dir.path()).assert().success();
    thermal()
        .args(["fit", "--head"])
        .arg(file("head.csv"))
        .arg("--screw")
        .arg(file("screw.csv"))
        .arg("--out")
        .arg(file("model.json"))
        .assert()
        .success();
    let table = thermal()
        .args(["--format", "json", "compensate", "--model"])
        .arg(file("model.json"))
        .arg("--table")
        .arg(file("day.csv"))
        .arg("--plot")
        .arg(dir.path())
        .output()
        .unwrap();
    let json: serde_json::Value = serde_json::from_slice(&table.stdout).unwrap();
    assert_eq!(json["schema"], "pivotsight.thermal-compensate/1");
    let (before, after) =
        (json["before_rms_mm"].as_f64().unwrap(), json["after_rms_mm"].as_f64().unwrap());
    assert!(before > 0.1 && after < 0.0012, "{before} {after}");
    assert!(file("compensation.svg").exists());

    let line = "{\"position_mm\":{\"x\":700},\"screw_c\":{\"x\":30},\"head_c\":[5,3,4,3,2,1]}\n";
    let lines = line.repeat(50_000);
    let out = thermal()
        .args(["compensate", "--model"])
        .arg(file("model.json"))
        .write_stdin(lines)
        .output()
        .unwrap();
    assert_eq!(out.stdout.iter().filter(|&&b| b == b'\n').count(), 50_000);
    let out = thermal()
        .args(["compensate", "--model"])
        .arg(file("model.json"))
        .write_stdin(format!("{line}nonsense\n{line}"))
        .assert()
        .code(3);
    assert_eq!(String::from_utf8_lossy(&out.get_output().stdout).lines().count(), 3);
}

#[test]
fn bad_calibrations_are_refused_with_words() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("c.csv");
    for (kind, text, words) in [
        ("--head", "head_1_c,displacement_mm\n1,2\n2,4\n", "too few"),
        ("--head", "head_1_c,head_3_c,displacement_mm\n1,2,3\n", "head_2_c"),
        ("--head", "displacement_mm\n1\n", "no head sensor"),
        ("--head", "head_1_c,displacement_um\n1,1\n", "displacement_um"),
        (
            "--screw",
            "axis,screw_c,position_mm,error_mm\nx,20,0,0\nx,20,100,0\nx,20,200,0\n",
            "--t0-c",
        ),
        (
            "--screw",
            "axis,screw_c,position_mm,error_mm\nx,20,0,0\nx,30,100,0\nx,40,200,0\n",
            "positions",
        ),
        ("--screw", "axis,screw_c,position_mm,error_mm\n,20,0,0\n", "axis"),
        ("--screw", "axis,screw_c,position_mm,error_mm\nx,20,0,NaN\n", "c.csv:2"),
    ] {
        std::fs::write(&path, text).unwrap();
        let out = thermal().args(["fit", kind]).arg(&path).assert().code(2).get_output().clone();
        let message = String::from_utf8(out.stderr).unwrap();
        assert!(message.contains(words), "{words}: {message}");
    }
    std::fs::write(&path, "{\"schema\":\"pivotsight.rotary/1\"}").unwrap();
    thermal().args(["compensate", "--model"]).arg(&path).write_stdin("").assert().code(2);
}

/// Temperatures taken for rises would bend the coefficients: what looks like them gets a constant, and the user is told.
#[test]
fn a_head_that_gives_temperatures_gets_a_constant_and_a_word() {
    let truth = Truth { cold_c: 20.0, ..Truth::sample(3) };
    let mut hits = (0, 0);
    for seed in 0..20 {
        let (model, warnings) = fitted(&truth, 120, seed, &head::Options::default());
        assert!(warnings.iter().any(|w| w.contains("look like temperatures")), "{warnings:?}");
        let head = model.head.unwrap();
        for (c, a) in head.coefficients.iter().zip(&truth.head_mm_per_c) {
            hits.0 += usize::from((c.mm_per_c - a).abs() < c.mm_per_c_u95);
            hits.1 += 1;
        }
    }
    assert!(hits.0 * 10 > hits.1 * 8, "{hits:?}");
}

#[test]
fn a_mistyped_reading_of_a_screw_is_named() {
    let csv = Truth::sample(4).screw_csv(&[0.0, 6.0, 12.0, 18.0], 9, 7);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("screw.csv");
    for slip_mm in [0.0, 0.05, 5.0] {
        let mut lines: Vec<String> = csv.lines().map(str::to_owned).collect();
        let (head, error) = lines[12].rsplit_once(',').unwrap();
        lines[12] = format!("{head},{}", error.parse::<f64>().unwrap() + slip_mm);
        std::fs::write(&path, lines.join("\n") + "\n").unwrap();
        let mut warnings = Vec::new();
        let screw = screw::Data::read(&path).unwrap();
        let options = screw::Options::default();
        let fitted = fit(None, Some((&screw, &options)), Vec::new(), &mut warnings);
        let said = fitted.map_or_else(|e| e.to_string(), |_| warnings.join("\n"));
        let place = lines[12].split(',').nth(2).unwrap().parse::<f64>().unwrap();
        let named = said.contains("the reading at") && said.contains(&format!("{place} mm lies"));
        assert_eq!(named, slip_mm > 0.0, "{slip_mm}: {said}");
        assert!(!said.contains("no correction"), "{slip_mm}: {said}");
    }
}
