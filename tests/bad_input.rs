//! Bad input of every kind, through the whole command line: exit code 2, a message that names what is wrong and
//! where, nothing half written, and never a panic.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

#[path = "common/line.rs"]
mod line;
#[path = "common/workshop.rs"]
mod workshop;

use line::run;
use std::path::Path;
use workshop::{listing, refused, workshop};

/// Every place where the program reads a file, marked `@`, with a file that is good there.
const READERS: [&str; 32] = [
    "burn @burn.png --calib calib.toml",
    "burn burn.png --calib @calib.toml",
    "circles @burn.png --calib calib.toml --expect-mm 5.75",
    "circles burn.png --calib @calib.toml --expect-mm 5.75",
    "rod @captures.csv --calib calib.toml",
    "rod captures.csv --calib @calib.toml",
    "solve @session.toml",
    "rotary @sweep.csv --pivot-mm 573",
    "align @blank.csv",
    "align apply --align @align.json --machine ac.toml path.apt out.nc",
    "align apply --align align.json --machine @ac.toml path.apt out.nc",
    "align apply --align align.json --machine ac.toml --from apt @path.apt out.nc",
    "ballbar decouple --data @bar.csv",
    "thermal fit --head @heat/head.csv",
    "thermal fit --screw @heat/screw.csv",
    "thermal compensate --model @model.json --table heat/day.csv",
    "thermal compensate --model model.json --table @heat/day.csv",
    "verify --machine @machine.toml --data rtcp.csv",
    "verify --machine machine.toml --data @rtcp.csv",
    "verify --machine machine.toml --now @machine.toml --data rtcp.csv",
    "diagnose rtcp --model @machine.toml --data rtcp.csv",
    "diagnose rtcp --model machine.toml --data @rtcp.csv",
    "simulate rtcp --model @machine.toml --data poses.csv",
    "simulate rtcp --model machine.toml --data @poses.csv",
    "rtcp inverse --machine @machine.toml --poses joints.csv",
    "rtcp inverse --machine machine.toml --poses @joints.csv",
    "machine @machine.toml",
    "export --machine @machine.toml --control siemens",
    "render burn @machine.toml --out-dir rendered",
    "batch burn.png --job @job.toml --out batch",
    "report @solve.json --out page.html",
    "history --records @records.sqlite",
];

