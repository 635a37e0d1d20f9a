//! The check rod: arcs of its rim in several captures → one radius, a centre per table angle, and the C axis.

mod agreement;
mod attempts;
mod budget;
mod captures;
mod joint;
mod light;
mod outer;
mod points;
mod report;
mod seek;
mod sight;

pub use captures::{Capture, read as read_captures};
pub use points::points_csv;
pub use report::{CaptureReport, Options, Report, RodCenter};

use nalgebra::{DMatrix, Vector2};

use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::fit::Circle;
use crate::frame::{Frame, Picture};
use crate::measure::points::{CLOSE, GLANCE, Points, Search, edge_points};
use crate::uncertainty::{K95, k95};
use crate::units;
use attempts::Attempts;
use joint::{Arc, Axis, Joint};
use light::{Light, Shift};
use outer::Found;

/// One edge point, for `diagnose rod` and for overlays.
#[derive(Debug, Clone, Copy)]
pub struct EdgePoint {
    /// Index of the capture.
    pub capture: usize,
    /// Place in the picture.
    pub pixel: Vector2<f64>,
    /// Radial residual from the common circle.
    pub residual_mm: f64,
    /// Whether the fit rests on it.
    pub used: bool,
}

/// The report with what an overlay shows.
#[derive(Debug, Clone)]
pub struct Measured {
    /// The report.
    pub report: Report,
    /// All edge points.
    pub points: Vec<EdgePoint>,
    /// The rod's circle in each capture's plane.
    pub circles: Vec<Circle>,
}

/// Measures the rod from its captures.
pub fn measure(
    captures: &[Capture],
    calibration: &Calibration,
    options: &Options,
) -> Result<Measured> {
    check(options)?;
    use rayon::prelude::*;
    let read: Vec<((Frame, View), Option<&str>)> = captures
        .par_iter()
        .map(|c| {
            let picture = Picture::read(&c.path)?;
            let (w, h) = picture.size();
            let view = calibration.view_of(&c.image, w, h)?;
            let doubt = picture.doubt();
            Ok(((calibration.linear(picture.into_frame(options.channel)), view), doubt))
        })
        .collect::<Result<Vec<_>>>()?;
    let (frames, doubts): (Vec<_>, Vec<_>) = read.into_iter().unzip();
    let mut measured = measure_frames(captures, &frames, options)?;
    let sizes = frames.iter().map(|(frame, _)| (frame.width(), frame.height()));
    let sizes = captures.iter().map(|c| c.image.as_str()).zip(sizes);
    let doubts = captures.iter().zip(doubts).filter_map(|(c, doubt)| Some((&c.image, doubt?)));
    measured.report.warnings.extend(doubts.map(|(image, doubt)| format!("{image}: {doubt}")));
    measured.report.warnings.extend(calibration.doubt());
    measured.report.warnings.extend(units::sizes(sizes));
    if let Some(laser) = &calibration.laser {
        measured.report.refer_to_laser(laser);
    }
    Ok(measured)
}

/// Refuses options that no rod can have.
pub fn check(options: &Options) -> Result<()> {
    if !(options.diameter_u_mm.is_finite() && options.diameter_u_mm > 0.0) {
        return Err(Error::option(
            "diameter_u_mm",
            format!("{} is no standard uncertainty", options.diameter_u_mm),
            "give mm, above 0",
        ));
    }
    if let Some(d) = options.diameter_mm
        && !(d.is_finite() && d > 0.0)
    {
        return Err(Error::option(
            "--diameter-mm",
            format!("{d} is not a diameter"),
            "give the rod's diameter in mm",
        ));
    }
    if options.c_sense.abs() != 1.0 {
        return Err(Error::option(
            "--c-sense",
            format!("{} is no sense", options.c_sense),
            "give 1 or -1",
        ));
    }
    Ok(())
}

/// Rims that wander by more may be edges of two circles, if those of another wander by less than this part of it.
const DOUBTFUL_MM: f64 = 0.003;
const CLEARER: f64 = 0.5;
/// Other centres that are tried then.
const OTHERS: usize = 2;

