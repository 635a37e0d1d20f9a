//! The rounds in which sectors are matched with the common profile, sorted, and the profile made again; see [`locate`](super::locate()).

use crate::edge::hidden::is_known;
use crate::edge::levels::{Curve, median};
use crate::edge::locate::Options;
use crate::edge::noise::Noise;
use crate::edge::pool::Sectors;
use crate::edge::sector::{
    Bin, Match, NO_MATCH, PARAMETERS, Prior, SHIFT, bins_of, fit_sector, join, search,
};
use crate::edge::shape::Shape;
use crate::edge::{Profiles, Template};

/// Variance of gains and stretches that nothing holds.
const LOOSE: f64 = 0.09;

/// Least standard deviation of a sector's own tail, as a part of the step.
const LEAST_TAIL: f64 = 1e-4;

/// A sector's shift that moves by less than this part of its standard deviation has been found: while the common profile still changes,
/// and at last.
const SETTLED: [f64; 2] = [0.5, 0.1];

/// Softnesses from its middle where an edge has ended: beyond, a profile is straight over a softness.
const ENDED: f64 = 3.5;

/// Least noise assumed, as a part of the step: clipped levels and rounding look perfect and are not.
const LEAST_NOISE: f64 = 0.003;

/// Rounds in which levels, gains and tails are found together, where tails have bent the others.
const TOGETHER: usize = 3;

/// Sectors below which there is no edge to speak of.
const FEWEST: f64 = 6.0;

/// What is known after a round.
pub(super) struct Rounds<'a> {
    pub(super) profiles: &'a Profiles,
    pub(super) closed: bool,
    options: Options,
    sectors: Vec<Vec<Bin>>,
    /// Which sectors have pixels enough.
    enough: Vec<bool>,
    /// 1 for sectors in use, 0 for others.
    pub(super) alive: Vec<f64>,
    pub(super) curve: Curve,
    /// The common profile.
    pub(super) template: Template,
    /// Its first guess' range, counts.
    range: f64,
    /// The band's width, squared.
    pub(super) far_px2: f64,
    priors: Vec<Prior>,
    pub(super) matches: Vec<Match>,
    pub(super) noise: Noise,
    /// Rounds that are needed besides.
    pub(super) more: usize,
}

impl<'a> Rounds<'a> {
    /// What the profiles tell before the first round. `None` where too few sectors have pixels, or nothing varies.
    pub(super) fn new(profiles: &'a Profiles, closed: bool, options: Options) -> Option<Self> {
        let sectors: Vec<Vec<Bin>> =
            (0..profiles.sectors()).map(|s| bins_of(profiles, s)).collect();
        let n = sectors.len();
        // Whole or nearly so: the frame's border cuts some sectors short. Bins tell nothing: an edge along a row or
        // column of pixels fills few of them, as well as any other.
        let pixels = |bins: &Vec<Bin>| bins.iter().map(|b| b.count).sum::<f64>();
        let all: Vec<f64> = sectors.iter().map(pixels).collect();
        let seen: Vec<f64> = all.iter().map(|c| f64::from(u8::from(*c > 0.0))).collect();
        let usual = median(&all, &seen);
        let enough: Vec<bool> =
            sectors.iter().map(|bins| bins.len() >= 4 && pixels(bins) >= 0.6 * usual).collect();
        let alive: Vec<f64> = enough.iter().map(|e| f64::from(u8::from(*e))).collect();
        if alive.iter().sum::<f64>() < FEWEST {
            return None;
        }
        let template = median_profile(profiles, &alive)?;
        let range = spread_of(&template);
        if range <= 0.0 {
            return None;
        }
        let wide = 100.0 * range * range;
        let far_px2 = (profiles.band.inside_px + profiles.band.outside_px).powi(2);
        let nothing = Prior {
            level: (0.0, wide),
            gain: (1.0, 100.0),
            stretch: (0.0, if profiles.hidden.is_some() { LOOSE } else { 1e-4 }),
            shift: (0.0, 100.0 * far_px2),
            tail: (0.0, 1e-12 * range * range),
        };
        Some(Self {
            profiles,
            closed,
            options,
            sectors,
            enough,
            alive,
            curve: Curve::new(n, closed),
            noise: Noise::white((0.05 * range).powi(2), &template),
            template,
            range,
            far_px2,
            priors: vec![nothing; n],
            matches: Vec::new(),
            more: 0,
        })
    }

