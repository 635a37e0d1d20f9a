//! A second renderer, which shares nothing with the program's own, and how the program measures its pictures.
//!
//! Burn pictures and captures of check rods at three levels, all of a picture drawn from its seed: [`burn`], [`rod`].

pub mod burn;
mod caliper;
mod contour;
pub mod dice;
mod dirt;
mod optics;
pub mod rod;
mod texture;

use nalgebra::{DVector, Rotation2, Vector2};
use pivotsight::error::Result;
use pivotsight::frame::{Channel, Frame, Picture};
use pivotsight::measure::{self, rod::Capture};
use rayon::prelude::*;
use serde_json::json;

use crate::stats::{quantile, share};
use burn::{BurnPicture, Mark};
use caliper::Search;
use dice::Level;
use optics::{HEIGHT_PX, WIDTH_PX};
use rod::RodSet;

/// How one picture or set was answered.
pub struct Answer {
    /// Error and its u95, or why there is none.
    pub result: std::result::Result<[[f64; 2]; 2], String>,
    /// Error of the plain caliper.
    caliper_mm: Option<f64>,
    story: String,
}

/// Prints the table of one kind of picture, `burns` or `rods`, at one level or (empty) all. `false` for any other.
pub fn table(kind: &str, cases: u64, seed: u64, only: &str) -> bool {
    let (what, answer): (_, fn(Level, u64) -> Answer) = match kind {
        "burns" => ("pictures", |level, seed| burn_answer(&burn::render(level, seed))),
        "rods" => ("sets", |level, seed| rod_answer(&rod::render(level, seed))),
        _ => return false,
    };
    if !only.is_empty() && Level::named(only).is_none() {
        return false;
    }
    println!(
        "| holdout {kind} | {what} | refused | median µm | rms µm | worst µm | u95 holds | over 3 u95 | caliper median µm |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for level in Level::ALL.into_iter().filter(|l| only.is_empty() || only == l.name()) {
        let seeds = (0..cases).into_par_iter().map(|i| seed * 100_000 + i);
        let answers: Vec<(u64, Answer)> = seeds.map(|s| (s, answer(level, s))).collect();
        if std::env::var_os("VERBOSE").is_some() {
            answers.iter().for_each(|(s, a)| eprintln!("{} {s}: {}", level.name(), line(a)));
        }
        row(level, &answers.into_iter().map(|a| a.1).collect::<Vec<_>>());
    }
    true
}

fn line(answer: &Answer) -> String {
    let caliper = answer.caliper_mm.map_or("-".to_owned(), |c| format!("{:.3}", 1e3 * c));
    let Answer { story, .. } = answer;
    match &answer.result {
        Ok([error, u95]) => {
            let [x, y] = error.map(|e| 1e3 * e);
            let [a, b] = u95.map(|u| 1e3 * u);
            format!("off {x:.3} {y:.3} µm, u95 {a:.3} {b:.3}, caliper {caliper}; {story}")
        }
        Err(why) => format!("refused: {why}, caliper {caliper}; {story}"),
    }
}

fn row(level: Level, answers: &[Answer]) {
    let good: Vec<&[[f64; 2]; 2]> = answers.iter().filter_map(|a| a.result.as_ref().ok()).collect();
    let sizes: Vec<f64> = good.iter().map(|[e, _]| 1e3 * e[0].hypot(e[1])).collect();
    let rms = (sizes.iter().map(|s| s * s).sum::<f64>() / sizes.len() as f64).sqrt();
    let ratios: Vec<f64> =
        good.iter().flat_map(|[e, u]| [e[0].abs() / u[0], e[1].abs() / u[1]]).collect();
    let within = |k: f64| ratios.iter().filter(|r| **r <= k).count();
    let calipers: Vec<f64> = answers.iter().filter_map(|a| Some(1e3 * a.caliper_mm?)).collect();
    println!(
        "| {} | {} | {} | {:.3} | {rms:.3} | {:.3} | {} | {} | {:.3} |",
        level.name(),
        answers.len(),
        answers.len() - good.len(),
        quantile(&sizes, 0.5),
        quantile(&sizes, 1.0),
        share(within(1.0), ratios.len()),
        ratios.len() - within(3.0),
        quantile(&calipers, 0.5),
    );
}

