//! The calibration file (`calib/*.toml`): a pinhole camera with Brown-Conrady distortion and the plane it
//! measures in, or just a scale for a quick start.

use std::borrow::Cow;
use std::path::Path;

use nalgebra::{Matrix3, Matrix6, SMatrix};
use serde::{Deserialize, Serialize};

use crate::camera::View;
use crate::camera::lens::{Lens, check_lens};
use crate::camera::plane_uncertainty::{
    LENS_NUMBERS, LensCovariance, PlaneCovariance, independent,
};
use crate::error::{Error, Result};
use crate::frame::{Channel, Frame, Picture};
use crate::tomlfile;

/// What a camera's gamma may be.
const GAMMAS: std::ops::RangeInclusive<f64> = 0.2..=5.0;

/// A camera's calibration as read from its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The name given in the file.
    pub name: String,
    /// How pixels map to the plane.
    pub mapping: Mapping,
    /// Where the laser axis lies, seen from the camera axis, where it is known.
    pub laser: Option<Laser>,
    /// How the sensor counts light: a count is proportional to its power of one over this. 1 where counts are light.
    pub gamma: f64,
}

/// How pixels map to millimetres in the measuring plane.
#[derive(Debug, Clone, PartialEq)]
pub enum Mapping {
    /// Pinhole with distortion, then a homography onto the plane.
    Pinhole {
        /// The lens.
        lens: Lens,
        /// Undistorted normalised image (x, y, 1) → plane in mm.
        homography_mm: Matrix3<f64>,
        /// What is not known of both. `None` where they are taken as exact.
        covariance: Option<Box<PlaneCovariance>>,
        /// Whether the camera is said to look through a mirror.
        mirrored: bool,
    },
    /// A plain scale: the camera axis goes through the frame's middle and v down is -Y.
    Scale {
        /// Size of a pixel in the plane.
        mm_per_px: f64,
        /// Turn of the picture's u axis against machine X, counter-clockwise.
        rotation_deg: f64,
    },
}

/// The laser axis seen from the camera axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laser {
    /// Offset on the measuring plane.
    pub offset_mm: [f64; 2],
    /// Half-widths of its 95 % intervals, where they are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset_u95_mm: Option<[f64; 2]>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) schema: u32,
    #[serde(default)]
    pub(super) name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) camera: Option<Lens>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lens_uncertainty: Option<LensUncertainty>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) plane: Option<Plane>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) scale: Option<Scale>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) laser: Option<Laser>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) sensor: Option<Sensor>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sensor {
    gamma: f64,
}

/// Covariance of fx_px, fy_px, cx_px, cy_px and the distortion.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LensUncertainty {
    covariance: [[f64; LENS_NUMBERS]; LENS_NUMBERS],
}

impl LensUncertainty {
    pub(super) fn of(covariance: &LensCovariance) -> Self {
        Self { covariance: rows(covariance) }
    }

    pub(super) fn checked(self) -> std::result::Result<LensCovariance, Complaint> {
        let covariance = SMatrix::from_fn(|r, c| self.covariance[r][c]);
        match independent(&covariance) {
            Some(_) => Ok(covariance),
            None => Err((
                "lens_uncertainty.covariance",
                "is no covariance".into(),
                "calibrate the camera again",
            )),
        }
    }
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plane {
    homography_mm: [[f64; 3]; 3],
    /// Whether the camera looks through a mirror.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    mirrored: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    homography_covariance: Option<[[f64; 6]; 6]>,
    /// How h11, h12, h21, h22, h31, h32 change with the lens' numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    homography_by_lens: Option<[[f64; LENS_NUMBERS]; 6]>,
}

impl Plane {
    fn covariance(
        &self,
        lens: Option<LensUncertainty>,
    ) -> std::result::Result<Option<Box<PlaneCovariance>>, Complaint> {
        let Some(homography) = &self.homography_covariance else { return Ok(None) };
        let homography = Matrix6::from_fn(|r, c| homography[r][c]);
        if independent(&homography).is_none() {
            return Err((
                "plane.homography_covariance",
                "is no covariance".into(),
                "calibrate the plane again",
            ));
        }
        let lens = match (lens, &self.homography_by_lens) {
            (Some(lens), Some(by)) => Some((lens.checked()?, SMatrix::from_fn(|r, c| by[r][c]))),
            (None, None) => None,
            _ => {
                return Err((
                    "plane.homography_by_lens",
                    "goes with [lens_uncertainty], and one of them is missing".into(),
                    "calibrate the plane again",
                ));
            }
        };
        Ok(Some(Box::new(PlaneCovariance { homography, lens })))
    }
}

/// A field, what is wrong with it and what to do.
pub(super) type Complaint = (&'static str, String, &'static str);

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Scale {
    mm_per_px: f64,
    #[serde(default)]
    rotation_deg: f64,
}

impl Calibration {
    /// Reads and checks a calibration file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file: File = tomlfile::read(path)?;
        Self::from_file(file)
            .map_err(|(field, reason, fix)| Error::field(path, None, field, reason, fix))
    }

