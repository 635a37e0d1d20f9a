//! The batch command end to end: it is killed, fed bad files, asked twice, and always ends with the same bytes.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};

fn pivotsight() -> Command {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("pivotsight"));
    command.env("PIVOTSIGHT_CONFIG", "none");
    command
}

/// A folder with `n` small pictures of a disc, a calibration and a job.
fn workshop(n: usize) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("in");
    std::fs::create_dir(&input).unwrap();
    for i in 0..n {
        picture(&input.join(format!("p{i:04}.png")), 30.0 + (i % 7) as f64 * 0.1);
    }
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("cam.toml", "schema = 1\nname = \"test\"\n[scale]\nmm_per_px = 0.01\n");
    write(
        "job.toml",
        "schema = 1\ncalib = \"cam.toml\"\n[measure.circles]\nexpect_mm = [0.6]\n\
         [limits]\n\"circles.0.diameter_mm\" = { min = 0.5, max = 0.7 }\n",
    );
    dir
}

/// A dark disc of this radius in px on a light ground, its edge one pixel wide.
fn picture(path: &Path, radius: f64) {
    let image = image::GrayImage::from_fn(120, 100, |u, v| {
        let r = (f64::from(u) - 61.3).hypot(f64::from(v) - 48.8);
        image::Luma([(200.0 - 150.0 * (radius - r + 0.5).clamp(0.0, 1.0)) as u8])
    });
    image.save(path).unwrap();
}

fn batch(dir: &Path, out: &str, more: &[&str]) -> Command {
    let mut command = pivotsight();
    command
        .current_dir(dir)
        .args(["batch", "in", "--job", "job.toml", "--quiet", "--out", out])
        .args(more);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn files(dir: &Path, out: &str) -> Vec<Vec<u8>> {
    ["results.jsonl", "results.csv", "results.parquet"]
        .map(|name| std::fs::read(dir.join(out).join(name)).unwrap())
        .to_vec()
}

#[test]
fn killed_at_fifty_random_moments_it_neither_repeats_nor_loses_a_picture() {
    let dir = workshop(40);
    let dir = dir.path();
    let begun = Instant::now();
    assert_eq!(batch(dir, "whole", &["--threads", "1"]).status().unwrap().code(), Some(0));
    let whole_run = begun.elapsed();
    let whole = files(dir, "whole");
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    let (mut kills, mut rounds, mut lines_before) = (0, 0, 0);
    while kills < 50 {
        rounds += 1;
        assert!(rounds < 500, "only {kills} kills in {rounds} runs");
        // A few kills a batch, so that every stage is hit: starting, measuring, writing the tables.
        let out = format!("killed{}", kills / 5);
        let mut child = batch(dir, &out, &["--threads", "2", "--resume"]).spawn().unwrap();
        std::thread::sleep(whole_run.mul_f64(rng.random_range(0.0..0.5)));
        let ended = child.try_wait().unwrap().is_some();
        let _ = child.kill();
        child.wait().unwrap();
        if ended {
            assert_eq!(files(dir, &out), whole);
            std::fs::remove_dir_all(dir.join(&out)).unwrap();
            lines_before = 0;
            continue;
        }
        kills += 1;
        let journal = std::fs::read(dir.join(&out).join("results.jsonl")).unwrap_or_default();
        let lines = journal.iter().filter(|b| **b == b'\n').count();
        assert!(lines >= lines_before || kills % 5 == 1, "results were lost");
        lines_before = lines;
        if kills % 5 == 0 {
            assert_eq!(batch(dir, &out, &["--resume"]).status().unwrap().code(), Some(0));
            assert!(files(dir, &out) == whole, "{out} differs from the run nobody killed");
            lines_before = 0;
        }
    }
    // A killed process takes a moment to go, and its lock with it.
    let journal = std::fs::File::open(dir.join("killed3/results.jsonl")).unwrap();
    journal.lock().unwrap();
    let child = batch(dir, "killed3", &["--resume"]).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    drop(journal);
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(0));
    let names: Vec<PathBuf> =
        std::fs::read_dir(dir.join("killed3")).unwrap().map(|e| e.unwrap().path()).collect();
    assert!(names.len() >= 5, "{names:?}");
}

