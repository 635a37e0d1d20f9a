//! What lies about a spot and within it: the halo that its heat has left, inside which a circle may tell far better where the spot is, and the
//! glint on its bottom, about which the spot is.

use crate::find::Candidate;
use crate::fit::Circle;
use crate::measure::points::Search;
use crate::measure::ring::{self, Ring};
use crate::measure::spot::{Inside, WHOLE};

impl Inside<'_> {
    /// The dark spot that a light circle in it, off its middle, is the glint of.
    pub(super) fn around_glint(&self, found: &Ring, spots: &[Candidate]) -> Option<Ring> {
        /// How much larger it is at least, and how far past its edge a glint may seem to reach.
        const LARGER: f64 = 1.3;
        const PAST: f64 = 1.1;
        /// How far off its middle the glint lies, in its radii: a light spot in the dark tint that its heat has left lies in the middle.
        const OFF: f64 = 0.1;
        if found.contrast >= 0.0 {
            return None;
        }
        let glint = found.seen(self.view);
        let holds = |dark: &&Candidate| {
            let apart = (dark.circle.center - glint.center).norm();
            dark.step > 0.0
                && dark.circle.radius > LARGER * glint.radius
                && apart + glint.radius < PAST * dark.circle.radius
                && apart > OFF * dark.circle.radius
        };
        spots.iter().filter(holds).find_map(|dark| self.measure(dark))
    }

    /// A circle within a spot that tells far better where it is, or is far clearer: what was found is its halo.
    pub(super) fn within_halo(&self, found: &Ring) -> Option<Ring> {
        /// Where it is looked for, in the spot's radii.
        const WITHIN: [f64; 2] = [0.7, 0.5];
        /// A spot that is known to this part of its radius needs no other.
        const SURE: f64 = 0.01;
        /// Standard deviation of its centre as a part of the halo's, at most, with such a part of its step.
        const SURER: f64 = 0.5;
        const STEP: f64 = 0.5;
        /// Or its step in the halo's.
        const CLEARER: f64 = 1.5;
        if found.fitted_sd_mm < SURE * found.circle.radius {
            return None;
        }
        let look = |rough: Circle| {
            let radius_px = rough.radius / self.view.pixel_mm();
            let search = Search {
                reach_px: 0.4 * radius_px + 3.0,
                inside_limit_px: 0.95 * radius_px,
                outside_limit_px: 0.8 * radius_px + 3.0,
                softness_px: 1.5,
                tinted: false,
                light: None,
            };
            ring::measure(self.frame, self.view, rough, search, Some(&self.ring.wander))
        };
        let looked = WITHIN.into_iter().filter_map(|part| {
            let radius = part * found.circle.radius;
            // Once more from where it is: a halo leads astray.
            let rough = look(Circle { radius, ..found.circle })?.circle;
            let core = look(rough)?;
            let apart = (core.circle.center - found.circle.center).norm();
            let step = core.contrast / found.contrast;
            let surer = core.fitted_sd_mm < SURER * found.fitted_sd_mm && step > STEP;
            // Of the two senses a core has the burn's: what is light in a dark spot is its glint.
            let is_burnt = step > 0.0 || core.contrast * self.ring.contrast > 0.0;
            ((surer || is_burnt && step.abs() > CLEARER)
                && core.arc_coverage > WHOLE
                && apart + core.circle.radius < found.circle.radius
                && self.is_spot(&core, rough))
            .then_some(core)
        });
        looked.min_by(|a, b| a.fitted_sd_mm.total_cmp(&b.fitted_sd_mm))
    }
}
