//! The kinematic chain: five joints between work and tool, as a product of exponentials.

use nalgebra::{SMatrix, Translation3, Vector3};

use crate::error::{Error, Result};
use crate::machine::axis::{Axis, AxisName, Side};
use crate::machine::error_model::{ComponentError, LocationError, LocationKind};
pub use crate::machine::screw::Motion;

/// Values of the five joints: x, y, z in mm, then the two rotary axes in the alphabet's order, in rad.
pub type Joints = [f64; 5];

/// Where the tool point is and where the tool points, in the table frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolPose {
    /// The tool point, mm.
    pub position_mm: Vector3<f64>,
    /// From the tool point up the tool: unit vector, +Z at zero.
    pub direction: Vector3<f64>,
}

impl ToolPose {
    /// Whether a vector is of length 1, to the digits that files give.
    pub fn is_direction(vector: &Vector3<f64>) -> bool {
        (vector.norm() - 1.0).abs() <= 1e-3
    }
}

/// A machine of three linear and two rotary axes, each in the head or in the table.
///
/// At zero of all joints the tool point is at the machine frame's origin, the tool points to +Z,
/// and the table frame is moved from the machine frame by the table point.
#[derive(Debug, Clone)]
pub struct Chain {
    /// From the work to the tool.
    pub(super) axes: [Axis; 5],
    /// For each of `axes`, its place in [`Joints`].
    pub(super) slots: [usize; 5],
    /// The table frame's origin at zero, in the machine frame.
    pub(super) table: Vector3<f64>,
}

impl Chain {
    /// A chain from the axes in order from work to tool: table side from the work down to the bed,
    /// then head side from the bed to the tool. Needs X, Y, Z and two different rotary axes.
    pub fn new(axes: [Axis; 5], table_mm: Vector3<f64>) -> Result<Self> {
        let fail = |reason: &str, fix: &str| Err(Error::measure("kinematic chain", reason, fix));
        let mut names: Vec<AxisName> = axes.iter().map(|a| a.name).collect();
        names.sort_unstable();
        names.dedup();
        if names.len() != 5 || names[..3] != [AxisName::X, AxisName::Y, AxisName::Z] {
            return fail("needs X, Y, Z and two different ones of A, B, C", "name five axes");
        }
        if axes.windows(2).any(|w| w[0].side == Side::Head && w[1].side == Side::Table) {
            return fail("has a head axis on the work's side", "list table axes before head axes");
        }
        let slots =
            std::array::from_fn(|i| names.iter().position(|&n| n == axes[i].name).unwrap_or(0));
        let chain = Self { axes, slots, table: table_mm };
        let [a, b] = chain.rotary_links().map(|i| chain.axes[i].direction);
        let linear = nalgebra::Matrix3::from_columns(
            &[AxisName::X, AxisName::Y, AxisName::Z]
                .map(|n| chain.axis(n).map_or(n.direction(), Axis::direction)),
        );
        if a.cross(&b).norm() < 1e-6 || linear.determinant().abs() < 1e-6 {
            return fail(
                "has parallel rotary axes or linear axes in one plane",
                "correct the directions",
            );
        }
        Ok(chain)
    }

    /// The five names in the order of [`Joints`].
    pub fn names(&self) -> [AxisName; 5] {
        let mut names = [AxisName::X; 5];
        for (axis, &slot) in self.axes.iter().zip(&self.slots) {
            names[slot] = axis.name;
        }
        names
    }

    /// The two rotary axes in the order of [`Joints`].
    pub fn rotary_names(&self) -> [AxisName; 2] {
        let n = self.names();
        [n[3], n[4]]
    }

    /// Refuses another machine's chain whose rotary axes are others: angles of one's would be taken for the other's.
    pub fn same_rotary(&self, other: &Self, option: &str) -> Result<()> {
        let [own, others] = [self, other].map(|c| c.rotary_names().map(AxisName::letter));
        if own == others {
            return Ok(());
        }
        let reason = format!(
            "has the rotary axes {} and {} where the machine has {} and {}",
            others[0], others[1], own[0], own[1]
        );
        Err(Error::option(
            option,
            reason,
            "give the same machine's file with the values its control held",
        ))
    }

    /// The axes from the work to the tool.
    pub fn axes(&self) -> &[Axis; 5] {
        &self.axes
    }

