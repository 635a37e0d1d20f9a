//! The generic dictionary: shapes in each variable that compete with the library, so that an effect outside it is
//! called unknown and described instead of being given the nearest name.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use crate::diagnose::basis::{
    Basis, distinct, goes_round, legendre, level_edges, middle, orders, smooth,
};
use crate::diagnose::experiment::{Direction, Layout, Variable};
use crate::diagnose::shape::{PLACES, Shape, shapes};
use crate::fit::robust::range;

/// A shape in one variable, seen along one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// Index into the layout's directions.
    pub direction: usize,
    /// Index into the layout's variables.
    pub variable: usize,
    /// The shape.
    pub shape: Shape,
}

/// Values on either side of a step, where there are many.
const STEP_BESIDE: usize = 3;
/// Cycles of a wave over the range of a variable, in halves: slower ones are polynomials.
const WAVES: std::ops::RangeInclusive<u32> = 2..=12;
/// The same over time: what goes on and off by itself does so all day.
const WAVES_IN_TIME: std::ops::RangeInclusive<u32> = 2..=24;
/// Least distinct values to a cycle of a wave.
const VALUES_TO_A_CYCLE: f64 = 4.0;
/// Highest order in either variable of a product.
const PRODUCT_ORDER: u32 = 3;
/// Places of a step tried between two of the dictionary's, at most.
const MOST_PLACES: usize = 64;

/// Least sites to a level or an order of a surface, where the variable is set for a whole capture.
const SITES_TO_A_LEVEL: usize = 2;

impl Term {
    /// The columns, one per coefficient, for a unit of one millimetre.
    pub fn columns(&self, layout: &Layout) -> DMatrix<f64> {
        let along = &layout.directions[self.direction].factors;
        let all: Vec<usize> = (0..along.len()).collect();
        let mut columns = self.values_at(layout, &all);
        for mut column in columns.column_iter_mut() {
            let moved = column.iter_mut().zip(along);
            moved.for_each(|(v, a)| *v = if *a == 0.0 { 0.0 } else { a * *v });
        }
        columns
    }

    /// Whether one value stands for all observations of a capture.
    pub fn is_by_capture(&self, layout: &Layout) -> bool {
        let within = |v: usize| layout.variables[v].within;
        !within(self.variable)
            && !matches!(self.shape, Shape::Surface(v) | Shape::Product(v, ..) | Shape::Hill(v, ..) if within(v))
    }

    /// What the columns are at some observations, along a direction of factor 1: all of them, or one of every capture.
    pub fn values_at(&self, layout: &Layout, observations: &[usize]) -> DMatrix<f64> {
        let at = |v: usize| -> Vec<f64> {
            let values = &layout.variables[v].values;
            observations.iter().map(|i| values[*i]).collect()
        };
        let (x, seen) = (at(self.variable), self.seen(layout));
        let column = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { x.iter().map(|x| f(*x)).collect() };
        let mut columns = match self.shape {
            Shape::Harmonic(k) => {
                let k = f64::from(k);
                vec![
                    column(&|x| (k * x.to_radians()).cos()),
                    column(&|x| (k * x.to_radians()).sin()),
                ]
            }
            Shape::Power(k) => {
                let (mid, half) = middle(&seen);
                vec![column(&|x| legendre(k, (x - mid) / half))]
            }
            Shape::Step(at) => vec![column(&|x| if x > at { 1.0 } else { 0.0 })],
            Shape::Levels(count) => {
                let edges = level_edges(&seen, count);
                (1..count)
                    .map(|level| {
                        column(&|x| f64::from(u8::from(edges.partition_point(|e| *e < x) == level)))
                    })
                    .collect()
            }
            Shape::Wave(cycles) => {
                let (mid, half) = middle(&seen);
                let phase = move |x: f64| std::f64::consts::PI * cycles * (x - mid) / half;
                vec![column(&|x| phase(x).cos()), column(&|x| phase(x).sin())]
            }
            Shape::Surface(other) | Shape::Product(other, ..) => {
                let (v, w) = (&layout.variables[self.variable], &layout.variables[other]);
                let values = |x: &[f64], functions: Vec<Basis>| -> Vec<Vec<f64>> {
                    functions.into_iter().map(|f| f.values(x)).collect()
                };
                let (a, b) = self.shape.factors(v, w);
                let (a, b) = (values(&x, a), values(&at(other), b));
                let both = a.iter().flat_map(|a| b.iter().map(move |b| (a, b)));
                let product = |(a, b): (&Vec<f64>, &Vec<f64>)| -> Vec<f64> {
                    a.iter().zip(b).map(|(a, b)| a * b).collect()
                };
                // The first of all is the constant, which comes last.
                both.skip(usize::from(self.shape.has_constant())).map(product).collect()
            }
            Shape::Bump(at, width) => {
                let turn = layout.variables[self.variable].angle;
                vec![column(&|x| bell(x - at, turn, width))]
            }
            Shape::Hill(other, place, width) => {
                let turns = [self.variable, other].map(|v| layout.variables[v].angle);
                let bell = |k: usize, x: f64| bell(x - place[k], turns[k], width[k]);
                vec![x.iter().zip(&at(other)).map(|(x, y)| bell(0, *x) * bell(1, *y)).collect()]
            }
        };
        if self.shape.has_constant() {
            // The shape's mean belongs to it: a library effect must not be called in to make up for it.
            columns.push(vec![1.0; x.len()]);
        }
        DMatrix::from_fn(x.len(), columns.len(), |i, c| columns[c][i])
    }

