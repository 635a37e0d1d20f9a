//! Where the laser axis is, seen from the camera axis: burns shot at one machine position and photographed at another.
//!
//! Machine coordinates say where the laser axis is over the table. A burn shot at `P_b` therefore lies at `P_b`; photographed
//! from `P` it is seen at the plane offset `p` from the camera axis, which then is at `P_b - p`. The laser axis is at
//! `P`, so seen from the camera axis it lies at `offset = P - (P_b - p) = P + p - P_b`. The other way round, whatever is seen
//! at `p` from machine position `P` lies at the machine position `P + p - offset` ([`machine_mm`]).

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use serde::Serialize;

use crate::camera::{Calibration, Laser, View};
use crate::error::{Error, Result, above_zero};
use crate::fit::robust::median;
use crate::frame::Picture;
use crate::measure::circles;
use crate::measure::plane_errors::PlaneErrors;
use crate::repeats;
use crate::table::Table;
use crate::uncertainty::{K95, k95};

/// A burn so many times farther off than the middle one was mistyped, not scattered: of three burns one in hundreds is.
const FAR: f64 = 20.0;
/// What is never called far off, mm.
const LEAST_OFF_MM: f64 = 0.05;

/// One burn and its picture.
#[derive(Debug, Clone)]
pub struct Shot {
    /// The picture as written in the table.
    pub image: String,
    /// Where it is.
    pub path: PathBuf,
    /// The table's line.
    pub line: u64,
    /// Machine X and Y at which the laser fired.
    pub burnt_mm: Vector2<f64>,
    /// Machine X and Y at which the picture was taken.
    pub position_mm: Vector2<f64>,
}

/// One burn's share of the result.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct ShotReport {
    /// The picture.
    pub image: String,
    /// The burn's centre in the plane.
    pub center_mm: [f64; 2],
    /// Half-widths of its 95 % intervals, without what the plane adds to all burns.
    pub center_u95_mm: [f64; 2],
    /// The offset that this burn alone gives.
    pub offset_mm: [f64; 2],
    /// That minus the result.
    pub residual_mm: [f64; 2],
}

/// The offset and what it rests on.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// Laser axis seen from the camera axis, on the plane.
    pub offset_mm: [f64; 2],
    /// Half-widths of its 95 % intervals.
    pub offset_u95_mm: [f64; 2],
    /// Every burn.
    pub burns: Vec<ShotReport>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Report {
    /// As it stands in a calibration file.
    pub fn laser(&self) -> Laser {
        Laser { offset_mm: self.offset_mm, offset_u95_mm: Some(self.offset_u95_mm) }
    }
}

/// The machine position of what is seen at `plane_mm` from machine position `position_mm`: the laser fires there when
/// the machine is driven to it.
pub fn machine_mm(
    position_mm: Vector2<f64>,
    plane_mm: Vector2<f64>,
    laser: Option<&Laser>,
) -> Vector2<f64> {
    position_mm + plane_mm - laser.map_or_else(Vector2::zeros, |l| l.offset_mm.into())
}

/// Reads `BURNS.csv`: `image,burn_x_mm,burn_y_mm,x_mm,y_mm`. A picture that stands twice is left out once, with a warning.
pub fn read(path: impl AsRef<Path>, warnings: &mut Vec<String>) -> Result<Vec<Shot>> {
    let path = path.as_ref();
    let table = Table::read(path, &["image", "burn_x_mm", "burn_y_mm", "x_mm", "y_mm"], &[])?;
    repeats::pictures_once(&table, warnings)?
        .into_iter()
        .map(|(row, path)| {
            let pair = |x: &str, y: &str| -> Result<Vector2<f64>> {
                Ok(Vector2::new(table.number(row, x)?, table.number(row, y)?))
            };
            Ok(Shot {
                path,
                line: table.line(row),
                image: table.text(row, "image").to_owned(),
                burnt_mm: pair("burn_x_mm", "burn_y_mm")?,
                position_mm: pair("x_mm", "y_mm")?,
            })
        })
        .collect()
}

