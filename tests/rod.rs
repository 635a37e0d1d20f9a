//! `rod` on a machine whose positions are not exact: the interval knows it, and a slip of the pen is named.

mod painter;
#[path = "common/turned_rod.rs"]
mod turned_rod;

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, View};
use pivotsight::frame::{Frame, Gray, Picture};
use pivotsight::measure::rod::{self, Capture, Options, Report};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use turned_rod::{AXIS_MM, eccentric, turning};

/// The captures of a rendered rod with everything that stays the same when their positions change.
struct Rod {
    captures: Vec<Capture>,
    frames: Vec<(Frame, View)>,
    center_mm: Vector2<f64>,
}

fn rendered() -> Rod {
    let folder = format!("{}/images/rod-typical", env!("CARGO_MANIFEST_DIR"));
    let calibration = Calibration::read(format!("{folder}/calib.toml")).unwrap();
    let captures = rod::read_captures(format!("{folder}/rod-0001.csv"), &mut Vec::new()).unwrap();
    let frames = captures
        .iter()
        .map(|c| {
            let picture = Picture::read(&c.path).unwrap();
            let (w, h) = picture.size();
            let view = calibration.view_of(&c.image, w, h).unwrap();
            (picture.into_frame(Options::default().channel), view)
        })
        .collect();
    let truth = std::fs::read_to_string(format!("{folder}/rod-0001.truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
    let at = |k: usize| truth["rod_centers"][0]["center_mm"][k].as_f64().unwrap();
    Rod { captures, frames, center_mm: Vector2::new(at(0), at(1)) }
}

impl Rod {
    /// The report where each capture lies elsewhere than its table says.
    fn displaced(&self, by: impl FnMut(usize) -> Vector2<f64>) -> Report {
        let mut captures = self.captures.clone();
        let shifts = (0..captures.len()).map(by).collect::<Vec<_>>();
        captures.iter_mut().zip(shifts).for_each(|(c, shift)| c.position_mm += shift);
        rod::measure_frames(&captures, &self.frames, &Options::default()).unwrap().report
    }
}

#[test]
fn inexact_positions_of_the_machine_are_in_the_interval() {
    let rod = rendered();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let normal = Normal::new(0.0, 0.005).unwrap();
    let (mut inside, mut widest, mut scatter) = (0, 0.0_f64, 0.0);
    let runs = 15;
    for _ in 0..runs {
        let report = rod.displaced(|_| Vector2::from_fn(|_, _| normal.sample(&mut rng)));
        for k in 0..2 {
            let error = report.rod_centers[0].center_mm[k] - rod.center_mm[k];
            let u95 = report.rod_centers[0].center_u95_mm[k];
            inside += usize::from(error.abs() <= u95);
            widest = widest.max(u95);
        }
        scatter += report.position_scatter_mm / f64::from(runs);
        assert!(report.captures.iter().all(|c| c.arc_used > 0.8), "{:?}", report.captures);
    }
    assert!(inside >= 26, "{inside} of {} values inside their interval", 2 * runs);
    assert!(widest < 0.02, "{widest} mm");
    assert!((0.003..0.008).contains(&scatter), "5 µm of scatter, found {scatter} mm");
}

/// One capture at each table angle: none disagrees with another, and the positions have to be taken for exact.
#[test]
fn captures_that_cannot_disagree_do_not_widen_the_interval() {
    let mut rod = rendered();
    rod.captures.truncate(1);
    rod.frames.truncate(1);
    let report = rod.displaced(|_| Vector2::zeros());
    assert!(report.rod_centers[0].center_u95_mm.iter().all(|u| *u < 0.03), "{report:#?}");
    assert_eq!(report.position_scatter_mm, 0.0);
}

#[test]
fn exact_positions_show_no_scatter_and_one_slip_is_named_and_left_out() {
    let rod = rendered();
    let exact = rod.displaced(|_| Vector2::zeros());
    assert_eq!(exact.position_scatter_mm, 0.0, "{exact:#?}");
    for slip_mm in [0.05, 0.5, 2.0] {
        let report = rod.displaced(|i| Vector2::new(if i == 1 { slip_mm } else { 0.0 }, 0.0));
        let told = report.warnings.iter().find(|w| w.contains("rod-0001-02.png: left out"));
        let told = told.unwrap_or_else(|| panic!("{slip_mm}: {:?}", report.warnings));
        assert!(slip_mm < 2.0 || told.contains("its x_mm were +2.0"), "{slip_mm}: {told}");
        assert_eq!(report.captures[1].edge_points, 0);
        for k in 0..2 {
            let error = (report.rod_centers[0].center_mm[k] - rod.center_mm[k]).abs();
            let u95 = report.rod_centers[0].center_u95_mm[k];
            assert!(error < 1.5 * u95 && u95 < 0.002, "{slip_mm}: {error} ± {u95}");
        }
    }
}

/// Moved along its rim a capture shows an arc that looks nearly right, and leads the search astray until it is left out of it.
#[test]
fn a_capture_displaced_along_the_rim_is_found_out() {
    let rod = rendered();
    for (moved, slip_mm) in [(1, 0.06), (3, 0.09), (4, 0.13)] {
        let report = rod.displaced(|i| {
            let out = (rod.center_mm - rod.captures[i].position_mm).normalize();
            if i == moved { slip_mm * Vector2::new(-out.y, out.x) } else { Vector2::zeros() }
        });
        let image = &report.captures[moved].image;
        let told = report.warnings.iter().any(|w| w.starts_with(&format!("{image}: ")));
        assert!(told, "{moved}: {:?}", report.warnings);
        for k in 0..2 {
            let error = (report.rod_centers[0].center_mm[k] - rod.center_mm[k]).abs();
            let u95 = report.rod_centers[0].center_u95_mm[k];
            assert!(error < 1.5 * u95 && u95 < 0.002, "{moved}: {error} ± {u95}");
        }
    }
}

#[test]
fn an_angle_of_which_one_capture_alone_shows_the_rim_is_refused_by_name() {
    let mut rod = rendered();
    let last = rod.captures.len() - 1;
    rod.captures[last - 1..].iter_mut().for_each(|c| c.c_deg = 90.0);
    let (width, height) = (rod.frames[last].0.width(), rod.frames[last].0.height());
    let data = vec![90u8; width * height];
    rod.frames[last].0 = Frame::Eight(Gray { width, height, data });
    let refused = rod::measure_frames(&rod.captures, &rod.frames, &Options::default());
    let why = refused.map(|m| m.report.diameter_mm).unwrap_err().to_string();
    assert!(why.contains("C = 90°") && why.contains("only one of the 2"), "{why}");
    let names = format!("{} does, not {}", rod.captures[last - 1].image, rod.captures[last].image);
    assert!(why.contains(&names), "{why}");
}

/// An arc of the chamfer lies on the rod's circle too, about another centre: the angle that has it does not turn with the others.
#[test]
fn an_angle_whose_centre_does_not_turn_with_the_table_is_refused_by_name() {
    let mut rod = rendered();
    for (i, capture) in rod.captures.iter_mut().enumerate() {
        capture.c_deg = [0.0, 90.0, 180.0][i % 3];
        capture.position_mm.x += if i % 3 == 2 { 0.2 } else { 0.0 };
    }
    let refused = rod::measure_frames(&rod.captures, &rod.frames, &Options::default());
    let why = refused.map(|m| m.report.axis_center_mm).unwrap_err().to_string();
    assert!(why.contains("do not turn with the table"), "{why}");
}

/// Of two captures at one of four table angles the other angles tell which is right; where none is left of an angle, the other three tell
/// the axis.
#[test]
fn a_capture_that_one_of_four_angles_shows_elsewhere_is_left_out_by_name() {
    const MM_PER_PX: f64 = 0.0075;
    let radius_px = 1000.0;
    let ways = (0..8).map(|k| (90.0 * f64::from(k % 4), 17.0 + 45.0 * f64::from(k)));
    let ways: Vec<_> = ways.collect();
    let (mut captures, mut frames) = turning(&ways, MM_PER_PX, radius_px, |from_px, _| {
        60.0 + 110.0 * 0.5 * libm::erfc((from_px.norm() - radius_px) / 2.0)
    });
    captures[0].position_mm.y += 10.0;
    for angles in [4, 3] {
        let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
        let told = report.warnings.iter().find(|w| w.starts_with("capture 0: left out"));
        assert!(told.is_some_and(|w| w.contains("y_mm +10.00 mm")), "{:?}", report.warnings);
        assert_eq!(report.rod_centers.len(), angles);
        let off_mm = Vector2::from(report.axis_center_mm) - Vector2::from(AXIS_MM);
        for (off, u95) in off_mm.iter().zip(report.axis_center_u95_mm) {
            assert!(off.abs() < 1.5 * u95 && u95 < 0.005, "{angles}: {off} ± {u95}");
        }
        captures.remove(4);
        frames.remove(4);
    }
}

/// At several table angles the others of its angle follow a slip of a few hundredths: it is told by how well all agree without it.
#[test]
fn a_slip_at_one_of_several_table_angles_is_named_and_left_out() {
    const MM_PER_PX: f64 = 0.0075;
    let radius_px = 1000.0;
    let (mut captures, frames) = eccentric(MM_PER_PX, radius_px, |from_px, _| {
        60.0 + 110.0 * 0.5 * libm::erfc((from_px.norm() - radius_px) / 2.0)
    });
    captures[4].position_mm.x += 0.05;
    let report = rod::measure_frames(&captures, &frames, &Options::default()).unwrap().report;
    let told = report.warnings.iter().any(|w| w.starts_with("capture 4: left out"));
    assert!(told && report.captures[4].edge_points == 0, "{:?}", report.warnings);
    let off_mm = Vector2::from(report.axis_center_mm) - Vector2::from(AXIS_MM);
    for (off, u95) in off_mm.iter().zip(report.axis_center_u95_mm) {
        assert!(off.abs() < 1.5 * u95 && u95 < 0.001, "{off} ± {u95}");
    }
}

/// One arc at each table angle tells radius and centre badly, but all centres turn together: the diameter is as sure as its errors are small,
/// where the machine's positions are exact and where they are not, and where the corners are darker by up to a fifth.
#[test]
fn one_capture_an_angle_tells_the_diameter_as_surely_as_it_is_known() {
    const MM_PER_PX: f64 = 0.0075;
    const RUNS: u32 = 10;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(9);
    for (scatter_mm, angles, widest_mm) in [(0.0, 6, 1e-4), (5e-4, 10, 8e-4)] {
        let normal = Normal::new(0.0, scatter_mm).unwrap();
        let (mut inside, mut squares, mut widths) = (0, 0.0, Vec::new());
        for run in 0..RUNS {
            let radius_px = 500.0 + 31.7 * f64::from(run);
            let step_deg = 360.0 / f64::from(angles);
            let way = |k| (step_deg * f64::from(k), 3.0 * step_deg * f64::from(k) + f64::from(run));
            let ways: Vec<_> = (0..angles).map(way).collect();
            let darker = [0.0, 0.1, 0.2][run as usize % 3];
            let (mut captures, frames) = turning(&ways, MM_PER_PX, radius_px, |from_px, p| {
                let corner = (p - Vector2::new(319.5, 239.5)).norm_squared() / 1.6e5;
                let step = 60.0 + 45.0 * libm::erfc((radius_px - from_px.norm()) / 2.0);
                step * (1.0 - darker * corner)
            });
            captures.iter_mut().for_each(|c| {
                c.position_mm += Vector2::from_fn(|_, _| normal.sample(&mut rng));
            });
            let seen = rod::measure_frames(&captures, &frames, &Options::default());
            let report = seen.unwrap().report;
            let off_mm = report.diameter_mm - 2.0 * radius_px * MM_PER_PX;
            println!("{scatter_mm}: off by {off_mm:.6} ± {:.6} mm", report.diameter_u95_mm);
            inside += u32::from(off_mm.abs() < report.diameter_u95_mm);
            squares += off_mm * off_mm;
            widths.push(report.diameter_u95_mm);
        }
        widths.sort_by(f64::total_cmp);
        let (middle_mm, rms_mm) = (widths[RUNS as usize / 2], (squares / f64::from(RUNS)).sqrt());
        assert!(inside + 1 >= RUNS, "{scatter_mm}: {inside} of {RUNS}");
        // How pixels integrate light leaves 0.002 px of the radius open in every interval.
        let known_mm = rms_mm.hypot(2.0 * 0.002 * MM_PER_PX);
        println!("± {middle_mm:.6} mm for {rms_mm:.6} mm rms");
        assert!(middle_mm < 3.0 * 1.96 * known_mm, "{middle_mm} mm for {rms_mm} mm");
        assert!(middle_mm < widest_mm, "{middle_mm} mm");
    }
}
