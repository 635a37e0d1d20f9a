//! Takes the errors behind measured lengths apart: what the paths can see, its values, and what would add the rest.

use nalgebra::{DMatrix, DVector};

use super::data::Data;
use super::model::{Bar, ERRORS, Errors, Point, to_unit};
use super::path::{Kind, Path, Setup};
use super::report::{Combination, Report, Term, Value};
use super::sight::{self, Sight, null_space, rows, suggest, there_and_back};
use super::swarm;
use crate::error::{Error, Result, above_zero};
use crate::fit::least_squares::Solution;
use crate::fit::{least_squares, serial};
use crate::uncertainty::{K95, k95, scatters_more};

/// What is known beside the lengths.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Lengths of the set-up.
    pub setup: Setup,
    /// The base cup's position is not known: three nuisances for each path.
    pub unknown_cup: bool,
    /// The bar's length is not known: one nuisance.
    pub unknown_bar: bool,
    /// Standard uncertainty of a length; `None`: from the residuals.
    pub noise_mm: Option<f64>,
    /// Paths for names in the data that do not say it themselves.
    pub paths: Vec<(String, Path)>,
    /// The particle swarm's settings.
    pub swarm: swarm::Options,
}

/// Least squares and swarm on what is visible.
pub fn decouple(data: &Data, options: &Options) -> Result<Report> {
    let bar = Bar::new(&options.setup)?;
    let sight = Sight::of(&bar, &data.points, options)?;
    let (n, unknowns) = (data.points.len(), sight.rank + sight.nuisance.ncols());
    check(n, unknowns, options)?;
    let problem = Problem { scale: bar.scale(), bar: &bar, data, sight: &sight };
    let derivative = problem.derivative();
    let nothing = DVector::zeros(sight.rank);
    let solved = least_squares::solve(nothing.clone(), least_squares::Options::default(), |z| {
        (problem.residuals(z), || derivative.clone())
    });
    let measured = problem.residuals(&nothing);
    let errors = problem.errors(solved.parameters.as_slice());
    let u95 = length_u95_mm(data, options, &solved, unknowns);
    // Half-width of the interval of any combination c of the scaled errors: cᵀ D⁺ c with D from the visible directions.
    let u95_of = |c: &[f64; 6]| -> f64 {
        let along = &sight.directions * DVector::from_row_slice(c);
        let variance = (along.transpose() * &solved.covariance * &along)[(0, 0)].max(0.0);
        u95 * variance.sqrt()
    };
    let visible = sight.visible();
    let scale = problem.scale;
    let own_u95 = |i: usize| {
        let mut c = [0.0; 6];
        c[i] = scale[i];
        u95_of(&c)
    };
    let value_of = |&i: &usize| Value {
        name: ERRORS[i].0.to_owned(),
        value: to_unit(i, errors[i]),
        unit: ERRORS[i].1.to_owned(),
        u95: to_unit(i, own_u95(i)),
    };
    let hidden: Vec<usize> = (0..6).filter(|i| !visible.contains(i)).collect();
    let combination = |c: [f64; 6]| Combination {
        value: (0..6).map(|i| c[i] * errors[i] / scale[i]).sum(),
        u95: u95_of(&c),
        unit: "mm".to_owned(),
        terms: terms(&c, |i, c| c / to_unit(i, scale[i])),
    };
    let combinations = rows(&sight.directions, &hidden, &visible).into_iter().map(combination);
    let null_direction = |c: &[f64; 6]| terms(c, |i, c| c * to_unit(i, scale[i]));
    let by_swarm = problem.swarm(&derivative, &measured, options.swarm)?;
    let dof = (n - unknowns) as f64;
    let rms = solved.residuals.norm() / dof.sqrt();
    let warnings = data
        .warnings
        .iter()
        .cloned()
        .chain(warnings(options, rms, dof))
        .chain(reversal(data))
        .chain(problem.one_way(&solved.covariance, &own_u95)?)
        .chain(beside_x(data, &visible))
        .collect();
    let swarm_value =
        |&i: &usize| Term { name: ERRORS[i].0.to_owned(), value: to_unit(i, by_swarm[i]) };
    let place = |(p, r): (&Point, &f64)| (p.path, p.pose.b_rad.to_degrees(), -r);
    Ok(Report {
        rank: sight.rank,
        swarm: visible.iter().map(swarm_value).collect(),
        visible: visible.iter().map(value_of).collect(),
        not_visible: hidden.iter().map(|&i| ERRORS[i].0.to_owned()).collect(),
        combinations: combinations.collect(),
        null_directions: null_space(&sight).iter().map(null_direction).collect(),
        would_add: suggest(&bar, data, options, &hidden)?,
        points: n,
        paths: data.paths.iter().map(|(_, p)| p.name()).collect(),
        before_rms_mm: measured.norm() / (n as f64).sqrt(),
        after_rms_mm: solved.residuals.norm() / (n as f64).sqrt(),
        residuals: data.points.iter().zip(solved.residuals.iter()).map(place).collect(),
        measured: measured.iter().map(|r| -r).collect(),
        singular_values: sight.singular_values,
        warnings,
    })
}

