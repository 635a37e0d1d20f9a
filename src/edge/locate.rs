//! Finds the edge in every sector by matching its profile with the profile common to all of them.
//!
//! Sector k is modelled as a_k + g_k T(d - δ_k): the common profile T, shifted by δ_k, on a level a_k and with a gain g_k. T, the
//! levels and the shifts are found in turn. Levels and gains are held by priors around curves that vary
//! slowly along the contour, as tightly as the data show them to: on a clean picture that reaches the
//! Cramer-Rao bound (free levels would cost half of the information), on a textured one it lets them float.

use crate::edge::levels::{Curve, median};
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
    /// Share of the sectors with a usable edge.
    pub coverage: f64,
}

/// One sector's model.
#[derive(Clone, Copy)]
struct Match {
    level: f64,
    gain: f64,
    shift: f64,
    shift_variance: f64,
    level_variance: f64,
    gain_variance: f64,
    misfit: f64,
}

/// Prior of a sector's level and gain: mean and variance.
#[derive(Clone, Copy)]
struct Prior {
    level: (f64, f64),
    gain: (f64, f64),
}

/// One bin of a profile.
struct Bin {
    distance: f64,
    value: f64,
    count: f64,
}

/// Locates the edge in every sector. `None` where too few sectors have pixels, or nothing varies.
pub fn locate(profiles: &Profiles, closed: bool, options: Options) -> Option<Located> {
    let sectors: Vec<Vec<Bin>> = (0..profiles.sectors()).map(|s| bins_of(profiles, s)).collect();
    let n = sectors.len();
    let enough = |bins: &Vec<Bin>| bins.len() * 3 >= profiles.bins * 2;
    let mut alive: Vec<f64> = sectors.iter().map(|b| f64::from(u8::from(enough(b)))).collect();
    if alive.iter().sum::<f64>() < 6.0 {
        return None;
    }
    let mut template = median_profile(profiles, &alive);
    let range = spread_of(&template);
    if range <= 0.0 {
        return None;
    }
    let wide = 100.0 * range * range;
    let mut priors = vec![Prior { level: (0.0, wide), gain: (1.0, 100.0) }; n];
    let mut matches: Vec<Match> = Vec::new();
    let mut noise2 = (0.05 * range).powi(2);
    let curve = Curve::new(n, closed);
    for round in 0..options.rounds {
        matches = (0..n)
            .map(|s| {
                if alive[s] == 0.0 {
                    return NO_MATCH;
                }
                let start = match matches.get(s) {
                    Some(m) if m.shift_variance.is_finite() => m.shift,
                    _ => search(&sectors[s], &template, profiles),
                };
                fit_sector(&sectors[s], &template, priors[s], noise2, start, profiles)
            })
            .collect();
        let misfit: Vec<f64> = matches.iter().map(|m| m.misfit).collect();
        noise2 = median(&misfit, &alive).max(1e-12 * range * range);
        let gains: Vec<f64> = matches.iter().map(|m| m.gain).collect();
        let typical = median(&gains, &alive);
        for s in 0..n {
            let m = &matches[s];
            let good = enough(&sectors[s])
                && m.shift_variance.is_finite()
                && m.gain > options.least_gain * typical
                && m.gain < 4.0 * typical
                && m.misfit < options.worst_fit * noise2;
            alive[s] = f64::from(u8::from(good || (round == 0 && enough(&sectors[s]))));
        }
        if alive.iter().sum::<f64>() < 6.0 {
            return None;
        }
        update_priors(&mut priors, &matches, &alive, &curve, range);
        if round + 1 < options.rounds {
            rebuild(&mut template, &sectors, &matches, &alive, &curve, noise2);
        }
    }
    let step = template.edge();
    let points: Vec<EdgePoint> = matches
        .iter()
        .zip(&alive)
        .zip(&profiles.angle_rad)
        .map(|((m, &a), &angle_rad)| EdgePoint {
            angle_rad,
            distance_px: step.distance_px + m.shift,
            variance_px2: m.shift_variance * (0.5 * m.misfit / noise2).max(1.0),
            usable: a > 0.0,
        })
        .collect();
    let coverage = alive.iter().sum::<f64>() / n as f64;
    Some(Located { points, template, step, noise: noise2.sqrt(), coverage })
}

const NO_MATCH: Match = Match {
    level: 0.0,
    gain: 0.0,
    shift: 0.0,
    shift_variance: f64::INFINITY,
    level_variance: f64::INFINITY,
    gain_variance: f64::INFINITY,
    misfit: f64::INFINITY,
};

fn bins_of(profiles: &Profiles, sector: usize) -> Vec<Bin> {
    profiles
        .range(sector)
        .filter(|&i| profiles.count[i] > 0.0)
        .map(|i| Bin {
            distance: f64::from(profiles.distance_px[i]),
            value: f64::from(profiles.value[i]),
            count: f64::from(profiles.count[i]),
        })
        .collect()
}

/// The median over the sectors, bin by bin: the first guess of the common profile.
fn median_profile(profiles: &Profiles, alive: &[f64]) -> Template {
    let mut values = Vec::with_capacity(profiles.bins);
    let mut last = 0.0;
    for b in 0..profiles.bins {
        let list: Vec<f64> = (0..profiles.sectors())
            .map(|s| f64::from(profiles.value[s * profiles.bins + b]))
            .collect();
        let weights: Vec<f64> = (0..profiles.sectors())
            .map(|s| if profiles.count[s * profiles.bins + b] > 0.0 { alive[s] } else { 0.0 })
            .collect();
        if weights.iter().any(|w| *w > 0.0) {
            last = median(&list, &weights);
        }
        values.push(last);
    }
    let mut template =
        Template { start_px: profiles.bin_middle_px(0), step_px: profiles.band.bin_px, values };
    template.smooth(2);
    template
}

