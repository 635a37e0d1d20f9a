//! From the tool in the table frame back to the joints: closed form for the ideal chain, then
//! corrected for the component errors where there are any.
//!
//! The tool's direction depends on the two rotary joints alone: `R₁(θ₁) R₂(θ₂) z = u`, the second
//! problem of Paden and Kahan (Murray, Li & Sastry, section 3.3), with at most two solutions. With
//! the rotary joints known the tool point is linear in X, Y, Z.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::machine::axis::{AxisName, Side};
use crate::machine::chain::{Chain, Joints, ToolPose};

/// Directions closer than this to a singular one are called singular (rad).
const SINGULAR_RAD: f64 = 1e-7;

/// Why a solution is not alone in its neighbourhood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Singularity {
    /// The tool lies along this axis, which may then take any value.
    Free(AxisName),
    /// The two solutions meet: the direction is at the edge of what the rotary axes reach.
    Edge,
}

impl std::fmt::Display for Singularity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Free(axis) => write!(f, "tool along {axis}: {axis} is free"),
            Self::Edge => write!(f, "edge of the reachable directions: both solutions meet"),
        }
    }
}

/// One way to hold a tool pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// The joints; rotary ones by the turn nearest to the hint that lies within the limits.
    pub joints: Joints,
    /// The singularity it is at, if any.
    pub singularity: Option<Singularity>,
    /// The first axis outside its limits, if any.
    pub outside: Option<AxisName>,
}

impl Chain {
    /// X, Y, Z that hold the tool point at `position_mm` of the table frame with the rotary joints
    /// given (rad, in the order of [`Joints`]): what a control's RTCP computes.
    #[inline]
    pub fn inverse_at(&self, position_mm: &Vector3<f64>, rotary: [f64; 2]) -> Joints {
        let mut q = [0.0, 0.0, 0.0, rotary[0], rotary[1]];
        self.solve_linear(position_mm, &mut q);
        if self.axes.iter().any(|a| a.errors.is_some()) {
            // The errors are small and smooth: a few rounds bring the tool point to rounding.
            let mut aim = *position_mm;
            for _ in 0..8 {
                let miss = position_mm - self.forward(&q).position_mm;
                aim += miss;
                self.solve_linear(&aim, &mut q);
                if miss.norm() < 1e-12 {
                    break;
                }
            }
        }
        q
    }