    /// Values of its variable that its direction sees: on a part of the machine, that part's own.
    pub(super) fn seen<'a>(&self, layout: &'a Layout) -> Cow<'a, [f64]> {
        seen(&layout.directions[self.direction], &layout.variables[self.variable])
    }

    /// The same shape at places (and widths) between those of the dictionary.
    pub fn around(&self, layout: &Layout) -> Vec<Self> {
        let distinct = distinct(&self.seen(layout));
        let (low, high) = (distinct[0], distinct[distinct.len() - 1]);
        let shapes: Vec<Shape> = match self.shape {
            Shape::Step(at) => {
                let reach = distinct.len().div_ceil(PLACES);
                let here = distinct.partition_point(|v| *v <= at);
                // One or two values far off at the end are outliers.
                let margin = if distinct.len() > 4 * STEP_BESIDE { STEP_BESIDE } else { 1 };
                let first = here.saturating_sub(reach).max(margin);
                let last = (here + reach).min(distinct.len() - margin);
                let stride = (last + 1).saturating_sub(first).div_ceil(MOST_PLACES).max(1);
                (first..last + 1)
                    .step_by(stride)
                    .map(|i| Shape::Step(0.5 * (distinct[i - 1] + distinct[i])))
                    .collect()
            }
            Shape::Bump(at, width) => {
                let step = (high - low) / (4.0 * PLACES as f64);
                let widths = [0.55, 0.75, 1.0, 1.35, 1.8].map(|f| f * width);
                let places = (-2..=2).map(|k| at + f64::from(k) * step);
                let seen = places.filter(|at| (low..=high).contains(at));
                seen.flat_map(|at| widths.map(|width| Shape::Bump(at, width))).collect()
            }
            Shape::Wave(cycles) => {
                [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3].map(|d| Shape::Wave(cycles + d)).into()
            }
            _ => Vec::new(),
        };
        shapes.into_iter().map(|shape| Self { shape, ..*self }).collect()
    }

    /// Columns that make its size, of `all`; a constant that goes with the shape comes after them.
    pub fn own_columns(&self, all: usize) -> usize {
        if self.shape.has_constant() { all - 1 } else { all }
    }

    /// Size of a wave, height of a step or bump, largest value of a polynomial, half the range of a free function, mm; and how it
    /// changes with each of its own coefficients.
    pub fn amplitude(&self, columns: &DMatrix<f64>, values: &[f64]) -> (f64, DVector<f64>) {
        let own = self.own_columns(values.len());
        let columns = columns.columns(0, own);
        let values = DVector::from_column_slice(&values[..own]);
        match self.shape {
            Shape::Levels(_) | Shape::Surface(_) | Shape::Product(..) => {
                let sums = columns * &values;
                let half = (columns.row(sums.imax()) - columns.row(sums.imin())) * 0.5;
                (0.5 * (sums.max() - sums.min()), half.transpose())
            }
            _ => {
                let size = values.norm();
                (size, values / size.max(f64::MIN_POSITIVE))
            }
        }
    }

    /// The variable it follows, or both.
    pub fn versus(&self, layout: &Layout) -> String {
        let name = |v: usize| layout.variables[v].name;
        match self.shape {
            Shape::Surface(other) | Shape::Product(other, ..) | Shape::Hill(other, ..) => {
                format!("{}, {}", name(self.variable), name(other))
            }
            _ => name(self.variable).into(),
        }
    }

    /// A short name of the shape, for the JSON.
    pub fn shape_name(&self) -> String {
        match self.shape {
            Shape::Harmonic(k) => format!("harmonic {k}"),
            Shape::Power(1) => "linear".into(),
            Shape::Power(k) => format!("polynomial {k}"),
            Shape::Step(at) => format!("step at {at:.4}"),
            Shape::Levels(count) => format!("irregular, {count} levels"),
            Shape::Wave(cycles) => format!("wave of {cycles:.1} cycles"),
            Shape::Product(_, p, q) => format!("product of orders {p} and {q}"),
            Shape::Surface(_) => "surface".into(),
            Shape::Bump(at, width) => format!("bump at {at:.4} of width {width:.3}"),
            Shape::Hill(_, [a, b], [u, w]) => {
                format!("bump at {a:.4} and {b:.4} of widths {u:.3} and {w:.3}")
            }
        }
    }

    /// What it says, for people.
    pub fn text(&self, layout: &Layout, amplitude_mm: f64, u95_mm: f64) -> String {
        let output = &layout.directions[self.direction].name;
        let variable = layout.variables[self.variable].name;
        let size = format!("amplitude {amplitude_mm:.5} ± {u95_mm:.5} mm");
        match self.shape {
            Shape::Harmonic(k) => {
                format!("{output} goes through {k} cycle(s) a turn of {variable}, {size}")
            }
            Shape::Power(1) => {
                format!("{output} follows a straight line in {variable}, {size}")
            }
            Shape::Power(k) => {
                format!("{output} follows a polynomial of degree {k} in {variable}, {size}")
            }
            Shape::Step(at) => format!("{output} jumps at {variable} = {at:.4}, {size}"),
            Shape::Levels(count) => {
                format!(
                    "{output} depends on {variable} in no simple shape ({count} levels), {size}"
                )
            }
            Shape::Wave(cycles) => {
                format!(
                    "{output} goes through {cycles:.1} cycles over the range of {variable}, {size}"
                )
            }
            Shape::Surface(other) | Shape::Product(other, ..) => {
                let other = layout.variables[other].name;
                format!("{output} depends on {variable} and {other} together, {size}")
            }
            Shape::Bump(at, width) => {
                format!("{output} has a bump at {variable} = {at:.4} (width {width:.3}), {size}")
            }
            Shape::Hill(other, [a, b], [u, w]) => {
                let other = layout.variables[other].name;
                format!(
                    "{output} has a bump at {variable} = {a:.4} (width {u:.3}) and {other} = {b:.4} (width {w:.3}) together, {size}"
                )
            }
        }
    }
}