#[test]
fn a_bad_picture_is_a_row_with_its_reason_and_can_be_tried_again() {
    let dir = workshop(3);
    let dir = dir.path();
    std::fs::write(dir.join("in/p0001.png"), b"").unwrap();
    std::fs::write(dir.join("in/q.png"), b"not a picture at all").unwrap();
    assert_eq!(batch(dir, "out", &[]).status().unwrap().code(), Some(3));
    let csv = std::fs::read_to_string(dir.join("out/results.csv")).unwrap();
    assert!(csv.contains("the file is empty") && csv.contains("not a picture"), "{csv}");
    assert_eq!(csv.lines().count(), 5);
    picture(&dir.join("in/p0001.png"), 30.0);
    std::fs::remove_file(dir.join("in/q.png")).unwrap();
    picture(&dir.join("in/q.png"), 30.0);
    assert_eq!(batch(dir, "out", &["--resume"]).status().unwrap().code(), Some(3), "failures stay");
    assert_eq!(
        batch(dir, "out", &["--resume", "--retry-failed"]).status().unwrap().code(),
        Some(0)
    );
    assert_eq!(
        std::fs::read_to_string(dir.join("out/results.csv")).unwrap().lines().count(),
        6 - 1
    );
}

#[test]
fn what_cannot_work_is_said_before_anything_is_measured() {
    let dir = workshop(1);
    let dir = dir.path();
    let says = |command: &mut Command, words: &str| {
        let output = command.output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(words), "{message}");
    };
    let job = |text: &str| std::fs::write(dir.join("bad.toml"), text).unwrap();
    let bad = || {
        let mut command = pivotsight();
        command.current_dir(dir).args(["batch", "in", "--job", "bad.toml", "--out", "x"]);
        command
    };
    job("schema = 1\ncalib = \"cam.toml\"\nspeed = 3\n[measure.circles]\nexpect_mm = [1]\n");
    says(&mut bad(), "speed");
    job("schema = 1\ncalib = \"none.toml\"\n[measure.circles]\nexpect_mm = [1]\n");
    says(&mut bad(), "none.toml: cannot read");
    job(
        "schema = 1\ncalib = \"cam.toml\"\n[measure.circles]\nexpect_mm = [1]\n[limits]\na_mm = {}\n",
    );
    says(&mut bad(), "limits.a_mm: has no bound");
    batch(dir, "out", &[]).status().unwrap();
    says(&mut batch(dir, "out", &[]), "add --resume");
    std::fs::write(
        dir.join("cam.toml"),
        "schema = 1\nname = \"test\"\n[scale]\nmm_per_px = 0.02\n",
    )
    .unwrap();
    says(&mut batch(dir, "out", &["--resume"]), "the calibration is not the one");
    std::fs::create_dir(dir.join("empty")).unwrap();
    says(
        pivotsight().current_dir(dir).args(["batch", "empty", "--job", "job.toml", "--out", "y"]),
        "nothing to measure",
    );
    says(pivotsight().current_dir(dir).args(["batch", "in", "--job", "job.toml"]), "--out");
}

