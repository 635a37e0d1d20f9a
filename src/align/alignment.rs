//! How a blank lies: read again, as a motion of the path, as a picture and as text.

use std::path::Path;

use nalgebra::{Rotation3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

use super::touches::Touches;
use crate::earlier::Earlier;
use crate::error::Result;
use crate::machine::Motion;
use crate::plot::{Figure, Panel};
use crate::uncertainty::K95;

/// How the blank lies. Angles level the blank: `Ry(B) Rx(A)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Alignment {
    /// Turn about X that levels the blank, first of the two.
    pub a_deg: f64,
    /// Half-width of its 95 % interval, as all `u95`.
    pub a_u95_deg: f64,
    /// Turn about Y that levels the blank.
    pub b_deg: f64,
    /// Of `b_deg`.
    pub b_u95_deg: f64,
    /// Between the face's normal and Z: both turns together.
    #[serde(default)]
    pub tilt_deg: f64,
    /// Of `tilt_deg`.
    #[serde(default)]
    pub tilt_u95_deg: f64,
    /// Height of the levelled face above the ideal one.
    pub dz_mm: f64,
    /// Of `dz_mm`.
    pub dz_u95_mm: f64,
    /// Midpoints of the side touches; `null` without them.
    pub center_mm: Option<[f64; 2]>,
    /// Of `center_mm`.
    pub center_u95_mm: Option<[f64; 2]>,
    /// Mean height of the side touches.
    pub center_z_mm: f64,
    /// Height of the ideal face.
    pub z_ideal_mm: f64,
    /// Where the ideal blank's axis is.
    pub center_ideal_mm: [f64; 2],
    /// Turn of the blank about its axis, as told.
    pub c_deg: f64,
    /// Standard uncertainty of a touch.
    pub touch_u_mm: f64,
    /// The face's form: rms of what the plane leaves.
    pub face_rms_mm: f64,
    /// How many touches the face has.
    pub face_points: usize,
}

impl Alignment {
    /// What is to be doubted before a path is moved by it.
    pub fn doubts(&self) -> Vec<String> {
        /// A blank is clamped straighter than this, degrees, and its tilt known better (95 %).
        const MOST_DEG: f64 = 10.0;
        const MOST_UNSURE_DEG: f64 = 0.2;
        let (a, b) = (self.a_deg, self.b_deg);
        let tilted = (a.abs().max(b.abs()) > MOST_DEG).then(|| {
            format!(
                "the blank lies {a:.2}° about X and {b:.2}° about Y off level: is it clamped so?"
            )
        });
        let unsure = self.a_u95_deg.max(self.b_u95_deg);
        let unsure = (unsure > MOST_UNSURE_DEG).then(|| {
            format!("the blank's tilt is known to ±{unsure:.2}° only: look for a wrong touch before the path is cut")
        });
        tilted.into_iter().chain(unsure).collect()
    }

    /// Reads the JSON result of `align`.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let file = Earlier {
            path: path.as_ref(),
            command: "align",
            fix: "give the result of `align --format json`",
        };
        let alignment: Self = file.result()?;
        if alignment.a_deg.abs() > 45.0 || alignment.b_deg.abs() > 45.0 {
            return Err(file.wrong("tilts the blank by more than 45°"));
        }
        Ok(alignment)
    }

    /// From the programmed path to the path on the blank: `p' = (Ry(B) Rx(A))⁻¹ (o + Rz(C) (p - o) + t)`, where `o` is the ideal
    /// axis and `t` brings axis and face of the levelled blank to where they are.
    pub fn motion(&self) -> Motion {
        let level = leveller(self.a_deg.to_radians(), self.b_deg.to_radians());
        let [ox, oy] = self.center_ideal_mm;
        let axis = match self.center_mm {
            Some([x, y]) => level * Vector3::new(x, y, self.center_z_mm),
            None => Vector3::new(ox, oy, 0.0),
        };
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), self.c_deg.to_radians());
        let ideal = Vector3::new(ox, oy, 0.0);
        let t = Vector3::new(axis.x, axis.y, self.dz_mm) - turn * ideal;
        let back = level.inverse();
        Motion::from_parts(Translation3::from(back * t), back * turn)
    }

    /// A map of the touches and the face's residuals.
    pub fn figure(&self, touches: &Touches) -> Figure {
        let level = leveller(self.a_deg.to_radians(), self.b_deg.to_radians());
        let height = self.dz_mm + self.z_ideal_mm;
        let residuals: Vec<_> = touches
            .face
            .iter()
            .enumerate()
            .map(|(i, p)| (i as f64 + 1.0, (level * p).z - height, K95 * self.touch_u_mm))
            .collect();
        let flat =
            |points: &[Vector3<f64>]| -> Vec<_> { points.iter().map(|p| (p.x, p.y)).collect() };
        let sides: Vec<Vector3<f64>> = touches.sides.concat();
        let map = Panel::new("x, mm", "y, mm").title("Touches").equal_scale();
        let map = map.points("face", &flat(&touches.face)).points("sides", &flat(&sides));
        let map = match self.center_mm {
            Some([x, y]) => map.points("centre", &[(x, y)]),
            None => map,
        };
        let face = Panel::new("face point", "height over the plane, mm").title("Face, levelled");
        Figure::new("Blank")
            .columns(2)
            .panel(map)
            .panel(face.points_with_bars("±95 % of a touch", &residuals))
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let mut out = format!(
            "A {:+.5}° ±{:.5}°, B {:+.5}° ±{:.5}° level the blank; its face is {:+.4} ±{:.4} mm above the ideal\n",
            self.a_deg, self.a_u95_deg, self.b_deg, self.b_u95_deg, self.dz_mm, self.dz_u95_mm
        );
        out.push_str(&format!("tilt {:.5}° ±{:.5}° in all\n", self.tilt_deg, self.tilt_u95_deg));
        if let Some(([x, y], [ux, uy])) = self.center_mm.zip(self.center_u95_mm) {
            out.push_str(&format!("centre X {x:+.4} ±{ux:.4} mm, Y {y:+.4} ±{uy:.4} mm\n"));
        }
        out.push_str(&format!(
            "{} face points, flat to {:.4} mm rms\n",
            self.face_points, self.face_rms_mm
        ));
        out
    }
}

/// `Ry(B) Rx(A)`.
pub(super) fn leveller(a_rad: f64, b_rad: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), b_rad)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), a_rad)
}