    fn from_file(file: File) -> std::result::Result<Self, Complaint> {
        if file.schema != 1 {
            return Err((
                "schema",
                format!("is {}, this program reads 1", file.schema),
                "use a matching version",
            ));
        }
        let mapping = match (file.camera, file.plane, file.scale) {
            (Some(lens), Some(plane), None) => {
                check_lens(&lens)?;
                let homography_mm = Matrix3::from_fn(|r, c| plane.homography_mm[r][c]);
                if !homography_mm.iter().all(|v| v.is_finite())
                    || homography_mm.determinant().abs() < 1e-12
                {
                    return Err((
                        "plane.homography_mm",
                        "cannot be inverted".into(),
                        "calibrate the plane again",
                    ));
                }
                let covariance = plane.covariance(file.lens_uncertainty)?;
                Mapping::Pinhole { lens, homography_mm, covariance, mirrored: plane.mirrored }
            }
            (None, None, Some(Scale { mm_per_px, rotation_deg })) => {
                if !(mm_per_px.is_finite() && mm_per_px > 0.0) {
                    return Err((
                        "scale.mm_per_px",
                        format!("is {mm_per_px}"),
                        "give the size of a pixel in mm",
                    ));
                }
                if !rotation_deg.is_finite() {
                    return Err((
                        "scale.rotation_deg",
                        "is not finite".into(),
                        "give an angle in degrees",
                    ));
                }
                Mapping::Scale { mm_per_px, rotation_deg }
            }
            (Some(_), None, None) => {
                return Err((
                    "plane",
                    "is missing: this file knows the lens only".into(),
                    "find the plane with `pivotsight calib plane --lens THIS_FILE`",
                ));
            }
            _ => {
                return Err((
                    "calibration",
                    "needs either [camera] and [plane], or [scale] alone".into(),
                    "see docs/conventions.md for both forms",
                ));
            }
        };
        if let Some(laser) = &file.laser {
            if !laser.offset_mm.iter().all(|v| v.is_finite()) {
                return Err(("laser.offset_mm", "is not finite".into(), "give two numbers in mm"));
            }
            let unsure = |u: &f64| !(u.is_finite() && *u >= 0.0);
            if let Some(u) = laser.offset_u95_mm.iter().flatten().find(|u| unsure(u)) {
                let fix = "give two half-widths in mm, zero or more";
                return Err(("laser.offset_u95_mm", format!("holds {u}"), fix));
            }
        }
        let gamma = checked_gamma(file.sensor)?;
        Ok(Self { name: file.name, mapping, laser: file.laser, gamma })
    }

    /// The same with a plane that is taken as exact: to judge the calibration itself.
    pub fn as_exact(&self) -> Self {
        let mut exact = self.clone();
        if let Mapping::Pinhole { covariance, .. } = &mut exact.mapping {
            *covariance = None;
        }
        exact
    }

    /// Width and height of the frames the lens was calibrated for; `None` for a plain scale.
    pub fn lens_size(&self) -> Option<(usize, usize)> {
        match &self.mapping {
            Mapping::Pinhole { lens, .. } => {
                Some((lens.width_px as usize, lens.height_px as usize))
            }
            Mapping::Scale { .. } => None,
        }
    }

    /// The calibration as the text of its file.
    pub fn to_toml(&self) -> String {
        let mut lens_uncertainty = None;
        let (camera, plane, scale) = match &self.mapping {
            Mapping::Pinhole { lens, homography_mm, covariance, mirrored } => {
                let of_lens = covariance.as_ref().and_then(|c| c.lens.as_ref());
                lens_uncertainty = of_lens.map(|(lens, _)| LensUncertainty::of(lens));
                let plane = Plane {
                    homography_mm: rows(homography_mm),
                    mirrored: *mirrored,
                    homography_covariance: covariance.as_ref().map(|c| rows(&c.homography)),
                    homography_by_lens: of_lens.map(|(_, by_lens)| rows(by_lens)),
                };
                (Some(lens.clone()), Some(plane), None)
            }
            &Mapping::Scale { mm_per_px, rotation_deg } => {
                (None, None, Some(Scale { mm_per_px, rotation_deg }))
            }
        };
        let file = File {
            schema: 1,
            name: self.name.clone(),
            camera,
            lens_uncertainty,
            plane,
            scale,
            laser: self.laser.clone(),
            sensor: (self.gamma != 1.0).then_some(Sensor { gamma: self.gamma }),
        };
        // These plain structures always serialise.
        toml::to_string(&file).unwrap_or_default()
    }