    /// One axis, where the machine has it.
    pub fn axis(&self, name: AxisName) -> Option<&Axis> {
        self.axes.iter().find(|a| a.name == name)
    }

    /// Puts in a location error (adding to what is there); see [`LocationError`] for units.
    pub fn add_location_error(&mut self, error: LocationError, amount: f64) -> Result<()> {
        let axis = self.axis_mut(error.axis)?;
        let point = axis.point_mm();
        match error.kind {
            LocationKind::Shift(i) => {
                axis.set_line(axis.direction, point + Vector3::ith(i, amount));
            }
            LocationKind::Tilt(i) => {
                let turn = nalgebra::Rotation3::from_scaled_axis(Vector3::ith(i, amount));
                axis.set_line(turn * axis.direction, point);
            }
            LocationKind::Zero => axis.zero += amount,
            LocationKind::Scale => axis.scale += amount,
        }
        Ok(())
    }

    /// Puts in a component error (in place of an earlier one of that name).
    pub fn set_component_error(&mut self, error: &ComponentError) -> Result<()> {
        self.axis_mut(error.axis)?.errors.get_or_insert_default().set(error);
        Ok(())
    }

    fn axis_mut(&mut self, name: AxisName) -> Result<&mut Axis> {
        self.axes.iter_mut().find(|a| a.name == name).ok_or_else(|| {
            Error::measure(
                format!("axis {name}"),
                "this machine has no such axis",
                "name one it has",
            )
        })
    }

    /// Where the tool is in the machine frame.
    pub fn tool(&self, q: &Joints) -> Motion {
        let head = self.axes.iter().zip(&self.slots).filter(|(a, _)| a.side == Side::Head);
        head.fold(Motion::identity(), |m, (a, &slot)| m * a.motion(q[slot]))
    }

    /// Where the table frame is in the machine frame.
    pub fn work(&self, q: &Joints) -> Motion {
        let table = self.axes.iter().zip(&self.slots).rev().filter(|(a, _)| a.side == Side::Table);
        let moved = table.fold(Motion::identity(), |m, (a, &slot)| m * a.motion(q[slot]));
        moved * Translation3::from(self.table)
    }

    /// Where the tool is in the table frame.
    pub fn forward(&self, q: &Joints) -> ToolPose {
        let pose = self.work(q).inv_mul(&self.tool(q));
        ToolPose { position_mm: pose.translation.vector, direction: pose.rotation * Vector3::z() }
    }

    /// The derivative of tool position (rows 0-2, mm) and direction (rows 3-5) in the table frame
    /// by the joints.
    pub fn jacobian(&self, q: &Joints) -> SMatrix<f64, 6, 5> {
        let mut jacobian = SMatrix::<f64, 6, 5>::zeros();
        let mut prefix =
            Motion::from_parts(Translation3::from(-self.table), nalgebra::Rotation3::identity());
        let pose = self.forward(q);
        for (axis, &slot) in self.axes.iter().zip(&self.slots) {
            let (motion, twist) = (axis.motion(q[slot]), axis.twist(q[slot]));
            let twist = match axis.side {
                Side::Head => {
                    let seen = twist.seen_from(&prefix);
                    prefix *= motion;
                    seen
                }
                Side::Table => {
                    // d(M⁻¹) = -M⁻¹ (dM M⁻¹): the same twist, seen from behind M⁻¹, the other way.
                    prefix *= motion.inverse();
                    let mut seen = twist.seen_from(&prefix);
                    seen.angular = -seen.angular;
                    seen.linear = -seen.linear;
                    seen
                }
            };
            let position = twist.angular.cross(&pose.position_mm) + twist.linear;
            let direction = twist.angular.cross(&pose.direction);
            jacobian.fixed_view_mut::<3, 1>(0, slot).copy_from(&position);
            jacobian.fixed_view_mut::<3, 1>(3, slot).copy_from(&direction);
        }
        jacobian
    }

    /// The places in `axes` of the two rotary axes, from work to tool.
    pub(super) fn rotary_links(&self) -> [usize; 2] {
        let mut links = (0..5).filter(|&i| self.axes[i].name.is_rotary());
        [links.next().unwrap_or(0), links.next().unwrap_or(0)]
    }
}
