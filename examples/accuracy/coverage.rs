//! Rendered burns, circles and rods of the three presets: errors against the truth, and whether the stated intervals hold.

use pivotsight::error::Result;
use pivotsight::frame::{Channel, Picture};
use pivotsight::measure::rod::Capture;
use pivotsight::measure::{burn, circles, rod};
use pivotsight::render::rod::RenderedRod;
use pivotsight::render::{self, BurnScene, Preset, RodScene};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::decoded::{self, Shown};
use crate::stats::{quantile, share};

const LEVELS: [(&str, Preset); 3] =
    [("clean", Preset::Clean), ("typical", Preset::Typical), ("hard", Preset::Hard)];

/// One number of a result.
struct Answer {
    error_mm: f64,
    u95_mm: f64,
}

/// The numbers of one picture: a list for each row of the table.
type Answers<const N: usize> = Result<[Vec<Answer>; N]>;

/// Prints the table of one kind of picture, `burns`, `circles` or `rods`, at one level or (empty) all. `false` for any other.
pub fn table(kind: &str, cases: u64, seed: u64, only: &str) -> bool {
    if !only.is_empty() && !LEVELS.iter().any(|(level, _)| only == *level) {
        return false;
    }
    println!(
        "| {kind} | pictures | refused | median µm | 90 % | worst | u95 holds | over 3 u95 | width / needed |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (level, preset) in LEVELS.into_iter().filter(|(l, _)| only.is_empty() || only == *l) {
        let seeds = (0..cases).into_par_iter().map(|i| seed * 100_000 + i);
        match kind {
            "burns" => {
                let scene = BurnScene::preset(preset).expect("a preset is a scene");
                rows(level, ["offset"], seeds.map(|s| (s, one_burn(&scene, s))).collect());
            }
            "circles" => {
                let scene = BurnScene::preset(preset).expect("a preset is a scene");
                let answers = seeds.map(|s| (s, two_circles(&scene, s))).collect();
                rows(level, ["ring's centre", "spot's centre", "diameters"], answers);
            }
            "rods" => {
                let scene = RodScene::preset(preset).expect("a preset is a scene");
                let answers = seeds.map(|s| (s, one_rod(&scene, s))).collect();
                let what =
                    ["axis", "diameter", "axis, positions inexact", "diameter, positions inexact"];
                rows(level, what, answers);
            }
            _ => return false,
        }
    }
    true
}

fn pair(found: [f64; 2], truth: [f64; 2], u95: [f64; 2]) -> Vec<Answer> {
    (0..2).map(|k| Answer { error_mm: found[k] - truth[k], u95_mm: u95[k] }).collect()
}

fn one_burn(scene: &BurnScene, seed: u64) -> Answers<1> {
    let made = render::burn::render(scene, seed)?;
    let picture = Picture::decode("rendered", &made.picture.png()?)?;
    let options = burn::Options::default();
    let report = burn::measure(&picture, &made.camera.calibration, &options, "rendered")?.report;
    Ok([pair(report.offset.offset_mm, made.truth.offset_mm, report.offset.offset_u95_mm)])
}

fn two_circles(scene: &BurnScene, seed: u64) -> Answers<3> {
    let made = render::burn::render(scene, seed)?;
    let picture = Picture::decode("rendered", &made.picture.png()?)?;
    let truths = [&made.truth.ring, &made.truth.spot];
    let options = circles::Options {
        expect_mm: truths.map(|t| t.diameter_mm).to_vec(),
        channel: Channel::default(),
    };
    let measured = circles::measure(&picture, &made.camera.calibration, &options, "rendered")?;
    let [ring, spot] = [0, 1].map(|i| &measured.report.circles[i].circle);
    let centre = |i: usize| {
        let circle = [ring, spot][i];
        pair(circle.center_mm, truths[i].center_mm, circle.center_u95_mm)
    };
    let diameters = pair(
        [ring.diameter_mm, spot.diameter_mm],
        truths.map(|t| t.diameter_mm),
        [ring.diameter_u95_mm, spot.diameter_u95_mm],
    );
    Ok([centre(0), centre(1), diameters])
}

