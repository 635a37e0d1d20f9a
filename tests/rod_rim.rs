//! Which edge of a `rod` is the rim: beside chamfers, grooves, turning lines and light that slopes or clips.

#[path = "../examples/accuracy/decoded.rs"]
mod decoded;
mod painter;
#[path = "common/turned_rod.rs"]
mod turned_rod;

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::frame::Frame;
use pivotsight::measure::rod::{self, Capture, Options};
use pivotsight::render::{self, Preset, RodScene};
use turned_rod::{AXIS_MM, eccentric, turning, turning_off};

/// On the side away from the light the chamfer is as dark as the table, and its inner edge the only one to be seen: the rim is
/// found all the same, not a circle through the rim here and the chamfer there, nor the chamfer's.
#[test]
fn a_chamfer_dark_on_one_side_is_not_taken_for_the_rim() {
    let scene = RodScene::preset(Preset::Hard).unwrap();
    for seed in [4_100_002, 4_100_042] {
        let made = render::rod::render(&scene, seed).unwrap();
        let (captures, frames) = decoded::captures(&made).unwrap();
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let off_mm = report.diameter_mm - made.truth.diameter_mm;
        assert!(off_mm.abs() < report.diameter_u95_mm.max(0.005), "{seed}: {off_mm} mm");
    }
}

/// A chamfer that is hardly lighter than the table hides the rim's edge in every single capture, beside its own strong one; what most captures have
/// at one radius is the rim all the same.
#[test]
fn a_rim_that_is_faint_in_every_capture_is_the_rod() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("faint.toml");
    let preset = std::fs::read_to_string(format!(
        "{}/src/render/presets/rod-hard.toml",
        env!("CARGO_MANIFEST_DIR")
    ));
    let level = |line: &str| match line.split(" = ").next().unwrap() {
        "chamfer_mm" => "chamfer_mm = 0.4".to_owned(),
        "chamfer_lit" => "chamfer_lit = 0.36".to_owned(),
        "chamfer_dark" => "chamfer_dark = 0.33".to_owned(),
        "table" => "table = 0.3".to_owned(),
        "shadow" => "shadow = 0.0".to_owned(),
        "glare_count" => "glare_count = 0".to_owned(),
        _ => line.to_owned(),
    };
    let scene: Vec<String> = preset.unwrap().lines().map(level).collect();
    std::fs::write(&path, scene.join("\n")).unwrap();
    let scene = RodScene::read(&path).unwrap();
    for seed in [6, 8] {
        let made = render::rod::render(&scene, seed).unwrap();
        let (captures, frames) = decoded::captures(&made).unwrap();
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let off_mm = report.diameter_mm - made.truth.diameter_mm;
        assert!(off_mm.abs() < report.diameter_u95_mm, "{seed}: {off_mm} mm");
    }
}

