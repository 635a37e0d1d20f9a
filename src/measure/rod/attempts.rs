//! Where the rod's circle may be: the likeliest places first, about one centre or at each table angle by itself.

use nalgebra::Vector2;
use rayon::prelude::*;

use crate::camera::View;
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::rod::astray;
use crate::measure::rod::beside;
use crate::measure::rod::outer::{self, Captures, Found};
use crate::measure::rod::seek::{self, Voter};
use crate::measure::rod::{Capture, Measured};

/// Circles at two table angles that differ by more are not those of one rod.
const ONE_ROD_MM: f64 = 0.05;

/// The same of single arcs, as a part of the radius.
const ONE_ARC: f64 = 0.05;

/// What circles are sought in.
pub(super) struct Attempts<'a> {
    captures: &'a [Capture],
    angle_of: &'a [usize],
    frames: &'a [(Frame, View)],
    nominal_mm: Option<f64>,
    /// Edges of each capture.
    voters: Vec<Vec<Voter>>,
    /// Least and most radius.
    bounds_mm: (f64, f64),
}

impl<'a> Attempts<'a> {
    /// Reads the captures' edges.
    pub(super) fn new(
        captures: &'a [Capture],
        angle_of: &'a [usize],
        frames: &'a [(Frame, View)],
        nominal_mm: Option<f64>,
    ) -> Self {
        let each = frames.par_iter().enumerate();
        let voters = each
            .map(|(i, (frame, view))| seek::voters(frame, view, captures[i].position_mm, i))
            .collect();
        let field_mm = frames
            .iter()
            .map(|(f, v)| v.pixel_mm() * f.width().max(f.height()) as f64)
            .fold(0.0, f64::max);
        let bounds_mm = match nominal_mm {
            Some(d) => (0.4 * d, 0.6 * d),
            None => (0.12 * field_mm, 0.12 * field_mm + 4.0 * field_mm),
        };
        Self { captures, angle_of, frames, nominal_mm, voters, bounds_mm }
    }

    /// Circles about which all captures together may show the rod, likeliest first.
    pub(super) fn likely(&self) -> Vec<Circle> {
        self.likely_in(None)
    }

    /// The rod's circle near one of those.
    pub(super) fn rim(&self, about: Circle) -> Option<Found> {
        outer::rim(self.seen(None), about, self.nominal_mm)
    }

    /// The rim of nominal size, however faint beside other edges. `None` where there is none, or no size was named.
    pub(super) fn named(&self) -> Option<Found> {
        const CENTERS: usize = 3;
        let radius = 0.5 * self.nominal_mm?;
        let rough = Circle { radius, ..self.rough(self.seen(None))? };
        let likely = outer::likely(self.seen(None), rough);
        let mut found = likely.into_iter().take(CENTERS).filter_map(|about| self.rim(about));
        found.find(|found| (found.radius_mm - radius).abs() < outer::NAMED_WITHIN * radius)
    }

    /// The rim just outside a circle that was measured. `None` where there is none, or the nominal diameter says which is meant.
    pub(super) fn just_outside(&self, measured: &Measured) -> Option<Found> {
        let radius_mm = 0.5 * measured.report.diameter_mm;
        let seen = self.nominal_mm.is_none().then(|| self.seen(None))?;
        outer::just_outside(seen, self.centers(measured), radius_mm)
    }

    /// Radii of the edges beside a circle that was measured: fainter outside, stronger inside.
    pub(super) fn beside(&self, measured: &Measured) -> [Option<f64>; 2] {
        beside::beside(self.seen(None), &self.centers(measured), 0.5 * measured.report.diameter_mm)
    }

    /// The warnings about captures that were left out.
    pub(super) fn left_out(&self, measured: &Measured) -> Vec<String> {
        let places = measured.circles.iter().zip(self.captures);
        let rim = |(c, capture): (&Circle, &Capture)| Circle {
            center: c.center + capture.position_mm,
            ..*c
        };
        let rims: Vec<Circle> = places.map(rim).collect();
        let reports = &measured.report.captures;
        astray::left_out(reports, &astray::astray_mm(reports, &self.voters, &rims))
    }

    /// The rod's centre at every table angle, those that were left out too.
    fn centers(&self, measured: &Measured) -> Vec<Vector2<f64>> {
        let angles = self.angle_of.iter().max().map_or(0, |last| last + 1);
        let first = |angle| self.angle_of.iter().position(|a| *a == angle);
        let center = |i: usize| measured.circles[i].center + self.captures[i].position_mm;
        (0..angles).filter_map(first).map(center).collect()
    }

    /// The rim that all captures but one show: one whose position is wrong may lead all astray.
    pub(super) fn without(&self, capture: usize) -> Option<Found> {
        let seen = Captures { without: Some(capture), ..self.seen(None) };
        let about = *outer::likely(seen, self.rough(seen)?).first()?;
        outer::rim(seen, about, self.nominal_mm)
    }

    /// The circle at each of several table angles found by itself: a rod far off the axis shows no common one. `None` where one
    /// shows none or they are not of one size.
    pub(super) fn apart(&self) -> Option<Found> {
        let angles = self.angle_of.iter().max()? + 1;
        let own = |angle: usize| {
            let all = self.captures.iter().zip(self.angle_of);
            all.filter(move |(_, a)| **a == angle).map(|(capture, _)| capture)
        };
        if angles < 2 {
            return None;
        }
        let found = |angle| {
            let about = *self.likely_in(Some(angle)).first()?;
            outer::rim(self.seen(Some(angle)), about, self.nominal_mm)
        };
        let each = (0..angles).map(found).collect::<Option<Vec<Found>>>()?;
        let mut radii: Vec<f64> = each.iter().map(|found| found.radius_mm).collect();
        radii.sort_by(f64::total_cmp);
        let radius_mm = radii[angles / 2];
        let centers = each.iter().enumerate().map(|(angle, found)| {
            let (center, larger) = (found.centers[angle], found.radius_mm - radius_mm);
            let often = own(angle).count() > 1;
            let most = if often { ONE_ROD_MM } else { ONE_ARC * radius_mm };
            // A single arc hardly tells a larger radius from a centre farther away: the arc stays where it is.
            let arc = own(angle).next()?.position_mm - center;
            let moved = if often { Vector2::zeros() } else { arc.normalize() * larger };
            (larger.abs() < most).then_some(center + moved)
        });
        let centers = centers.collect::<Option<Vec<_>>>()?;
        let middle = each.into_iter().find(|found| found.radius_mm == radius_mm)?;
        Some(Found { centers, ..middle })
    }

    /// Likely circles in the captures of one table angle `only` or in all.
    fn likely_in(&self, only: Option<usize>) -> Vec<Circle> {
        let seen = self.seen(only);
        self.rough(seen).map_or_else(Vec::new, |rough| outer::likely(seen, rough))
    }

    /// The circle about which most edges gather.
    fn rough(&self, seen: Captures) -> Option<Circle> {
        let asked = self.voters.iter().enumerate().filter(|(i, _)| seen.has(*i));
        let voters: Vec<Voter> = asked.flat_map(|(_, own)| own).copied().collect();
        seek::rim(&voters, self.captures.len(), self.bounds_mm)
    }

    fn seen(&self, only: Option<usize>) -> Captures<'_> {
        let Self { captures, angle_of, frames, .. } = *self;
        Captures { captures, angle_of, frames, only, without: None }
    }
}
