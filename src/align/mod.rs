//! Aligns the tool path with a blank as it really lies: touches → tilt and centre, then CL data or NC code moved onto it.
//!
//! `Ry(B) Rx(A)` *levels the blank*; the path takes the inverse to come to lie on the tilted blank.

mod alignment;
pub mod apply;
pub mod cl;
pub mod fit;
mod mover;
pub mod nc;
pub mod post;
mod touches;

pub use alignment::Alignment;
pub use fit::fit;
pub use touches::Touches;
