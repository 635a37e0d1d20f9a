//! `burn`, `rod` and `circles` end to end: rendered pictures against their truth, real washers against a
//! coordinate measuring machine, and messages for bad input.

use assert_cmd::Command;
use serde_json::Value;

fn run(args: &[&str]) -> (i32, Value, String) {
    let output = Command::cargo_bin("pivotsight").unwrap().args(args).output().unwrap();
    let json = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code().unwrap(), json, String::from_utf8_lossy(&output.stderr).into_owned())
}

fn image(path: &str) -> String {
    format!("{}/images/{path}", env!("CARGO_MANIFEST_DIR"))
}

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path} in {value}"))
}

/// Errors stay within three times the stated 95 % interval: a wrong number is worse than none.
#[test]
fn burns_are_measured_to_their_uncertainty() {
    for folder in ["burn-clean", "burn-typical", "burn-hard"] {
        for picture in ["burn-0001", "burn-0002"] {
            let truth = std::fs::read(image(&format!("{folder}/{picture}.truth.json"))).unwrap();
            let truth: Value = serde_json::from_slice(&truth).unwrap();
            let (code, result, error) = run(&[
                "burn",
                &image(&format!("{folder}/{picture}.png")),
                "--calib",
                &image(&format!("{folder}/calib.toml")),
                "--format",
                "json",
            ]);
            assert!(code <= 1, "{folder}/{picture}: {error}");
            for axis in 0..2 {
                let found = number(&result, &format!("/offset_mm/{axis}"));
                let u95 = number(&result, &format!("/offset_u95_mm/{axis}"));
                let real = number(&truth, &format!("/offset_mm/{axis}"));
                assert!(
                    (found - real).abs() < 3.0 * u95,
                    "{folder}/{picture}: {found} {real} {u95}"
                );
            }
        }
    }
}

/// The inner edge of a pale annulus, sought from its rough place, once led to the dark spot's: ring and spot were then one, the offset
/// nothing and the verdict a pass.
#[test]
fn a_strong_spot_is_not_taken_for_the_inner_edge_of_its_ring() {
    let folder = tempfile::tempdir().unwrap();
    for seed in ["3101221", "3101237"] {
        let path = |file: &str| folder.path().join(seed).join(file).to_str().unwrap().to_owned();
        let to = ["--out-dir", &path("")];
        let (code, _, error) =
            run(&[&["render", "burn", "--preset", "hard", "--seed", seed][..], &to].concat());
        assert_eq!(code, 0, "{error}");
        let truth = std::fs::read(path("burn-0001.truth.json")).unwrap();
        let truth: Value = serde_json::from_slice(&truth).unwrap();
        let (picture, calib) = (path("burn-0001.png"), path("calib.toml"));
        let (_, result, error) = run(&["burn", &picture, "--calib", &calib, "--format", "json"]);
        for axis in 0..2 {
            let [found, u95] = ["offset_mm", "offset_u95_mm"]
                .map(|key| number(&result, &format!("/{key}/{axis}")));
            let real = number(&truth, &format!("/offset_mm/{axis}"));
            assert!((found - real).abs() < 1.5 * u95, "{seed}: {found} {real} {u95} {error}");
        }
    }
}

#[test]
fn burns_at_one_setting_are_judged_by_their_mean() {
    // The two pictures are of different settings: the mean says so.
    let pictures = [1, 2].map(|n| image(&format!("burn-typical/burn-000{n}.png")));
    let calib = image("burn-typical/calib.toml");
    let [a, b] = &pictures;
    let mean = ["--calib", &calib, "--mean", "--format", "json"];
    let (code, _, error) = run(&[&["burn", a, a][..], &mean].concat());
    assert!(code == 2 && error.contains("one picture"), "{error}");
    // Another file with the same picture in it: what a decoder does not read is added.
    let folder = tempfile::tempdir().unwrap();
    let again = folder.path().join("again.png").to_str().unwrap().to_owned();
    std::fs::write(&again, [&std::fs::read(a).unwrap()[..], &[0]].concat()).unwrap();
    let (code, twice, error) = run(&[&["burn", a, &again][..], &mean].concat());
    assert!(code <= 1, "{error}");
    assert_eq!(number(&twice, "/mean/tests"), 2.0);
    for axis in 0..2 {
        let of = |path: &str| number(&twice, &format!("{path}/{axis}"));
        let [once, both] = ["/results/0", "/mean"].map(|p| of(&format!("{p}/offset_mm")));
        assert!((once - both).abs() < 1e-12);
        let [once, both] = ["/results/0", "/mean"].map(|p| of(&format!("{p}/offset_u95_mm")));
        assert!((once / both - 2f64.sqrt()).abs() < 1e-9, "{once} {both}");
    }
    let (_, result, error) = run(&[&["burn", a, b][..], &mean].concat());
    assert!(number(&result, "/mean/p_agree") < 0.01 && error.contains("turned"), "{error}");
    let (code, _, error) = run(&[&["burn", a][..], &mean].concat());
    assert!(code == 2 && error.contains("--mean"), "{error}");
}

