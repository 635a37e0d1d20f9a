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

use crate::edge::Profiles;
use crate::edge::Template;
use crate::edge::blurred::Blurred;
use crate::edge::levels::median;
use crate::edge::rounds::Rounds;
use crate::edge::sector::Match;
use crate::edge::shape::Shape;
use crate::edge::template::Step;

/// How edges are located.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Rounds of shifts and common profile in turn.
    pub rounds: usize,
    /// A sector whose gain is under this part of the median shows no edge.
    pub least_gain: f64,
    /// A sector that fits worse than this many times the median variance is not used.
    pub worst_fit: f64,
    /// Whether what fades beside the edge may be stronger on one side of the contour, as heat tint is.
    pub tinted: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { rounds: 4, least_gain: 0.3, worst_fit: 25.0, tinted: false }
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

/// Locates the edge in every sector. `None` where too few sectors have pixels, or nothing varies.
pub fn locate(profiles: &Profiles, closed: bool, options: Options) -> Option<Located> {
    let mut rounds = Rounds::new(profiles, closed, options)?;
    let mut learnt = false;
    for round in 0.. {
        // Texture hides what one more round would change.
        let done = round + 1 + usize::from(rounds.noise.is_correlated());
        let last = done >= options.rounds + rounds.more;
        let shape = Shape::of(&rounds.template);
        rounds.match_sectors(&shape, last);
        rounds.sort_out(round)?;
        learnt |= rounds.learn_noise(&shape, round, last);
        if last {
            break;
        }
        rounds.hold_sectors(round);
        rounds.template = rounds.renewed(&shape)?;
    }
    Some(conclude(rounds, learnt))
}

/// What the last round tells; `learnt` where it is known whether the noise goes together.
fn conclude(mut rounds: Rounds, learnt: bool) -> Located {
    let of_tail: Vec<f64> = rounds.matches.iter().map(|m| m.tail).collect();
    let (tails, _) = rounds.curve.fit(&of_tail, &rounds.alive);
    let (mut blurred, mut plain) = (None, false);
    if learnt && !rounds.noise.is_correlated() {
        let shape = Shape::of(&rounds.template);
        let all = rounds.all();
        if let Some(found) = all.plain(&rounds.template, &shape, &rounds.matches) {
            blurred = found.blurred;
            (rounds.template, rounds.matches) = (found.template, found.matches);
            plain = true;
        } else {
            let pool = all.pool(&rounds.template, &shape, &rounds.matches);
            blurred = all.blurred(&pool, &rounds.template, &rounds.matches, 1.0);
        }
    }
    let Rounds { template, matches, alive, noise, profiles, closed, far_px2, .. } = rounds;
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
            usable: a > 0.0 && m.measured.1 < far_px2,
        })
        .collect();
    let coverage = alive.iter().sum::<f64>() / alive.len() as f64;
    let least = tails.iter().copied().fold(f64::INFINITY, f64::min);
    let most = tails.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let leaning_px = 0.5 * (most - least) / step.contrast().abs().max(1e-300) * step.softness_px;
    let gains = quartiles(&matches, &alive);
    let (textured, noise) = (noise.is_correlated(), noise.pixel2.sqrt());
    Located { points, template, step, noise, plain, textured, coverage, gains, leaning_px }
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
