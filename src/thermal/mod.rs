//! Thermal error of a laser machine: a model from calibration runs, and corrections in real time.
//!
//! `ΔK = K0 + tan β(T) (P - P0)` for each axis: `K0 = Σ a_i t_i` is the cutting head's displacement from the rises
//! `t_i` of its sensors above the cold state; `tan β(T) = Tk_max (T - T0) / (T_max - T0)` is the slope of the position
//! error along the axis at screw temperature `T`. `ΔK` is the deviation; the correction has the opposite sign.

mod blocks;
pub mod compensate;
pub mod head;
mod law;
mod lines;
mod model;
pub mod screw;
pub mod simulate;
mod sums;
pub mod verify;

pub use model::{Model, fit};
