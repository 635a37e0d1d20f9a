//! What has no name, described: the shapes of the model with their sizes, and what has no shape at all.

use nalgebra::DMatrix;

use crate::diagnose::fit::{Extra, ExtraTerm, Fitter};
use crate::diagnose::report::{Unnamed, Where};
use crate::diagnose::select::Selection;
use crate::fit::least_squares;
use crate::uncertainty::k95;

/// A coefficient beyond so many times the largest of what the baseline left is not the shape's: the set-up takes most of it away again;
const NONSENSE: f64 = 3.0;
/// nor is one whose standard deviation is beyond this part of it.
const UNKNOWN: f64 = 0.5;

/// The shapes without a name.
pub fn shapes(fitter: &Fitter, s: &Selection) -> Vec<Unnamed> {
    let f = &s.fitted;
    let layout = fitter.experiment.layout();
    let offsets = fitter.offsets(&f.model);
    let kept = (0..layout.values.len()).filter(|i| fitter.space.kept(*i));
    let largest_mm = kept.map(|i| s.baseline.residual[i].abs()).fold(0.0, f64::max);
    let described = |(i, e): (usize, &ExtraTerm)| {
        let Extra::Generic(term) = &e.kind else { return None };
        let at = offsets[f.model.active.len() + i];
        let count = e.values.len();
        let mut values = e.values.clone();
        let mut covariance = f.covariance.view((at, at), (count, count)).into_owned();
        let is_lost = |c: usize| {
            values[c].abs() > NONSENSE * largest_mm
                || covariance[(c, c)].sqrt() > UNKNOWN * largest_mm
        };
        if (0..count).any(is_lost) {
            (values, covariance) = apart_from_set_up(fitter, s, at, e, largest_mm);
        }
        let amplitude = term.amplitude(&e.columns, &values);
        let own = 0..term.own_columns(values.len());
        let variance = own.map(|c| covariance[(c, c)]).fold(0.0, f64::max);
        let u95 = k95(f.noise.dof) * variance.sqrt();
        Some(Unnamed {
            output: layout.directions[term.direction].name.to_string(),
            versus: term.versus(layout),
            shape: term.shape_name(),
            amplitude_mm: amplitude,
            amplitude_u95_mm: Some(u95),
            formula: (amplitude > 0.0).then(|| term.formula(layout, &values, amplitude)),
            text: term.text(layout, amplitude, u95),
        })
    };
    f.model.extras.iter().enumerate().filter_map(described).collect()
}

/// The coefficients of a shape, and their covariance, where the set-up (a target's place, a cup, a centre) takes up most of it: those
/// that leave the same with the set-up found anew, none much larger than `largest_mm`. `at` is its first free parameter.
fn apart_from_set_up(
    fitter: &Fitter,
    s: &Selection,
    at: usize,
    shape: &ExtraTerm,
    largest_mm: f64,
) -> (Vec<f64>, DMatrix<f64>) {
    let f = &s.fitted;
    let (count, set_up) = (shape.values.len(), f.model.nuisances.len());
    let white = fitter.whiten(&f.tangent, &f.noise);
    let rows = white.nrows();
    let bounded = |others: DMatrix<f64>| {
        let mut all = DMatrix::zeros(rows + count, count + others.ncols());
        all.view_mut((0, 0), (rows, count)).copy_from(&white.columns(at, count));
        all.view_mut((0, count), (rows, others.ncols())).copy_from(&others);
        (0..count).for_each(|c| all[(rows + c, c)] = 1.0 / largest_mm.max(1e-12));
        all
    };
    let design = bounded(white.columns(0, set_up).into_owned());
    let given = DMatrix::from_column_slice(count, 1, &shape.values);
    let mut target = DMatrix::zeros(rows + count, 1);
    target.view_mut((0, 0), (rows, 1)).copy_from(&(white.columns(at, count) * given));
    let (inverse, _) = least_squares::covariance(&design, 1e-12);
    let values = inverse * design.tr_mul(&target);
    let covariance =
        least_squares::covariance(&bounded(white.clone().remove_columns(at, count)), 1e-12).0;
    (
        values.rows(0, count).iter().copied().collect(),
        covariance.view((0, 0), (count, count)).into_owned(),
    )
}

/// A remainder of no shape, and where it is largest.
pub fn unstructured(worst: Option<Where>) -> Unnamed {
    let (output, versus, amplitude_mm) =
        worst.map_or((String::new(), String::new(), 0.0), |w| (w.output, w.versus, w.rms_mm));
    let text = format!(
        "captures scatter more than the noise allows, in no shape of the dictionary; most in {output} over {versus}"
    );
    let shape = "unstructured".into();
    Unnamed { output, versus, shape, amplitude_mm, amplitude_u95_mm: None, formula: None, text }
}
