//! One sector's profile matched with the common one.

use crate::edge::noise::Noise;
use crate::edge::template::Step;
use crate::edge::{Profiles, Template};

/// Parameters of a sector: level, gain, shift, stretch and tail.
pub(super) const PARAMETERS: usize = 5;

/// One sector's model.
#[derive(Clone, Copy)]
pub(super) struct Match {
    pub(super) level: f64,
    pub(super) gain: f64,
    pub(super) shift: f64,
    pub(super) stretch: f64,
    pub(super) tail: f64,
    pub(super) shift_variance: f64,
    pub(super) level_variance: f64,
    pub(super) gain_variance: f64,
    pub(super) stretch_variance: f64,
    pub(super) tail_variance: f64,
    pub(super) misfit: f64,
    /// The shift as the profile alone has it, without its prior, and its variance.
    pub(super) measured: (f64, f64),
}

impl Match {
    /// What the match leaves over of a bin's value.
    pub(super) fn residual(&self, b: &Bin, template: &Template, edge: &Step) -> f64 {
        let place = self.place(b, edge);
        b.value - self.level - self.gain * template.at(place).0 - self.tail * edge.tail(place)
    }

    /// Where a bin falls on the common profile.
    pub(super) fn place(&self, b: &Bin, edge: &Step) -> f64 {
        edge.distance_px + (1.0 + self.stretch) * (b.distance - self.shift - edge.distance_px)
    }

    /// Slopes of the model in level, gain, shift, stretch and tail.
    fn columns(&self, b: &Bin, template: &Template, edge: &Step) -> [f64; PARAMETERS] {
        let from_edge = b.distance - self.shift - edge.distance_px;
        let place = self.place(b, edge);
        let (t, slope) = template.at(place);
        let steep = self.gain * slope;
        [1.0, t, -steep * (1.0 + self.stretch), steep * from_edge, edge.tail(place)]
    }

    /// Slopes and residual in standard deviations of the bin.
    pub(super) fn row(
        &self,
        b: &Bin,
        template: &Template,
        edge: &Step,
        noise: &Noise,
    ) -> [f64; PARAMETERS + 1] {
        let weight = 1.0 / noise.variance(b, template.node(b.distance - self.shift)).sqrt();
        let [one, profile, shift, stretch, tail] = self.columns(b, template, edge);
        let residual = b.value - self.level - self.gain * profile - self.tail * tail;
        [one, profile, shift, stretch, tail, residual].map(|v| v * weight)
    }
}

/// Priors of a sector's parameters: mean and variance.
#[derive(Clone, Copy)]
pub(super) struct Prior {
    pub(super) level: (f64, f64),
    pub(super) gain: (f64, f64),
    pub(super) stretch: (f64, f64),
    pub(super) shift: (f64, f64),
    pub(super) tail: (f64, f64),
}

pub(super) const NO_MATCH: Match = Match {
    level: 0.0,
    gain: 0.0,
    shift: 0.0,
    stretch: 0.0,
    tail: 0.0,
    stretch_variance: f64::INFINITY,
    tail_variance: f64::INFINITY,
    shift_variance: f64::INFINITY,
    level_variance: f64::INFINITY,
    gain_variance: f64::INFINITY,
    misfit: f64::INFINITY,
    measured: (0.0, f64::INFINITY),
};

/// One bin of a profile.
pub(super) struct Bin {
    pub(super) distance: f64,
    pub(super) value: f64,
    pub(super) count: f64,
}

pub(super) fn bins_of(profiles: &Profiles, sector: usize) -> Vec<Bin> {
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

/// The shift with the best correlation, over the whole band: the start for a sector that has none.
pub(super) fn search(bins: &[Bin], template: &Template, profiles: &Profiles) -> f64 {
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

/// Gauss-Newton for one sector's parameters.
pub(super) fn fit_sector(
    bins: &[Bin],
    template: &Template,
    edge: &Step,
    prior: Prior,
    noise: &Noise,
    start: f64,
    profiles: &Profiles,
) -> Match {
    use nalgebra::{SMatrix, SVector};
    let reach = 0.5 * (profiles.band.inside_px + profiles.band.outside_px);
    let held = [prior.level, prior.gain, prior.shift, prior.stretch, prior.tail];
    let mut p = SVector::<f64, PARAMETERS>::from(held.map(|h| h.0));
    p[2] = start;
    let of = |p: &SVector<f64, PARAMETERS>| Match {
        level: p[0],
        gain: p[1],
        shift: p[2],
        stretch: p[3],
        tail: p[4],
        ..NO_MATCH
    };
    let mut inverse = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    for _ in 0..8 {
        let mut normal = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
        let mut right = SVector::<f64, PARAMETERS>::zeros();
        let now = of(&p);
        let mut filter = noise.filter();
        for b in bins {
            let (row, _) = filter.next(b.distance, now.row(b, template, edge, noise));
            let x = SVector::<f64, PARAMETERS>::from_column_slice(&row[..PARAMETERS]);
            normal += x * x.transpose();
            right += x * row[PARAMETERS];
        }
        for (i, (mean, variance)) in held.into_iter().enumerate() {
            normal[(i, i)] += 1.0 / variance;
            right[i] += (mean - p[i]) / variance;
        }
        let Some(solved) = normal.cholesky() else { return NO_MATCH };
        inverse = solved.inverse();
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
    let last = of(&p);
    let mut filter = noise.filter();
    let misfit: f64 = bins
        .iter()
        .map(|b| filter.next(b.distance, last.row(b, template, edge, noise)).0[PARAMETERS].powi(2))
        .sum();
    Match {
        level_variance: inverse[(0, 0)],
        gain_variance: inverse[(1, 1)],
        shift_variance: inverse[(2, 2)],
        stretch_variance: inverse[(3, 3)],
        tail_variance: inverse[(4, 4)],
        misfit: misfit / (bins.len() as f64 - 4.0).max(1.0),
        measured: without((p[2], inverse[(2, 2)]), prior.shift),
        ..last
    }
}

/// An estimate with its prior taken out again. The prior only leads the search to the right place: what is
/// measured there is the profile's own.
fn without((value, variance): (f64, f64), (mean, width): (f64, f64)) -> (f64, f64) {
    let information = 1.0 / variance - 1.0 / width;
    if information * variance < 1e-3 {
        return (value, f64::INFINITY);
    }
    ((value / variance - mean / width) / information, 1.0 / information)
}
