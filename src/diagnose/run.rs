//! From an experiment to the answer: selection, lack of fit, naming rules, gap.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::basis::distinct;
use crate::diagnose::by_site;
use crate::diagnose::classes::{PairInstead, by_name, pair_instead, rivals, stand_ins};
use crate::diagnose::doubts;
use crate::diagnose::experiment::{Experiment, Layout};
use crate::diagnose::fit::{Extra, Fitted, Fitter, Model};
use crate::diagnose::holdout::held_out_rms;
use crate::diagnose::next::next_measurement;
use crate::diagnose::noise::Noise;
use crate::diagnose::outliers::whole_captures;
use crate::diagnose::parts::{Part, contribution, without};
use crate::diagnose::repeats::repeats_ln_p;
use crate::diagnose::report::{Gap, NamedEffect, Outlier, Report, Residuals, Verdict, Where};
use crate::diagnose::resolution::rounded_to_mm;
use crate::diagnose::screen::{Screened, screen};
use crate::diagnose::select::Selection;
use crate::diagnose::sizes;
use crate::diagnose::unnamed;
use crate::error::{Error, Result};
use crate::fit::robust::range;
use crate::fit::tails::ln_chi2_tail;

/// How to diagnose.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Standard deviation of an observation, where it is known, mm.
    pub noise_mm: Option<f64>,
}

/// p-value under which a lack of fit is said to exist.
const LACK_OF_FIT_P: f64 = 1e-3;
/// Nothing measures better than this, mm.
const LEAST_NOISE_MM: f64 = 1e-9;
/// Least number of captures or poses worth a diagnosis.
const LEAST_CAPTURES: usize = 8;

impl Options {
    fn check(&self) -> Result<()> {
        match self.noise_mm {
            Some(s) if !(s.is_finite() && s >= LEAST_NOISE_MM) => Err(Error::option(
                "--noise-mm",
                format!("is {s}"),
                format!(
                    "give the standard deviation of one value in mm, at least {LEAST_NOISE_MM}"
                ),
            )),
            _ => Ok(()),
        }
    }
}

/// A diagnosis with everything the report, the model file and the next measurement are made from.
pub struct Diagnosis<'a> {
    /// The answer.
    pub report: Report,
    /// The selection behind it.
    pub selection: Selection,
    /// The fitter behind it.
    pub fitter: Fitter<'a>,
}

/// Diagnoses one experiment.
pub fn diagnose<'a>(experiment: &'a dyn Experiment, options: &Options) -> Result<Diagnosis<'a>> {
    options.check()?;
    let layout = experiment.layout();
    if layout.group_count() < LEAST_CAPTURES {
        return Err(Error::measure(
            experiment.kind().name(),
            format!("{} captures are too few to tell anything from noise", layout.group_count()),
            format!("give at least {LEAST_CAPTURES}; a sound design has 40 or more"),
        ));
    }
    if range(&layout.values) == (0.0, 0.0) {
        let outputs: Vec<&str> =
            layout.directions.iter().filter(|d| !d.is_part).map(|d| &*d.name).collect();
        return Err(Error::measure(
            experiment.kind().name(),
            format!("nothing is measured: {} are missing or all zero", outputs.join(", ")),
            "give the measured columns; for a plan alone use --plan-only",
        ));
    }
    let Screened { fitter, mut selection, outliers } = screen(experiment, options.noise_mm);
    if lack_of_fit(&fitter, &selection.fitted).is_some_and(|p| p < LACK_OF_FIT_P) {
        by_site::take_back(&fitter, &mut selection);
    }
    let pairs: Vec<_> = (0..selection.fitted.model.active.len())
        .map(|i| pair_instead(&fitter, &selection, i))
        .collect();
    let mut report = build(&fitter, &selection, &pairs, outliers);
    report.next_measurement = next_measurement(&fitter, &selection, &pairs);
    Ok(Diagnosis { report, selection, fitter })
}

/// p-value of a remaining lack of fit: against given noise, or against repeats.
fn lack_of_fit(fitter: &Fitter, f: &Fitted) -> Option<f64> {
    let white = fitter.whiten_residual(f, &f.noise);
    let mut ln_p: Option<f64> = None;
    let mut tests = 0.0;
    if quieter(fitter, f).is_some() || rounded_to_mm(fitter, f).is_some() {
        // Repeats may tell what is smaller than the noise given, which the user calls noise; rounded readings repeat themselves.
        return Some(1.0);
    }
    if let Some((chi2, dof)) = against_given(fitter, f, &white) {
        tests += 1.0;
        ln_p = Some(ln_chi2_tail(chi2, dof));
    }
    for (_, p) in repeats_ln_p(fitter, f, &white) {
        tests += 1.0;
        ln_p = Some(ln_p.map_or(p, |q| q.min(p)));
    }
    ln_p.map(|p| (p + f64::ln(f64::max(tests, 1.0))).min(0.0).exp())
}

