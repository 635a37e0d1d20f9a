//! `pivotsight calib`: from a bare camera to a calibration file, and whether it still holds.

pub mod camera;
pub mod check;
mod laser;
mod plane;
pub mod target;

use std::path::Path;

use super::{Global, Outcome};
use crate::error::Result;

/// Calibrates the camera: lens, plane and laser, and checks whether a calibration still holds
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Camera(camera::Args),
    Check(check::Args),
    Laser(laser::Args),
    Plane(plane::Args),
    Target(target::Args),
}

impl Args {
    /// Whether `--out` names the file the command makes.
    pub fn makes_file(&self) -> bool {
        matches!(self.what, What::Target(_))
    }
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.what {
        What::Camera(args) => camera::run(args, global),
        What::Check(args) => check::run(args, global),
        What::Laser(args) => laser::run(args, global),
        What::Plane(args) => plane::run(args, global),
        What::Target(args) => target::run(args, global),
    }
}

/// A file's name without folder and extension: what a calibration is called unless told otherwise.
fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}
