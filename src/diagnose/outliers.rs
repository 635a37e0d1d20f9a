//! Observations that are set aside: a slipped reading is no effect, and no shape should be bent to follow it.

use nalgebra::DMatrix;

use crate::diagnose::experiment::{Experiment, Layout};
use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::generic::range;
use crate::diagnose::noise::Space;
use crate::diagnose::rim::is_rough;
use crate::diagnose::select::{Selection, select};
use crate::fit::tails::chi2_quantile;

/// Largest part of the observations that may be set aside.
const MOST: f64 = 0.03;
/// How much likelier outliers must be than the effects they would be taken for, nats.
const CLEARLY: f64 = 3.0;

/// A selection on the observations that are not set aside.
pub struct Screened<'a> {
    /// The fitter, without the outliers.
    pub fitter: Fitter<'a>,
    /// What it selected.
    pub selection: Selection,
    /// The outliers, in order.
    pub outliers: Vec<usize>,
}

/// Selects effects and outliers: first what even the largest model cannot explain is set aside; where something was found, then also what
/// lies far from the baseline alone, if that is likelier than the effects found with it.
pub fn screen(experiment: &dyn Experiment, given_mm: Option<f64>) -> Screened<'_> {
    let layout = experiment.layout();
    let mut first = settle(experiment, given_mm, Vec::new());
    let model = &first.selection.fitted.model;
    if model.active.is_empty() && model.extras.is_empty() {
        return first;
    }
    let suspects = {
        let fitter = Fitter { experiment, space: space(experiment, &[], given_mm), given_mm };
        far(&fitter, &fitter.fit(fitter.baseline(), None), layout)
    };
    if !suspects.is_empty() && few(suspects.len(), layout) {
        let second = settle(experiment, given_mm, suspects);
        if second.ln_evidence() > first.ln_evidence() + CLEARLY {
            first = second;
        }
    }
    first
}

impl Screened<'_> {
    /// Log evidence, nats: an outlier may lie anywhere in the values' range, and which one it is must be said; a part is one of
    /// many.
    fn ln_evidence(&self) -> f64 {
        let layout = self.fitter.experiment.layout();
        let f = &self.selection.fitted;
        let n = layout.values.len() as f64;
        let (low, high) = range(&self.selection.baseline.residual);
        let gone = self.outliers.len() as f64;
        let constant = 0.5 * std::f64::consts::TAU.ln();
        self.fitter.ln_likelihood(f)
            - constant * (n - gone)
            - gone * ((high - low).max(1e-12).ln() + n.ln())
            - 0.5 * f.rank as f64 * n.ln()
            - f.model.active.len() as f64 * self.selection.library_tests.max(1.0).ln()
            - f.model.extras.len() as f64 * self.selection.generic_tests.ln()
    }
}

/// Selects, sets aside what even the selected model cannot explain, and selects again.
fn settle<'a>(
    experiment: &'a dyn Experiment,
    given_mm: Option<f64>,
    mut outliers: Vec<usize>,
) -> Screened<'a> {
    let run = |outliers: &[usize]| {
        let fitter = Fitter { experiment, space: space(experiment, outliers, given_mm), given_mm };
        let selection = select(&fitter);
        (fitter, selection)
    };
    let layout = experiment.layout();
    let (mut fitter, mut selection) = run(&outliers);
    for _ in 0..2 {
        let found = far(&fitter, &selection.fitted, layout);
        if found.is_empty() || !few(outliers.len() + found.len(), layout) {
            break;
        }
        outliers.extend(found);
        (fitter, selection) = run(&outliers);
    }
    outliers.sort_unstable();
    Screened { fitter, selection, outliers }
}

/// Whether so many may be set aside.
fn few(count: usize, layout: &Layout) -> bool {
    count as f64 <= MOST * layout.values.len() as f64 + 1.0
}

/// The space the noise is described in; with the form of the artefact's rim where that is rough.
fn space(experiment: &dyn Experiment, outliers: &[usize], given_mm: Option<f64>) -> Space {
    let layout = experiment.layout();
    let mut keep = vec![true; layout.values.len()];
    outliers.iter().for_each(|i| keep[*i] = false);
    let space = Space::new(layout, &keep);
    let fitter = Fitter { experiment, space, given_mm };
    if is_rough(&fitter) { Space::with_rim(layout, &keep) } else { fitter.space }
}

/// Observations that a fit leaves far away: beyond a 0.1 % chance in the whole set.
fn far(fitter: &Fitter, f: &Fitted, layout: &Layout) -> Vec<usize> {
    let n = layout.values.len();
    let limit = chi2_quantile((1e-3 / n as f64).ln(), 1.0).sqrt();
    let column = DMatrix::from_column_slice(n, 1, &f.residual);
    let white = fitter.whiten(&column, &f.noise);
    let top = fitter.space.top();
    let rest: Vec<f64> = (0..n).map(|i| white[(top + i, 0)]).collect();
    let mut sizes: Vec<f64> =
        (0..n).filter(|i| fitter.space.kept(*i)).map(|i| rest[i].abs()).collect();
    if sizes.is_empty() {
        return Vec::new();
    }
    sizes.sort_by(f64::total_cmp);
    // A robust scale: outliers must not hide in the noise they made.
    let scale = (sizes[sizes.len() / 2] / 0.6745).clamp(1e-9, 1.0);
    (0..n).filter(|&i| fitter.space.kept(i) && rest[i].abs() > 1.1 * limit * scale).collect()
}
