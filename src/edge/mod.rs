//! Sub-pixel edge points with a variance each, from the pixels in a band along an expected contour.
//!
//! 1. [`Contour`]: the expected circle as it is seen in the picture (tilt and distortion included).
//! 2. [`scan`]: every pixel of the band goes, once and uninterpolated, into the profile of its sector.
//! 3. [`locate`]: each sector's profile is matched with the profile common to all of them. No shape of edge is
//!    assumed, so soft, asymmetric and multiple edges all work, and the noise bound is reached.
//! 4. [`together()`]: a small mark on brushed metal, once more all round at once, free of the metal's texture.

mod blurred;
mod contour;
mod hidden;
mod levels;
mod locate;
mod lost;
mod noise;
mod plain;
mod pool;
mod rounds;
mod scan;
mod sector;
mod shading;
mod shape;
mod template;
mod texture;
mod together;
mod window;

pub use contour::Contour;
pub(crate) use contour::wrap;
pub use hidden::{Side, hide};
pub use locate::{Located, Options as LocateOptions, locate};
pub use lost::Lost;
pub use scan::{Band, Profiles, scan};
pub use shading::{Levels, Slope, even_out, flatten};
pub use template::Template;
pub(crate) use template::lens_share;
pub use together::together;