    /// The frame with counts that are light.
    pub fn linear(&self, frame: Frame) -> Frame {
        light(frame, self.gamma)
    }

    /// The same of a picture's channel, without a copy where counts are light.
    pub fn light_in<'a>(&self, picture: &'a Picture, channel: Channel) -> Cow<'a, Frame> {
        let frame = picture.frame(channel);
        if self.gamma == 1.0 { frame } else { Cow::Owned(self.linear(frame.into_owned())) }
    }

    /// As [`Calibration::view`]; the error names the picture too.
    pub fn view_of(&self, picture: &str, width_px: usize, height_px: usize) -> Result<View> {
        self.view(width_px, height_px).map_err(|e| match e {
            Error::Measure { subject, reason, fix } => {
                Error::measure(format!("{picture}: {subject}"), reason, fix)
            }
            other => other,
        })
    }

    /// The mapping for frames of this size; an error where the calibration was made for another size.
    pub fn view(&self, width_px: usize, height_px: usize) -> Result<View> {
        if let Mapping::Pinhole { lens, .. } = &self.mapping
            && (lens.width_px as usize, lens.height_px as usize) != (width_px, height_px)
        {
            return Err(Error::measure(
                format!("calibration '{}'", self.name),
                format!(
                    "holds for frames of {}×{} px, this picture has {width_px}×{height_px} px",
                    lens.width_px, lens.height_px
                ),
                "use the calibration made for this camera and resolution",
            ));
        }
        Ok(View::new(&self.mapping, width_px, height_px))
    }
}

fn rows<const R: usize, const C: usize>(m: &SMatrix<f64, R, C>) -> [[f64; C]; R] {
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}

/// The frame of a sensor of this gamma with counts that are light.
pub fn light(frame: Frame, gamma: f64) -> Frame {
    if gamma == 1.0 { frame } else { frame.linear(gamma) }
}

pub(super) fn checked_gamma(sensor: Option<Sensor>) -> std::result::Result<f64, Complaint> {
    let gamma = sensor.map_or(1.0, |s| s.gamma);
    if GAMMAS.contains(&gamma) {
        return Ok(gamma);
    }
    Err((
        "sensor.gamma",
        format!("is {gamma}, a camera's lies between {} and {}", GAMMAS.start(), GAMMAS.end()),
        "give 2.2 for pictures made to be looked at (sRGB), leave [sensor] out where counts are light",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_survives_a_round_trip() {
        let text = "schema = 1\nname = 'b'\n[camera]\nwidth_px = 1600\nheight_px = 1200\nfx_px = 3520.0\nfy_px = 3520.0\n\
                    cx_px = 799.5\ncy_px = 599.5\ndistortion = [0.1, 0.0, 0.0, 0.0, 0.0]\n\
                    [plane]\nhomography_mm = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]\n\
                    homography_covariance = [[1e-8, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1e-8, 0.0, 0.0, 0.0, 0.0], \
                    [0.0, 0.0, 1e-8, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1e-8, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1e-8, 0.0], \
                    [0.0, 0.0, 0.0, 0.0, 0.0, 1e-8]]\n\
                    [sensor]\ngamma = 2.2\n";
        let file = tomlfile::parse("c.toml", text).unwrap();
        let calibration = Calibration::from_file(file).unwrap();
        let again =
            Calibration::from_file(tomlfile::parse("c.toml", &calibration.to_toml()).unwrap())
                .unwrap();
        assert_eq!(calibration, again);
        assert!(calibration.view(1600, 1201).unwrap_err().to_string().contains("1600×1200"));
        let negative = text.replacen("1e-8", "-1e-8", 1);
        let refused = Calibration::from_file(tomlfile::parse("c.toml", &negative).unwrap());
        assert_eq!(refused.unwrap_err().0, "plane.homography_covariance");
    }
}