#[test]
fn a_dry_run_measures_nothing_and_a_full_disk_loses_nothing() {
    let dir = workshop(4);
    let dir = dir.path();
    let output = batch(dir, "out", &["--dry-run"]).stdout(Stdio::piped()).output().unwrap();
    assert!(String::from_utf8_lossy(&output.stdout).contains("would measure 4 pictures"));
    assert!(!dir.join("out").exists());
    // A limit on file size stands in for a full disk: the journal stops in the middle of a line.
    let binary = assert_cmd::cargo::cargo_bin!("pivotsight");
    let script = format!(
        "trap '' XFSZ; ulimit -f 1; exec {} batch in --job job.toml --out out --threads 1",
        binary.display()
    );
    let status = Command::new("bash").current_dir(dir).args(["-c", &script]).output().unwrap();
    let message = String::from_utf8_lossy(&status.stderr).into_owned();
    assert_eq!(status.status.code(), Some(2), "{message}");
    assert!(
        message.contains("results.jsonl: cannot write") && message.contains("--resume"),
        "{message}"
    );
    assert_eq!(batch(dir, "out", &["--resume"]).status().unwrap().code(), Some(0));
    batch(dir, "whole", &[]).status().unwrap();
    assert_eq!(files(dir, "out"), files(dir, "whole"));
}

#[test]
fn a_watched_folder_is_measured_while_a_camera_fills_it() {
    let dir = workshop(1);
    let dir = dir.path();
    let mut child =
        batch(dir, "out", &["--watch", "--settle-s", "0.1", "--idle-s", "4"]).spawn().unwrap();
    let (whole, half) = (dir.join("whole.png"), dir.join("in/z.png"));
    picture(&whole, 30.5);
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&half, &bytes[..bytes.len() / 2]).unwrap();
    let row = |name: &str| {
        std::fs::read_to_string(dir.join("out/results.jsonl")).is_ok_and(|rows| rows.contains(name))
    };
    while !row("p0000") {
        assert!(child.try_wait().unwrap().is_none(), "it stopped before anything was measured");
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_millis(500));
    assert!(!row("z.png"), "half a picture is not measured");
    std::fs::write(&half, &bytes).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(row("z.png"));
}

/// A file that failed half written is measured again once it has grown, where its format does not say that its end is missing.
#[test]
fn a_watched_file_that_failed_and_then_grows_is_measured_again() {
    let dir = workshop(0);
    let dir = dir.path();
    let (png, pgm) = (dir.join("whole.png"), dir.join("in/slow.pgm"));
    picture(&png, 30.5);
    image::open(&png).unwrap().save(dir.join("whole.pgm")).unwrap();
    let bytes = std::fs::read(dir.join("whole.pgm")).unwrap();
    let mut child =
        batch(dir, "out", &["--watch", "--settle-s", "0.1", "--idle-s", "3"]).spawn().unwrap();
    std::fs::write(&pgm, &bytes[..bytes.len() / 2]).unwrap();
    let rows = || std::fs::read_to_string(dir.join("out/results.jsonl")).unwrap_or_default();
    while !rows().contains("failed") {
        assert!(child.try_wait().unwrap().is_none(), "it stopped before anything was measured");
        std::thread::sleep(Duration::from_millis(50));
    }
    std::fs::write(&pgm, &bytes).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(rows().lines().count() == 1 && rows().contains("\"measured\""), "{}", rows());
}

/// A watch is ended by Ctrl-C or by whoever ends services, and leaves its tables and summary.
#[cfg(unix)]
#[test]
fn a_watch_that_is_told_to_end_leaves_everything_in_order() {
    for signal in ["-INT", "-TERM"] {
        let dir = workshop(9);
        let dir = dir.path();
        let mut child = batch(dir, "out", &["--watch", "--settle-s", "0.1"]).spawn().unwrap();
        while !dir.join("out/summary.json").exists() {
            assert!(child.try_wait().unwrap().is_none(), "it stopped before anything was measured");
            std::thread::sleep(Duration::from_millis(50));
        }
        let end = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        assert!(end.success());
        assert_eq!(child.wait().unwrap().code(), Some(0));
        assert_eq!(batch(dir, "whole", &[]).status().unwrap().code(), Some(0));
        assert_eq!(files(dir, "out"), files(dir, "whole"));
    }
}