/// Where pixels are coarse and the picture clear, rim and chamfer are some pixels apart, and the chamfer's edge is the stronger one.
#[test]
fn a_narrow_chamfer_seen_with_coarse_pixels_is_not_the_rim() {
    const MM_PER_PX: f64 = 0.012;
    let mapping = Mapping::Scale { mm_per_px: MM_PER_PX, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let (radius_mm, chamfer_mm) = (9.0, 0.15);
    let (mut captures, mut frames) = (Vec::new(), Vec::new());
    for (k, way_deg) in [20.0, 80.0, 140.0, 200.0, 260.0, 320.0f64].into_iter().enumerate() {
        let way = Vector2::new(way_deg.to_radians().cos(), way_deg.to_radians().sin());
        // The camera looks at the rim.
        let at_mm = Vector2::new(100.0, 50.0) + radius_mm * way;
        let seen = painter::picture(|p| {
            let plane_mm = MM_PER_PX * Vector2::new(p.x - 319.5, 239.5 - p.y);
            match (plane_mm + radius_mm * way).norm() {
                r if r < radius_mm - chamfer_mm => 160.0,
                r if r < radius_mm => 80.0,
                _ => 40.0,
            }
        });
        captures.push(Capture::in_memory(format!("capture {k}"), at_mm, 0.0));
        frames.push((
            seen.into_frame(Options::default().channel),
            calibration.view(640, 480).unwrap(),
        ));
    }
    for diameter_mm in [None, Some(2.0 * radius_mm)] {
        let options = Options { diameter_mm, ..Options::default() };
        let found = rod::measure_frames(&captures, &frames, &options).unwrap().report.diameter_mm;
        assert!((found - 2.0 * radius_mm).abs() < 0.001, "{diameter_mm:?}: {found}");
    }
}

/// Light that slopes across the picture moves every arc along it, and the axis with them at any number of table angles. Whether it slopes on
/// the rod, and is blurred with it, or behind the lens no picture tells: the interval has room for both.
#[test]
fn light_that_slopes_does_not_move_the_axis() {
    const MM_PER_PX: f64 = 0.008;
    let (radius_px, blur_px, slope) = (600.0, 2.0, 0.3 / 640.0);
    let [face, table] = [60.0, 150.0];
    // What a blurred step fitted to eight softnesses either side, with even levels, makes of it.
    let plain_mm = 7.7 * slope * blur_px * blur_px * MM_PER_PX;
    for on_the_rod in [true, false] {
        let (captures, frames) = eccentric(MM_PER_PX, radius_px, |from_px, p| {
            let z = (from_px.norm() - radius_px) / blur_px;
            let outside = 0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2);
            let peak = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
            // Blurred together with the step, light that grows outwards lifts the flank.
            let lifted = slope * from_px.x / radius_px * blur_px * peak;
            let step = (1.0 + slope * (p.x - 319.5)) * outside;
            let lit = step + if on_the_rod { lifted } else { 0.0 };
            (1.0 + slope * (p.x - 319.5)) * face + (table - face) * lit
        });
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let off_mm = Vector2::from(report.axis_center_mm) - Vector2::from(AXIS_MM);
        let u95_mm = report.axis_center_u95_mm;
        println!("{:?} of {plain_mm} mm, ± {u95_mm:?}", off_mm.as_slice());
        assert!(off_mm.norm() < 0.2 * plain_mm, "{off_mm} of {plain_mm} mm");
        assert!((0..2).all(|i| off_mm[i].abs() < u95_mm[i]), "{off_mm} ± {u95_mm:?}");
        assert!(u95_mm[0] < 0.5 * plain_mm, "{u95_mm:?}");
    }
}

/// Of a rod beside the axis, rim and chamfer's edge cross where all table angles are looked at about one centre.
#[test]
fn a_narrow_chamfer_of_an_eccentric_rod_is_not_the_rim() {
    const MM_PER_PX: f64 = 0.0075;
    let radius_px = 1000.0;
    for (face, chamfer, table) in [(200.0, 110.0, 30.0), (40.0, 125.0, 170.0)] {
        let (captures, frames) = eccentric(MM_PER_PX, radius_px, |from_px, _| {
            let outside = |r: f64| 0.5 * libm::erfc(-(from_px.norm() - r) / 2.0);
            let inner = outside(radius_px - 11.0);
            face + (chamfer - face) * inner + (table - chamfer) * outside(radius_px)
        });
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let off_mm = report.diameter_mm - 2.0 * radius_px * MM_PER_PX;
        assert!(off_mm.abs() < 0.001, "{} mm, off by {off_mm} mm", report.diameter_mm);
    }
}

