//! Captures that were left out, and where their rim lies instead: the machine's position is wrong by that, where it was mistyped.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Vector2};

use super::CaptureReport;
use super::seek::Voter;
use crate::fit::Circle;
use crate::fit::robust::median;

/// Cells in which centres are gathered: gradients are as unsure at a radius of some millimetres.
const CELL_MM: f64 = 0.1;
/// How near the rim its edges lie, in the end.
const NEAR_MM: f64 = 0.03;
/// No chamfer is wider: farther away nothing else looks like the rim.
const CHAMFER_MM: f64 = 1.2;
/// A capture shows the rim where it has this part of the edges on it that those in place have.
const LEAST: f64 = 0.4;

/// How far from where the other captures put it each left-out capture's rim lies, as far as it shows one. `rims` are where all should lie,
/// in the machine's coordinates.
pub(super) fn astray_mm(
    reports: &[CaptureReport],
    voters: &[Vec<Voter>],
    rims: &[Circle],
) -> Vec<Option<Vector2<f64>>> {
    let left_out = |i: usize| reports[i].edge_points == 0;
    let in_place = (0..reports.len()).filter(|&i| !left_out(i));
    let mut edges: Vec<f64> = in_place.map(|i| on(&voters[i], rims[i]) as f64).collect();
    let least = LEAST * if edges.is_empty() { f64::INFINITY } else { median(&mut edges) };
    let astray = |i: usize| {
        let found = left_out(i).then(|| nearest(&voters[i], rims[i].radius))??;
        (on(&voters[i], found) as f64 >= least).then(|| found.center - rims[i].center)
    };
    (0..reports.len()).map(astray).collect()
}

/// The warnings about captures that were left out.
pub(super) fn left_out(
    reports: &[CaptureReport],
    astray_mm: &[Option<Vector2<f64>>],
) -> Vec<String> {
    let told = reports.iter().zip(astray_mm).filter(|(report, _)| report.edge_points == 0);
    told.map(|(c, astray_mm)| {
        let what = match astray_mm {
            Some(off) => format!(
                "its rim seems to lie {:.2} mm from where the other captures put it, as if its x_mm were {:+.2} mm and its y_mm {:+.2} mm off{}",
                off.norm(),
                off.x,
                off.y,
                if off.norm() < CHAMFER_MM { ", or it shows another edge" } else { "" }
            ),
            None if c.residual_rms_mm > 0.0 => format!(
                "its edge misses the rim of the other captures, by {:.4} mm in the mean and {:.4} mm rms",
                c.residual_mean_mm.abs(),
                c.residual_rms_mm
            ),
            None => "its rim is not where the other captures put it".to_owned(),
        };
        format!("{}: left out: {what}: check the picture, its x_mm, y_mm and c_deg", c.image)
    })
    .collect()
}

/// Edges that lie on a circle and along it.
fn on(voters: &[Voter], circle: Circle) -> usize {
    voters.iter().filter(|v| v.off_mm(circle).is_some_and(|off| off.abs() < NEAR_MM)).count()
}

/// The circle of a known radius on which most edges lie.
fn nearest(voters: &[Voter], radius: f64) -> Option<Circle> {
    let cell = |p: Vector2<f64>| ((p.x / CELL_MM).floor() as i64, (p.y / CELL_MM).floor() as i64);
    let mut cells: BTreeMap<(i64, i64), usize> = BTreeMap::new();
    for center in voters.iter().flat_map(|v| v.centers(radius)) {
        *cells.entry(cell(center)).or_default() += 1;
    }
    let around = |(x, y): (i64, i64)| {
        let near = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (x + i, y + j)));
        near.filter_map(|at| cells.get(&at)).sum::<usize>()
    };
    let (x, y) = cells.keys().copied().max_by_key(|at| around(*at))?;
    let mut circle =
        Circle { center: CELL_MM * Vector2::new(x as f64 + 0.5, y as f64 + 0.5), radius };
    for within_mm in [8.0, 4.0, 2.0, 1.0, 1.0].map(|part| part * NEAR_MM) {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for voter in voters {
            let Some(off) = voter.off_mm(circle).filter(|off| off.abs() < within_mm) else {
                continue;
            };
            let out = voter.toward(circle.center);
            normal += out * out.transpose();
            right += out * off;
        }
        circle.center += normal.try_inverse()? * right;
    }
    Some(circle)
}
