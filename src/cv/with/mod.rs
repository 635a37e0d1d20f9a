//! What OpenCV does here, with the feature `opencv`.

mod board;
mod ellipse;
mod lens;
mod video;

pub use board::detect;
pub use ellipse::{contours, fit_ellipse, hough_circles, one_thread};
pub use lens::calibrate;
pub use video::Video;

use opencv::boxed_ref::BoxedRef;
use opencv::core::Mat;

use crate::error::{Error, Result};
use crate::frame::Gray;

/// What `--version` says of OpenCV.
pub fn built_in() -> String {
    let version = opencv::core::get_version_string().unwrap_or_default();
    format!("opencv {version}")
}

/// OpenCV's own words, for the rare call that fails.
fn failed(e: opencv::Error) -> Error {
    Error::measure("OpenCV", e.message, "report this with the pictures that caused it")
}

/// A gray picture as OpenCV sees it, without a copy.
fn mat(gray: &Gray<u8>) -> Result<BoxedRef<'_, Mat>> {
    Mat::new_rows_cols_with_data(gray.height as i32, gray.width as i32, &gray.data).map_err(failed)
}
