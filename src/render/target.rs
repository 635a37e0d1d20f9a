//! A calibration target held before the camera, for pictures whose corners are known.

use std::path::Path;

use nalgebra::{Matrix3, Vector2};

use super::camera::{Camera, Sensor};
use super::draw::Dice;
use super::expose::{Band, Patch, Scene, expose};
use super::picture::Picture;
use super::surface::Light;
use crate::calib::target::{Shape, Target};
use crate::camera::{Calibration, Lens, Mapping};
use crate::cv::Pose;
use crate::error::{Error, Result};

/// Radiance of ink, paper and what is round the paper.
const LEVELS: [f64; 3] = [0.06, 0.85, 0.35];

/// A picture of the target and where its points are in it.
#[derive(Debug, Clone)]
pub struct RenderedTarget {
    /// The picture.
    pub picture: Picture,
    /// The places of [`Target::points_mm`], in the same order; some may be outside the frame.
    pub points_px: Vec<Vector2<f64>>,
}

/// Photographs `target` held at `pose` (its top left corner being the board's origin).
pub fn render(
    target: &Target,
    lens: &Lens,
    pose: &Pose,
    blur_px: f64,
    seed: u64,
) -> Result<RenderedTarget> {
    let turn = pose.turn.matrix();
    let to_image =
        Matrix3::from_columns(&[turn.column(0).into(), turn.column(1).into(), pose.shift_mm]);
    let homography_mm = to_image.try_inverse().ok_or_else(|| {
        Error::measure("target", "is seen edge on", "hold it so that its face is seen")
    })?;
    let mapping =
        Mapping::Pinhole { lens: lens.clone(), homography_mm, covariance: None, mirrored: false };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let (width, height) = (lens.width_px, lens.height_px);
    let view = calibration.view(width as usize, height as usize)?;
    let points_px = target.points_mm().into_iter().map(|p| view.to_pixel(p)).collect();
    let scene = Board {
        shapes: target.shapes(),
        low: Vector2::repeat(-target.pitch_mm),
        high: target.size_mm() + Vector2::repeat(target.pitch_mm),
    };
    let mut dice = Dice::new(Path::new("target"), seed, 1);
    let shade = Light::default().shade(&mut dice, width, height)?;
    let camera = Camera { calibration, blur_px };
    let picture = expose(&scene, &camera, &Sensor::default(), &shade, &mut dice, seed)?;
    Ok(RenderedTarget { picture, points_px })
}

struct Board {
    shapes: Vec<Shape>,
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl Scene for Board {
    type Local = Vec<Shape>;
    type Ground = ();

    fn local(&self, patch: Patch) -> (Vec<Shape>, usize) {
        let reach = patch.radius_mm + patch.pixel_mm;
        let near = |shape: &&Shape| match shape {
            Shape::Box { corner, size, .. } => {
                let off = patch.middle_mm - patch.middle_mm.sup(corner).inf(&(corner + size));
                off.norm() < reach
            }
            Shape::Disc { center, radius } => (patch.middle_mm - center).norm() < reach + radius,
        };
        (self.shapes.iter().filter(near).copied().collect(), 4)
    }

    fn ground(&self, _: Vector2<f64>) {}

    fn radiance(&self, near: &Vec<Shape>, (): (), p: Vector2<f64>, sample: f64, _: Band) -> f64 {
        let [ink, paper, round] = LEVELS;
        let sheet = inside(p, self.low, self.high, sample);
        let mut value = round + (paper - round) * sheet;
        for shape in near {
            let (cover, level) = match *shape {
                Shape::Box { corner, size, ink: black } => {
                    (inside(p, corner, corner + size, sample), if black { ink } else { paper })
                }
                Shape::Disc { center, radius } => {
                    (((radius - (p - center).norm()) / sample + 0.5).clamp(0.0, 1.0), ink)
                }
            };
            value += (level - value) * cover;
        }
        value
    }
}

/// How much of a square sample about `p` lies in a rectangle.
fn inside(p: Vector2<f64>, low: Vector2<f64>, high: Vector2<f64>, sample: f64) -> f64 {
    let along = |p: f64, low: f64, high: f64| {
        let half = 0.5 * sample;
        (((p + half).min(high) - (p - half).max(low)) / sample).clamp(0.0, 1.0)
    };
    along(p.x, low.x, high.x) * along(p.y, low.y, high.y)
}
