//! Which of the errors a set of paths can see, and which path would show the others.

use nalgebra::{DMatrix, DVector, Vector3};

use super::data::Data;
use super::decouple::Options;
use super::model::{Bar, Point};
use super::path::{Path, Range};
use crate::error::Result;

/// Singular values under this part of the largest are zero: the rest of rounding and of second-order terms.
const RANK_TOLERANCE: f64 = 1e-6;

/// What a set of points can see.
pub(super) struct Sight {
    /// Orthonormal columns that span the nuisances.
    pub(super) nuisance: DMatrix<f64>,
    /// Sensitivities with the nuisances taken out.
    pub(super) left: DMatrix<f64>,
    /// By falling size, for one point.
    pub(super) singular_values: Vec<f64>,
    /// Rows: visible directions of the scaled errors.
    pub(super) directions: DMatrix<f64>,
    /// How many there are.
    pub(super) rank: usize,
}

impl Sight {
    pub(super) fn of(bar: &Bar, points: &[Point], options: &Options) -> Result<Self> {
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

    /// Errors whose own direction is visible.
    pub(super) fn visible(&self) -> Vec<usize> {
        (0..6).filter(|&i| self.share(i) > 1.0 - 1e-6).collect()
    }
}

/// Whether the axes went both ways, and the points say so.
pub(super) fn there_and_back(points: &[Point]) -> bool {
    [1.0, -1.0].iter().all(|way| points.iter().any(|p| p.dir == *way))
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
    if there_and_back(points) {
        columns.extend(backlash(bar, points, |p| p.dir)?);
    }
    Ok(if columns.is_empty() {
        DMatrix::zeros(points.len(), 0)
    } else {
        DMatrix::from_columns(&columns)
    })
}

/// What 1 mm of backlash of B at the pivot length and of Z adds to the lengths where the axes go `way`: they stand elsewhere
/// than they read.
pub(super) fn backlash(
    bar: &Bar,
    points: &[Point],
    way: impl Fn(&Point) -> f64,
) -> Result<[DVector<f64>; 2]> {
    let column = |b_rad: f64, up_mm: f64| {
        let at = |sign: f64| {
            let elsewhere = |p: &Point| {
                let mut moved = *p;
                moved.pose.b_rad += sign * b_rad * way(p);
                moved.pose.up_mm += sign * up_mm * way(p);
                moved
            };
            bar.known(&points.iter().map(elsewhere).collect::<Vec<_>>(), &[0.0; 6])
        };
        let (up, down) = (at(1.0)?, at(-1.0)?);
        Ok(DVector::from_fn(points.len(), |i, _| (up[i] - down[i]) / 0.02))
    };
    Ok([column(0.01 / bar.scale_b_mm(), 0.0)?, column(0.0, 0.01)?])
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

/// Reduced rows of a row space on some columns; the columns to drop are known by themselves.
pub(super) fn rows(space: &DMatrix<f64>, columns: &[usize], drop: &[usize]) -> Vec<[f64; 6]> {
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
pub(super) fn null_space(sight: &Sight) -> Vec<[f64; 6]> {
    let d = &sight.directions;
    let blind = DMatrix::<f64>::identity(6, 6) - d.transpose() * d;
    rows(&blind, &[0, 1, 2, 3, 4, 5], &[])
}

/// The path that makes most of the hidden errors visible; `None` if nothing is hidden or none helps.
pub(super) fn suggest(
    bar: &Bar,
    data: &Data,
    options: &Options,
    hidden: &[usize],
) -> Result<Option<String>> {
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
        let range = Range { from_deg: 0.0, to_deg: -60.0, steps: 120 };
        let Ok(poses) = path.plan(&options.setup, range) else { continue };
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
