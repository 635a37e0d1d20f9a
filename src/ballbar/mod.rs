//! Ball bar with B and a linear axis moving together: plan a path, simulate it, take the errors apart.
//!
//! The bar sees only the part of an error along itself, so every path is blind to some errors. `decouple` says what
//! the given paths can see, gives numbers for that alone, and names a path that would add the rest.
//!
//! Lengths are in the pivot's frame at zero: X right, Y back, Z up; the source's `Z` drives the head *down*.
//! Errors are the machine model's location errors: a shifted or tilted axis line, the zero pose unchanged.

mod data;
pub mod decouple;
pub mod model;
pub mod path;
mod report;
mod sight;
pub mod simulate;
pub mod swarm;

pub use data::Data;
pub use model::{ERRORS, Errors};
pub use path::{Kind, Path, Range, Setup};
pub use report::{Combination, Report, Term, Value, sum};
