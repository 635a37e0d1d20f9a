//! The camera: its calibration file and the mapping between pixels and the measuring plane.

mod calibration;
mod horizon;
mod identity;
mod view;

pub use calibration::{Calibration, Laser, Lens, Mapping, light};
pub use identity::Identity;
pub use view::View;