/// The output whose sites differ most by what its own repeats allow.
fn least_repeated(fitter: &Fitter, f: &Fitted) -> Option<String> {
    let layout = fitter.experiment.layout();
    if !layout.random.is_empty() {
        return None;
    }
    let white = fitter.whiten_residual(f, &f.noise);
    let kinds =
        repeats_ln_p(fitter, f, &white).into_iter().filter_map(|(kind, p)| Some((kind?, p)));
    let (class, _) = kinds.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let first = layout.classes.iter().position(|c| *c == class)?;
    layout.outputs().find(|d| d.factors[first] != 0.0).map(|d| d.name.to_string())
}

/// χ² against the noise that was given, and its degrees of freedom.
fn against_given(fitter: &Fitter, f: &Fitted, white: &DMatrix<f64>) -> Option<(f64, f64)> {
    let top = fitter.space.top();
    let dof = fitter.space.observations() as f64 - top as f64 - f.rank as f64;
    (fitter.given_mm.is_some() && dof >= 1.0)
        .then(|| (white.rows(top, f.residual.len()).norm_squared(), dof))
}

/// Share of the given noise's variance that the values show, where they scatter by less: as rarely by chance as a lack of fit is
/// so large.
fn quieter(fitter: &Fitter, f: &Fitted) -> Option<f64> {
    let (chi2, dof) = against_given(fitter, f, &fitter.whiten_residual(f, &f.noise))?;
    (-ln_chi2_tail(chi2, dof).exp_m1() < LACK_OF_FIT_P).then_some(chi2 / dof)
}

/// Where in the data these observations stand.
fn set_aside(experiment: &dyn Experiment, observations: &[usize]) -> Vec<Outlier> {
    let mut marked = experiment.layout().values.clone();
    observations.iter().for_each(|i| marked[*i] = f64::NAN);
    let columns = experiment.predicted_columns(&marked);
    let mut by_row: BTreeMap<usize, Vec<&'static str>> = BTreeMap::new();
    for (name, values) in &columns {
        for (i, _) in values.iter().enumerate().filter(|(_, v)| v.is_nan()) {
            by_row.entry(i + 1).or_default().push(name);
        }
    }
    // An edge point's two coordinates are one value.
    let one_value = observations.len() < by_row.values().map(Vec::len).sum();
    let of_row = |(row, names): (usize, Vec<&'static str>)| match one_value {
        true => vec![Outlier { row, column: None }],
        false => names.into_iter().map(|name| Outlier { row, column: Some(name) }).collect(),
    };
    by_row.into_iter().flat_map(of_row).collect()
}