/// How the program answers a picture of a burn.
pub fn burn_answer(made: &BurnPicture) -> Answer {
    let mut story = made.story.clone();
    let mut measured = || -> Result<_> {
        let picture = Picture::decode("holdout", &made.photo.pgm())?;
        let options = measure::burn::Options::default();
        let subject = "holdout";
        let report = measure::burn::measure(&picture, &made.calibration, &options, subject)?.report;
        let error = Vector2::from(report.offset.offset_mm) - truth_mm(made);
        for (name, found, mark) in
            [("ring", &report.ring, &made.ring), ("spot", &report.spot, &made.spot)]
        {
            let [x, y] = (Vector2::from(found.center_mm) - mark.centre_mm).into();
            let [a, b] = found.center_u95_mm;
            story += &format!(
                "; {name} off {:.3} {:.3} µm, u95 {:.3} {:.3}",
                1e3 * x,
                1e3 * y,
                1e3 * a,
                1e3 * b
            );
        }
        Ok([error.into(), report.offset.offset_u95_mm])
    };
    let result = measured().map_err(|e| e.to_string());
    Answer { result, caliper_mm: burn_caliper_mm(made), story }
}

fn truth_mm(made: &BurnPicture) -> Vector2<f64> {
    made.spot.centre_mm - made.ring.centre_mm
}

fn burn_caliper_mm(made: &BurnPicture) -> Option<f64> {
    let picture = Picture::decode("holdout", &made.photo.pgm()).ok()?;
    let frame = picture.into_frame(Channel::Luminance);
    let centre = |mark: &Mark| {
        let search = Search {
            centre_mm: mark.centre_mm,
            radius_mm: mark.radius_mm,
            reach_mm: mark.softness_mm.min(0.9 * mark.radius_mm).max(4.0 * burn::MM_PER_PX),
            step_mm: 0.5 * burn::MM_PER_PX,
        };
        let ways = (0..360).map(|k| f64::from(k).to_radians());
        caliper::centre_mm(&search, caliper::points(&frame, &made.camera, &search, ways))
    };
    let offset = centre(&made.spot)? - centre(&made.ring)?;
    Some((offset - truth_mm(made)).norm())
}

/// How the captures of one rod are answered.
pub fn rod_answer(made: &RodSet) -> Answer {
    let frames = || -> Result<Vec<Frame>> {
        let each = made.shots.iter().map(|shot| Picture::decode("holdout", &shot.photo.pgm()));
        each.map(|picture| Ok(picture?.into_frame(Channel::Luminance))).collect()
    };
    let frames = match frames() {
        Ok(frames) => frames,
        Err(e) => {
            let story = made.story.clone();
            return Answer { result: Err(e.to_string()), caliper_mm: None, story };
        }
    };
    let caliper_mm = rod_caliper_mm(made, &frames);
    let mut story = made.story.clone();
    let measured = || -> Result<_> {
        let view = made.calibration.view(WIDTH_PX, HEIGHT_PX)?;
        let shown: Vec<_> = frames.into_iter().map(|frame| (frame, view.clone())).collect();
        let capture = |(k, shot): (usize, &rod::Shot)| {
            Capture::in_memory(format!("capture {k}"), shot.machine_mm, shot.c_deg)
        };
        let captures: Vec<Capture> = made.shots.iter().enumerate().map(capture).collect();
        let options = measure::rod::Options { c_sense: made.c_sense, ..Default::default() };
        let report = measure::rod::measure_frames(&captures, &shown, &options)?.report;
        let (diameter_mm, u95_mm) = (report.diameter_mm, report.diameter_u95_mm);
        let edge =
            report.captures.iter().map(|c| format!(" {:.0}@{}", 100.0 * c.arc_used, c.c_deg));
        story += &format!(
            "; diameter off {:.3} µm, u95 {:.3}; form {:.3} µm; % of the edge@C{}",
            1e3 * (diameter_mm - 2.0 * made.radius_mm),
            1e3 * u95_mm,
            1e3 * report.form_rms_mm,
            edge.collect::<String>()
        );
        let error = Vector2::from(report.axis_center_mm) - centre_mm(made);
        Ok([error.into(), report.axis_center_u95_mm])
    };
    let result = measured().map_err(|e| e.to_string());
    Answer { result, caliper_mm, story }
}

