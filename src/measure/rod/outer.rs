//! Which edge is the rod? A chamfer's inner edge is often the stronger one, and on one side of the light the only
//! strong one: a circle through the rim on one side and the chamfer on the other looks as good.
//!
//! Every capture's steps of brightness near the circle that was found are read once; circles are then tried all
//! about it. About the right centre there are two, the rim and the chamfer's edge; about a wrong one there is one at
//! most. The outermost that over half as many captures support as any is the rod.

use nalgebra::Vector2;
use rayon::prelude::*;

use crate::camera::View;
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::rod::Capture;
use crate::measure::rod::sight::Sight;

/// How far the centre may be off at first.
const SHIFT_MM: f64 = 0.8;
/// How far it may be off at the second look: as much as a circle through the rim here and the chamfer there.
const NEARER_MM: f64 = 0.4;
/// How far apart the rod may be at two table angles: twice as far as it sits from the axis.
const ECCENTRIC_MM: f64 = 0.5;
/// Width of a bin of distance: finer than any chamfer, and two pixels at least.
const BIN_MM: f64 = 0.01;
const LEAST_BIN_PX: f64 = 2.0;
/// The same at first, while the centre is not known.
const FAR_BIN_MM: f64 = 0.02;
/// Least width of a chamfer that is told from its rim while the centres are not known.
pub(super) const CHAMFER_MM: f64 = 0.1;
/// Two edges that are nearer part where the support between them is less than this share of theirs.
const DIP: f32 = 0.9;
/// Bins that edges are apart at least: the steps of nearer ones overlap.
const APART: usize = 4;
/// A capture half believes in an edge of this many standard errors: turning lines and texture have ten.
const BELIEVED: f32 = 20.0;
/// Centres that are looked at closely, and how many steps of the first look they are apart: one likely circle must not have all.
const CLOSER: usize = 12;
const START_STEPS: f64 = 2.5;
/// Support that the rod's circle needs, as a share of all captures.
const LEAST: f32 = 0.17;
/// Share of the best circle's support that an outer one needs.
const SUPPORTED: f32 = 0.55;
/// The same for one at the nominal diameter, where no clearer one is.
const NAMED: f32 = 0.3;
/// How near it is to that, as a part of the radius.
pub(super) const NAMED_WITHIN: f64 = 0.01;
/// The same for one that is worth a word: texture and shadows have less.
pub(super) const FAINTER: f32 = 0.45;

/// The rod's circle as it was found.
#[derive(Clone)]
pub(super) struct Found {
    /// Its centre at each table angle, machine coordinates.
    pub centers: Vec<Vector2<f64>>,
    /// Its radius.
    pub radius_mm: f64,
    /// Radius of the next edge inside.
    pub inner_mm: Option<f64>,
    /// Radius of an edge farther out that fewer captures show, or all of them more faintly; or that is clear, but not of the nominal size.
    pub fainter_mm: Option<f64>,
    /// Whether most of them show it.
    pub is_common: bool,
    /// Radius of an edge inside beside which this one is faint: a chamfer's, or this one is no rim.
    pub stronger_mm: Option<f64>,
    /// Captures that are left out, as the others agree without them.
    pub without: Vec<usize>,
}

impl Found {
    /// The fainter edge, where most captures show it: of two concentric edges the outer is the rod's.
    pub(super) fn common_rim(&self) -> Option<Self> {
        let radius_mm = self.fainter_mm.filter(|_| self.is_common)?;
        let inside = Some(self.radius_mm);
        Some(Self {
            radius_mm,
            inner_mm: inside,
            fainter_mm: None,
            is_common: false,
            stronger_mm: inside,
            ..self.clone()
        })
    }
}

/// The captures in which a circle is looked for: of one table angle, or all, or all but one.
#[derive(Clone, Copy)]
pub(super) struct Captures<'a> {
    pub captures: &'a [Capture],
    pub angle_of: &'a [usize],
    pub frames: &'a [(Frame, View)],
    pub only: Option<usize>,
    pub without: Option<usize>,
}

