//! The burn test: is the 100 W spot concentric with the 500 W ring, and how far are B and the shims off?
//!
//! Signs (`docs/conventions.md`): the beam leaves the nozzle along `Ry(B)·(0, 0, -1)`, so a B that stands too far by β moves
//! a mark burnt from height h by `-h tan β` in X; the spot, burnt from nearer, lies `+H tan β` from the ring (`H` the
//! difference of the heights). The correction turns B by `-β`. In Y a head turned by α about X moves the marks
//! by `+h tan α`: the offset is `-H tan α`, and the shims have to turn the head by `-α`.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::find::{self, Candidate};
use crate::frame::{Channel, Frame, Picture};
use crate::measure::circles::measure_candidate;
use crate::measure::ring::{self, Ring, Search};
use crate::measure::{CircleReport, best_channel};
use crate::uncertainty::{K95, Verdict, distance, k95};

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
    let view = calibration.view(width, height)?;
    let attempt = |channel: Channel| {
        let (ring, spot, warnings) = marks(&picture.frame(channel), &view, options, subject)?;
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

fn marks(
    frame: &Frame,
    view: &View,
    options: &Options,
    subject: &str,
) -> Result<(Ring, Ring, Vec<String>)> {
    let look = find::look(frame);
    let side = frame.width().max(frame.height()) as f64;
    let near = options.near_mm.map(|p| (view.to_pixel(Vector2::from(p)), 0.1 * side));
    let all = find::circles(
        &look,
        find::Options {
            least_radius_px: 0.02 * side,
            most_radius_px: 0.6 * side,
            near,
            least_coverage: 0.35,
            centers: 8,
        },
    );
    let steady: Vec<Candidate> = all.into_iter().filter(is_steady).collect();
    let rings = ring_candidates(&steady, 0.06 * side);
    let mut warnings = Vec::new();
    let mut no_spot = false;
    for outer in rings.iter().take(4) {
        let inside = find::circles(
            &look,
            find::Options {
                least_radius_px: (0.05 * outer.circle.radius).max(4.0),
                most_radius_px: 0.45 * outer.circle.radius,
                near: Some((outer.circle.center, 0.7 * outer.circle.radius)),
                least_coverage: 0.55,
                centers: 6,
            },
        );
        let spots: Vec<Candidate> = inside
            .into_iter()
            .filter(|c| {
                is_steady(c)
                    && (c.circle.center - outer.circle.center).norm() + 0.5 * c.circle.radius
                        < 0.95 * outer.circle.radius
            })
            .collect();
        let Some(spot) = best_spot(&spots) else {
            no_spot = true;
            continue;
        };
        if options.near_mm.is_none()
            && let Some(other) = second_burn(&rings, outer)
        {
            return Err(Error::measure(
                subject,
                format!(
                    "shows two test burns, near pixel ({:.0}, {:.0}) and ({:.0}, {:.0})",
                    outer.circle.center.x,
                    outer.circle.center.y,
                    other.circle.center.x,
                    other.circle.center.y
                ),
                "say which one with --near-mm X,Y (plane mm), or crop the picture",
            ));
        }
        let Some((ring, spot)) = measure_pair(frame, view, outer, &spot, &steady) else { continue };
        if ring.arc_coverage < 0.6 {
            warnings.push(format!(
                "only {:.0} % of the ring's edge was found",
                100.0 * ring.arc_coverage
            ));
        }
        return Ok((ring, spot, warnings));
    }
    if no_spot {
        return Err(Error::measure(
            subject,
            "a ring was found, but no spot inside it",
            "burn the spot (100 W from 1-5 mm) and photograph again, or light it so that it shows",
        ));
    }
    Err(Error::measure(
        subject,
        "no ring was found",
        "check that the whole ring is in the picture, in focus and darker or brighter than the plate",
    ))
}

/// Whether a candidate's edge runs along its circle rather than wandering about it.
fn is_steady(c: &Candidate) -> bool {
    c.scatter_px < 0.035 * c.circle.radius + 4.0 && c.step.abs() > 0.0
}

/// Likely rings, best first: strong, well covered, large; of concentric edges the outermost strong one.
fn ring_candidates(all: &[Candidate], least_radius_px: f64) -> Vec<Candidate> {
    let rank =
        |c: &Candidate| c.score * c.coverage * c.circle.radius.sqrt() / (1.0 + 0.1 * c.scatter_px);
    let mut list: Vec<Candidate> =
        all.iter().filter(|c| c.circle.radius > least_radius_px).copied().collect();
    list.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
    let mut rings: Vec<Candidate> = Vec::new();
    for c in list.iter().take(8) {
        // A halo is much fainter than the ring it surrounds.
        let outermost = all
            .iter()
            .filter(|o| {
                concentric(o, c)
                    && o.circle.radius >= c.circle.radius
                    && o.step.abs() > 0.4 * c.step.abs()
                    && o.coverage > 0.6 * c.coverage
                    && o.scatter_px < 2.0 * c.scatter_px + 3.0
            })
            .max_by(|a, b| a.circle.radius.total_cmp(&b.circle.radius))
            .unwrap_or(c);
        let known = |r: &Candidate| {
            concentric(r, outermost)
                && (r.circle.radius / outermost.circle.radius - 1.0).abs() < 0.05
        };
        if !rings.iter().any(known) {
            rings.push(*outermost);
        }
    }
    rings
}

fn concentric(a: &Candidate, b: &Candidate) -> bool {
    (a.circle.center - b.circle.center).norm() < 0.12 * a.circle.radius.max(b.circle.radius)
}

/// The spot among the circles inside the ring: the strongest; of nested edges the outermost of similar strength.
fn best_spot(spots: &[Candidate]) -> Option<Candidate> {
    let best = spots.iter().max_by(|a, b| {
        let rank = |c: &Candidate| c.score * c.step.abs().sqrt() * c.coverage;
        rank(a).total_cmp(&rank(b))
    })?;
    Some(*best)
}

/// Another ring beside this one of nearly the same standing.
fn second_burn<'a>(rings: &'a [Candidate], first: &Candidate) -> Option<&'a Candidate> {
    rings.iter().find(|r| {
        let apart = (r.circle.center - first.circle.center).norm();
        apart > 0.9 * (r.circle.radius + first.circle.radius)
            && (0.6..1.7).contains(&(r.circle.radius / first.circle.radius))
            && r.score > 0.6 * first.score
            && r.coverage > 0.8
            && r.scatter_px < 2.0 * first.scatter_px + 2.0
    })
}

