//! Finds the edge in every sector by matching its profile with the profile common to all of them.
//!
//! Sector k is modelled as a_k + g_k T(x) + h_k H(x) at x = x0 + (1 + s_k)(d - δ_k - x0): the common profile T, shifted by δ_k, on a level a_k, with a gain
//! g_k, and made steeper by s_k about the edge at x0 (focus and rims vary along a real edge, and a clipped
//! profile then leans). H fades away outside the edge: heat tint and shadow are stronger on one side than on the other, and where they
//! are, the edge would seem to lie further out. T and the sectors' parameters are found in turn. Where along the profile sectors differ from T by more than
//! pixel noise (bevels, burrs, reflections beside the edge), the profile counts for less. Levels and gains are held by priors around curves that vary
//! slowly along the contour, as tightly as the data show them to (free levels would cost half of the information): on a textured
//! picture that lets them float. The tail of an arc's own sector would be texture there, which the noise has already and which pulled every edge inwards: it keeps to
//! the tails' slow curve. Where nothing but pixel noise shows, all sectors share one level and one gain ([`Sectors::plain`]),
//! which reaches the Cramer-Rao bound.

use crate::edge::blurred::Blurred;
use crate::edge::hidden::is_known;
use crate::edge::levels::{Curve, median};
use crate::edge::noise::Noise;
use crate::edge::pool::Sectors;
use crate::edge::sector::{Bin, Match, NO_MATCH, Prior, SHIFT, bins_of, fit_sector, join, search};
use crate::edge::shape::Shape;
use crate::edge::template::Step;
use crate::edge::{Profiles, Template};

/// How edges are located.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Rounds of shifts and common profile in turn.
    pub rounds: usize,
    /// A sector whose gain is under this part of the median shows no edge.
    pub least_gain: f64,
    /// A sector that fits worse than this many times the median variance is not used.
    pub worst_fit: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { rounds: 4, least_gain: 0.3, worst_fit: 25.0 }
    }
}

/// The edge in one sector.
#[derive(Debug, Clone, Copy)]
pub struct EdgePoint {
    /// Polar angle in the picture.
    pub angle_rad: f64,
    /// Distance of the edge from the contour along its normal.
    pub distance_px: f64,
    /// Variance of that distance from pixel noise.
    pub variance_px2: f64,
    /// Whether it may be used: the sector has pixels, shows the edge and fits the common profile.
    pub usable: bool,
}

impl Located {
    /// Whether the step is about the same all round, and the common profile's, rather than partly another's and partly none.
    pub fn is_even(&self) -> bool {
        const MOST_UNEVEN: f64 = 2.0;
        const USUAL: std::ops::Range<f64> = 0.75..1.35;
        let [low, middle, high] = self.gains;
        high < MOST_UNEVEN * low && USUAL.contains(&middle)
    }

    /// Typical standard deviation of an edge point from pixel noise.
    pub fn point_sd_px(&self) -> f64 {
        let (variances, weights): (Vec<f64>, Vec<f64>) =
            self.points.iter().map(|p| (p.variance_px2, f64::from(u8::from(p.usable)))).unzip();
        median(&variances, &weights).sqrt()
    }
}

/// All edges of a band.
#[derive(Debug, Clone)]
pub struct Located {
    /// One a sector.
    pub points: Vec<EdgePoint>,
    /// The common profile.
    pub template: Template,
    /// The edge in the common profile.
    pub step: Step,
    /// Standard deviation of a pixel about the model, in counts.
    pub noise: f64,
    /// Whether the edge is the same everywhere, but for its place and pixel noise.
    pub plain: bool,
    /// Whether errors go together along a profile, as those of brushed metal do.
    pub textured: bool,
    /// Share of the sectors with a usable edge.
    pub coverage: f64,
    /// Quartiles of the sectors' gains: the step there as a part of the common profile's.
    pub gains: [f64; 3],
    /// How far the edge would seem shifted if what fades away beside it, stronger on one side, were taken for edge.
    pub leaning_px: f64,
}

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

