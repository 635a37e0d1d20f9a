//! A sharp edge seen through a Gaussian blur: where a common profile is one, four numbers say more of it than its nodes.

use nalgebra::{SMatrix, SVector};

use crate::edge::Template;
use crate::edge::noise::by_chance;
use crate::edge::pool::Pool;
use crate::edge::template::Step;

/// Variance of a uniform distribution one step wide.
const BIN: f64 = 1.0 / 12.0;

/// Levels either side, middle and standard deviation of the blur.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blurred {
    inner: f64,
    outer: f64,
    middle_px: f64,
    sigma_px: f64,
}

impl Blurred {
    /// Fitted to the nodes of `template`, whose weights hold if a pixel's variance is as assumed times `scale`. `None` where the profile is
    /// another one by more than chance and more than a trace.
    pub(super) fn fit(pool: &Pool, template: &Template, scale: f64) -> Option<Self> {
        /// Root mean square difference, as a part of the step, that does not matter.
        const TRACE: f64 = 0.003;
        let start = template.edge();
        let mut now = Self {
            inner: start.inner,
            outer: start.outer,
            middle_px: start.distance_px,
            sigma_px: start.softness_px,
        };
        let nodes: Vec<(f64, f64, f64)> = (0..pool.value.len())
            .filter(|&i| pool.weight[i] > 0.0)
            .map(|i| (template.place_px(i), pool.value[i], pool.weight[i]))
            .collect();
        let mut settled = false;
        for _ in 0..20 {
            let mut normal = SMatrix::<f64, 4, 4>::zeros();
            let mut right = SVector::<f64, 4>::zeros();
            for &(x, value, weight) in &nodes {
                let z = (x - now.middle_px) / now.sigma_px;
                let outer = below(z);
                let rise = now.contrast() * density(z) / now.sigma_px;
                let row = SVector::from([1.0 - outer, outer, -rise, -rise * z]);
                normal += row * row.transpose() * weight;
                right += row * (weight * (value - now.at(x)));
            }
            let step = normal.cholesky()?.solve(&right);
            let sigma_px = (now.sigma_px + step[3]).clamp(0.5 * now.sigma_px, 2.0 * now.sigma_px);
            now = Self {
                inner: now.inner + step[0],
                outer: now.outer + step[1],
                middle_px: now.middle_px + step[2].clamp(-sigma_px, sigma_px),
                sigma_px,
            };
            settled = step[2].hypot(step[3]) < 1e-6 * sigma_px;
            if settled {
                break;
            }
        }
        let (mut squares, mut weights) = (0.0, 0.0);
        for &(x, value, weight) in &nodes {
            squares += weight * (value - now.at(x)).powi(2);
            weights += weight;
        }
        let dof = nodes.len() as f64 - 4.0;
        let trace = (TRACE * now.contrast()).powi(2) * weights;
        let alike = by_chance(squares, dof, scale) || squares < trace;
        (settled && dof > 0.0 && alike).then_some(now)
    }

    /// Outer minus inner level.
    fn contrast(&self) -> f64 {
        self.outer - self.inner
    }

    /// The level at a place.
    fn at(&self, x_px: f64) -> f64 {
        self.inner + self.contrast() * below((x_px - self.middle_px) / self.sigma_px)
    }

    /// As a common profile on the nodes of another one, for bins one step wide: their means are blurred by that. (A pool's nodes are
    /// not: what bins blur, going to the nearest node along the slope sharpens again.)
    pub(super) fn template(&self, nodes: &Template) -> Template {
        let sigma_px = (self.sigma_px.powi(2) + BIN * nodes.step_px.powi(2)).sqrt();
        let seen = Self { sigma_px, ..*self };
        let values = (0..nodes.values.len()).map(|i| seen.at(nodes.place_px(i))).collect();
        Template { values, ..*nodes }
    }

    /// The edge in it: nothing tints it.
    pub(super) fn step(self) -> Step {
        let Self { inner, outer, middle_px, sigma_px } = self;
        Step {
            distance_px: middle_px,
            rim_px: middle_px,
            rim_sd_px: 0.0,
            inner,
            outer,
            softness_px: sigma_px,
            fades: [0.0; 2],
        }
    }
}

/// Share of a normal distribution below `z` standard deviations.
fn below(z: f64) -> f64 {
    0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

/// Density of the standard normal distribution.
fn density(z: f64) -> f64 {
    (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
}