fn spread_of(template: &Template) -> f64 {
    let (lo, hi) = template
        .values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
    hi - lo
}

/// The shift with the best correlation, over the whole band: the start for a sector that has none.
fn search(bins: &[Bin], template: &Template, profiles: &Profiles) -> f64 {
    let reach = 0.4 * (profiles.band.inside_px + profiles.band.outside_px);
    let step = (2.0 * profiles.band.bin_px).max(reach / 16.0);
    let count = (reach / step).floor() as i32;
    let mut best = (f64::NEG_INFINITY, 0.0);
    for i in -count..=count {
        let shift = f64::from(i) * step;
        let (mut w, mut t, mut v, mut tt, mut tv) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for b in bins {
            let (x, _) = template.at(b.distance - shift);
            w += b.count;
            t += b.count * x;
            v += b.count * b.value;
            tt += b.count * x * x;
            tv += b.count * x * b.value;
        }
        let (var, cov) = (tt - t * t / w, tv - t * v / w);
        // A far shift must explain clearly more than a near one.
        let gain = if cov > 0.0 && var > 0.0 { cov * cov / var } else { 0.0 };
        let value = gain * (1.0 - 0.3 * (shift / reach).powi(2));
        if value > best.0 {
            best = (value, shift);
        }
    }
    best.1
}

/// Gauss-Newton for one sector's level, gain and shift.
fn fit_sector(
    bins: &[Bin],
    template: &Template,
    prior: Prior,
    noise2: f64,
    start: f64,
    profiles: &Profiles,
) -> Match {
    use nalgebra::{Matrix3, Vector3};
    let reach = 0.5 * (profiles.band.inside_px + profiles.band.outside_px);
    let mut p = Vector3::new(prior.level.0, prior.gain.0, start);
    let mut inverse = Matrix3::zeros();
    for _ in 0..8 {
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Vector3::<f64>::zeros();
        for b in bins {
            let (t, slope) = template.at(b.distance - p[2]);
            let row = Vector3::new(1.0, t, -p[1] * slope);
            let w = b.count / noise2;
            let r = b.value - p[0] - p[1] * t;
            normal += row * row.transpose() * w;
            right += row * (w * r);
        }
        normal[(0, 0)] += 1.0 / prior.level.1;
        right[0] += (prior.level.0 - p[0]) / prior.level.1;
        normal[(1, 1)] += 1.0 / prior.gain.1;
        right[1] += (prior.gain.0 - p[1]) / prior.gain.1;
        let Some(solved) = normal.try_inverse() else { return NO_MATCH };
        inverse = solved;
        let mut step = inverse * right;
        // Far steps leave the range in which the slope means anything.
        let limit = 0.25 * reach;
        step[2] = step[2].clamp(-limit, limit);
        p += step;
        if p[2].abs() > reach || !p.iter().all(|v| v.is_finite()) {
            return NO_MATCH;
        }
        if step[2].abs() < 1e-4 * profiles.band.bin_px {
            break;
        }
    }
    let mut misfit = 0.0;
    for b in bins {
        misfit += b.count * (b.value - p[0] - p[1] * template.at(b.distance - p[2]).0).powi(2);
    }
    Match {
        level: p[0],
        gain: p[1],
        shift: p[2],
        level_variance: inverse[(0, 0)],
        gain_variance: inverse[(1, 1)],
        shift_variance: inverse[(2, 2)],
        misfit: misfit / (bins.len() as f64 - 3.0).max(1.0),
    }
}

/// Priors for the next round: curves through levels and gains, as wide as these scatter beyond their noise.
fn update_priors(
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
    for (s, prior) in priors.iter_mut().enumerate() {
        *prior = Prior { level: (levels[s], level_variance), gain: (gains[s], gain_variance) };
    }
}

/// The common profile again, from all usable sectors laid on top of each other.
fn rebuild(
    template: &mut Template,
    sectors: &[Vec<Bin>],
    matches: &[Match],
    alive: &[f64],
    curve: &Curve,
    noise2: f64,
) {
    let shifts: Vec<f64> = matches.iter().map(|m| m.shift).collect();
    let noise: Vec<f64> = matches.iter().map(|m| m.shift_variance).collect();
    let (smooth, sd, _) = curve.fit_order(2, &shifts, alive);
    // Shifts that are mostly noise would sharpen the profile on that noise: shrink them to the curve.
    let trust = (1.0 - median(&noise, alive) / (sd * sd).max(1e-300)).clamp(0.0, 1.0);
    let n = template.values.len();
    let mut sum = vec![0.0; n];
    let mut weight = vec![0.0; n];
    for (s, bins) in sectors.iter().enumerate() {
        if alive[s] == 0.0 {
            continue;
        }
        let m = &matches[s];
        let shift = smooth[s] + trust * (m.shift - smooth[s]);
        for b in bins {
            let x = b.distance - shift;
            let place = (x - template.start_px) / template.step_px;
            let node = place.round();
            if node < 0.0 || node >= n as f64 {
                continue;
            }
            let (old, slope) = template.at(x);
            let y = (b.value - m.level) / m.gain;
            let r = (y - old) * m.gain * (b.count / noise2).sqrt();
            let w = b.count * m.gain * m.gain * crate::fit::circle::tukey(r / 3.0);
            let i = node as usize;
            sum[i] += w * (y - slope * (place - node) * template.step_px);
            weight[i] += w;
        }
    }
    let mut last = template.values[0];
    for i in 0..n {
        if weight[i] > 0.0 {
            last = sum[i] / weight[i];
        }
        template.values[i] = last;
    }
}
