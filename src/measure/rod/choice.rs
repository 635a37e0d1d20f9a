//! Which of the circles that the edges suggest is the rod's rim: the one that is measured well.

use super::attempts::Attempts;
use super::finish::finish;
use super::follow::follow;
use super::outer::Found;
use super::{Capture, Measured, Options, agreement, seen, slip};
use crate::camera::View;
use crate::error::{Error, Result};
use crate::frame::Frame;

/// Rims that wander by more may be edges of two circles, if those of another wander by less than this part of it.
const DOUBTFUL_MM: f64 = 0.003;
const CLEARER: f64 = 0.5;
/// Captures from which on any one of them may be the wrong one.
const LEAST_WITHOUT: usize = 5;
/// Other centres that are tried then.
const OTHERS: usize = 2;

/// The circles that captures suggest, and what it takes to measure each.
pub(super) struct Choice<'a> {
    captures: &'a [Capture],
    frames: &'a [(Frame, View)],
    options: &'a Options,
    c_deg: &'a [f64],
    angle_of: &'a [usize],
    attempts: Attempts<'a>,
}

impl<'a> Choice<'a> {
    /// Reads the captures' edges; `c_deg` are the different table angles, `angle_of` says which each capture has.
    pub fn new(
        captures: &'a [Capture],
        frames: &'a [(Frame, View)],
        options: &'a Options,
        (c_deg, angle_of): (&'a [f64], &'a [usize]),
    ) -> Self {
        let attempts = Attempts::new(captures, angle_of, frames, options.diameter_mm);
        Self { captures, frames, options, c_deg, angle_of, attempts }
    }

    /// The circle that is measured best, near the nominal diameter where one is told and seen.
    pub fn best(&self) -> Result<Measured> {
        let mut best = self.likeliest();
        if best.as_ref().map_or(true, |m| self.bereft(m) > 0)
            && self.captures.len() >= LEAST_WITHOUT
        {
            let other = self.without_one().filter(|m| self.is_better(m, &best));
            best = other.map_or(best, Ok);
        }
        match self.options.diameter_mm {
            Some(nominal_mm) => self.near(nominal_mm, best),
            None => best,
        }
    }

    /// The rim just outside the one that was measured.
    pub fn just_outside(&self, measured: &Measured) -> Option<Measured> {
        let found = self.attempts.just_outside(measured)?;
        self.measure_at(&found)
            .ok()
            .filter(|m| !doubtful(m) && self.bereft(m) <= self.bereft(measured))
    }

    /// The likeliest circle; another one where that is doubtful and the other clearly better.
    fn likeliest(&self) -> Result<Measured> {
        let likely = self.attempts.likely();
        let about = |nth: usize| likely.get(nth).and_then(|circle| self.attempts.rim(*circle));
        let first = about(0).ok_or_else(|| unseen(self.options.diameter_mm));
        let mut best = first.and_then(|found| self.measure(found));
        // Edges of two circles taken for one wander about it, or miss it.
        for other in 0..=OTHERS {
            if !best.as_ref().map_or(true, |m| doubtful(m) || self.bereft(m) > 0) {
                break;
            }
            let found = if other == 0 { self.attempts.apart() } else { about(other) };
            let Some(Ok(other)) = found.map(|found| self.measure(found)) else { continue };
            if self.is_better(&other, &best) {
                best = Ok(other);
            }
        }
        best
    }

    /// At how many table angles none of the captures is left, or one of several.
    fn bereft(&self, measured: &Measured) -> usize {
        let is_bereft = |angle: &usize| {
            let all = measured.report.captures.iter().zip(self.angle_of);
            let own = || all.clone().filter(|(_, a)| *a == angle);
            let left = own().filter(|(capture, _)| capture.edge_points > 0).count();
            left == 0 || left == 1 && own().count() > 1
        };
        (0..self.c_deg.len()).filter(is_bereft).count()
    }

    /// Whether a rim wanders so much less than another that the other may be edges of two circles.
    fn clearer(&self, a: &Measured, b: &Measured) -> bool {
        self.bereft(a) <= self.bereft(b) && a.report.form_rms_mm < CLEARER * b.report.form_rms_mm
    }

    /// Whether another circle is surely the rod sooner than the best one so far.
    fn is_better(&self, other: &Measured, best: &Result<Measured>) -> bool {
        match best {
            Ok(best) => {
                self.clearer(other, best)
                    || !doubtful(other) && self.bereft(other) < self.bereft(best)
            }
            // Where the likeliest is refused another must be no such circle itself.
            Err(_) => !doubtful(other),
        }
    }

