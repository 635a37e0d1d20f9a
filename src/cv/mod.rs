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

pub use door::built_in;

/// The program's version with what is built in, as `--version` prints it.
pub fn version() -> &'static str {
    static VERSION: std::sync::LazyLock<String> =
        std::sync::LazyLock::new(|| format!("{} ({})", env!("CARGO_PKG_VERSION"), built_in()));
    &VERSION
}