/// `pairs` are the two names that could stand for each named effect.
fn build(
    fitter: &Fitter,
    s: &Selection,
    pairs: &[Option<PairInstead>],
    outliers: Vec<usize>,
) -> Report {
    let layout = fitter.experiment.layout();
    let f = &s.fitted;
    let named_model = Model {
        extras: f
            .model
            .extras
            .iter()
            .filter(|e| matches!(e.kind, Extra::Form { .. }))
            .cloned()
            .collect(),
        // Shapes may have moved the set-up far away, where they make up for it.
        nuisances: s.baseline.model.nuisances.clone(),
        ..f.model.clone()
    };
    let generic_count = f.model.extras.len() - named_model.extras.len();
    let named =
        if generic_count == 0 { f.clone() } else { fitter.fit(named_model, Some(&f.noise)) };
    let p = lack_of_fit(fitter, f);
    let lacking = p.is_some_and(|p| p < LACK_OF_FIT_P);
    let remains = generic_count > 0 || lacking;
    let verdict = match (f.model.active.is_empty(), remains) {
        (true, false) => Verdict::Consistent,
        (true, true) => Verdict::Unknown,
        (false, false) => Verdict::Named,
        (false, true) => Verdict::Partly,
    };
    let mut unnamed = unnamed::shapes(fitter, s);
    if lacking && generic_count == 0 {
        let places = places(fitter, f, &f.noise);
        let worst = least_repeated(fitter, f)
            .and_then(|output| places.iter().find(|w| w.output == output))
            .or(places.first());
        unnamed.push(unnamed::unstructured(worst.cloned()));
    }
    let rms = |r: &[f64]| {
        let kept: Vec<f64> =
            (0..r.len()).filter(|i| fitter.space.kept(*i)).map(|i| r[i] * r[i]).collect();
        (kept.iter().sum::<f64>() / kept.len().max(1) as f64).sqrt()
    };
    let share = quieter(fitter, f).unwrap_or(1.0);
    let gap = Gap {
        before_rms_mm: rms(&s.baseline.residual),
        after_rms_mm: rms(&named.residual),
        heldout_before_rms_mm: held_out_rms(fitter, &s.baseline, share),
        heldout_after_rms_mm: held_out_rms(fitter, &named, share),
        noise_rms_mm: fitter.space.noise_rms_mm(&f.noise),
        with_unnamed_rms_mm: (generic_count > 0).then(|| rms(&f.residual)),
    };
    let two = |pair: &Option<PairInstead>| pair.as_ref().map(|p| p.effects);
    let pairs: Vec<_> = pairs.iter().map(two).collect();
    let untested = fitter
        .experiment
        .effects()
        .iter()
        .filter_map(|e| e.untestable.as_ref().map(|u| (e.name.to_string(), u.why.clone())))
        .collect();
    let slips = doubts::slipped_captures(&whole_captures(&outliers, layout), layout);
    let effects = named_effects(fitter, s, &pairs);
    let doubts = doubts::of_answer(fitter, s, &pairs).into_iter().chain(slips);
    let doubts = doubts.chain(effects.iter().filter_map(|e| doubts::untold(fitter, s, e)));
    let doubts = doubts.collect();
    Report {
        kind: fitter.experiment.kind().name().into(),
        verdict,
        noise_mm: f.noise.sigma_mm.iter().sum::<f64>() / f.noise.sigma_mm.len() as f64,
        noise_source: noise_source(fitter, layout, f),
        captures: layout.group_count(),
        observations: layout.values.len(),
        effects,
        in_the_control: Vec::new(),
        unnamed,
        gap,
        places: places(fitter, &s.baseline, &f.noise),
        next_measurement: None,
        outliers: set_aside(fitter.experiment, &outliers),
        untested,
        lack_of_fit_p: p,
        doubts,
        residuals: Residuals {
            before_mm: s.baseline.residual.clone(),
            after_mm: named.residual.clone(),
        },
    }
}

fn noise_source(fitter: &Fitter, layout: &Layout, f: &Fitted) -> String {
    let mut seen = vec![0usize; layout.sites.iter().max().map_or(0, |m| m + 1)];
    layout.sites.iter().for_each(|s| seen[*s] += 1);
    let repeats: usize = seen.iter().map(|c| c.saturating_sub(1)).sum();
    let source = match (fitter.given_mm, repeats) {
        (Some(given_mm), _) => match quieter(fitter, f) {
            Some(share) => format!(
                "given, but the values scatter by {:.2} µm only: what is smaller than the noise given is not told",
                1e3 * given_mm * share.sqrt()
            ),
            None => "given".into(),
        },
        (None, 0) => "what the model leaves; no repeats to check it against".into(),
        (None, r) => format!("what the model leaves, checked against {r} repeated captures"),
    };
    let shared = match (fitter.space.rim_rms_mm(&f.noise), fitter.space.serial()) {
        (Some(rms), _) => format!("the rim's own form, {:.2} µm rms, counts", 1e3 * rms),
        (_, Some(c)) => format!("that errors follow one another (correlation {c:.2}) counts"),
        _ => return source,
    };
    format!("{source}; {shared} as noise")
}

