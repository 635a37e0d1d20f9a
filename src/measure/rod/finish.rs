//! From a rim's edge in all captures to the report: corrections, uncertainty, checks and the axis.

use nalgebra::{DMatrix, Vector2};

use super::axis::{self, Axis, Known};
use super::follow::Followed;
use super::joint::{self, Arc, Joint, Refined};
use super::light::Shift;
use super::seen::Seen;
use super::turned::turned_mm;
use super::{Capture, Measured, Options, Report, RodCenter, agreement, budget};
use crate::error::{Error, Result};
use crate::fit::Circle;
use crate::fit::correlated::{Fit, groups};
use crate::measure::points::Points;
use crate::uncertainty::{self, k95};

/// How far turning lines move the rim to one side, as a part of how far they may move it all round: they are cut about a spindle's
/// centre, a few hundredths of their pitch beside the rod's.
const LINES_OFF_CENTRE: f64 = 0.1;

/// What a single table angle leaves open.
pub(super) const ONE_ANGLE: &str =
    "one table angle only: the centre is the rod's, and its eccentricity to the C axis is in it";

/// The answer from a rim's edge in all captures.
pub(super) fn finish(
    captures: &[Capture],
    options: &Options,
    Seen { followed, c_deg, angle_of }: &Seen,
) -> Result<Measured> {
    let angles = c_deg.len();
    let Followed { arcs, robust, shift, .. } = followed;
    let refined = refine(followed, angles, options)?;
    let fit = &refined.fit;
    let mut warnings = Vec::new();
    let blur_mm = mean(arcs, blurred_radius);
    let mut rod = free(fit, robust, shift, blur_mm);
    let mut axis = axis_seen(&rod, arcs, c_deg, options, &mut warnings)?;
    if let Some(axis) = &axis {
        rod.take_radius(&axis.known);
    }
    let form = agreement::seen_again(arcs, robust, c_deg, options.c_sense) * wander(&refined, &rod);
    let (rim_mm, off_mm) = unseen(arcs, angles);
    (0..2).for_each(|i| rod.covariance[(i, i)] += off_mm * off_mm);
    let mut all = vec![&mut rod];
    all.extend(axis.as_mut().map(|axis| &mut axis.known));
    all.iter_mut().for_each(|known| known.widen_radius(form + rim_mm * rim_mm));
    let nominal = take_nominal(&mut all, options, &mut warnings);
    let (centers, rod_centers) =
        (centers(&rod, angles), rod_centers(&rod, axis.as_ref(), c_deg, fit.dof));
    let (axis_center, axis_u95) = match &axis {
        Some(axis) => axis_place(axis),
        None => {
            warnings.push(ONE_ANGLE.to_owned());
            (centers[0], rod_centers[0].center_u95_mm)
        }
    };
    let radius = rod.radius();
    let radius_dof = axis.as_ref().map_or(fit.dof, |axis| axis.dof_of(4).min(fit.dof));
    let diameter_u95_mm = 2.0 * k95(radius_dof) * rod.radius_variance().max(0.0).sqrt();
    let (points, captures_report) =
        agreement::residuals(captures, arcs, robust, &centers, radius - blur_mm);
    agreement::check(&refined, &points, &captures_report, options)?;
    agreement::arcs_seen(arcs, robust, options, &mut warnings);
    agreement::places_and_form(&refined, arcs, &captures_report, options, &mut warnings);
    let sources = budget::Sources {
        fit,
        groups: &refined.groups,
        images: arcs.iter().map(|a| captures[a.capture].image.as_str()).collect(),
        gain: axis.as_ref().map_or(&rod, |axis| &axis.known).first_and_radius(),
        nominal,
        rim_mm,
        light_mm: (0.5 * shift.covariance.trace()).sqrt(),
        lines_mm: off_mm,
        plane: &refined.by_plane,
    };
    let budget = sources.budget(axis_u95, diameter_u95_mm);
    let turned = |c_deg: f64| match &axis {
        Some(axis) => axis.center(c_deg, options.c_sense),
        None => centers[0],
    };
    let center = |(c, a): (&Capture, &Option<usize>)| {
        a.map_or_else(|| turned(c.c_deg), |a| centers[a]) - c.position_mm
    };
    let seen = captures.iter().zip(angle_of);
    let circles = seen.map(|seen| Circle { center: center(seen), radius }).collect();
    let eccentricity = axis.as_ref().map(eccentricity_of);
    Ok(Measured {
        report: Report {
            rod_centers,
            axis_center_mm: axis_center.into(),
            axis_center_u95_mm: axis_u95,
            eccentricity_mm: eccentricity.map(|e| e.0),
            eccentricity_u95_mm: eccentricity.map(|e| e.1),
            axis_separated: axis.is_some(),
            diameter_mm: 2.0 * radius,
            diameter_u95_mm,
            form_rms_mm: refined.form_mm,
            position_scatter_mm: refined.position_scatter_mm(),
            captures: captures_report,
            budget,
            warnings,
        },
        points,
        circles,
    })
}

