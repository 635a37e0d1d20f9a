//! Rotated tool centre point: what the control computes, what the machine really does, and the
//! difference.

pub mod compare;
pub mod doubts;
pub mod export;
pub mod plan;
pub mod poses;
pub mod report;
mod results;
mod session;
mod session_file;
mod session_reader;
mod session_rod;
pub mod solve;
pub mod solved_file;
pub mod sweep;
pub mod verify;

use nalgebra::Vector3;

pub use session::{InControl, Limit, Session};

use crate::machine::{Chain, Joints};

/// The deviation `d` = tool point really reached - target really there (machine frame, mm), when
/// the control, believing `control`, holds the tool at `target_mm` of the table frame with the
/// rotary joints given (rad) on the machine `real`.
#[inline]
pub fn deviation(
    control: &Chain,
    real: &Chain,
    target_mm: &Vector3<f64>,
    rotary: [f64; 2],
) -> Vector3<f64> {
    let joints: Joints = control.inverse_at(target_mm, rotary);
    reached_minus_target(real, target_mm, &joints)
}

/// As [`deviation`], for joints already commanded.
#[inline]
pub fn reached_minus_target(
    real: &Chain,
    target_mm: &Vector3<f64>,
    joints: &Joints,
) -> Vector3<f64> {
    let work = real.work(joints);
    real.tool(joints).translation.vector - (work * nalgebra::Point3::from(*target_mm)).coords
}
