//! Results of earlier commands that a session file names: the rod's and the burn test's.

use std::path::Path;

use nalgebra::{Matrix2, Matrix4, Rotation2, RowVector4, SMatrix, Vector2, Vector4};
use serde::Deserialize;
use serde_json::Value;

use crate::earlier::Earlier;
use crate::error::Result;
use crate::machine::apart_deg;
use crate::rtcp::session_file::OneOrTwo;
use crate::uncertainty::{K95, Measured};

/// What is used of the output of `pivotsight rod --format json`.
#[derive(Debug, Deserialize)]
pub struct RodResult {
    pub axis_center_mm: [f64; 2],
    pub axis_center_u95_mm: OneOrTwo,
    pub diameter_mm: Option<f64>,
    pub diameter_u95_mm: Option<f64>,
    pub eccentricity_mm: Option<f64>,
    pub eccentricity_u95_mm: Option<f64>,
    pub axis_separated: Option<bool>,
    #[serde(default)]
    pub rod_centers: Vec<RodCenter>,
    #[serde(default)]
    pub warnings: Vec<String>,
}

#[derive(Debug, Deserialize)]
pub struct RodCenter {
    pub c_deg: f64,
    pub center_mm: [f64; 2],
    pub center_u95_mm: OneOrTwo,
}

/// What is used of the output of `pivotsight burn --format json`.
#[derive(Debug, Deserialize)]
pub struct BurnResult {
    pub offset_mm: [f64; 2],
    pub offset_u95_mm: [f64; 2],
    pub offset_cov_mm2: Option<[[f64; 2]; 2]>,
}

/// Degrees within which two angles of the table are one.
const SAME_ANGLE_DEG: f64 = 0.5;
/// No centre is taken for better known than this, mm.
const LEAST_U_MM: f64 = 1e-6;
/// Centres that miss their circle by more do not turn with the table as they are said to, mm.
const MOST_ASTRAY_MM: f64 = 0.02;

/// The rod's centre seen from the C axis along X.
#[derive(Debug, Clone, Copy)]
pub struct OffAxis {
    /// With the part of its uncertainty that the axis does not share.
    pub offset_mm: Measured,
    /// How it changes with an error of the axis in X and in Y.
    pub follows: [f64; 2],
}

impl OffAxis {
    /// One that has nothing to do with the axis' errors.
    pub fn alone(offset_mm: Measured) -> Self {
        Self { offset_mm, follows: [0.0; 2] }
    }
}

impl RodResult {
    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self> {
        let file = earlier(path, "rod");
        file.shape(file.json()?)
    }

    /// The rod's centre at a table angle, seen from the C axis along X: from where it was seen at all angles; `None` where these do not
    /// tell.
    pub fn offset_at(&self, c_deg: f64, c_sense: i32) -> Option<OffAxis> {
        let axis = Vector2::from(self.axis_center_mm);
        if self.is_rods() {
            // The rod's own centre, seen at the touches' angle, is the very centre seen.
            let is_there = |r: &&RodCenter| apart_deg(r.c_deg, c_deg) < SAME_ANGLE_DEG;
            let seen = self.rod_centers.iter().find(is_there)?;
            return Some(OffAxis::alone(Measured::exact(seen.center_mm[0] - axis.x)));
        }
        // Axis and eccentricity together, by least squares: an error of the axis turns up in the eccentricity.
        let turn = |c: f64| Rotation2::new(f64::from(c_sense) * c.to_radians());
        let row = |c: f64| {
            let mut row = SMatrix::<f64, 2, 4>::identity();
            row.fixed_view_mut::<2, 2>(0, 2).copy_from(turn(c).matrix());
            row
        };
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        let weight = |r: &RodCenter| {
            let u = r.center_u95_mm.pair().map(|u| (u / K95).max(LEAST_U_MM));
            Matrix2::from_diagonal(&Vector2::from(u.map(|u| u.powi(-2))))
        };
        for seen in &self.rod_centers {
            let (row, weight) = (row(seen.c_deg), weight(seen));
            normal += row.transpose() * weight * row;
            right += row.transpose() * weight * Vector2::from(seen.center_mm);
        }
        // Angles that are nearly one tell nothing, and leave nothing that rounding has not made.
        let told = normal.try_inverse().filter(|c| c.diagonal().iter().all(|v| *v > 0.0));
        let covariance = told?;
        let found = covariance * right;
        let left = |r: &RodCenter| Vector2::from(r.center_mm) - row(r.c_deg) * found;
        let count = self.rod_centers.len() as f64;
        let missed_mm2: f64 = self.rod_centers.iter().map(|r| left(r).norm_squared()).sum();
        if (missed_mm2 / count).sqrt() > MOST_ASTRAY_MM {
            return None;
        }
        let chi2: f64 = self.rod_centers.iter().map(|r| left(r).dot(&(weight(r) * left(r)))).sum();
        let covariance = covariance * (chi2 / (2.0 * count - 4.0).max(1.0)).max(1.0);
        let along: RowVector4<f64> = row(c_deg).row(0) - RowVector4::new(1.0, 0.0, 0.0, 0.0);
        let with_axis = along * covariance;
        let stated = self.axis_center_u95_mm.pair().map(|u| (u / K95).max(LEAST_U_MM).powi(2));
        let follows = [with_axis[0] / stated[0], with_axis[1] / stated[1]];
        let shared = follows[0] * with_axis[0] + follows[1] * with_axis[1];
        let u2 = (with_axis * along.transpose())[0] - shared;
        let value = (row(c_deg) * found).x - axis.x;
        let offset_mm = Measured { value, u: u2.max(0.0).sqrt() };
        Some(OffAxis { offset_mm, follows })
    }

    /// Twice the eccentricity, where several table angles show it.
    pub fn run_out(&self) -> Option<Measured> {
        let e = self.eccentricity_mm.filter(|_| self.rod_centers.len() > 1)?;
        Some(Measured { value: 2.0 * e, u: 2.0 * self.eccentricity_u95_mm.unwrap_or(0.0) / K95 })
    }

    /// Whether its centre is the rod's at one angle and not the table's axis.
    pub fn is_rods(&self) -> bool {
        self.axis_separated == Some(false)
    }
}

impl BurnResult {
    /// Reads the file: of several pictures their mean where it was asked for, else the last, with a warning: it is taken for the
    /// test that ended the adjusting.
    pub fn read(path: &Path, warnings: &mut Vec<String>) -> Result<Self> {
        let file = earlier(path, "burn");
        let mut json = file.json()?;
        if let Some(mean) = json.get_mut("mean") {
            return file.shape(mean.take());
        }
        let Some(results) = json.get_mut("results").and_then(Value::as_array_mut) else {
            return file.shape(json);
        };
        let count = results.len();
        let last = results.pop().unwrap_or_default();
        if count > 1 {
            let image = last.get("image").and_then(Value::as_str).unwrap_or_default();
            warnings.push(format!(
                "{}: holds {count} pictures, of which the last, {image}, is taken; give the result of one picture, or that of \
                 `burn --mean` for tests burnt at one setting",
                path.display()
            ));
        }
        file.shape(last)
    }
}

fn earlier<'p>(path: &'p Path, command: &'p str) -> Earlier<'p> {
    Earlier { path, command, fix: "write it with --format json --out FILE" }
}
