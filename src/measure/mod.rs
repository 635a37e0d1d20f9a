//! A picture (or captures) → a measurement.

pub mod ring;
