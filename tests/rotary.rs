//! Rotary axis correction: the source's machine, truth from a simulated axis, tables for controls, bad input.

#![allow(clippy::unwrap_used)]

use assert_cmd::Command;
use pivotsight::rotary::{Options, Report, Sweep, correct, simulate::Truth};
use pivotsight::table::Table;

fn rotary() -> Command {
    let mut command = Command::cargo_bin("pivotsight").unwrap();
    command.arg("rotary");
    command
}

fn sweep(csv: &str) -> Sweep {
    let table = Table::parse(
        "s.csv",
        csv.as_bytes(),
        &["angle_deg", "deviation_mm"],
        &["dir", "run", "comp_deg"],
    );
    Sweep::from_table(&table.unwrap(), false).unwrap()
}

/// Angle, printed new entry, confidence.
type Printed = (f64, f64, String);

fn k197(pivot_mm: f64) -> Option<(Report, Vec<Printed>)> {
    let path = "../shared/data/k197-1.csv";
    let mut reader =
        csv::Reader::from_path(path).map_err(|e| eprintln!("skipped: {path}: {e}")).ok()?;
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let text: String = rows.iter().map(|r| format!("{},{},{}\n", &r[0], &r[1], &r[3])).collect();
    let truth = rows
        .iter()
        .map(|r| (r[0].parse().unwrap(), r[4].parse().unwrap(), r[8].to_owned()))
        .collect();
    let options = Options { dead_band_mm: 0.010, ..Options::new(pivot_mm) };
    Some((
        correct(&sweep(&format!("angle_deg,deviation_mm,comp_deg\n{text}")), &options).unwrap(),
        truth,
    ))
}

#[test]
fn the_source_table_comes_out_at_573_mm_and_is_over_corrected_at_700_mm() {
    let Some((report, truth)) = k197(573.0) else { return };
    let mut certain = 0;
    for (row, (angle, comp, confidence)) in report.rows.iter().zip(&truth) {
        assert_eq!(row.angle_deg, *angle);
        if confidence == "high" {
            certain += 1;
            assert!((row.comp_new_deg - comp).abs() < 1e-4, "{angle}: {} {comp}", row.comp_new_deg);
        }
    }
    assert_eq!(certain, 24);
    assert!(report.summary.printed_rule.over_correction_percent.abs() < 0.1);

    let Some((report, truth)) = k197(700.0) else { return };
    let rule = &report.summary.printed_rule;
    assert!((rule.over_correction_percent - 22.2).abs() < 0.1);
    // The printed table, on an axis of 700 mm, leaves a fifth of the largest deviation.
    assert!((rule.worst_left_mm - 0.083 * 0.222).abs() < 1e-3, "{}", rule.worst_left_mm);
    let (row, printed) = (&report.rows[36], &truth[36]);
    let ratio = (row.comp_old_deg - printed.1) / (row.comp_old_deg - row.comp_new_deg);
    assert!((ratio - 1.222).abs() < 0.003, "{ratio}");
}

/// A pitch error with a backlash of 0.002°.
fn error_deg(angle: f64, dir: i8) -> f64 {
    0.008 * (angle / 60.0).sin() + 0.002 * (angle / 9.0).cos() + 0.001 * f64::from(dir)
}

#[test]
fn stated_intervals_hold_with_noise_run_shifts_and_an_uncertain_length() {
    let angles: Vec<f64> = (-9..=9).map(|i| 10.0 * f64::from(i)).collect();
    let (mut inside, mut all) = (0, 0);
    for seed in 0..300 {
        // The true length differs from the stated 600 mm by a draw of its uncertainty.
        let off = [-1.6, -0.9, -0.4, 0.0, 0.3, 0.8, 1.7][seed as usize % 7];
        let truth =
            Truth { error_deg, pivot_mm: 600.0 + 3.0 * off, noise_mm: 0.004, run_shift_mm: 0.002 };
        let runs = if seed % 2 == 0 { 3 } else { 5 };
        let csv = truth.sweep(&angles, &[1, -1], runs, seed);
        let report =
            correct(&sweep(&csv), &Options { pivot_u_mm: 3.0, ..Options::new(600.0) }).unwrap();
        for row in &report.rows {
            let dir = if serde_json::to_value(row.dir).unwrap() == "-" { -1 } else { 1 };
            all += 1;
            inside += usize::from(
                (row.error_deg - error_deg(row.angle_deg, dir)).abs() <= row.error_u95_deg.unwrap(),
            );
        }
    }
    let coverage = 100.0 * inside as f64 / all as f64;
    assert!((93.0..98.5).contains(&coverage), "{coverage} %");
}

