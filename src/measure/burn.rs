//! The burn test: is the 100 W spot concentric with the 500 W ring, and how far are B and the shims off?
//!
//! Signs (`docs/conventions.md`): the beam leaves the nozzle along `Ry(B)·(0, 0, -1)`, so a B that stands too far by β moves
//! a mark burnt from height h by `-h tan β` in X; the spot, burnt from nearer, lies `+H tan β` from the ring (`H` the
//! difference of the heights). The correction turns B by `-β`. In Y a head turned by α about X moves the marks
//! by `+h tan α`: the offset is `-H tan α`, and the shims have to turn the head by `-α`.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use crate::camera::Calibration;
use crate::error::{Error, Result};
use crate::frame::{Channel, Picture};
use crate::measure::marks;
use crate::measure::ring::Ring;
use crate::measure::{CircleReport, best_channel};
use crate::uncertainty::{Contribution, K95, Verdict, budget, distance, k95};

/// How the limit is read.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Default,
    clap::ValueEnum,
    Serialize,
    Deserialize,
    schemars::JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum ToleranceKind {
    /// The distance between the centres
    #[default]
    Distance,
    /// ISO 1101: the zone's diameter, twice the distance
    Zone,
}

/// What is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The limit.
    pub tolerance_mm: f64,
    /// What the limit applies to.
    pub tolerance_kind: ToleranceKind,
    /// Nozzle height at which the ring was burnt.
    pub ring_height_mm: f64,
    /// Nozzle height at which the spot was burnt.
    pub spot_height_mm: f64,
    /// Length of the head's flange over which the shims tilt it, where it is known.
    pub flange_mm: Option<f64>,
    /// Which part of a colour picture is measured.
    pub channel: Channel,
    /// Where the ring's centre is, about, in the plane: for pictures with several test burns.
    pub near_mm: Option<[f64; 2]>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tolerance_mm: 0.01,
            tolerance_kind: ToleranceKind::Distance,
            ring_height_mm: 50.0,
            spot_height_mm: 3.0,
            flange_mm: None,
            channel: Channel::Auto,
            near_mm: None,
        }
    }
}

/// How to turn B and the head so that the next burn is concentric.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Correction {
    /// Turn B by this much (add it to the B zero's actual position).
    pub b_deg: f64,
    /// Half-width of its 95 % interval.
    pub b_u95_deg: f64,
    /// Turn the head about X by this much with shims under its flange.
    pub shim_deg: f64,
    /// Half-width of its 95 % interval.
    pub shim_u95_deg: f64,
    /// Thickness of shims over the flange's length; null where that length is not given.
    pub shim_mm: Option<f64>,
}

/// The burn test's result.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// The ring: the outer edge of the burnt disc or annulus.
    pub ring: CircleReport,
    /// The spot.
    pub spot: CircleReport,
    /// Spot minus ring.
    pub offset_mm: [f64; 2],
    /// Half-widths of its 95 % intervals.
    pub offset_u95_mm: [f64; 2],
    /// Its covariance.
    pub offset_cov_mm2: [[f64; 2]; 2],
    /// Distance between the centres.
    pub distance_mm: f64,
    /// Half-width of its 95 % interval.
    pub distance_u95_mm: f64,
    /// ISO 1101 concentricity zone: twice the distance.
    pub zone_mm: f64,
    /// The limit.
    pub tolerance_mm: f64,
    /// What the limit applies to.
    pub tolerance_kind: ToleranceKind,
    /// Whether it is kept.
    pub verdict: Verdict,
    /// What to turn.
    pub correction: Correction,
    /// What contributes how much to the uncertainty of the distance.
    pub budget: Vec<Contribution>,
    /// The part of a colour picture that was measured; `luminance` for a gray one.
    pub channel: Channel,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// The report with what an overlay shows.
#[derive(Debug, Clone)]
pub struct Measured {
    /// The report.
    pub report: Report,
    /// The ring with its edge points.
    pub ring: Ring,
    /// The spot with its edge points.
    pub spot: Ring,
}

