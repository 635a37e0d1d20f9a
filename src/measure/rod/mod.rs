//! The check rod: arcs of its rim in several captures → one radius, a centre per table angle, and the C axis.

mod agreement;
mod aimed;
mod attempts;
mod axis;
mod beside;
mod budget;
mod captures;
mod finish;
mod follow;
mod joint;
mod light;
mod outer;
mod points;
mod report;
mod seek;
mod sight;
mod slip;
mod table;
mod turned;

pub use aimed::{RimPoint, measure_points};
pub use captures::{Capture, read as read_captures};
pub use points::points_csv;
pub use report::{CaptureReport, Options, Report, RodCenter};
pub use table::RodTable;

use nalgebra::Vector2;

use crate::camera::{Calibration, View};
use crate::error::{Error, Result, above_zero};
use crate::fit::Circle;
use crate::frame::{Frame, Picture};
use crate::units;
use attempts::Attempts;
use finish::finish;
use follow::follow;
use outer::Found;

/// One edge point, for `diagnose rod` and for overlays.
#[derive(Debug, Clone, Copy)]
pub struct EdgePoint {
    /// Index of the capture.
    pub capture: usize,
    /// Place in the picture.
    pub pixel: Vector2<f64>,
    /// Radial residual from the common circle.
    pub residual_mm: f64,
    /// Whether the fit rests on it.
    pub used: bool,
}

/// The report with what an overlay shows.
#[derive(Debug, Clone)]
pub struct Measured {
    /// The report.
    pub report: Report,
    /// All edge points.
    pub points: Vec<EdgePoint>,
    /// The rod's circle in each capture's plane.
    pub circles: Vec<Circle>,
}

/// Measures the rod from its captures.
pub fn measure(
    captures: &[Capture],
    calibration: &Calibration,
    options: &Options,
) -> Result<Measured> {
    check(options)?;
    use rayon::prelude::*;
    let read: Vec<((Frame, View), Vec<String>)> = captures
        .par_iter()
        .map(|c| {
            let picture = Picture::read(&c.path)?;
            let (w, h) = picture.size();
            let view = calibration.view_of(&c.image, w, h)?;
            let doubts = picture.doubts().collect();
            Ok(((calibration.linear(picture.into_frame(options.channel)), view), doubts))
        })
        .collect::<Vec<_>>()
        // The first that fails is named, whichever was read first.
        .into_iter()
        .collect::<Result<Vec<_>>>()?;
    let (frames, doubts): (Vec<_>, Vec<_>) = read.into_iter().unzip();
    let mut measured = measure_frames(captures, &frames, options)?;
    let sizes = frames.iter().map(|(frame, _)| (frame.width(), frame.height()));
    let sizes = captures.iter().map(|c| c.image.as_str()).zip(sizes);
    for (capture, doubts) in captures.iter().zip(doubts) {
        let told = doubts.into_iter().map(|doubt| format!("{}: {doubt}", capture.image));
        measured.report.warnings.extend(told);
    }
    measured.report.warnings.extend(calibration.doubt());
    measured.report.warnings.extend(units::sizes(sizes));
    if let Some(laser) = &calibration.laser {
        measured.report.refer_to_laser(laser);
    }
    Ok(measured)
}

/// Refuses options that no rod can have.
pub fn check(options: &Options) -> Result<()> {
    above_zero("--diameter-u-mm", options.diameter_u_mm, "give a standard uncertainty in mm")?;
    if let Some(d) = options.diameter_mm {
        above_zero("--diameter-mm", d, "give the rod's diameter in mm")?;
    }
    if options.c_sense.abs() != 1.0 {
        return Err(Error::option(
            "--c-sense",
            format!("{} is no sense", options.c_sense),
            "give 1 or -1",
        ));
    }
    Ok(())
}

/// Rims that wander by more may be edges of two circles, if those of another wander by less than this part of it.
const DOUBTFUL_MM: f64 = 0.003;
const CLEARER: f64 = 0.5;
/// Captures from which on any one of them may be the wrong one.
const LEAST_WITHOUT: usize = 5;
/// Other centres that are tried then.
const OTHERS: usize = 2;