/// As [`measure`], from frames already in memory, and as if the camera axis were the laser axis.
pub fn measure_frames(
    captures: &[Capture],
    frames: &[(Frame, View)],
    options: &Options,
) -> Result<Measured> {
    let unseen = || {
        Error::measure(
            "captures",
            "no rim of a rod is seen on which they agree",
            "check the pictures, the machine positions (x_mm, y_mm) and the calibration's signs",
        )
    };
    let (c_deg, angle_of) = captures::table_angles(captures);
    let attempts = Attempts::new(captures, &angle_of, frames, options.diameter_mm);
    let measure_at = |found: &Found| -> Result<Measured> {
        let (arcs, fitted, shift) = follow(captures, frames, found, &angle_of)?;
        let mut measured = finish(captures, options, &c_deg, &angle_of, &arcs, &fitted, shift)?;
        agreement::fainter_rim(found.fainter_mm, options, &mut measured.report.warnings);
        Ok(measured)
    };
    let measure = |found: Found| -> Result<Measured> {
        let rim = found.common_rim().and_then(|rim| measure_at(&rim).ok());
        rim.map_or_else(|| measure_at(&found), Ok)
    };
    let likely = attempts.likely();
    let about = |nth: usize| likely.get(nth).and_then(|circle| attempts.rim(*circle));
    let mut best = about(0).ok_or_else(unseen).and_then(&measure);
    // Edges of two circles taken for one wander about it, or miss it.
    let doubtful = |m: &Measured| m.report.form_rms_mm >= DOUBTFUL_MM;
    for other in 0..=OTHERS {
        if !best.as_ref().map_or(true, doubtful) {
            break;
        }
        let found = if other == 0 { attempts.apart() } else { about(other) };
        let Some(Ok(other)) = found.map(&measure) else { continue };
        let clearer = |m: &Measured| other.report.form_rms_mm < CLEARER * m.report.form_rms_mm;
        // Where the likeliest is refused another must be no such circle itself.
        if best.as_ref().map_or_else(|_| !doubtful(&other), clearer) {
            best = Ok(other);
        }
    }
    best.map(|best| {
        let outer = attempts.just_outside(&best.report);
        let outer = outer.and_then(|found| measure_at(&found).ok()).filter(|m| !doubtful(m));
        outer.unwrap_or(best)
    })
}

/// Follows a rim through all captures: edge points and the joint circle in turn, and how far the light moves it.
fn follow(
    captures: &[Capture],
    frames: &[(Frame, View)],
    rim: &Found,
    angle_of: &[usize],
) -> Result<(Vec<Arc>, Joint, Option<Shift>)> {
    use rayon::prelude::*;
    let mut guess = Joint {
        centers: rim.centers.clone(),
        radius: rim.radius_mm,
        shifts: vec![Vector2::zeros(); captures.len()],
        weights: Vec::new(),
    };
    let mut softness = vec![2.0; captures.len()];
    let mut arcs: Vec<Arc> = Vec::new();
    let mut light: Option<Light> = None;
    let mut seen = None;
    for (reach_px, effort) in [(12.0, GLANCE), (4.0, GLANCE), (1.0, CLOSE)] {
        light = seen;
        let slope = light.map(|light| light.divided_per_px());
        arcs = frames
            .par_iter()
            .enumerate()
            .filter_map(|(i, (frame, view))| {
                let position_mm = captures[i].position_mm;
                let rough = guess.seen(angle_of[i], i, position_mm);
                let per_mm = 1.0 / view.pixel_mm();
                let inside_limit_px = rim.inner_mm.map_or(60.0, |inner_mm| {
                    (0.6 * (rim.radius_mm - inner_mm) * per_mm).clamp(4.0, 60.0)
                });
                let search = Search {
                    reach_px,
                    inside_limit_px,
                    outside_limit_px: 60.0,
                    softness_px: softness[i],
                };
                let mut points = edge_points(frame, view, rough, search, effort, slope)?;
                points.move_to_rim(rough.center);
                Some(Arc { points, position_mm, angle: angle_of[i], capture: i })
            })
            .collect();
        for arc in &arcs {
            softness[arc.capture] = arc.points.located.step.softness_px.clamp(0.6, 20.0);
        }
        seen = Light::of(&arcs, &frames[0].1);
        if let Some(a) = (0..rim.centers.len()).find(|a| arcs.iter().all(|arc| arc.angle != *a)) {
            let first = angle_of.iter().position(|angle| *angle == a).unwrap_or(0);
            return Err(Error::measure(
                format!("the captures at C = {}°", captures[first].c_deg),
                "the rod's rim is not seen where the other captures say that it is",
                "check x_mm, y_mm and the pictures, or leave them out",
            ));
        }
        guess = joint::robust(&arcs, &guess, 20).ok_or_else(|| {
            Error::measure(
                "captures",
                "too few edge points for a circle",
                "take captures all round the rim",
            )
        })?;
    }
    let shift = light.map(|light| light.shift(&arcs, &frames[0].1));
    Ok((arcs, guess, shift))
}

fn finish(
    captures: &[Capture],
    options: &Options,
    c_deg: &[f64],
    angle_of: &[usize],
    arcs: &[Arc],
    robust: &Joint,
    shift: Option<Shift>,
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
    let shift = shift.unwrap_or_default();
    for (a, b) in (0..angles).flat_map(|a| (0..angles).map(move |b| (a, b))) {
        let mut part = covariance.fixed_view_mut::<2, 2>(2 * a, 2 * b);
        part += shift.covariance;
    }
    // Every table angle shows the same rim: its form does not average out over them.
    covariance[(last, last)] *= angles as f64;
    covariance[(last, last)] += mean(arcs, |p| p.located.step.rim_sd_px * p.pixel_mm).powi(2);
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
        if excess > 1.5 {
            return Ok(Some((axis, K95 * excess)));
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
fn mean(arcs: &[Arc], of: impl Fn(&Points) -> f64) -> f64 {
    arcs.iter().map(|a| of(&a.points)).sum::<f64>() / arcs.len().max(1) as f64
}
