//! What the program promises of OpenCV: built in it calibrates lenses, without it it says how to get it.

#[path = "common/json.rs"]
mod json;
#[path = "common/schema.rs"]
mod schema;

use assert_cmd::Command;
use json::run;
use schema::unlike_its_schema;

#[test]
fn the_version_lists_what_is_built_in() {
    let out = Command::cargo_bin("pivotsight").unwrap().arg("--version").output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    let built_in = if cfg!(feature = "opencv") { "(opencv 4." } else { "(no opencv)" };
    assert!(text.contains(built_in), "{text}");
}

#[test]
fn targets_are_true_to_scale() {
    let folder = tempfile::tempdir().unwrap();
    for (target, paper) in
        [("charuco:11x7:15", "A4"), ("chessboard:10x7:40", "A2"), ("dots:9x7:2.5", "A4")]
    {
        for extension in ["svg", "pdf"] {
            let path = folder.path().join(format!("t.{extension}"));
            let (json, code, _) =
                run(&["calib", "target", target, "--out", path.to_str().unwrap()]);
            assert_eq!(code, Some(0));
            // The result goes to the file alone; nothing is printed but in it.
            assert_eq!(json["paper"], paper, "{json:#}");
            assert_eq!(unlike_its_schema(&json), [""; 0]);
            let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
            let page = &json["page_mm"];
            let (w, h) = (page[0].as_f64().unwrap(), page[1].as_f64().unwrap());
            match extension {
                "svg" => assert!(text.contains(&format!(
                    "width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\""
                ))),
                _ => assert!(text.contains(&format!(
                    "/MediaBox [0 0 {:.5} {:.5}]",
                    w / 25.4 * 72.0,
                    h / 25.4 * 72.0
                ))),
            }
        }
    }
    let (_, code, _) = run(&["calib", "target", "charuco:10x8:15", "--out", "x.svg"]);
    assert_eq!(code, Some(2));
}

#[cfg(not(feature = "opencv"))]
#[test]
fn without_opencv_the_command_says_how_to_get_it() {
    let (_, code, words) =
        run(&["calib", "camera", "images/burn-clean/burn-0001.png", "--target", "charuco:11x7:15"]);
    assert_eq!(code, Some(2));
    assert!(words.contains("libopencv-dev") && words.contains("--features opencv"), "{words}");
}

#[cfg(feature = "opencv")]
mod with {
    use std::path::Path;

    use super::{run, unlike_its_schema};
    use nalgebra::{Rotation3, Vector2, Vector3};
    use pivotsight::calib::lens;
    use pivotsight::calib::target::Target;
    use pivotsight::camera::{Lens, LensFile};
    use pivotsight::cv::{self, BoardView, Distortion, Pose};
    use pivotsight::frame::{Channel, Picture};
    use pivotsight::render::target::render;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use serde_json::Value;

    fn truth() -> Lens {
        Lens {
            width_px: 800,
            height_px: 600,
            fx_px: 1010.0,
            fy_px: 1006.0,
            cx_px: 411.0,
            cy_px: 290.0,
            distortion: [-0.21, 0.11, 8e-4, -6e-4, 0.0],
        }
    }

    /// Views all over the frame, tilted in different directions.
    fn poses(target: &Target, lens: &Lens) -> Vec<Pose> {
        let half = target.size_mm() / 2.0;
        let distance = 0.75 * lens.fx_px * target.size_mm().x / 800.0 * 1.6;
        (0..12)
            .map(|i| {
                let t = f64::from(i) * 2.4;
                let lean = 0.2 + 0.035 * f64::from(i);
                let turn =
                    Rotation3::from_axis_angle(
                        &nalgebra::Unit::new_normalize(Vector3::new(t.cos(), t.sin(), 0.0)),
                        lean,
                    ) * Rotation3::from_axis_angle(&Vector3::z_axis(), 0.15 * (t * 1.7).sin());
                let reach = if i % 4 == 3 { 0.0 } else { 0.16 };
                let (s, c) = (0.5 + 1.571 * f64::from(i)).sin_cos();
                let depth = distance * (1.0 + 0.12 * f64::from(i % 3));
                let middle = Vector3::new(c * reach * depth, 0.75 * s * reach * depth, depth);
                Pose { turn, shift_mm: middle - turn * Vector3::new(half.x, half.y, 0.0) }
            })
            .collect()
    }

