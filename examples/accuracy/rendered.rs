//! Rendered burns and rods of the three presets against their truth.

use std::path::PathBuf;

use nalgebra::Vector2;
use pivotsight::error::Result;
use pivotsight::frame::{Channel, Picture};
use pivotsight::measure::{burn, rod};
use pivotsight::render::{self, BurnScene, Preset, RodScene};
use rayon::prelude::*;

const LEVELS: [(&str, Preset); 3] =
    [("clean", Preset::Clean), ("typical", Preset::Typical), ("hard", Preset::Hard)];

/// One answer: error and half-widths, mm.
struct Answer {
    error_mm: Vector2<f64>,
    u95_mm: [f64; 2],
}

/// Prints the table of burns: error of the offset.
pub fn burns(cases: u64, seed: u64) {
    head("offset");
    for (name, preset) in LEVELS {
        let scene = BurnScene::preset(preset).expect("a preset is a scene");
        let answers = (0..cases).into_par_iter().map(|i| one_burn(&scene, seed * 100_000 + i));
        row(name, answers.collect());
    }
}

fn one_burn(scene: &BurnScene, seed: u64) -> Result<Answer> {
    let made = render::burn::render(scene, seed)?;
    let picture = Picture::decode("rendered", &made.picture.png()?)?;
    let options = burn::Options::default();
    let report = burn::measure(&picture, &made.camera.calibration, &options, "rendered")?.report;
    let error_mm = Vector2::from(report.offset_mm) - Vector2::from(made.truth.offset_mm);
    Ok(Answer { error_mm, u95_mm: report.offset_u95_mm })
}

/// Prints the table of rods: error of the C axis, or of the rod's centre where one angle only is seen.
pub fn rods(cases: u64, seed: u64) {
    head("axis");
    for (name, preset) in LEVELS {
        let scene = RodScene::preset(preset).expect("a preset is a scene");
        let answers = (0..cases).map(|i| one_rod(&scene, seed * 100_000 + i));
        row(name, answers.collect());
    }
}

fn one_rod(scene: &RodScene, seed: u64) -> Result<Answer> {
    let made = render::rod::render(scene, seed)?;
    let (mut captures, mut frames) = (Vec::new(), Vec::new());
    for (i, capture) in made.captures.iter().enumerate() {
        let picture = Picture::decode("rendered", &capture.picture.png()?)?;
        let (width, height) = picture.size();
        let view = made.camera.calibration.view(width, height)?;
        frames.push((picture.into_frame(Channel::Luminance), view));
        captures.push(rod::Capture {
            image: format!("capture {i}"),
            path: PathBuf::new(),
            position_mm: capture.machine_mm.into(),
            c_deg: capture.c_deg,
            t_s: None,
            temp_c: None,
            direction: None,
        });
    }
    let report = rod::measure_frames(&captures, &frames, &rod::Options::default())?.report;
    let truth = if report.axis_separated {
        made.truth.axis_center_mm
    } else {
        made.truth.rod_centers[0].center_mm
    };
    let error_mm = Vector2::from(report.axis_center_mm) - Vector2::from(truth);
    Ok(Answer { error_mm, u95_mm: report.axis_center_u95_mm })
}

fn head(what: &str) {
    println!(
        "| {what} | median µm | 90 % | worst | median u95 µm | u95 holds | beyond 3 u95 | refused |"
    );
    println!("|---|---|---|---|---|---|---|---|");
}

fn row(name: &str, answers: Vec<Result<Answer>>) {
    let total = answers.len();
    let good: Vec<Answer> = answers.into_iter().filter_map(Result::ok).collect();
    let n = good.len();
    if n == 0 {
        println!("| {name} | - | - | - | - | - | - | {total} |");
        return;
    }
    let sorted = |f: &dyn Fn(&Answer) -> f64| {
        let mut list: Vec<f64> = good.iter().map(f).collect();
        list.sort_by(f64::total_cmp);
        list
    };
    let errors = sorted(&|a| 1e3 * a.error_mm.norm());
    let widths = sorted(&|a| 1e3 * a.u95_mm[0]);
    let within =
        |a: &Answer, k: f64| (0..2).filter(|&i| a.error_mm[i].abs() <= k * a.u95_mm[i]).count();
    let holds: usize = good.iter().map(|a| within(a, 1.0)).sum();
    let wrong = good.iter().filter(|a| within(a, 3.0) < 2).count();
    println!(
        "| {name} | {:.3} | {:.3} | {:.3} | {:.3} | {:.1} % | {wrong} of {n} | {} |",
        errors[n / 2],
        errors[n * 9 / 10],
        errors[n - 1],
        widths[n / 2],
        50.0 * holds as f64 / n as f64,
        total - n
    );
}
