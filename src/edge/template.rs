//! The profile common to all sectors: value over distance.

use crate::fit::robust::scatter;

/// A profile at equally spaced distances.
#[derive(Debug, Clone)]
pub struct Template {
    /// Distance of the first value.
    pub start_px: f64,
    /// Distance between values.
    pub step_px: f64,
    /// The values.
    pub values: Vec<f64>,
}

impl Template {
    /// Distance of a node.
    pub(super) fn place_px(&self, node: usize) -> f64 {
        self.start_px + self.step_px * node as f64
    }

    /// Smooths with a binomial kernel, `times` over.
    pub fn smooth(&mut self, times: usize) {
        let n = self.values.len();
        for _ in 0..times {
            let old = self.values.clone();
            for i in 1..n.saturating_sub(1) {
                self.values[i] = 0.25 * old[i - 1] + 0.5 * old[i] + 0.25 * old[i + 1];
            }
        }
    }

    /// Smooths just enough that noise makes no more than a small part of the slopes: noise that passes for slope
    /// would pass for knowledge of the place too.
    pub fn denoise(&mut self) {
        const NOISE_SHARE: f64 = 0.02;
        let n = self.values.len();
        if n < 8 {
            return;
        }
        // Third differences of a smooth curve are small: what is left of them is noise (variance 20 of one).
        let v = &self.values;
        let mut thirds: Vec<f64> =
            (0..n - 3).map(|i| (v[i + 3] - 3.0 * v[i + 2] + 3.0 * v[i + 1] - v[i]).abs()).collect();
        let noise2 = scatter(&mut thirds).powi(2) / 20.0;
        let energy = |v: &[f64]| v.windows(3).map(|w| 0.25 * (w[2] - w[0]).powi(2)).sum::<f64>();
        let mut passes = 0;
        while passes < n * n / 64 {
            // Slope noise of a Gaussian-smoothed row: η² / (4 √π σ³) for σ² = passes / 2 bins.
            let sigma = (0.5 * passes as f64).sqrt();
            let slope_noise2 = noise2 * (0.5f64).min(0.141 / sigma.powi(3).max(1e-9));
            if slope_noise2 * n as f64 <= NOISE_SHARE * energy(&self.values) {
                return;
            }
            self.smooth(1);
            passes += 1;
        }
    }

    /// The strongest edge near distance 0 as a step: the levels either side, where it crosses the middle between them, and its
    /// softness (standard deviation of the Gaussian with the same peak slope).
    pub fn edge(&self) -> Step {
        /// Softnesses from its middle at which an edge has risen.
        const RISEN: f64 = 2.6;
        /// What a tint has moved an edge by is known to this part of it (standard deviation), as is what it may have.
        const DOUBT: f64 = 0.3;
        let n = self.values.len();
        let v = &self.values;
        let slope: Vec<f64> = (0..n)
            .map(|i| {
                let inner = i > 0 && i + 1 < n;
                if inner { 0.5 * (v[i + 1] - v[i - 1]) / self.step_px } else { 0.0 }
            })
            .collect();
        // Of edges about as strong, the one nearest to where it is expected; the ends of the profile are no edges.
        let end_px = self.place_px(n - 1);
        let strength = |i: usize| {
            let distance_px = self.place_px(i);
            let reach_px = if distance_px < 0.0 { self.start_px } else { end_px };
            slope[i].abs() * (1.0 - 0.7 * (distance_px / reach_px).powi(2))
        };
        let margin = (n / 16).max(1);
        let peak = (margin..n.saturating_sub(margin))
            .max_by(|&a, &b| strength(a).total_cmp(&strength(b)))
            .unwrap_or(0);
        let sign = slope[peak].signum();
        let floor = 0.04 * slope[peak].abs();
        // The edge reaches as far as the slope keeps its sign and more than a trace of its size.
        let mut lo = peak;
        while lo > 0 && slope[lo - 1] * sign > floor {
            lo -= 1;
        }
        let mut hi = peak;
        while hi + 1 < n && slope[hi + 1] * sign > floor {
            hi += 1;
        }
        let softness = |rise: f64| {
            rise.abs() / (slope[peak].abs().max(1e-300) * (2.0 * std::f64::consts::PI).sqrt())
        };
        // Where a part of the rise from one node to another is reached.
        let crossing_px = |lo: usize, hi: usize, part: f64| {
            let level = self.values[lo] + part * (self.values[hi] - self.values[lo]);
            let at = (lo..hi).find_map(|i| {
                let (a, b) = (self.values[i] - level, self.values[i + 1] - level);
                (a * b <= 0.0 && a != b).then(|| i as f64 + a / (a - b))
            });
            self.start_px + self.step_px * at.unwrap_or(peak as f64)
        };
        let (inner, outer) = (self.values[lo], self.values[hi]);
        let (distance_px, softness_px) = (crossing_px(lo, hi, 0.5), softness(outer - inner));
        // A heat tint or a shadow beside the edge goes on sloping: the rim's own levels are where it has risen.
        for _ in 0..3 {
            let reach = RISEN * softness(self.values[hi] - self.values[lo]) / self.step_px;
            let reach = (reach.ceil() as usize).max(1);
            lo = lo.max(peak.saturating_sub(reach));
            hi = hi.min(peak + reach);
        }
        let quartiles_px = [0.25, 0.5, 0.75].map(|part| crossing_px(lo, hi, part));
        let fades = self.fades(lo, hi);
        let (moved_px, perhaps_px) = self.tint_px(fades, quartiles_px, softness_px);
        let rim_px = quartiles_px[1] - moved_px;
        let rim_sd_px = DOUBT * (rim_px - distance_px).hypot(perhaps_px);
        Step { distance_px, rim_px, rim_sd_px, inner, outer, softness_px, fades }
    }