#[test]
fn overlays_are_drawn_on_request_and_are_there_whenever_their_row_is() {
    let dir = workshop(4);
    let dir = dir.path();
    let job = std::fs::read_to_string(dir.join("job.toml")).unwrap();
    std::fs::write(dir.join("job.toml"), format!("overlay = true\n{job}")).unwrap();
    let drawn = |out: &str| -> Vec<Vec<u8>> {
        let one = |i: usize| dir.join(out).join(format!("overlays/p000{i}.png.png"));
        (0..4).map(|i| std::fs::read(one(i)).unwrap()).collect()
    };
    batch(dir, "one", &["--threads", "1"]).status().unwrap();
    let whole = (files(dir, "one"), drawn("one"));
    assert!(image::load_from_memory(&whole.1[0]).unwrap().width() >= 120);
    // A run cut off after two rows draws the others' overlays again.
    let lines = std::fs::read_to_string(dir.join("one/results.jsonl")).unwrap();
    assert!(lines.contains("\"overlays\":[\"overlays/p0000.png.png\"]"), "{lines}");
    let cut: String = lines.split_inclusive('\n').take(2).collect();
    std::fs::write(dir.join("one/results.jsonl"), cut).unwrap();
    std::fs::remove_file(dir.join("one/overlays/p0003.png.png")).unwrap();
    batch(dir, "one", &["--resume"]).status().unwrap();
    batch(dir, "four", &["--threads", "4"]).status().unwrap();
    assert!((files(dir, "one"), drawn("one")) == whole);
    assert!((files(dir, "four"), drawn("four")) == whole);
}

#[test]
fn pictures_of_several_sizes_under_one_scale_are_told() {
    let dir = workshop(2);
    let dir = dir.path();
    let small = image::open(dir.join("in/p0000.png")).unwrap();
    let wider = image::imageops::resize(
        &small,
        small.width() + 8,
        small.height(),
        image::imageops::FilterType::Nearest,
    );
    let output = |out: &str| {
        let mut command = pivotsight();
        command.current_dir(dir).args(["batch", "in", "--job", "job.toml", "--out", out]);
        String::from_utf8(command.output().unwrap().stderr).unwrap()
    };
    let alike = output("alike");
    assert!(!alike.contains("mm_per_px"), "{alike}");
    wider.save(dir.join("in/wider.png")).unwrap();
    let mixed = output("mixed");
    assert!(mixed.contains("warning: ") && mixed.contains("one mm_per_px holds"), "{mixed}");
}

#[test]
fn copies_and_pictures_no_longer_there_are_told() {
    let dir = workshop(3);
    let dir = dir.path();
    let output = |more: &[&str]| {
        let mut command = pivotsight();
        command.current_dir(dir).args(["batch", "in", "--job", "job.toml", "--out", "out"]);
        String::from_utf8(command.args(more).output().unwrap().stderr).unwrap()
    };
    let first = output(&[]);
    assert!(!first.contains("warning"), "{first}");
    std::fs::remove_file(dir.join("in/p0002.png")).unwrap();
    std::fs::copy(dir.join("in/p0000.png"), dir.join("in/again.png")).unwrap();
    let said = output(&["--resume"]);
    assert!(said.contains("warning: 1 picture the same as another"), "{said}");
    assert!(said.contains("warning: 1 picture measured before and no longer there"), "{said}");
    assert_eq!(String::from_utf8(files(dir, "out").swap_remove(0)).unwrap().lines().count(), 4);
}