/// Locates the edge in every sector. `None` where too few sectors have pixels, or nothing varies.
pub fn locate(profiles: &Profiles, closed: bool, options: Options) -> Option<Located> {
    let sectors: Vec<Vec<Bin>> = (0..profiles.sectors()).map(|s| bins_of(profiles, s)).collect();
    let n = sectors.len();
    // Whole or nearly so: the frame's border cuts some sectors short. Bins tell nothing: an edge along a row or
    // column of pixels fills few of them, as well as any other.
    let pixels = |bins: &Vec<Bin>| bins.iter().map(|b| b.count).sum::<f64>();
    let all: Vec<f64> = sectors.iter().map(pixels).collect();
    let seen: Vec<f64> = all.iter().map(|c| f64::from(u8::from(*c > 0.0))).collect();
    let usual = median(&all, &seen);
    let enough = |bins: &Vec<Bin>| bins.len() >= 4 && pixels(bins) >= 0.6 * usual;
    let mut alive: Vec<f64> = sectors.iter().map(|b| f64::from(u8::from(enough(b)))).collect();
    if alive.iter().sum::<f64>() < 6.0 {
        return None;
    }
    let hidden = profiles.hidden;
    let mut template = median_profile(profiles, &alive)?;
    let range = spread_of(&template);
    if range <= 0.0 {
        return None;
    }
    let wide = 100.0 * range * range;
    let far = (profiles.band.inside_px + profiles.band.outside_px).powi(2);
    let nothing = Prior {
        level: (0.0, wide),
        gain: (1.0, 100.0),
        stretch: (0.0, if hidden.is_some() { LOOSE } else { 1e-4 }),
        shift: (0.0, 100.0 * far),
        tail: (0.0, 1e-12 * range * range),
    };
    let mut priors = vec![nothing; n];
    let mut matches: Vec<Match> = Vec::new();
    let mut noise = Noise::white((0.05 * range).powi(2), &template);
    let curve = Curve::new(n, closed);
    let (mut joined, mut whitening, mut learnt) = (Vec::new(), Vec::new(), false);
    for round in 0..options.rounds {
        // Texture hides what one more round would change.
        let last = round + 1 + usize::from(noise.is_correlated()) >= options.rounds;
        let shape = Shape::of(&template);
        let straight_px = shape.edge.softness_px;
        let many = noise.joined(straight_px, template.step_px);
        matches = (0..n)
            .map(|s| {
                if alive[s] == 0.0 {
                    return NO_MATCH;
                }
                let (prior, band) = (priors[s], &profiles.band);
                let start = match matches.get(s) {
                    Some(m) if m.shift_variance.is_finite() => {
                        let (mean, variance) = prior.shift;
                        let astray = (m.shift - mean).powi(2) > variance;
                        if astray { prior.at(mean) } else { m.parameters() }
                    }
                    _ => prior.at(search(&sectors[s], &template, profiles)),
                };
                let place_px = shape.edge.distance_px + start[SHIFT];
                join(&sectors[s], place_px, ENDED * straight_px, many, &mut joined);
                let settled = SETTLED[usize::from(last)];
                fit_sector(&joined, &shape, prior, &noise, start, settled, band, &mut whitening)
            })
            .collect();
        let misfit: Vec<f64> = matches.iter().map(|m| m.misfit).collect();
        let typical_misfit = median(&misfit, &alive);
        let gains: Vec<f64> = matches.iter().map(|m| m.gain).collect();
        let typical = median(&gains, &alive);
        for s in 0..n {
            let m = &matches[s];
            let good = enough(&sectors[s])
                && m.shift_variance.is_finite()
                && m.gain > options.least_gain * typical
                && m.gain < 4.0 * typical
                && m.misfit < options.worst_fit * typical_misfit;
            // A first round only sorts out what has no edge at all.
            let first = round == 0
                && enough(&sectors[s])
                && m.shift_variance.is_finite()
                && m.gain > 0.1 * typical;
            alive[s] = f64::from(u8::from(good || first));
        }
        if alive.iter().sum::<f64>() < 6.0 {
            return None;
        }
        noise.learn_sizes(&shape, &sectors, &matches, &alive);
        noise.pixel2 = noise.pixel2.max(LEAST_NOISE * LEAST_NOISE * range * range);
        if round == 0 {
            noise.shape2.fill(0.0);
        } else if !last {
            noise.learn_correlation(&shape, &sectors, &matches, &alive);
            learnt = true;
        }
        if last {
            break;
        }
        update_priors(round, &mut priors, &matches, &alive, &curve, range);
        if noise.is_correlated() && !closed {
            // A tail of an arc's own sector would be texture, which the noise has already: only the tails' slow curve is left. Round a closed
            // contour what fades on one side must be followed, and what texture does to both sides cancels from the centre.
            for p in &mut priors {
                p.tail.1 = (LEAST_TAIL * range).powi(2);
            }
        }
        if hidden.is_some() {
            // Of a flank alone gain and stretch look much alike: what a round takes for one must not hold the next.
            for p in &mut priors {
                (p.gain, p.stretch) = ((1.0, LOOSE), (0.0, LOOSE));
            }
        }
        let all = Sectors { bins: &sectors, alive: &alive, curve: &curve, noise: &noise, hidden };
        template = all.pool(&template, &shape, &matches).template(&template)?;
    }
    let tails: Vec<f64> = matches.iter().map(|m| m.tail).collect();
    let (tails, _) = curve.fit(&tails, &alive);
    let (mut blurred, mut plain) = (None, false);
    if learnt && !noise.is_correlated() {
        let all = Sectors { bins: &sectors, alive: &alive, curve: &curve, noise: &noise, hidden };
        let shape = Shape::of(&template);
        if let Some(found) = all.plain(&template, &shape, &matches) {
            (template, matches, blurred) = (found.template, found.matches, found.blurred);
            plain = true;
        } else {
            let pool = all.pool(&template, &shape, &matches);
            blurred = all.blurred(&pool, &template, &matches, 1.0);
        }
    }
    let step = blurred.map_or_else(|| template.edge(), Blurred::step);
    let disturbed = local_misfit(&matches, &alive, closed);
    let points: Vec<EdgePoint> = matches
        .iter()
        .zip(&alive)
        .zip(profiles.angle_rad.iter().zip(&disturbed))
        .map(|((m, &a), (&angle_rad, &here))| EdgePoint {
            angle_rad,
            distance_px: step.distance_px + m.measured.0,
            variance_px2: m.measured.1 * here.max(0.5 * m.misfit),
            usable: a > 0.0 && m.measured.1 < far,
        })
        .collect();
    let coverage = alive.iter().sum::<f64>() / n as f64;
    let least = tails.iter().copied().fold(f64::INFINITY, f64::min);
    let most = tails.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let leaning_px = 0.5 * (most - least) / step.contrast().abs().max(1e-300) * step.softness_px;
    let gains = quartiles(&matches, &alive);
    let (textured, noise) = (noise.is_correlated(), noise.pixel2.sqrt());
    Some(Located { points, template, step, noise, plain, textured, coverage, gains, leaning_px })
}

