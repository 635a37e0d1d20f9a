//! The camera: its calibration file and the mapping between pixels and the measuring plane.

mod calibration;
mod doubts;
mod horizon;
mod identity;
mod lens;
mod plane_uncertainty;
mod view;

pub use calibration::{Calibration, Laser, Mapping, light};
pub use identity::Identity;
pub use lens::{Lens, LensFile};
pub(crate) use plane_uncertainty::independent;
pub use plane_uncertainty::{LENS_NUMBERS, LensCovariance, PlaneCovariance};
pub use view::View;