#[test]
fn a_rod_job_measures_tables_of_captures() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    std::fs::create_dir(dir.join("in")).unwrap();
    let rods = Path::new(env!("CARGO_MANIFEST_DIR")).join("images/rod-typical");
    let table = std::fs::read_to_string(rods.join("rod-0001.csv")).unwrap();
    let absolute = table.replace("rod-0001-", &format!("{}/rod-0001-", rods.display()));
    for name in ["a.csv", "b.csv"] {
        std::fs::write(dir.join("in").join(name), &absolute).unwrap();
    }
    std::fs::write(dir.join("in/wrong.csv"), "image,x_mm\nnone.png,1\n").unwrap();
    let job = format!(
        "schema = 1\ncalib = '{}'\noverlay = true\n[measure.rod]\n[limits]\ndiameter_mm = {{ min = 18.0, max = 19.0 }}\n",
        rods.join("calib.toml").display()
    );
    std::fs::write(dir.join("job.toml"), job).unwrap();
    assert_eq!(batch(dir, "one", &["--threads", "1"]).status().unwrap().code(), Some(3));
    assert_eq!(batch(dir, "two", &["--threads", "2"]).status().unwrap().code(), Some(3));
    assert!(files(dir, "one") == files(dir, "two"));
    let lines = std::fs::read_to_string(dir.join("one/results.jsonl")).unwrap();
    let rows: Vec<serde_json::Value> =
        lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(rows[0]["verdict"], "pass");
    assert_eq!(rows[0]["axis_center_mm"], rows[1]["axis_center_mm"]);
    assert_eq!(rows[0]["overlays"].as_array().unwrap().len(), 6);
    assert!(dir.join("one/overlays/b.csv-6.png").is_file());
    assert!(rows[2]["reason"].as_str().is_some_and(|r| r.contains("y_mm")), "{}", rows[2]);
}

