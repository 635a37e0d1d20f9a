//! One sector's profile matched with the common one.

use nalgebra::{SMatrix, SVector};

use crate::edge::noise::{Noise, Whitening};
use crate::edge::shape::Shape;
use crate::edge::template::Step;
use crate::edge::{Band, Profiles, Template};

/// Parameters of a sector: level, gain, shift, stretch and tail.
pub(super) const PARAMETERS: usize = 5;
/// Which of them is the shift.
pub(super) const SHIFT: usize = 2;

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
    /// The parameters.
    pub(super) fn parameters(&self) -> [f64; PARAMETERS] {
        [self.level, self.gain, self.shift, self.stretch, self.tail]
    }

    /// What the match leaves over of a bin's value.
    pub(super) fn residual(&self, b: &Bin, shape: &Shape) -> f64 {
        self.row(b, shape)[PARAMETERS]
    }

    /// Where a bin falls on the common profile.
    pub(super) fn place(&self, b: &Bin, edge: &Step) -> f64 {
        edge.distance_px + (1.0 + self.stretch) * (b.distance - self.shift - edge.distance_px)
    }

    /// Slopes of the model in level, gain, shift, stretch and tail, and the residual.
    #[inline]
    pub(super) fn row(&self, b: &Bin, shape: &Shape) -> Row {
        let from_edge = b.distance - self.shift - shape.edge.distance_px;
        let at = shape.at(self.place(b, &shape.edge));
        let steep = self.gain * at.slope;
        let residual = b.value - self.level - self.gain * at.profile - self.tail * at.tail;
        [1.0, at.profile, -steep * (1.0 + self.stretch), steep * from_edge, at.tail, residual]
    }
}

/// Slopes of a sector's model at a bin, and the residual there.
pub(super) type Row = [f64; PARAMETERS + 1];

/// Sums of products of whitened rows: the normal equations, their right side and the residuals' squares.
#[derive(Default)]
pub(super) struct Products([[f64; PARAMETERS + 1]; PARAMETERS + 1]);

impl Products {
    /// Takes in one row.
    #[inline]
    pub(super) fn add(&mut self, row: &Row) {
        // The matrix is symmetric; its half by pairs, as the processor does two products at once.
        for (i, (sums, a)) in self.0.iter_mut().zip(row).enumerate() {
            for (sum, b) in sums.iter_mut().zip(row).skip(i & !1) {
                *sum += a * b;
            }
        }
    }