#[test]
fn whatever_a_file_holds_it_is_refused_by_name_and_never_breaks_the_program() {
    let dir = workshop();
    let dir = dir.path();
    let noise: Vec<u8> =
        (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let picture = std::fs::read(dir.join("burn.png")).unwrap();
    let bad: [(&str, Vec<u8>); 6] = [
        ("empty", Vec::new()),
        ("spaces", b"\n\n  \n".to_vec()),
        ("noise", noise),
        ("picture", picture[..1000].to_vec()),
        ("letter", b"Dear all,\n\nthe numbers are in the other file; see \"you\n".to_vec()),
        ("page", b"<!DOCTYPE html><html><body>404</body></html>\n".to_vec()),
    ];
    for reader in READERS {
        let (head, tail) = reader.split_once('@').unwrap();
        let (file, tail) = tail.split_once(' ').unwrap_or((tail, ""));
        // What stands there must work, or a refusal below says nothing; `render` and `rod` are only refused.
        let good = run(dir, &reader.replace('@', "")).status.code();
        let only_bad = reader.starts_with("render") || reader.starts_with("rod");
        assert!(only_bad || good == Some(0) || good == Some(1), "{reader}: {good:?}");
        for made in ["out.nc", "rendered", "batch", "page.html"] {
            let path = dir.join(made);
            drop(std::fs::remove_dir_all(&path).or_else(|_| std::fs::remove_file(&path)));
        }
        let extension = file.rsplit('.').next().unwrap();
        let line = |name: &str| format!("{head}{name}.{extension} {tail}");
        refused(dir, &line("nosuchfile"), &["nosuchfile."]);
        for (name, bytes) in &bad {
            let file = format!("{name}.{extension}");
            std::fs::write(dir.join(&file), bytes).unwrap();
            if file == "empty.sqlite" || file == "spaces.sqlite" {
                continue; // An empty database is one without records.
            }
            refused(dir, &line(name), &[&file]);
        }
    }
}

#[test]
fn pictures_that_lie_about_themselves_are_refused() {
    let dir = workshop();
    let dir = dir.path();
    let picture = std::fs::read(dir.join("burn.png")).unwrap();
    let burn = |name: &str, bytes: &[u8], words: &[&str]| {
        std::fs::write(dir.join(name), bytes).unwrap();
        refused(dir, &format!("burn {name} --calib calib.toml"), &[&[name], words].concat());
    };
    burn("half.png", &picture[..picture.len() / 2], &["cut short"]);
    burn("head.png", &picture[..20], &[]);
    burn("really.png", b"kind,x_mm\nface,1\n", &["is not a picture"]);
    let mut jpeg = std::io::Cursor::new(Vec::new());
    let whole = image::open(dir.join("burn.png")).unwrap();
    whole.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    burn("half.jpg", &jpeg[..jpeg.len() * 9 / 10], &["cut short", "end marker"]);
    // A camera that was held on end, or says so: rows and columns are no longer the sensor's.
    let turned =
        b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    burn("turned.jpg", &[&jpeg[..2], turned, &jpeg[2..]].concat(), &["EXIF", "orientation"]);
    // 60,000 × 60,000 pixels claimed in a few bytes, and 20,000 × 20,000 really compressed to little.
    let mut huge = picture.clone();
    huge[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    burn("huge.png", &huge, &[]);
    burn("huge.pgm", b"P5 60000 60000 255\n", &[]);
    let flat = image::GrayImage::from_pixel(20_000, 20_000, image::Luma([7]));
    flat.save(dir.join("bomb.png")).unwrap();
    refused(dir, "burn bomb.png --calib calib.toml", &["bomb.png"]);
    // Readable, and still not what is asked for.
    image::GrayImage::from_pixel(640, 480, image::Luma([90])).save(dir.join("small.png")).unwrap();
    refused(dir, "burn small.png --calib calib.toml", &["small.png", "640", "calib"]);
    image::GrayImage::from_pixel(800, 600, image::Luma([90])).save(dir.join("flat.png")).unwrap();
    refused(dir, "burn flat.png --calib calib.toml", &["flat.png", "ring"]);
    refused(dir, "circles flat.png --calib calib.toml --expect-mm 5", &["flat.png", "5"]);
    refused(dir, "rod captures.csv --calib calib.toml", &["captures.csv:3", "another position"]);
}

/// Which of two burns is meant nobody knows, unless it is told.
#[test]
fn of_two_test_burns_the_one_that_is_named_is_measured() {
    let dir = workshop();
    let dir = dir.path();
    let one = image::open(dir.join("burn.png")).unwrap().to_luma8();
    let (w, h) = one.dimensions();
    let mut two = image::GrayImage::new(2 * w, h);
    image::imageops::replace(&mut two, &one, 0, 0);
    image::imageops::replace(&mut two, &one, i64::from(w), 0);
    two.save(dir.join("two.png")).unwrap();
    let scale = "schema = 1\nname = 'plain'\n[scale]\nmm_per_px = 0.016\n";
    std::fs::write(dir.join("scale.toml"), scale).unwrap();
    refused(dir, "burn two.png --calib scale.toml", &["two.png", "two test burns", "--near-mm"]);
    let line = "burn two.png --calib scale.toml --near-mm=-6.4,0 --format json";
    let json: serde_json::Value = serde_json::from_slice(&run(dir, line).stdout).unwrap();
    let x = json["ring"]["center_mm"][0].as_f64().unwrap();
    assert!((x + 6.4).abs() < 0.5, "{json:#}");
}

#[test]
fn slips_of_the_hand_get_a_hint() {
    let dir = workshop();
    let dir = dir.path();
    refused(dir, "burn brun.png --calib calib.toml", &["brun.png", "did you mean 'burn.png'?"]);
    refused(dir, "burn burn.png --calib clib.toml", &["did you mean 'calib.toml'?"]);
    refused(dir, "thermal fit --head heta/head.csv", &["did you mean 'heat'?"]);
    refused(dir, "report heat", &["heat", "batch"]);
    refused(dir, "batch burn.png --job job.toml --out blank.csv", &["blank.csv", "folder"]);
    refused(dir, "burm burn.png", &["burn"]);
    refused(dir, "burn burn.png --calb calib.toml", &["--calib"]);
    refused(dir, "burn burn.png --calib calib.toml --tolerance-mm=-1", &["--tolerance-mm"]);
    refused(dir, "burn burn.png --calib calib.toml --tolerance-mm 0,01", &["0,01"]);
    refused(dir, "burn . --calib calib.toml", &["folder"]);
    refused(dir, "batch b*.jpg --job job.toml --out o", &["b*.jpg", "nothing to measure"]);
    refused(dir, "rotary sweep.csv --pivot-mm 0", &["--pivot-mm"]);
    refused(dir, "verify --machine machine.toml --data rtcp.csv --noise-mm 0", &["--noise-mm"]);
    refused(dir, "align blank.csv --z-ideal-mm 1e300", &["--z-ideal-mm"]);
    let posted = "align apply --align align.json --machine machine.toml path.apt o.nc";
    refused(dir, &format!("{posted} --feed-mm-min 1e300"), &["--feed-mm-min", "faster"]);
    for what in ["diagnose", "simulate"] {
        let line = format!("{what} rtcp --model machine.toml --data rtcp.csv --calib none.toml");
        refused(dir, &line, &["--calib", "rod"]);
    }
    refused(dir, "circles burn.png --calib calib.toml --expect-mm 900", &["900"]);
    let one = "circles burn.png --calib calib.toml --expect-mm 5.75 --expect-mm";
    refused(dir, &format!("{one} 5.3"), &["one circle only", "5.75", "5.3"]);
    refused(dir, &format!("{one} 5.75"), &["5.75", "twice"]);
}

#[test]
fn a_failed_run_leaves_the_old_result_as_it_was() {
    let dir = workshop();
    let dir = dir.path();
    std::fs::write(dir.join("old.json"), "precious").unwrap();
    refused(dir, "solve nosuch.toml --out old.json", &["nosuch.toml"]);
    assert_eq!(std::fs::read_to_string(dir.join("old.json")).unwrap(), "precious");
    refused(dir, "solve session.toml --out no/where/new.json", &["no/where", "does not exist"]);
    refused(dir, "solve session.toml --out heat", &["heat", "is a folder"]);
    refused(dir, "solve session.toml --write-machine no/where/m.toml", &["does not exist"]);
}

#[test]
fn outputs_never_replace_inputs_nor_each_other_and_come_together() {
    let dir = workshop();
    let dir = dir.path();
    let session = std::fs::read(dir.join("session.toml")).unwrap();
    std::fs::write(dir.join("one.csv"), "image,x_mm,y_mm\nburn.png,0,0\n").unwrap();
    let copy = |from: &str, to: &str| {
        std::fs::copy(dir.join(from), dir.join(to)).unwrap();
    };
    copy("burn.png", "b.overlay.png");
    copy("burn.png", "b.png");
    let two = "image,x_mm,y_mm\nb.png,0,0\nb.overlay.png,1,0\n";
    std::fs::write(dir.join("two.csv"), two).unwrap();
    copy("machine.toml", "tool_carrier.spf");
    copy("machine.toml", "old.toml");
    copy("rtcp.csv", "index.html");
    let text = String::from_utf8(session.clone()).unwrap();
    let text = text.replace("[control]", "[control]\nmachine = \"old.toml\"");
    std::fs::write(dir.join("session2.toml"), text).unwrap();
    for (line, words) in [
        ("solve session.toml --out session.toml", ["--out", "session.toml"]),
        ("solve session.toml --out heat/../session.toml", ["--out", "SESSION.toml"]),
        ("solve session.toml --write-machine ./session.toml", ["--write-machine", "another name"]),
        ("solve session.toml --out a.toml --write-machine a.toml", ["a.toml", "another name"]),
        ("solve session.toml --log session.toml", ["--log", "session.toml"]),
        ("rod one.csv --calib calib.toml --points burn.png", ["--points", "one.csv"]),
        ("rod one.csv --calib calib.toml --points calib.toml", ["--points", "--calib"]),
        ("burn b.png b.overlay.png --calib calib.toml --overlay .", ["--overlay", "IMAGE"]),
        ("rod two.csv --calib calib.toml --overlay .", ["--overlay", "two.csv"]),
        ("export --machine tool_carrier.spf --control siemens --dir .", ["--dir", "--machine"]),
        ("diagnose rtcp --model machine.toml --data index.html --report .", ["--report", "--data"]),
        ("solve session2.toml --write-machine old.toml", ["--write-machine", "session2.toml"]),
    ] {
        refused(dir, line, &words);
    }
    assert_eq!(std::fs::read(dir.join("session.toml")).unwrap(), session);
    if Path::new("/dev/full").exists() {
        refused(dir, "solve session.toml --write-machine m.toml --out /dev/full", &["/dev/full"]);
    }
}

#[cfg(unix)]
#[test]
fn what_never_ends_is_refused() {
    let dir = workshop();
    let dir = dir.path();
    let made = std::process::Command::new("mkfifo").arg(dir.join("pipe.csv")).status();
    if made.is_ok_and(|status| status.success()) {
        refused(dir, "rotary pipe.csv --pivot-mm 573", &["pipe.csv", "is a named pipe"]);
        refused(dir, "machine pipe.csv", &["pipe.csv", "is a named pipe"]);
    }
    if Path::new("/dev/zero").exists() {
        refused(dir, "machine /dev/zero", &["/dev/zero", "larger than"]);
        refused(dir, "report /dev/zero --out page.html", &["/dev/zero", "larger than"]);
    }
}

#[test]
fn a_page_is_made_of_results_only() {
    let dir = workshop();
    let dir = dir.path();
    for (text, word) in [
        (r#"{"a": 1}"#, "not a result"),
        ("[1, 2]", "not a result"),
        (r#"{"schema": "pivotsight.foo/1", "a": 1}"#, "nothing that a page shows"),
        (r#"{"schema": "pivotsight.burn/2", "distance_mm": 1}"#, "version 1"),
    ] {
        std::fs::write(dir.join("f.json"), text).unwrap();
        refused(dir, "report f.json", &["f.json", word]);
    }
    refused(
        dir,
        "align apply --align align.json --machine ac.toml path.apt out.nc --decimals 0",
        &["--decimals", "decimal point"],
    );
}

#[cfg(unix)]
#[test]
fn a_link_to_nothing_is_called_one() {
    let dir = workshop();
    let dir = dir.path();
    std::os::unix::fs::symlink("gone/calib.toml", dir.join("link.toml")).unwrap();
    let listed = listing(dir);
    refused(dir, "burn burn.png --calib link.toml", &["link.toml", "a link to 'gone/calib.toml'"]);
    assert_eq!(listing(dir), listed);
}

/// A name that JSON cannot hold is refused, never a panic half way.
#[cfg(unix)]
#[test]
fn names_that_are_not_utf_8_are_refused() {
    use std::os::unix::ffi::OsStrExt;
    let dir = workshop();
    let name = std::ffi::OsStr::from_bytes(b"b\xff.png");
    std::fs::copy(dir.path().join("burn.png"), dir.path().join(name)).unwrap();
    let output = std::process::Command::new(assert_cmd::cargo::cargo_bin!("pivotsight"))
        .current_dir(dir.path())
        .env("PIVOTSIGHT_CONFIG", "none")
        .arg("burn")
        .arg(name)
        .args(["--calib", "calib.toml", "--format", "json"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("IMAGE") && said.contains("UTF-8"), "{said}");
}

/// Whoever asked for overlays sees what was refused as well, and why.
#[test]
fn what_is_refused_is_drawn_where_overlays_are_asked_for() {
    let dir = workshop();
    let dir = dir.path();
    let (width, height) = image::image_dimensions(dir.join("burn.png")).unwrap();
    for (name, gray) in [("bare.png", 90), ("barer.png", 91), ("barest.png", 92)] {
        let bare = image::GrayImage::from_pixel(width, height, image::Luma([gray]));
        bare.save(dir.join(name)).unwrap();
    }
    std::fs::write(
        dir.join("bare.csv"),
        "image,x_mm,y_mm\nbare.png,0,0\nbarer.png,5,0\nbarest.png,0,5\n",
    )
    .unwrap();
    for (line, job) in [
        ("burn bare.png burn.png --calib calib.toml --overlay o --format json", "burn"),
        (
            "circles bare.png burn.png --calib calib.toml --expect-mm 5.75 --overlay o --format json",
            "circles",
        ),
    ] {
        let result: serde_json::Value = serde_json::from_slice(&run(dir, line).stdout).unwrap();
        let [refused, measured] = [0, 1].map(|i| result["results"][i].clone());
        assert!(refused["error"].is_string() && measured["error"].is_null(), "{job}: {result}");
        assert_eq!(
            refused["overlay"].as_str().map(Path::new),
            Some(&*Path::new("o").join("bare.overlay.png"))
        );
        // The picture, and what is said beneath.
        let drawn = image::open(dir.join("o/bare.overlay.png")).unwrap();
        let zoom = drawn.width() / width;
        assert!(zoom >= 1 && drawn.height() > zoom * height + 30, "{job}");
        std::fs::remove_dir_all(dir.join("o")).unwrap();
    }
    for line in [
        "burn bare.png --calib calib.toml --overlay o",
        "rod bare.csv --calib calib.toml --overlay o",
    ] {
        assert_eq!(run(dir, line).status.code(), Some(2), "{line}");
        assert!(dir.join("o/bare.overlay.png").is_file(), "{line}");
        std::fs::remove_dir_all(dir.join("o")).unwrap();
    }
    std::fs::write(
        dir.join("draw.toml"),
        "schema = 1\ncalib = \"calib.toml\"\noverlay = true\n[measure.burn]\n",
    )
    .unwrap();
    assert_eq!(run(dir, "batch bare.png --job draw.toml --out batch").status.code(), Some(3));
    let rows = std::fs::read_to_string(dir.join("batch/results.jsonl")).unwrap();
    assert!(rows.contains(r#""overlays":["overlays/bare.png.png"]"#), "{rows}");
    assert!(dir.join("batch/overlays/bare.png.png").is_file());
}
