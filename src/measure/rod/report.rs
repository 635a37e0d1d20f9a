//! What is asked of a rod's captures, and what is answered.

use serde::{Deserialize, Serialize};

use crate::camera::Laser;
use crate::frame::Channel;
use crate::uncertainty::{Contribution, K95, budget};

/// What is known beforehand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The rod's nominal diameter: a prior, not a truth.
    pub diameter_mm: Option<f64>,
    /// Standard uncertainty of that diameter. 0.02 mm covers the tolerance of a ground rod of unknown class.
    pub diameter_u_mm: f64,
    /// Sense in which C turns the table: +1 or -1 (`c_sense` of the machine file).
    pub c_sense: f64,
    /// Which part of colour pictures is measured.
    pub channel: Channel,
}

impl Default for Options {
    fn default() -> Self {
        Self { diameter_mm: None, diameter_u_mm: LEAST_U_MM, c_sense: 1.0, channel: Channel::Auto }
    }
}

/// Edges nearer to the nominal one than three times this are the rod's, however well that is known: arcs tell a diameter badly.
pub(super) const LEAST_U_MM: f64 = 0.02;

impl Options {
    /// Whether a diameter is the rod's nominal one, as far as that is known.
    pub(super) fn is_nominal(&self, diameter_mm: f64) -> bool {
        let u_mm = self.diameter_u_mm.max(LEAST_U_MM);
        self.diameter_mm.is_some_and(|d| (diameter_mm - d).abs() < 3.0 * u_mm)
    }
}

/// The rod's centre at one table angle.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct RodCenter {
    /// Table angle.
    pub c_deg: f64,
    /// Centre in machine coordinates.
    pub center_mm: [f64; 2],
    /// Half-widths of its 95 % intervals.
    pub center_u95_mm: [f64; 2],
}

/// How one capture fits the common circle.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct CaptureReport {
    /// The picture.
    pub image: String,
    /// Machine X.
    pub x_mm: f64,
    /// Machine Y.
    pub y_mm: f64,
    /// Table angle.
    pub c_deg: f64,
    /// Edge points used.
    pub edge_points: usize,
    /// Share of the visible arc with a usable edge, 0..1.
    pub arc_used: f64,
    /// Mean radial residual; of a capture that is left out, of all its edge points.
    pub residual_mean_mm: f64,
    /// Root mean square of its edge points' radial residuals: their noise counts here, and hardly in `form_rms_mm`.
    pub residual_rms_mm: f64,
}

/// The rod's result.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// One centre a table angle.
    pub rod_centers: Vec<RodCenter>,
    /// The C axis in machine coordinates.
    pub axis_center_mm: [f64; 2],
    /// Half-widths of its 95 % intervals.
    pub axis_center_u95_mm: [f64; 2],
    /// Distance of the rod's centre from the C axis; null with a single table angle.
    pub eccentricity_mm: Option<f64>,
    /// Half-width of its 95 % interval.
    pub eccentricity_u95_mm: Option<f64>,
    /// Whether several table angles part the axis from the rod's eccentricity.
    pub axis_separated: bool,
    /// The rod's diameter.
    pub diameter_mm: f64,
    /// Half-width of its 95 % interval.
    pub diameter_u95_mm: f64,
    /// Root mean square of the form deviation: of what steps along the rim leave over, each the mean of its edge points, with every capture
    /// where it seems to be.
    pub form_rms_mm: f64,
    /// Standard deviation (each axis) of the captures' places against the machine's positions; 0 where they agree.
    pub position_scatter_mm: f64,
    /// Every capture.
    pub captures: Vec<CaptureReport>,
    /// What contributes how much to the uncertainty of the axis (rms of X and Y) and of the diameter.
    pub budget: Vec<Contribution>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Report {
    /// Machine coordinates say where the laser axis is: what the camera axis finds at a machine position lies short of
    /// it by the laser's offset from the camera axis (`docs/conventions.md`).
    pub(super) fn refer_to_laser(&mut self, laser: &Laser) {
        let u95 = laser.offset_u95_mm.unwrap_or_default();
        let centers = self.rod_centers.iter_mut().map(|c| (&mut c.center_mm, &mut c.center_u95_mm));
        let axis = (&mut self.axis_center_mm, &mut self.axis_center_u95_mm);
        for (center, center_u95) in centers.chain([axis]) {
            for k in 0..2 {
                center[k] -= laser.offset_mm[k];
                center_u95[k] = center_u95[k].hypot(u95[k]);
            }
        }
        let laser_mm = (0.5 * (u95[0] * u95[0] + u95[1] * u95[1])).sqrt() / K95;
        let (axis, others): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.budget).into_iter().partition(|c| c.of == "axis_center_mm");
        let parts = axis.into_iter().map(|c| (c.source, c.u_mm));
        self.budget = budget("axis_center_mm", parts.chain([("laser offset".into(), laser_mm)]));
        self.budget.extend(others);
    }
}
