//! `pivotsight circles`: circles of expected diameters, and how concentric they are.

use std::fmt::Write;
use std::path::PathBuf;

use super::pictures::{self, Camera, Shown};
use super::{Global, Outcome};
use crate::camera::Calibration;
use crate::draw;
use crate::error::Result;
use crate::frame::Channel;
use crate::measure::CircleReport;
use crate::measure::circles::{self, Options, Report};
use crate::measure::cross;
use crate::uncertainty::text;

/// Measures circles of expected diameters: centres, diameters and how concentric they are
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Pictures that show the circles
    #[arg(value_name = "IMAGE", required = true)]
    images: Vec<PathBuf>,
    /// The camera's calibration file
    #[arg(long, value_name = "FILE")]
    calib: PathBuf,
    /// Expected diameter, good to 12 %; once for each circle, reported in this order
    #[arg(long, value_name = "D", required = true)]
    expect_mm: Vec<f64>,
    /// Which part of colour pictures is measured
    #[arg(long, value_enum, default_value = "auto")]
    channel: Channel,
    /// Write pictures of what was measured to DIR
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Ask OpenCV for a second opinion on the same pictures (needs it built in)
    #[arg(long)]
    cross_check: bool,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let options = Options { expect_mm: args.expect_mm.clone(), channel: args.channel };
    circles::check(&options)?;
    let (calibration, identity) = Calibration::identified(&args.calib)?;
    let overlay = args.overlay.as_deref();
    let doubts = calibration.doubts();
    let camera =
        Camera { calibration: &calibration, identity: &identity, channel: args.channel, doubts };
    pictures::run("circles", &args.images, camera, overlay, global, |picture, subject| {
        let measured = circles::measure(picture, &calibration, &options, subject)?;
        let overlay = match &args.overlay {
            Some(_) => Some(draw::circles(picture, &calibration, &measured, subject)?),
            None => None,
        };
        let report = &measured.report;
        let mut shown = Shown {
            keys: pictures::keys(report, subject)?,
            table: format!("{subject}\n{}", table(report)),
            warnings: report.warnings.clone(),
            good: true,
            overlay,
            size: picture.size(),
        };
        if args.cross_check {
            let frame = calibration.light_in(picture, report.channel);
            let view = calibration.view(frame.width(), frame.height())?;
            shown.cross_check(&cross::circles(&frame, &view, &named(report))?);
        }
        Ok(shown)
    })
}

/// The circles by name.
fn named(r: &Report) -> Vec<(String, &CircleReport)> {
    r.circles.iter().enumerate().map(|(i, c)| (format!("circle {i}"), &c.circle)).collect()
}

fn table(r: &Report) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    for (i, c) in r.circles.iter().enumerate() {
        let _ = writeln!(t, "  circle {i}   {}", super::burn::circle(&c.circle));
    }
    for p in &r.pairs {
        let _ = writeln!(
            t,
            "  {} to {}     distance {} mm   dx {:+.5}   dy {:+.5}   zone {:.5} mm",
            p.a,
            p.b,
            text(p.distance_mm, p.distance_u95_mm),
            p.offset_mm[0],
            p.offset_mm[1],
            p.zone_mm
        );
    }
    t
}