    /// All sectors as they are seen now.
    pub(super) fn all(&self) -> Sectors<'_> {
        Sectors {
            bins: &self.sectors,
            alive: &self.alive,
            curve: &self.curve,
            noise: &self.noise,
            hidden: self.profiles.hidden,
        }
    }

    /// Matches every sector in use with the common profile, which `shape` is of.
    pub(super) fn match_sectors(&mut self, shape: &Shape, last: bool) {
        let straight_px = shape.edge.softness_px;
        let many = self.noise.joined(straight_px, self.template.step_px);
        let settled = SETTLED[usize::from(last)];
        let (mut joined, mut whitening) = (Vec::new(), Vec::new());
        let (noise, band) = (&self.noise, &self.profiles.band);
        let match_one = |s: usize| {
            if self.alive[s] == 0.0 {
                return NO_MATCH;
            }
            let start = self.start(s);
            let place_px = shape.edge.distance_px + start[SHIFT];
            join(&self.sectors[s], place_px, ENDED * straight_px, many, &mut joined);
            fit_sector(&joined, shape, self.priors[s], noise, start, settled, band, &mut whitening)
        };
        self.matches = (0..self.sectors.len()).map(match_one).collect();
    }

    /// Where a sector's match starts from.
    fn start(&self, sector: usize) -> [f64; PARAMETERS] {
        let prior = self.priors[sector];
        match self.matches.get(sector) {
            Some(m) if m.shift_variance.is_finite() => {
                let (mean, variance) = prior.shift;
                let astray = (m.shift - mean).powi(2) > variance;
                if astray { prior.at(mean) } else { m.parameters() }
            }
            _ => prior.at(search(&self.sectors[sector], &self.template, self.profiles)),
        }
    }

    /// Leaves out what shows no edge or another one. `None` where too few are left.
    pub(super) fn sort_out(&mut self, round: usize) -> Option<()> {
        let misfit: Vec<f64> = self.matches.iter().map(|m| m.misfit).collect();
        let typical_misfit = median(&misfit, &self.alive);
        let gains: Vec<f64> = self.matches.iter().map(|m| m.gain).collect();
        let typical = median(&gains, &self.alive);
        let is_alive = |(m, enough): (&Match, &bool)| {
            let good = m.gain > self.options.least_gain * typical
                && m.gain < 4.0 * typical
                && m.misfit < self.options.worst_fit * typical_misfit;
            // A first round only sorts out what has no edge at all.
            let first = round == 0 && m.gain > 0.1 * typical;
            *enough && m.shift_variance.is_finite() && (good || first)
        };
        self.alive = (self.matches.iter().zip(&self.enough))
            .map(|sector| f64::from(u8::from(is_alive(sector))))
            .collect();
        (self.alive.iter().sum::<f64>() >= FEWEST).then_some(())
    }

    /// Learns the noise from what the matches leave over; whether it was asked if that goes together.
    pub(super) fn learn_noise(&mut self, shape: &Shape, round: usize, last: bool) -> bool {
        let (sectors, matches, alive) = (&self.sectors, &self.matches, &self.alive);
        self.noise.learn_sizes(shape, sectors, matches, alive);
        self.noise.pixel2 =
            self.noise.pixel2.max(LEAST_NOISE * LEAST_NOISE * self.range * self.range);
        if round == 0 {
            self.noise.shape2.fill(0.0);
        } else if !last {
            self.noise.learn_correlation(shape, sectors, matches, alive);
        }
        round > 0 && !last
    }

    /// Holds the sectors' parameters in the next round by what they were in this one.
    pub(super) fn hold_sectors(&mut self, round: usize) {
        let (matches, alive) = (&self.matches, &self.alive);
        let may_be_bent =
            (1..=TOGETHER).contains(&round) && self.options.tinted && !self.noise.is_correlated();
        let bent = update_priors(
            round,
            may_be_bent,
            &mut self.priors,
            matches,
            alive,
            &self.curve,
            self.range,
        );
        if bent {
            self.more = TOGETHER - 1;
        }
        if self.noise.is_correlated() && !self.closed {
            // A tail of an arc's own sector would be texture, which the noise has already: only the tails' slow curve is left. Round a closed
            // contour what fades on one side must be followed, and what texture does to both sides cancels from the centre.
            for p in &mut self.priors {
                p.tail.1 = (LEAST_TAIL * self.range).powi(2);
            }
        }
        if self.profiles.hidden.is_some() {
            // Of a flank alone gain and stretch look much alike: what a round takes for one must not hold the next.
            for p in &mut self.priors {
                (p.gain, p.stretch) = ((1.0, LOOSE), (0.0, LOOSE));
            }
        }
    }

    /// The common profile made again.
    pub(super) fn renewed(&self, shape: &Shape) -> Option<Template> {
        self.all().pool(&self.template, shape, &self.matches).template(&self.template)
    }
}