/// Checks what is asked for; `unknowns` are the visible directions and the nuisances.
fn check(points: usize, unknowns: usize, options: &Options) -> Result<()> {
    if points < unknowns + 3 {
        return Err(Error::measure(
            "ball bar data",
            format!("{points} points are too few, {} are the least here", unknowns + 3),
            "measure the whole path",
        ));
    }
    let fix = "give the standard uncertainty of a length in mm";
    options.noise_mm.map_or(Ok(()), |s| above_zero("--noise-mm", s, fix))
}

/// Lengths of the bar, as they depend on the visible directions z of the scaled errors.
struct Problem<'a> {
    bar: &'a Bar,
    data: &'a Data,
    sight: &'a Sight,
    scale: Errors,
}

impl Problem<'_> {
    fn errors(&self, z: &[f64]) -> Errors {
        let directions = &self.sight.directions;
        let along = |i: usize| (0..z.len()).map(|r| directions[(r, i)] * z[r]).sum::<f64>();
        std::array::from_fn(|i| self.scale[i] * along(i))
    }

    /// The exact lengths less the measured ones, with the nuisances' part projected out.
    fn residuals(&self, z: &DVector<f64>) -> DVector<f64> {
        let n = self.data.points.len();
        let r = match self.bar.known(&self.data.points, &self.errors(z.as_slice())) {
            Ok(l) => DVector::from_fn(n, |i, _| l[i] - self.data.lengths_mm[i]),
            Err(_) => DVector::from_element(n, f64::NAN),
        };
        &r - &self.sight.nuisance * self.sight.nuisance.tr_mul(&r)
    }

    /// Their derivative, for which the sensitivities without errors serve.
    fn derivative(&self) -> DMatrix<f64> {
        &self.sight.left * self.sight.directions.transpose()
    }

    /// What a backlash does that rows of one way cannot show: the error it moves farthest beyond its interval.
    fn one_way(
        &self,
        covariance: &DMatrix<f64>,
        own_u95: &impl Fn(usize) -> f64,
    ) -> Result<Option<String>> {
        const ONE_UM: f64 = 1e-3;
        /// Parts of an interval by which it moves no error to speak of.
        const SHOWS: f64 = 0.01;
        if !self.data.goes_one_way() {
            return Ok(None);
        }
        let left = self.derivative();
        let columns = sight::backlash(self.bar, &self.data.points, |_| 1.0)?;
        let moved = columns.iter().flat_map(|column| {
            let z = covariance * left.tr_mul(column) * ONE_UM;
            let errors = self.errors(z.as_slice());
            self.sight.visible().into_iter().map(move |i| (i, errors[i].abs()))
        });
        let beyond = |&(i, moved): &(usize, f64)| moved / own_u95(i);
        let worst = moved.max_by(|a, b| beyond(a).total_cmp(&beyond(b)));
        Ok(worst.filter(|worst| beyond(worst) > SHOWS).map(|(i, moved)| {
            let (name, unit) = ERRORS[i];
            format!(
                "B goes one way only: a backlash of B or Z looks like the errors and is in no interval (1 µm moves {name} by up to \
                 {:.5} {unit}); measure there and back, with a column 'dir'",
                to_unit(i, moved)
            )
        }))
    }

    /// The errors that a swarm finds on the same sums of squares, |R z - Qᵀ r|², in coordinates of equal weight: w = R z.
    fn swarm(
        &self,
        derivative: &DMatrix<f64>,
        measured: &DVector<f64>,
        options: swarm::Options,
    ) -> Result<Errors> {
        let rank = self.sight.rank;
        if rank == 0 {
            return Ok(self.errors(&[]));
        }
        let qr = derivative.clone().qr();
        let target = -(qr.q().transpose() * measured);
        let bound = 2.0 * target.norm() + 1e-6;
        let cost = |w: &[f64]| (DVector::from_row_slice(w) - &target).norm_squared();
        let w = DVector::from_vec(swarm::minimise(rank, bound, options, cost)?);
        let z = qr.r().solve_upper_triangular(&w);
        Ok(z.map_or([f64::NAN; 6], |z| self.errors(z.as_slice())))
    }
}

