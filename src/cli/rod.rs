//! `pivotsight rod`: arcs of the check rod's rim → the C axis.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::outfiles::OutFile;
use super::pictures::overlay_names;
use super::{Global, Outcome, result};
use crate::camera::{Calibration, Identity};
use crate::draw;
use crate::error::{Error, Result, above_zero};
use crate::frame::{Channel, Picture};
use crate::measure::cross::{self, Opinion};
use crate::measure::rod::{self, Capture, Measured, Options, Report, RodTable, points_csv};
use crate::output::{Document, create_folder, write_whole};
use crate::uncertainty::text;
use crate::units;

/// Measures the check rod from captures of its rim: the C axis, the rod's diameter and eccentricity
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Table of the captures: image,x_mm,y_mm and optionally z_mm,b_deg,c_deg,t_s,temp_c,dir_x,dir_y; without `image`: points of the rim that
    /// were aimed at by hand, x_mm,y_mm and optionally c_deg
    #[arg(value_name = "CAPTURES.csv")]
    captures: PathBuf,
    /// The camera's calibration file; of points aimed at with the camera's crosshair its laser offset alone is used
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// Standard uncertainty of a point aimed at by hand (default: from the points' scatter)
    #[arg(long, value_name = "U")]
    aim_u_mm: Option<f64>,
    /// The rod's nominal diameter
    #[arg(long, value_name = "D")]
    diameter_mm: Option<f64>,
    /// Standard uncertainty of that diameter: half the certificate's U where there is one
    #[arg(long, value_name = "U", requires = "diameter_mm", default_value_t = Options::default().diameter_u_mm)]
    diameter_u_mm: f64,
    /// Sense in which a positive C turns the table (c_sense of the machine file)
    #[arg(long, value_name = "1|-1", default_value_t = 1.0)]
    c_sense: f64,
    /// Which part of colour pictures is measured
    #[arg(long, value_enum, default_value = "auto")]
    channel: Channel,
    /// Write the edge points to FILE, for `diagnose rod`
    #[arg(long, value_name = "FILE")]
    points: Option<OutFile>,
    /// Write pictures of what was measured to DIR
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Ask OpenCV for a second opinion on the same pictures (needs it built in)
    #[arg(long)]
    cross_check: bool,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output<'r> {
    /// What it was measured with; not of points aimed at without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    calibration: Option<Identity>,
    /// The overlays written.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    overlays: Vec<PathBuf>,
    #[serde(flatten)]
    report: &'r Report,
    /// OpenCV's second opinion, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    cross_check: Option<Vec<Opinion>>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let options = Options {
        diameter_mm: args.diameter_mm,
        diameter_u_mm: args.diameter_u_mm,
        c_sense: args.c_sense,
        channel: args.channel,
    };
    let given = RodTable::read(&args.captures)?;
    if given.has_points() {
        return aimed(args, &given, &options, global);
    }
    if args.aim_u_mm.is_some() {
        let fix = "leave it out: pictures tell how surely their edges are seen";
        return Err(Error::option("--aim-u-mm", "is for points aimed at by hand", fix));
    }
    let calib = args.calib.as_ref().ok_or_else(|| {
        Error::option(
            "--calib",
            "is missing: the table names pictures",
            "give the camera's calibration file",
        )
    })?;
    let (calibration, identity) = Calibration::identified(calib)?;
    let mut warnings = Vec::new();
    let captures = given.captures(&mut warnings)?;
    global.reads(&args.captures, captures.iter().map(|c| &c.path))?;
    if let Some(folder) = &args.overlay {
        global.makes("--overlay", folder, overlay_names(captures.iter().map(|c| &c.path)))?;
    }
    let mut measured = rod::measure(&captures, &calibration, &options).map_err(|e| {
        if let Some(folder) = &args.overlay {
            refused_overlays(folder, &captures, &calibration, args.channel, &e);
        }
        // What is odd about the table may be why.
        warnings.extend(odd_places(&captures, &calibration));
        warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
        e.in_file(&args.captures, None)
    })?;
    if let Some(path) = &args.points {
        global.write(path, points_csv(&captures, &measured).as_bytes())?;
    }
    let overlays = match &args.overlay {
        Some(folder) => overlays(folder, &captures, &calibration, &measured, args.channel)?,
        None => Vec::new(),
    };
    let cross_check = match args.cross_check {
        true => Some(second_opinion(&captures, &calibration, &measured, args.channel)?),
        false => None,
    };
    let opinions = || cross_check.iter().flatten();
    let report = &mut measured.report;
    report.warnings.splice(..0, warnings);
    report.warnings.extend(opinions().filter_map(Opinion::warning));
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let mut words = table(report);
    opinions().for_each(|o| words.push_str(&format!("{}\n", o.line())));
    let output = Output { calibration: Some(identity), overlays, report, cross_check };
    let json = result("rod", &args.captures, &output.report.warnings, &output);
    Ok(Outcome::good(Document::single(json, words)))
}

