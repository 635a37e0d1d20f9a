//! From a rim's edge in all captures to the report: corrections, uncertainty, checks and the axis.

use nalgebra::{DMatrix, Vector2};

use super::follow::Followed;
use super::joint::{self, Arc, Axis};
use super::turned::turned_mm;
use super::{Capture, Measured, Options, Report, RodCenter, agreement, budget};
use crate::error::{Error, Result};
use crate::fit::Circle;
use crate::measure::points::Points;
use crate::uncertainty::{K95, k95};

/// The answer from a rim's edge in all captures.
pub(super) fn finish(
    captures: &[Capture],
    options: &Options,
    c_deg: &[f64],
    angle_of: &[usize],
    Followed { arcs, robust, shift }: &Followed,
) -> Result<Measured> {
    let angles = c_deg.len();
    let refined = joint::refine(arcs, angles, robust).ok_or_else(|| {
        Error::measure(
            "captures",
            "the arcs do not determine a circle",
            "take captures all round the rim",
        )
    })?;
    let fit = &refined.fit;
    let mut warnings = Vec::new();
    let mut beta = fit.beta.clone();
    let mut covariance = fit.covariance.clone();
    let last = 2 * angles;
    for (a, b) in (0..angles).flat_map(|a| (0..angles).map(move |b| (a, b))) {
        let mut part = covariance.fixed_view_mut::<2, 2>(2 * a, 2 * b);
        part += shift.covariance;
    }
    // Every table angle shows the same rim: its form does not average out over them.
    covariance[(last, last)] *= 1.0 + (angles - 1) as f64 * fit.by_wander[last];
    let rim_mm = mean(arcs, |p| joint::RADIUS_PX.hypot(p.located.step.rim_sd_px) * p.pixel_mm)
        .hypot(turned_mm(arcs));
    covariance[(last, last)] += rim_mm * rim_mm;
    let blur_mm = mean(arcs, blurred_radius);
    let mut nominal = None;
    if let Some(d) = options.diameter_mm {
        // The nominal radius as one more observation.
        let gap = 0.5 * d - (robust.radius + beta[last] + blur_mm);
        let variance = (0.5 * options.diameter_u_mm).powi(2);
        let total = covariance[(last, last)] + variance;
        if gap.abs() > 3.0 * total.sqrt() {
            warnings.push(format!(
                "the rod measures {:.4} mm, not the nominal {d} mm: the nominal value was not used",
                2.0 * (robust.radius + beta[last] + blur_mm)
            ));
        } else {
            nominal = Some((covariance[(last, last)] / total, variance.sqrt()));
            let gain = covariance.column(last) / total;
            beta += &gain * gap;
            covariance -= &gain * gain.transpose() * total;
        }
    }
    let factor = k95(fit.dof);
    let centers: Vec<Vector2<f64>> = (0..angles)
        .map(|a| robust.centers[a] + Vector2::new(beta[2 * a], beta[2 * a + 1]) + shift.mm)
        .collect();
    let center_covariance: DMatrix<f64> = covariance.view((0, 0), (last, last)).into_owned();
    let u = |i: usize| factor * covariance[(i, i)].max(0.0).sqrt();
    let rod_centers = (0..angles)
        .map(|a| RodCenter {
            c_deg: c_deg[a],
            center_mm: centers[a].into(),
            center_u95_mm: [u(2 * a), u(2 * a + 1)],
        })
        .collect();
    let axis = if angles > 1 {
        find_axis(&centers, &center_covariance, c_deg, options, &mut warnings)?
    } else {
        None
    };
    let (axis_center, axis_u95) = match &axis {
        Some((axis, k)) => {
            (axis.center, [k * axis.covariance[(0, 0)].sqrt(), k * axis.covariance[(1, 1)].sqrt()])
        }
        None => {
            warnings.push(
                "one table angle only: the centre is the rod's, and its eccentricity to the C axis is in it"
                    .to_owned(),
            );
            (centers[0], [u(0), u(1)])
        }
    };
    let radius = robust.radius + beta[last] + blur_mm;
    let (points, captures_report) =
        agreement::residuals(captures, arcs, robust, &centers, robust.radius + beta[last]);
    agreement::check(&refined, &points, &captures_report)?;
    agreement::angles_seen(&captures_report, angle_of, c_deg)?;
    agreement::arcs_seen(arcs, robust, options, &mut warnings);
    agreement::places_and_form(&refined, &captures_report, options, &mut warnings);
    let sources = budget::Sources {
        fit,
        groups: &refined.groups,
        images: arcs.iter().map(|a| captures[a.capture].image.as_str()).collect(),
        gain: axis
            .as_ref()
            .map_or_else(|| DMatrix::identity(2, 2 * angles), |(axis, _)| axis.gain.clone()),
        nominal,
        rim_mm,
        light_mm: (0.5 * shift.covariance.trace()).sqrt(),
    };
    let budget = sources.budget(axis_u95, 2.0 * u(last));
    let circles =
        arcs.iter().map(|a| Circle { center: centers[a.angle] - a.position_mm, radius }).collect();
    Ok(Measured {
        report: Report {
            rod_centers,
            axis_center_mm: axis_center.into(),
            axis_center_u95_mm: axis_u95,
            eccentricity_mm: axis.as_ref().map(|(a, _)| a.eccentricity.norm()),
            eccentricity_u95_mm: axis.as_ref().map(|(a, k)| {
                crate::uncertainty::distance(
                    a.eccentricity,
                    a.eccentricity_covariance,
                    f64::INFINITY,
                )
                .1 * k
                    / K95
            }),
            axis_separated: axis.is_some(),
            diameter_mm: 2.0 * radius,
            diameter_u95_mm: 2.0 * u(last),
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

/// The axis and the coverage factor of its covariance.
fn find_axis(
    centers: &[Vector2<f64>],
    covariance: &DMatrix<f64>,
    c_deg: &[f64],
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Option<(Axis, f64)>> {
    let Some(axis) = joint::axis(centers, covariance, c_deg, options.c_sense) else {
        return Ok(None);
    };
    if axis.dof > 0 {
        // Centres that scatter more than their uncertainties: the axis is no better known than they agree.
        let excess = (axis.chi2 / axis.dof as f64).sqrt();
        if let Some(other) = joint::axis(centers, covariance, c_deg, -options.c_sense)
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
        if axis.excess > 1.5 {
            let factor = K95 * axis.excess;
            return Ok(Some((axis, factor)));
        }
    }
    Ok(Some((axis, K95)))
}

/// σ²/2R: a blurred rim's half level lies that much inside.
fn blurred_radius(points: &Points) -> f64 {
    let softness_px = points.located.step.softness_px;
    softness_px * softness_px / (2.0 * points.radius_px) * points.pixel_mm
}

/// Mean over the captures.
pub(super) fn mean(arcs: &[Arc], of: impl Fn(&Points) -> f64) -> f64 {
    arcs.iter().map(|a| of(&a.points)).sum::<f64>() / arcs.len().max(1) as f64
}
