//! The source's particle swarm, beside least squares.

use argmin::core::{CostFunction, Executor, State};
use argmin::solver::particleswarm::ParticleSwarm;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

use crate::error::{Error, Result};

/// How the swarm searches.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Particles.
    pub particles: usize,
    /// Generations.
    pub generations: u64,
    /// Same seed, same answer.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { particles: 40, generations: 150, seed: 1 }
    }
}

struct Problem<F>(F);

impl<F: Fn(&[f64]) -> f64> CostFunction for Problem<F> {
    type Param = Vec<f64>;
    type Output = f64;
    fn cost(&self, param: &Vec<f64>) -> std::result::Result<f64, argmin::core::Error> {
        Ok((self.0)(param))
    }
}

/// The best of a swarm inside ±`bound` of zero in every coordinate.
pub fn minimise(
    dimensions: usize,
    bound: f64,
    options: Options,
    cost: impl Fn(&[f64]) -> f64,
) -> Result<Vec<f64>> {
    let fail = |reason: String| {
        let fix = "report the file as a bug: the least squares beside it need no swarm";
        Error::measure("particle swarm", reason, fix)
    };
    let bounds = (vec![-bound; dimensions], vec![bound; dimensions]);
    let solver = ParticleSwarm::new(bounds, options.particles)
        .with_rng_generator(Xoshiro256PlusPlus::seed_from_u64(options.seed));
    let result = Executor::new(Problem(cost), solver)
        .configure(|state| state.max_iters(options.generations))
        .run()
        .map_err(|e: argmin::core::Error| fail(e.to_string()))?;
    let best = result.state().get_best_param().map(|p| p.position.clone());
    best.ok_or_else(|| fail("found nothing".into()))
}