    /// All ways to hold `pose`, those within the limits first, then nearest to `near` first. Empty
    /// where the rotary axes cannot reach the direction. With component errors, a solution nearer
    /// to a singularity than the errors are large may be missing; one that is given holds the pose.
    pub fn inverse(&self, pose: &ToolPose, near: &Joints) -> Vec<Solution> {
        let norm = pose.direction.norm();
        if !(norm > 0.0 && norm.is_finite()) {
            return Vec::new();
        }
        let wanted = pose.direction / norm;
        let mut solutions = self.solve_rotary(&wanted, near);
        let exact = self.axes.iter().all(|a| a.errors.is_none());
        solutions.retain_mut(|solution| {
            let [.., a, b] = solution.joints;
            solution.joints = self.inverse_at(&pose.position_mm, [a, b]);
            let held = exact || self.correct(&wanted, &pose.position_mm, solution);
            solution.outside = self.outside(&solution.joints);
            held
        });
        let distance = |s: &Solution| (s.joints[3] - near[3]).hypot(s.joints[4] - near[4]);
        solutions.sort_by(|a, b| {
            (a.outside.is_some(), distance(a))
                .partial_cmp(&(b.outside.is_some(), distance(b)))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        solutions
    }

    /// On which of the two solutions for a direction the rotary joints of `q` lie: the sign tells them apart, and
    /// the size says how far they are from where both meet (1 at most, no unit).
    pub fn branch(&self, q: &Joints) -> f64 {
        let [w1, w2] = self.rotary_ways();
        let axis = &self.axes[self.rotary_links()[1]];
        let travel = axis.sign() * (axis.scale * q[self.slots[self.rotary_links()[1]]] + axis.zero);
        let middle = Rotation3::from_scaled_axis(w2 * travel) * Vector3::z();
        middle.dot(&w1.cross(&w2))
    }

    /// The rotary axes' directions as seen by the tool's direction in the table frame.
    fn rotary_ways(&self) -> [Vector3<f64>; 2] {
        self.rotary_links().map(|i| match self.axes[i].side {
            Side::Head => self.axes[i].direction,
            Side::Table => -self.axes[i].direction,
        })
    }

    /// The first axis (in the order of [`Joints`]) outside its limits.
    pub fn outside(&self, q: &Joints) -> Option<AxisName> {
        self.names().into_iter().zip(q).find_map(|(name, &value)| {
            let [low, high] = self.axis(name)?.limits;
            (value < low - 1e-9 || value > high + 1e-9).then_some(name)
        })
    }

    /// The ideal chain's X, Y, Z for the tool point and the rotary joints in `q`.
    fn solve_linear(&self, position: &Vector3<f64>, q: &mut Joints) {
        let mut rotation = Matrix3::identity();
        let mut point = -self.table;
        let mut columns = Matrix3::zeros();
        for (axis, &slot) in self.axes.iter().zip(&self.slots) {
            match &axis.screw {
                Some(screw) => {
                    let travel = axis.sign() * (axis.scale * q[slot] + axis.zero);
                    let signed = if axis.side == Side::Head { travel } else { -travel };
                    let turn = rotation * screw.rotation(signed);
                    point += (rotation - turn) * screw.point;
                    rotation = turn;
                }
                None => {
                    let direction = rotation * axis.direction;
                    columns.set_column(slot, &(direction * (axis.sense * axis.scale)));
                }
            }
        }
        let rest = position - point;
        // Cramer's rule: the columns are near orthonormal.
        let [a, b, c] = [0, 1, 2].map(|i| columns.column(i).into_owned());
        let (bc, ca, ab) = (b.cross(&c), c.cross(&a), a.cross(&b));
        let determinant = a.dot(&bc);
        q[0] = bc.dot(&rest) / determinant;
        q[1] = ca.dot(&rest) / determinant;
        q[2] = ab.dot(&rest) / determinant;
    }

    /// The rotary joints of the ideal chain that point the tool along the unit vector `wanted`.
    fn solve_rotary(&self, wanted: &Vector3<f64>, near: &Joints) -> Vec<Solution> {
        let links = self.rotary_links().map(|i| (&self.axes[i], self.slots[i]));
        let [w1, w2] = self.rotary_ways();
        let tool = Vector3::z();
        // z = α w1 + β w2 + γ w1×w2 is where the second rotation brings the tool.
        let c = w1.dot(&w2);
        let (p, r) = (w2.dot(&tool), w1.dot(wanted));
        let s2 = 1.0 - c * c;
        let (alpha, beta) = ((r - c * p) / s2, (p - c * r) / s2);
        let gamma2 = (1.0 - alpha * alpha - beta * beta - 2.0 * alpha * beta * c) / s2;
        if gamma2 < -SINGULAR_RAD * SINGULAR_RAD {
            return Vec::new();
        }
        let gamma = gamma2.max(0.0).sqrt();
        let free1 = w1.cross(wanted).norm() < SINGULAR_RAD;
        let free2 = w2.cross(&tool).norm() < SINGULAR_RAD;
        let edge = gamma < SINGULAR_RAD;
        let singularity = if free1 {
            Some(Singularity::Free(links[0].0.name))
        } else if free2 {
            Some(Singularity::Free(links[1].0.name))
        } else {
            edge.then_some(Singularity::Edge)
        };
        let roots: &[f64] = if edge { &[0.0] } else { &[1.0, -1.0] };
        roots
            .iter()
            .map(|sign| {
                let middle = w1 * alpha + w2 * beta + w1.cross(&w2) * (sign * gamma);
                let travels = [angle_about(&w1, &middle, wanted), angle_about(&w2, &tool, &middle)];
                let mut joints = [0.0; 5];
                for (i, &(axis, slot)) in links.iter().enumerate() {
                    let free = if i == 0 { free1 } else { free2 };
                    let q = (axis.sign() * travels[i] - axis.zero) / axis.scale;
                    joints[slot] =
                        if free { near[slot] } else { nearest_turn(q, near[slot], axis.limits) };
                }
                Solution { joints, singularity, outside: None }
            })
            .collect()
    }

    /// Moves the ideal solution until the real chain, component errors and all, points along
    /// `wanted` at `position`; whether it does. Position and direction go together: a linear axis'
    /// errors may turn the tool.
    fn correct(
        &self,
        wanted: &Vector3<f64>,
        position: &Vector3<f64>,
        found: &mut Solution,
    ) -> bool {
        let mut aim = *wanted;
        for _ in 0..12 {
            let turn = self.forward(&found.joints).direction.cross(wanted);
            if turn.norm() < 1e-12 {
                return true;
            }
            aim = Rotation3::from_scaled_axis(turn) * aim;
            let here = found.joints;
            let distance = |s: &Solution| (s.joints[3] - here[3]).hypot(s.joints[4] - here[4]);
            let candidates = self.solve_rotary(&aim, &here);
            let nearest = candidates.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
            let Some([.., a, b]) = nearest.map(|s| s.joints) else { return false };
            found.joints = self.inverse_at(position, [a, b]);
        }
        false
    }
}

/// The angle about `axis` that turns the part of `from` across the axis into that of `to`.
fn angle_about(axis: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> f64 {
    let across = |v: &Vector3<f64>| v - axis * axis.dot(v);
    let (from, to) = (across(from), across(to));
    axis.dot(&from.cross(&to)).atan2(from.dot(&to))
}

/// `q` plus the whole turns that bring it nearest to `near` within `limits`; nearest alone where
/// none is within.
fn nearest_turn(q: f64, near: f64, limits: [f64; 2]) -> f64 {
    let nearest = q + ((near - q) / TAU).round() * TAU;
    let inside = |v: &f64| *v >= limits[0] - 1e-9 && *v <= limits[1] + 1e-9;
    if inside(&nearest) {
        return nearest;
    }
    let up = q + ((limits[0] - 1e-9 - q) / TAU).ceil() * TAU;
    let down = q + ((limits[1] + 1e-9 - q) / TAU).floor() * TAU;
    let candidate = if nearest < limits[0] { up } else { down };
    if inside(&candidate) { candidate } else { nearest }
}
