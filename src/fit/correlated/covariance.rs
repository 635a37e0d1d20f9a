//! How the rows of an edge err together: the covariance at one grid point of the wander.

use nalgebra::DMatrix;

use super::Rows;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    Exponential,
    Gaussian,
}

/// How far wander reaches, and whether it is as large everywhere or as the white part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Kernel {
    pub shape: Shape,
    pub as_noise: bool,
}

/// All kernels of a shape.
pub(super) fn kernels(shape: Shape) -> [Kernel; 2] {
    [false, true].map(|as_noise| Kernel { shape, as_noise })
}

/// A grid point: what share of the variance wanders, how far, and how.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wandering {
    pub share: f64,
    pub length: f64,
    pub kernel: Kernel,
}

/// How alike any two rows of each group wander: the kernel by itself. Nothing where nothing wanders.
pub(super) fn alike(rows: &Rows, shape: Shape, length: f64) -> Vec<DMatrix<f64>> {
    let value = |i: usize, j: usize| {
        let s = (rows.place[i] - rows.place[j]).norm() / length;
        match shape {
            Shape::Exponential => (-s).exp(),
            Shape::Gaussian => (-0.5 * s * s).exp(),
        }
    };
    let block = |range: std::ops::Range<usize>| {
        let (at, n) = (range.start, range.len());
        let mut block = DMatrix::zeros(n, n);
        for j in 0..n {
            for i in j..n {
                block[(i, j)] = value(at + i, at + j);
                block[(j, i)] = block[(i, j)];
            }
        }
        block
    };
    groups(&rows.group).into_iter().map(block).collect()
}

/// Covariance of the rows of a group that stays in place, before scaling.
pub(super) fn block(
    rows: &Rows,
    range: std::ops::Range<usize>,
    alike: Option<&DMatrix<f64>>,
    mean_variance: f64,
    Wandering { share, kernel, .. }: Wandering,
) -> DMatrix<f64> {
    let variance = &rows.variance[range];
    let n = variance.len();
    let mut c = alike.map_or_else(|| DMatrix::zeros(n, n), |alike| alike * share);
    if kernel.as_noise {
        let roots: Vec<f64> = variance.iter().map(|v| v.sqrt()).collect();
        for (mut column, root) in c.column_iter_mut().zip(&roots) {
            column.iter_mut().zip(&roots).for_each(|(c, r)| *c *= r * root);
        }
    } else {
        c *= mean_variance;
    }
    match &rows.covariance {
        Some(known) => c += known * (1.0 - share),
        None => variance.iter().enumerate().for_each(|(i, v)| c[(i, i)] += (1.0 - share) * v),
    }
    c
}

/// The rows of each group; a group's rows stand together.
pub fn groups(group: &[usize]) -> Vec<std::ops::Range<usize>> {
    let mut ranges = Vec::new();
    let mut start = 0;
    for i in 1..=group.len() {
        if i == group.len() || group[i] != group[start] {
            ranges.push(start..i);
            start = i;
        }
    }
    ranges
}

/// Covariance of each group's rows where the group stays in place, before scaling, and the part of it that wanders.
pub(super) fn parts(
    rows: &Rows,
    mean_variance: f64,
    wandering: Wandering,
) -> (Vec<DMatrix<f64>>, Vec<DMatrix<f64>>) {
    let how_alike = if wandering.share > 0.0 {
        alike(rows, wandering.kernel.shape, wandering.length)
    } else {
        Vec::new()
    };
    let of_group = |(i, range): (usize, std::ops::Range<usize>)| {
        let of = |alike| block(rows, range.clone(), alike, mean_variance, wandering);
        let (all, still) = (of(how_alike.get(i)), of(None));
        let wander = &all - still;
        (all, wander)
    };
    groups(&rows.group).into_iter().enumerate().map(of_group).unzip()
}