/// The median over the sectors, bin by bin: the first guess of the common profile. Bins without pixels have their neighbour's level.
fn median_profile(profiles: &Profiles, alive: &[f64]) -> Option<Template> {
    let mut values = Vec::with_capacity(profiles.bins);
    let (mut last, mut known) = (f64::NAN, Vec::with_capacity(profiles.bins));
    let sectors = alive.iter().sum::<f64>();
    for b in 0..profiles.bins {
        let list: Vec<f64> = (0..profiles.sectors())
            .map(|s| f64::from(profiles.value[s * profiles.bins + b]))
            .collect();
        let weights: Vec<f64> = (0..profiles.sectors())
            .map(|s| if profiles.count[s * profiles.bins + b] > 0.0 { alive[s] } else { 0.0 })
            .collect();
        known.push(is_known(weights.iter().sum(), sectors));
        if weights.iter().any(|w| *w > 0.0) {
            last = median(&list, &weights);
        }
        values.push(last);
    }
    // The first may lie where the contour is too narrow for a pixel: a step there would pass for the edge.
    let first = values.iter().copied().find(|v| v.is_finite()).unwrap_or(0.0);
    values.iter_mut().take_while(|v| v.is_nan()).for_each(|v| *v = first);
    let mut template =
        Template { start_px: profiles.bin_middle_px(0), step_px: profiles.band.bin_px, values };
    if let Some(side) = profiles.hidden {
        template.mirror(&known, side)?;
    }
    template.smooth(2);
    template.denoise();
    Some(template)
}

fn spread_of(template: &Template) -> f64 {
    let (lo, hi) = template
        .values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
    hi - lo
}

/// Of values about their mean.
fn variance(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n
}

/// Priors for the next round: curves through levels and gains, as wide as these scatter beyond their noise. Tells whether
/// levels, gains and tails are to be found together.
fn update_priors(
    round: usize,
    may_be_bent: bool,
    priors: &mut [Prior],
    matches: &[Match],
    alive: &[f64],
    curve: &Curve,
    range: f64,
) -> bool {
    let of = |f: fn(&Match) -> f64| matches.iter().map(f).collect::<Vec<f64>>();
    let (levels, level_sd) = curve.fit(&of(|m| m.level), alive);
    let (gains, gain_sd) = curve.fit(&of(|m| m.gain), alive);
    let usual_tail = median(&of(|m| m.tail), alive);
    let (tails, tail_sd) = curve.fit(&of(|m| m.tail), alive);
    // The first round has no tails: what fades on one side has bent levels and gains there. Where that shows beside pixel noise alone, they are
    // found together.
    let together = may_be_bent && variance(&tails) > 0.0;
    let bent = |curve: &[f64]| if together { variance(curve) } else { 0.0 };
    let beyond = |sd: f64, noise: f64, least: f64| {
        (sd * sd - noise).max(0.1 * noise.min(sd * sd)).max(least)
    };
    let level_variance =
        beyond(level_sd, median(&of(|m| m.level_variance), alive), (1e-4 * range).powi(2))
            + bent(&levels);
    let gain_variance =
        beyond(gain_sd, median(&of(|m| m.gain_variance), alive), 1e-8) + bent(&gains);
    let stretches = of(|m| m.stretch);
    let (_, stretch_sd, _) = curve.fit_order(0, &stretches, alive);
    // The first round has no stretch: a common profile must exist before sectors can differ from it.
    let stretch_variance = if round == 0 {
        0.09
    } else {
        beyond(stretch_sd, median(&of(|m| m.stretch_variance), alive), 1e-6)
    };
    let tail_variance = if round == 0 || together {
        0.01 * range * range
    } else {
        beyond(tail_sd, median(&of(|m| m.tail_variance), alive), (LEAST_TAIL * range).powi(2))
    };
    // Wide enough for any real wander, but not for another edge.
    let known: Vec<f64> = alive
        .iter()
        .zip(matches)
        .map(|(a, m)| if m.measured.1.is_finite() { *a } else { 0.0 })
        .collect();
    let (shifts, shift_sd, _) = curve.fit_order(2, &of(|m| m.measured.0), &known);
    let shift_variance = (3.0 * shift_sd).powi(2).max(1e-6);
    for (s, prior) in priors.iter_mut().enumerate() {
        *prior = Prior {
            shift: (shifts[s], shift_variance),
            level: (levels[s], level_variance),
            gain: (gains[s], gain_variance),
            stretch: (0.0, stretch_variance),
            tail: (if round == 0 { 0.0 } else { tails[s] - usual_tail }, tail_variance),
        };
    }
    together
}
