//! What is missing and which observations are set aside, found in turn: the likeliest account of both.

use crate::diagnose::experiment::Experiment;
use crate::diagnose::fit::{Extra, Fitted, Fitter, Model};
use crate::diagnose::noise::Space;
use crate::diagnose::outliers::{alone_under_a_shape, far, few_of, whole_captures};
use crate::diagnose::parts::{Part, add, part_chi2};
use crate::diagnose::rim::is_rough;
use crate::diagnose::score::{Standing, gain_of_free};
use crate::diagnose::select::{Selection, select};
use crate::fit::robust::range;

/// How much likelier outliers must be than the effects they would be taken for, nats.
const CLEARLY: f64 = 3.0;

/// How much likelier errors that follow one another must be than independent ones before they are tried in place of what was found,
/// nats; and where nothing was found.
const FOLLOWS: f64 = 3.0;
const FOLLOWS_ALONE: f64 = 7.0;

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
    let mut first = settle(experiment, given_mm, Vec::new(), 0.0);
    let model = &first.selection.fitted.model;
    if model.active.is_empty() && model.extras.is_empty() {
        let second = following(&first, experiment, given_mm, FOLLOWS_ALONE);
        return likelier(first, second);
    }
    let mut suspected = vec![{
        let fitter = Fitter::new(experiment, space(experiment, &[], given_mm, 0.0), given_mm);
        far(&fitter, &fitter.fit(fitter.baseline(), None), layout)
    }];
    if !model.extras.is_empty() && !model.active.is_empty() {
        // A shape may have been bent to follow what the names alone leave far away.
        let names = Model { extras: Vec::new(), ..model.clone() };
        let fitter = &first.fitter;
        let mut suspects = far(fitter, &fitter.fit(names, None), layout);
        suspects.extend(&first.outliers);
        if suspects.len() > first.outliers.len() {
            suspected.push(suspects);
        }
    }
    if model.active.is_empty() {
        suspected.extend(far_from_likeliest_name(&first.fitter, &first.selection));
    }
    for mut suspects in suspected.into_iter().filter(|s| !s.is_empty() && few_of(s, layout)) {
        suspects.sort_unstable();
        if suspects == first.outliers {
            continue;
        }
        let second = settle(experiment, given_mm, suspects, 0.0);
        if second.ln_evidence() > first.ln_evidence() + CLEARLY {
            first = second;
        }
    }
    let mut alone = alone_under_a_shape(&first.fitter, &first.selection.fitted);
    let any_alone = !alone.is_empty();
    alone.extend(&first.outliers);
    if any_alone && few_of(&alone, layout) {
        let second = settle(experiment, given_mm, alone, 0.0);
        if second.ln_evidence() > first.ln_evidence() {
            first = second;
        }
    }
    let second = following(&first, experiment, given_mm, FOLLOWS);
    likelier(first, second)
}

/// The second account of the data where there is one and it is the likelier: a rough rim looks as if errors followed one another.
fn likelier<'a>(first: Screened<'a>, second: Option<Screened<'a>>) -> Screened<'a> {
    match second {
        Some(second) if second.fair_ln_evidence() > first.fair_ln_evidence() => second,
        _ => first,
    }
}

/// What the likeliest single name leaves far away: a shape may have been taken in its place because it could be bent to follow that.
fn far_from_likeliest_name(fitter: &Fitter, s: &Selection) -> Option<Vec<usize>> {
    let scores = Standing::new(fitter, &s.baseline, &[]).scores(fitter, &s.baseline, &s.library);
    let best = scores.into_iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence))?;
    let model = add(fitter, &s.baseline.model, &s.library.candidates[best.candidate].who);
    let named = fitter.fit(model, Some(&s.baseline.noise));
    Some(far(fitter, &named, fitter.experiment.layout()))
}

/// The selection with errors that follow one another, if what the names leave does: a shape, and a name called in beside it, may
/// stand for what merely wanders.
fn following<'a>(
    first: &Screened,
    experiment: &'a dyn Experiment,
    given_mm: Option<f64>,
    least: f64,
) -> Option<Screened<'a>> {
    let layout = experiment.layout();
    if layout.chains.is_empty() {
        return None;
    }
    let fitter = &first.fitter;
    let likeliest = |fitter: &Fitter, f: &Fitted| {
        fitter.space.likeliest_serial(layout, &f.residual, &f.tangent, &f.noise)
    };
    let names = Model { extras: Vec::new(), ..first.selection.fitted.model.clone() };
    let (rough, gain) = likeliest(fitter, &fitter.fit(names, None));
    if gain < least {
        return None;
    }
    let second = settle(experiment, given_mm, Vec::new(), rough);
    // What has been named since does not wander.
    let (finer, _) = likeliest(&second.fitter, &second.selection.fitted);
    let alike = (finer - rough).abs() < 0.1;
    Some(if alike { second } else { settle(experiment, given_mm, Vec::new(), finer) })
}

