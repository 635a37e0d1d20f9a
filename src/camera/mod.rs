//! The camera: its calibration file and the mapping between pixels and the measuring plane.

mod calibration;
mod horizon;
mod identity;
mod lens;
mod plane_uncertainty;
mod view;

pub use calibration::{Calibration, Laser, Mapping, light};
pub use identity::Identity;
pub use lens::Lens;
pub use plane_uncertainty::PlaneUncertainty;
pub use view::View;
