//! Finds the edge in every sector by matching its profile with the profile common to all of them.
//!
//! Sector k is modelled as a_k + g_k T(x0 + (1 + s_k)(d - δ_k - x0)): the common profile T, shifted by δ_k, on a level a_k, with a gain
//! g_k, and made steeper by s_k about the edge at x0 (focus and rims vary along a real edge, and a clipped
//! profile then leans). T and the sectors' parameters are found in turn. Where along the profile sectors differ from T by more than
//! pixel noise (bevels, burrs, reflections beside the edge), the profile counts for less. Levels and gains are held by priors around curves that vary
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

impl Located {
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
    /// Share of the sectors with a usable edge.
    pub coverage: f64,
}

/// Least noise assumed, as a part of the step: clipped levels and rounding look perfect and are not.
const LEAST_NOISE: f64 = 0.003;

/// One sector's model.
#[derive(Clone, Copy)]
struct Match {
    level: f64,
    gain: f64,
    shift: f64,
    stretch: f64,
    shift_variance: f64,
    level_variance: f64,
    gain_variance: f64,
    stretch_variance: f64,
    misfit: f64,
}

/// Prior of a sector's level, gain and stretch: mean and variance.
#[derive(Clone, Copy)]
struct Prior {
    level: (f64, f64),
    gain: (f64, f64),
    stretch: (f64, f64),
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
    let mut template = median_profile(profiles, &alive);
    let range = spread_of(&template);
    if range <= 0.0 {
        return None;
    }
    let wide = 100.0 * range * range;
    let mut priors =
        vec![Prior { level: (0.0, wide), gain: (1.0, 100.0), stretch: (0.0, 1e-4) }; n];
    let mut matches: Vec<Match> = Vec::new();
    let mut noise2 = (0.05 * range).powi(2);
    let curve = Curve::new(n, closed);
    // Variance of the sectors' own shape at each node of the common profile.
    let mut shape2 = vec![0.0; template.values.len()];
    for round in 0..options.rounds {
        let edge_px = template.edge().distance_px;
        matches = (0..n)
            .map(|s| {
                if alive[s] == 0.0 {
                    return NO_MATCH;
                }
                let start = match matches.get(s) {
                    Some(m) if m.shift_variance.is_finite() => m.shift,
                    _ => search(&sectors[s], &template, profiles),
                };
                fit_sector(
                    &sectors[s],
                    &template,
                    edge_px,
                    priors[s],
                    (noise2, &shape2),
                    start,
                    profiles,
                )
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
        noise2 = noise_and_shape(&mut shape2, &template, edge_px, &sectors, &matches, &alive)
            .max(LEAST_NOISE * LEAST_NOISE * range * range);
        if round == 0 {
            shape2.fill(0.0);
        }
        update_priors(round, &mut priors, &matches, &alive, &curve, range);
        if round + 1 < options.rounds {
            rebuild(&mut template, edge_px, &sectors, &matches, &alive, &curve, (noise2, &shape2));
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
            variance_px2: m.shift_variance * (0.5 * m.misfit).max(1.0),
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
    stretch: 0.0,
    stretch_variance: f64::INFINITY,
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

/// Pixel noise (variance of one pixel), and how much the sectors' shapes differ from the common one, node by node.
fn noise_and_shape(
    shape2: &mut [f64],
    template: &Template,
    edge_px: f64,
    sectors: &[Vec<Bin>],
    matches: &[Match],
    alive: &[f64],
) -> f64 {
    let n = shape2.len();
    let mut sizes: Vec<Vec<f64>> = vec![Vec::new(); n];
    let mut counts = vec![0.0; n];
    for (s, bins) in sectors.iter().enumerate().filter(|(s, _)| alive[*s] > 0.0) {
        let m = &matches[s];
        for b in bins {
            let from_edge = b.distance - m.shift - edge_px;
            let t = template.at(edge_px + (1.0 + m.stretch) * from_edge).0;
            let i = template.node(b.distance - m.shift);
            sizes[i].push((b.value - m.level - m.gain * t).abs());
            counts[i] += b.count;
        }
    }
    // Residual variance per node, and the variance of one pixel that would explain it.
    let spread: Vec<f64> = sizes
        .iter()
        .map(|list| {
            let ones = vec![1.0; list.len()];
            (1.4826 * median(list, &ones)).powi(2)
        })
        .collect();
    let mut pixel: Vec<f64> = (0..n)
        .filter(|&i| sizes[i].len() >= 12)
        .map(|i| spread[i] * counts[i] / sizes[i].len() as f64)
        .collect();
    if pixel.is_empty() {
        shape2.fill(0.0);
        return 0.0;
    }
    pixel.sort_by(f64::total_cmp);
    let noise2 = pixel[pixel.len() * 2 / 5];
    for i in 0..n {
        let mean_count = (counts[i] / sizes[i].len().max(1) as f64).max(1.0);
        let excess = spread[i] - 1.6 * noise2 / mean_count;
        shape2[i] = if sizes[i].len() >= 12 { excess.max(0.0) } else { 0.0 };
    }
    noise2
}

/// Gauss-Newton for one sector's level, gain, shift and stretch.
fn fit_sector(
    bins: &[Bin],
    template: &Template,
    edge_px: f64,
    prior: Prior,
    (noise2, shape2): (f64, &[f64]),
    start: f64,
    profiles: &Profiles,
) -> Match {
    use nalgebra::{Matrix4, Vector4};
    let reach = 0.5 * (profiles.band.inside_px + profiles.band.outside_px);
    let mut p = Vector4::new(prior.level.0, prior.gain.0, start, prior.stretch.0);
    let mut inverse = Matrix4::zeros();
    for _ in 0..8 {
        let mut normal = Matrix4::<f64>::zeros();
        let mut right = Vector4::<f64>::zeros();
        for b in bins {
            let from_edge = b.distance - p[2] - edge_px;
            let (t, slope) = template.at(edge_px + (1.0 + p[3]) * from_edge);
            let row = Vector4::new(1.0, t, -p[1] * slope * (1.0 + p[3]), p[1] * slope * from_edge);
            let w = 1.0 / (noise2 / b.count + shape2[template.node(b.distance - p[2])]);
            let r = b.value - p[0] - p[1] * t;
            normal += row * row.transpose() * w;
            right += row * (w * r);
        }
        for (i, (mean, variance)) in [(0, prior.level), (1, prior.gain), (3, prior.stretch)] {
            normal[(i, i)] += 1.0 / variance;
            right[i] += (mean - p[i]) / variance;
        }
        let Some(solved) = normal.try_inverse() else { return NO_MATCH };
        inverse = solved;
        let mut step = inverse * right;
        // Far steps leave the range in which the slope means anything.
        let limit = 0.25 * reach;
        step[2] = step[2].clamp(-limit, limit);
        p += step;
        p[3] = p[3].clamp(-0.6, 1.5);
        if p[2].abs() > reach || !p.iter().all(|v| v.is_finite()) {
            return NO_MATCH;
        }
        if step[2].abs() < 1e-4 * profiles.band.bin_px {
            break;
        }
    }
    let model = |b: &Bin| {
        p[0] + p[1] * template.at(edge_px + (1.0 + p[3]) * (b.distance - p[2] - edge_px)).0
    };
    let misfit: f64 = bins
        .iter()
        .map(|b| {
            let expected = noise2 / b.count + shape2[template.node(b.distance - p[2])];
            (b.value - model(b)).powi(2) / expected
        })
        .sum();
    Match {
        level: p[0],
        gain: p[1],
        shift: p[2],
        stretch: p[3],
        level_variance: inverse[(0, 0)],
        gain_variance: inverse[(1, 1)],
        shift_variance: inverse[(2, 2)],
        stretch_variance: inverse[(3, 3)],
        misfit: misfit / (bins.len() as f64 - 4.0).max(1.0),
    }
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
    for (s, prior) in priors.iter_mut().enumerate() {
        *prior = Prior {
            level: (levels[s], level_variance),
            gain: (gains[s], gain_variance),
            stretch: (0.0, stretch_variance),
        };
    }
}

/// The common profile again, from all usable sectors laid on top of each other.
fn rebuild(
    template: &mut Template,
    edge_px: f64,
    sectors: &[Vec<Bin>],
    matches: &[Match],
    alive: &[f64],
    curve: &Curve,
    (noise2, shape2): (f64, &[f64]),
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
            let x = edge_px + (1.0 + m.stretch) * (b.distance - shift - edge_px);
            let place = (x - template.start_px) / template.step_px;
            let node = place.round();
            if node < 0.0 || node >= n as f64 {
                continue;
            }
            let (old, slope) = template.at(x);
            let y = (b.value - m.level) / m.gain;
            let i = node as usize;
            let variance = noise2 / b.count + shape2[i];
            let r = (y - old) * m.gain / variance.sqrt();
            let w = m.gain * m.gain / variance * crate::fit::circle::tukey(r / 3.0);
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
