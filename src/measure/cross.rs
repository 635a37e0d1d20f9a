//! A second opinion: OpenCV's contours and ellipses on the same picture, held against what was measured.
//!
//! OpenCV looks without a hint first; only where its contours are broken is it led to the circle that was measured. The ellipse
//! through the contour is compared with the ellipse as which the measured circle is seen, so that perspective plays no part.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::Serialize;

use crate::camera::View;
use crate::cv::{self, Ellipse};
use crate::error::Result;
use crate::fit::Circle;
use crate::fit::robust::scatter;
use crate::frame::Frame;
use crate::machine::apart_deg;
use crate::measure::CircleReport;
use crate::measure::rod;
use crate::uncertainty::K95;

/// Canny's edge pixels are whole: their errors repeat over about this many neighbours.
const ALIKE_PX: f64 = 4.0;
/// What no scatter shows: thresholds and whole pixels, px.
const FLOOR_PX: f64 = 0.05;
/// Least share of the circle that must be seen.
const LEAST_SHARE: f64 = 0.25;

/// What OpenCV says of one circle.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Opinion {
    /// Which circle.
    pub circle: String,
    /// How OpenCV came to it.
    pub found: Found,
    /// Centre of OpenCV's ellipse minus that of the measured circle as it is seen, in the plane; null where it has none.
    pub difference_mm: Option<[f64; 2]>,
    /// Half-widths of its 95 % intervals, of both measurements together.
    pub difference_u95_mm: Option<[f64; 2]>,
    /// Whether the two agree within both uncertainties; null where OpenCV found nothing.
    pub agrees: Option<bool>,
}

/// How OpenCV came to a circle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Found {
    /// By itself.
    Alone,
    /// Led to where the circle was measured.
    Led,
    /// Not at all.
    Nothing,
}

impl Opinion {
    /// The same for people, in a line.
    pub fn line(&self) -> String {
        let said = match (self.difference_mm, self.difference_u95_mm, self.agrees) {
            (Some([x, y]), Some([ux, uy]), Some(agrees)) => format!(
                "off by ({x:+.5}, {y:+.5}) ± ({ux:.5}, {uy:.5}) mm: {}",
                if agrees { "agrees" } else { "DISAGREES" }
            ),
            _ => "not found".to_owned(),
        };
        format!("OpenCV     {}: {said}", self.circle)
    }

    /// What a user should know of it.
    pub fn warning(&self) -> Option<String> {
        match (self.agrees, self.difference_mm) {
            (Some(true), _) => None,
            (Some(false), Some([x, y])) => Some(format!(
                "cross-check: OpenCV sees the {} off by ({x:+.5}, {y:+.5}) mm, beyond both uncertainties: look at the overlay",
                self.circle
            )),
            _ => Some(format!("cross-check: OpenCV does not find the {}", self.circle)),
        }
    }
}

/// Blur in pixels and share of Otsu's threshold with which contours are looked for: sharp and strong edges first, then
/// faint ones, then soft ones.
const LOOKS: [(f64, f64); 3] = [(1.2, 1.0), (1.2, 0.3), (4.0, 0.3)];

/// OpenCV's opinion on the circles of one picture.
pub fn circles(
    frame: &Frame,
    view: &View,
    measured: &[(String, &CircleReport)],
) -> Result<Vec<Opinion>> {
    let gray = frame.to_eight();
    let mut opinions: Vec<Option<Opinion>> = vec![None; measured.len()];
    for (blur_px, share) in LOOKS {
        let contours = cv::contours(&gray, blur_px, share)?;
        for ((name, circle), opinion) in measured.iter().zip(&mut opinions) {
            if opinion.as_ref().is_none_or(|o| o.found == Found::Nothing) {
                *opinion = Some(one(&contours, view, name, circle)?);
            }
        }
        if opinions.iter().flatten().all(|o| o.found != Found::Nothing) {
            break;
        }
    }
    Ok(opinions.into_iter().flatten().collect())
}

fn one(
    contours: &[Vec<Vector2<f64>>],
    view: &View,
    name: &str,
    report: &CircleReport,
) -> Result<Opinion> {
    let circle = Circle { center: report.center_mm.into(), radius: 0.5 * report.diameter_mm };
    let nothing = Opinion {
        circle: name.to_owned(),
        found: Found::Nothing,
        difference_mm: None,
        difference_u95_mm: None,
        agrees: None,
    };
    let seen: Vec<Vector2<f64>> = (0..720)
        .map(|i| (f64::from(i) * std::f64::consts::TAU / 720.0).sin_cos())
        .map(|(s, c)| view.to_pixel(circle.center + Vector2::new(c, s) * circle.radius))
        .collect();
    let Some(ours) = cv::fit_ellipse(&seen)? else { return Ok(nothing) };
    // By itself: whole contours that are about as large and about there.
    let mut alone: Option<(usize, Ellipse)> = None;
    for contour in contours.iter().filter(|c| c.len() as f64 > 4.0 * ours.radius()) {
        if let Some(e) = cv::fit_ellipse(contour)?
            && (e.radius() / ours.radius() - 1.0).abs() < 0.1
            && (e.center - ours.center).norm() < 0.3 * ours.radius()
            && (e.axes[0] / e.axes[1] - 1.0).abs() < 0.15
            && alone.is_none_or(|(n, _)| contour.len() > n)
        {
            alone = Some((contour.len(), e));
        }
    }
    let (found, start) = match alone {
        Some((_, e)) => (Found::Alone, e),
        None => (Found::Led, ours),
    };
    let Some((ellipse, u_px)) = refine(contours, start)? else { return Ok(nothing) };
    let jacobian = view.mm_per_px(ours.center);
    let difference = jacobian * (ellipse.center - ours.center);
    let theirs =
        jacobian * Matrix2::from_diagonal(&u_px.map(|u| u * u).into()) * jacobian.transpose();
    // Both see the same picture: their errors are no independent ones.
    let u95: [f64; 2] =
        std::array::from_fn(|k| K95 * theirs[(k, k)].sqrt() + report.center_u95_mm[k]);
    Ok(Opinion {
        found,
        difference_mm: Some(difference.into()),
        difference_u95_mm: Some(u95),
        agrees: Some((0..2).all(|k| difference[k].abs() <= u95[k])),
        ..nothing
    })
}