/// Measures every burn and averages what they say. `diameter_mm` is about that of the burns.
pub fn calibrate(shots: &[Shot], calibration: &Calibration, diameter_mm: f64) -> Result<Report> {
    above_zero("--diameter-mm", diameter_mm, "give the burns' diameter in mm")?;
    let options = circles::Options { expect_mm: vec![diameter_mm], channel: Default::default() };
    let mut burns = Vec::new();
    // The plane's errors are the same in all pictures: they do not average out.
    let exact = calibration.as_exact();
    let mut planes = Vec::new();
    for shot in shots {
        let subject = shot.path.display().to_string();
        let measured = |picture: Picture| -> Result<(View, circles::Measured)> {
            let (width, height) = picture.size();
            let view = calibration.view_of(&subject, width, height)?;
            let seen = circles::measure(&picture, &exact, &options, &subject);
            Ok((view, seen.map_err(|e| e.of_option("--diameter-mm"))?))
        };
        let (view, seen) =
            Picture::read(&shot.path).and_then(measured).map_err(|e| e.on_line(shot.line))?;
        let circles = seen.report.circles.iter().zip(&seen.rings);
        let Some((circle, ring)) = circles.map(|(c, ring)| (&c.circle, ring)).next() else {
            continue;
        };
        planes.push(PlaneErrors::of(&view, ring));
        let offset = shot.position_mm + Vector2::from(circle.center_mm) - shot.burnt_mm;
        burns.push(ShotReport {
            image: shot.image.clone(),
            center_mm: circle.center_mm,
            center_u95_mm: circle.center_u95_mm,
            offset_mm: offset.into(),
            residual_mm: [0.0; 2],
        });
    }
    if let Some((i, off_mm)) = odd_one_out(&burns) {
        return Err(Error::measure(
            format!("line {}: {}", shots[i].line, shots[i].image),
            format!(
                "this burn puts the laser axis {off_mm:.3} mm from where the others agree that it is"
            ),
            "correct its burn_x_mm, burn_y_mm, x_mm or y_mm, or remove the row",
        ));
    }
    let plane = PlaneErrors::mean(&planes).center_covariance(f64::INFINITY);
    average(burns, [0, 1].map(|k| K95 * plane[(k, k)].sqrt()))
}

/// A laser axis that is known no better than this (95 %) is not known: no machine places its burns so badly.
const MOST_UNSURE_MM: f64 = 0.5;

/// The burn whose offset is farthest from the median, and how far, where that is no scatter: [`FAR`] times what the
/// middle one is off, or [`LEAST_OFF_MM`] at least.
fn odd_one_out(burns: &[ShotReport]) -> Option<(usize, f64)> {
    if burns.len() < 3 {
        return None;
    }
    let middle =
        [0, 1].map(|k| median(&mut burns.iter().map(|b| b.offset_mm[k]).collect::<Vec<_>>()));
    let off = |b: &ShotReport| (b.offset_mm[0] - middle[0]).hypot(b.offset_mm[1] - middle[1]);
    let usual = median(&mut burns.iter().map(off).collect::<Vec<_>>());
    let far = burns.iter().map(off).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
    far.filter(|(_, off_mm)| *off_mm > (FAR * usual).max(LEAST_OFF_MM))
}

/// The mean of the burns' offsets. Its uncertainty is what the burns' scatter says (the machine's repeatability is in
/// it), but no less than that of their centres, and what the plane adds to all of them alike.
fn average(mut burns: Vec<ShotReport>, plane_u95_mm: [f64; 2]) -> Result<Report> {
    let n = burns.len() as f64;
    if burns.is_empty() {
        return Err(Error::measure("burns", "there are none", "give at least one burn"));
    }
    let mut warnings = Vec::new();
    let offset_mm = [0, 1].map(|k| burns.iter().map(|b| b.offset_mm[k]).sum::<f64>() / n);
    let offset_u95_mm = [0, 1].map(|k| {
        let measured = burns.iter().map(|b| b.center_u95_mm[k].powi(2)).sum::<f64>().sqrt() / n;
        let squares: f64 = burns.iter().map(|b| (b.offset_mm[k] - offset_mm[k]).powi(2)).sum();
        let scatter = if n > 1.0 { k95(n - 1.0) * (squares / (n - 1.0) / n).sqrt() } else { 0.0 };
        measured.max(scatter).hypot(plane_u95_mm[k])
    });
    if offset_u95_mm.iter().any(|u95| *u95 > MOST_UNSURE_MM) {
        return Err(Error::measure(
            "burns",
            format!(
                "they do not agree where the laser axis is: ({:.3} ± {:.3}, {:.3} ± {:.3}) mm",
                offset_mm[0], offset_u95_mm[0], offset_mm[1], offset_u95_mm[1]
            ),
            "check burn_x_mm, burn_y_mm, x_mm and y_mm (mm, machine coordinates), and the calibration's signs",
        ));
    }
    for b in &mut burns {
        b.residual_mm = [0, 1].map(|k| b.offset_mm[k] - offset_mm[k]);
    }
    if burns.len() < 3 {
        warnings.push(format!(
            "{} only: the machine's own scatter is hardly known; shoot three burns or more",
            if burns.len() == 1 { "one burn" } else { "two burns" }
        ));
    }
    Ok(Report { offset_mm, offset_u95_mm, burns, warnings })
}