#[test]
fn shifts_of_runs_are_in_the_intervals_without_a_column_run_and_with_a_noise_given() {
    let angles: Vec<f64> = (-9..=9).map(|i| 10.0 * f64::from(i)).collect();
    let truth = Truth { error_deg, pivot_mm: 600.0, noise_mm: 0.001, run_shift_mm: 0.001 };
    for noise_mm in [None, Some(0.001)] {
        let (mut inside, mut all) = (0, 0);
        for seed in 0..200 {
            let csv = truth.sweep(&angles, &[1, -1], 5, seed);
            let runs = csv.lines().map(|l| l.rsplit_once(',').unwrap().0);
            let unnamed: String = runs.map(|l| format!("{l}\n")).collect();
            let csv = if noise_mm.is_some() { csv } else { unnamed };
            let report =
                correct(&sweep(&csv), &Options { noise_mm, ..Options::new(600.0) }).unwrap();
            for row in &report.rows {
                let dir = if serde_json::to_value(row.dir).unwrap() == "-" { -1 } else { 1 };
                let off = row.error_deg - error_deg(row.angle_deg, dir);
                all += 1;
                inside += usize::from(off.abs() <= row.error_u95_deg.unwrap());
            }
        }
        let coverage = 100.0 * inside as f64 / all as f64;
        assert!((94.0..98.5).contains(&coverage), "{noise_mm:?}: {coverage} %");
    }
}

#[test]
fn the_new_table_removes_the_error_from_both_directions() {
    let angles: Vec<f64> = (-18..=18).map(|i| 5.0 * f64::from(i)).collect();
    let before = Truth { error_deg, pivot_mm: 650.0, noise_mm: 0.0005, run_shift_mm: 0.0 };
    let report =
        correct(&sweep(&before.sweep(&angles, &[1, -1], 2, 3)), &Options::new(650.0)).unwrap();
    assert!((report.summary.reversal_deg.unwrap() - 0.002).abs() < 1e-4);
    let corrected = |angle: f64, dir: i8| {
        let row = report.rows.iter().find(|r| {
            r.angle_deg == angle && (serde_json::to_value(r.dir).unwrap() == "-") == (dir < 0)
        });
        error_deg(angle, dir) + row.unwrap().comp_new_deg
    };
    let after =
        Truth { error_deg: corrected, pivot_mm: 650.0, noise_mm: 0.0005, run_shift_mm: 0.0 };
    let verified =
        correct(&sweep(&after.sweep(&angles, &[1, -1], 2, 4)), &Options::new(650.0)).unwrap();
    assert!(report.summary.before_max_mm > 0.08);
    assert!(verified.summary.before_max_mm < 0.003);
    let inside = report.rows.iter().zip(&verified.rows).filter(|(expected, got)| {
        (got.deviation_mm - expected.predicted_deviation_mm).abs()
            <= expected.predicted_u95_mm.unwrap()
    });
    assert!(inside.count() as f64 > 0.9 * report.rows.len() as f64);
}

