//! A shape without a name as a formula of the data's columns, so that a model file can hold it.

use std::fmt::Write as _;

use crate::diagnose::basis::{Basis, level_edges, middle};
use crate::diagnose::experiment::{Layout, Variable};
use crate::diagnose::generic::Term;
use crate::diagnose::shape::Shape;

impl Term {
    /// The formula of the shape with these coefficients, in units of `unit`.
    pub fn formula(&self, layout: &Layout, values: &[f64], unit: f64) -> String {
        let variable = &layout.variables[self.variable];
        let (x, name) = (&*self.seen(layout), variable.name);
        let mut sum = Sum { text: String::new(), unit };
        let own = self.own_columns(values.len());
        match self.shape {
            Shape::Harmonic(k) => {
                sum.add(values[0], &Basis::Cos(k).text(name, x));
                sum.add(values[1], &Basis::Sin(k).text(name, x));
            }
            Shape::Power(k) => sum.add(values[0], &Basis::Legendre(k).text(name, x)),
            Shape::Step(at) => sum.add(values[0], &step(name, at)),
            Shape::Levels(count) => {
                let mut last = 0.0;
                for (value, edge) in values[..own].iter().zip(level_edges(x, count)) {
                    sum.add(value - last, &step(name, edge));
                    last = *value;
                }
            }
            Shape::Wave(cycles) => {
                let (mid, half) = middle(x);
                let phase =
                    format!("(PI*{}*({name} - {})/{})", number(cycles), number(mid), number(half));
                sum.add(values[0], &format!("cos{phase}"));
                sum.add(values[1], &format!("sin{phase}"));
            }
            Shape::Surface(other) | Shape::Product(other, ..) => {
                let w = &layout.variables[other];
                let (a, b) = self.shape.factors(variable, w);
                let both = a.iter().flat_map(|p| b.iter().map(move |q| (p, q)));
                let products = both.skip(usize::from(self.shape.has_constant()));
                for (value, (p, q)) in values.iter().zip(products) {
                    sum.add(*value, &format!("{}*{}", p.text(name, x), q.text(w.name, &w.values)));
                }
            }
            Shape::Bump(at, width) => {
                sum.add(values[0], &bell(variable, at, width));
            }
            Shape::Hill(other, at, width) => {
                let bells = [
                    bell(variable, at[0], width[0]),
                    bell(&layout.variables[other], at[1], width[1]),
                ];
                sum.add(values[0], &bells.join("*"));
            }
        }
        // The constant that goes with the shape, where the baseline has none.
        let constants = values[own..].iter().filter(|constant| **constant != 0.0);
        constants.for_each(|constant| sum.add(*constant, "1"));
        sum.text
    }
}

/// Terms with their coefficients, as text.
struct Sum {
    text: String,
    unit: f64,
}

impl Sum {
    fn add(&mut self, coefficient: f64, of: &str) {
        let join = if self.text.is_empty() { "" } else { " + " };
        // Writing to a String cannot fail.
        let _ = write!(self.text, "{join}{}*{of}", number(coefficient / self.unit));
    }
}

impl Basis {
    /// As a formula of a column with these values.
    fn text(self, name: &str, values: &[f64]) -> String {
        let (mid, half) = middle(values);
        let u = format!("(({name} - {})/{})", number(mid), number(half));
        match self {
            Self::Legendre(0) => "1".into(),
            Self::Legendre(1) => u,
            Self::Legendre(2) => format!("(1.5*{u}^2 - 0.5)"),
            Self::Legendre(3) => format!("(2.5*{u}^3 - 1.5*{u})"),
            Self::Legendre(_) => format!("(4.375*{u}^4 - 3.75*{u}^2 + 0.375)"),
            Self::Cos(k) => format!("cos({k}*{name}*PI/180)"),
            Self::Sin(k) => format!("sin({k}*{name}*PI/180)"),
        }
    }
}

/// 0 up to a place, 1 beyond it.
fn step(name: &str, at: f64) -> String {
    format!("(0.5 + 0.5*signum({name} - {}))", number(at))
}

/// A bell curve in a variable.
fn bell(variable: &Variable, at: f64, width: f64) -> String {
    let mut d = format!("({} - {})", variable.name, number(at));
    if variable.angle {
        d = format!("({d} - 360*round({d}/360))");
    }
    format!("exp(-0.5*({d}/{})^2)", number(width))
}

/// A number as formulas take it, with its sign in brackets.
fn number(value: f64) -> String {
    if value < 0.0 { format!("({value:.9})") } else { format!("{value:.9}") }
}

#[cfg(test)]
mod tests {
    use exmex::Express;

    use super::*;
    use crate::diagnose::experiment::Direction;
    use crate::diagnose::generic::dictionary;

    #[test]
    fn a_formula_says_what_the_columns_of_its_shape_say() {
        const ROWS: usize = 150;
        let column = |name, angle, of: &dyn Fn(f64) -> f64| Variable {
            name,
            values: (0..ROWS).map(|i| of((i * 61 % ROWS) as f64)).collect(),
            angle,
            within: false,
        };
        let layout = Layout {
            values: vec![0.0; ROWS],
            groups: (0..ROWS).collect(),
            sites: (0..ROWS).collect(),
            directions: vec![Direction::whole("dx_mm", vec![1.0; ROWS])],
            variables: vec![
                column("b_deg", true, &|i| (i * 7.0) % 13.0 * 15.0 - 90.0),
                column("c_deg", true, &|i| (i * 11.0) % 29.0 * 12.3),
                column("t_s", false, &|i| 31.5 * i),
            ],
            ..Layout::default()
        };
        let mut terms = dictionary(&layout);
        let is_bump = |t: &&Term| matches!(t.shape, Shape::Bump(..)) && t.variable == 1;
        let bump = *terms.iter().find(is_bump).unwrap();
        terms.extend(bump.hills(&layout));
        for of in [
            |s: Shape| matches!(s, Shape::Hill(..)),
            |s: Shape| matches!(s, Shape::Surface(_)),
            |s: Shape| matches!(s, Shape::Product(..)),
            |s: Shape| matches!(s, Shape::Wave(_)),
        ] {
            assert!(terms.iter().any(|t| of(t.shape)));
        }
        for term in terms {
            let columns = term.columns(&layout);
            let values: Vec<f64> =
                (0..columns.ncols()).map(|k| 0.003 * (1.7 * k as f64 + 0.4).cos()).collect();
            let formula = exmex::parse::<f64>(&term.formula(&layout, &values, 0.002)).unwrap();
            for i in 0..ROWS {
                let of = |name: &String| layout.variables.iter().find(|v| v.name == name).unwrap();
                let inputs: Vec<f64> =
                    formula.var_names().iter().map(|n| of(n).values[i]).collect();
                let said = 0.002 * formula.eval(&inputs).unwrap();
                let meant: f64 = columns.row(i).iter().zip(&values).map(|(c, v)| c * v).sum();
                assert!((said - meant).abs() < 1e-9, "{term:?} at {i}: {said} for {meant}");
            }
        }
    }
}