/// What is asked for: the C axis, or where one table angle only is seen, the rod's centre.
fn centre_mm(made: &RodSet) -> Vector2<f64> {
    if made.has_several_angles { made.axis_mm } else { made.shots[0].rod_mm }
}

/// Edge points of all captures fitted together: axis, radius and, with several angles, eccentricity.
fn rod_caliper_mm(made: &RodSet, frames: &[Frame]) -> Option<f64> {
    let mut points = Vec::new();
    for (shot, frame) in made.shots.iter().zip(frames) {
        let search = Search {
            centre_mm: shot.rod_mm - shot.machine_mm,
            radius_mm: made.radius_mm,
            reach_mm: made.softness_mm.max(4.0 * made.mm_per_px),
            step_mm: 0.5 * made.mm_per_px,
        };
        let ways = (0..3600).map(|k| (0.1 * f64::from(k)).to_radians());
        let found = caliper::points(frame, &made.camera, &search, ways);
        points.extend(found.into_iter().map(|p| (p, shot)));
    }
    caliper::keep_clear(&mut points, |p| p.0.contrast);
    let mut start = DVector::zeros(if made.has_several_angles { 5 } else { 3 });
    start[2] = made.radius_mm;
    let found = caliper::fit(&points, start, |at, (point, shot)| {
        let table = Rotation2::new(made.c_sense * shot.c_deg.to_radians());
        let mut moved = Vector2::new(at[0], at[1]);
        if made.has_several_angles {
            moved += table * Vector2::new(at[3], at[4]);
        }
        let d = shot.machine_mm + point.place_mm - shot.rod_mm - moved;
        let (r, n) = (d.norm(), d.normalize());
        let turned = table.inverse() * n;
        let slopes = [n.x, n.y, 1.0, turned.x, turned.y];
        (DVector::from_column_slice(&slopes[..at.len()]), r - at[2])
    })?;
    Some(found[0].hypot(found[1]))
}

/// Writes the picture of a level and seed as PNG, with the calibration, the truth and the captures' table beside it, and says
/// what is in it.
pub fn picture(kind: &str, level: &str, seed: u64, path: &str) -> bool {
    let Some(level) = Level::named(level) else { return false };
    let stem = path.trim_end_matches(".png");
    let (photos, calibration, truth, table, answer) = match kind {
        "burn" => {
            let made = burn::render(level, seed);
            let answer = burn_answer(&made);
            let circle = |m: &Mark| json!({ "center_mm": m.centre_mm.as_slice(), "diameter_mm": 2.0 * m.radius_mm });
            let truth = json!({ "ring": circle(&made.ring), "spot": circle(&made.spot) });
            (vec![(path.to_owned(), made.photo)], made.calibration, truth, None, answer)
        }
        "rod" => {
            let made = rod::render(level, seed);
            let answer = rod_answer(&made);
            let truth = json!({
                "axis_center_mm": centre_mm(&made).as_slice(), "diameter_mm": 2.0 * made.radius_mm, "c_sense": made.c_sense,
            });
            let name = |k: usize| format!("{stem}-{}.png", k + 1);
            let mut table = "image,x_mm,y_mm,c_deg\n".to_owned();
            for (k, shot) in made.shots.iter().enumerate() {
                let image = name(k);
                let image = image.rsplit('/').next().unwrap_or_default();
                let [x, y] = shot.machine_mm.into();
                table += &format!("{image},{x},{y},{}\n", shot.c_deg);
            }
            let each = made.shots.into_iter().enumerate();
            let photos = each.map(|(k, shot)| (name(k), shot.photo)).collect();
            (photos, made.calibration, truth, Some(table), answer)
        }
        _ => return false,
    };
    for (path, photo) in photos {
        if let Err(e) = photo.write_png(&path) {
            println!("{path}: {e}");
        }
    }
    let (calibration, truth) = (calibration.to_toml(), truth.to_string());
    let beside = [("calib.toml", Some(calibration)), ("truth.json", Some(truth)), ("csv", table)];
    for (ending, text) in beside {
        let file = format!("{stem}.{ending}");
        if let Some(text) = text
            && let Err(e) = std::fs::write(&file, text)
        {
            println!("{file}: {e}");
        }
    }
    println!("{}", line(&answer));
    true
}
