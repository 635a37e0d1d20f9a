//! Circles of a burn test's picture that were tried in vain, what they rule out, and what to tell the user of them.

use crate::error::Error;
use crate::find::Candidate;
use crate::fit::Circle;
use crate::measure::annulus::{Flaw, HALO};
use crate::measure::bands::is_concentric;
use crate::measure::marks::Marks;

/// A ring's step as a part of another's that has no spot.
const FAINT: f64 = 0.05;
/// How far two circles' centres and radii may be apart that are one, in radii.
const SAME: f64 = 0.3;

/// What was tried in vain.
#[derive(Default)]
pub(super) struct Tried<'a> {
    /// Rings without a spot, or with an unclear one.
    pub(super) lone: Vec<&'a Candidate>,
    /// Those with an unclear one.
    pub(super) unclear: Vec<&'a Candidate>,
    /// Spots of what may be rings, but about which too much speaks against it: no rings themselves.
    pub(super) spots: Vec<Circle>,
    /// A line with a spot, which is the ring only where there is no burn.
    pub(super) line: Option<(&'a Candidate, Marks)>,
    /// Circles that are no rings.
    refused: Vec<&'a Candidate>,
    /// Lamps' reflections among them: what is seen in them is the lamp's.
    lamps: Vec<&'a Candidate>,
    /// Whether there are ripples or bands of tint.
    rippled: bool,
    /// Whether a ring does not tell where it is.
    unsure: bool,
}

impl<'a> Tried<'a> {
    /// Puts by a circle that is no ring, and what it is instead.
    pub(super) fn refuse(&mut self, c: &'a Candidate, flaw: Flaw) {
        match flaw {
            Flaw::Unsure => self.unsure = true,
            Flaw::Lamp => self.lamps.push(c),
            Flaw::Ripples => self.rippled = true,
            Flaw::Other => {}
        }
        self.refused.push(c);
    }

    /// The line with a spot, where no burn lies about it.
    pub(super) fn line_alone(&mut self) -> Option<Marks> {
        self.line.take().filter(|(line, _)| !self.has_burn_about(line)).map(|(_, marks)| marks)
    }

    /// Whether a ring without a usable spot lies within a line, or about it: then the line is not the burn's.
    fn has_burn_about(&self, line: &Candidate) -> bool {
        /// How far apart the two centres are, and how much smaller one is, in the larger one's radii.
        const APART: f64 = 0.5;
        self.lone.iter().any(|ring| {
            let (a, b) = (&ring.circle, &line.circle);
            let (small, large) = (a.radius.min(b.radius), a.radius.max(b.radius));
            (a.center - b.center).norm() < APART * large && small > APART * large
        })
    }

    /// Whether what was tried before says that a circle is no ring.
    pub(super) fn rules_out(&self, c: &Candidate) -> bool {
        // Beside a clear circle the faintest ones are no rings, and what is much fainter about one that is none is its halo.
        let before = self.refused.iter().chain(&self.lone);
        let clearest = before.map(|r| r.step.abs()).fold(0.0, f64::max);
        if c.step.abs() < FAINT * clearest {
            return true;
        }
        let is_halo = |r: &&Candidate| is_concentric(r, c) && c.step.abs() < HALO * r.step.abs();
        self.refused.iter().any(is_halo)
            || self.spots.iter().any(|spot| spot.apart(&c.circle) < SAME * spot.radius)
            || self.lamps.iter().any(|l| l.circle.distance(c.circle.center) < 0.0)
    }

    /// What to tell the user.
    pub(super) fn error(&self, subject: &str) -> Error {
        let (what, help) = if !self.lone.is_empty() {
            (
                "a ring was found, but no spot inside it that is clear enough to measure",
                "burn the spot (100 W from 1-5 mm) and photograph again, lit so that no glare covers it",
            )
        } else if !self.lamps.is_empty() {
            (
                "the circle about the likeliest spot is soft and as bright as the camera can tell: a lamp's reflection, or a burn that is overexposed",
                "shade the lamp or move it, and expose less",
            )
        } else if self.unsure {
            (
                "a ring was found, but its edge is so ragged, or so lost in its surface, that it does not tell where the ring's centre is",
                "burn on a smoother plate, or light and expose so that the burn stands out more",
            )
        } else if self.rippled {
            (
                "the circles about one centre are ripples or bands of tint, about as strong as each other: which is the ring's edge cannot be told",
                "wipe the tint off the plate, or light and expose so that the burn is darker than its bands",
            )
        } else {
            (
                "no ring was found",
                "check that the whole ring is in the picture, in focus and darker or brighter than the plate",
            )
        };
        Error::measure(subject, what, help)
    }
}
