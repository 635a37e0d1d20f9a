//! A picture (or captures) → a measurement.

mod annulus;
mod bands;
pub mod burn;
pub mod circles;
mod concentric;
pub mod cross;
mod dirt;
pub(crate) mod expected;
mod halo;
mod limits;
mod marks;
pub mod offset;
pub(crate) mod plane_errors;
pub mod points;
mod polygon;
pub mod ring;
pub mod rod;
pub(crate) mod round;
mod rows;
mod spot;
mod spots;
mod tried;
mod two_edges;

use serde::Serialize;

use crate::error::{Error, Result};
use crate::frame::{Channel, Picture};
use crate::uncertainty::{K95, k95};
use plane_errors::PlaneErrors;
use ring::Ring;

/// A measured circle as every output shows it.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct CircleReport {
    /// Centre in the plane.
    pub center_mm: [f64; 2],
    /// Centre as it is seen in the picture.
    pub center_px: [f64; 2],
    /// Diameter.
    pub diameter_mm: f64,
    /// Half-widths of the centre's 95 % intervals.
    pub center_u95_mm: [f64; 2],
    /// Half-width of the diameter's 95 % interval.
    pub diameter_u95_mm: f64,
    /// Edge points used.
    pub edge_points: usize,
    /// Share of the circle on which the edge was found, 0..1.
    pub arc_coverage: f64,
    /// Root mean square of the edge's form deviation.
    pub form_rms_mm: f64,
}

impl CircleReport {
    /// The report of a measured ring in a plane known as surely as that.
    pub(crate) fn of(ring: &Ring, plane: &PlaneErrors) -> Self {
        let k = k95(ring.dof);
        let covariance = ring.covariance + plane.covariance(ring.dof);
        let u = |i: usize| k * covariance[(i, i)].max(0.0).sqrt();
        Self {
            center_mm: ring.circle.center.into(),
            center_px: ring.center_px.into(),
            diameter_mm: 2.0 * ring.circle.radius,
            center_u95_mm: [u(0), u(1)],
            diameter_u95_mm: 2.0 * u(2),
            edge_points: ring.edge_points,
            arc_coverage: ring.arc_coverage,
            form_rms_mm: ring.form_rms_mm,
        }
    }

    /// The same of a burnt mark, which may be soft itself: what a blurred picture takes from a sharp mark's diameter was added, and a soft
    /// mark's has lost nothing of it. Which it is no picture tells.
    pub(crate) fn of_mark(ring: &Ring, plane: &PlaneErrors) -> Self {
        let report = Self::of(ring, plane);
        // Anywhere between none and all of it alike, seen from all.
        let own_mm = K95 * 2.0 * ring.blur_mm / 3f64.sqrt();
        Self { diameter_u95_mm: report.diameter_u95_mm.hypot(own_mm), ..report }
    }
}

/// Measures in every channel worth trying and keeps the one whose result is known best (least `spread`, by a tenth at
/// least, so that noise does not choose), of those that no other one refutes; the first channel's error where none can be
/// measured. `refutes` says whether the first result shows the second to be wrong.
pub(crate) fn best_channel<M>(
    picture: &Picture,
    choice: Channel,
    subject: &str,
    attempt: impl FnMut(Channel) -> Result<M>,
    refutes: impl Fn(&M, &M) -> bool,
    spread: impl Fn(&M) -> f64,
) -> Result<M> {
    let tried: Vec<Result<M>> = picture.channels(choice).into_iter().map(attempt).collect();
    let (mut measured, mut errors) = (Vec::new(), Vec::new());
    for result in tried {
        match result {
            Ok(m) => measured.push(m),
            Err(e) => errors.push(e),
        }
    }
    let stands = |m: &M| !measured.iter().any(|other| refutes(other, m));
    let mut best: Option<(f64, usize)> = None;
    for (i, m) in measured.iter().enumerate().filter(|(_, m)| stands(m)) {
        let value = spread(m);
        if best.is_none_or(|(least, _)| value < 0.9 * least) {
            best = Some((value, i));
        }
    }
    match (best, errors.into_iter().next()) {
        (Some((_, i)), _) => Ok(measured.swap_remove(i)),
        (None, Some(e)) => Err(e),
        (None, None) => Err(Error::measure(subject, "has no channel to measure", "give a picture")),
    }
}