/// The named effects; `pairs` are the two names that could stand for each.
fn named_effects(fitter: &Fitter, s: &Selection, pairs: &[Option<[usize; 2]>]) -> Vec<NamedEffect> {
    let f = &s.fitted;
    let layout = fitter.experiment.layout();
    let stand_ins = stand_ins(fitter, s);
    let sizes_u95 = sizes::u95(fitter, s, &stand_ins);
    let classes = rivals(s, stand_ins);
    // What the baseline takes up of an effect is no part of the gap.
    let basis = orthonormal(&s.baseline.tangent, 1e-9);
    let beside = |values: &[f64]| {
        let column = DMatrix::from_column_slice(values.len(), 1, values);
        &column - &basis * basis.tr_mul(&column)
    };
    let gap = beside(&s.baseline.residual);
    let gap2 = gap.norm_squared().max(1e-300);
    let effects = fitter.experiment.effects();
    let in_two =
        |i: usize| pairs[i].into_iter().flatten().filter(move |e| *e != f.model.active[i].effect);
    let mut named: Vec<NamedEffect> = f
        .model
        .active
        .iter()
        .enumerate()
        .map(|(i, a)| {
            let info = &effects[a.effect];
            let form = &info.forms[a.form];
            let values = form.iter().zip(&a.values);
            let parameters = values.map(|(p, v)| (p.name.to_string(), *v)).collect();
            let of_form = form.iter().filter(|p| !p.grid.is_empty());
            let along = beside(&contribution(fitter, &f.model, Part::Effect(i))).dot(&gap);
            let ln_p = without(fitter, f, &[Part::Effect(i)]).1.map_or(0.0, |s| s.ln_p);
            let odds = || by_name(&classes[i]).map(|r| (r.effect, (-r.deficit).exp()));
            let total: f64 = 1.0 + odds().map(|(_, odds)| odds).sum::<f64>();
            let name = |effect: usize| effects[effect].name.to_string();
            let form_corrected_over = f
                .model
                .extras
                .iter()
                .filter_map(|e| match e.kind {
                    Extra::Form { effect, variable } if effect == a.effect => {
                        Some(layout.variables[variable].name.to_owned())
                    }
                    _ => None,
                })
                .collect();
            NamedEffect {
                name: info.name.to_string(),
                meaning: info.meaning.to_string(),
                confusable_with: by_name(&classes[i])
                    .map(|r| r.effect)
                    .chain(in_two(i).filter(|e| by_name(&classes[i]).all(|r| r.effect != *e)))
                    .map(name)
                    .collect(),
                parameters,
                parameters_u95: sizes_u95[i].clone(),
                form_parameters: of_form.map(|p| p.name.to_string()).collect(),
                share_percent: (100.0 * along / gap2).clamp(0.0, 100.0),
                p_value: (ln_p + s.library_tests.ln()).min(0.0).exp(),
                weight: 1.0 / total,
                confusable_weights: odds().map(|(e, odds)| (name(e), odds / total)).collect(),
                form_corrected_over,
            }
        })
        .collect();
    named.sort_by(|a, b| b.share_percent.total_cmp(&a.share_percent));
    named
}

/// The ranges in which a model's residuals exceed the noise most: eight bins of each variable, each output. The noise is that of the
/// whole answer: what is missing from a model counts as noise to it.
fn places(fitter: &Fitter, f: &Fitted, noise: &Noise) -> Vec<Where> {
    const BINS: usize = 8;
    let layout = fitter.experiment.layout();
    let mut found: Vec<(f64, Where)> = Vec::new();
    for d in layout.outputs() {
        for v in &layout.variables {
            let (low, high) = range(&v.values);
            if high <= low {
                continue;
            }
            // Few values are their own ranges: a direction is 1 or -1, and nothing between.
            let few = distinct(&v.values);
            let width = (high - low) / BINS as f64;
            let count = if few.len() <= BINS { few.len() } else { BINS };
            for b in 0..count {
                let (from, to) = match few.len() <= BINS {
                    true => (few[b], few[b]),
                    false => (low + width * b as f64, low + width * (b + 1) as f64),
                };
                let inside = |x: f64| match from == to {
                    true => (x - from).abs() <= 1e-6 * (high - low),
                    false => x >= from && (x < to || b + 1 == BINS && x == high),
                };
                let (mut sum, mut in_noise, mut weight) = (0.0, 0.0, 0.0);
                for i in 0..f.residual.len() {
                    if fitter.space.kept(i) && inside(v.values[i]) {
                        let share = d.factors[i] * d.factors[i];
                        let noise = noise.sigma_mm[layout.classes[i]].max(1e-12);
                        sum += share * f.residual[i].powi(2);
                        in_noise += share * (f.residual[i] / noise).powi(2);
                        weight += share;
                    }
                }
                if weight < 2.0 {
                    continue;
                }
                let rms_mm = (sum / weight).sqrt();
                let excess = (in_noise / weight).sqrt();
                found.push((
                    excess * weight.sqrt().min(5.0),
                    Where { output: d.name.to_string(), versus: v.name.into(), from, to, rms_mm },
                ));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut seen = std::collections::HashSet::new();
    found
        .into_iter()
        .map(|(_, w)| w)
        .filter(|w| seen.insert((w.output.clone(), w.versus.clone())))
        .take(6)
        .collect()
}
