//! Rendered pictures are what their truth says, by means that share nothing with measuring: moments of
//! the mark's darkness.

#![allow(clippy::unwrap_used)]

#[path = "common/plain_disc.rs"]
mod plain_disc;

use assert_cmd::Command;
use nalgebra::Vector2;
use pivotsight::render::burn::{self, Beam};
use pivotsight::render::{BurnScene, Preset, RodScene, rod};

use plain_disc::plain_disc;

/// Centre and radius of the darkness, from its moments in the plane.
fn moments(made: &burn::RenderedBurn) -> (Vector2<f64>, f64) {
    let picture = &made.picture;
    let view = made.camera.calibration.view(picture.width_px, picture.height_px).unwrap();
    let values = picture.channel(0);
    let border = &values[..picture.width_px];
    let bright = border.iter().map(|&v| f64::from(v)).sum::<f64>() / border.len() as f64;
    let dark = 0.85 * 0.1;
    let (mut area, mut first) = (0.0, Vector2::zeros());
    for (i, &value) in values.iter().enumerate() {
        let pixel = Vector2::new((i % picture.width_px) as f64, (i / picture.width_px) as f64);
        let part = (bright - f64::from(value)) / (bright - dark);
        if part.abs() > 5e-4 {
            let size = part * view.mm_per_px(pixel).determinant().abs();
            area += size;
            first += view.to_plane(pixel) * size;
        }
    }
    (first / area, (area / std::f64::consts::PI).sqrt())
}

#[test]
fn a_disc_lies_where_its_truth_says_at_every_blur_and_view() {
    for (blur, tilt, k1) in [(0.8, 0.0, 0.0), (1.2, 0.0, 0.0), (3.0, 0.0, 0.0), (0.8, 4.0, -0.2)] {
        let mut scene = plain_disc();
        scene.camera.blur_px = blur.into();
        scene.camera.tilt_deg = [tilt.into(), (-tilt / 2.0).into()];
        scene.camera.distortion[0] = k1.into();
        for seed in 0..3 {
            let made = burn::render(&scene, seed).unwrap();
            let (center, radius) = moments(&made);
            let truth = Vector2::from(made.truth.ring.center_mm);
            // 0.02 µm at 20 µm a pixel: a thousandth of a pixel.
            let off_um = 1e3 * (center - truth).norm();
            let radius_off_um = 1e3 * (radius - made.truth.ring.diameter_mm / 2.0);
            assert!(off_um < 0.03, "blur {blur} tilt {tilt}: centre off by {off_um} µm");
            assert!(radius_off_um.abs() < 0.1, "blur {blur}: radius off by {radius_off_um} µm");
        }
    }
}

#[test]
fn a_seed_gives_one_picture_whatever_the_number_of_threads() {
    let mut scene = BurnScene::preset(Preset::Hard).unwrap();
    scene.camera = scene.camera.binned(4);
    scene.sensor.colour = true;
    scene.sensor.bits = 12;
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| burn::render(&scene, 7).unwrap().picture)
    };
    let one = on(1);
    assert_eq!(one, on(3));
    assert_eq!((one.channels, one.values.iter().max().unwrap() <= &4095), (3, true));
    assert_ne!(one, burn::render(&scene, 8).unwrap().picture);
}

#[test]
fn a_leaning_beam_moves_the_spot_by_the_height_difference() {
    let beam = Beam { b_error_deg: 0.1, flange_tilt_deg: 0.0 };
    let offset = beam.offset_mm(50.0, 3.0);
    assert!((offset.x - 47.0 * 0.1f64.to_radians().tan()).abs() < 1e-12 && offset.y == 0.0);
    let beam = Beam { b_error_deg: 0.0, flange_tilt_deg: 0.1 };
    assert!((beam.offset_mm(50.0, 3.0).y + 47.0 * 0.1f64.to_radians().tan()).abs() < 1e-12);
}

#[test]
fn rod_captures_show_the_rim_of_a_rod_that_turns_with_c() {
    let mut scene = RodScene::preset(Preset::Clean).unwrap();
    scene.camera = scene.camera.binned(8);
    scene.axis.eccentricity_mm = 0.2.into();
    scene.captures.c_deg = vec![0.0, 90.0, 180.0];
    let made = rod::render(&scene, 3).unwrap();
    let truth = &made.truth;
    let center = |i: usize| Vector2::from(truth.rod_centers[i].center_mm);
    let axis = Vector2::from(truth.axis_center_mm);
    assert!(((center(0) + center(2)) / 2.0 - axis).norm() < 1e-12);
    let (a, b) = (center(0) - axis, center(1) - axis);
    assert!((Vector2::new(-a.y, a.x) - b).norm() < 1e-12, "C turns counter-clockwise");
    for capture in &made.captures {
        // Bright on the rod, dark on the table, at every pixel well away from the rim.
        let picture = &capture.picture;
        let view = made.camera.calibration.view(picture.width_px, picture.height_px).unwrap();
        let i = truth.rod_centers.iter().position(|r| r.c_deg == capture.c_deg).unwrap();
        for (k, value) in picture.channel(0).into_iter().enumerate() {
            let pixel = Vector2::new((k % picture.width_px) as f64, (k / picture.width_px) as f64);
            let at = Vector2::from(capture.machine_mm) + view.to_plane(pixel);
            let out = (at - center(i)).norm() - truth.diameter_mm / 2.0;
            if out.abs() > 0.6 {
                assert_eq!(value > 0.4, out < 0.0, "{out} {value}");
            }
        }
    }
}

#[test]
fn the_command_writes_pictures_truth_and_calibration_and_checks_its_scene() {
    let folder = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        Command::cargo_bin("pivotsight").unwrap().args(args).current_dir(&folder).output().unwrap()
    };
    let done = run(&[
        "render",
        "rod",
        "--preset",
        "typical",
        "--out-dir",
        "a/b",
        "--binning",
        "8",
        "--format",
        "json",
    ]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(json["schema"], "pivotsight.render-rod/1");
    for name in ["rod-0001.csv", "rod-0001-01.png", "rod-0001.truth.json", "calib.toml"] {
        assert!(folder.path().join("a/b").join(name).exists(), "{name}");
    }
    for (text, words) in [
        (
            "schema = 1\nkind = 'burn'\n[ring]\nradius = 3.0\n",
            "s.toml:4: ring: unknown field `radius`",
        ),
        (
            "schema = 1\nkind = 'burn'\n[ring]\nradius_mm = [2.0, 900.0]\n",
            "ring.radius_mm: may become 900",
        ),
        ("schema = 1\nkind = 'rod'\n", "kind: is 'rod'"),
        (
            "schema = 1\nkind = 'burn'\n[spot]\noffset_mm = [0, 0]\n[machine]\n",
            "spot.offset_mm: is given",
        ),
        ("schema = 1\nkind = 'burn'\n[ring]\nradius_mm = 'big'\n", "a number, a range [low, high]"),
    ] {
        std::fs::write(folder.path().join("s.toml"), text).unwrap();
        let failed = run(&["render", "burn", "s.toml", "--out-dir", "never"]);
        let message = String::from_utf8_lossy(&failed.stderr).into_owned();
        assert_eq!(failed.status.code(), Some(2), "{message}");
        assert!(message.contains(words), "{message}");
        assert!(!folder.path().join("never").exists());
    }
}
