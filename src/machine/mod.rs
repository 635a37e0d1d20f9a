//! The machine: a five-axis kinematic chain of screws, its errors, and the file that describes it.
//!
//! - [`Machine`] is `machine.toml`; [`Machine::chain`] turns it into a
//! - [`Chain`]: forward, inverse (all solutions), fixed-rotary inverse, Jacobian, and where tool
//!   and work really are. Location errors ([`LocationError`]) and component errors
//!   ([`ComponentError`]) are put into a chain; a chain without any is what the control believes.
//!
//! Joint values are [`Joints`]: `[x, y, z, rotary, rotary]`, linear in mm, rotary in rad, the two
//! rotary axes in the alphabet's order (B, C for the head B / table C machine). Conventions:
//! `docs/machine.md`.

mod axis;
mod chain;
mod data_kind;
mod entered;
mod error_model;
mod figure;
mod file;
mod file_check;
mod inverse;
mod screw;

pub use axis::{Axis, AxisName, Side, apart_deg, written_deg};
pub use chain::{Chain, Joints, Motion, ToolPose};
pub use data_kind::DataKind;
pub use entered::{Entered, entered, is_entered, is_told};
pub use error_model::{ComponentError, Curve, LocationError, LocationKind};
pub use figure::frames_svg;
pub use file::{AxisEntry, Effect, Head, Kinematics, Machine, Table, Target};
pub(crate) use file_check::FOCUS;
pub use inverse::{Singularity, Solution};
