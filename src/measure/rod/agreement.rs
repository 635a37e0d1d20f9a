//! How well the captures agree on one circle: edge points, places and form.

use nalgebra::Vector2;

use super::axis::Axis;
use super::joint::{Arc, Joint, Refined};
use super::report::LEAST_U_MM;
use super::{Capture, CaptureReport, EdgePoint, Options, Report};
use crate::error::{Error, Result};
use crate::fit::robust::scatter;

/// No check rod is out of round by this much: smooth arcs that miss their circle by more are edges of two circles.
pub(super) const DISAGREEMENT_MM: f64 = 0.01;
/// A turned rim wanders by less than this; edges of two circles taken together wander by more.
pub(super) const RAGGED_MM: f64 = 0.006;
/// No machine misplaces a rod's centre by this much: the centre is another edge's, where it is this many times what it may be.
const ASTRAY_MM: f64 = 0.03;
const FAR_ASTRAY: f64 = 4.0;
/// Machine positions that scatter by more than this are worth a word, where captures that are in place are this improbable.
const SCATTER_MM: f64 = 0.001;
const IN_PLACE: f64 = 0.01;
/// Part of a capture's edge points below which they may be those of another edge that crosses the rim.
const HARDLY_USED: f64 = 0.25;

/// Refuses captures whose edges lie on no common circle.
pub(super) fn check(
    refined: &Refined,
    points: &[EdgePoint],
    captures: &[CaptureReport],
    options: &Options,
) -> Result<()> {
    let misses = refined.misses_mm;
    let apart = misses > 5.0 * DISAGREEMENT_MM
        || misses > DISAGREEMENT_MM && misses > 4.0 * local_scatter(points);
    if !apart {
        return Ok(());
    }
    let size = |c: &&CaptureReport| c.residual_mean_mm.abs();
    let worst = captures.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
    let worst = worst.map_or_else(String::new, |c| {
        format!(", {} most, by {:.3} mm in the mean", c.image, c.residual_mean_mm.abs())
    });
    Err(Error::measure(
        "captures",
        format!("their edges do not lie on one circle: they miss it by {misses:.3} mm{worst}"),
        match options.diameter_mm {
            None => {
                "give --diameter-mm (some captures may show the chamfer's edge only), or check the positions"
            }
            Some(_) => {
                "check the positions and --diameter-mm, and the pictures: some may show another edge than the rim's"
            }
        },
    ))
}

/// Nothing of the nominal size is seen, and what is seen is no turned rim.
pub(super) fn none_near(nominal_mm: f64, found: &Report) -> Error {
    Error::measure(
        "captures",
        format!(
            "no rim of the nominal {nominal_mm} mm is seen on which they agree; what is seen, of {:.3} mm, wanders by {:.4} mm",
            found.diameter_mm, found.form_rms_mm
        ),
        "check the pictures and --diameter-mm, or leave it out",
    )
}

/// Refuses centres that do not turn with the table: an arc whose chamfer was taken for its rim lies on the rod's circle too, about
/// another centre. `excess` is by how much they miss what their uncertainties allow.
pub(super) fn turn_together(
    axis: &Axis,
    excess: f64,
    centers: &[Vector2<f64>],
    c_deg: &[f64],
    c_sense: f64,
) -> Result<()> {
    let misses = centers
        .iter()
        .zip(c_deg)
        .map(|(center, c_deg)| ((center - axis.center(*c_deg, c_sense)).norm(), c_deg));
    let worst = misses.max_by(|a, b| a.0.total_cmp(&b.0));
    match worst {
        Some((miss_mm, c_deg)) if miss_mm > ASTRAY_MM && excess > FAR_ASTRAY => {
            Err(Error::measure(
                "captures",
                format!(
                    "the rod's centres do not turn with the table: that at C = {c_deg}° misses their common circle most, by {miss_mm:.3} mm"
                ),
                "check x_mm, y_mm and c_deg (degrees, of the table), see in the pictures whether a chamfer's edge was taken for the rim \
                 (--diameter-mm may help), or leave this angle out",
            ))
        }
        _ => Ok(()),
    }
}

