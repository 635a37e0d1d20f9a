//! The burn test: is the 100 W spot concentric with the 500 W ring, and how far are B and the shims off?

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use crate::camera::{Calibration, View};
use crate::error::{Error, Result, above_zero};
use crate::frame::{Channel, Picture};
use crate::measure::dirt;
use crate::measure::marks;
use crate::measure::offset::Offset;
use crate::measure::plane_errors::PlaneErrors;
use crate::measure::ring::Ring;
use crate::measure::{CircleReport, best_channel};
use crate::uncertainty::{Contribution, K95, budget, k95};
use crate::units;

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

/// The burn test's result.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// The ring: the outer edge of the burnt disc or annulus.
    pub ring: CircleReport,
    /// The spot.
    pub spot: CircleReport,
    /// Spot minus ring, and what it means.
    #[serde(flatten)]
    pub offset: Offset,
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
        let (ring, spot, warnings) = marks::measure(
            &calibration.light_in(picture, channel),
            &view,
            options.near_mm,
            subject,
        )?;
        Ok(report(ring, spot, &view, options, channel, warnings))
    };
    let spread = |m: &Measured| {
        let [x, y] = m.report.offset.offset_u95_mm;
        x.hypot(y)
    };
    let mut measured = best_channel(picture, options.channel, subject, attempt, refutes, spread)?;
    if picture.is_colour() {
        let word = measured.report.channel.word();
        measured.report.warnings.push(format!("colour picture: measured in its {word} channel"));
    }
    measured.report.warnings.extend(picture.doubts());
    Ok(measured)
}

/// Whether a channel that shows the ring far clearer has it elsewhere: the other one has taken a heat tint for it. So it has where
/// its spot may be dirt and the other's is none.
fn refutes(clear: &Measured, other: &Measured) -> bool {
    /// Contrast of the ring as a part of the clearer one's.
    const FAINTER: f64 = 0.7;
    let apart = |a: f64, b: f64, a_u95: f64, b_u95: f64| (a - b).abs() > a_u95.hypot(b_u95);
    let (a, b) = (&clear.report.ring, &other.report.ring);
    let elsewhere = (0..2).any(|i| {
        let u95 = |c: &CircleReport| c.center_u95_mm[i];
        apart(a.center_mm[i], b.center_mm[i], u95(a), u95(b))
    });
    let is_dot = |m: &Measured| marks::is_dot(&m.ring, &m.spot);
    if is_dot(other) && !is_dot(clear) || dirt::is_within(&other.spot.circle, &clear.spot.circle) {
        return true;
    }
    other.ring.contrast.abs() < FAINTER * clear.ring.contrast.abs()
        && (elsewhere || apart(a.diameter_mm, b.diameter_mm, a.diameter_u95_mm, b.diameter_u95_mm))
}

/// Checks the options; the same for every picture.
pub fn check(options: &Options) -> Result<()> {
    let positive = |name, v| above_zero(name, v, "give a length in mm");
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

/// What of the options looks like another unit.
pub fn doubts(options: &Options) -> impl Iterator<Item = String> {
    let heights = [
        units::height("--ring-height-mm", options.ring_height_mm),
        units::height("--spot-height-mm", options.spot_height_mm),
        units::limit("--tolerance-mm", options.tolerance_mm),
    ];
    heights.into_iter().flatten()
}

fn report(
    ring: Ring,
    spot: Ring,
    view: &View,
    options: &Options,
    channel: Channel,
    warnings: Vec<String>,
) -> Measured {
    let (ring, spot) = (ring.soft_by_itself(), spot.soft_by_itself());
    let apart: Vector2<f64> = spot.circle.center - ring.circle.center;
    let dof = ring.dof.min(spot.dof);
    let planes = [&ring, &spot].map(|circle| PlaneErrors::of(view, circle));
    let plane = planes[1].seen_from(&planes[0]).center_covariance(dof);
    let covariance: Matrix2<f64> = ring.center_covariance() + spot.center_covariance() + plane;
    let report = Report {
        ring: CircleReport::of_mark(&ring, &planes[0]),
        spot: CircleReport::of_mark(&spot, &planes[1]),
        offset: Offset::judge(apart, covariance, plane, dof, options),
        budget: {
            // Along the offset, which is the way that counts for the distance.
            let along = apart.try_normalize(0.0).unwrap_or_else(Vector2::x);
            let part = |c: Matrix2<f64>| k95(dof) / K95 * along.dot(&(c * along)).max(0.0).sqrt();
            let parts = [
                ("edge of the ring", part(ring.center_covariance())),
                ("edge of the spot", part(spot.center_covariance())),
                ("calibration", part(plane)),
            ];
            budget("distance_mm", parts)
        },
        channel,
        warnings,
    };
    Measured { report, ring, spot }
}
