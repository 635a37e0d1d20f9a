//! Bumps over two variables together: what happens near one pose alone, found from a shape in one of the variables or over both.

use crate::diagnose::basis::distinct;
use crate::diagnose::experiment::{Layout, Variable};
use crate::diagnose::generic::{Term, is_slow};
use crate::diagnose::shape::Shape;
use crate::fit::robust::range;

/// Places tried over the range of a variable.
const PLACES: usize = 8;
/// Widths tried, in parts of the range.
const WIDTHS: [f64; 2] = [0.1, 0.2];
/// Fewer distinct values of a variable do not tell where it stands.
const FEWEST_VALUES: usize = 5;
/// Widths about one that has been found, in parts of it.
const FINER_WIDTHS: [f64; 3] = [0.75, 1.0, 1.35];

impl Term {
    /// Bumps over two variables that may be all there is to this term: a bump that stands in one place of another variable too, or what a
    /// surface or product over two stands for.
    pub fn hills(&self, layout: &Layout) -> Vec<Self> {
        let d = &layout.directions[self.direction];
        let v = &layout.variables[self.variable];
        if d.is_part || v.within {
            return Vec::new();
        }
        let here = match self.shape {
            Shape::Bump(at, width) => vec![(at, width)],
            _ => bumps(v),
        };
        let beside = |(i, w): &(usize, &Variable)| match self.shape {
            Shape::Surface(other) | Shape::Product(other, ..) => *i == other,
            Shape::Bump(..) | Shape::Wave(_) | Shape::Power(_) => {
                *i != self.variable && !w.within && !(is_slow(v) && is_slow(w))
            }
            _ => false,
        };
        let others = layout.variables.iter().enumerate().filter(beside);
        others.flat_map(|(other, w)| self.over_both(&here, other, &bumps(w))).collect()
    }

    /// The same bump at places and widths about its own: `step` of its widths apart, and as many powers of the finer widths.
    pub(super) fn hills_around(&self, layout: &Layout, step: f64) -> Vec<Self> {
        let Shape::Hill(other, at, width) = self.shape else { return Vec::new() };
        let about = |variable: usize, at: f64, width: f64| -> Vec<(f64, f64)> {
            let (low, high) = range(&layout.variables[variable].values);
            let places = [-1.0, 0.0, 1.0].map(|k| at + k * step * width);
            let seen = places.into_iter().filter(|at| (low..=high).contains(at));
            seen.flat_map(|at| FINER_WIDTHS.map(|f| (at, width * f.powf(step)))).collect()
        };
        let here = about(self.variable, at[0], width[0]);
        self.over_both(&here, other, &about(other, at[1], width[1]))
    }

    /// Bumps of every place and width here with every one `there`, in the `other` variable.
    fn over_both(&self, here: &[(f64, f64)], other: usize, there: &[(f64, f64)]) -> Vec<Self> {
        let both = here.iter().flat_map(|a| there.iter().map(move |b| (a, b)));
        both.map(|(a, b)| Shape::Hill(other, [a.0, b.0], [a.1, b.1]))
            .map(|shape| Self { shape, ..*self })
            .collect()
    }
}

/// Places and widths of a bump in a variable.
fn bumps(v: &Variable) -> Vec<(f64, f64)> {
    let values = distinct(&v.values);
    if values.len() < FEWEST_VALUES {
        return Vec::new();
    }
    let (low, high) = (values[0], values[values.len() - 1]);
    let places = (0..PLACES).map(|k| low + (k as f64 + 0.5) / PLACES as f64 * (high - low));
    places.flat_map(|at| WIDTHS.map(|w| (at, w * (high - low)))).collect()
}