/// The rod from points of its rim that were aimed at by hand.
fn aimed(args: &Args, given: &RodTable, options: &Options, global: &Global) -> Result<Outcome> {
    let mut warnings = Vec::new();
    let points = given.points(&mut warnings)?;
    for (option, given) in [
        ("--points", args.points.is_some()),
        ("--overlay", args.overlay.is_some()),
        ("--cross-check", args.cross_check),
        ("--channel", args.channel != Channel::default()),
    ] {
        if given {
            let reason = "needs pictures, and the table has no column 'image'";
            return Err(Error::option(option, reason, "leave it out"));
        }
    }
    if let Some(u) = args.aim_u_mm {
        above_zero("--aim-u-mm", u, "give a standard uncertainty in mm")?;
    }
    let calibration = args.calib.as_ref().map(Calibration::identified).transpose()?;
    let laser = calibration.as_ref().and_then(|(c, _)| c.laser.as_ref());
    let mut report = rod::measure_points(&points, args.aim_u_mm, laser, options)
        .map_err(|e| e.in_file(&args.captures, None))?;
    report.warnings.splice(..0, warnings);
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let output = Output {
        calibration: calibration.map(|(_, identity)| identity),
        overlays: Vec::new(),
        report: &report,
        cross_check: None,
    };
    let json = result("rod", &args.captures, &report.warnings, &output);
    Ok(Outcome::good(Document::single(json, table(&report))))
}

/// A word on positions that may be in another unit.
fn odd_places(captures: &[Capture], calibration: &Calibration) -> Option<String> {
    /// Where a calibration holds for any size.
    const USUAL_PX: (usize, usize) = (1600, 1200);
    let (width, height) = calibration.lens_size().unwrap_or(USUAL_PX);
    let view = calibration.view(width, height).ok()?;
    let places: Vec<[f64; 2]> = captures.iter().map(|c| c.position_mm.into()).collect();
    units::positions(&places, view.pixel_mm() * width as f64)
}

/// OpenCV's opinion on the rod.
fn second_opinion(
    captures: &[Capture],
    calibration: &Calibration,
    measured: &Measured,
    channel: Channel,
) -> Result<Vec<Opinion>> {
    let frames = captures
        .iter()
        .map(|c| {
            let frame = calibration.linear(Picture::read(&c.path)?.into_frame(channel));
            let view = calibration.view(frame.width(), frame.height())?;
            Ok((frame, view))
        })
        .collect::<Result<Vec<_>>>()?;
    cross::rod(&frames, captures, measured)
}

/// One picture a capture, numbered as in the table where a name comes twice.
fn overlays(
    folder: &Path,
    captures: &[Capture],
    calibration: &Calibration,
    measured: &Measured,
    channel: Channel,
) -> Result<Vec<PathBuf>> {
    create_folder(folder)?;
    let drawn = draw::rod_captures(captures, calibration, measured, channel)?;
    let write = |(name, png): (String, Vec<u8>)| {
        let path = folder.join(name);
        write_whole(&path, &png)?;
        Ok(path)
    };
    overlay_names(captures.iter().map(|c| &c.path)).into_iter().zip(drawn).map(write).collect()
}

/// The captures of a rod that could not be measured, and why, as far as that can be drawn and written: `why` is the error.
fn refused_overlays(
    folder: &Path,
    captures: &[Capture],
    calibration: &Calibration,
    channel: Channel,
    why: &Error,
) {
    if create_folder(folder).is_err() {
        return;
    }
    let names = overlay_names(captures.iter().map(|c| &c.path));
    for (i, png) in draw::rod_refused(captures, calibration, channel, why) {
        let _ = write_whole(folder.join(&names[i]), &png);
    }
}

fn table(r: &Report) -> String {
    let mut t = String::new();
    let pair =
        |v: [f64; 2], u: [f64; 2]| format!("X {} mm   Y {} mm", text(v[0], u[0]), text(v[1], u[1]));
    // Writing to a String cannot fail.
    let name = if r.axis_separated { "C axis" } else { "rod" };
    let _ = writeln!(t, "{name:<14}{}", pair(r.axis_center_mm, r.axis_center_u95_mm));
    let _ = writeln!(
        t,
        "{:<14}{} mm   form {:.4} mm rms",
        "diameter",
        text(r.diameter_mm, r.diameter_u95_mm),
        r.form_rms_mm
    );
    if let (Some(e), Some(u)) = (r.eccentricity_mm, r.eccentricity_u95_mm) {
        let _ = writeln!(t, "{:<14}{} mm", "eccentricity", text(e, u));
        for c in &r.rod_centers {
            let at = format!("rod at C {}°", (1e3 * c.c_deg).round() / 1e3);
            let _ = writeln!(t, "{at:<13} {}", pair(c.center_mm, c.center_u95_mm));
        }
    }
    if r.captures.is_empty() {
        return t;
    }
    let _ =
        writeln!(t, "capture                     X          Y      C   edge   mean      rms (mm)");
    for c in &r.captures {
        let _ = writeln!(
            t,
            "{:<20} {:>10.4} {:>10.4} {:>6.1} {:>4.0} % {:>+9.5} {:>8.5}",
            c.image,
            c.x_mm,
            c.y_mm,
            c.c_deg,
            100.0 * c.arc_used,
            c.residual_mean_mm,
            c.residual_rms_mm
        );
    }
    t
}
