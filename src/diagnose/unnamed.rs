//! What has no name, described: the shapes of the model with their sizes, and what has no shape at all.

use nalgebra::DMatrix;

use crate::diagnose::fit::{Extra, ExtraTerm, Fitter};
use crate::diagnose::generic::Term;
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
    let kept = (0..layout.values.len()).filter(|i| fitter.space.kept(*i));
    let largest_mm = kept.map(|i| s.baseline.residual[i].abs()).fold(0.0, f64::max);
    let terms: Vec<(Term, &ExtraTerm)> = (f.model.extras.iter())
        .filter_map(|e| match e.kind {
            Extra::Generic(term) => Some((term, e)),
            Extra::Form { .. } => None,
        })
        .collect();
    let (values, covariance) = coefficients(fitter, s, largest_mm);
    let mut at = 0;
    let described = |(term, e): (Term, &ExtraTerm)| {
        let range = at..at + e.values.len();
        at = range.end;
        let values = &values[range.clone()];
        let (amplitude, change) = term.amplitude(&e.columns, values);
        let own = covariance.view((range.start, range.start), (change.len(), change.len()));
        let u95 = k95(f.noise.dof) * change.dot(&(own * &change)).max(0.0).sqrt();
        Unnamed {
            output: layout.directions[term.direction].name.to_string(),
            versus: term.versus(layout),
            shape: term.shape_name(),
            amplitude_mm: amplitude,
            amplitude_u95_mm: Some(u95),
            formula: (amplitude > 0.0).then(|| term.formula(layout, values, amplitude)),
            text: term.text(layout, amplitude, u95),
        }
    };
    terms.into_iter().map(described).collect()
}

/// The coefficients of all shapes, one after another, and their covariance. Where the set-up (a target's place, a cup, a centre) takes up
/// most of a shape, or another shape does, they are those that leave the same with the set-up found anew, none much larger than
/// `largest_mm`.
fn coefficients(fitter: &Fitter, s: &Selection, largest_mm: f64) -> (Vec<f64>, DMatrix<f64>) {
    let f = &s.fitted;
    let offsets = fitter.offsets(&f.model);
    let of_shapes: Vec<usize> = (f.model.extras.iter().enumerate())
        .filter(|(_, e)| e.is_shape())
        .flat_map(|(i, e)| {
            let at = offsets[f.model.active.len() + i];
            at..at + e.values.len()
        })
        .collect();
    let free = fitter.free(&f.model);
    let given: Vec<f64> = of_shapes.iter().map(|c| free[*c]).collect();
    let covariance = f.covariance.select_rows(&of_shapes).select_columns(&of_shapes);
    let is_lost = |c: usize| {
        given[c].abs() > NONSENSE * largest_mm || covariance[(c, c)].sqrt() > UNKNOWN * largest_mm
    };
    let count = given.len();
    if !(0..count).any(is_lost) {
        return (given, covariance);
    }
    let white = fitter.whiten(&f.tangent, &f.noise);
    let shapes = white.select_columns(&of_shapes);
    let rows = white.nrows();
    let bounded = |others: DMatrix<f64>| {
        let mut all = DMatrix::zeros(rows + count, count + others.ncols());
        all.view_mut((0, 0), (rows, count)).copy_from(&shapes);
        all.view_mut((0, count), (rows, others.ncols())).copy_from(&others);
        (0..count).for_each(|c| all[(rows + c, c)] = 1.0 / largest_mm.max(1e-12));
        all
    };
    let set_up = f.model.nuisances.len();
    let design = bounded(white.columns(0, set_up).into_owned());
    let mut target = DMatrix::zeros(rows + count, 1);
    let seen = &shapes * DMatrix::from_column_slice(count, 1, &given);
    target.view_mut((0, 0), (rows, 1)).copy_from(&seen);
    let (inverse, _) = least_squares::covariance(&design, 1e-12);
    let values = inverse * design.tr_mul(&target);
    let others: Vec<usize> = (0..white.ncols()).filter(|c| !of_shapes.contains(c)).collect();
    let covariance = least_squares::covariance(&bounded(white.select_columns(&others)), 1e-12).0;
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