/// Light that clips a part of the rim moves its edge there, and is told by the picture's name.
#[test]
fn light_clipped_at_the_rim_is_told() {
    const RADIUS_PX: f64 = 1000.0;
    let (captures, mut frames) = eccentric(0.0075, RADIUS_PX, |from_px, _| {
        60.0 + 110.0 * 0.5 * libm::erfc((from_px.norm() - RADIUS_PX) / 2.0)
    });
    let mut told = || {
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        // The light grows across the picture, and clips where it is a third brighter.
        let Frame::Eight(gray) = &mut frames[2].0 else { panic!("eight bits a pixel") };
        let width = gray.width;
        for (i, value) in gray.data.iter_mut().enumerate() {
            let light = 1.3 + 0.6 * (i % width) as f64 / width as f64;
            *value = (light * f64::from(*value)).min(255.0) as u8;
        }
        report.warnings.into_iter().find(|w| w.contains("light clips"))
    };
    assert_eq!(told(), None);
    assert!(told().is_some_and(|w| w.starts_with("capture 2: ")));
}

/// About one centre the rim of a rod that is far off the axis lies farther out at some table angles: that is no other edge.
#[test]
fn a_rod_far_off_the_axis_shows_no_other_edges() {
    const MM_PER_PX: f64 = 0.0075;
    let radius_px = 1200.0;
    let ways: Vec<_> = (0..9).map(|k| (120.0 * f64::from(k % 3), 40.0 * f64::from(k))).collect();
    for off_mm in [0.3, 0.5, 0.8] {
        let (captures, frames) = turning_off(off_mm, &ways, MM_PER_PX, radius_px, |from_px, _| {
            60.0 + 45.0 * libm::erfc((radius_px - from_px.norm()) / 2.0)
        });
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let told: Vec<_> = report.warnings.iter().filter(|w| w.contains("edge")).collect();
        assert!(told.is_empty(), "{off_mm}: {told:?}");
        let off_mm = report.diameter_mm - 2.0 * radius_px * MM_PER_PX;
        assert!(off_mm.abs() < 0.001, "off by {off_mm} mm");
    }
}

/// A short arc hardly tells its radius: with a certified diameter the centre is known the better, the better that is known.
#[test]
fn a_certified_diameter_carries_a_short_arc() {
    const MM_PER_PX: f64 = 0.0075;
    let radius_px = 1200.0;
    let (captures, frames) =
        turning(&[(0.0, 0.0), (0.0, 6.0)], MM_PER_PX, radius_px, |from_px, _| {
            60.0 + 45.0 * libm::erfc((radius_px - from_px.norm()) / 2.0)
        });
    let measured = |diameter_u_mm: Option<f64>| {
        let known = Options::default();
        let options = Options {
            diameter_mm: diameter_u_mm.map(|_| 2.0 * radius_px * MM_PER_PX),
            diameter_u_mm: diameter_u_mm.unwrap_or(known.diameter_u_mm),
            ..known
        };
        let report = rod::measure_frames(&captures, &frames, &options).unwrap().report;
        let center_mm = Vector2::from(AXIS_MM) + Vector2::new(0.05, 0.0);
        let off_mm = Vector2::from(report.axis_center_mm) - center_mm;
        let u95_mm = Vector2::from(report.axis_center_u95_mm);
        assert!(off_mm.norm() < u95_mm.norm(), "{diameter_u_mm:?}: {off_mm} {u95_mm}");
        u95_mm.norm()
    };
    let [free, usual, certified] = [None, Some(0.02), Some(0.0005)].map(measured);
    println!("u95 of the centre: free {free:.5}, to 20 µm {usual:.5}, to 0.5 µm {certified:.5} mm");
    assert!(certified < 0.5 * usual && usual < 1.1 * free, "{free} {usual} {certified}");
}