#[test]
fn controls_get_their_tables_in_their_own_sense() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("s.csv");
    let mut text = String::from("angle_deg,deviation_mm,dir\n");
    for i in 0..9 {
        let y = 0.02 * f64::from(i % 8) / 7.0;
        text.push_str(&format!("{0},{y},+\n{0},{1},-\n", 45 * i, y + 0.006));
    }
    std::fs::write(&input, text).unwrap();
    let table = |control: &str, more: &[&str]| {
        let out = dir.path().join("table");
        rotary()
            .arg(&input)
            .args(["--pivot-mm", "573", "--noise-mm", "0.001", "--modulo", "--control", control])
            .arg("--table")
            .arg(&out)
            .args(more)
            .assert()
            .success();
        std::fs::read_to_string(out).unwrap()
    };
    let siemens = table("siemens", &["--axis", "C1"]);
    assert!(siemens.contains("$AA_ENC_COMP[0,7,C1]=0.0023\n"), "{siemens}");
    assert!(siemens.contains("$AA_ENC_COMP_IS_MODULO[0,C1]=1\nM17\n"), "{siemens}");
    // The axis lags by 0.0006° whichever way it goes: the control's backlash is positive.
    assert!(siemens.contains("backlash 0.0006: add it to MD32450"), "{siemens}");
    assert!(siemens.contains("STEP[0,C1]=45.0\n") && siemens.contains("MAX[0,C1]=360.0\n"));
    let linuxcnc = table("linuxcnc", &[]);
    assert!(linuxcnc.contains("315.000000 -0.0020 -0.0026\n"), "{linuxcnc}");
    assert_eq!(linuxcnc.lines().count(), 9);
    let fanuc = table("fanuc", &["--reference-point", "60"]);
    let steps: Vec<i32> = fanuc
        .lines()
        .filter(|l| l.starts_with("N100"))
        .map(|l| l.split('P').nth(1).unwrap().parse().unwrap())
        .collect();
    assert!(fanuc.contains("N3622A4P68\n") && fanuc.contains("N10061P"), "{fanuc}");
    assert_eq!(steps.len(), 16, "eight sections of a turn, both directions");
    assert_eq!(steps[..8].iter().sum::<i32>(), 0, "a turn adds up to nothing");
    assert!(steps.iter().all(|s| s.abs() <= 7));
    // From another reference the same turn begins elsewhere.
    let turned = table("fanuc", &["--reference-point", "60", "--reference-deg", "90"]);
    let sections = |text: &str| -> Vec<i32> {
        let values = text.lines().filter(|l| l.starts_with("N100"));
        values.take(8).map(|l| l.split('P').nth(1).unwrap().parse().unwrap()).collect()
    };
    let (mut from_zero, from_90) = (sections(&fanuc), sections(&turned));
    from_zero.rotate_left(2);
    let apart = from_zero.iter().zip(&from_90).map(|(a, b)| (a - b).abs()).max();
    assert!(apart <= Some(1), "rounded from another start: {from_zero:?}, {from_90:?}");
    // Absolute and incremental tables say the same.
    let read = |text: String| -> Vec<f64> {
        text.lines().skip(1).map(|l| l.split(',').nth(1).unwrap().parse().unwrap()).collect()
    };
    let (absolute, steps) = (read(table("csv", &[])), read(table("csv", &["--incremental"])));
    let mut sum = 0.0;
    for (a, s) in absolute.iter().zip(&steps) {
        sum += s;
        assert!((a - sum).abs() < 1e-9);
    }
    // Steps are nil at their reference: what the table is there, at 90°, is in none of them.
    let steps = read(table("csv", &["--incremental", "--reference-deg", "90"]));
    assert!((steps[0] + absolute[2]).abs() < 1e-9 && absolute[2].abs() > 1e-4, "{absolute:?}");
}

/// 0.2 mm at 20°, 600 mm from the axis, is 0.019099°: a table of steps of 0.01° corrects 0.02°, one of points 40° apart nothing.
#[test]
fn what_is_expected_is_what_the_controls_table_leaves() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("s.csv");
    let rows = "angle_deg,deviation_mm\n0,0\n10,0.1\n20,0.2\n30,0.1\n40,0\n";
    std::fs::write(&input, rows).unwrap();
    let expected = |arguments: &str| {
        let mut command = rotary();
        command.arg(&input).args(["--pivot-mm", "600", "--noise-mm", "0.001", "--format", "json"]);
        let table = dir.path().join("table");
        let out = command.arg("--table").arg(&table).args(arguments.split(' ')).output().unwrap();
        let json: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let left = json["summary"]["after_table_max_mm"].as_f64().unwrap();
        (left, json["warnings"].to_string().contains("the table as written leaves"))
    };
    // FANUC's table has whole steps of -7 to 7.
    let (left, _) = expected("--control fanuc");
    assert!((0.004..0.006).contains(&left), "{left}");
    for control in ["csv", "siemens", "linuxcnc"] {
        let (left, told) = expected(&format!("--control {control}"));
        assert!(left < 6e-4 && !told, "{control}: {left}");
        let (left, told) = expected(&format!("--control {control} --resolution-deg 0.01"));
        assert!((left - 0.0094).abs() < 5e-4 && told, "{control}: {left}");
    }
    let (left, told) = expected("--control csv --step-deg 40");
    assert!((left - 0.2).abs() < 1e-3 && told, "{left}");
}