/// Says so where captures lie elsewhere than the machine says, or the rim is ragged.
pub(super) fn places_and_form(
    refined: &Refined,
    arcs: &[Arc],
    captures: &[CaptureReport],
    options: &Options,
    warnings: &mut Vec<String>,
) {
    for c in captures.iter().filter(|c| c.edge_points > 0 && c.arc_used < HARDLY_USED) {
        warnings.push(format!(
            "{}: only {:.0} % of its edge lies where the other captures put the rim: check the picture, its x_mm, y_mm and c_deg",
            c.image,
            100.0 * c.arc_used
        ));
    }
    if let Some(by) = refined.enlarged {
        warnings.push(format!(
            "the arcs bend as if the pictures were {:.2} % too {}: the rim may lie at another height than the calibration's plane, or beside \
             another edge; the diameter is that of the machine's places, not of the bend (`calib check` tells whether the calibration holds)",
            100.0 * by.abs(),
            if by > 0.0 { "large" } else { "small" }
        ));
    }
    let clipped = clipped(arcs, captures);
    let light = if clipped.is_some() { "clipped light, " } else { "" };
    let scatter_mm = refined.position_scatter_mm();
    if 1.0 - refined.fit.displaced < IN_PLACE && scatter_mm > SCATTER_MM {
        warnings.push(format!(
            "the captures disagree as if the machine's positions scattered by {scatter_mm:.4} mm (standard deviation): \
             {light}backlash, drift, an angle, the calibration or the lens may be the cause (`diagnose rod` tells which); the uncertainties \
             take it for chance"
        ));
    }
    warnings.extend(clipped);
    let form_mm = refined.form_mm;
    if form_mm > RAGGED_MM && options.diameter_mm.is_none() {
        warnings.push(format!(
            "the edges wander by {form_mm:.4} mm rms about the circle, more than a turned rim does: look at the \
             overlays whether the chamfer's edge was taken for the rim, or give --diameter-mm"
        ));
    }
}

/// A word on captures whose light is clipped beside some of the rim: there the edge seems to lie towards the darker side.
fn clipped(arcs: &[Arc], captures: &[CaptureReport]) -> Option<String> {
    /// Share of a capture's edge that its captures' names are told from on, and how many names.
    const LEAST: f64 = 0.1;
    const NAMED: usize = 4;
    let clipped = arcs.iter().filter(|arc| arc.points.clipped > LEAST);
    let images: Vec<&str> = clipped.map(|arc| captures[arc.capture].image.as_str()).collect();
    let more = match images.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let names = images.iter().take(NAMED).copied().collect::<Vec<_>>().join(", ");
    (!images.is_empty()).then(|| {
        format!("{names}{more}: light clips the picture beside the rim's edge: where that is is less sure; expose less")
    })
}

/// Every edge point against its common circle, and what that makes of the captures.
pub(super) fn residuals(
    captures: &[Capture],
    arcs: &[Arc],
    robust: &Joint,
    centers: &[Vector2<f64>],
    radius: f64,
) -> (Vec<EdgePoint>, Vec<CaptureReport>) {
    let mut points = Vec::new();
    let mut reports = Vec::new();
    for capture in captures {
        reports.push(CaptureReport {
            image: capture.image.clone(),
            x_mm: capture.position_mm.x,
            y_mm: capture.position_mm.y,
            c_deg: capture.c_deg,
            edge_points: 0,
            arc_used: 0.0,
            residual_mean_mm: 0.0,
            residual_rms_mm: 0.0,
        });
    }
    for (k, arc) in arcs.iter().enumerate() {
        let (mut n, mut sum, mut squares) = (0usize, 0.0, 0.0);
        let left_out = robust.weights[k].iter().all(|w| *w == 0.0);
        for i in 0..arc.points.place_mm.len() {
            let residual_mm = (arc.machine(i) - centers[arc.angle]).norm() - radius;
            let used = robust.weights[k][i] > 0.0;
            if used || left_out && arc.points.usable[i] {
                n += 1;
                sum += residual_mm;
                squares += residual_mm * residual_mm;
            }
            points.push(EdgePoint {
                capture: arc.capture,
                pixel: arc.points.place_px[i],
                residual_mm,
                used,
            });
        }
        let count = n.max(1) as f64;
        let report: &mut CaptureReport = &mut reports[arc.capture];
        report.edge_points = if left_out { 0 } else { n };
        report.arc_used = report.edge_points as f64 / arc.points.place_mm.len().max(1) as f64;
        report.residual_mean_mm = sum / count;
        report.residual_rms_mm = (squares / count).sqrt();
    }
    (points, reports)
}

