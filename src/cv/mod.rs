//! OpenCV: the only door to it. Built in with the feature `opencv`; without it every function here says how to get it.
//!
//! Detectors of calibration targets, `calibrateCamera`, cameras and video files, and a second opinion on circles.

#[cfg(feature = "opencv")]
mod with;
#[cfg(not(feature = "opencv"))]
mod without;

#[cfg(feature = "opencv")]
use with as door;
#[cfg(not(feature = "opencv"))]
use without as door;

pub use door::{
    Video, built_in, calibrate, contours, detect, fit_ellipse, hough_circles, one_thread,
};

use nalgebra::{Rotation3, Vector2, Vector3};

use crate::camera::Lens;

/// An ellipse in a picture or a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Its centre.
    pub center: Vector2<f64>,
    /// Its half axes.
    pub axes: [f64; 2],
}

impl Ellipse {
    /// Mean of the half axes.
    pub fn radius(&self) -> f64 {
        0.5 * (self.axes[0] + self.axes[1])
    }
}

/// Points of a target seen in a picture.
#[derive(Debug, Clone, Default)]
pub struct Detection {
    /// Which of [`crate::calib::target::Target::points_mm`] each one is.
    pub ids: Vec<usize>,
    /// Where it is seen.
    pub pixels: Vec<Vector2<f64>>,
}

/// Which distortion coefficients are free; the others are zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Distortion {
    /// None of them
    None,
    /// k1
    K1,
    /// k1, k2
    K1k2,
    /// k1, k2, p1, p2
    Decentred,
    /// k1, k2, p1, p2, k3
    #[default]
    Full,
}

impl Distortion {
    /// Which of fx, fy, cx, cy, k1, k2, p1, p2, k3 are free.
    pub fn free(self) -> [bool; 9] {
        let count = match self {
            Self::None => 4,
            Self::K1 => 5,
            Self::K1k2 => 6,
            Self::Decentred => 8,
            Self::Full => 9,
        };
        std::array::from_fn(|i| i < count)
    }
}

/// A lens as `calibrateCamera` finds it.
#[derive(Debug, Clone)]
pub struct LensFit {
    /// The lens.
    pub lens: Lens,
    /// Board → camera for each view: the place of a point is `turn · (x, y, 0) + shift_mm`.
    pub poses: Vec<Pose>,
}

/// Where a board is, seen from the camera (x right, y down, z away).
#[derive(Debug, Clone, Copy)]
pub struct Pose {
    /// The board's axes in the camera's frame.
    pub turn: Rotation3<f64>,
    /// The board's origin in the camera's frame.
    pub shift_mm: Vector3<f64>,
}

/// One view of a board: places on it and where they are seen.
#[derive(Debug, Clone, Default)]
pub struct BoardView {
    /// Places on the board, whose face is z = 0.
    pub board_mm: Vec<Vector3<f64>>,
    /// The same in the picture: corners, or the middles of dots' images.
    pub pixels: Vec<Vector2<f64>>,
    /// Radius of the dots; 0 for corners.
    pub radius_mm: f64,
}

/// The program's version with what is built in, as `--version` prints it.
pub fn version() -> &'static str {
    static VERSION: std::sync::LazyLock<String> =
        std::sync::LazyLock::new(|| format!("{} ({})", env!("CARGO_PKG_VERSION"), built_in()));
    &VERSION
}
