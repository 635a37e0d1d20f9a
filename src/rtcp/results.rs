//! Results of earlier commands that a session file names: the rod's and the burn test's.

use std::path::Path;

use nalgebra::{Rotation2, Vector2};
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
/// Centres that miss their circle by more do not turn with the table as they are said to, mm.
const MOST_ASTRAY_MM: f64 = 0.02;

impl RodResult {
    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self> {
        let file = earlier(path, "rod");
        file.shape(file.json()?)
    }

    /// The rod's centre at a table angle, seen from the C axis along X: as it was seen there, or where the table turns it to from the
    /// angles at which it was seen; `None` where these do not tell.
    pub fn offset_at(&self, c_deg: f64, c_sense: i32) -> Option<Measured> {
        let axis = Vector2::from(self.axis_center_mm);
        let off = |r: &RodCenter| Vector2::from(r.center_mm) - axis;
        let seen = self.rod_centers.iter().find(|r| apart_deg(r.c_deg, c_deg) < SAME_ANGLE_DEG);
        if let Some(seen) = seen {
            // The rod's own centre, seen at the touches' angle, is the very centre seen.
            let u = if self.is_rods() { 0.0 } else { seen.center_u95_mm.pair()[0] / K95 };
            return Some(Measured { value: off(seen).x, u });
        }
        if self.is_rods() || self.rod_centers.len() < 2 {
            return None;
        }
        let turn = |c: f64| Rotation2::new(f64::from(c_sense) * c.to_radians());
        let count = self.rod_centers.len() as f64;
        let mean = |of: &dyn Fn(&RodCenter) -> Vector2<f64>| {
            self.rod_centers.iter().map(of).sum::<Vector2<f64>>() / count
        };
        let eccentric = mean(&|r| turn(r.c_deg).inverse() * off(r));
        let missed = mean(&|r| (off(r) - turn(r.c_deg) * eccentric).map(|v| v * v));
        let stated = mean(&|r| Vector2::from(r.center_u95_mm.pair()).map(|u| (u / K95).powi(2)));
        let u2 = 0.5 * (missed + stated).sum();
        let told = missed.sum().sqrt() < MOST_ASTRAY_MM;
        told.then(|| Measured { value: (turn(c_deg) * eccentric).x, u: u2.sqrt() })
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