/// The common circle, with all that is known of the edge points.
fn refine(followed: &Followed, angles: usize, options: &Options) -> Result<Refined> {
    let Followed { arcs, robust, bow, view, .. } = followed;
    let is_nominal = |radius: f64| options.is_nominal(2.0 * radius);
    joint::refine(arcs, angles, robust, (bow, view), is_nominal).ok_or_else(|| {
        let alone = |angle: &usize| arcs.iter().filter(|arc| arc.angle == *angle).count() < 2;
        let fix = match (0..angles).filter(alone).count() {
            0 => "take captures all round the rim".to_owned(),
            n => format!(
                "{n} of {angles} table angles show the rim in one capture only: take several at each, all round it"
            ),
        };
        Error::measure("captures", "the arcs do not determine a circle", fix)
    })
}

/// The axis, where there are several table angles.
fn axis_seen(
    rod: &Known,
    arcs: &[Arc],
    c_deg: &[f64],
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Option<Axis>> {
    let angles = c_deg.len();
    if angles < 2 {
        return Ok(None);
    }
    let often = |angle| arcs.iter().filter(|arc| arc.angle == angle).count() > 1;
    let in_place = axis::IN_PLACE[usize::from((0..angles).all(often))];
    find_axis(rod, &centers(rod, angles), c_deg, options, in_place, warnings)
}

/// Standard uncertainties that no fit shows: of the rim all round, and of its centre to one side.
fn unseen(arcs: &[Arc], angles: usize) -> (f64, f64) {
    let lines_mm = turned_mm(arcs);
    let rim_mm = mean(arcs, |p| joint::RADIUS_PX.hypot(p.located.step.rim_sd_px) * p.pixel_mm)
        .hypot(lines_mm);
    // Seen at one table angle, the rod's centre is the axis: with more, lines out of centre turn with the rod.
    let off_mm = if angles > 1 { 0.0 } else { LINES_OFF_CENTRE * lines_mm };
    (rim_mm, off_mm)
}

/// Where the axis is, with its intervals.
fn axis_place(axis: &Axis) -> (Vector2<f64>, [f64; 2]) {
    let u95 = |i| k95(axis.dof_of(i)) * axis.known.covariance[(i, i)].max(0.0).sqrt();
    (axis.known.pair(0), [0, 1].map(u95))
}

/// How far the rod stands off the axis, with its interval.
fn eccentricity_of(axis: &Axis) -> (f64, f64) {
    let (seen, covariance) = (axis.known.pair(2), axis.known.pair_covariance(2));
    let dof = axis.dof_of(2).min(axis.dof_of(3));
    (seen.norm(), uncertainty::distance(seen, covariance, dof).1)
}

/// Centres and radius as the edge points tell them, every table angle by itself.
fn free(fit: &Fit, robust: &Joint, shift: &Shift, blur_mm: f64) -> Known {
    let n = fit.beta.len();
    let mut known = Known {
        values: fit.beta.clone(),
        covariance: fit.covariance.clone(),
        gain: DMatrix::identity(n, n),
    };
    for (a, center) in robust.centers.iter().enumerate() {
        let mut own = known.values.fixed_rows_mut::<2>(2 * a);
        own += center + shift.mm;
        for b in 0..robust.centers.len() {
            let mut part = known.covariance.fixed_view_mut::<2, 2>(2 * a, 2 * b);
            part += shift.covariance;
        }
    }
    known.values[n - 1] += robust.radius + blur_mm;
    known
}

/// The nominal radius as one more observation: its weight and standard uncertainty, where the edges do not speak against it.
pub(super) fn take_nominal(
    all: &mut [&mut Known],
    options: &Options,
    warnings: &mut Vec<String>,
) -> Option<(f64, f64)> {
    let nominal_mm = options.diameter_mm?;
    let variance = (0.5 * options.diameter_u_mm).powi(2);
    let total = all[0].radius_variance() + variance;
    if (0.5 * nominal_mm - all[0].radius()).abs() > 3.0 * total.sqrt() {
        warnings.push(not_nominal(2.0 * all[0].radius(), nominal_mm));
        return None;
    }
    let weight = all[0].radius_variance() / total;
    all.iter_mut().for_each(|known| known.observe_radius(0.5 * nominal_mm, variance));
    Some((weight, variance.sqrt()))
}

/// The warning about a nominal diameter that the edges speak against.
pub(super) fn not_nominal(diameter_mm: f64, nominal_mm: f64) -> String {
    format!(
        "the rod measures {diameter_mm:.4} mm, not the nominal {nominal_mm} mm: the nominal value was not used; if it is right, another edge than the rim's was measured"
    )
}

/// The rod's centre at each table angle; where the axis says how far centres are out of place, that is in their intervals.
pub(super) fn rod_centers(
    rod: &Known,
    axis: Option<&Axis>,
    c_deg: &[f64],
    dof: f64,
) -> Vec<RodCenter> {
    let u95 = |i: usize| {
        let pixels_mm2 = rod.covariance[(i, i)].max(0.0);
        let (variance, of_axis) =
            axis.map_or((pixels_mm2, f64::INFINITY), |axis| axis.of_a_center(pixels_mm2));
        k95(dof.min(of_axis)) * variance.sqrt()
    };
    let center = |(a, &c_deg): (usize, &f64)| RodCenter {
        c_deg,
        center_mm: rod.pair(2 * a).into(),
        center_u95_mm: [u95(2 * a), u95(2 * a + 1)],
    };
    c_deg.iter().enumerate().map(center).collect()
}

pub(super) fn centers(rod: &Known, angles: usize) -> Vec<Vector2<f64>> {
    (0..angles).map(|a| rod.pair(2 * a)).collect()
}

/// The part of the radius' variance that wander of the rim makes.
fn wander(refined: &Refined, rod: &Known) -> f64 {
    let fit = &refined.fit;
    let rows = rod.gain.row(rod.values.len() - 1) * &fit.influence;
    let of = |covariance: &[DMatrix<f64>]| {
        let of_group = |(range, block): (std::ops::Range<usize>, &DMatrix<f64>)| {
            let own = rows.columns_range(range);
            (own * block * own.transpose())[(0, 0)]
        };
        groups(&refined.groups).into_iter().zip(covariance).map(of_group).sum::<f64>()
    };
    let share = of(&fit.wander_covariance) / of(&fit.row_covariance);
    share.clamp(0.0, 1.0) * rod.radius_variance()
}

/// The axis. Centres that scatter on no circle about it are refused.
pub(super) fn find_axis(
    rod: &Known,
    centers: &[Vector2<f64>],
    c_deg: &[f64],
    options: &Options,
    in_place: f64,
    warnings: &mut Vec<String>,
) -> Result<Option<Axis>> {
    let Some(axis) = axis::axis(rod, c_deg, options.c_sense, in_place) else {
        return Ok(None);
    };
    if axis.dof > 0 {
        let excess = (axis.chi2 / axis.dof as f64).sqrt();
        if let Some(other) = axis::axis(rod, c_deg, -options.c_sense, in_place)
            && axis.chi2 > other.chi2 + 20.0
            && axis.chi2 > 5.0 * other.chi2
        {
            warnings.push(
                "the rod's centres turn against C: c_sense seems to be the other one".to_owned(),
            );
            // Nor may they miss the circle on which they would turn the other way.
            let excess = (other.chi2 / other.dof.max(1) as f64).sqrt();
            agreement::turn_together(&other, excess, centers, c_deg, -options.c_sense)?;
        } else {
            agreement::turn_together(&axis, excess, centers, c_deg, options.c_sense)?;
        }
    }
    if axis.dof == 0
        && let Some(other) = axis::axis(rod, c_deg, -options.c_sense, in_place)
    {
        let apart_mm = (other.known.pair(0) - axis.known.pair(0)).norm();
        if apart_mm > OTHER_SENSE_MM {
            warnings.push(format!(
                "two table angles do not tell which way C turns: if c_sense is the other one, the axis lies {apart_mm:.4} mm away; add a third angle"
            ));
        }
    }
    Ok(Some(axis))
}

/// An axis that the other sense of C puts farther away is worth a word.
const OTHER_SENSE_MM: f64 = 0.002;

/// σ²/2R: a blurred rim's half level lies that much inside.
fn blurred_radius(points: &Points) -> f64 {
    let softness_px = points.located.step.softness_px;
    softness_px * softness_px / (2.0 * points.radius_px) * points.pixel_mm
}

/// Mean over the captures.
pub(super) fn mean(arcs: &[Arc], of: impl Fn(&Points) -> f64) -> f64 {
    arcs.iter().map(|a| of(&a.points)).sum::<f64>() / arcs.len().max(1) as f64
}
