//! The same functions without the feature `opencv`: each says how to get it.

use std::path::Path;

use nalgebra::Vector2;

use crate::calib::target::Target;
use crate::cv::{BoardView, Detection, Distortion, Ellipse, LensFit};
use crate::error::{Error, Result};
use crate::frame::Gray;

fn missing(what: &str) -> Error {
    Error::option(
        what,
        "needs OpenCV, which is not built into this program",
        "install Debian's libopencv-dev, clang and libclang-dev, then build with `cargo build --release --features opencv`",
    )
}

/// What `--version` says of OpenCV.
pub fn built_in() -> String {
    "no opencv".to_owned()
}

/// Needs OpenCV.
pub fn detect(_: &Gray<u8>, _: &Target) -> Result<Option<Detection>> {
    Err(missing("calib camera"))
}

/// Needs OpenCV.
pub fn calibrate(_: &[BoardView], _: (u32, u32), _: Distortion) -> Result<LensFit> {
    Err(missing("calib camera"))
}

/// Needs OpenCV.
pub fn contours(_: &Gray<u8>, _: f64, _: f64) -> Result<Vec<Vec<Vector2<f64>>>> {
    Err(missing("--cross-check"))
}

/// Needs OpenCV.
pub fn fit_ellipse(_: &[Vector2<f64>]) -> Result<Option<Ellipse>> {
    Err(missing("--cross-check"))
}

/// Needs OpenCV.
pub fn hough_circles(_: &Gray<u8>, _: f64, _: f64, _: [f64; 2]) -> Result<Vec<Ellipse>> {
    Err(missing("the comparison"))
}

/// Needs OpenCV.
pub fn one_thread() -> Result<()> {
    Err(missing("the comparison"))
}

/// Cannot be: opening one is an error.
pub struct Video(std::convert::Infallible);

impl Video {
    /// Needs OpenCV.
    pub fn device(_: u32) -> Result<Self> {
        Err(missing("a camera as SOURCE"))
    }

    /// Needs OpenCV.
    pub fn file(_: &Path) -> Result<Self> {
        Err(missing("a video file as SOURCE"))
    }

    /// Cannot be called.
    pub fn read(&mut self) -> Result<Option<Gray<u8>>> {
        match self.0 {}
    }
}
