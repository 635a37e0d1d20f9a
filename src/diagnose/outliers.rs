//! Observations that are set aside: a slipped reading is no effect, and no shape should be bent to follow it.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::Layout;
use crate::diagnose::fit::{Extra, Fitted, Fitter};
use crate::diagnose::parts::{Part, beside_the_rest};
use crate::fit::robust::scatter;
use crate::fit::tails::f_quantile;

/// Largest part of the observations that may be set aside.
const MOST: f64 = 0.05;

/// Captures of which nothing is left.
pub(super) fn whole_captures(outliers: &[usize], layout: &Layout) -> Vec<usize> {
    if layout.random.is_empty() {
        return Vec::new();
    }
    let mut left = vec![0usize; layout.group_count()];
    layout.groups.iter().for_each(|g| left[*g] += 1);
    outliers.iter().for_each(|i| left[layout.groups[*i]] -= 1);
    (0..left.len()).filter(|g| left[*g] == 0).collect()
}

/// Whether these observations may be set aside: few of all, and few captures as a whole.
pub(super) fn few_of(outliers: &[usize], layout: &Layout) -> bool {
    let captures = whole_captures(outliers, layout);
    let single = outliers.iter().filter(|i| !captures.contains(&layout.groups[**i])).count();
    few(single, layout.values.len()) && few(captures.len(), layout.group_count())
}

/// Whether so many of all observations may be set aside.
pub(super) fn few(count: usize, all: usize) -> bool {
    count as f64 <= MOST * all as f64 + 1.0
}

/// Which of the values left by a fit lie far from the rest, beyond a 0.1 % chance in the whole set. The scale is robust: outliers must
/// not hide in the noise they made.
pub(super) fn slipped(left: &DVector<f64>) -> Vec<bool> {
    let mut sizes: Vec<f64> = left.iter().map(|v| v.abs()).collect();
    if sizes.is_empty() {
        return Vec::new();
    }
    let limit = limit(left.len()) * scatter(&mut sizes);
    left.iter().map(|v| v.abs() > limit && limit > 0.0).collect()
}

/// Standard deviations beyond which one of so many values is far.
fn limit(values: usize) -> f64 {
    1.1 * f_quantile((1e-3 / values as f64).ln(), 1.0, f64::INFINITY).sqrt()
}

/// Least share of a reading's own error that is taken to be left by the fit: where the model follows a reading more closely, nothing
/// else says what it should have been.
const LEAST_LEFT: f64 = 0.3;

/// A rounded reading that is off by no more than so many steps may be so by chance.
const ROUNDED_OFF: f64 = 1.5;

/// Observations that a fit leaves far away: beyond a 0.1 % chance in the whole set. What is left of each is counted in units of what
/// the fit leaves of noise there: a shape of many coefficients follows a slipped reading part of the way. Of a capture whose shared parts
/// are far, all of them.
pub(super) fn far(fitter: &Fitter, f: &Fitted, layout: &Layout) -> Vec<usize> {
    let n = layout.values.len();
    let white = fitter.whiten_residual(f, &f.noise);
    let top = fitter.space.top();
    let basis = orthonormal(&fitter.whiten(&f.tangent, &f.noise), 1e-7);
    let left = |row: usize| (1.0 - basis.row(row).norm_squared()).max(LEAST_LEFT);
    let own = |row: usize| white[(row, 0)] / left(row).sqrt();
    let rest: Vec<f64> = (0..n).map(|i| own(top + i)).collect();
    let is_far = beyond(&rest, |i| fitter.space.kept(i), &layout.classes);
    // What is rounded may be a step off.
    let is_off = |i: usize| f.residual[i].abs() > ROUNDED_OFF * fitter.steps_mm[layout.classes[i]];
    let alone: Vec<usize> =
        (0..n).filter(|&i| fitter.space.kept(i) && is_far[i] && is_off(i)).collect();
    if layout.random.is_empty() {
        return alone;
    }
    // Values that lie far within a capture draw its shared parts along, and with them the others: without them it may be where it belongs.
    let with_far: BTreeSet<usize> = alone.into_iter().map(|i| layout.groups[i]).collect();
    let members = |group: usize| -> Vec<usize> {
        (0..n).filter(|&i| layout.groups[i] == group && fitter.space.kept(i)).collect()
    };
    let slipped = slipped_captures(fitter, layout, own);
    let whole =
        (0..slipped.len()).filter(|g| slipped[*g] && !with_far.contains(g)).flat_map(members);
    // The noise may hold what slipped; how the values scatter does not.
    let scales = scales(&rest, |i| fitter.space.kept(i), &layout.classes);
    let far_mm: Vec<f64> =
        scales.iter().zip(&f.noise.sigma_mm).map(|(s, sigma)| limit(n) * s * sigma).collect();
    let parts = with_far.iter().flat_map(|&g| {
        let part = peeled(f, layout, members(g), &far_mm);
        // Its values agree among themselves: then all of it is where it does not belong.
        if part.is_empty() && slipped[g] { members(g) } else { part }
    });
    let mut found: Vec<usize> = whole.chain(parts).collect();
    found.sort_unstable();
    found
}