    fn gray(path: &Path) -> pivotsight::frame::Gray<u8> {
        Picture::read(path).unwrap().into_frame(Channel::Auto).to_eight()
    }

    /// Every kind of target, rendered: its markers are OpenCV's, and its points are found where they are.
    #[test]
    fn rendered_targets_are_found_where_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let lens = truth();
        for (text, most_px) in
            [("charuco:11x7:15", 0.12), ("chessboard:10x7:16", 0.06), ("dots:9x7:17", 0.12)]
        {
            let target: Target = text.parse().unwrap();
            let pose = poses(&target, &lens)[7];
            let made = render(&target, &lens, &pose, 1.0, 5).unwrap();
            let path = folder.path().join("t.png");
            made.picture.write_png(&path).unwrap();
            if let Ok(kept) = std::env::var("PIVOTSIGHT_KEEP") {
                std::fs::copy(&path, Path::new(&kept).join(format!("{}.png", target.kind.word())))
                    .unwrap();
            }
            let found = cv::detect(&gray(&path), &target).unwrap().expect(text);
            assert!(found.ids.len() > 40, "{text}: {}", found.ids.len());
            // Chessboards and dots may be counted from the opposite corner.
            let n = made.points_px.len();
            let off = |turned: bool| -> f64 {
                let squares: f64 = found
                    .ids
                    .iter()
                    .zip(&found.pixels)
                    .map(|(&i, p)| {
                        (p - made.points_px[if turned { n - 1 - i } else { i }]).norm_squared()
                    })
                    .sum();
                (squares / found.ids.len() as f64).sqrt()
            };
            let rms = off(false).min(off(true));
            println!("{text}: {} points, {rms:.4} px rms", found.ids.len());
            assert!(rms < most_px, "{text}: {rms} px");
        }
    }

    /// Share of the lens's numbers that lie within their intervals: known lens, known noise of each point, a curl of the board by
    /// `curl_mm` (standard deviation), another one in each view, and a print whose points are off by `print_mm` in all of them.
    fn share_inside(noise_px: f64, curl_mm: f64, print_mm: f64) -> f64 {
        let lens = truth();
        let target: Target = "charuco:11x7:15".parse().unwrap();
        let camera = lens.normalised();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
        let wanted = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, -0.21, 0.11, 8e-4, -6e-4];
        let half = target.size_mm() / 2.0;
        let (mut inside, mut total) = (0, 0);
        for _ in 0..25 {
            let printed: Vec<Vector3<f64>> = target
                .points_mm()
                .iter()
                .map(|_| print_mm * Vector3::new(noise(), noise(), 3.0 * noise()))
                .collect();
            let found = poses(&target, &lens)
                .iter()
                .enumerate()
                .map(|(i, pose)| {
                    let board_mm: Vec<Vector3<f64>> =
                        target.points_mm().iter().map(|p| p.push(0.0)).collect();
                    let curl = [(); 3].map(|()| curl_mm * noise());
                    let pixels = board_mm
                        .iter()
                        .zip(&printed)
                        .map(|(b, off)| {
                            let at = (b.xy() - half).component_div(&half);
                            let z = curl[0] * at.x * at.x
                                + curl[1] * at.x * at.y
                                + curl[2] * at.y * at.y;
                            let b = off + Vector3::new(b.x, b.y, z);
                            let p = pose.turn * b + pose.shift_mm;
                            let exact = camera.to_pixel(Vector2::new(p.x / p.z, p.y / p.z));
                            exact + noise_px * Vector2::new(noise(), noise())
                        })
                        .collect();
                    (i, BoardView { board_mm, pixels, radius_mm: 0.0 })
                })
                .collect();
            let names: Vec<String> = (0..12).map(|i| i.to_string()).collect();
            let made =
                lens::from_views(&names, found, vec![None; 12], (800, 600), Distortion::Decentred)
                    .unwrap();
            if print_mm > 0.0 {
                let [plane, out] = made.report.board_sd_mm.map(|sd| sd / print_mm);
                assert!((0.8..1.2).contains(&plane) && (2.0..4.0).contains(&out), "{plane} {out}");
            }
            for (p, truth) in made.report.parameters.iter().zip(wanted) {
                total += 1;
                inside += usize::from((p.value - truth).abs() <= p.u95.unwrap());
            }
        }
        println!(
            "noise {noise_px} px, curl {curl_mm}, print {print_mm} mm: {inside} of {total} inside"
        );
        f64::from(inside as u32) / f64::from(total)
    }

    /// The stated intervals hold, whether the points err each by itself, all of a view's together, or alike in all views.
    #[test]
    fn intervals_of_the_lens_hold() {
        for (noise_px, curl_mm, print_mm) in [(0.1, 0.0, 0.0), (0.05, 0.2, 0.0), (0.03, 0.0, 0.05)]
        {
            let share = share_inside(noise_px, curl_mm, print_mm);
            assert!((0.90..=0.99).contains(&share), "{share}");
        }
    }

    /// Perspective shifts the middles of dots' images; the lens found does not follow them.
    #[test]
    fn a_lens_is_found_from_dots() {
        let folder = tempfile::tempdir().unwrap();
        let lens = truth();
        let target: Target = "dots:9x7:17".parse().unwrap();
        let mut images = Vec::new();
        for (i, pose) in poses(&target, &lens).iter().enumerate() {
            let path = folder.path().join(format!("view-{i:02}.png"));
            render(&target, &lens, pose, 1.0, i as u64).unwrap().picture.write_png(&path).unwrap();
            images.push(path);
        }
        // One picture twice and one that is not there: told, and no further views.
        std::fs::copy(&images[0], folder.path().join("again.png")).unwrap();
        images.extend(["again.png", "missing.png"].map(|name| folder.path().join(name)));
        let made = lens::calibrate(&images, &target, Distortion::Decentred).unwrap();
        let report = &made.report;
        let why = |i: usize| report.views[i].rejected.as_deref().unwrap_or("");
        assert!(why(12).contains("is the picture") && why(12).ends_with("again"), "{}", why(12));
        assert!(why(13).contains("cannot read") && made.unread == 1, "{}", why(13));
        println!("{} px rms", report.rms_px);
        assert!(report.rms_px < 0.06, "{report:#?}");
        let wanted = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, -0.21, 0.11, 8e-4, -6e-4];
        for (p, truth) in report.parameters.iter().zip(wanted) {
            println!("{} {} ± {:?}, truth {truth}", p.name, p.value, p.u95);
            assert!((p.value - truth).abs() < 1.5 * p.u95.unwrap(), "{p:?}, truth {truth}");
        }
    }

    fn value(json: &Value, name: &str) -> (f64, f64) {
        let p = json["parameters"].as_array().unwrap().iter().find(|p| p["name"] == name).unwrap();
        (p["value"].as_f64().unwrap(), p["u95"].as_f64().unwrap_or(0.0))
    }

    /// From rendered pictures to a lens, two of them bad.
    #[test]
    fn a_lens_is_found_from_pictures_and_bad_ones_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let lens = truth();
        let target: Target = "charuco:11x7:15".parse().unwrap();
        let mut images = Vec::new();
        for (i, pose) in poses(&target, &lens).iter().enumerate() {
            let path = folder.path().join(format!("view-{i:02}.png"));
            // In one picture the paper is warped: another lens shows it.
            let seen_by = if i == 5 {
                Lens { distortion: [0.3, 0.0, 0.02, 0.0, 0.0], ..lens.clone() }
            } else {
                lens.clone()
            };
            render(&target, &seen_by, pose, 1.0, i as u64)
                .unwrap()
                .picture
                .write_png(&path)
                .unwrap();
            images.push(path.display().to_string());
        }
        images.push("images/burn-clean/burn-0001.png".into());
        let calib = folder.path().join("lens.toml");
        let coverage = folder.path().join("coverage.png");
        let mut args: Vec<&str> = vec!["calib", "camera"];
        args.extend(images.iter().map(String::as_str));
        args.extend(["--target", "charuco:11x7:15", "--distortion", "decentred"]);
        args.extend([
            "--write-calib",
            calib.to_str().unwrap(),
            "--coverage",
            coverage.to_str().unwrap(),
        ]);
        let (json, code, words) = run(&args);
        assert_eq!(code, Some(0), "{words}");
        assert_eq!(unlike_its_schema(&json), [""; 0]);
        if let Ok(kept) = std::env::var("PIVOTSIGHT_KEEP") {
            std::fs::copy(&coverage, Path::new(&kept).join("coverage.png")).unwrap();
            std::fs::write(Path::new(&kept).join("camera.json"), format!("{json:#}")).unwrap();
        }
        let rejected = |i: usize| json["views"][i]["rejected"].as_str().map(str::to_owned);
        assert!(rejected(5).unwrap().contains("px rms"), "{json:#}");
        assert!(rejected(12).unwrap().contains("not found"));
        assert_eq!((0..13).filter(|&i| rejected(i).is_some()).count(), 2, "{json:#}");
        assert!(json["rms_px"].as_f64().unwrap() < 0.12, "{json:#}");
        // What matters: the same place of the frame is seen along the same ray, to a tenth of a pixel or so.
        let found = LensFile::read(&calib).unwrap().lens;
        for (name, truth) in
            [("fx_px", 1010.0), ("fy_px", 1006.0), ("cx_px", 411.0), ("cy_px", 290.0)]
        {
            let (v, u) = value(&json, name);
            assert!((v - truth).abs() < (2.5 * u).max(1.0), "{name}: {v} ± {u}, truth {truth}");
        }
        assert!((found.distortion[0] + 0.21).abs() < 0.02);
        // The lens alone is no calibration yet, and the message says what is missing.
        let (_, code, words) = run(&[
            "circles",
            "images/burn-clean/burn-0001.png",
            "--calib",
            calib.to_str().unwrap(),
            "--expect-mm",
            "5",
        ]);
        assert!(code == Some(2) && words.contains("calib plane"), "{words}");
    }

    /// OpenCV's own contours and ellipses agree with what is measured, and what is off is flagged.
    #[test]
    fn the_second_opinion_agrees_or_says_so() {
        let burn = "images/burn-clean/burn-0001.png";
        let (json, _, words) =
            run(&["burn", burn, "--calib", "images/burn-clean/calib.toml", "--cross-check"]);
        println!("{:#} {words}", json["cross_check"]);
        for opinion in json["cross_check"].as_array().unwrap() {
            assert_eq!(opinion["agrees"], true, "{opinion:#}");
        }
        let (json, _, words) = run(&[
            "rod",
            "images/rod-typical/rod-0001.csv",
            "--calib",
            "images/rod-typical/calib.toml",
            "--cross-check",
        ]);
        println!("{:#} {words}", json["cross_check"]);
        assert!(json["cross_check"].as_array().is_some_and(|o| !o.is_empty()));
        // A result that is off by more than both uncertainties.
        use pivotsight::measure::{CircleReport, cross};
        let picture = Picture::read(burn).unwrap().into_frame(Channel::Auto);
        let calibration =
            pivotsight::camera::Calibration::read("images/burn-clean/calib.toml").unwrap();
        let view = calibration.view(picture.width(), picture.height()).unwrap();
        let (json, ..) = run(&["burn", burn, "--calib", "images/burn-clean/calib.toml"]);
        let ring = &json["ring"];
        let number = |v: &Value| v.as_f64().unwrap();
        let report = CircleReport {
            center_mm: [number(&ring["center_mm"][0]) + 0.02, number(&ring["center_mm"][1])],
            center_px: [0.0; 2],
            diameter_mm: number(&ring["diameter_mm"]),
            center_u95_mm: [0.0005; 2],
            diameter_u95_mm: 0.001,
            edge_points: 0,
            arc_coverage: 1.0,
            form_rms_mm: 0.0,
        };
        let opinions = cross::circles(&picture, &view, &[("ring".into(), &report)]).unwrap();
        assert_eq!(opinions[0].agrees, Some(false));
        assert!(opinions[0].warning().unwrap().contains("beyond both uncertainties"));
    }

    /// A video file is read frame by frame, and one that is none is refused.
    #[test]
    fn video_files_are_read() {
        let file = Path::new("/usr/share/doc/opencv-doc/examples/data/vtest.avi");
        let (_, code, words) = run(&["center", "Cargo.toml", "--calib", "calib/scale.toml"]);
        assert!(code == Some(2) && words.contains("cannot be opened as a video"), "{words}");
        if !file.exists() {
            println!("skipped: Debian's opencv-doc with vtest.avi is not installed");
            return;
        }
        let mut video = cv::Video::file(file).unwrap();
        let mut count = 0;
        while let Some(frame) = video.read().unwrap() {
            assert_eq!((frame.width, frame.height), (768, 576));
            count += 1;
        }
        assert_eq!(count, 795);
    }

    /// Pictures that do not determine the lens give none.
    #[test]
    fn square_on_views_are_refused() {
        let lens = truth();
        let target: Target = "chessboard:10x7:16".parse().unwrap();
        let camera = lens.normalised();
        let found = poses(&target, &lens)
            .iter()
            .enumerate()
            .map(|(i, pose)| {
                let board_mm: Vec<Vector3<f64>> =
                    target.points_mm().iter().map(|p| p.push(0.0)).collect();
                let wobble = |k: usize| 0.05 * ((k * 7919 % 97) as f64 / 97.0 - 0.5);
                let pixels = board_mm
                    .iter()
                    .enumerate()
                    .map(|(k, b)| {
                        let p = Vector3::new(b.x, b.y, 0.0) + pose.shift_mm;
                        camera.to_pixel(Vector2::new(p.x / p.z, p.y / p.z))
                            + Vector2::new(wobble(k + i), wobble(3 * k + i))
                    })
                    .collect();
                (i, BoardView { board_mm, pixels, radius_mm: 0.0 })
            })
            .collect();
        let names: Vec<String> = (0..12).map(|i| i.to_string()).collect();
        let made = lens::from_views(&names, found, vec![None; 12], (800, 600), Distortion::Full);
        let words = made.unwrap_err().to_string();
        assert!(words.contains("focal length") && words.contains("tilt"), "{words}");
    }

    /// OpenCV's own chessboard pictures against the figures published beside them (`left_intrinsics.yml`).
    #[test]
    fn opencvs_own_pictures_give_opencvs_own_figures() {
        let folder = Path::new("/usr/share/doc/opencv-doc/examples/data");
        if !folder.join("left01.jpg").exists() {
            println!("skipped: Debian's opencv-doc with left01.jpg is not installed");
            return;
        }
        for side in ["left", "right"] {
            let images: Vec<String> = (1..=14)
                .map(|i| folder.join(format!("{side}{i:02}.jpg")))
                .filter(|p| p.exists())
                .map(|p| p.display().to_string())
                .collect();
            let mut args: Vec<&str> = vec!["calib", "camera"];
            args.extend(images.iter().map(String::as_str));
            args.extend(["--target", "chessboard:10x7:25"]);
            let (json, code, words) = run(&args);
            assert_eq!(code, Some(0), "{words}");
            println!("{side}: {json:#}");
            let used =
                json["views"].as_array().unwrap().iter().filter(|v| v["used"] == true).count();
            assert!(used >= 12, "{used} of {}", images.len());
            let rms = json["rms_px"].as_f64().unwrap();
            assert!(rms < 0.39, "{side}: {rms} px rms");
            if side == "left" {
                // The published run kept a view with mislocated corners (left02: 1.18 px rms, here 0.19), so its
                // numbers are no truth to better than this.
                for (name, published, within) in [
                    ("fx_px", 535.916, 5.0),
                    ("fy_px", 535.916, 5.0),
                    ("cx_px", 342.283, 4.0),
                    ("cy_px", 235.571, 4.0),
                    ("k1", -0.26637, 0.06),
                ] {
                    let (v, u) = value(&json, name);
                    assert!(
                        (v - published).abs() < within,
                        "{name}: {v} ± {u}, published {published}"
                    );
                }
            }
        }
    }
}