/// As [`measure`], from frames already in memory, and as if the camera axis were the laser axis.
pub fn measure_frames(
    captures: &[Capture],
    frames: &[(Frame, View)],
    options: &Options,
) -> Result<Measured> {
    let unseen = || {
        let named = options.diameter_mm.map(|d| format!(" of about {d} mm"));
        let option = if named.is_some() { "--diameter-mm, " } else { "" };
        Error::measure(
            "captures",
            format!("no rim of a rod{} is seen on which they agree", named.unwrap_or_default()),
            format!(
                "check {option}the pictures, the machine positions (x_mm, y_mm) and the calibration's signs"
            ),
        )
    };
    let (c_deg, angle_of) = captures::table_angles(captures.iter().map(|c| c.c_deg));
    let attempts = Attempts::new(captures, &angle_of, frames, options.diameter_mm);
    let measure_at = |found: &Found| -> Result<Measured> {
        let mut followed = follow(captures, frames, found, &angle_of)?;
        if found.without.is_none()
            && let Some(without) = slip::at_fault(&followed.arcs, &followed.robust)
        {
            let found = Found { without: Some(without), ..found.clone() };
            followed = follow(captures, frames, &found, &angle_of)?;
        }
        let mut measured = finish(captures, options, &c_deg, &angle_of, &followed)?;
        let mut beside = [found.fainter_mm, found.stronger_mm];
        if c_deg.len() > 1 && beside.iter().any(Option::is_some) {
            let seen = attempts.beside(&measured.report);
            // What is beside the rim about one centre may be the rim at another table angle.
            beside.iter_mut().zip(seen).for_each(|(edge, seen)| *edge = edge.and(seen));
        }
        agreement::fainter_rim(beside[0], options, &mut measured.report);
        agreement::stronger_edge(beside[1], options, &mut measured.report.warnings);
        Ok(measured)
    };
    let measure = |found: Found| -> Result<Measured> {
        let rim = found.common_rim().and_then(|rim| measure_at(&rim).ok());
        rim.map_or_else(|| measure_at(&found), Ok)
    };
    let likely = attempts.likely();
    let about = |nth: usize| likely.get(nth).and_then(|circle| attempts.rim(*circle));
    let mut best = about(0).ok_or_else(unseen).and_then(&measure);
    // Edges of two circles taken for one wander about it, or miss it.
    let doubtful = |m: &Measured| m.report.form_rms_mm >= DOUBTFUL_MM;
    for other in 0..=OTHERS {
        if !best.as_ref().map_or(true, doubtful) {
            break;
        }
        let found = if other == 0 { attempts.apart() } else { about(other) };
        let Some(Ok(other)) = found.map(&measure) else { continue };
        let clearer = |m: &Measured| other.report.form_rms_mm < CLEARER * m.report.form_rms_mm;
        // Where the likeliest is refused another must be no such circle itself.
        if best.as_ref().map_or_else(|_| !doubtful(&other), clearer) {
            best = Ok(other);
        }
    }
    if best.is_err() && captures.len() >= LEAST_WITHOUT {
        // Without one that is at a wrong position the others agree.
        let others = (0..captures.len()).filter_map(|i| measure(attempts.without(i)?).ok());
        let others = others.filter(|m| !doubtful(m));
        let gone = |m: &Measured| m.report.captures.iter().filter(|c| c.edge_points == 0).count();
        let apart = |m: &Measured| m.report.form_rms_mm.hypot(m.report.position_scatter_mm);
        let order =
            |a: &Measured, b: &Measured| gone(a).cmp(&gone(b)).then(apart(a).total_cmp(&apart(b)));
        best = others.min_by(order).map_or(best, Ok);
    }
    if let Some(nominal_mm) = options.diameter_mm {
        let meets = |m: &Measured| options.is_nominal(m.report.diameter_mm);
        if !best.as_ref().is_ok_and(meets) {
            // Stronger edges than the rim's (turned grooves, a collet) led elsewhere.
            let named = attempts.named().and_then(|found| measure_at(&found).ok());
            let ragged = |m: &Measured| m.report.form_rms_mm >= agreement::RAGGED_MM;
            match (named.filter(|m| meets(m) && !ragged(m)), &best) {
                (Some(named), _) => best = Ok(named),
                (None, Ok(other)) if ragged(other) => {
                    return Err(agreement::none_near(nominal_mm, &other.report));
                }
                _ => {}
            }
        }
    }
    let best = best?;
    if let Some(nominal_mm) = options.diameter_mm
        && !options.is_nominal(best.report.diameter_mm)
    {
        // What is not believed may not have led to an edge near it either.
        let unled = Options { diameter_mm: None, ..options.clone() };
        let mut free = measure_frames(captures, frames, &unled)?;
        free.report.warnings.push(finish::not_nominal(free.report.diameter_mm, nominal_mm));
        return Ok(free);
    }
    let outer = attempts.just_outside(&best.report);
    let outer = outer.and_then(|found| measure_at(&found).ok()).filter(|m| !doubtful(m));
    Ok(outer.unwrap_or(best))
}
