//! Circles of expected diameters in one picture, and how concentric they are.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::camera::{Calibration, View};
use crate::error::{Error, Result, above_zero};
use crate::find;
use crate::fit::Circle;
use crate::frame::{Channel, Frame, Picture};
use crate::measure::plane_errors::PlaneErrors;
use crate::measure::ring::{self, Ring};
use crate::measure::{CircleReport, best_channel, expected, round};
use crate::uncertainty::distance;

/// What is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// Expected diameters, in the order in which they are reported.
    pub expect_mm: Vec<f64>,
    /// Which part of a colour picture is measured.
    #[serde(default)]
    pub channel: Channel,
}

/// One expected circle.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Expected {
    /// The diameter that was asked for.
    pub expect_mm: f64,
    /// What was measured.
    #[serde(flatten)]
    pub circle: CircleReport,
}

/// How concentric two of the circles are.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Pair {
    /// Index of the first circle in the order asked.
    pub a: usize,
    /// Index of the second.
    pub b: usize,
    /// Centre of b minus centre of a.
    pub offset_mm: [f64; 2],
    /// Length of the offset.
    pub distance_mm: f64,
    /// Half-width of its 95 % interval.
    pub distance_u95_mm: f64,
    /// ISO 1101 concentricity zone: twice the distance.
    pub zone_mm: f64,
    /// Half-width of its 95 % interval.
    pub zone_u95_mm: f64,
}

/// The circles of one picture.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// In the order asked.
    pub circles: Vec<Expected>,
    /// Every pair of them.
    pub pairs: Vec<Pair>,
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
    /// The circles with their edge points.
    pub rings: Vec<Ring>,
}

/// Measures the expected circles in a picture; `subject` names it in messages.
pub fn measure(
    picture: &Picture,
    calibration: &Calibration,
    options: &Options,
    subject: &str,
) -> Result<Measured> {
    check(options)?;
    let (width, height) = picture.size();
    let view = calibration.view_of(subject, width, height)?;
    let attempt = |channel| {
        let frame = calibration.light_in(picture, channel);
        in_frame(&frame, &view, options, channel, subject)
    };
    // The circle whose centre is known worst.
    let spread = |m: &Measured| {
        let each = m.report.circles.iter().map(|c| c.circle.center_u95_mm);
        each.map(|u| u[0].hypot(u[1])).fold(0.0, f64::max)
    };
    let mut measured =
        best_channel(picture, options.channel, subject, attempt, |_, _| false, spread)?;
    measured.report.warnings.extend(picture.doubts());
    Ok(measured)
}

/// Refuses options that cannot be meant.
pub fn check(options: &Options) -> Result<()> {
    if options.expect_mm.is_empty() {
        return Err(Error::option(
            "--expect-mm",
            "is missing",
            "give the diameter of each circle in mm",
        ));
    }
    for (i, d) in options.expect_mm.iter().enumerate() {
        above_zero("--expect-mm", *d, "give a diameter in mm")?;
        if options.expect_mm[..i].contains(d) {
            return Err(Error::option(
                "--expect-mm",
                format!("{d} is given twice"),
                "give each circle's diameter once: the clearest circle of that size is measured",
            ));
        }
    }
    Ok(())
}

fn in_frame(
    frame: &Frame,
    view: &View,
    options: &Options,
    channel: Channel,
    subject: &str,
) -> Result<Measured> {
    let look = find::look(frame);
    let mut rings = Vec::new();
    let mut circles = Vec::new();
    let mut planes = Vec::new();
    let mut warnings = Vec::new();
    for &expect_mm in &options.expect_mm {
        let radius_px = expected_radius_px(expect_mm, view)?;
        let seen = expected::measure(frame, view, &look, expect_mm).ok_or_else(|| {
            Error::measure(
                subject,
                format!(
                    "shows no circle of about {expect_mm} mm diameter ({radius_px:.0} px radius){}",
                    clearest(&look, view)
                ),
                "check the picture, the expected diameter and the calibration's scale",
            )
        })?;
        let ring = seen.ring;
        // One edge is no two circles, and would be perfectly concentric with itself.
        let apart = |other: &Ring| other.circle.apart(&ring.circle);
        if let Some(twice) = rings.iter().position(|r| apart(r) < view.pixel_mm()) {
            return Err(Error::measure(
                subject,
                format!(
                    "shows one circle only, of {:.4} mm diameter, where {} and {expect_mm} mm are expected",
                    2.0 * ring.circle.radius,
                    options.expect_mm[twice]
                ),
                "check the expected diameters and the calibration's scale",
            ));
        }
        warnings.extend(doubts(expect_mm, &ring, &seen.alike));
        let plane = PlaneErrors::of(view, &ring);
        circles.push(Expected { expect_mm, circle: CircleReport::of(&ring, &plane) });
        planes.push(plane);
        rings.push(ring);
    }
    let pairs = pairs(&rings, &planes);
    Ok(Measured { report: Report { circles, pairs, channel, warnings }, rings })
}