/// Quartiles of the gains of the sectors that show the edge.
fn quartiles(matches: &[Match], alive: &[f64]) -> [f64; 3] {
    let shown = matches.iter().zip(alive).filter(|(_, a)| **a > 0.0);
    let mut gains: Vec<f64> = shown.map(|(m, _)| m.gain).collect();
    gains.sort_by(f64::total_cmp);
    [1, 2, 3].map(|q| gains.get(q * gains.len() / 4).copied().unwrap_or(f64::NAN))
}

/// How much worse or better than usual the sectors near each one fit. Brushed metal disturbs the arcs along its
/// lines, at both ends of a diameter, more than the others.
fn local_misfit(matches: &[Match], alive: &[f64], closed: bool) -> Vec<f64> {
    let n = matches.len();
    let half = (n / 36).max(3);
    let misfits: Vec<f64> = matches.iter().map(|m| m.misfit).collect();
    let typical = median(&misfits, alive);
    (0..n)
        .map(|s| {
            let mut near: Vec<usize> = Vec::with_capacity(4 * half + 2);
            for step in 0..=2 * half {
                let place = (s + n + step).wrapping_sub(half);
                if closed {
                    near.extend([place % n, (place + n / 2) % n]);
                } else if (n..2 * n).contains(&place) {
                    near.push(place - n);
                }
            }
            let (values, weights): (Vec<f64>, Vec<f64>) =
                near.iter().map(|&i| (misfits[i], alive[i])).unzip();
            let known = weights.iter().sum::<f64>() >= 5.0;
            if known { median(&values, &weights).max(0.1 * typical) } else { typical.max(1.0) }
        })
        .collect()
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

/// Priors for the next round: curves through levels and gains, as wide as these scatter beyond their noise.
fn update_priors(
    round: usize,
    priors: &mut [Prior],
    matches: &[Match],
    alive: &[f64],
    curve: &Curve,
    range: f64,
) {
    let of = |f: fn(&Match) -> f64| matches.iter().map(f).collect::<Vec<f64>>();
    let (levels, level_sd) = curve.fit(&of(|m| m.level), alive);
    let (gains, gain_sd) = curve.fit(&of(|m| m.gain), alive);
    let beyond = |sd: f64, noise: f64, least: f64| {
        (sd * sd - noise).max(0.1 * noise.min(sd * sd)).max(least)
    };
    let level_variance =
        beyond(level_sd, median(&of(|m| m.level_variance), alive), (1e-4 * range).powi(2));
    let gain_variance = beyond(gain_sd, median(&of(|m| m.gain_variance), alive), 1e-8);
    let stretches = of(|m| m.stretch);
    let (_, stretch_sd, _) = curve.fit_order(0, &stretches, alive);
    // The first round has no stretch: a common profile must exist before sectors can differ from it.
    let stretch_variance = if round == 0 {
        0.09
    } else {
        beyond(stretch_sd, median(&of(|m| m.stretch_variance), alive), 1e-6)
    };
    let usual_tail = median(&of(|m| m.tail), alive);
    let (tails, tail_sd) = curve.fit(&of(|m| m.tail), alive);
    let tail_variance = if round == 0 {
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
}