#[test]
fn old_tables_are_read_in_either_sense_and_as_steps() {
    let base = "angle_deg,deviation_mm,comp_deg\n-10,0.02,";
    let absolute = sweep(&format!("{base}-0.003\n0,0,0\n10,0.01,0.004\n"));
    let a = correct(&absolute, &Options::new(600.0)).unwrap();
    let steps = sweep(&format!("{base}0\n0,0,0.003\n10,0.01,0.004\n"));
    let s = correct(&steps, &Options { incremental: true, ..Options::new(600.0) }).unwrap();
    let siemens = sweep(&format!("{base}0.003\n0,0,0\n10,0.01,-0.004\n"));
    let m = correct(&siemens, &Options { comp_sense: -1.0, ..Options::new(600.0) }).unwrap();
    for i in 0..3 {
        assert!((a.rows[i].comp_new_deg - s.rows[i].comp_new_deg).abs() < 1e-12);
        assert!((a.rows[i].comp_new_deg - m.rows[i].comp_new_deg).abs() < 1e-12);
    }
    assert_eq!(a.rows[0].error_u95_deg, None, "three readings tell no noise");
}

#[test]
fn bad_input_is_named_and_measures_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("s.csv");
    for (text, args, words) in [
        ("angle_deg,deviation_mm\n0,0.01\n", &["--pivot-mm", "0"][..], "--pivot-mm"),
        (
            "angle_deg,deviation_mm\n0,0.01\n",
            &["--pivot-mm", "600", "--dead-band-mm=-1"],
            "--dead-band-mm",
        ),
        ("angle_deg,deviation_mm\n0,90\n", &["--pivot-mm", "600"], "units"),
        (
            "angle_deg,deviation_mm\n0,inf\n",
            &["--pivot-mm", "600"],
            "s.csv:2: column 'deviation_mm'",
        ),
        ("angle_deg,deviation_um\n0,1\n", &["--pivot-mm", "600"], "deviation_um"),
        ("angle_deg,deviation_mm,dir\n0,1,sideways\n", &["--pivot-mm", "600"], "'sideways'"),
        ("angle_deg,deviation_mm,dir\n0,0.1,+\n5,0.1,\n", &["--pivot-mm", "600"], "some do not"),
        ("angle_deg,deviation_mm,comp_deg\n0,0,1\n0,0,2\n", &["--pivot-mm", "600"], "comp_deg"),
        (
            "angle_deg,deviation_mm\n0,0.01\n",
            &["--pivot-mm", "600", "--table", "t.csv"],
            "--step-deg",
        ),
        (
            "angle_deg,deviation_mm\n5,0.01\n",
            &["--pivot-mm", "600", "--table", "t.csv", "--step-deg", "1"],
            "no two angles",
        ),
        (
            "angle_deg,deviation_mm\n0,0.01\n",
            &["--pivot-mm", "600", "--reference-point", "4294967295"],
            "--reference-point",
        ),
        (
            "angle_deg,deviation_mm\n0,0.01\n5,0.01\n9.8,0.01\n15,0.01\n",
            &["--pivot-mm", "600", "--table", "t.csv"],
            "angle_deg: the smallest step between the measured angles, 4.800000°, does not divide",
        ),
    ] {
        std::fs::write(&input, text).unwrap();
        let out = rotary().arg(&input).args(args).assert().code(2).get_output().clone();
        let message = String::from_utf8(out.stderr).unwrap();
        assert!(message.contains(words), "{words}: {message}");
        assert!(out.stdout.is_empty());
    }
}

