//! One joint of the machine: which side it is on, its line, its sense, its limits and its errors.

use nalgebra::{Translation3, Vector3};

use crate::error::{Error, Result};
use crate::machine::error_model::AxisErrors;
use crate::machine::screw::{Motion, RotaryScrew, Twist};

/// The names of the axes, as in ISO 841.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum AxisName {
    X,
    Y,
    Z,
    A,
    B,
    C,
}

impl AxisName {
    /// All six, linear ones first.
    pub const ALL: [Self; 6] = [Self::X, Self::Y, Self::Z, Self::A, Self::B, Self::C];

    /// Whether it turns rather than slides.
    pub fn is_rotary(self) -> bool {
        matches!(self, Self::A | Self::B | Self::C)
    }

    /// 0, 1, 2 for X or A, Y or B, Z or C.
    pub fn component(self) -> usize {
        self as usize % 3
    }

    /// The unit vector it moves along or about at nominal.
    pub fn direction(self) -> Vector3<f64> {
        Vector3::ith(self.component(), 1.0)
    }

    /// The axis with this letter.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|a| a.letter() == letter)
    }

    /// The name of a table's column of a rotary axis' angles: `b_deg`.
    pub fn column_deg(self) -> String {
        format!("{}_deg", self.letter().to_ascii_lowercase())
    }

    /// Its letter.
    pub fn letter(self) -> char {
        ['X', 'Y', 'Z', 'A', 'B', 'C'][self as usize]
    }
}

impl std::fmt::Display for AxisName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.letter())
    }
}

/// What an axis carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The tool: its motion is the tool's.
    Head,
    /// The work: a linear axis moves the table the opposite way, so that machine coordinates say
    /// where the tool is relative to the work (ISO 841).
    Table,
}

/// One joint at its zero, in the machine frame.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Its name.
    pub name: AxisName,
    /// What it carries.
    pub side: Side,
    /// +1 where positive values move the carried body right-handed about (or along) the direction,
    /// else -1.
    pub sense: f64,
    /// Least and largest value, mm or rad; infinite where unknown.
    pub limits: [f64; 2],
    pub(super) direction: Vector3<f64>,
    pub(super) screw: Option<RotaryScrew>,
    pub(super) zero: f64,
    pub(super) scale: f64,
    pub(super) errors: Option<Box<AxisErrors>>,
}

impl Axis {
    /// A linear axis; `direction` is where its positive values move the tool relative to the work.
    pub fn linear(name: AxisName, side: Side, direction: Vector3<f64>) -> Result<Self> {
        Self::new(name, side, 1.0, direction, None)
    }

    /// A rotary axis about the line through `point_mm` along `direction`.
    pub fn rotary(
        name: AxisName,
        side: Side,
        sense: f64,
        direction: Vector3<f64>,
        point_mm: Vector3<f64>,
    ) -> Result<Self> {
        Self::new(name, side, sense, direction, Some(point_mm))
    }

    fn new(
        name: AxisName,
        side: Side,
        sense: f64,
        direction: Vector3<f64>,
        point: Option<Vector3<f64>>,
    ) -> Result<Self> {
        let subject = format!("axis {name}");
        if name.is_rotary() != point.is_some() {
            let reason = "X Y Z slide and A B C turn";
            return Err(Error::measure(subject, reason, "use the letter that fits the axis"));
        }
        let length = direction.norm();
        let usable = length.is_finite()
            && length > 1e-9
            && point.is_none_or(|p| p.iter().all(|v| v.is_finite()))
            && sense.abs() == 1.0;
        if !usable {
            let fix = "give a direction other than zero, finite numbers, and a sense of 1 or -1";
            return Err(Error::measure(subject, "its line is not usable", fix));
        }
        let direction = direction / length;
        Ok(Self {
            name,
            side,
            sense,
            limits: [f64::NEG_INFINITY, f64::INFINITY],
            direction,
            screw: point.map(|p| RotaryScrew::new(direction, p)),
            zero: 0.0,
            scale: 1.0,
            errors: None,
        })
    }

    /// The unit direction of the axis, real where location errors were put in.
    pub fn direction(&self) -> Vector3<f64> {
        self.direction
    }

    /// A point of a rotary axis' line; the origin for a linear axis.
    pub fn point_mm(&self) -> Vector3<f64> {
        self.screw.as_ref().map_or_else(Vector3::zeros, |s| s.point)
    }

    pub(super) fn set_line(&mut self, direction: Vector3<f64>, point: Vector3<f64>) {
        self.direction = direction.normalize();
        if let Some(screw) = &mut self.screw {
            *screw = RotaryScrew::new(self.direction, point);
        }
    }

    /// The way the carried body goes for a positive command.
    pub(super) fn sign(&self) -> f64 {
        if self.screw.is_none() && self.side == Side::Table { -self.sense } else { self.sense }
    }

    /// What the joint really does when told `q`: sense, zero, scale and its own positioning error.
    fn travel(&self, q: f64) -> f64 {
        let own = self.errors.as_ref().map_or(0.0, |e| e.own.value(q));
        self.sign() * (self.scale * q + self.zero + own)
    }

    /// The motion of the carried body (in the machine frame) when told `q`.
    pub fn motion(&self, q: f64) -> Motion {
        let travel = self.travel(q);
        let ideal = match &self.screw {
            Some(screw) => screw.motion(travel),
            None => Motion::from_parts(
                Translation3::from(self.direction * travel),
                nalgebra::Rotation3::identity(),
            ),
        };
        match &self.errors {
            Some(errors) if errors.moves => errors.motion(q, self.point_mm()) * ideal,
            _ => ideal,
        }
    }

    /// d(motion)/dq · motion⁻¹ at `q`.
    pub(super) fn twist(&self, q: f64) -> Twist {
        let slope_own = self.errors.as_ref().map_or(0.0, |e| e.own.slope(q));
        let speed = self.sign() * (self.scale + slope_own);
        let unit = match &self.screw {
            Some(screw) => screw.twist(),
            None => Twist { angular: Vector3::zeros(), linear: self.direction },
        };
        let ideal = Twist { angular: unit.angular * speed, linear: unit.linear * speed };
        match &self.errors {
            Some(errors) if errors.moves => {
                let carried = ideal.seen_from(&errors.motion(q, self.point_mm()));
                let own = errors.twist(q, self.point_mm());
                Twist {
                    angular: carried.angular + own.angular,
                    linear: carried.linear + own.linear,
                }
            }
            _ => ideal,
        }
    }
}

/// An angle in degrees as people wrote it: radians and back leave the last bits changed.
pub fn written_deg(angle_rad: f64) -> f64 {
    (1e9 * angle_rad.to_degrees()).round() / 1e9 + 0.0
}

/// How far two angles of a rotary axis lie apart, whole turns aside.
pub fn apart_deg(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(360.0);
    turn.min(360.0 - turn)
}
