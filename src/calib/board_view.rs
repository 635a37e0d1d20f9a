//! Where a lens should see a board's points, and the lens that sees them where they are.

use nalgebra::{Vector2, Vector3};

use crate::camera::{Lens, View};
use crate::cv::{self, BoardView, Distortion, LensFit, Pose};
use crate::error::Result;

/// Points of a dot's outline; so many leave 1 % of what its middle is off its centre.
const OUTLINE: u32 = 24;
/// The middles' shifts change in the second decimal by then.
const ROUNDS: usize = 2;

impl BoardView {
    /// Seen minus expected, for each point, through a lens' normalised view.
    pub fn residuals(&self, camera: &View, pose: &Pose) -> Vec<Vector2<f64>> {
        let expected = |b: &Vector3<f64>| match self.radius_mm > 0.0 {
            true => middle(camera, pose, b, self.radius_mm),
            false => seen(camera, pose, b),
        };
        self.board_mm.iter().zip(&self.pixels).map(|(b, p)| p - expected(b)).collect()
    }

    /// With dots' centres in place of the middles of their images, which perspective shifts to the near side.
    fn centred(&self, lens: &Lens, pose: &Pose) -> Self {
        let camera = lens.normalised();
        let centres = self.board_mm.iter().zip(self.residuals(&camera, pose));
        let pixels = centres.map(|(b, off)| seen(&camera, pose, b) + off).collect();
        Self { pixels, ..self.clone() }
    }
}

fn seen(camera: &View, pose: &Pose, b: &Vector3<f64>) -> Vector2<f64> {
    let p = pose.turn * b + pose.shift_mm;
    camera.to_pixel(Vector2::new(p.x / p.z, p.y / p.z))
}

/// Middle of the area that a dot covers in the picture.
fn middle(camera: &View, pose: &Pose, b: &Vector3<f64>, radius_mm: f64) -> Vector2<f64> {
    let centre = seen(camera, pose, b);
    let outline = (0..=OUTLINE).map(|i| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(OUTLINE)).sin_cos();
        seen(camera, pose, &(b + radius_mm * Vector3::new(cos, sin, 0.0))) - centre
    });
    let (mut area, mut moment, mut last) = (0.0, Vector2::zeros(), None);
    for at in outline {
        if let Some(before) = last.replace(at) {
            let twice = before.perp(&at);
            area += twice;
            moment += twice * (before + at) / 3.0;
        }
    }
    centre + moment / area
}

/// The lens on which all views agree.
pub(super) fn fitted(
    views: &[BoardView],
    size: (u32, u32),
    distortion: Distortion,
) -> Result<LensFit> {
    let mut fit = cv::calibrate(views, size, distortion)?;
    if views.iter().any(|v| v.radius_mm > 0.0) {
        for _ in 0..ROUNDS {
            let centred: Vec<BoardView> =
                views.iter().zip(&fit.poses).map(|(v, p)| v.centred(&fit.lens, p)).collect();
            fit = cv::calibrate(&centred, size, distortion)?;
        }
    }
    Ok(fit)
}