/// Measures a burn test's picture; `subject` names it in messages.
pub fn measure(
    picture: &Picture,
    calibration: &Calibration,
    options: &Options,
    subject: &str,
) -> Result<Measured> {
    check(options)?;
    let (width, height) = picture.size();
    let view = calibration.view_of(subject, width, height)?;
    let attempt = |channel: Channel| {
        let (ring, spot, warnings) =
            marks::measure(&picture.frame(channel), &view, options.near_mm, subject)?;
        Ok(report(ring, spot, options, channel, warnings))
    };
    let spread = |m: &Measured| m.report.offset_u95_mm[0].hypot(m.report.offset_u95_mm[1]);
    let mut measured = best_channel(picture, options.channel, subject, attempt, spread)?;
    if picture.is_colour() {
        let word = measured.report.channel.word();
        measured.report.warnings.push(format!("colour picture: measured in its {word} channel"));
    }
    Ok(measured)
}

/// Checks the options; the same for every picture.
pub fn check(options: &Options) -> Result<()> {
    let positive = |name: &str, v: f64| {
        if v.is_finite() && v > 0.0 {
            Ok(())
        } else {
            Err(Error::option(name, format!("{v} is not a length"), "give a positive number in mm"))
        }
    };
    positive("--tolerance-mm", options.tolerance_mm)?;
    positive("--ring-height-mm", options.ring_height_mm)?;
    positive("--spot-height-mm", options.spot_height_mm)?;
    if let Some(l) = options.flange_mm {
        positive("--flange-mm", l)?;
    }
    if options.ring_height_mm <= options.spot_height_mm {
        return Err(Error::option(
            "--ring-height-mm",
            "is not above the spot's height, so the offset says nothing of the beam's tilt",
            "burn the ring from farther away (50 mm) than the spot (1-5 mm)",
        ));
    }
    Ok(())
}

fn report(
    ring: Ring,
    spot: Ring,
    options: &Options,
    channel: Channel,
    warnings: Vec<String>,
) -> Measured {
    let (ring, spot) = (ring.soft_by_itself(), spot.soft_by_itself());
    let offset: Vector2<f64> = spot.circle.center - ring.circle.center;
    let covariance: Matrix2<f64> = ring.center_covariance() + spot.center_covariance();
    let dof = ring.dof.min(spot.dof);
    let k = k95(dof);
    let (distance_mm, distance_u95_mm) = distance(offset, covariance, dof);
    let factor = match options.tolerance_kind {
        ToleranceKind::Distance => 1.0,
        ToleranceKind::Zone => 2.0,
    };
    let u = |i: usize| k * covariance[(i, i)].max(0.0).sqrt();
    let report = Report {
        ring: CircleReport::of(&ring),
        spot: CircleReport::of(&spot),
        offset_mm: offset.into(),
        offset_u95_mm: [u(0), u(1)],
        offset_cov_mm2: [
            [covariance[(0, 0)], covariance[(0, 1)]],
            [covariance[(1, 0)], covariance[(1, 1)]],
        ]
        .map(|row| row.map(|v| v * (k / K95).powi(2))),
        distance_mm,
        distance_u95_mm,
        zone_mm: 2.0 * distance_mm,
        tolerance_mm: options.tolerance_mm,
        tolerance_kind: options.tolerance_kind,
        verdict: Verdict::of(factor * distance_mm, factor * distance_u95_mm, options.tolerance_mm),
        correction: correction(offset, [u(0), u(1)], options),
        budget: {
            // Along the offset, which is the way that counts for the distance.
            let along = offset.try_normalize(0.0).unwrap_or_else(Vector2::x);
            let part = |c: Matrix2<f64>| k / K95 * along.dot(&(c * along)).max(0.0).sqrt();
            let (ring, spot) = (part(ring.center_covariance()), part(spot.center_covariance()));
            budget("distance_mm", [("edge of the ring", ring), ("edge of the spot", spot)])
        },
        channel,
        warnings,
    };
    Measured { report, ring, spot }
}

/// The turn of B and of the head that makes the next burn concentric. See the module's signs.
fn correction(offset: Vector2<f64>, u95: [f64; 2], options: &Options) -> Correction {
    let height = options.ring_height_mm - options.spot_height_mm;
    let slope = |d: f64| (1.0 / (1.0 + (d / height).powi(2)) / height).to_degrees();
    let shim = (offset.y / height).atan();
    Correction {
        b_deg: -(offset.x / height).atan().to_degrees(),
        b_u95_deg: u95[0] * slope(offset.x),
        shim_deg: shim.to_degrees(),
        shim_u95_deg: u95[1] * slope(offset.y),
        shim_mm: options.flange_mm.map(|l| l * shim.tan()),
    }
}
