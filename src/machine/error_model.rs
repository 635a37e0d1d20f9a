//! Errors of the axes under their ISO 230-7 names: location errors (where an axis' line really is)
//! and component errors (how a moving axis really moves).

use std::str::FromStr;

use nalgebra::Vector3;

use crate::error::Error;
use crate::machine::axis::AxisName;
use crate::machine::screw::{Motion, Twist, small_motion};

/// A location error, such as `XOC` (the C axis lies off in X) or `AOB` (the B axis is tilted about
/// X).
///
/// For a rotary axis: `XO· YO· ZO·` shift its line (mm), `AO· BO· CO·` tilt it (rad) about its own
/// point; the tilt about its own direction is its zero error. For a linear axis: `AO· BO· CO·` turn
/// its direction (squareness, rad), and `EXX EYY EZZ` are its scale error (length per length). The
/// zero pose stays where it is, except for a zero error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LocationError {
    /// The axis that is off.
    pub axis: AxisName,
    /// The way it is off.
    pub kind: LocationKind,
}

/// The way an axis is off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LocationKind {
    /// Shifted along X, Y or Z (component 0, 1, 2), mm.
    Shift(usize),
    /// Tilted about X, Y or Z, rad.
    Tilt(usize),
    /// Turned about itself at zero, rad.
    Zero,
    /// Travels too far by this part of the way.
    Scale,
}

impl FromStr for LocationError {
    type Err = Error;

    /// Reads `XOC`, `X0C`, `EXX` and their like.
    fn from_str(name: &str) -> Result<Self, Error> {
        let unknown = || {
            Error::option(
                name,
                "is no location error of this kind of axis",
                "write e.g. XOC (position), AOC (tilt), BOB (zero), COY (squareness) or EXX (scale)",
            )
        };
        let letters: Vec<char> = name.chars().collect();
        let &[first, middle, last] = letters.as_slice() else { return Err(unknown()) };
        let axis = AxisName::from_letter(last).ok_or_else(unknown)?;
        let kind = match (first, middle) {
            ('E', middle) if middle == last && !axis.is_rotary() => LocationKind::Scale,
            (first, 'O' | '0') => {
                let sort = AxisName::from_letter(first).ok_or_else(unknown)?;
                match (sort.is_rotary(), axis.is_rotary()) {
                    (false, true) => LocationKind::Shift(sort.component()),
                    (true, true) if sort == axis => LocationKind::Zero,
                    (true, _) => LocationKind::Tilt(sort.component()),
                    (false, false) => return Err(unknown()),
                }
            }
            _ => return Err(unknown()),
        };
        Ok(Self { axis, kind })
    }
}

/// A component error, such as `EBB` (angular positioning of B) or `EZC` (axial motion of C), as a
/// function of the axis' own commanded position.
///
/// The axis' own positioning error counts along its own positive sense; the other five move the
/// carried body along or about the machine's X, Y, Z, turning about the axis' point. Lengths in mm,
/// angles in rad.
#[derive(Debug, Clone, PartialEq)]
pub struct ComponentError {
    /// The axis that moves.
    pub axis: AxisName,
    /// The way the body goes wrong: `X Y Z` shift, `A B C` turn.
    pub way: AxisName,
    /// How much, over the axis' position.
    pub curve: Curve,
}

/// A function of one axis' position.
#[derive(Debug, Clone, PartialEq)]
pub enum Curve {
    /// Σ cos·cos(n·2πq/period) + sin·sin(n·2πq/period) over `[n, cos, sin]`; order 0 is a constant.
    Harmonics {
        /// mm or rad; 2π for a rotary axis.
        period: f64,
        /// `[order, cosine amplitude, sine amplitude]`.
        terms: Vec<[f64; 3]>,
    },
    /// Straight lines between `(position, value)` points in rising order; constant beyond the ends.
    Table(Vec<(f64, f64)>),
}

impl Default for Curve {
    fn default() -> Self {
        Self::Table(Vec::new())
    }
}

impl Curve {
    /// The value at `q`.
    pub fn value(&self, q: f64) -> f64 {
        match self {
            Self::Harmonics { period, terms } => terms
                .iter()
                .map(|&[n, c, s]| {
                    let (sin, cos) = (n * std::f64::consts::TAU * q / period).sin_cos();
                    c * cos + s * sin
                })
                .sum(),
            Self::Table(points) => match Self::segment(points, q) {
                Some(((q0, v0), (q1, v1))) => v0 + (v1 - v0) * (q - q0) / (q1 - q0),
                None => match points.first() {
                    Some(&(q0, v0)) if q <= q0 => v0,
                    _ => points.last().map_or(0.0, |p| p.1),
                },
            },
        }
    }

    /// The derivative at `q`.
    pub fn slope(&self, q: f64) -> f64 {
        match self {
            Self::Harmonics { period, terms } => terms
                .iter()
                .map(|&[n, c, s]| {
                    let k = n * std::f64::consts::TAU / period;
                    let (sin, cos) = (k * q).sin_cos();
                    k * (s * cos - c * sin)
                })
                .sum(),
            Self::Table(points) => {
                Self::segment(points, q).map_or(0.0, |((q0, v0), (q1, v1))| (v1 - v0) / (q1 - q0))
            }
        }
    }

    fn segment(points: &[(f64, f64)], q: f64) -> Option<((f64, f64), (f64, f64))> {
        let right = points.partition_point(|p| p.0 <= q);
        (right > 0 && right < points.len()).then(|| (points[right - 1], points[right]))
    }
}

/// The component errors of one axis.
#[derive(Debug, Clone, Default)]
pub struct AxisErrors {
    /// Positioning along or about itself.
    pub own: Curve,
    /// The other ways.
    shift: [Curve; 3],
    turn: [Curve; 3],
    /// Whether any of the other ways is used.
    pub moves: bool,
}

impl AxisErrors {
    pub fn set(&mut self, error: &ComponentError) {
        let i = error.way.component();
        if error.way == error.axis {
            self.own = error.curve.clone();
            return;
        }
        self.moves = true;
        if error.way.is_rotary() {
            self.turn[i] = error.curve.clone();
        } else {
            self.shift[i] = error.curve.clone();
        }
    }

    pub fn motion(&self, q: f64, point: Vector3<f64>) -> Motion {
        let at = |c: &[Curve; 3]| Vector3::from_fn(|i, _| c[i].value(q));
        small_motion(at(&self.turn), point, at(&self.shift))
    }

    /// d(motion)/dq · motion⁻¹, to second order in the (small) turn.
    pub fn twist(&self, q: f64, point: Vector3<f64>) -> Twist {
        let value = |c: &[Curve; 3]| Vector3::from_fn(|i, _| c[i].value(q));
        let slope = |c: &[Curve; 3]| Vector3::from_fn(|i, _| c[i].slope(q));
        let turn = value(&self.turn);
        let turn_slope = slope(&self.turn);
        let angular = turn_slope + 0.5 * turn.cross(&turn_slope);
        let centre = point + value(&self.shift);
        Twist { angular, linear: slope(&self.shift) + centre.cross(&angular) }
    }
}
