//! Fits: least squares in general, circles in particular, with correlated residuals.

pub mod circle;
pub mod correlated;
pub mod least_squares;
pub mod robust;
pub mod serial;
pub mod tails;

pub use circle::Circle;
