//! A sharp edge seen through a Gaussian blur: where a common profile is one, four numbers say more of it than its nodes.

use nalgebra::{SMatrix, SVector};

use crate::edge::Template;
use crate::edge::noise::by_chance;
use crate::edge::pool::{Pool, Sectors};
use crate::edge::sector::Match;
use crate::edge::shape::Shape;
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

impl Sectors<'_> {
    /// The common profile of these matches as a blurred sharp edge; `pool` is that profile on the nodes of `template`, whose weights hold if
    /// a pixel's variance is as assumed times `scale`. `None` where it is another one by more than chance and more than a trace.
    pub(super) fn blurred(
        &self,
        pool: &Pool,
        template: &Template,
        matches: &[Match],
        scale: f64,
    ) -> Option<Blurred> {
        // Pixels went to their nodes along the slopes of a profile with noise in it, which that sharpens: now along the edge's own.
        let first = Blurred::fit(pool, template)?;
        let pool = self.pool(template, &Shape::of(&first.template(template)), matches);
        Blurred::fit(&pool, template).filter(|edge| edge.is_like(&pool, template, scale))
    }
}

impl Blurred {
    /// Fitted to the nodes of `template`.
    fn fit(pool: &Pool, template: &Template) -> Option<Self> {
        let start = template.edge();
        let mut now = Self {
            inner: start.inner,
            outer: start.outer,
            middle_px: start.distance_px,
            sigma_px: start.softness_px,
        };
        let mut settled = false;
        for _ in 0..20 {
            let mut normal = SMatrix::<f64, 4, 4>::zeros();
            let mut right = SVector::<f64, 4>::zeros();
            for (x, value, weight) in pool.nodes(template) {
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
        settled.then_some(now)
    }

    /// Whether it differs from a pool's profile by chance or a trace only.
    fn is_like(&self, pool: &Pool, template: &Template, scale: f64) -> bool {
        /// Root mean square difference, as a part of the step, that does not matter.
        const TRACE: f64 = 0.003;
        let (mut squares, mut weights, mut dof) = (0.0, 0.0, -4.0);
        for (x, value, weight) in pool.nodes(template) {
            squares += weight * (value - self.at(x)).powi(2);
            weights += weight;
            dof += 1.0;
        }
        let trace = (TRACE * self.contrast()).powi(2) * weights;
        dof > 0.0 && (by_chance(squares, dof, scale) || squares < trace)
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
