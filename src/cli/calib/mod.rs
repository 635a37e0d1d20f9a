//! `pivotsight calib`: from a bare camera to a calibration file, and whether it still holds.

mod check;
mod laser;
mod plane;

use std::path::Path;

use super::{Global, Outcome};
use crate::camera::Calibration;
use crate::error::Result;
use crate::output::write_whole;

/// Calibrates the camera: lens, plane and laser, and checks whether a calibration still holds
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Check(check::Args),
    Laser(laser::Args),
    Plane(plane::Args),
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.what {
        What::Check(args) => check::run(args, global),
        What::Laser(args) => laser::run(args, global),
        What::Plane(args) => plane::run(args, global),
    }
}

/// Writes a calibration file.
fn write(path: &Path, calibration: &Calibration) -> Result<()> {
    write_whole(path, calibration.to_toml().as_bytes())
}

/// A file's name without folder and extension: what a calibration is called unless told otherwise.
fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}