impl Captures<'_> {
    /// Whether a capture is one of those.
    pub fn has(&self, capture: usize) -> bool {
        self.only.is_none_or(|only| self.angle_of[capture] == only) && self.without != Some(capture)
    }

    fn pixel_mm(&self) -> f64 {
        self.frames.iter().map(|(_, v)| v.pixel_mm()).sum::<f64>() / self.frames.len() as f64
    }

    /// Bins as wide as pixels of the captures ask for.
    pub(super) fn bin_mm(&self) -> f64 {
        BIN_MM.max(LEAST_BIN_PX * self.pixel_mm())
    }

    /// The steps of brightness about a circle in machine coordinates.
    pub(super) fn sights(&self, about: Circle, bin_mm: f64) -> Vec<Sight> {
        let pixel_mm = self.pixel_mm();
        let each = self.captures.par_iter().zip(self.angle_of).zip(self.frames).enumerate();
        each.filter(|(i, _)| self.has(*i))
            .filter_map(|(_, ((capture, &angle), (frame, view)))| {
                let about = Circle { center: about.center - capture.position_mm, ..about };
                Sight::new(frame, view, about, [pixel_mm, bin_mm], angle)
            })
            .collect()
    }
}

/// Circles near `rough` about the centres that are likeliest at a first look, best first: far from the centre a shift bends the arcs;
/// once it is known roughly, [`rim`] looks again from there.
pub(super) fn likely(seen: Captures, rough: Circle) -> Vec<Circle> {
    let bin_mm = seen.bin_mm().max(FAR_BIN_MM);
    let sights = seen.sights(rough, bin_mm);
    let search = Search { bin_mm, sights: sights.iter().collect() };
    let shifts = search.centers(SHIFT_MM);
    shifts.into_iter().map(|shift| Circle { center: rough.center + shift, ..rough }).collect()
}

/// The rod's circle near `about` in the captures, where `nominal_mm` may say which of its edges is meant: about one centre first, then
/// for each table angle its own, for the rod may be eccentric. `None` where the captures agree on no circle.
pub(super) fn rim(seen: Captures, about: Circle, nominal_mm: Option<f64>) -> Option<Found> {
    let bin_mm = seen.bin_mm();
    let sights = seen.sights(about, bin_mm);
    let inside_mm = sights.first()?.inside_mm;
    let all = Search { bin_mm, sights: sights.iter().collect() };
    let shift = *all.centers(NEARER_MM).first()?;
    let support = all.support(|_| shift, true);
    let most = support.iter().copied().fold(0.0, f32::max);
    if most < LEAST * sights.len() as f32 {
        return None;
    }
    let peaks_above = |share: f32| peaks(&support, share * most);
    let peaks = peaks_above(SUPPORTED);
    let radius_mm = |b: usize| about.radius + (b as f64 + 0.5) * bin_mm - inside_mm;
    let named = nominal_mm.and_then(|d| {
        let gap = |b: &usize| (radius_mm(*b) - 0.5 * d).abs();
        let nearest = |peaks: &[usize]| {
            let nearest = peaks.iter().min_by(|a, b| gap(a).total_cmp(&gap(b)))?;
            (gap(nearest) < NAMED_WITHIN * 0.5 * d).then_some(*nearest)
        };
        nearest(&peaks).or_else(|| nearest(&peaks_above(NAMED)))
    });
    let outer = named.or(peaks.last().copied())?;
    let gap = (CHAMFER_MM / bin_mm).ceil() as usize;
    let inner = peaks.iter().copied().rfind(|&b| b + gap <= outer);
    let edges: Vec<usize> = std::iter::once(outer).chain(inner).collect();
    let angles = seen.angle_of.iter().max()? + 1;
    let centers = (0..angles).map(|a| {
        let own: Vec<&Sight> = sights.iter().filter(|s| s.angle == a).collect();
        // An angle that shows nothing at all is refused by name when its edges are followed.
        let alone = angles == 1 || own.is_empty();
        let search = Search { bin_mm, sights: own };
        about.center + if alone { shift } else { search.recentre(shift, &edges) }
    });
    let centers: Vec<Vector2<f64>> = centers.collect();
    // About one centre an eccentric rod's own rim lies farther out at some angles, and nearer in at others.
    let own = |sight: &Sight| centers[sight.angle] - about.center;
    let support = all.support(own, true);
    let share = if named.is_some() { SUPPORTED } else { FAINTER };
    let least = share * support.iter().copied().fold(0.0, f32::max);
    let fainter = self::peaks(&support, least).into_iter().rfind(|&b| b >= outer + gap);
    // A nominal diameter says which edge is meant.
    let open = nominal_mm.is_none();
    let common = if open { all.common_step(own, outer) } else { None };
    let stronger = if open { all.stronger_inside(own, outer, gap) } else { None };
    Some(Found {
        centers,
        radius_mm: radius_mm(outer),
        inner_mm: inner.map(radius_mm),
        fainter_mm: common.or(fainter).map(radius_mm),
        is_common: common.is_some(),
        stronger_mm: stronger.map(radius_mm),
        without: seen.without.into_iter().collect(),
    })
}

