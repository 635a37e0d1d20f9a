//! The scene's camera and sensor: what the optics do, what the sensor adds, and the calibration file
//! that a perfect calibration of this camera would give.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use super::draw::{Dice, Draw};
use crate::camera::{Calibration, Lens, Mapping};
use crate::error::Result;

/// `[camera]`: optics and geometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Optics {
    /// Frame width (default 1600).
    pub width_px: u32,
    /// Frame height (default 1200).
    pub height_px: u32,
    /// Size of a pixel in the plane, on the axis (default 0.008).
    pub pixel_mm: Draw,
    /// Focal length in pixels; with the pixel's size it sets the working distance (default 3520).
    pub focal_px: Draw,
    /// Principal point minus the frame's middle (default 0, 0).
    pub axis_shift_px: [Draw; 2],
    /// k1, k2, p1, p2, k3 (default none).
    pub distortion: [Draw; 5],
    /// Tilt of the plane about the camera's u and v axes (default 0, 0).
    pub tilt_deg: [Draw; 2],
    /// Turn of the camera about its axis (default 0: u is machine X, v is -Y).
    pub roll_deg: Draw,
    /// Optical blur: standard deviation of the Gaussian spread (default 1.2).
    pub blur_px: Draw,
}

impl Default for Optics {
    fn default() -> Self {
        let zero = || Draw::Fixed(0.0);
        Self {
            width_px: 1600,
            height_px: 1200,
            pixel_mm: 0.008.into(),
            focal_px: 3520.0.into(),
            axis_shift_px: [zero(), zero()],
            distortion: [zero(), zero(), zero(), zero(), zero()],
            tilt_deg: [zero(), zero()],
            roll_deg: zero(),
            blur_px: 1.2.into(),
        }
    }
}

/// `[sensor]`: from light to numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sensor {
    /// 8, 12 or 16 bits; 12 are stored as 0..4095 in a 16-bit file (default 8).
    pub bits: u8,
    /// Red, green and blue instead of gray; the mark's contrast differs between them (default false).
    pub colour: bool,
    /// Part of full scale that a white surface reaches (default 0.85).
    pub exposure: Draw,
    /// Electrons at full scale: sets the shot noise (default 20000).
    pub full_well_e: Draw,
    /// Read noise in electrons (default 15).
    pub read_noise_e: Draw,
    /// Part of full scale read without light (default 0.01).
    pub black: Draw,
    /// Exponent of the output curve: value = light^(1/gamma) (default 1, linear).
    pub gamma: Draw,
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            bits: 8,
            colour: false,
            exposure: 0.85.into(),
            full_well_e: 20_000.0.into(),
            read_noise_e: 15.0.into(),
            black: 0.01.into(),
            gamma: 1.0.into(),
        }
    }
}

/// One camera drawn from a scene: its true calibration and its optical blur.
#[derive(Debug, Clone)]
pub struct Camera {
    /// What a perfect calibration would find.
    pub calibration: Calibration,
    /// Standard deviation of the optical blur.
    pub blur_px: f64,
}

impl Optics {
    /// The same view with `n` × `n` pixels read as one; the blur keeps its size in pixels.
    pub fn binned(&self, n: u32) -> Self {
        let less = 1.0 / f64::from(n);
        Self {
            width_px: self.width_px / n,
            height_px: self.height_px / n,
            pixel_mm: self.pixel_mm.times(f64::from(n)),
            focal_px: self.focal_px.times(less),
            axis_shift_px: std::array::from_fn(|i| self.axis_shift_px[i].times(less)),
            ..self.clone()
        }
    }

