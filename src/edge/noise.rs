//! What disturbs the profiles: pixel noise, sectors whose shape differs from the common one, and texture.
//!
//! Texture and shading err together over many bins. Taken for independent errors they would pull an edge that
//! is matched over a wide band; told apart by their correlation, only what is steeper than the texture counts.
//! Errors are modelled as √(v_a v_b) [(1 - φ) δ_ab + φ exp(-|a - b| / ℓ)] with v from the spread at each distance;
//! φ and ℓ have the highest restricted likelihood over all sectors. A filter (Kalman, one state) makes the
//! errors independent in one pass along a profile.

use crate::edge::Template;
use crate::edge::sector::{Bin, Match, PARAMETERS, Products, Row};
use crate::edge::shape::Shape;
use crate::fit::robust::scatter;

/// Shares of the correlated part tried.
const SHARES: [f64; 6] = [0.3, 0.5, 0.7, 0.85, 0.93, 0.98];
/// Correlation lengths tried, in nodes of the common profile: each twice the one before.
const LEAST_LENGTH: f64 = 2.0;

/// The model of the errors.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    /// Variance of one pixel.
    pub(super) pixel2: f64,
    /// Variance of the sectors' own shape at each node of the common profile.
    pub(super) shape2: Vec<f64>,
    /// Share φ of the correlated part.
    share: f64,
    /// Its correlation length ℓ.
    length_px: f64,
    /// The same on the grid of those that are tried, where they have been learnt.
    likeliest: Option<[usize; 2]>,
    /// Where the nodes are.
    start_px: f64,
    step_px: f64,
}

impl Noise {
    /// Independent errors of one size, at the nodes of a common profile.
    pub(super) fn white(pixel2: f64, template: &Template) -> Self {
        let shape2 = vec![0.0; template.values.len()];
        let Template { start_px, step_px, .. } = *template;
        Self { pixel2, shape2, share: 0.0, length_px: 1.0, likeliest: None, start_px, step_px }
    }

    /// Whether neighbouring bins err together.
    pub(super) fn is_correlated(&self) -> bool {
        self.share > 0.0
    }

    /// Variance of a bin's mean; of each that is joined.
    pub(super) fn variance(&self, bin: &Bin, node: usize) -> f64 {
        self.pixel2 * bin.joined / bin.count + self.shape2[node]
    }

    /// One over the root of that, in a sector of that shift.
    fn weight(&self, bin: &Bin, shift_px: f64) -> f64 {
        1.0 / self.variance(bin, self.node(bin.distance - shift_px)).sqrt()
    }

    /// The node nearest to a distance.
    fn node(&self, distance_px: f64) -> usize {
        // Truncated towards zero, as it is several times as fast as rounded.
        let place = (distance_px - self.start_px) / self.step_px + 0.5;
        (place as usize).min(self.shape2.len() - 1)
    }

    /// What makes a profile's errors independent, bin by bin.
    pub(super) fn whitening(&self, bins: &[Bin], shift_px: f64, list: &mut Vec<Whitening>) {
        list.clear();
        let mut filter = Filter::new(self.share, self.length_px);
        let next = |b: &Bin| filter.next(b.distance, self.weight(b, shift_px), b.joined);
        list.extend(bins.iter().map(next));
    }

    /// How many bins of a width say as much joined as each by itself, of those over which a profile is straight.
    pub(super) fn joined(&self, straight_px: f64, bin_px: f64) -> usize {
        let alike_px = if self.is_correlated() { self.length_px } else { f64::INFINITY };
        ((straight_px.min(alike_px) / bin_px) as usize).max(1)
    }

