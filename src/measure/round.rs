//! Whether a measured edge is a circle's, as far as it tells by itself.

use crate::measure::polygon::is_polygon;
use crate::measure::ring::Ring;

/// Contrast over a pixel's noise below which texture may look like a circle's edge: it must be regular and stand out.
pub(super) const FAINT: f64 = 2.0;
/// A faint edge whose sectors all show more of it than they have in common is their noise; where most show so little, there is none.
const OF_NOISE: f64 = 1.3;
const UNSEEN: f64 = 0.3;
/// Form over radius below which nothing but a circle's edge stays; anything else must stand out from the surface.
pub(super) const REGULAR: f64 = 0.015;
/// Share of its circumference that the edge of a poor part shows, or a faint one.
pub(super) const WHOLE: f64 = 0.85;
/// Standard deviation of the centre, as its edge tells it, over the radius, and of an arc's radius: what is less sure is gathered
/// from anything, or straight. Less where less of the circle is seen.
const DOUBT: f64 = 0.03;

/// Root mean square of a circle's form over its radius.
pub(super) fn form(ring: &Ring) -> f64 {
    ring.form_rms_mm / ring.circle.radius
}

/// Whether an edge is a circle's as far as it tells by itself: sure of its place, and neither a polygon's nor texture's arc.
pub(crate) fn may_be_circle(ring: &Ring) -> bool {
    let of_noise = is_faint(ring) && ring.gain > OF_NOISE;
    if of_noise || ring.gain < UNSEEN {
        return false;
    }
    let most_mm = DOUBT * ring.arc_coverage.min(1.0).powi(2) * ring.circle.radius;
    let unsure_arc = ring.covariance[(2, 2)].sqrt() > most_mm || is_faint(ring);
    ring.fitted_sd_mm <= most_mm && !(is_arc(ring) && unsure_arc) && !is_polygon(ring)
}

/// Whether not all of a circle is seen.
pub(super) fn is_arc(ring: &Ring) -> bool {
    ring.arc_coverage < WHOLE
}

/// Whether an edge may be texture's.
pub(super) fn is_faint(ring: &Ring) -> bool {
    ring.contrast.abs() < FAINT * ring.noise
}

/// Whether an edge is as round as a circle's.
pub(super) fn is_regular(ring: &Ring) -> bool {
    form(ring) < REGULAR
}

/// Whether a step is no larger than the pixels' noise makes one: both sides are seen along the edge, about a softness wide.
pub(super) fn is_of_noise(ring: &Ring, pixel_mm: f64) -> bool {
    /// In standard deviations of the step: of all circles that a picture has room for, its noise alone makes some of five or six.
    const SURE: f64 = 10.0;
    let length_px = std::f64::consts::TAU * ring.arc_coverage * ring.circle.radius / pixel_mm;
    let pixels = length_px * ring.softness_px.max(1.0);
    ring.contrast.abs() < SURE * ring.noise * (2.0 / pixels).sqrt()
}