    /// The normal matrix.
    pub(super) fn normal(&self) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
        SMatrix::from_fn(|i, j| self.0[i.min(j)][i.max(j)])
    }

    /// The right side.
    pub(super) fn right(&self) -> SVector<f64, PARAMETERS> {
        SVector::from_fn(|i, _| self.0[i][PARAMETERS])
    }

    /// The residuals' squares.
    pub(super) fn squares(&self) -> f64 {
        self.0[PARAMETERS][PARAMETERS]
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

impl Prior {
    /// Mean and variance of each parameter.
    fn held(&self) -> [(f64, f64); PARAMETERS] {
        [self.level, self.gain, self.shift, self.stretch, self.tail]
    }

    /// The means but for the shift.
    pub(super) fn at(&self, shift: f64) -> [f64; PARAMETERS] {
        let mut parameters = self.held().map(|(mean, _)| mean);
        parameters[SHIFT] = shift;
        parameters
    }
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

/// One bin of a profile, or several joined.
#[derive(Clone, Copy)]
pub(super) struct Bin {
    pub(super) distance: f64,
    pub(super) value: f64,
    /// Pixels.
    pub(super) count: f64,
    /// How many are joined.
    pub(super) joined: f64,
}

pub(super) fn bins_of(profiles: &Profiles, sector: usize) -> Vec<Bin> {
    let mut bins = Vec::with_capacity(profiles.bins);
    bins.extend(profiles.range(sector).filter(|&i| profiles.count[i] > 0.0).map(|i| Bin {
        distance: f64::from(profiles.distance_px[i]),
        value: f64::from(profiles.value[i]),
        count: f64::from(profiles.count[i]),
        joined: 1.0,
    }));
    bins
}

/// The bins with those farther than `clear_px` from a place joined, `many` at most: there a profile is straight over as many.
pub(super) fn join(bins: &[Bin], place_px: f64, clear_px: f64, many: usize, list: &mut Vec<Bin>) {
    let first = bins.partition_point(|b| b.distance < place_px - clear_px);
    let last = bins.partition_point(|b| b.distance <= place_px + clear_px).max(first);
    let mean = |part: &[Bin]| {
        let count: f64 = part.iter().map(|b| b.count).sum();
        let of = |f: fn(&Bin) -> f64| part.iter().map(|b| b.count * f(b)).sum::<f64>() / count;
        Bin {
            distance: of(|b| b.distance),
            value: of(|b| b.value),
            count,
            joined: part.len() as f64,
        }
    };
    list.clear();
    list.extend(bins[..first].rchunks(many).rev().map(mean));
    list.extend_from_slice(&bins[first..last]);
    list.extend(bins[last..].chunks(many).map(mean));
}

/// The shift with the best correlation, over the whole band: the start for a sector that has none.
pub(super) fn search(bins: &[Bin], template: &Template, profiles: &Profiles) -> f64 {
    let reach = 0.4 * (profiles.band.inside_px + profiles.band.outside_px);
    let stride = (reach / 16.0 / template.step_px).round().max(2.0) as i32;
    let step = f64::from(stride) * template.step_px;
    let count = (reach / step).floor() as i32;
    let last = template.values.len() as i32 - 1;
    let (mut w, mut v) = (0.0, 0.0);
    let nodes: Vec<i32> = bins
        .iter()
        .map(|b| {
            (w, v) = (w + b.count, v + b.count * b.value);
            ((b.distance - template.start_px) / template.step_px + 0.5) as i32
        })
        .collect();
    let mut best = (f64::NEG_INFINITY, 0.0);
    for i in -count..=count {
        let shift = f64::from(i) * step;
        let (mut t, mut tt, mut tv) = (0.0, 0.0, 0.0);
        for (b, node) in bins.iter().zip(&nodes) {
            let x = template.values[(node - i * stride).clamp(0, last) as usize];
            let counted = b.count * x;
            t += counted;
            tt += counted * x;
            tv += counted * b.value;
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

/// Gauss-Newton for one sector's parameters, from those of `start`, until a step moves the shift by less than `settled` of its standard
/// deviation. `whitening` is room to work in.
#[expect(clippy::too_many_arguments)]
pub(super) fn fit_sector(
    bins: &[Bin],
    shape: &Shape,
    prior: Prior,
    noise: &Noise,
    start: [f64; PARAMETERS],
    settled: f64,
    band: &Band,
    whitening: &mut Vec<Whitening>,
) -> Match {
    let reach = 0.5 * (band.inside_px + band.outside_px);
    let held = prior.held();
    let mut p = SVector::<f64, PARAMETERS>::from(start);
    let of = |p: &SVector<f64, PARAMETERS>| Match {
        level: p[0],
        gain: p[1],
        shift: p[2],
        stretch: p[3],
        tail: p[4],
        ..NO_MATCH
    };
    let (mut last, mut squares) = (None, 0.0);
    noise.whitening(bins, start[SHIFT], whitening);
    let mut last_shift = 0.0f64;
    for _ in 0..8 {
        let mut products = Products::default();
        let now = of(&p);
        let mut mean = Row::default();
        for (b, w) in bins.iter().zip(&*whitening) {
            products.add(&w.apply(now.row(b, shape), &mut mean));
        }
        let data = products.normal();
        let data_right = products.right();
        let (mut normal, mut right) = (data, data_right);
        for (i, (mean, variance)) in held.into_iter().enumerate() {
            normal[(i, i)] += 1.0 / variance;
            right[i] += (mean - p[i]) / variance;
        }
        let Some(solved) = normal.cholesky() else { return NO_MATCH };
        let mut step = solved.solve(&right);
        let variance = solved.solve(&SVector::<f64, PARAMETERS>::ith(SHIFT, 1.0))[SHIFT];
        last = Some(solved);
        // Far steps leave the range in which the slope means anything.
        let limit = 0.25 * reach;
        step[2] = step[2].clamp(-limit, limit);
        // Steps to and fro would never end.
        if step[2] * last_shift < 0.0 {
            step *= 0.5;
        }
        last_shift = step[2];
        p += step;
        p[3] = p[3].clamp(-0.6, 1.5);
        if p[2].abs() > reach || !p.iter().all(|v| v.is_finite()) {
            return NO_MATCH;
        }
        // What the step leaves of the squares.
        squares = products.squares() - step.dot(&(2.0 * data_right - data * step));
        if step[2].abs() < settled * variance.sqrt() {
            break;
        }
    }
    let Some(inverse) = last.map(|solved| solved.inverse()) else { return NO_MATCH };
    Match {
        level_variance: inverse[(0, 0)],
        gain_variance: inverse[(1, 1)],
        shift_variance: inverse[(2, 2)],
        stretch_variance: inverse[(3, 3)],
        tail_variance: inverse[(4, 4)],
        misfit: squares.max(0.0) / (bins.len() as f64 - 4.0).max(1.0),
        measured: without((p[2], inverse[(2, 2)]), prior.shift),
        ..of(&p)
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