    /// Learns the variances from what the matches leave over.
    pub(super) fn learn_sizes(
        &mut self,
        shape: &Shape,
        sectors: &[Vec<Bin>],
        matches: &[Match],
        alive: &[f64],
    ) {
        let n = self.shape2.len();
        let mut sizes: Vec<Vec<f64>> = (0..n).map(|_| Vec::with_capacity(sectors.len())).collect();
        let mut counts = vec![0.0; n];
        for (s, bins) in sectors.iter().enumerate().filter(|(s, _)| alive[*s] > 0.0) {
            for b in bins {
                let i = self.node(b.distance - matches[s].shift);
                sizes[i].push(matches[s].residual(b, shape).abs());
                counts[i] += b.count;
            }
        }
        // Residual variance per node, and the variance of one pixel that would explain it.
        let spread: Vec<f64> = sizes
            .iter_mut()
            .map(|list| if list.is_empty() { 0.0 } else { scatter(list).powi(2) })
            .collect();
        let mut pixel: Vec<f64> = (0..n)
            .filter(|&i| sizes[i].len() >= 12)
            .map(|i| spread[i] * counts[i] / sizes[i].len() as f64)
            .collect();
        self.shape2.fill(0.0);
        self.pixel2 = 0.0;
        if pixel.is_empty() {
            return;
        }
        pixel.sort_by(f64::total_cmp);
        self.pixel2 = pixel[pixel.len() * 2 / 5];
        for i in 0..n {
            let mean_count = (counts[i] / sizes[i].len().max(1) as f64).max(1.0);
            let excess = spread[i] - 1.6 * self.pixel2 / mean_count;
            self.shape2[i] = if sizes[i].len() >= 12 { excess.max(0.0) } else { 0.0 };
        }
    }

    /// Learns the correlation from what the matches leave over.
    pub(super) fn learn_correlation(
        &mut self,
        shape: &Shape,
        sectors: &[Vec<Bin>],
        matches: &[Match],
        alive: &[f64],
    ) {
        let used: Vec<usize> = (0..sectors.len()).filter(|&s| alive[s] > 0.0).collect();
        // A few dozen sectors know as much of the texture as all of them.
        let every = used.len().div_ceil(30).max(1);
        let rows: Vec<Vec<(f64, Row)>> = used
            .iter()
            .step_by(every)
            .map(|&s| {
                let row = |b: &Bin| {
                    let weight = self.weight(b, matches[s].shift);
                    (b.distance, matches[s].row(b, shape).map(|v| v * weight))
                };
                sectors[s].iter().map(row).collect()
            })
            .collect();
        let span = self.shape2.len() as f64;
        let lengths = ((2.0 * span / LEAST_LENGTH).log2().ceil() as usize).max(1);
        let length = |i: usize| LEAST_LENGTH * self.step_px * 2f64.powi(i as i32);
        let size = [SHARES.len(), lengths];
        let start = self.likeliest.unwrap_or(size.map(|n| n / 2));
        let (at, value) = climb(size, start, |[i, j]| likelihood(&rows, SHARES[i], length(j)));
        self.likeliest = Some(at);
        // Two more numbers must be worth it (Schwarz 1978): what only looks like texture costs knowledge of the edge.
        let bins = rows.iter().map(Vec::len).sum::<usize>().max(1) as f64;
        (self.share, self.length_px) = if value > likelihood(&rows, 0.0, 1.0) + bins.ln() {
            (SHARES[at[0]], length(at[1]))
        } else {
            (0.0, 1.0)
        };
    }
}

/// Whether noise alone may well make a sum of squares so large: `dof` independent ones of variance `scale` each.
pub(super) fn by_chance(squares: f64, dof: f64, scale: f64) -> bool {
    /// Standard deviations of the sum above its mean.
    const CHANCE: f64 = 2.5;
    squares < scale * (dof + CHANCE * (2.0 * dof).sqrt())
}

/// The place of a grid, and the value there, from which no step up, down, left or right leads higher.
fn climb(
    size: [usize; 2],
    start: [usize; 2],
    value: impl Fn([usize; 2]) -> f64,
) -> ([usize; 2], f64) {
    let mut known = vec![None; size[0] * size[1]];
    let mut at = start;
    loop {
        let [i, j] = at;
        let steps = [at, [i + 1, j], [i.wrapping_sub(1), j], [i, j + 1], [i, j.wrapping_sub(1)]];
        let mut best = (at, f64::NEG_INFINITY);
        for place in steps {
            if place[0] < size[0] && place[1] < size[1] {
                let here =
                    *known[place[0] * size[1] + place[1]].get_or_insert_with(|| value(place));
                if here > best.1 {
                    best = (place, here);
                }
            }
        }
        if best.0 == at {
            return best;
        }
        at = best.0;
    }
}

