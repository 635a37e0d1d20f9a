//! `pivotsight calib camera`: the lens from pictures of a target.

use std::fmt::Write;
use std::path::PathBuf;

use super::super::outfiles::OutFile;
use super::super::{Global, Outcome, Status, result};
use crate::calib::lens::{self, Report};
use crate::calib::target::Target;
use crate::cv::Distortion;
use crate::draw;
use crate::error::Result;
use crate::output::Document;

/// Finds focal length, principal point and distortion from pictures of a target (needs OpenCV built in)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Pictures of the target: ten or more, tilted in different directions, that fill the frame between them
    #[arg(value_name = "IMAGE", required = true)]
    images: Vec<PathBuf>,
    /// KIND:COLUMNSxROWS:PITCH_MM as for `calib target`, with the pitch measured on the print
    #[arg(long, value_name = "TARGET")]
    target: Target,
    /// Which distortion coefficients are free
    #[arg(long, value_enum, default_value = "full")]
    distortion: Distortion,
    /// Write the lens to FILE, for `calib plane --lens FILE`
    #[arg(long, value_name = "FILE")]
    write_calib: Option<OutFile>,
    /// Write a picture of where in the frame the target was seen to FILE.png
    #[arg(long, value_name = "FILE")]
    coverage: Option<OutFile>,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output<'r> {
    /// The target that was photographed.
    target: String,
    #[serde(flatten)]
    report: &'r Report,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let made = lens::calibrate(&args.images, &args.target, args.distortion)?;
    if let Some(path) = &args.write_calib {
        global.write(path, made.lens.to_toml(&super::stem(path)).as_bytes())?;
    }
    if let Some(path) = &args.coverage {
        global.write(path, &draw::coverage(&made)?)?;
    }
    let report = &made.report;
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let output = Output { target: args.target.to_string(), report };
    let json = result("calib-camera", &args.images, &report.warnings, &output);
    let status = if made.unread > 0 { Status::SomeFailed } else { Status::Good };
    Ok(Outcome { document: Some(Document::single(json, table(report))), status })
}

fn table(r: &Report) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    for p in &r.parameters {
        let places = if p.name.ends_with("px") { 3 } else { 6 };
        let _ = match p.u95 {
            Some(u95) => writeln!(t, "{:<6} {:>12.places$} ± {u95:.places$}", p.name, p.value),
            None => writeln!(t, "{:<6} {:>12.places$}   (held)", p.name, p.value),
        };
    }
    let used = r.views.iter().filter(|v| v.used).count();
    let _ = writeln!(
        t,
        "rms {:.4} px over {used} of {} views; {:.0} % of the frame covered",
        r.rms_px,
        r.views.len(),
        100.0 * r.coverage
    );
    let [plane, out] = r.board_sd_mm.map(|sd| 1e3 * sd);
    let _ = writeln!(
        t,
        "the board's points lie {plane:.1} µm off its grid and {out:.0} µm out of its plane (standard deviations)"
    );
    let _ = writeln!(t, "points   rms px  worst px   tilt   picture");
    for v in &r.views {
        let number =
            |v: Option<f64>, places: usize| v.map_or("-".into(), |v| format!("{v:.places$}"));
        let _ = writeln!(
            t,
            "{:>6} {:>8} {:>9} {:>5}°   {}{}",
            v.points,
            number(v.rms_px, 4),
            number(v.worst_px, 3),
            number(v.tilt_deg, 1),
            v.image,
            v.rejected.as_ref().map_or(String::new(), |why| format!("   LEFT OUT: {why}"))
        );
    }
    t
}
