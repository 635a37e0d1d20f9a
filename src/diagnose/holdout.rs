//! The gap on captures the fit has not seen: whole sites are held out in turn.

use nalgebra::DMatrix;

use crate::diagnose::fit::{Fitted, Fitter};

/// Number of folds.
const FOLDS: usize = 5;

/// Root mean square of what a model leaves on held-out sites, mm; the model is refitted (linearly, about its
/// solution) without them.
pub fn held_out_rms(fitter: &Fitter, fitted: &Fitted) -> f64 {
    let layout = fitter.experiment.layout();
    let white = fitter.space.whiten(&fitter.space.split(&fitted.tangent), &fitted.noise);
    let column = DMatrix::from_column_slice(fitted.residual.len(), 1, &fitted.residual);
    let residual = fitter.whiten(&column, &fitted.noise);
    let (mut sum, mut count) = (0.0, 0.0);
    for fold in 0..FOLDS {
        // Spread sites over the folds so that neighbours in the file part.
        let out = |g: usize| (layout.sites[g] * 7 + layout.sites[g] / FOLDS) % FOLDS == fold;
        let mut train = white.clone();
        let mut target = residual.clone();
        for row in fitter.space.rows_of(&out) {
            train.row_mut(row).fill(0.0);
            target[(row, 0)] = 0.0;
        }
        let step = match train.ncols() {
            0 => DMatrix::zeros(0, 1),
            n => {
                let tolerance = 1e-9 * train.norm();
                let solved = train.svd(true, true).solve(&target, tolerance);
                solved.unwrap_or_else(|_| DMatrix::zeros(n, 1))
            }
        };
        let predicted = &fitted.tangent * step;
        for (i, &g) in layout.groups.iter().enumerate() {
            if out(g) && fitter.space.kept(i) {
                sum += (fitted.residual[i] - predicted[(i, 0)]).powi(2);
                count += 1.0;
            }
        }
    }
    (sum / f64::max(count, 1.0)).sqrt()
}