#[test]
fn a_burn_partly_out_of_the_picture_is_measured_like_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let whole = ::image::open(image("burn-typical/burn-0001.png")).unwrap();
    let calib = image("../calib/scale.toml");
    let measure = |x: u32| {
        let file = folder.path().join(format!("{x}.png"));
        whole.crop_imm(x, 0, whole.width() - x, whole.height()).save(&file).unwrap();
        let file = file.to_str().unwrap();
        let (code, result, error) = run(&["burn", file, "--calib", &calib, "--format", "json"]);
        assert!(code <= 1, "{error}");
        result
    };
    let (all, part) = (measure(0), measure(300));
    assert!(number(&part, "/ring/arc_coverage") < 0.8);
    for axis in 0..2 {
        let both = |what: &str| [&all, &part].map(|r| number(r, &format!("/{what}/{axis}")));
        let ([a, b], [u, v]) = (both("offset_mm"), both("offset_u95_mm"));
        assert!((a - b).abs() < u + v, "{a} ± {u}, {b} ± {v}");
    }
}

#[test]
fn washers_agree_with_the_coordinate_measuring_machine() {
    let data = format!("{}/../shared/data/washers", env!("CARGO_MANIFEST_DIR"));
    let Ok(cmm) = std::fs::read_to_string(format!("{data}/cmm.csv")) else {
        println!("skipped: the washer pictures are not here");
        return;
    };
    let zones: Vec<f64> =
        cmm.lines().skip(1).map(|l| l.split(',').nth(9).unwrap().parse().unwrap()).collect();
    let folder = tempfile::tempdir().unwrap();
    for (camera, mm_per_px, limit_mm) in [("ccd4", 0.01740, 0.0030), ("ccd1", 0.03133, 0.0046)] {
        let calib = folder.path().join("scale.toml");
        std::fs::write(&calib, format!("schema = 1\n[scale]\nmm_per_px = {mm_per_px}\n")).unwrap();
        let pictures: Vec<String> =
            (1..=20).map(|i| format!("{data}/{camera}/{i:04}.png")).collect();
        let mut args = vec!["circles"];
        args.extend(pictures.iter().map(String::as_str));
        let calib = calib.to_str().unwrap();
        args.extend([
            "--calib",
            calib,
            "--expect-mm",
            "23.7",
            "--expect-mm",
            "19.05",
            "--format",
            "json",
        ]);
        let (code, result, error) = run(&args);
        assert_eq!(code, 0, "{error}");
        let results = result["results"].as_array().unwrap();
        let squares: f64 = results
            .iter()
            .zip(&zones)
            .map(|(r, zone)| (number(r, "/pairs/0/distance_mm") - 0.5 * zone).powi(2))
            .sum();
        let rms = (squares / 20.0).sqrt();
        println!("{camera}: rms {:.2} µm", rms * 1e3);
        assert!(rms < limit_mm, "{camera}: {rms}");
    }
}