    /// Draws one camera.
    pub(super) fn draw(&self, dice: &mut Dice) -> Result<Camera> {
        for (field, value) in
            [("camera.width_px", self.width_px), ("camera.height_px", self.height_px)]
        {
            if !(16..=16_384).contains(&value) {
                return Err(dice.fault(
                    field,
                    format!("is {value}"),
                    "choose between 16 and 16384",
                ));
            }
        }
        let pixel_mm = dice.roll("camera.pixel_mm", &self.pixel_mm, 1e-5..=1.0)?;
        let focal_px = dice.roll("camera.focal_px", &self.focal_px, 100.0..=1e7)?;
        let shift = dice.roll2("camera.axis_shift_px", &self.axis_shift_px, -2000.0..=2000.0)?;
        let mut distortion = [0.0; 5];
        for (value, draw) in distortion.iter_mut().zip(&self.distortion) {
            *value = dice.roll("camera.distortion", draw, -2.0..=2.0)?;
        }
        let tilt = dice.roll2("camera.tilt_deg", &self.tilt_deg, -45.0..=45.0)?;
        let roll = dice.roll("camera.roll_deg", &self.roll_deg, -360.0..=360.0)?;
        let blur_px = dice.roll("camera.blur_px", &self.blur_px, 0.0..=20.0)?;
        let lens = Lens {
            width_px: self.width_px,
            height_px: self.height_px,
            fx_px: focal_px,
            fy_px: focal_px,
            cx_px: (f64::from(self.width_px) - 1.0) / 2.0 + shift[0],
            cy_px: (f64::from(self.height_px) - 1.0) / 2.0 + shift[1],
            distortion,
        };
        let mapping = Mapping::Pinhole {
            lens,
            homography_mm: plane_homography(pixel_mm * focal_px, tilt, roll),
            covariance: None,
            mirrored: false,
        };
        let calibration = Calibration {
            name: "rendered camera (true values)".into(),
            mapping,
            laser: None,
            gamma: 1.0,
        };
        Ok(Camera { calibration, blur_px })
    }
}

/// Normalised image → plane for a camera at `distance_mm` whose axis meets the plane's origin.
///
/// In the camera's frame (x right, y down, z forward) the plane point (X, Y) lies at
/// `R · (X, -Y, 0) + (0, 0, distance)`, with R the tilt about the camera's x then y axis, after the roll
/// about its z axis; the homography is the inverse of that projection.
fn plane_homography(distance_mm: f64, tilt_deg: [f64; 2], roll_deg: f64) -> Matrix3<f64> {
    let about = |axis: Vector3<f64>, deg: f64| {
        Rotation3::from_axis_angle(&nalgebra::Unit::new_normalize(axis), deg.to_radians())
    };
    let turn = about(Vector3::y(), tilt_deg[1])
        * about(Vector3::x(), tilt_deg[0])
        * about(Vector3::z(), roll_deg);
    let x = turn * Vector3::x();
    let y = turn * -Vector3::y();
    let to_image = Matrix3::from_columns(&[x, y, Vector3::new(0.0, 0.0, distance_mm)]);
    // Invertible for every tilt below 90°.
    let h = to_image.try_inverse().unwrap_or_else(Matrix3::identity);
    h / h[(2, 2)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use std::path::Path;

    #[test]
    fn the_axis_meets_the_origin_and_v_down_is_minus_y() {
        let optics = Optics {
            tilt_deg: [4.0.into(), (-3.0).into()],
            axis_shift_px: [12.0.into(), (-7.0).into()],
            ..Optics::default()
        };
        let camera = optics.draw(&mut Dice::new(Path::new("s"), 1, 0)).unwrap();
        let view = camera.calibration.view(1600, 1200).unwrap();
        let axis = view.axis_px();
        assert!((axis - Vector2::new(811.5, 592.5)).norm() < 1e-9);
        let below = view.to_plane(axis + Vector2::new(0.0, 1.0));
        assert!(below.y < -0.0079 && below.y > -0.0081 && below.x.abs() < 1e-4, "{below}");
        // A plane tilted about the camera's x axis: its lower part (v down) is nearer or farther, so the
        // scale differs above and below the axis, and not to its left and right.
        let only_x = Optics { tilt_deg: [10.0.into(), 0.0.into()], ..Optics::default() };
        let view = only_x.draw(&mut Dice::new(Path::new("s"), 1, 0)).unwrap();
        let view = view.calibration.view(1600, 1200).unwrap();
        let size = |u: f64, v: f64| view.pixel_mm_at(Vector2::new(u, v));
        assert!((size(799.5, 0.0) / size(799.5, 1199.0) - 1.0).abs() > 0.05);
        assert!((size(0.0, 599.5) / size(1599.0, 599.5) - 1.0).abs() < 1e-9);
    }
}