/// A camera that died while writing: the file is told once, and measured all the same when nothing more comes.
#[test]
fn a_watched_file_that_stays_cut_short_is_told_once_and_fails_with_its_reason() {
    let dir = workshop(2);
    let dir = dir.path();
    let whole = std::fs::read(dir.join("in/p0000.png")).unwrap();
    std::fs::write(dir.join("in/half.png"), &whole[..whole.len() / 2]).unwrap();
    let args = ["batch", "in", "--job", "job.toml", "--out", "out", "--watch", "--settle-s", "0.1"];
    let output =
        pivotsight().current_dir(dir).args(args).args(["--idle-s", "0.8"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert_eq!(said.matches("half.png: its end is missing").count(), 1, "{said}");
    let rows = std::fs::read_to_string(dir.join("out/results.jsonl")).unwrap();
    let failed = rows.lines().find(|l| l.contains("half.png")).unwrap();
    assert!(failed.contains("cut short"), "{failed}");
}

#[test]
fn results_never_replace_what_is_measured() {
    let dir = workshop(1);
    let dir = dir.path();
    std::fs::create_dir_all(dir.join("out/overlays")).unwrap();
    std::fs::copy(dir.join("in/p0000.png"), dir.join("out/overlays/p0000.png")).unwrap();
    let args = ["batch", "out/overlays", "--job", "job.toml", "--out", "out"];
    let output = pivotsight().current_dir(dir).args(args).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("--out") && said.contains("p0000.png"), "{said}");
    assert!(!dir.join("out/batch.json").exists());
    // Nor what somebody else keeps under a name of theirs.
    std::fs::create_dir(dir.join("notes")).unwrap();
    std::fs::write(dir.join("notes/results.jsonl"), "mine").unwrap();
    let output = batch(dir, "notes", &[]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("results.jsonl that is no batch's"), "{said}");
    assert_eq!(std::fs::read(dir.join("notes/results.jsonl")).unwrap(), b"mine");
}

/// A batch's pictures are recorded once however often it is resumed, and those of another batch in the same folder too.
#[test]
fn records_tell_batches_in_one_folder_apart() {
    let dir = workshop(2);
    let dir = dir.path();
    let go = |more: &[&str]| {
        let more = [&["--records", "r.sqlite"], more].concat();
        assert_eq!(batch(dir, "out", &more).status().unwrap().code(), Some(0));
        let kept = pivotsight()
            .current_dir(dir)
            .args(["history", "export", "--records", "r.sqlite"])
            .output()
            .unwrap();
        String::from_utf8(kept.stdout).unwrap().lines().count()
    };
    assert_eq!(go(&[]), 2);
    assert_eq!(go(&["--resume"]), 2);
    std::fs::remove_dir_all(dir.join("out")).unwrap();
    assert_eq!(go(&[]), 4);
}

/// Burns whose heights a manifest tells are data for `diagnose burn`, whatever their pictures are called.
#[test]
fn burns_at_known_heights_are_data_for_diagnose() {
    let dir = tempfile::tempdir().unwrap();
    let shots = Path::new(env!("CARGO_MANIFEST_DIR")).join("images/burn-typical");
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    for (from, to) in [("burn-0001.png", "low, first.png"), ("burn-0002.png", "high.png")] {
        std::fs::copy(shots.join(from), dir.path().join(to)).unwrap();
    }
    std::fs::copy(shots.join("calib.toml"), dir.path().join("calib.toml")).unwrap();
    write("job.toml", "schema = 1\ncalib = \"calib.toml\"\n[measure.burn]\n");
    write(
        "circles.toml",
        "schema = 1\ncalib = \"calib.toml\"\n[measure.circles]\nexpect_mm = [5.0]\n",
    );
    let run = |words: &str| {
        let output = pivotsight().current_dir(dir.path()).args(words.split(' ')).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let told = "image,height_mm,power_w,b_deg,temp_c\n\"low, first.png\",20,500,0,21.5\nhigh.png,47,500,-30,21.5\n";
    write("told.csv", told);
    assert_eq!(run("batch told.csv --job job.toml --out out").0, Some(1));
    let rows: Vec<serde_json::Value> =
        std::fs::read_to_string(dir.path().join("out/results.jsonl"))
            .unwrap()
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
    let [low, high] = [0, 1].map(|i| &rows[i]["offset_mm"]);
    // Each is corrected for its own height, not for the job's.
    for (row, height_mm) in rows.iter().zip([20.0, 47.0]) {
        let b_deg = -(row["offset_mm"][0].as_f64().unwrap() / height_mm).atan().to_degrees();
        assert!((row["correction"]["b_deg"].as_f64().unwrap() - b_deg).abs() < 1e-9, "{row:#}");
    }
    let burns = format!(
        "height_mm,power_w,b_deg,temp_c,dx_mm,dy_mm,x_image\n20.0,500.0,0.0,21.5,{},{},\"low, first.png\"\n47.0,500.0,-30.0,21.5,{},{},high.png\n",
        low[0], low[1], high[0], high[1]
    );
    assert_eq!(std::fs::read_to_string(dir.path().join("out/burns.csv")).unwrap(), burns);
    let (code, said) = run("diagnose burn --plan-only --data out/burns.csv --noise-mm 0.002");
    assert_eq!(code, Some(0), "{said}");
    // What no burn has is refused before anything is measured, what looks like metres told.
    for (cells, words) in [("-47,500,0", "'height_mm': -47"), ("47,0,0", "'power_w': 0")] {
        write("no.csv", &format!("image,height_mm,power_w,b_deg\nhigh.png,{cells}\n"));
        let (code, said) = run("batch no.csv --job job.toml --out no");
        assert!(code == Some(2) && said.contains(&format!("no.csv:2: column {words}")), "{said}");
    }
    write("m.csv", "image,height_mm,power_w,b_deg\nhigh.png,0.047,500,0\n");
    let (_, said) = run("batch m.csv --job job.toml --out m");
    assert!(said.contains("warning: m.csv:2: column 'height_mm' is 0.047"), "{said}");
    // Half of what is needed, and burns' columns for what is no burn.
    write("half.csv", "image,height_mm,power_w\nhigh.png,47,500\n");
    let (code, said) = run("batch half.csv --job job.toml --out half");
    assert!(
        code == Some(2)
            && said.contains("half.csv: column 'b_deg': is missing")
            && said.contains("height_mm, power_w and b_deg"),
        "{said}"
    );
    let (code, said) = run("batch told.csv --job circles.toml --out circles");
    assert!(code == Some(2) && said.contains("height_mm"), "{said}");
}
