//! Takes the errors behind measured lengths apart: what the paths can see, its values, and what would add the rest.

use nalgebra::{DMatrix, DVector, Vector3};

use super::data::Data;
use super::model::{Bar, ERRORS, Errors, Point, to_unit};
use super::path::{Path, Setup};
use super::report::{Combination, Report, Term, Value};
use super::swarm;
use crate::error::{Error, Result};
use crate::fit::{least_squares, serial};
use crate::uncertainty::{K95, k95};

/// Singular values under this part of the largest are zero: the rest of rounding and of second-order terms.
const RANK_TOLERANCE: f64 = 1e-6;

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

/// What a set of points can see.
struct Sight {
    /// Orthonormal columns that span the nuisances.
    nuisance: DMatrix<f64>,
    /// Sensitivities with the nuisances taken out.
    left: DMatrix<f64>,
    singular_values: Vec<f64>,
    /// Rows: visible directions of the scaled errors.
    directions: DMatrix<f64>,
    rank: usize,
}

impl Sight {
    fn of(bar: &Bar, points: &[Point], options: &Options) -> Result<Self> {
        let j = bar.sensitivity(points)?;
        let nuisance = orthonormal(&nuisances(bar, points, options)?);
        let left = &j - &nuisance * nuisance.tr_mul(&j);
        let triangle = if left.nrows() > 6 { left.clone().qr().r() } else { left.clone() };
        let svd = triangle.svd(false, true);
        let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
        order.sort_by(|&a, &b| svd.singular_values[b].total_cmp(&svd.singular_values[a]));
        let largest = j.norm().max(f64::MIN_POSITIVE);
        let rank =
            order.iter().filter(|&&i| svd.singular_values[i] > RANK_TOLERANCE * largest).count();
        let v_t = svd.v_t.unwrap_or_else(|| DMatrix::zeros(0, 6));
        let per_point = (points.len() as f64).sqrt();
        Ok(Self {
            singular_values: order.iter().map(|&i| svd.singular_values[i] / per_point).collect(),
            directions: DMatrix::from_fn(rank, 6, |r, c| v_t[(order[r], c)]),
            rank,
            nuisance,
            left,
        })
    }

    /// How much of an error's own direction is visible: 1 all of it, 0 nothing.
    fn share(&self, error: usize) -> f64 {
        self.directions.column(error).norm_squared()
    }

    fn visible(&self) -> Vec<usize> {
        (0..6).filter(|&i| self.share(i) > 1.0 - 1e-6).collect()
    }
}

/// Columns of what is not known beside the errors.
fn nuisances(bar: &Bar, points: &[Point], options: &Options) -> Result<DMatrix<f64>> {
    let paths = points.iter().map(|p| p.path + 1).max().unwrap_or(0);
    let mut columns: Vec<DVector<f64>> = Vec::new();
    if options.unknown_cup {
        for path in 0..paths {
            for axis in 0..3 {
                let at = |step: f64| {
                    bar.lengths(points, &[0.0; 6], |p| {
                        (if p == path { Vector3::ith(axis, step) } else { Vector3::zeros() }, 0.0)
                    })
                };
                let (up, down) = (at(0.01)?, at(-0.01)?);
                columns.push(DVector::from_fn(points.len(), |i, _| (up[i] - down[i]) / 0.02));
            }
        }
    }
    if options.unknown_bar {
        columns.push(DVector::from_element(points.len(), -1.0));
    }
    Ok(if columns.is_empty() {
        DMatrix::zeros(points.len(), 0)
    } else {
        DMatrix::from_columns(&columns)
    })
}

/// Orthonormal columns of the same span (Gram-Schmidt, twice for rounding).
fn orthonormal(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let mut kept: Vec<DVector<f64>> = Vec::new();
    for column in matrix.column_iter() {
        let mut v = column.into_owned();
        let norm = v.norm();
        for _ in 0..2 {
            for k in &kept {
                v -= k * k.dot(&v);
            }
        }
        if v.norm() > 1e-7 * norm {
            kept.push(v.normalize());
        }
    }
    if kept.is_empty() { DMatrix::zeros(matrix.nrows(), 0) } else { DMatrix::from_columns(&kept) }
}

