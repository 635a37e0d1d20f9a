//! Cameras and video files.

use std::path::Path;

use opencv::core::Mat;
use opencv::{imgproc, prelude::*, videoio};

use super::failed;
use crate::error::{Error, Result};
use crate::frame::Gray;

/// An open camera or video file.
pub struct Video {
    capture: videoio::VideoCapture,
    picture: Mat,
    gray: Mat,
}

/// Failures are this program's to report, not OpenCV's warnings.
fn quiet() -> Result<()> {
    opencv::core::set_log_level(opencv::core::LogLevel::LOG_LEVEL_ERROR).map(|_| ()).map_err(failed)
}

impl Video {
    /// Opens the camera of this number.
    pub fn device(number: u32) -> Result<Self> {
        quiet()?;
        let capture =
            videoio::VideoCapture::new(number as i32, videoio::CAP_ANY).map_err(failed)?;
        Self::opened(capture, || {
            Error::option(
                "SOURCE",
                format!("camera {number} cannot be opened"),
                "check that it is connected and used by no other program (ls /dev/video*)",
            )
        })
    }

    /// Opens a video file.
    pub fn file(path: &Path) -> Result<Self> {
        quiet()?;
        let name = path.to_string_lossy();
        let capture =
            videoio::VideoCapture::from_file(name.as_ref(), videoio::CAP_ANY).map_err(failed)?;
        Self::opened(capture, || {
            Error::file(
                path,
                "cannot be opened as a video",
                "give a video file that OpenCV reads, or a folder of pictures",
            )
        })
    }

    fn opened(capture: videoio::VideoCapture, error: impl Fn() -> Error) -> Result<Self> {
        if !capture.is_opened().map_err(failed)? {
            return Err(error());
        }
        Ok(Self { capture, picture: Mat::default(), gray: Mat::default() })
    }

    /// The next frame; `None` at the end.
    pub fn read(&mut self) -> Result<Option<Gray<u8>>> {
        self.next().map_err(failed)
    }

    fn next(&mut self) -> opencv::Result<Option<Gray<u8>>> {
        if !self.capture.read(&mut self.picture)? || self.picture.empty() {
            return Ok(None);
        }
        let gray = if self.picture.channels() == 1 {
            &self.picture
        } else {
            imgproc::cvt_color(&self.picture, &mut self.gray, imgproc::COLOR_BGR2GRAY, 0)?;
            &self.gray
        };
        let (width, height) = (gray.cols() as usize, gray.rows() as usize);
        Ok(Some(Gray { width, height, data: gray.data_bytes()?.to_vec() }))
    }
}
