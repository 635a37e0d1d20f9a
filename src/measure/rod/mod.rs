//! The check rod: arcs of its rim in several captures → one radius, a centre per table angle, and the C axis.

mod agreement;
mod aimed;
mod astray;
mod attempts;
mod axis;
mod beside;
mod budget;
mod captures;
mod choice;
mod finish;
mod follow;
mod joint;
mod light;
mod outer;
mod points;
mod report;
mod seek;
mod seen;
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
use choice::Choice;

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
    measured.report.warnings.extend(calibration.doubts());
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

/// As [`measure`], from frames already in memory, and as if the camera axis were the laser axis.
pub fn measure_frames(
    captures: &[Capture],
    frames: &[(Frame, View)],
    options: &Options,
) -> Result<Measured> {
    let (c_deg, angle_of) = captures::table_angles(captures.iter().map(|c| c.c_deg));
    let choice = Choice::new(captures, frames, options, (&c_deg, &angle_of));
    let best = choice.best()?;
    if let Some(nominal_mm) = options.diameter_mm
        && !options.is_nominal(best.report.diameter_mm)
    {
        // What is not believed may not have led to an edge near it either.
        let unled = Options { diameter_mm: None, ..options.clone() };
        let mut free = measure_frames(captures, frames, &unled)?;
        free.report.warnings.push(finish::not_nominal(free.report.diameter_mm, nominal_mm));
        return Ok(free);
    }
    Ok(choice.just_outside(&best).unwrap_or(best))
}