/// Least squares and swarm on what is visible.
pub fn decouple(data: &Data, options: &Options) -> Result<Report> {
    let bar = Bar::new(&options.setup)?;
    let sight = Sight::of(&bar, &data.points, options)?;
    let (n, rank, known) = (data.points.len(), sight.rank, sight.nuisance.ncols());
    if n < rank + known + 3 {
        return Err(Error::measure(
            "ball bar data",
            format!("{n} points are too few, {} are the least here", rank + known + 3),
            "measure the whole path",
        ));
    }
    if options.noise_mm.is_some_and(|s| !(s.is_finite() && s > 0.0)) {
        return Err(Error::option(
            "--noise-mm",
            "is not above 0",
            "give the standard uncertainty of a length in mm",
        ));
    }
    let scale = bar.scale();
    let errors_of = |z: &[f64]| -> Errors {
        std::array::from_fn(|i| {
            scale[i] * (0..rank).map(|r| sight.directions[(r, i)] * z[r]).sum::<f64>()
        })
    };
    // The exact lengths, with the nuisances' part projected out; the sensitivities at zero serve as derivative.
    let derivative = &sight.left * sight.directions.transpose();
    let residuals = |z: &[f64]| -> DVector<f64> {
        let r = match bar.known(&data.points, &errors_of(z)) {
            Ok(l) => DVector::from_fn(n, |i, _| l[i] - data.lengths_mm[i]),
            Err(_) => DVector::from_element(n, f64::NAN),
        };
        &r - &sight.nuisance * sight.nuisance.tr_mul(&r)
    };
    let solved =
        least_squares::solve(DVector::zeros(rank), least_squares::Options::default(), |z| {
            (residuals(z.as_slice()), derivative.clone())
        });
    let z = solved.parameters.as_slice();
    let errors = errors_of(z);

    // Whatever order the file has them in: errors go together along the path, in time or both.
    let along: Vec<f64> = data.along_paths().iter().map(|&i| solved.residuals[i]).collect();
    let widen = [solved.residuals.as_slice(), &along]
        .map(|r| serial::widening(r, rank + known).0)
        .into_iter()
        .fold(1.0, f64::max);
    let rms = solved.residuals.norm() / ((n - rank - known) as f64).sqrt();
    // Of n points that repeat each other n / widen are news, and the unknowns were taken from those.
    let news = (n as f64 / widen - (rank + known) as f64).max(1.0);
    let (u, k) = match options.noise_mm {
        Some(noise) => (noise * widen.sqrt(), K95),
        None => (solved.residuals.norm() / news.sqrt(), k95(news)),
    };
    // Variance of any combination c of the scaled errors: cᵀ D⁺ c with D from the visible directions.
    let variance = |c: &[f64; 6]| -> f64 {
        let along = &sight.directions * DVector::from_row_slice(c);
        (along.transpose() * &solved.covariance * &along)[(0, 0)].max(0.0)
    };
    let before = residuals(&vec![0.0; rank]).norm() / (n as f64).sqrt();

    let visible = sight.visible();
    let value = |i: usize, errors: &Errors| to_unit(i, errors[i]);
    let values: Vec<Value> = visible
        .iter()
        .map(|&i| {
            let mut c = [0.0; 6];
            c[i] = scale[i];
            Value {
                name: ERRORS[i].0.to_owned(),
                value: value(i, &errors),
                unit: ERRORS[i].1.to_owned(),
                u95: to_unit(i, k * u * variance(&c).sqrt()),
            }
        })
        .collect();
    let hidden: Vec<usize> = (0..6).filter(|i| !visible.contains(i)).collect();
    let combinations = rows(&sight.directions, &hidden, &visible)
        .into_iter()
        .map(|c| Combination {
            value: (0..6).map(|i| c[i] * errors[i] / scale[i]).sum(),
            u95: k * u * variance(&c).sqrt(),
            unit: "mm".to_owned(),
            terms: terms(&c, |i, c| c / to_unit(i, scale[i])),
        })
        .collect();
    let null_directions =
        null_space(&sight).iter().map(|c| terms(c, |i, c| c * to_unit(i, scale[i]))).collect();

    // The swarm on the same sums of squares, |R z - Qᵀ r|², in coordinates of equal weight: w = R z.
    let found = if rank == 0 {
        Vec::new()
    } else {
        let qr = derivative.clone().qr();
        let target = -(qr.q().transpose() * residuals(&vec![0.0; rank]));
        let bound = 2.0 * target.norm() + 1e-6;
        let cost = |w: &[f64]| (DVector::from_row_slice(w) - &target).norm_squared();
        let w = DVector::from_vec(swarm::minimise(rank, bound, options.swarm, cost)?);
        qr.r().solve_upper_triangular(&w).map_or_else(Vec::new, |z| z.as_slice().to_vec())
    };
    let swarm_errors = if found.len() == rank { errors_of(&found) } else { [f64::NAN; 6] };
    let mut warnings = data.warnings.clone();
    if !options.unknown_cup || !options.unknown_bar {
        warnings.push(
            "the base cup's position and the bar's length are taken as exact where --unknown-cup and --unknown-bar do not say \
             otherwise: an error of theirs goes into the result"
                .to_owned(),
        );
    }
    if options.noise_mm.is_some_and(|s| rms > 3.0 * s) {
        warnings.push(format!("the six errors leave {rms:.4} mm, more than the noise: something else is wrong (see diagnose)"));
    }
    Ok(Report {
        rank,
        singular_values: sight.singular_values,
        swarm: visible
            .iter()
            .map(|&i| Term { name: ERRORS[i].0.to_owned(), value: value(i, &swarm_errors) })
            .collect(),
        visible: values,
        not_visible: hidden.iter().map(|&i| ERRORS[i].0.to_owned()).collect(),
        combinations,
        null_directions,
        would_add: suggest(&bar, data, options, &hidden)?,
        points: n,
        paths: data.paths.iter().map(|(_, p)| p.name()).collect(),
        before_rms_mm: before,
        after_rms_mm: solved.residuals.norm() / (n as f64).sqrt(),
        residuals: data
            .points
            .iter()
            .zip(solved.residuals.iter())
            .map(|(p, r)| (p.path, p.pose.b_rad.to_degrees(), -r))
            .collect(),
        measured: residuals(&vec![0.0; rank]).iter().map(|r| -r).collect(),
        warnings,
    })
}

