//! Edge points as rows for the fits: how much each counts, and how they err together.

use nalgebra::{DMatrix, DVector, Vector2};

use crate::camera::View;
use crate::edge::{Contour, together};
use crate::fit::circle::{self, Circle};
use crate::fit::correlated;
use crate::fit::robust::scatter;
use crate::frame::Frame;
use crate::measure::points::{Points, Search};

/// [`correlated::Rows::unsteady`] of a burnt edge: rendered burns of other makers cover 80 % where a stationary edge would 95 %; this much
/// more brings them to where they should be. Where sectors differ in nothing but place, short wander is steady.
const UNSTEADY: f64 = 0.4;

/// Weights for the robust circle: inverse variances, but none so sure that it outweighs the form of the edge.
pub(super) fn robust_weights(points: &Points) -> Vec<f64> {
    let mut known: Vec<f64> = points
        .variance_mm2
        .iter()
        .zip(&points.usable)
        .filter(|(v, u)| **u && v.is_finite())
        .map(|(v, _)| *v)
        .collect();
    known.sort_by(f64::total_cmp);
    let middle = known.get(known.len() / 2).copied().unwrap_or(1.0);
    points
        .variance_mm2
        .iter()
        .zip(&points.usable)
        .map(|(v, u)| if *u { 1.0 / v.max(0.3 * middle) } else { 0.0 })
        .collect()
}

/// Robust weights have done their work: what is within reach of the circle counts in full.
pub(super) fn final_weights(points: &Points, fitted: &circle::Robust) -> Vec<f64> {
    let each = fitted.weights.iter().zip(robust_weights(points)).zip(&points.place_mm);
    each.map(|((robust, own), p)| {
        let keep = *robust > 0.0 && fitted.circle.distance(*p).abs() < 3.5 * fitted.scale;
        if keep { own } else { 0.0 }
    })
    .collect()
}

/// Radial residuals of neighbouring edge points joined into at most `groups` rows for the correlated fit, with
/// coefficients for centre x, y and radius.
pub(super) fn group_rows(
    points: &Points,
    weights: &[f64],
    about: Circle,
    groups: usize,
) -> correlated::Rows {
    let n = points.place_mm.len();
    let size = n.div_ceil(groups).max(1);
    let mut design = Vec::new();
    let mut y = Vec::new();
    let mut variance = Vec::new();
    let mut place = Vec::new();
    for chunk in (0..n).collect::<Vec<_>>().chunks(size) {
        let (mut total, mut sum, mut at, mut spread) = (0.0, 0.0, Vector2::zeros(), 0.0);
        for &i in chunk {
            let w = weights[i];
            if w > 0.0 {
                total += w;
                sum += w * about.distance(points.place_mm[i]);
                at += points.place_mm[i] * w;
                spread += w * w * points.variance_mm2[i];
            }
        }
        if total > 0.0 {
            let middle = at / total;
            let normal = (middle - about.center).normalize();
            design.extend([normal.x, normal.y, 1.0]);
            y.push(sum / total);
            variance.push(spread / (total * total));
            place.push(middle);
        }
    }
    let mean = variance.iter().sum::<f64>() / variance.len().max(1) as f64;
    variance.iter_mut().for_each(|v| *v = v.max(0.05 * mean));
    correlated::Rows {
        design: DMatrix::from_row_slice(y.len(), 3, &design),
        group: vec![0; y.len()],
        y: DVector::from_vec(y),
        variance,
        place,
        covariance: None,
        displacement: None,
        unsteady: UNSTEADY,
        unsteady_if_long: points.located.plain,
    }
}

/// The edge of a small mark on a textured surface again, all round at once. `None` where its profiles say as much.
pub(super) fn textured_rows(
    frame: &Frame,
    view: &View,
    points: &Points,
    about: Circle,
    search: Search,
) -> Option<correlated::Rows> {
    if !points.located.textured {
        return None;
    }
    let contour = Contour::of_circle(view, about.center, about.radius)?;
    let edge = together(
        frame,
        &contour,
        &points.located,
        (search.inside_limit_px, search.outside_limit_px),
        points.clip,
    )?;
    let place = |(angle, distance): (&f64, &f64)| view.to_plane(contour.point(*angle, *distance));
    let place: Vec<Vector2<f64>> =
        edge.angle_rad.iter().zip(&edge.distance_px).map(place).collect();
    // Dirt and glare that have been taken for edge.
    let off: Vec<f64> = place.iter().map(|p| about.distance(*p).abs()).collect();
    let far = 3.5 * scatter(&mut off.clone()).max(0.05 * points.pixel_mm);
    let kept: Vec<usize> = (0..place.len()).filter(|&i| off[i] < far).collect();
    let place: Vec<Vector2<f64>> = kept.iter().map(|&i| place[i]).collect();
    let normal = |p: &Vector2<f64>| (p - about.center).normalize();
    let mm = DVector::from_fn(place.len(), |i, _| {
        1.0 / (view.px_per_mm(place[i]) * normal(&place[i])).norm()
    });
    let covariance = edge.covariance_px2.select_rows(&kept).select_columns(&kept);
    let covariance = covariance.component_mul(&(&mm * mm.transpose()));
    let design = place.iter().map(normal).flat_map(|n| [n.x, n.y, 1.0]);
    Some(correlated::Rows {
        design: DMatrix::from_row_iterator(place.len(), 3, design),
        y: DVector::from_fn(place.len(), |i, _| about.distance(place[i])),
        variance: covariance.diagonal().iter().copied().collect(),
        covariance: Some(covariance),
        group: vec![0; place.len()],
        place,
        displacement: None,
        unsteady: UNSTEADY,
        unsteady_if_long: false,
    })
}