/// Scatter of the positions of a machine that is not exact.
const SCATTER_MM: f64 = 0.003;

/// The C axis, or the rod's centre where one table angle only is seen, and the diameter; again where the machine's positions
/// scatter.
fn one_rod(scene: &RodScene, seed: u64) -> Answers<4> {
    let made = render::rod::render(scene, seed)?;
    let (mut captures, frames) = decoded::captures(&made)?;
    let [axis, diameter] = rod_answers(&made, &captures, &frames)?;
    let mut dice = ChaCha8Rng::seed_from_u64(seed);
    for capture in &mut captures {
        for axis in capture.position_mm.iter_mut() {
            let z: f64 = StandardNormal.sample(&mut dice);
            *axis += SCATTER_MM * z;
        }
    }
    let [inexact_axis, inexact_diameter] = rod_answers(&made, &captures, &frames)?;
    Ok([axis, diameter, inexact_axis, inexact_diameter])
}

fn rod_answers(made: &RenderedRod, captures: &[Capture], frames: &[Shown]) -> Answers<2> {
    let report = rod::measure_frames(captures, frames, &rod::Options::default())?.report;
    let truth = if report.axis_separated {
        made.truth.axis_center_mm
    } else {
        made.truth.rod_centers[0].center_mm
    };
    let diameter = Answer {
        error_mm: report.diameter_mm - made.truth.diameter_mm,
        u95_mm: report.diameter_u95_mm,
    };
    Ok([pair(report.axis_center_mm, truth, report.axis_center_u95_mm), vec![diameter]])
}

/// One row for each of `what`. The last column compares the stated intervals with those that would hold 95 % of the errors:
/// the reciprocal of the 95 % quantile of |error| / u95. With `VERBOSE` set, tells of each picture.
fn rows<const N: usize>(level: &str, what: [&str; N], answers: Vec<(u64, Answers<N>)>) {
    let all = answers.len();
    if std::env::var_os("VERBOSE").is_some() {
        answers.iter().for_each(|(seed, a)| eprintln!("{level} {seed}: {}", line(what, a)));
    }
    let good: Vec<[Vec<Answer>; N]> = answers.into_iter().filter_map(|(_, a)| a.ok()).collect();
    for (k, what) in what.iter().enumerate() {
        let errors: Vec<f64> = good
            .iter()
            .map(|g| 1e3 * g[k].iter().map(|a| a.error_mm * a.error_mm).sum::<f64>().sqrt())
            .collect();
        let ratios: Vec<f64> =
            good.iter().flat_map(|g| &g[k]).map(|a| a.error_mm.abs() / a.u95_mm).collect();
        let within = |k: f64| ratios.iter().filter(|r| **r <= k).count();
        println!(
            "| {level}, {what} | {all} | {} | {:.3} | {:.3} | {:.3} | {} | {} | {:.2} |",
            all - good.len(),
            quantile(&errors, 0.5),
            quantile(&errors, 0.9),
            quantile(&errors, 1.0),
            share(within(1.0), ratios.len()),
            ratios.len() - within(3.0),
            1.0 / quantile(&ratios, 0.95),
        );
    }
}

fn line<const N: usize>(what: [&str; N], answers: &Answers<N>) -> String {
    let each = match answers {
        Ok(each) => each,
        Err(why) => return format!("refused: {why}"),
    };
    let of = |(what, list): (&str, &Vec<Answer>)| {
        let number = |a: &Answer| format!("{:.3} (u95 {:.3})", 1e3 * a.error_mm, 1e3 * a.u95_mm);
        format!("{what} off {} µm", list.iter().map(number).collect::<Vec<_>>().join(" "))
    };
    what.into_iter().zip(each).map(of).collect::<Vec<_>>().join("; ")
}