/// The ellipse through all contour points about `start`, outliers left out, and its centre's standard uncertainties.
fn refine(contours: &[Vec<Vector2<f64>>], start: Ellipse) -> Result<Option<(Ellipse, [f64; 2])>> {
    let mut ellipse = start;
    let mut band = (0.05 * start.radius()).max(4.0);
    let mut used = Vec::new();
    for _ in 0..4 {
        let off = |p: &Vector2<f64>| (p - ellipse.center).norm() - ellipse.radius();
        used = contours.iter().flatten().copied().filter(|p| off(p).abs() < band).collect();
        if (used.len() as f64) < LEAST_SHARE * std::f64::consts::TAU * ellipse.radius() {
            return Ok(None);
        }
        let Some(next) = cv::fit_ellipse(&used)? else { return Ok(None) };
        ellipse = next;
        let mut sizes: Vec<f64> =
            used.iter().map(|p| ((p - next.center).norm() - next.radius()).abs()).collect();
        let scatter = scatter(&mut sizes);
        // An ellipse seen at an angle is no circle: its axes differ, and that is no scatter.
        let oval = (next.axes[0] - next.axes[1]).abs();
        band = (3.0 * scatter + oval).clamp(1.5, band);
    }
    let squares: f64 =
        used.iter().map(|p| ((p - ellipse.center).norm() - ellipse.radius()).powi(2)).sum();
    let mut normal = Matrix3::<f64>::zeros();
    for p in &used {
        let n = (p - ellipse.center).normalize();
        let row = Vector3::new(n.x, n.y, 1.0);
        normal += row * row.transpose();
    }
    let variance = squares / used.len() as f64 * ALIKE_PX;
    Ok(normal.try_inverse().map(|c| {
        let u = |k: usize| (variance * c[(k, k)] + FLOOR_PX * FLOOR_PX).sqrt();
        (ellipse, [u(0), u(1)])
    }))
}

/// OpenCV's opinion on the rod: its contours near the rim in all captures of a table angle make one ellipse in machine mm.
pub fn rod(
    frames: &[(Frame, View)],
    captures: &[rod::Capture],
    measured: &rod::Measured,
) -> Result<Vec<Opinion>> {
    let mut opinions = Vec::new();
    for center in &measured.report.rod_centers {
        let mut points = Vec::new();
        let mut pixel_mm: f64 = 0.0;
        for (i, (frame, view)) in frames.iter().enumerate() {
            if apart_deg(captures[i].c_deg, center.c_deg) > 1e-6 {
                continue;
            }
            let circle = measured.circles[i];
            let near = 6.0 * view.pixel_mm();
            pixel_mm = pixel_mm.max(view.pixel_mm());
            // In the capture's plane, about the measured centre: angles of one table position lie on one circle.
            points.extend(
                cv::contours(&frame.to_eight(), LOOKS[0].0, LOOKS[0].1)?
                    .iter()
                    .flatten()
                    .map(|p| view.to_plane(*p))
                    .filter(|p| circle.distance(*p).abs() < near)
                    .map(|p| (p - circle.center) / view.pixel_mm()),
            );
        }
        let name = format!("rod at C {}°", center.c_deg);
        let radius = 0.5 * measured.report.diameter_mm / pixel_mm.max(1e-12);
        let start = Ellipse { center: Vector2::zeros(), axes: [radius; 2] };
        let opinion = match refine(&[points], start)? {
            Some((e, u_px)) => {
                let u95: [f64; 2] =
                    std::array::from_fn(|k| K95 * u_px[k] * pixel_mm + center.center_u95_mm[k]);
                let difference = e.center * pixel_mm;
                Opinion {
                    circle: name,
                    found: Found::Led,
                    difference_mm: Some(difference.into()),
                    difference_u95_mm: Some(u95),
                    agrees: Some((0..2).all(|k| difference[k].abs() <= u95[k])),
                }
            }
            None => Opinion {
                circle: name,
                found: Found::Nothing,
                difference_mm: None,
                difference_u95_mm: None,
                agrees: None,
            },
        };
        opinions.push(opinion);
    }
    Ok(opinions)
}