/// Half-width of the 95 % interval of one independent length.
fn length_u95_mm(data: &Data, options: &Options, solved: &Solution, unknowns: usize) -> f64 {
    // Whatever order the file has them in: errors go together along the path, in time or both.
    let along: Vec<f64> = data.along_paths().iter().map(|&i| solved.residuals[i]).collect();
    let widen = [solved.residuals.as_slice(), &along]
        .map(|r| serial::widening(r, unknowns).0)
        .into_iter()
        .fold(1.0, f64::max);
    // Of n points that repeat each other n / widen are news, and the unknowns were taken from those.
    let news = (data.points.len() as f64 / widen - unknowns as f64).max(1.0);
    match options.noise_mm {
        Some(noise) => K95 * (noise * widen.sqrt()),
        None => k95(news) * (solved.residuals.norm() / news.sqrt()),
    }
}

/// What a user should know; `rms_mm` is what the errors leave with `dof` degrees of freedom.
fn warnings(options: &Options, rms_mm: f64, dof: f64) -> Vec<String> {
    let mut warnings = Vec::new();
    if !options.unknown_cup || !options.unknown_bar {
        warnings.push(
            "the base cup's position and the bar's length are taken as exact where --unknown-cup and --unknown-bar do not say \
             otherwise: an error of theirs goes into the result"
                .to_owned(),
        );
    }
    if options.noise_mm.is_some_and(|s| scatters_more(rms_mm, dof, s)) {
        warnings.push(format!("the six errors leave {rms_mm:.4} mm, more than the noise: something else is wrong (see diagnose)"));
    }
    warnings
}

/// What the reversal of the axes adds is told apart by the column `dir`.
fn reversal(data: &Data) -> Option<String> {
    there_and_back(&data.points).then(|| {
        "what a backlash of B or Z adds on the way back is fitted beside the errors and in none of them (diagnose ballbar tells its size)".to_owned()
    })
}

/// The X axis is none of the six: where it moves, what is wrong with it goes into what it looks like.
fn beside_x(data: &Data, visible: &[usize]) -> Option<String> {
    let a0b = ERRORS.iter().position(|e| e.0 == "A0B")?;
    let moves_x = data.paths.iter().any(|(_, path)| path.kind == Kind::Xb);
    (moves_x && visible.contains(&a0b)).then(|| {
        "A0B rests on a path that moves X, and X is taken as straight and square: a tilt of 20 µm/m of it looks like 0.004° of A0B"
            .to_owned()
    })
}

fn terms(c: &[f64; 6], factor: impl Fn(usize, f64) -> f64) -> Vec<Term> {
    (0..6)
        .filter(|&i| c[i].abs() > 1e-6)
        .map(|i| Term { name: ERRORS[i].0.to_owned(), value: factor(i, c[i]) })
        .collect()
}