/// The rim just outside a circle that was measured: about one centre a narrow chamfer's edge and the rim of an eccentric rod are one, about
/// each table angle's own they part.
pub(super) fn just_outside(
    seen: Captures,
    centers: Vec<Vector2<f64>>,
    radius_mm: f64,
) -> Option<Found> {
    let bin_mm = seen.bin_mm();
    let center = centers.iter().sum::<Vector2<f64>>() / centers.len().max(1) as f64;
    let sights = seen.sights(Circle { center, radius: radius_mm }, bin_mm);
    let here = (sights.first()?.inside_mm / bin_mm) as usize;
    let all = Search { bin_mm, sights: sights.iter().collect() };
    let support = all.support(|sight| centers[sight.angle] - center, true);
    let end = here + APART + (CHAMFER_MM / bin_mm).ceil() as usize;
    let inner = support.get(here.checked_sub(APART)?..end + 1)?;
    let own = inner[..2 * APART].iter().copied().fold(0.0, f32::max);
    let outer = (here + APART..end).rfind(|&b| {
        let dip = support[here..b].iter().copied().fold(f32::INFINITY, f32::min);
        let is_peak = support[b] >= support[b - 1] && support[b] > support[b + 1];
        is_peak && support[b] >= SUPPORTED * own && dip < DIP * own.min(support[b])
    })?;
    Some(Found {
        centers,
        radius_mm: radius_mm + (outer - here) as f64 * bin_mm,
        inner_mm: Some(radius_mm),
        fainter_mm: None,
        is_common: false,
        stronger_mm: None,
        without: Vec::new(),
    })
}

/// The captures together.
pub(super) struct Search<'a> {
    pub bin_mm: f64,
    pub sights: Vec<&'a Sight>,
}

