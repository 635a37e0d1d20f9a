//! Circles of expected diameters in one picture, and how concentric they are.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::find::{self, Candidate, ITSELF, Sides};
use crate::fit::Circle;
use crate::frame::{Channel, Frame, Picture};
use crate::measure::ring::{self, Ring, Search};
use crate::measure::{CircleReport, best_channel};
use crate::uncertainty::distance;

/// A circle is looked for within this share of its expected diameter.
const DIAMETER_WINDOW: f64 = 0.12;
/// Candidates that are tried: the edges of an annulus gather into several of a spot's size.
const TRIES: usize = 8;

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
        let frame = calibration.linear(picture.frame(channel));
        in_frame(&frame, &view, options, channel, subject)
    };
    // The circle whose centre is known worst.
    let spread = |m: &Measured| {
        let each = m.report.circles.iter().map(|c| c.circle.center_u95_mm);
        each.map(|u| u[0].hypot(u[1])).fold(0.0, f64::max)
    };
    best_channel(picture, options.channel, subject, attempt, spread)
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
    for d in &options.expect_mm {
        if !(d.is_finite() && *d > 0.0) {
            return Err(Error::option(
                "--expect-mm",
                format!("{d} is not a diameter"),
                "give a positive number in mm",
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
    let mut warnings = Vec::new();
    for &expect_mm in &options.expect_mm {
        let radius_px = 0.5 * expect_mm / view.pixel_mm();
        if radius_px < 4.0 {
            return Err(Error::option(
                "--expect-mm",
                format!(
                    "{expect_mm} mm is only {:.1} px across with this calibration",
                    2.0 * radius_px
                ),
                "check the unit (mm) and the calibration's scale",
            ));
        }
        if radius_px > 4.0 * view.width_px().max(view.height_px()) as f64 {
            return Err(Error::option(
                "--expect-mm",
                format!(
                    "{expect_mm} mm is {:.0} px across with this calibration, far more than the frame",
                    2.0 * radius_px
                ),
                "check the unit (mm) and the calibration's scale",
            ));
        }
        let candidates = find::circles(
            &look,
            find::Options {
                least_radius_px: radius_px * (1.0 - DIAMETER_WINDOW),
                most_radius_px: radius_px * (1.0 + DIAMETER_WINDOW),
                near: None,
                least_coverage: 0.25,
                centers: 8,
                known: &[],
            },
        );
        let mut ragged: Option<Ring> = None;
        let ring = pick(&candidates, radius_px)
            .into_iter()
            .take(TRIES)
            .find_map(|c| {
                let ring = measure_candidate(frame, view, &c, &candidates)?;
                let off = (2.0 * ring.circle.radius / expect_mm - 1.0).abs();
                if off > DIAMETER_WINDOW {
                    return None;
                }
                let faint = ring.contrast.abs() < FAINT * ring.noise;
                if form(&ring) < REGULAR && !faint {
                    return Some(ring);
                }
                let others: Vec<Circle> =
                    candidates.iter().filter(|o| rivals(o, &c)).map(|o| o.circle).collect();
                if find::stands_out(&look, &c, Sides::Edge, &others) == Some(false) {
                    return None;
                }
                if form(&ring) < if faint { REGULAR } else { RAGGED } {
                    return Some(ring);
                }
                let best = ragged.as_ref().map_or(MOST_RAGGED, form);
                if form(&ring) < best && !faint && ring.arc_coverage > WHOLE {
                    ragged = Some(ring);
                }
                None
            })
            .or(ragged)
            .map(Ring::perhaps_soft)
            .ok_or_else(|| {
                Error::measure(
                    subject,
                    format!("shows no circle of about {expect_mm} mm diameter ({radius_px:.0} px radius)"),
                    "check the picture, the expected diameter and the calibration's scale",
                )
            })?;
        if ring.arc_coverage < 0.5 {
            warnings.push(format!(
                "only {:.0} % of the {expect_mm} mm circle's edge was found",
                100.0 * ring.arc_coverage
            ));
        }
        circles.push(Expected { expect_mm, circle: CircleReport::of(&ring) });
        rings.push(ring);
    }
    let pairs = pairs(&rings);
    Ok(Measured { report: Report { circles, pairs, channel, warnings }, rings })
}

/// Contrast over a pixel's noise below which texture may look like a circle's edge: it must be regular and stand out.
const FAINT: f64 = 2.0;
/// Form over radius below which nothing but a circle's edge stays; anything else must stand out from the surface.
const REGULAR: f64 = 0.015;
/// Form over radius above which an edge may be background gathered into a circle, which wanders and has gaps ...
const RAGGED: f64 = 0.03;
/// ... and above which it is no circle's, whole as it may seem.
const MOST_RAGGED: f64 = 0.08;
/// Share of its circumference that the edge of a poor part shows.
const WHOLE: f64 = 0.85;

/// Whether another circle is about as strong, and not the same one seen twice.
fn rivals(other: &Candidate, c: &Candidate) -> bool {
    let apart = (other.circle.center - c.circle.center).norm() / c.circle.radius;
    let larger = other.circle.radius / c.circle.radius - 1.0;
    other.score > 0.3 * c.score && apart.max(larger.abs()) > 0.1
}

/// Root mean square of a circle's form over its radius.
fn form(ring: &Ring) -> f64 {
    ring.form_rms_mm / ring.circle.radius
}

/// Candidates in the order in which they are tried: strong ones near the expected radius first.
fn pick(candidates: &[Candidate], radius_px: f64) -> Vec<Candidate> {
    let mut list = candidates.to_vec();
    let rank =
        |c: &Candidate| c.score / (1.0 + ((c.circle.radius / radius_px - 1.0) / 0.05).powi(2));
    list.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
    list
}

/// Measures a circle that was found, keeping clear of its concentric neighbours.
pub(crate) fn measure_candidate(
    frame: &Frame,
    view: &View,
    candidate: &Candidate,
    others: &[Candidate],
) -> Option<Ring> {
    let (rough, search) = around(view, candidate, others);
    ring::measure(frame, view, rough, search, None)
}

/// The plane's circle and where its edge is to be looked for, clear of concentric neighbours.
pub(crate) fn around(view: &View, candidate: &Candidate, others: &[Candidate]) -> (Circle, Search) {
    let c = candidate.circle;
    let center = view.to_plane(c.center);
    let radius = c.radius * view.mm_per_px(c.center).determinant().abs().sqrt();
    let (mut inside, mut outside) = (0.9 * c.radius, 0.9 * c.radius);
    for o in others {
        let apart = o.circle.radius - c.radius;
        let off = (o.circle.center - c.center).norm();
        // A neighbour is as concentric as both are steady; what is not is no edge of this part.
        let concentric = off < 0.02 * c.radius + 2.0 + candidate.scatter_px.min(0.05 * c.radius);
        // Within an edge's own softness there is no other.
        let itself = o.step * candidate.step > 0.0 && apart.abs() < ITSELF * candidate.softness_px;
        if concentric && !itself && apart.abs() > 3.0 + off && o.score > 0.15 * candidate.score {
            let half = (0.6 * apart.abs() - off).max(3.0);
            if apart < 0.0 {
                inside = inside.min(half);
            } else {
                outside = outside.min(half);
            }
        }
    }
    let search = Search {
        reach_px: (3.0 * candidate.scatter_px).clamp(3.0, 0.2 * c.radius + 4.0),
        inside_limit_px: inside,
        outside_limit_px: outside,
        softness_px: candidate.softness_px.max(1.0),
    };
    (Circle { center, radius }, search)
}

fn pairs(rings: &[Ring]) -> Vec<Pair> {
    let mut list = Vec::new();
    for b in 1..rings.len() {
        for a in 0..b {
            let offset: Vector2<f64> = rings[b].circle.center - rings[a].circle.center;
            let covariance = rings[a].center_covariance() + rings[b].center_covariance();
            let (distance_mm, distance_u95_mm) =
                distance(offset, covariance, rings[a].dof.min(rings[b].dof));
            list.push(Pair {
                a,
                b,
                offset_mm: offset.into(),
                distance_mm,
                distance_u95_mm,
                zone_mm: 2.0 * distance_mm,
            });
        }
    }
    list
}