    /// How the profile goes on beyond a rim that rises from node `lo` to `hi`, inside and outside of it, as parts of the rise.
    fn fades(&self, lo: usize, hi: usize) -> [f64; 2] {
        let v = &self.values;
        let rise = v[hi] - v[lo];
        if rise == 0.0 {
            return [0.0; 2];
        }
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let (inner, outer) =
            (&v[..(lo + 1).div_ceil(3)], &v[v.len() - (v.len() - hi).div_ceil(3)..]);
        [(v[lo] - mean(inner)) / rise, (mean(outer) - v[hi]) / rise]
    }

    /// How far a tint that fades away on one side of the rim has moved the rim's middle level, and how far it may have besides,
    /// where the rim rises with these quartiles and fades like this beyond them. The tint shows twice: the rim leans, its outer half
    /// reaching farther than its inner one or the other way round, and the profile goes on beyond the rim. One alone may be
    /// a mark's own form: a line's flank leans too.
    fn tint_px(
        &self,
        [inside, outside]: [f64; 2],
        [first, middle, last]: [f64; 3],
        softness_px: f64,
    ) -> (f64, f64) {
        /// Exponential tails on Gaussian edges move their middle by as many softnesses as this times what they lean.
        const MOVES: f64 = 5.0;
        /// What goes on beyond the rim, as a part of its step: from here on it may be a tint, and from there on it is.
        const FADES: std::ops::Range<f64> = 0.03..0.06;
        let leans = (first + last - 2.0 * middle) / (last - first).max(self.step_px);
        let beyond = if leans > 0.0 { outside } else { inside };
        let share = ((beyond - FADES.start) / (FADES.end - FADES.start)).clamp(0.0, 1.0);
        let moves_px = MOVES * leans * (1.0 - lens_share(softness_px)) * softness_px;
        (moves_px * share, moves_px * (1.0 - share))
    }
}

/// How much of an edge's softness a lens in focus explains, 0..1.
pub(crate) fn lens_share(softness_px: f64) -> f64 {
    const LENS_PX: f64 = 1.5;
    (LENS_PX / softness_px).min(1.0)
}

/// An edge in a profile.
#[derive(Debug, Clone, Copy, Default)]
pub struct Step {
    /// Where it crosses the middle between its levels.
    pub distance_px: f64,
    /// Where it crosses the middle between the levels close by, which a tint or shadow beside it moves less, without what a
    /// tint moves it still.
    pub rim_px: f64,
    /// Standard deviation of that place as far as it is a matter of what is called tint.
    pub rim_sd_px: f64,
    /// Level on the inside.
    pub inner: f64,
    /// Level on the outside.
    pub outer: f64,
    /// Standard deviation of the Gaussian blur with the same peak slope.
    pub softness_px: f64,
    /// How much the profile goes on beyond the rim inside and outside, as parts of its step: what a tint leaves to be seen.
    pub fades: [f64; 2],
}

impl Step {
    /// What fades away outside the edge: as the step itself rises, then over a few softnesses.
    pub(super) fn tail(&self, distance_px: f64) -> f64 {
        const FADES_OVER: f64 = 4.0;
        let from_edge = (distance_px - self.distance_px) / self.softness_px.max(0.5);
        // A logistic with the slope of the Gaussian edge.
        1.0 / (1.0 + (-1.6 * from_edge).exp()) * (-from_edge.max(0.0) / FADES_OVER).exp()
    }

    /// Outer minus inner level.
    pub fn contrast(&self) -> f64 {
        self.outer - self.inner
    }
}