/// The values of a capture without which its others agree on its shared parts; all of them where that takes more than a few. `far_mm` is, for
/// each class of values, what is far.
fn peeled(f: &Fitted, layout: &Layout, members: Vec<usize>, far_mm: &[f64]) -> Vec<usize> {
    /// Part of a capture's values that dirt on the artefact may reach.
    const MOST_DIRTY: f64 = 0.25;
    let shared: Vec<&Vec<f64>> = layout.random.iter().flatten().collect();
    let far = |i: usize| far_mm[layout.classes[i]].max(f64::MIN_POSITIVE);
    let (mut rest, mut gone) = (members.clone(), Vec::new());
    while rest.len() > shared.len() + 1 {
        let columns =
            DMatrix::from_fn(rest.len(), shared.len(), |r, c| shared[c][rest[r]] / far(rest[r]));
        let left = DMatrix::from_fn(rest.len(), 1, |r, _| f.residual[rest[r]] / far(rest[r]));
        let basis = orthonormal(&columns, 1e-7);
        let mut own = &left - &basis * basis.tr_mul(&left);
        for r in 0..rest.len() {
            own[(r, 0)] /= (1.0 - basis.row(r).norm_squared()).max(LEAST_LEFT).sqrt();
        }
        let worst = own.column(0).iamax();
        if own[(worst, 0)].abs() <= 1.0 {
            return gone;
        }
        gone.push(rest.remove(worst));
        if gone.len() as f64 > MOST_DIRTY * members.len() as f64 {
            break;
        }
    }
    members
}

/// Captures that lie apart as a whole from where a fit has them; `own` gives what a row of the whitened residual leaves.
fn slipped_captures(fitter: &Fitter, layout: &Layout, own: impl Fn(usize) -> f64) -> Vec<bool> {
    let mut slipped = vec![false; layout.group_count()];
    if layout.random.is_empty() {
        return slipped;
    }
    let (parts, places): (Vec<f64>, Vec<(usize, usize)>) = fitter
        .space
        .capture_rows_used()
        .map(|(row, group, part)| (own(row), (group, part)))
        .unzip();
    let kinds: Vec<usize> = places.iter().map(|(_, part)| *part).collect();
    let is_far = beyond(&parts, |_| true, &kinds);
    for ((group, _), far) in places.into_iter().zip(is_far) {
        slipped[group] |= far;
    }
    slipped
}

/// Which of the values lie far from those of their class, where they count.
fn beyond(values: &[f64], kept: impl Fn(usize) -> bool, classes: &[usize]) -> Vec<bool> {
    let limit = limit(values.len());
    let scales = scales(values, kept, classes);
    values.iter().zip(classes).map(|(v, class)| v.abs() > limit * scales[*class]).collect()
}

/// How much each output's values scatter, robustly: outliers must not hide in the noise they made, nor make another output's values look
/// far. What an output has too few values to tell, all tell together.
fn scales(rest: &[f64], kept: impl Fn(usize) -> bool, classes: &[usize]) -> Vec<f64> {
    /// Values that tell an output's own scatter.
    const TELL: usize = 10;
    let of = |class: Option<usize>| -> Vec<f64> {
        let counts = |i: &usize| kept(*i) && class.is_none_or(|c| classes[*i] == c);
        (0..rest.len()).filter(counts).map(|i| rest[i].abs()).collect()
    };
    let scale = |mut sizes: Vec<f64>| match sizes.is_empty() {
        true => 1.0,
        false => scatter(&mut sizes).clamp(1e-9, 1.0),
    };
    let together = scale(of(None));
    let count = classes.iter().max().map_or(0, |c| c + 1);
    let own = (0..count).map(|c| of(Some(c)));
    own.map(|sizes| if sizes.len() < TELL { together } else { scale(sizes) }).collect()
}

/// Values that a shape stands on alone: most of what it adds to the rest of the model is at one capture. A slipped reading looks like that,
/// and a shape of which no second capture tells is none.
pub(super) fn alone_under_a_shape(fitter: &Fitter, f: &Fitted) -> Vec<usize> {
    /// Least part of the shape's square that is there, and of a value that it stands on.
    const MOST_OF_IT: f64 = 0.8;
    const NOTABLE: f64 = 0.1;
    let layout = fitter.experiment.layout();
    let top = fitter.space.top();
    let mut alone = Vec::new();
    for (k, extra) in f.model.extras.iter().enumerate() {
        if !matches!(extra.kind, Extra::Generic(_)) {
            continue;
        }
        let shape = beside_the_rest(fitter, f, Part::Extra(k));
        let all = shape.norm_squared();
        let mut by_capture = vec![0.0; layout.group_count()];
        for (i, group) in layout.groups.iter().enumerate() {
            by_capture[*group] += shape[top + i].powi(2);
        }
        if let Some(one) = by_capture.iter().position(|s| *s > MOST_OF_IT * all) {
            let stands_on = |i: &usize| {
                layout.groups[*i] == one
                    && fitter.space.kept(*i)
                    && shape[top + i].powi(2) > NOTABLE * all
            };
            alone.extend((0..layout.values.len()).filter(stands_on));
        }
    }
    // Two shapes may stand on one capture.
    alone.sort_unstable();
    alone.dedup();
    alone
}
