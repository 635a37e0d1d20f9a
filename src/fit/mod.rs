//! Fits: least squares in general, circles and ellipses in particular.

pub mod least_squares;
