//! The generic dictionary's shapes: which ones the values of a variable can carry, and what each of them is made of.

use crate::diagnose::basis::{Basis, distinct, goes_round, of_order, smooth};
use crate::diagnose::experiment::Variable;

/// A shape in one variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// `order` cycles a turn (cosine and sine).
    Harmonic(u32),
    /// Legendre polynomial of this degree over the variable's range.
    Power(u32),
    /// A jump at this value.
    Step(f64),
    /// Any function: a level of its own for each of this many ranges of the variable.
    Levels(usize),
    /// A Gaussian bump at a value, with a standard deviation.
    Bump(f64, f64),
    /// So many cycles over the variable's range (cosine and sine).
    Wave(f64),
    /// A function of one order of the variable times one of another variable: that variable, both orders.
    Product(usize, u32, u32),
    /// Any smooth function of the variable and this other one together: products of low orders in each.
    Surface(usize),
    /// A Gaussian bump over the variable and this other one: where it stands in both, with a standard deviation in each.
    Hill(usize, [f64; 2], [f64; 2]),
}

/// Highest harmonic tried in an angle.
const HARMONICS: u32 = 8;
/// Distinct values from which on a step is another shape than a line.
const LEAST_OF_A_STEP: usize = 3;
/// The same of a bump at one of them.
const LEAST_OF_A_BUMP: usize = 4;
/// Places of a step that are tried over the range of a variable.
pub(super) const PLACES: usize = 12;
/// Products of two orders that add up to no more than one above the highest.
const PRODUCTS: f64 = 6.0;
/// Highest polynomial degree tried.
pub(super) const DEGREES: u32 = 4;
/// Levels of a free function: fewer find smooth functions with less noise, more follow fast ones.
const LEVELS: [usize; 2] = [24, 48];
/// A function of fewer has another shape.
const FEWEST_LEVELS: usize = 8;
/// Least distinct values to a level of the finer functions.
const VALUES_TO_A_LEVEL: usize = 3;

impl Shape {
    /// Whether it is a function of no set form.
    pub fn is_free(self) -> bool {
        matches!(self, Self::Levels(_) | Self::Surface(_))
    }

    /// Whether it stands at a place, or has a number of cycles, that is searched for.
    pub fn is_placed(self) -> bool {
        matches!(self, Self::Step(_) | Self::Bump(..) | Self::Wave(_) | Self::Hill(..))
    }

    /// Whether it is all that there is to see by itself: what has one harmonic of a turn need not have another, a cubic is a straight line and more.
    pub fn is_whole(self) -> bool {
        self.is_placed() || matches!(self, Self::Harmonic(_))
    }

    /// The functions of one variable and of another whose products make a shape over both.
    pub(super) fn factors(self, v: &Variable, w: &Variable) -> (Vec<Basis>, Vec<Basis>) {
        match self {
            Self::Product(_, p, q) => (of_order(v, p), of_order(w, q)),
            _ => (smooth(v), smooth(w)),
        }
    }

    /// Whether a constant goes with it: what comes as one whole of cycles, or changes sign with another variable, needs none.
    pub fn has_constant(self) -> bool {
        !matches!(self, Self::Harmonic(_) | Self::Product(..))
    }

    /// How many of its kind the variables offer: one each, or for every pair of them, and a product of any orders.
    pub(super) fn among(self, variables: usize) -> f64 {
        let one = variables as f64;
        let pairs = 0.5 * one * (one - 1.0);
        match self {
            Self::Surface(_) | Self::Hill(..) => pairs,
            Self::Product(..) => pairs * PRODUCTS,
            _ => one,
        }
    }

    /// Numbers chosen from a grid besides the coefficients.
    pub fn places(self) -> usize {
        match self {
            Self::Harmonic(_) | Self::Power(_) | Self::Levels(_) => 0,
            Self::Surface(_) | Self::Product(..) => 0,
            Self::Step(_) | Self::Wave(_) => 1,
            Self::Bump(..) => 2,
            Self::Hill(..) => 4,
        }
    }
}

/// Shapes that the distinct values of a variable can carry, free functions of `most_levels` at most.
pub fn shapes(values: &[f64], angle: bool, most_levels: usize) -> Vec<Shape> {
    let distinct = distinct(values);
    let (low, high) = (distinct[0], distinct[distinct.len() - 1]);
    let count = distinct.len();
    let mut shapes = Vec::new();
    if count < 2 {
        return shapes;
    }
    if angle {
        let most = HARMONICS.min((count as u32).saturating_sub(1) / 2 + 1);
        shapes.extend((1..=most).map(Shape::Harmonic));
    }
    if !goes_round(angle, values) {
        shapes.extend((1..=DEGREES.min(count as u32 - 1)).map(Shape::Power));
    }
    if count >= LEAST_OF_A_STEP {
        let spots = PLACES.min(count - 1);
        for s in 0..spots {
            let i = ((s as f64 + 0.5) / spots as f64 * (count - 1) as f64) as usize;
            let i = i.min(count - 2);
            shapes.push(Shape::Step(0.5 * (distinct[i] + distinct[i + 1])));
        }
    }
    if count >= FEWEST_LEVELS && values.len() >= 60 {
        let most = count.min(LEVELS[0]).min(most_levels);
        if most >= FEWEST_LEVELS {
            shapes.push(Shape::Levels(most));
        }
        if count >= VALUES_TO_A_LEVEL * LEVELS[1] && LEVELS[1] <= most_levels {
            shapes.push(Shape::Levels(LEVELS[1]));
        }
    }
    if (LEAST_OF_A_BUMP..8).contains(&count) {
        // One value alone, which is no end: those are steps.
        let gap = distinct.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        shapes.extend(distinct[1..count - 1].iter().map(|at| Shape::Bump(*at, gap / 4.0)));
    }
    if count >= 8 {
        let spots = 16.min(count);
        for width in [(high - low) / 20.0, (high - low) / 8.0] {
            for s in 0..spots {
                let i = (s as f64 / (spots - 1) as f64 * (count - 1) as f64).round() as usize;
                shapes.push(Shape::Bump(distinct[i], width));
            }
        }
    }
    shapes
}