/// Restricted log likelihood of the residuals (scale known), each profile's own parameters projected out.
fn likelihood(rows: &[Vec<(f64, Row)>], share: f64, length_px: f64) -> f64 {
    let mut sum = 0.0;
    for profile in rows {
        let mut filter = Filter::new(share, length_px);
        let mut products = Products::default();
        let mut mean = Row::default();
        let (mut sizes, mut log_det) = (1.0f64, 0.0);
        for (at, row) in profile {
            let whitening = filter.next(*at, 1.0, 1.0);
            products.add(&whitening.apply(*row, &mut mean));
            // Logarithms are dear: one for many factors, none of them under 1.
            sizes *= whitening.size;
            if sizes > 1e100 {
                log_det -= 2.0 * sizes.ln();
                sizes = 1.0;
            }
        }
        log_det -= 2.0 * sizes.ln();
        let (mut normal, right) = (products.normal(), products.right());
        for i in 0..PARAMETERS {
            normal[(i, i)] *= 1.0 + 1e-9;
            normal[(i, i)] += 1e-12;
        }
        let Some(cholesky) = normal.cholesky() else { continue };
        let left = products.squares() - right.dot(&cholesky.solve(&right));
        let det = 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        // One odd sector must not decide for all.
        let dof = (profile.len() as f64 - PARAMETERS as f64).max(1.0);
        let scale = (left / dof).max(1e-12);
        sum += -0.5 * (dof * scale.ln() + log_det + det);
    }
    sum
}

/// What is done to a bin's row to make it independent of the rows before it, and of unit variance.
#[derive(Clone, Copy)]
pub(super) struct Whitening {
    /// One over the standard deviation of the bin.
    weight: f64,
    /// How much of what the earlier rows foretell is left at this bin.
    fade: f64,
    /// How much of a surprise is believed.
    gain: f64,
    /// One over the standard deviation of a surprise.
    size: f64,
}

impl Whitening {
    /// The row's part that the earlier ones do not foretell. `mean` is what they do: zero before the first row.
    #[inline]
    pub(super) fn apply(&self, mut row: Row, mean: &mut Row) -> Row {
        // Where errors are independent the rows before foretell nothing: so it is in most pictures.
        if self.fade == 0.0 && self.gain == 0.0 {
            return row.map(|v| v * self.weight * self.size);
        }
        for (value, mean) in row.iter_mut().zip(mean) {
            let foretold = self.fade * *mean;
            let surprise = self.weight * *value - foretold;
            *mean = foretold + self.gain * surprise;
            *value = surprise * self.size;
        }
        row
    }
}

/// Works out, bin after bin, how correlated values become independent: it depends on where the bins are alone.
struct Filter {
    share: f64,
    length_px: f64,
    at: Option<f64>,
    variance: f64,
}

impl Filter {
    fn new(share: f64, length_px: f64) -> Self {
        Self { share, length_px, at: None, variance: share }
    }

    /// What is done at the next bin, at a distance; `weight` is one over the standard deviation of each that is `joined`.
    fn next(&mut self, at: f64, weight: f64, joined: f64) -> Whitening {
        if self.share == 0.0 {
            return Whitening { weight, fade: 0.0, gain: 0.0, size: joined.sqrt() };
        }
        let fade = self.at.map_or(1.0, |last| (-(at - last).abs() / self.length_px).exp());
        self.variance = fade * fade * self.variance + self.share * (1.0 - fade * fade);
        self.at = Some(at);
        let total = self.variance + (1.0 - self.share) / joined;
        let gain = self.variance / total;
        self.variance *= 1.0 - gain;
        Whitening { weight, fade, gain, size: 1.0 / total.sqrt() }
    }
}
