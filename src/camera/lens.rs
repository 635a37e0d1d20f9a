//! The lens: a pinhole with Brown-Conrady distortion, in OpenCV's order of the numbers.

use std::path::Path;

use nalgebra::{Matrix3, SVector};
use serde::{Deserialize, Serialize};

use super::calibration::{Complaint, File, LensUncertainty, checked_gamma};
use super::plane_uncertainty::{LENS_NUMBERS, LensCovariance};
use crate::camera::{Mapping, View};
use crate::error::{Error, Result};
use crate::tomlfile;

/// Pinhole intrinsics and Brown-Conrady distortion, in OpenCV's order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Frame width the calibration holds for.
    pub width_px: u32,
    /// Frame height the calibration holds for.
    pub height_px: u32,
    /// Focal length along u.
    pub fx_px: f64,
    /// Focal length along v.
    pub fy_px: f64,
    /// Principal point, u.
    pub cx_px: f64,
    /// Principal point, v.
    pub cy_px: f64,
    /// k1, k2, p1, p2, k3; missing ones are zero.
    #[serde(default)]
    pub distortion: [f64; 5],
}

/// A lens as its file tells it, with or without a plane.
#[derive(Debug, Clone, PartialEq)]
pub struct LensFile {
    /// The lens.
    pub lens: Lens,
    /// How surely it is known, where the file says so.
    pub covariance: Option<LensCovariance>,
    /// The sensor's gamma.
    pub gamma: f64,
}

impl LensFile {
    /// Reads the lens of a calibration file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file: File = tomlfile::read(path)?;
        let lens = file.camera.ok_or_else(|| {
            Error::field(path, None, "camera", "is missing", "give a file with [camera]")
        })?;
        let blame = |(field, reason, fix)| Error::field(path, None, field, reason, fix);
        let gamma = check_lens(&lens).and_then(|()| checked_gamma(file.sensor)).map_err(blame)?;
        let covariance = file.lens_uncertainty.map(LensUncertainty::checked).transpose();
        Ok(Self { lens, covariance: covariance.map_err(blame)?, gamma })
    }

    /// The lens alone as the text of a calibration file, for `calib plane` to complete.
    pub fn to_toml(&self, name: &str) -> String {
        let file = File {
            schema: 1,
            name: name.to_owned(),
            camera: Some(self.lens.clone()),
            lens_uncertainty: self.covariance.as_ref().map(LensUncertainty::of),
            plane: None,
            scale: None,
            laser: None,
            sensor: None,
        };
        // These plain structures always serialise.
        toml::to_string(&file).unwrap_or_default()
    }
}

impl Lens {
    /// A lens that is another by these numbers: fx, fy, cx, cy, k1, k2, p1, p2, k3.
    pub(crate) fn plus(&self, by: &SVector<f64, LENS_NUMBERS>) -> Self {
        Self {
            fx_px: self.fx_px + by[0],
            fy_px: self.fy_px + by[1],
            cx_px: self.cx_px + by[2],
            cy_px: self.cy_px + by[3],
            distortion: std::array::from_fn(|i| self.distortion[i] + by[4 + i]),
            ..self.clone()
        }
    }

    /// The mapping between pixels and the undistorted normalised image.
    pub fn normalised(&self) -> View {
        let mapping = Mapping::Pinhole {
            lens: self.clone(),
            homography_mm: Matrix3::identity(),
            covariance: None,
            mirrored: false,
        };
        View::new(&mapping, self.width_px as usize, self.height_px as usize)
    }
}

/// Frames that a lens' axis may lie off: a frame may be a part of a far larger picture.
const MOST_OFF: f64 = 10.0;

/// What no lens can have: the field, what is wrong with it and what to do.
pub(super) fn check_lens(lens: &Lens) -> std::result::Result<(), Complaint> {
    let numbers = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px];
    if !numbers.iter().chain(&lens.distortion).all(|v| v.is_finite()) {
        return Err((
            "camera",
            "has a number that is not finite".into(),
            "calibrate the camera again",
        ));
    }
    if let Some((name, f)) = [("camera.fx_px", lens.fx_px), ("camera.fy_px", lens.fy_px)]
        .into_iter()
        .find(|(_, f)| *f <= 0.0)
    {
        return Err((name, format!("is {f}"), "give the focal length in pixels, above zero"));
    }
    if lens.width_px == 0 || lens.height_px == 0 {
        return Err(("camera.width_px", "is zero".into(), "give the frame's size in pixels"));
    }
    let middle =
        [("camera.cx_px", lens.cx_px, lens.width_px), ("camera.cy_px", lens.cy_px, lens.height_px)];
    if let Some((name, px, size)) =
        middle.into_iter().find(|(_, px, size)| px.abs() > MOST_OFF * f64::from(*size))
    {
        let reason = format!("is {px} in a frame of {size} px");
        return Err((name, reason, "give where the lens' axis meets the picture, in pixels"));
    }
    Ok(())
}