/// Scatter of neighbouring edge points about each other: the edge's own, whatever circle it is held against.
fn local_scatter(points: &[EdgePoint]) -> f64 {
    let mut steps: Vec<f64> = points
        .windows(2)
        .filter(|w| w[0].used && w[1].used && w[0].capture == w[1].capture)
        .map(|w| (w[1].residual_mm - w[0].residual_mm).abs())
        .collect();
    if steps.is_empty() {
        return 0.0;
    }
    scatter(&mut steps) / 2.0f64.sqrt()
}

/// Sectors of the rim.
const SECTORS: usize = 72;

/// Which sectors some arcs show: those that are turned back by an angle, degrees.
fn sectors(
    arcs: &[Arc],
    robust: &Joint,
    turned_deg: impl Fn(&Arc) -> Option<f64>,
) -> [bool; SECTORS] {
    let mut seen = [false; SECTORS];
    for (arc, weights) in arcs.iter().zip(&robust.weights) {
        let Some(deg) = turned_deg(arc) else { continue };
        for i in (0..weights.len()).filter(|i| weights[*i] > 0.0) {
            let q = arc.machine(i) - robust.centers[arc.angle];
            let turn = (q.y.atan2(q.x) / std::f64::consts::TAU - deg / 360.0).rem_euclid(1.0);
            seen[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] = true;
        }
    }
    seen
}

/// At how many more table angles what one shows of the rim is seen: its form is the same there and does not average out.
pub(super) fn seen_again(arcs: &[Arc], robust: &Joint, c_deg: &[f64], c_sense: f64) -> f64 {
    let mut times = [0u32; SECTORS];
    for (angle, c_deg) in c_deg.iter().enumerate() {
        let own = |arc: &Arc| (arc.angle == angle).then_some(c_sense * c_deg);
        let seen = sectors(arcs, robust, own);
        times.iter_mut().zip(seen).for_each(|(times, seen)| *times += u32::from(seen));
    }
    let all: u32 = times.iter().sum();
    let again: u32 = times.iter().map(|times| times * times.saturating_sub(1)).sum();
    f64::from(again) / f64::from(all.max(1))
}

/// Says so where the arcs seen from one table angle cover too little of the rim for a free radius.
pub(super) fn arcs_seen(
    arcs: &[Arc],
    robust: &Joint,
    options: &Options,
    warnings: &mut Vec<String>,
) {
    let seen = sectors(arcs, robust, |_| Some(0.0));
    let twice: Vec<bool> = seen.iter().chain(&seen).copied().collect();
    let gap = twice.split(|s| *s).map(<[bool]>::len).max().unwrap_or(0).min(SECTORS) as f64 * 360.0
        / SECTORS as f64;
    if gap > 240.0 && options.diameter_mm.is_none() {
        warnings.push(format!(
            "the arcs span {:.0}° of the rim: on a short arc a free radius costs much accuracy; give --diameter-mm, with --diameter-u-mm where a certificate says it better than to 0.02 mm, or more captures",
            360.0 - gap
        ));
    }
}

/// Says so where an edge farther out may be the rim: it may not where what was measured is just as large as it should be.
pub(super) fn fainter_rim(fainter_mm: Option<f64>, options: &Options, report: &mut Report) {
    let Some(radius_mm) = fainter_mm else { return };
    let outer_mm = 2.0 * radius_mm;
    let off_mm = options.diameter_mm.map(|nominal_mm| (report.diameter_mm - nominal_mm).abs());
    if off_mm.is_some_and(|off_mm| off_mm < 0.5 * options.diameter_u_mm.max(LEAST_U_MM)) {
        return;
    }
    report.warnings.push(match options.diameter_mm {
        None => format!(
            "some captures show a fainter edge farther out, near diameter {outer_mm:.2} mm: if that is the rod's rim, give --diameter-mm"
        ),
        Some(nominal_mm) => format!(
            "the edge nearest to {nominal_mm} mm was taken; there is a clear one outside it, near diameter {outer_mm:.2} mm: if that is \
             the rod's rim, the nominal diameter is a chamfer's"
        ),
    });
}

/// Says so where the rim is faint beside an edge inside it, and no nominal diameter tells which of them is the rod's.
pub(super) fn stronger_edge(
    stronger_mm: Option<f64>,
    options: &Options,
    warnings: &mut Vec<String>,
) {
    if let (Some(radius_mm), None) = (stronger_mm, options.diameter_mm) {
        warnings.push(format!(
            "the rim is faint beside an edge inside it, at diameter {:.2} mm: that may be its chamfer's, or this one a reflection on the \
             table; --diameter-mm tells which is meant",
            2.0 * radius_mm
        ));
    }
}