fn measure_pair(
    frame: &Frame,
    view: &View,
    outer: &Candidate,
    spot: &Candidate,
    all: &[Candidate],
) -> Option<(Ring, Ring)> {
    let mut edges: Vec<Candidate> = all.iter().filter(|c| concentric(c, outer)).copied().collect();
    edges.push(*spot);
    let ring = measure_candidate(frame, view, outer, &edges);
    let ring = ring?;
    // The spot's band ends where the ring's next edge begins.
    let reach = edges
        .iter()
        .filter(|c| c.circle.radius > 1.5 * spot.circle.radius)
        .map(|c| {
            c.circle.radius - (c.circle.center - spot.circle.center).norm() - 2.5 * c.softness_px
        })
        .fold(f64::INFINITY, f64::min);
    let c = spot.circle;
    let rough = crate::fit::Circle {
        center: view.to_plane(c.center),
        radius: c.radius * view.mm_per_px(c.center).determinant().abs().sqrt(),
    };
    let search = Search {
        reach_px: (3.0 * spot.scatter_px).clamp(3.0, 0.3 * c.radius + 3.0),
        inside_limit_px: 0.95 * c.radius,
        outside_limit_px: (reach - c.radius).clamp(0.4 * c.radius + 4.0, 4.0 * c.radius),
        softness_px: spot.softness_px.max(1.5),
    };
    let spot = ring::measure(frame, view, rough, search, Some(&ring.wander));
    let spot = spot?;
    let plausible = spot.circle.radius < 0.6 * ring.circle.radius
        && (spot.circle.center - ring.circle.center).norm() < ring.circle.radius
        && (spot.circle.radius / rough.radius - 1.0).abs() < 0.5;
    plausible.then_some((ring, spot))
}

fn report(
    ring: Ring,
    spot: Ring,
    options: &Options,
    channel: Channel,
    warnings: Vec<String>,
) -> Measured {
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