#[test]
fn a_copied_run_counts_once_and_is_told() {
    let header = "angle_deg,deviation_mm,run\n".to_owned();
    let rows = |run: &str, values: [&str; 5]| -> String {
        let row = |(i, v): (usize, &&str)| format!("{},{v},{run}\n", 10 * i);
        values.iter().enumerate().map(row).collect()
    };
    let first = rows("a", ["0.001", "0.011", "0.019", "0.032", "0.041"]);
    let second = ["0.003", "0.010", "0.022", "0.030", "0.040"];
    let two = header + &first + &rows("b", second);
    let three = format!("{two}{}", rows("c", second));
    let (two, three) = (sweep(&two), sweep(&three));
    assert!(two.warnings.is_empty());
    assert!(three.warnings[0].contains("run 'c'") && three.warnings[0].contains("run 'b'"));
    let noise = |s: &Sweep| (s.noise(None).reading_mm, s.groups[2].mean_mm, s.groups[2].readings);
    assert_eq!(noise(&two), noise(&three));
    // Of two runs that are alike the dial's last digit may be why, unless its noise is told to be larger.
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("twice.csv");
    std::fs::write(
        &path,
        format!("angle_deg,deviation_mm,run\n{first}{}", first.replace(",a\n", ",b\n")),
    )
    .unwrap();
    for (noise_mm, told) in [("0.002", true), ("0.0003", false)] {
        let out = rotary()
            .arg(&path)
            .args(["--pivot-mm", "400", "--noise-mm", noise_mm])
            .output()
            .unwrap();
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(said.contains("a run was copied"), told, "{noise_mm}: {said}");
    }
}

/// A dial read to its last digit repeats exactly and is not exact; a place that one run saw has that run's shift; and a wrong L makes a
/// correction wrong in proportion.
#[test]
fn intervals_hold_the_last_digit_the_runs_and_the_length() {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut draw = |sd: f64| Normal::new(0.0, sd).unwrap().sample(&mut random);
    let (mut read, mut alone, mut next) = ((0, 0), (0, 0), (0, 0));
    let count = |of: &mut (usize, usize), inside: bool| {
        of.0 += usize::from(inside);
        of.1 += 1;
    };
    for _ in 0..60 {
        // The whole circle's error at L = 500 mm, read to a hundredth; and the last place by one run of five alone, to all digits.
        let truth = |angle: f64| 0.03 * angle.to_radians().sin();
        let (mut coarse, mut fine) = (String::from("angle_deg,run,deviation_mm\n"), String::new());
        for run in 0..5 {
            let shift = draw(0.004);
            for angle in (0..360).step_by(15).map(f64::from) {
                coarse += &format!("{angle},{run},{:.2}\n", truth(angle) + draw(0.001));
                if run == 0 || angle < 345.0 {
                    fine += &format!("{angle},{run},{:.6}\n", truth(angle) + shift + draw(0.001));
                }
            }
        }
        let options = Options::new(500.0);
        for row in correct(&sweep(&coarse), &options).unwrap().rows {
            let off = row.deviation_mm - truth(row.angle_deg);
            count(&mut read, off.abs() < row.deviation_u95_mm.unwrap());
        }
        let fine = sweep(&format!("angle_deg,run,deviation_mm\n{fine}"));
        let row = correct(&fine, &options).unwrap().rows.pop().unwrap();
        count(&mut alone, (row.deviation_mm - truth(345.0)).abs() < row.deviation_u95_mm.unwrap());
        // L is 2 mm off in one of three: what a correction of 0.4 mm leaves.
        let off = draw(1.0);
        let text: String = (0..30)
            .map(|k| format!("{},{},{:.6}\n", 10 * (k % 10), k / 10, 0.4 + draw(0.0003)))
            .collect();
        let measured = sweep(&format!("angle_deg,run,deviation_mm\n{text}"));
        let options = Options { pivot_u_mm: 1.0, ..Options::new(200.0 + off) };
        for row in correct(&measured, &options).unwrap().rows {
            // The true axis is at 200 mm.
            let left = 0.4 - 200.0 * (0.4 / (200.0 + off)) + draw(0.0003);
            count(
                &mut next,
                (left - row.predicted_deviation_mm).abs() < row.predicted_u95_mm.unwrap(),
            );
        }
    }
    for (what, (held, all)) in [("read", read), ("alone", alone), ("next", next)] {
        assert!(held as f64 > 0.9 * all as f64, "{what}: {held} of {all}");
    }
}