fn terms(c: &[f64; 6], factor: impl Fn(usize, f64) -> f64) -> Vec<Term> {
    (0..6)
        .filter(|&i| c[i].abs() > 1e-6)
        .map(|i| Term { name: ERRORS[i].0.to_owned(), value: factor(i, c[i]) })
        .collect()
}

/// Reduced rows of a row space on some columns; the columns to drop are known by themselves.
fn rows(space: &DMatrix<f64>, columns: &[usize], drop: &[usize]) -> Vec<[f64; 6]> {
    let mut m: Vec<[f64; 6]> = (0..space.nrows())
        .map(|r| std::array::from_fn(|c| if drop.contains(&c) { 0.0 } else { space[(r, c)] }))
        .collect();
    let mut done = 0;
    for &c in columns {
        let Some(pivot) = (done..m.len()).max_by(|&a, &b| m[a][c].abs().total_cmp(&m[b][c].abs()))
        else {
            break;
        };
        if m[pivot][c].abs() < 1e-6 {
            continue;
        }
        m.swap(done, pivot);
        let lead = m[done][c];
        m[done].iter_mut().for_each(|v| *v /= lead);
        let row = m[done];
        for (r, other) in m.iter_mut().enumerate() {
            if r != done {
                let f = other[c];
                other.iter_mut().zip(row).for_each(|(v, w)| *v -= f * w);
            }
        }
        done += 1;
    }
    m.truncate(done);
    m
}

/// Directions of the scaled errors that change no length.
fn null_space(sight: &Sight) -> Vec<[f64; 6]> {
    let d = &sight.directions;
    let blind = DMatrix::<f64>::identity(6, 6) - d.transpose() * d;
    rows(&blind, &[0, 1, 2, 3, 4, 5], &[])
}

/// The path that makes most of the hidden errors visible; `None` if nothing is hidden or none helps.
fn suggest(bar: &Bar, data: &Data, options: &Options, hidden: &[usize]) -> Result<Option<String>> {
    let mut best: Option<(usize, f64, String)> = None;
    let now = Sight::of(bar, &data.points, options)?;
    let side = 0.375 * options.setup.bar_mm;
    for name in [
        "zb".into(),
        format!("zbk-y{side}"),
        "xb".into(),
        format!("xbk-y{side}"),
        format!("zb-y{side}"),
    ] {
        let path = Path::parse(&name)?;
        let Ok(poses) = path.plan(&options.setup, 0.0, -60.0, 120) else { continue };
        let mut points = data.points.clone();
        points.extend(Point::of(&path, data.paths.len(), &poses));
        let sight = Sight::of(bar, &points, options)?;
        let gained = hidden.iter().filter(|&&i| sight.share(i) > 1.0 - 1e-6).count();
        // Among equals, the path that shows its weakest direction best.
        let weakest = sight.singular_values[sight.rank.saturating_sub(1)];
        let better = best.as_ref().is_none_or(|b| gained > b.0 || (gained == b.0 && weakest > b.1));
        if sight.rank > now.rank && better {
            best = Some((gained, weakest, name));
        }
    }
    Ok(best.map(|b| b.2))
}
