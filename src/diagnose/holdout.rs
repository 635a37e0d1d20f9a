//! The gap on captures the fit has not seen: whole sites are held out in turn.

use nalgebra::DMatrix;

use crate::diagnose::fit::{Fitted, Fitter};
use crate::fit::least_squares;
use crate::fit::least_squares::transposed_times;

/// Number of folds: many, so that nearly all of the data fit the model that the rest judge.
const FOLDS: usize = 20;

/// Root mean square of what a model leaves on held-out sites, mm; its effects are refitted (linearly, about its solution)
/// without them. The baseline's own parameters are of the set-up (where the target was put), are in no model file, and are found
/// anew in every run: they are taken from all sites, and what they take of the noise is added again, so that the true model
/// would leave the noise, no more and no less. Of the noise's variance the data show `share`: less than all where more was given.
pub fn held_out_rms(fitter: &Fitter, fitted: &Fitted, share: f64) -> f64 {
    let layout = fitter.experiment.layout();
    let mut white = fitter.whiten(&fitted.tangent, &fitted.noise);
    let setup = 0..fitted.model.nuisances.len();
    let of_setup = fitted.tangent.columns_range(setup.clone()).into_owned();
    let setup_white = white.columns_range(setup.clone()).into_owned();
    let setup_covariance = match setup.len() {
        0 => DMatrix::zeros(0, 0),
        _ => least_squares::covariance(&setup_white, 1e-9).0,
    };
    let found = &setup_covariance * setup_white.transpose();
    let taken = &of_setup * setup_covariance;
    let scale: Vec<f64> = white.column_iter().map(|c| c.norm().max(1e-300)).collect();
    white.column_iter_mut().zip(&scale).for_each(|(mut c, s)| c /= *s);
    let residual = fitter.whiten_residual(fitted, &fitted.noise);
    let (information, along) = (transposed_times(&white, &white), white.tr_mul(&residual));
    let (mut sum, mut count) = (0.0, 0.0);
    for fold in 0..FOLDS {
        // Spread sites over the folds so that neighbours in the file part.
        let out = |g: usize| (layout.sites[g] * 7 + layout.sites[g] / FOLDS) % FOLDS == fold;
        let rows = fitter.space.rows_of(&out);
        let (w, r) = (white.select_rows(&rows), residual.select_rows(&rows));
        let left = &information - transposed_times(&w, &w);
        let mut step = match scale.len() {
            0 => DMatrix::zeros(0, 1),
            n => {
                let solved = left.svd(true, true).solve(&(&along - w.tr_mul(&r)), 1e-12);
                solved.unwrap_or_else(|_| DMatrix::zeros(n, 1))
            }
        };
        step.rows_range_mut(setup.clone()).fill(0.0);
        let beyond = &residual - &white * &step;
        step.iter_mut().zip(&scale).for_each(|(v, s)| *v /= s);
        step.rows_range_mut(setup.clone()).copy_from(&(&found * beyond));
        let predicted = &fitted.tangent * step;
        for (i, &g) in layout.groups.iter().enumerate() {
            if out(g) && fitter.space.kept(i) {
                sum += (fitted.residual[i] - predicted[(i, 0)]).powi(2);
                sum += share * taken.row(i).dot(&of_setup.row(i));
                count += 1.0;
            }
        }
    }
    (sum / f64::max(count, 1.0)).sqrt()
}