/// The core of a fibre is a pale circle in a textured picture; where none is to be seen, no texture is taken for it.
#[test]
fn a_fibre_without_a_visible_core_is_said_to_have_none() {
    let data = format!("{}/../shared/data/fibres", env!("CARGO_MANIFEST_DIR"));
    if !std::path::Path::new(&data).is_dir() {
        println!("skipped: the fibre pictures are not here");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let calib = folder.path().join("scale.toml");
    std::fs::write(&calib, "schema = 1\n[scale]\nmm_per_px = 0.0004343\n").unwrap();
    for i in 1..=10 {
        let picture = format!("{data}/fibre_{i:03}.jpg");
        let expected = ["--expect-mm", "0.125", "--expect-mm", "0.05", "--format", "json"];
        let args = ["circles", &picture, "--calib", calib.to_str().unwrap()];
        let (code, result, error) = run(&[&args[..], &expected].concat());
        if [1, 3].contains(&i) {
            assert!(
                code == 2 && error.contains("no circle of about 0.05 mm"),
                "{picture}: {error}"
            );
            continue;
        }
        let [outer, core] = [0, 1].map(|k| number(&result, &format!("/circles/{k}/diameter_mm")));
        assert!((outer / core / 2.5 - 1.0).abs() < 0.03, "{picture}: {outer} / {core}");
    }
}

#[test]
fn bad_input_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let good = image("burn-clean/burn-0001.png");
    let calib = image("burn-clean/calib.toml");
    std::fs::write(at("empty.png"), b"").unwrap();
    std::fs::write(at("text.png"), b"not a picture at all").unwrap();
    let whole = std::fs::read(&good).unwrap();
    std::fs::write(at("cut.png"), &whole[..whole.len() / 3]).unwrap();
    std::fs::write(at("unknown.toml"), "schema = 1\n[scale]\nmm_per_px = 0.01\nmm_per_pixel = 2\n")
        .unwrap();
    std::fs::write(at("nan.csv"), "image,x_mm,y_mm\na.png,0,0\nb.png,NaN,1\n").unwrap();
    std::fs::write(at("column.csv"), "image,x_mm\na.png,0\n").unwrap();
    let plate = image::GrayImage::from_fn(400, 300, |x, y| {
        image::Luma([120 + ((x * 7 + y * 13) % 11) as u8])
    });
    plate.save(at("plate.png")).unwrap();
    std::fs::write(at("scale.toml"), "schema = 1\n[scale]\nmm_per_px = 0.01\n").unwrap();
    // The captures of a rod, and one at another table angle that shows nothing.
    let rod = image("rod-typical");
    let table = std::fs::read_to_string(format!("{rod}/rod-0001.csv")).unwrap();
    let seen = table.lines().skip(1).map(|line| format!("{rod}/{line}\n")).collect::<String>();
    let place = table.lines().nth(1).unwrap().split(',').skip(1).take(2).collect::<Vec<_>>();
    let blank = format!("{},{},90", at("blank.png"), place.join(","));
    std::fs::write(at("blank.csv"), format!("image,x_mm,y_mm,c_deg\n{seen}{blank}\n")).unwrap();
    let (width, height) = image::image_dimensions(format!("{rod}/rod-0001-01.png")).unwrap();
    image::GrayImage::from_pixel(width, height, image::Luma([30])).save(at("blank.png")).unwrap();
    let rod_calib = format!("{rod}/calib.toml");
    let out = at("result.json");
    for (args, words) in [
        (vec!["burn", "missing.png", "--calib", &calib], "missing.png"),
        (vec!["burn", &at("empty.png"), "--calib", &calib], "empty"),
        (vec!["burn", &at("text.png"), "--calib", &calib], "not a picture"),
        (vec!["burn", &at("cut.png"), "--calib", &calib], "cut"),
        (vec!["burn", &good, "--calib", &at("unknown.toml")], "mm_per_pixel"),
        (vec!["burn", &at("plate.png"), "--calib", &calib], "px"),
        (vec!["burn", &at("plate.png"), "--calib", &at("scale.toml")], "found"),
        (vec!["burn", &good, "--calib", &calib, "--spot-height-mm", "60"], "--ring-height-mm"),
        (vec!["circles", &good, "--calib", &calib, "--expect-mm", "2300"], "--expect-mm"),
        (vec!["rod", &at("nan.csv"), "--calib", &calib], "nan.csv:3"),
        (vec!["rod", &at("column.csv"), "--calib", &calib], "y_mm"),
        (vec!["rod", &at("blank.csv"), "--calib", &rod_calib], "C = 90°"),
    ] {
        let mut all = args.clone();
        all.extend(["--out", &out]);
        let (code, _, error) = run(&all);
        assert_eq!(code, 2, "{args:?}: {error}");
        assert!(error.contains(words), "{args:?}: {error}");
        assert!(!std::path::Path::new(&out).exists(), "{args:?}");
    }
}
