//! How uncertain the sizes of named effects are: by noise, and because a confusable name may be another's.
//!
//! Where two effects are named and one of them could as well be a third, the other's size depends on which it is. The stated half
//! width holds 95 % of all answers' normal distributions together, each with its odds, about the likeliest answer's value.

use std::collections::BTreeMap;

use crate::diagnose::classes::Rival;
use crate::diagnose::experiment::{Active, Parameter};
use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::parts::{Part, add, remove};
use crate::diagnose::resolution::widening;
use crate::diagnose::select::Selection;
use crate::uncertainty::{K95, k95};

/// One answer's distribution of a size: its odds against the likeliest answer's, value and standard deviation.
struct Case {
    odds: f64,
    value: f64,
    sd: f64,
}

/// An interval this many times as wide as what machines show is none: the data do not tell that size.
const UNTOLD: f64 = 1e3;

/// 95 % half widths of the parameters of each named effect, without those that the data do not tell; `stand_ins` are what could be in their places.
pub fn u95(
    fitter: &Fitter,
    selection: &Selection,
    stand_ins: &[Vec<Rival>],
) -> Vec<BTreeMap<String, f64>> {
    let f = &selection.fitted;
    let others =
        if f.model.active.len() > 1 { others(fitter, selection, stand_ins) } else { vec![] };
    (0..f.model.active.len())
        .map(|i| {
            let own = &f.model.active[i];
            let as_here = others.iter().filter(|(_, at, _)| *at != i).filter_map(|(odds, _, g)| {
                let same = |a: &Active| (own.effect, own.form) == (a.effect, a.form);
                Some((*odds, sizes(fitter, g, g.model.active.iter().position(same)?)))
            });
            let as_here: Vec<_> = as_here.collect();
            let of = |(p, (name, value, sd)): (usize, (String, f64, f64))| {
                let mut cases = vec![Case { odds: 1.0, value, sd }];
                cases.extend(as_here.iter().map(|(odds, sizes)| {
                    let (_, value, sd) = sizes[p];
                    Case { odds: *odds, value, sd }
                }));
                (name, half_width(&cases, k95(f.noise.dof)))
            };
            let form = fitter.experiment.effects()[own.effect].forms[own.form].iter();
            let form = form.filter(|p| !p.is_switch()).zip(sizes(fitter, f, i));
            let told = |p: &Parameter, value: f64, u95: f64| {
                !p.is_at_limit(value) && u95 < UNTOLD * p.typical.abs().max(value.abs())
            };
            form.enumerate()
                .filter_map(|(k, (p, size))| {
                    let value = size.1;
                    let (name, u95) = of((k, size));
                    told(p, value, u95).then_some((name, u95))
                })
                .collect()
        })
        .collect()
}

/// The answers with one name in another's place: their odds, that place, and their fit.
fn others(
    fitter: &Fitter,
    selection: &Selection,
    stand_ins: &[Vec<Rival>],
) -> Vec<(f64, usize, Fitted)> {
    let f = &selection.fitted;
    let places =
        stand_ins.iter().enumerate().flat_map(|(i, list)| list.iter().map(move |r| (i, r)));
    places
        .map(|(i, rival)| {
            let rest = remove(&f.model, Part::Effect(i));
            let who = &selection.library.candidates[rival.candidate].who;
            let fitted = fitter.fit(add(fitter, &rest, who), Some(&f.noise));
            ((-rival.deficit).exp(), i, fitted)
        })
        .collect()
}

/// Least part of a coefficient's own direction that the data have to show.
const LEAST_SHOWN: f64 = 1.0 - 1e-6;

/// Name, value and standard deviation of the sizes of the effect at place `i`; infinite where the data do not show a coefficient by itself, as
/// a wave that is zero at every angle.
fn sizes(fitter: &Fitter, f: &Fitted, i: usize) -> Vec<(String, f64, f64)> {
    let own = &f.model.active[i];
    let at = fitter.offsets(&f.model)[i];
    // The pseudo-inverse times what it is of projects onto what is shown.
    let shown = (f.rank < f.covariance.nrows()).then(|| {
        let white = fitter.whiten(&f.tangent, &f.noise);
        (&f.covariance * white.tr_mul(&white)).diagonal()
    });
    let wider = widening(fitter, f);
    let sd = |k: usize| match &shown {
        Some(part) if part[k] < LEAST_SHOWN => f64::INFINITY,
        _ => wider * f.covariance[(k, k)].max(0.0).sqrt(),
    };
    fitter.experiment.effects()[own.effect].forms[own.form]
        .iter()
        .zip(&own.values)
        .filter(|(p, _)| !p.is_switch())
        .enumerate()
        .map(|(j, (p, value))| (p.name.to_string(), *value, sd(at + j)))
        .collect()
}

/// Half width about the first case's value that holds 95 % of all cases; `k` is the coverage factor of one alone.
fn half_width(cases: &[Case], k: f64) -> f64 {
    let middle = cases[0].value;
    let total: f64 = cases.iter().map(|c| c.odds).sum();
    let outside = |h: f64| {
        let tail = |c: &Case| {
            let scale = (c.sd * k / K95).max(f64::MIN_POSITIVE) * std::f64::consts::SQRT_2;
            let [above, below] =
                [1.0, -1.0].map(|s| libm::erfc((h + s * (middle - c.value)) / scale));
            c.odds * 0.5 * (above + below)
        };
        cases.iter().map(tail).sum::<f64>() / total
    };
    if cases.iter().any(|c| !c.sd.is_finite()) {
        return f64::INFINITY;
    }
    let (mut least, mut most) = (0.0, 0.0f64);
    cases.iter().for_each(|c| most = most.max((c.value - middle).abs() + 3.0 * k * c.sd));
    for _ in 0..60 {
        let h = 0.5 * (least + most);
        if outside(h) > 0.05 { least = h } else { most = h }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_answer_has_its_own_interval_and_several_have_one_that_holds_them() {
        let sure = Case { odds: 1.0, value: 3.0, sd: 0.1 };
        assert!((half_width(&[sure], K95) - K95 * 0.1).abs() < 1e-9);
        let two = |odds: f64| {
            let cases =
                [Case { odds: 1.0, value: 3.0, sd: 0.1 }, Case { odds, value: 5.0, sd: 0.1 }];
            half_width(&cases, K95)
        };
        // One in a hundred widens it a little, one in five has to be inside with all but a quarter of its distribution.
        assert!((0.196..0.25).contains(&two(0.01)));
        assert!((2.0..2.1).contains(&two(0.25)));
    }
}
