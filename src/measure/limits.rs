//! What a mark must keep to: a burn may be ragged, but a glare's border is no circle.

use crate::camera::View;
use crate::find::Candidate;
use crate::measure::ring::Ring;

/// From this softness on, as a part of its radius, the edge of what is clipped inside is a glare's where it is broken.
pub(super) const SOFT_BROKEN: f64 = 0.1;
/// The same where it is whole, to the part below.
const SOFT_WHOLE: f64 = 0.2;
const WHOLE: f64 = 0.95;

/// What a mark must keep to: lines of texture that happen to lie about a circle do not say where it is.
pub(super) struct Limits {
    pub coverage: f64,
    /// Its own form (rms) as a part of its radius; less where less of it is seen.
    pub form: f64,
    /// The standard deviation of its centre, as far as its edge tells it, as a part of its radius.
    pub doubt: f64,
    /// The same with what a tint may have moved it: a glare fades away all round, and what is left says little.
    pub in_all: f64,
}

impl Limits {
    /// Whether it is a circle.
    pub fn allow(&self, ring: &Ring, view: &View) -> bool {
        let radius_mm = ring.circle.radius;
        let softness = ring.softness_px * view.pixel_mm() / radius_mm;
        let whole = ring.arc_coverage > WHOLE;
        let glare = ring.clipped_inside && softness > if whole { SOFT_WHOLE } else { SOFT_BROKEN };
        let form2 = ring.form_rms_mm.powi(2) - ring.form_from_texture_mm.powi(2);
        !glare
            && ring.arc_coverage >= self.coverage
            && form2.max(0.0).sqrt() < self.form * ring.arc_coverage.powi(2) * radius_mm
    }

    /// Whether it tells where it is.
    pub fn trust(&self, ring: &Ring) -> bool {
        let radius_mm = ring.circle.radius;
        ring.fitted_sd_mm < self.doubt * radius_mm
            && ring.center_covariance().trace().sqrt() < self.in_all * radius_mm
    }
}

/// Whether a candidate's edge runs along its circle rather than wandering about it.
pub(super) fn is_steady(c: &Candidate) -> bool {
    c.scatter_px < 0.035 * c.circle.radius + 4.0 && c.step.abs() > 0.0
}

/// How much less a circle counts for being soft: by half where its softness is this part of its radius.
pub(super) fn glow(c: &Candidate, part: f64) -> f64 {
    1.0 + (c.softness_px / (part * c.circle.radius)).powi(2)
}