/// Every term worth trying on this layout.
pub fn dictionary(layout: &Layout) -> Vec<Term> {
    let mut terms = Vec::new();
    let sites = layout.sites.iter().max().map_or(0, |last| last + 1);
    let distinct_ones = layout.directions.iter().enumerate().filter(|(_, d)| d.is_distinct());
    for (direction, d) in distinct_ones {
        for (variable, v) in layout.variables.iter().enumerate() {
            // A place in the frame moves the edge only along the edge's normal.
            if v.within && d.name != "radius" && !layout.random.is_empty() {
                continue;
            }
            // A function of as many levels as places explains whatever they scatter, however often each was captured.
            let most_levels = if v.within { usize::MAX } else { sites / SITES_TO_A_LEVEL };
            let values = seen(d, v);
            for shape in shapes(&values, v.angle, most_levels) {
                terms.push(Term { direction, variable, shape });
            }
            let most = distinct(&values).len() as f64 / VALUES_TO_A_CYCLE;
            let cycles = if v.name == "t_s" { WAVES_IN_TIME } else { WAVES };
            let open = !goes_round(v.angle, &values);
            let cycles =
                cycles.map(|k| 0.5 * f64::from(k)).filter(|c| open && !v.within && *c <= most);
            let waves = cycles.map(Shape::Wave);
            terms.extend(waves.map(|shape| Term { direction, variable, shape }));
            if d.is_part {
                continue;
            }
            // Pairs of what is set for a whole capture.
            let later = layout.variables.iter().enumerate().skip(variable + 1);
            for (other, w) in later.filter(|(_, w)| !w.within && !v.within) {
                let columns = smooth(v).len() * smooth(w).len();
                let many = columns > sites / SITES_TO_A_LEVEL;
                let varies = varies(&v.values) && varies(&w.values);
                if is_slow(v) && is_slow(w) || !varies {
                    continue;
                }
                if !many {
                    terms.push(Term { direction, variable, shape: Shape::Surface(other) });
                }
                let up_to = |v: &Variable| 1..=PRODUCT_ORDER.min(orders(v));
                let both = up_to(v).flat_map(|p| up_to(w).map(move |q| (p, q)));
                let few = both.filter(|(p, q)| p + q <= PRODUCT_ORDER + 1);
                let shapes = few.map(|(p, q)| Shape::Product(other, p, q));
                terms.extend(shapes.map(|shape| Term { direction, variable, shape }));
            }
        }
    }
    terms
}

/// How high a bell curve is at a distance from its middle, which for an angle is that within a turn.
fn bell(mut distance: f64, turn: bool, width: f64) -> f64 {
    if turn {
        distance -= 360.0 * (distance / 360.0).round();
    }
    (-0.5 * (distance / width).powi(2)).exp()
}

/// Whether a variable only goes on while captures are taken.
pub(super) fn is_slow(variable: &Variable) -> bool {
    ["t_s", "temp_c"].contains(&variable.name)
}

/// Values of a variable that a direction sees.
fn seen<'a>(direction: &Direction, variable: &'a Variable) -> Cow<'a, [f64]> {
    if !direction.is_part {
        return Cow::Borrowed(&variable.values);
    }
    let rows = variable.values.iter().zip(&direction.factors);
    rows.filter(|(_, f)| **f != 0.0).map(|(v, _)| *v).collect()
}

/// Whether a variable takes more than one value.
fn varies(values: &[f64]) -> bool {
    let (low, high) = range(values);
    high > low
}