impl Search<'_> {
    /// The shifts, up to `most_mm`, under which the captures agree best on two circles, likeliest first, clear of each other.
    fn centers(&self, most_mm: f64) -> Vec<Vector2<f64>> {
        let value =
            |shift: Vector2<f64>, fine: bool| self.two_clearest(&self.support(|_| shift, fine));
        let coarse_mm = 4.0 * self.bin_mm;
        let mut all: Vec<(f32, Vector2<f64>)> =
            disc(most_mm, coarse_mm).map(|shift| (value(shift, false), shift)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut starts: Vec<Vector2<f64>> = Vec::with_capacity(CLOSER);
        for (_, start) in all {
            let apart = |s: &Vector2<f64>| (s - start).norm() > START_STEPS * coarse_mm;
            if starts.len() < CLOSER && starts.iter().all(apart) {
                starts.push(start);
            }
        }
        let refine = |start| self.climb(start, |shift| value(shift, true));
        let mut refined: Vec<(f32, Vector2<f64>)> = starts.into_iter().map(refine).collect();
        refined.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut centers: Vec<Vector2<f64>> = Vec::with_capacity(CLOSER);
        for (_, center) in refined {
            if centers.iter().all(|c| (c - center).norm() > CHAMFER_MM) {
                centers.push(center);
            }
        }
        centers
    }

    /// Support of the two circles about one centre that have most of it, clear of each other: of a rim and its chamfer's edge. A circle
    /// through the rim on one side and the chamfer on the other has as much as each, but no second beside it.
    fn two_clearest(&self, support: &[f32]) -> f32 {
        let gap = (CHAMFER_MM / self.bin_mm).ceil() as usize;
        let most = |from: &[f32]| from.iter().copied().fold(0.0, f32::max);
        let clearest = (0..support.len()).max_by(|&a, &b| support[a].total_cmp(&support[b]));
        clearest.map_or(0.0, |b| {
            let inside = &support[..b.saturating_sub(gap)];
            let outside = &support[(b + gap).min(support.len())..];
            support[b] + most(inside).max(most(outside))
        })
    }

    /// The shift near `start` under which the captures agree best on circles in these bins.
    fn recentre(&self, start: Vector2<f64>, bins: &[usize]) -> Vector2<f64> {
        let value = |shift: Vector2<f64>, fine: bool| -> f32 {
            let support = self.support(|_| shift, fine);
            bins.iter().map(|&b| support[b - 1].max(support[b]).max(support[b + 1])).sum()
        };
        let rough = disc(ECCENTRIC_MM, 4.0 * self.bin_mm)
            .map(|shift| (value(start + shift, false), start + shift))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(start, |best| best.1);
        self.climb(rough, |shift| value(shift, true)).1
    }

    /// The best value and its shift that small steps from `start` lead to.
    fn climb(
        &self,
        start: Vector2<f64>,
        value: impl Fn(Vector2<f64>) -> f32,
    ) -> (f32, Vector2<f64>) {
        let mut best = (value(start), start);
        for step in [2.0, 1.0, 0.5] {
            for _ in 0..6 {
                let before = best.0;
                for i in 0..8 {
                    let (s, c) = (std::f64::consts::FRAC_PI_4 * f64::from(i)).sin_cos();
                    let p = best.1 + step * self.bin_mm * Vector2::new(c, s);
                    let v = value(p);
                    if v > best.0 {
                        best = (v, p);
                    }
                }
                if best.0 <= before {
                    break;
                }
            }
        }
        best
    }

    /// How many captures support a circle about their shifted centres, for every radius.
    pub(super) fn support(&self, shift: impl Fn(&Sight) -> Vector2<f64>, fine: bool) -> Vec<f32> {
        let bins = self.sights.first().map_or(0, |s| s.bins);
        let mut sum = vec![0.0f32; bins];
        let mut own = vec![0.0f32; bins];
        for sight in &self.sights {
            sight.evidence(shift(sight), fine, self.bin_mm, &mut own);
            for (s, z) in sum.iter_mut().zip(&own) {
                *s += z.abs() / (z.abs() + BELIEVED);
            }
        }
        sum
    }
}

/// Where the support has peaks of so much and more.
pub(super) fn peaks(support: &[f32], least: f32) -> Vec<usize> {
    let high = |&b: &usize| {
        support[b] >= least && support[b] >= support[b - 1] && support[b] > support[b + 1]
    };
    (1..support.len() - 1).filter(high).collect()
}

/// Shifts on a grid, up to `most_mm`.
fn disc(most_mm: f64, step_mm: f64) -> impl Iterator<Item = Vector2<f64>> {
    let span = (most_mm / step_mm).ceil() as i32;
    (-span..=span)
        .flat_map(move |i| (-span..=span).map(move |j| (i, j)))
        .map(move |(i, j)| step_mm * Vector2::new(f64::from(i), f64::from(j)))
        .filter(move |shift| shift.norm() <= most_mm)
}
