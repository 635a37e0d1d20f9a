//! Records, regression, defaults, log, schemas, completions and man pages, end to end.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

#[path = "common/program.rs"]
mod program;

use std::path::Path;

use program::{ok, refused, run, session, write_session};

#[test]
fn a_place_where_no_records_can_be_kept_is_told_before_and_a_failure_after_costs_no_result() {
    let dir = session();
    let dir = dir.path();
    let records = |path: &str, words: &str| {
        refused(dir, &["solve", "session.toml", "--records", path], words);
    };
    records("no/where/r.sqlite", "does not exist");
    records(".", "is a folder");
    std::fs::write(dir.join("notes.txt"), "not a database, but long enough to be looked at")
        .unwrap();
    records("notes.txt", "notes.txt: the records cannot be used");
    assert!(!dir.join("r.sqlite").exists());
    ok(dir, &["schema", "burn", "--records", "no/where/r.sqlite"]);
    ok(dir, &["solve", "session.toml", "--records", "r.sqlite"]);
    let full =
        "CREATE TRIGGER full BEFORE INSERT ON records BEGIN SELECT RAISE(FAIL, 'no room'); END";
    rusqlite::Connection::open(dir.join("r.sqlite")).unwrap().execute_batch(full).unwrap();
    let output = run(dir, &["solve", "session.toml", "--records", "r.sqlite", "--quiet"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("r.sqlite") && said.contains("no room"), "{said}");
    assert!(output.status.success() && !output.stdout.is_empty(), "{said}");
}

#[test]
fn records_are_kept_listed_exported_and_drift_is_told() {
    let dir = session();
    let dir = dir.path();
    for i in 0..5 {
        write_session(dir, if i == 4 { 0.303 } else { 0.283 });
        ok(dir, &["solve", "session.toml", "--records", "r.sqlite"]);
    }
    let list = ok(dir, &["history", "--records", "r.sqlite", "--plot", "plots"]);
    assert!(list.contains("5 records") && list.contains("warning: drift: ΔX"), "{list}");
    assert!(std::fs::read_to_string(dir.join("plots/history.svg")).unwrap().contains("ΔX"));
    let lines = ok(dir, &["history", "export", "--records", "r.sqlite", "--last", "2"]);
    let records: Vec<serde_json::Value> =
        lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(records.len(), 2);
    assert_eq!(records[1]["command"], "solve");
    assert!(records[1]["result"]["delta_x_mm"].as_f64().is_some_and(|x| (x - 0.303).abs() < 1e-9));
    assert_eq!(records[1]["input_sha256"].as_str().map(str::len), Some(64));
    assert!(
        ok(dir, &["history", "--records", "r.sqlite", "--since", "2100-01-01"])
            .contains("0 records")
    );
    let empty = ["history", "export", "--records", "r.sqlite", "--input", "zzz"];
    assert_eq!(ok(dir, &empty) + &ok(dir, &[&empty[..], &["--format", "csv"]].concat()), "");
    let output = run(dir, &["history", "--records", "r.sqlite", "--command", "slove"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("the file holds: solve 5"), "{said}");
    refused(dir, &["history"], "--records: is missing");
    refused(dir, &["history", "--records", "r.sqlit"], "there are no records");
    refused(dir, &["history", "--records", "r.sqlit"], "did you mean 'r.sqlite'?");
    refused(dir, &["history", "--records", "session.toml"], "cannot be used");
    refused(
        dir,
        &["history", "--records", "r.sqlite", "--since", "2026-02-30"],
        "--since: is not a date",
    );
    let since = ["history", "--records", "r.sqlite", "--since", "2026-02-01"];
    refused(dir, &[&since[..], &["--until", "2026-01-01"]].concat(), "is not after --since");
}

/// A picture that is measured again is no further evidence, and a picture is as old as it is, not as its measurement.
#[test]
fn records_count_a_picture_once_and_know_when_it_was_taken() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let images = Path::new(env!("CARGO_MANIFEST_DIR")).join("images/burn-clean");
    let image = images.join("burn-0001.png");
    let calib = images.join("calib.toml");
    let burn = ["burn", image.to_str().unwrap(), "--calib", calib.to_str().unwrap()];
    let keep = ["--records", "r.sqlite", "--taken"];
    for time in ["2026-11-01", "2026-11-02T08:30:00Z", "file"] {
        run(dir, &[&burn[..], &keep, &[time]].concat());
    }
    let list = ok(dir, &["history", "--records", "r.sqlite", "--plot", "p"]);
    assert!(
        list.contains("2026-11-01T00:00:00Z") && list.contains("2026-11-02T08:30:00Z"),
        "{list}"
    );
    let plot = std::fs::read_to_string(dir.join("p/history.svg")).unwrap();
    assert!(plot.matches("<circle").count() <= 3, "one point in each of three panels");
    let bad = [&burn[..], &keep, &["yesterday"]].concat();
    assert!(String::from_utf8_lossy(&run(dir, &bad).stderr).contains("is no time"));
}

#[test]
fn regression_tells_drift_and_takes_new_values_only_when_asked() {
    let dir = session();
    let case = dir.path().join("cases/one");
    std::fs::create_dir_all(&case).unwrap();
    std::fs::rename(dir.path().join("session.toml"), case.join("session.toml")).unwrap();
    std::fs::write(case.join("case.toml"), "args = [\"solve\", \"session.toml\"]\n").unwrap();
    let expected = case.join("expected.csv");
    std::fs::write(
        &expected,
        "key,value,tolerance\nschema,pivotsight.solve/1,\ndelta_x_mm,0.283,1e-6\nr_mm,214.6,1e-6\n",
    )
    .unwrap();
    let dir = dir.path();
    let output = run(dir, &["regress", "cases", "--junit", "junit.xml"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("FAIL one")
            && text.contains("r_mm: expected 214.6")
            && !text.contains("delta_x_mm"),
        "{text}"
    );
    assert!(std::fs::read_to_string(dir.join("junit.xml")).unwrap().contains("failures=\"1\""));
    ok(dir, &["regress", "cases", "--update"]);
    ok(dir, &["regress", "cases"]);
    let junit = ["regress", "cases", "--junit", "cases/one/expected.csv"];
    refused(dir, &junit, "--junit: ");
    refused(dir, &["regress", "plots"], "plots: cannot read");
    std::fs::rename(&expected, dir.join("e.csv")).unwrap();
    refused(dir, &["regress", "cases"], "the table of expected values is missing");
    // From nothing: what has an uncertainty is held to a tenth of it, beside a case that cannot be run.
    ok(dir, &["regress", "cases", "--update"]);
    let made = std::fs::read_to_string(&expected).unwrap();
    assert!(
        made.contains("schema,pivotsight.solve/1,\n") && made.contains("\nr_mm,214."),
        "{made}"
    );
    assert!(!made.contains("u95"), "{made}");
    ok(dir, &["regress", "cases"]);
    let broken = dir.join("cases/broken");
    std::fs::create_dir(&broken).unwrap();
    std::fs::write(broken.join("case.toml"), "arg = []\n").unwrap();
    let beside = String::from_utf8(run(dir, &["regress", "cases"]).stdout).unwrap();
    assert!(beside.contains("FAIL broken") && beside.contains("ok   one"), "{beside}");
    std::fs::remove_dir_all(&broken).unwrap();
    std::fs::write(&expected, "key,value,tolerance\nr_mm,much,1e-6\n").unwrap();
    refused(dir, &["regress", "cases"], "expected.csv:2: column 'value'");
    std::fs::write(&expected, "key,value,tolerance\nr_mm,214.7,-1e-6\n").unwrap();
    refused(dir, &["regress", "cases"], "expected.csv:2: column 'tolerance': is negative");
    std::fs::write(&expected, "key,value,tolerance\nr_m,214.7,1e-6\n").unwrap();
    let misspelt = String::from_utf8(run(dir, &["regress", "cases"]).stdout).unwrap();
    assert!(misspelt.contains("got nothing: did you mean the key 'r_mm'?"), "{misspelt}");
    // What is refused has no values to expect.
    let refusal = dir.join("refusal");
    std::fs::create_dir(&refusal).unwrap();
    let toml = |args: &str| std::fs::write(refusal.join("case.toml"), args).unwrap();
    toml("args = [\"solve\", \"none.toml\"]\nexit_code = 2\n");
    assert!(ok(dir, &["regress", "refusal"]).contains("ok   refusal"));
    // What fails before anything is compared is in the rows all the same.
    toml("args = [\"solve\", \"none.toml\"]\nexit_code = 1\n");
    std::fs::write(refusal.join("expected.csv"), "key,value,tolerance\nr_mm,1,1\n").unwrap();
    let rows =
        String::from_utf8(run(dir, &["regress", "refusal", "--format", "csv"]).stdout).unwrap();
    assert!(rows.contains("refusal") && rows.contains("exit code 2 instead of 1"), "{rows}");
    std::fs::remove_file(refusal.join("expected.csv")).unwrap();
    toml("args = [\"solve\", \"none.toml\", \"--format=csv\"]\nexit_code = 2\n");
    refused(dir, &["regress", "refusal"], "case.toml: args: has --format=csv");
    // A case that runs the cases it is one of would never end.
    std::fs::write(&expected, "key,value,tolerance\nr_mm,214.7,1e-6\n").unwrap();
    std::fs::write(case.join("case.toml"), "args = [\"regress\", \"..\"]\n").unwrap();
    let output = run(dir, &["regress", "cases"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.code() == Some(1) && text.contains("cannot run cases"), "{text}");
}

#[test]
fn defaults_come_from_the_configuration_and_the_command_line_wins() {
    let dir = session();
    let dir = dir.path();
    std::fs::write(
        dir.join("config.toml"),
        "records = \"kept.sqlite\"\nlog = \"log.txt\"\n[solve]\nformat = \"csv\"\n",
    )
    .unwrap();
    assert!(ok(dir, &["solve", "session.toml"]).starts_with("schema,version"));
    assert!(ok(dir, &["solve", "session.toml", "--format", "json"]).starts_with('{'));
    assert!(ok(dir, &["history"]).contains("2 records"));
    // A table in a table is a command of the command; what the outer one sets does not disturb the inner.
    std::fs::write(
        dir.join("config.toml"),
        "quiet = true\n[align]\ntouch-u-mm = 0.002\n[align.apply]\ndecimals = 3\nmachine = \"m.toml\"\n",
    )
    .unwrap();
    refused(
        dir,
        &["align", "apply", "-q", "--align", "a.json", "a.cl", "b.cl"],
        "a.json: cannot read",
    );
    std::fs::write(
        dir.join("config.toml"),
        "records = \"kept.sqlite\"\nlog = \"log.txt\"\n[solve]\nformat = \"csv\"\n",
    )
    .unwrap();
    assert!(ok(dir, &["config"]).contains("kept.sqlite"));
    refused(dir, &["solve", "none.toml"], "none.toml");
    let log = std::fs::read_to_string(dir.join("log.txt")).unwrap();
    assert!(log.contains("ended: good") && log.contains("ended: none.toml"), "{log}");
    // Its paths are seen from the file's folder.
    std::fs::create_dir(dir.join("sub")).unwrap();
    std::fs::remove_file(dir.join("kept.sqlite")).unwrap();
    let mut elsewhere = std::process::Command::new(assert_cmd::cargo::cargo_bin!("pivotsight"));
    elsewhere.current_dir(dir.join("sub")).env("PIVOTSIGHT_CONFIG", dir.join("config.toml"));
    assert!(elsewhere.args(["solve", "../session.toml"]).output().unwrap().status.success());
    assert!(dir.join("kept.sqlite").exists() && !dir.join("sub/kept.sqlite").exists());
    // What is said on the command line is not held against what does not go with it here.
    // A default that needs an option which is not there waits for a call that has it.
    std::fs::write(
        dir.join("config.toml"),
        "[rotary]\npivot-mm = 573\ncontrol = \"siemens\"\naxis = \"C1\"\n",
    )
    .unwrap();
    let sweep = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/examples/k197-1.csv");
    let sweep = sweep.to_str().unwrap();
    ok(dir, &["rotary", sweep]);
    ok(dir, &["rotary", sweep, "--table", "t.spf"]);
    assert!(std::fs::read_to_string(dir.join("t.spf")).unwrap().contains("C1"));
    refused(dir, &["rotary", sweep, "--step-deg", "10"], "--table <FILE>");
    std::fs::write(dir.join("config.toml"), "[verify]\ndata = \"none.csv\"\n").unwrap();
    refused(dir, &["verify", "--plan", "s.csv", "--machine", "m.toml"], "m.toml: cannot read");
    for (config, words) in [
        ("[fly]\na = 1\n", "fly"),
        ("[slove]\na = 1\n", "did you mean 'solve'?"),
        (
            "[burn]\ntolerance-mm = \"thin\"\n",
            "config.toml: burn.tolerance-mm: cannot be \"thin\"; give a number",
        ),
        ("[burn]\ntolerance-mm = [1, 2]\n", "give one value, not a list"),
        ("[burn]\nnear-mm = 3\n", "give two numbers in mm: X,Y"),
        ("[burn]\ncalib = 3\n", "give the name of a file"),
        ("format = \"jsn\"\n", "format: cannot be \"jsn\"; give one of: table, json"),
        ("[calib]\ntarget = \"x\"\n", "[calib.camera]"),
        ("[calib.camera]\ntarget = 5\n", "calib.camera.target: cannot be 5"),
        ("[ballbar.plan]\nradius = \"x\"\n", "ballbar.plan.radius"),
        ("[solve]\nspeed = 1\n", "has no option --speed"),
        ("[burn]\ntolerance_mm = 0.02\n", "did you mean 'tolerance-mm'?"),
        ("quiet = \"x\"\n", "quiet: cannot be \"x\"; write true or false"),
    ] {
        std::fs::write(dir.join("config.toml"), config).unwrap();
        for args in [&["solve", "session.toml"][..], &["config"]] {
            refused(dir, args, words);
        }
    }
}

#[test]
fn shells_and_manuals_know_every_command() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell"] {
        assert!(ok(dir.path(), &["completions", shell]).contains("history"), "{shell}");
    }
    ok(dir.path(), &["man", "--out", "man", "--quiet"]);
    let page = std::fs::read_to_string(dir.path().join("man/pivotsight-batch.1")).unwrap();
    assert!(page.contains("resume") && dir.path().join("man/pivotsight.1").exists());
    refused(dir.path(), &["man", "fly"], "not a command");
}

#[test]
fn the_projects_own_pictures_measure_as_their_truth_says() {
    let images = Path::new(env!("CARGO_MANIFEST_DIR")).join("images");
    let dir = tempfile::tempdir().unwrap();
    let (images, junit) = (images.display().to_string(), "regress.xml");
    let output = run(dir.path(), &["regress", &images, "--junit", junit]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    let xml = std::fs::read_to_string(dir.path().join(junit)).unwrap();
    assert!(xml.contains("tests=\"5\" failures=\"0\""), "{xml}");
}