    /// The circle on which all agree but one capture, which is at a wrong position.
    fn without_one(&self) -> Option<Measured> {
        let others = (0..self.captures.len())
            .filter_map(|i| self.measure(self.attempts.without(i)?).ok())
            .filter(|m| !doubtful(m));
        let apart = |m: &Measured| m.report.form_rms_mm.hypot(m.report.position_scatter_mm);
        let order = |a: &Measured, b: &Measured| {
            left_out(a).cmp(&left_out(b)).then(apart(a).total_cmp(&apart(b)))
        };
        others.min_by(order)
    }

    /// The rim of nominal size where `best` is none: stronger edges than the rim's (turned grooves, a collet) led elsewhere.
    fn near(&self, nominal_mm: f64, best: Result<Measured>) -> Result<Measured> {
        let meets = |m: &Measured| self.options.is_nominal(m.report.diameter_mm);
        if let Ok(found) = &best
            && meets(found)
        {
            let is_open = doubtful(found) || left_out(found) > 0;
            let unled = is_open.then(|| self.unled()).flatten().filter(meets);
            let is_better = |m: &Measured| {
                self.clearer(m, found) || !doubtful(m) && left_out(m) < left_out(found)
            };
            return unled.filter(is_better).map_or(best, Ok);
        }
        let named = self.attempts.named().and_then(|found| self.measure_at(&found).ok());
        let ragged = |m: &Measured| m.report.form_rms_mm >= agreement::RAGGED_MM;
        match (named.filter(|m| meets(m) && !ragged(m)), best) {
            (Some(named), _) => Ok(named),
            // Neither the size nor all table angles speak for it.
            (None, Ok(other)) if ragged(&other) || self.bereft(&other) > 0 => {
                Err(agreement::none_near(nominal_mm, &other.report))
            }
            (None, Ok(other)) => Ok(other),
            // What leads to edges of two circles is the nominal diameter, now and then.
            (None, refused) => self.unled().filter(|m| meets(m) && !ragged(m)).map_or(refused, Ok),
        }
    }

    /// The likeliest circle sought without the nominal diameter, which may lead to edges of two circles.
    fn unled(&self) -> Option<Measured> {
        let attempts = Attempts::new(self.captures, self.angle_of, self.frames, None);
        let found = attempts.rim(*attempts.likely().first()?)?;
        self.measure(found).ok()
    }

    /// Measures a circle, about one centre where the table angles show one.
    fn measure(&self, found: Found) -> Result<Measured> {
        let rim = found.common_rim().and_then(|rim| self.measure_at(&rim).ok());
        rim.map_or_else(|| self.measure_at(&found), Ok)
    }

    /// Measures a circle where it was found, without a capture that slipped.
    fn measure_at(&self, found: &Found) -> Result<Measured> {
        let Self { captures, frames, options, c_deg, angle_of, .. } = *self;
        let mut found = found.clone();
        let mut followed = follow(captures, frames, &found, angle_of)?;
        if found.without.is_empty()
            && let Some(slipped) = slip::at_fault(&followed.arcs, &followed.robust)
        {
            found.without.push(slipped);
            followed = follow(captures, frames, &found, angle_of)?;
        }
        let strays = seen::strays(captures.len(), angle_of, &followed);
        if !strays.is_empty() {
            found.without.extend(strays);
            followed = follow(captures, frames, &found, angle_of)?;
        }
        let seen = seen::seen(captures, (c_deg, angle_of), followed)?;
        let mut measured = finish(captures, options, &seen)?;
        let told = self.attempts.left_out(&measured);
        measured.report.warnings.extend(told);
        let mut beside = [found.fainter_mm, found.stronger_mm];
        if c_deg.len() > 1 && beside.iter().any(Option::is_some) {
            let seen = self.attempts.beside(&measured);
            // What is beside the rim about one centre may be the rim at another table angle.
            beside.iter_mut().zip(seen).for_each(|(edge, seen)| *edge = edge.and(seen));
        }
        agreement::fainter_rim(beside[0], options, &mut measured.report);
        agreement::stronger_edge(beside[1], options, &mut measured.report.warnings);
        Ok(measured)
    }
}

/// How many captures were left out.
fn left_out(measured: &Measured) -> usize {
    measured.report.captures.iter().filter(|c| c.edge_points == 0).count()
}

fn doubtful(measured: &Measured) -> bool {
    measured.report.form_rms_mm >= DOUBTFUL_MM
}

fn unseen(nominal_mm: Option<f64>) -> Error {
    let named = nominal_mm.map(|d| format!(" of about {d} mm"));
    let option = if named.is_some() { "--diameter-mm, " } else { "" };
    Error::measure(
        "captures",
        format!("no rim of a rod{} is seen on which they agree", named.unwrap_or_default()),
        format!(
            "check {option}the pictures (they should show several sides of the rod), the machine positions (x_mm, y_mm) and the calibration's signs"
        ),
    )
}