/// The radius of an expected circle in the picture; refused where it is a dot or far larger than the frame.
fn expected_radius_px(expect_mm: f64, view: &View) -> Result<f64> {
    let radius_px = 0.5 * expect_mm / view.pixel_mm();
    let trouble = if radius_px < 4.0 {
        format!("{expect_mm} mm is only {:.1} px across with this calibration", 2.0 * radius_px)
    } else if radius_px > 4.0 * view.width_px().max(view.height_px()) as f64 {
        format!(
            "{expect_mm} mm is {:.0} px across with this calibration, far more than the frame",
            2.0 * radius_px
        )
    } else {
        return Ok(radius_px);
    };
    Err(Error::option("--expect-mm", trouble, "check the unit (mm) and the calibration's scale"))
}

/// What a user should know of a circle that was found, and of those as large that were not taken.
fn doubts(expect_mm: f64, ring: &Ring, alike: &[Vector2<f64>]) -> Vec<String> {
    let mut doubts = Vec::new();
    if !alike.is_empty() {
        let places = alike.iter().map(|p| format!("({:.2}, {:.2}) mm", p.x, p.y));
        doubts.push(format!(
            "{} circles of about {expect_mm} mm are seen: this is the one at ({:.2}, {:.2}) mm, the others are at {}",
            alike.len() + 1,
            ring.circle.center.x,
            ring.circle.center.y,
            places.collect::<Vec<_>>().join(", ")
        ));
    }
    let found_mm = 2.0 * ring.circle.radius;
    if (found_mm / expect_mm - 1.0).abs() > expected::FAR {
        doubts.push(format!(
            "the circle found measures {found_mm:.4} mm where {expect_mm} mm was expected: is it the one that is meant?"
        ));
    }
    if ring.arc_coverage < 0.5 {
        doubts.push(format!(
            "only {:.0} % of the {expect_mm} mm circle's edge was found",
            100.0 * ring.arc_coverage
        ));
    }
    if !round::is_regular(ring) {
        doubts.push(format!(
            "the {expect_mm} mm circle's edge wanders by {:.4} mm rms: check that it is round",
            ring.form_rms_mm
        ));
    }
    if let Some(other_mm) = ring.other_mm {
        doubts.push(format!(
            "light from one side shows only a part of the {expect_mm} mm circle's edge, and elsewhere another one of {other_mm:.2} mm: a chamfer? Even light shows both all round"
        ));
    }
    doubts.extend(ring.clip_warning(&format!("{expect_mm} mm circle")));
    doubts
}

/// The clearest circles of a picture, for one who finds that his is not among them.
fn clearest(look: &find::Look, view: &View) -> String {
    /// How many are named, and what a clear one's score is at least.
    const MOST: usize = 3;
    const CLEAR: f64 = 2.0;
    let side = view.width_px().max(view.height_px()) as f64;
    let options = find::Options {
        least_radius_px: 0.01 * side,
        most_radius_px: 0.6 * side,
        near: None,
        least_coverage: round::WHOLE,
        centers: 8,
        known: &[],
    };
    let clear = find::circles(look, options).into_iter().filter(|c| {
        c.score > CLEAR && find::stands_out(look, c, find::Sides::Edge, &[]) != Some(false)
    });
    let named: Vec<String> = clear
        .take(MOST)
        .map(|c| {
            let Circle { center: at, radius } = ring::in_plane(view, c.circle);
            format!("{:.3} mm at ({:.2}, {:.2}) mm", 2.0 * radius, at.x, at.y)
        })
        .collect();
    if named.is_empty() {
        return String::new();
    }
    format!("; clear ones are about {}", named.join(", "))
}

fn pairs(rings: &[Ring], planes: &[PlaneErrors]) -> Vec<Pair> {
    let mut list = Vec::new();
    for b in 1..rings.len() {
        for a in 0..b {
            let offset: Vector2<f64> = rings[b].circle.center - rings[a].circle.center;
            let dof = rings[a].dof.min(rings[b].dof);
            let plane = planes[b].seen_from(&planes[a]).center_covariance(dof);
            let covariance = rings[a].center_covariance() + rings[b].center_covariance() + plane;
            let (distance_mm, distance_u95_mm) = distance(offset, covariance, dof);
            list.push(Pair {
                a,
                b,
                offset_mm: offset.into(),
                distance_mm,
                distance_u95_mm,
                zone_mm: 2.0 * distance_mm,
                zone_u95_mm: 2.0 * distance_u95_mm,
            });
        }
    }
    list
}