impl Screened<'_> {
    /// Log evidence, nats: an outlier may lie anywhere in the values' range, and which one it is must be said; a part is one of
    /// many. Of a capture that is set aside only its shared parts may: within it values scatter as elsewhere.
    fn ln_evidence(&self) -> f64 {
        let layout = self.fitter.experiment.layout();
        let f = &self.selection.fitted;
        let n = layout.values.len() as f64;
        let (low, high) = range(&self.selection.baseline.residual);
        let constant = 0.5 * std::f64::consts::TAU.ln();
        let captures = whole_captures(&self.outliers, layout);
        let shared = (captures.len() * layout.random.iter().map(Vec::len).sum::<usize>()) as f64;
        let within: Vec<usize> = (self.outliers.iter().copied())
            .filter(|i| captures.contains(&layout.groups[*i]))
            .collect();
        let ordinary = (within.len() as f64 - shared).max(0.0);
        let gone = self.outliers.len() as f64 - ordinary;
        let ln_sigma = |i: &usize| f.noise.sigma_mm[layout.classes[*i]].ln();
        let usual = within.iter().map(ln_sigma).sum::<f64>() / within.len().max(1) as f64;
        self.fitter.ln_likelihood(f)
            - constant * (n - gone)
            - ordinary * (usual + 0.5)
            - gone * ((high - low).max(1e-12).ln() + n.ln())
            - 0.5 * f.rank as f64 * n.ln()
            - f.model.active.len() as f64 * self.selection.library_tests.max(1.0).ln()
            - f.model.extras.len() as f64 * self.selection.generic_tests.ln()
            - if self.fitter.space.serial().is_some() { 0.5 * n.ln() } else { 0.0 }
    }

    /// The same, with the coefficients of a free function or surface priced as they were when it was chosen.
    fn fair_ln_evidence(&self) -> f64 {
        let f = &self.selection.fitted;
        let ln_n = (self.fitter.experiment.layout().values.len() as f64).ln();
        let free = f.model.extras.iter().enumerate().filter_map(|(i, e)| match &e.kind {
            Extra::Generic(t) if t.shape.is_free() => Some((Part::Extra(i), e.values.len() as f64)),
            _ => None,
        });
        let fairer = free.map(|(part, rank)| {
            let chi2 = part_chi2(&self.fitter, f, part);
            gain_of_free(chi2, rank, ln_n) - 0.5 * (chi2 - rank * ln_n)
        });
        self.ln_evidence() + fairer.sum::<f64>()
    }
}

/// Selects, sets aside what even the selected model cannot explain, and selects again.
fn settle<'a>(
    experiment: &'a dyn Experiment,
    given_mm: Option<f64>,
    mut outliers: Vec<usize>,
    serial: f64,
) -> Screened<'a> {
    let run = |outliers: &[usize]| {
        let space = space(experiment, outliers, given_mm, serial);
        let fitter = Fitter::new(experiment, space, given_mm);
        let selection = select(&fitter);
        (fitter, selection)
    };
    let layout = experiment.layout();
    let (mut fitter, mut selection) = run(&outliers);
    /// Single values first, captures once those are gone.
    const ROUNDS: usize = 3;
    for _ in 0..ROUNDS {
        let found = far(&fitter, &selection.fitted, layout);
        let all: Vec<usize> = outliers.iter().chain(&found).copied().collect();
        if found.is_empty() || !few_of(&all, layout) {
            break;
        }
        outliers = all;
        (fitter, selection) = run(&outliers);
    }
    outliers.sort_unstable();
    Screened { fitter, selection, outliers }
}

/// The space the noise is described in; with the form of the artefact's rim where that is rough, or this correlation of neighbours.
fn space(
    experiment: &dyn Experiment,
    outliers: &[usize],
    given_mm: Option<f64>,
    serial: f64,
) -> Space {
    let layout = experiment.layout();
    let mut keep = vec![true; layout.values.len()];
    outliers.iter().for_each(|i| keep[*i] = false);
    if serial > 0.0 {
        return Space::with_serial(layout, &keep, serial);
    }
    let space = Space::new(layout, &keep);
    let fitter = Fitter::new(experiment, space, given_mm);
    if is_rough(&fitter) { Space::with_rim(layout, &keep) } else { fitter.space }
}