/// Turning lines go round with the rim: where one ends at it all edge points are off alike, and only the lines beside it tell by how much.
#[test]
fn turning_lines_at_the_rim_are_in_the_diameters_interval() {
    const MM_PER_PX: f64 = 0.0075;
    let (radius_px, lines_px) = (800.0, 9.0);
    let [face, line, table] = [150.0, 4.0, 60.0];
    let mut worst_mm = 0.0f64;
    for phase in [0.0, 1.6, 3.1, 4.7f64] {
        let (captures, frames) = eccentric(MM_PER_PX, radius_px, |from_px, _| {
            let z = from_px.norm() - radius_px;
            let outside = 0.5 * libm::erfc(-z / 2.0);
            let turned = face + line * (std::f64::consts::TAU * z / lines_px + phase).sin();
            turned + (table - turned) * outside
        });
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let off_mm = (report.diameter_mm - 2.0 * radius_px * MM_PER_PX).abs();
        println!("off by {off_mm} ± {} mm", report.diameter_u95_mm);
        assert!(off_mm < report.diameter_u95_mm, "{off_mm} ± {}", report.diameter_u95_mm);
        assert!(report.diameter_u95_mm < 0.006, "{}", report.diameter_u95_mm);
        worst_mm = worst_mm.max(off_mm);
    }
    // They do move it.
    assert!(worst_mm > 0.0002, "{worst_mm}");
}

/// A rim that lies at another height than the calibration's plane, or beside an edge at another height, bends its arcs too much or too little. The
/// machine's places tell the diameter then, where the nominal one says that it is the rod.
#[test]
fn arcs_that_all_bend_too_little_leave_the_diameter_to_the_machine() {
    const MM_PER_PX: f64 = 0.008;
    let radius_px = 900.0;
    let ways: Vec<(f64, f64)> = (0..6).map(|k| (0.0, 17.0 + 60.0 * f64::from(k))).collect();
    let disc = |from: Vector2<f64>, _| if from.norm() < radius_px { 170.0 } else { 60.0 };
    let (captures, mut frames) = turning(&ways, MM_PER_PX, radius_px, disc);
    let mapping = Mapping::Scale { mm_per_px: 1.004 * MM_PER_PX, rotation_deg: 0.0 };
    let enlarged = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    frames.iter_mut().for_each(|(_, view)| *view = enlarged.view(640, 480).unwrap());
    let truth_mm = 2.0 * radius_px * MM_PER_PX;
    let options = Options { diameter_mm: Some(truth_mm + 0.01), ..Options::default() };
    let report = rod::measure_frames(&captures, &frames, &options).unwrap().report;
    let off_mm = report.diameter_mm - truth_mm;
    assert!(off_mm.abs() < report.diameter_u95_mm, "{off_mm} ± {}", report.diameter_u95_mm);
    assert!(report.diameter_u95_mm < 0.004 && report.axis_center_u95_mm[0] < 0.002, "{report:?}");
    let told = "0.40 % too large";
    assert!(report.warnings.iter().any(|w| w.contains(told)), "{:?}", report.warnings);
}

/// Turned grooves in the face are clearer than the rim: a nominal diameter says which of them is the rod, and one that nothing has is no reason to
/// take a ragged circle.
#[test]
fn a_nominal_diameter_finds_the_rim_beside_clearer_grooves() {
    const MM_PER_PX: f64 = 0.008;
    let radius_px = 1250.0;
    let ways: Vec<(f64, f64)> = (0..6).map(|k| (0.0, 17.0 + 60.0 * f64::from(k))).collect();
    let face = |from: Vector2<f64>, _| match radius_px - from.norm() {
        inside if inside < 0.0 => 120.0,
        inside if (175.0..181.0).contains(&inside) || (190.0..196.0).contains(&inside) => 20.0,
        _ => 150.0,
    };
    let (captures, frames) = turning(&ways, MM_PER_PX, radius_px, face);
    let truth_mm = 2.0 * radius_px * MM_PER_PX;
    let options = Options { diameter_mm: Some(truth_mm), ..Options::default() };
    let report = rod::measure_frames(&captures, &frames, &options).unwrap().report;
    let off_mm = report.diameter_mm - truth_mm;
    assert!(off_mm.abs() < report.diameter_u95_mm, "{off_mm} ± {}", report.diameter_u95_mm);
}
