//! What an RTCP pose's errors make of the deviation, exactly.

use nalgebra::{Rotation3, Unit, Vector3};

use crate::diagnose::data::rtcp::Rtcp;

/// Errors of the head: offsets, B angle (in B's own sense), tilts of the B axis.
#[derive(Debug, Clone, Copy, Default)]
pub struct HeadError {
    pub(super) dx: f64,
    pub(super) dr: f64,
    pub(super) b: f64,
    pub(super) tilt_x: f64,
    pub(super) tilt_z: f64,
}

/// All errors at one pose.
#[derive(Debug, Clone, Default)]
pub struct PoseError {
    pub(super) head: HeadError,
    pub(super) datum: HeadError,
    pub(super) shift: Vector3<f64>,
    pub(super) c_shift: Vector3<f64>,
    pub(super) c_angle: f64,
    pub(super) tilt_cx: Tilt,
    pub(super) tilt_cy: Tilt,
}

/// The C axis turned about X or Y.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tilt {
    pub(super) angle_rad: f64,
    /// Height above the table's origin at which the axis stays where it was.
    pub(super) height_mm: f64,
}

impl Tilt {
    fn turned(self, about: &Unit<Vector3<f64>>, point: Vector3<f64>) -> Vector3<f64> {
        if self.angle_rad == 0.0 {
            return point;
        }
        let foot = Vector3::new(0.0, 0.0, self.height_mm);
        foot + Rotation3::from_axis_angle(about, self.angle_rad) * (point - foot)
    }
}

impl HeadError {
    /// Head vector at angle `b_rad` of a B of some sense.
    fn vector(&self, v0: Vector3<f64>, b_rad: f64, sense: f64) -> Vector3<f64> {
        let v = v0 + Vector3::new(self.dx, 0.0, -self.dr);
        let v = Rotation3::from_axis_angle(&Vector3::y_axis(), sense * (b_rad + self.b)) * v;
        if self.tilt_x == 0.0 && self.tilt_z == 0.0 {
            return v;
        }
        let x = Rotation3::from_axis_angle(&Vector3::x_axis(), self.tilt_x);
        let z = Rotation3::from_axis_angle(&Vector3::z_axis(), self.tilt_z);
        x * z * v
    }
}

impl PoseError {
    /// The deviation at a pose; `target_shift` is where the target really is, less where the model has it (table frame).
    pub fn deviation(&self, data: &Rtcp, row: usize, target_shift: Vector3<f64>) -> Vector3<f64> {
        let (b, c) = (data.b_deg[row].to_radians(), data.c_deg[row].to_radians());
        let (v0, b_sense) = (data.geometry.head, data.geometry.b_sense);
        let nominal = Rotation3::from_axis_angle(&Vector3::y_axis(), b_sense * b) * v0;
        let head = self.head.vector(v0, b, b_sense) - nominal;
        let datum = self.datum.vector(v0, 0.0, b_sense) - v0;
        let sense = data.geometry.c_sense;
        let turn = |c: f64| Rotation3::from_axis_angle(&Vector3::z_axis(), sense * c);
        let p = data.geometry.target;
        let mut target = turn(c + self.c_angle) * (p + target_shift);
        target = self.tilt_cy.turned(&Vector3::y_axis(), target);
        target = self.tilt_cx.turned(&Vector3::x_axis(), target);
        let target = target + self.c_shift - turn(c) * p;
        self.shift + head - datum - target
    }
}
