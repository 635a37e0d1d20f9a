//! `pivotsight calib plane`: pixel → mm with the machine as the ruler.

use std::fmt::Write;
use std::path::PathBuf;

use super::super::outfiles::OutFile;
use super::super::{Global, Outcome, Status, result};
use crate::calib::plane::{self, Orientation, Report};
use crate::camera::LensFile;
use crate::error::Result;
use crate::measure::rod::read_captures;
use crate::output::Document;
use crate::uncertainty::text;

/// Finds scale, rotation and tilt from pictures of any small mark taken at known machine positions
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Table of the captures: image,x_mm,y_mm; five positions or more that spread the mark over the frame
    #[arg(value_name = "CAPTURES.csv")]
    captures: PathBuf,
    /// The lens: a calibration file's [camera] (see `calib camera`); without it no distortion is assumed
    #[arg(long, value_name = "FILE")]
    lens: Option<PathBuf>,
    /// Write the calibration to FILE
    #[arg(long, value_name = "FILE")]
    write_calib: Option<OutFile>,
    /// The camera really looks through a mirror: accept a mirrored mapping
    #[arg(long)]
    mirrored: bool,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let lens = args.lens.as_ref().map(LensFile::read).transpose()?;
    let mut warnings = Vec::new();
    let captures = read_captures(&args.captures, &mut warnings)?;
    global.reads(&args.captures, captures.iter().map(|c| &c.path))?;
    let mut made =
        plane::calibrate(&captures, lens.as_ref()).map_err(|e| e.in_file(&args.captures, None))?;
    made.report.warnings.splice(..0, warnings);
    let refused = made.report.orientation == Orientation::Mirrored && !args.mirrored;
    if let Some(path) = &args.write_calib {
        if refused {
            made.report.warnings.push(format!(
                "{}: not written; correct the cause, or give --mirrored if the camera looks through a mirror",
                path.display()
            ));
        } else {
            made.calibration.name = super::stem(path);
            global.write(path, made.calibration.to_toml().as_bytes())?;
        }
    }
    let report = &made.report;
    report.warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let json = result("calib-plane", &args.captures, &report.warnings, report);
    Ok(Outcome {
        document: Some(Document::single(json, table(report))),
        status: if refused { Status::OutOfTolerance } else { Status::Good },
    })
}

fn table(r: &Report) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        t,
        "pixel         {:.8} ± {:.8} mm   height/width {:+.5} ± {:.5}   shear {} °",
        r.mm_per_px,
        r.mm_per_px_u95,
        r.aspect,
        r.aspect_u95,
        text(r.shear_deg, r.shear_u95_deg)
    );
    let mounted = match r.orientation {
        Orientation::Upright => "upright",
        Orientation::Turned => "TURNED",
        Orientation::Mirrored => "MIRRORED",
    };
    let _ = writeln!(t, "rotation      {} °   {mounted}", text(r.rotation_deg, r.rotation_u95_deg));
    if let (Some(v), Some(u)) = (r.tilt_deg, r.tilt_u95_deg) {
        let _ = writeln!(
            t,
            "tilt          about u {} °   about v {} °",
            text(v[0], u[0]),
            text(v[1], u[1])
        );
    }
    let _ = writeln!(
        t,
        "residuals     {:.5} mm rms   a place in the frame is known to {:.5} mm or better (95 %)",
        r.residual_rms_mm, r.field_u95_mm
    );
    let _ = writeln!(
        t,
        "capture                     X          Y    mark u     mark v    residual x, y (mm)"
    );
    for c in &r.captures {
        let _ = write!(t, "{:<20} {:>10.4} {:>10.4}", c.image, c.x_mm, c.y_mm);
        let _ = match (c.mark_px, c.residual_mm) {
            (Some([u, v]), Some([x, y])) => writeln!(
                t,
                " {u:>9.2}  {v:>9.2}   {x:>+9.5} {y:>+9.5}{}",
                if c.used { "" } else { "  left out" }
            ),
            _ => writeln!(t, "   mark not found"),
        };
    }
    t
}
