//! Diagnosis: where simulation and measurement part, what is missing, and the gap closing.

mod algebra;
pub mod classes;
pub mod data;
pub mod effects;
mod exchange;
pub mod experiment;
pub mod fit;
mod formula;
pub mod generic;
pub mod holdout;
pub mod load;
pub mod model;
pub mod next;
pub mod noise;
mod outliers;
pub mod own;
pub mod page;
mod pairs;
pub mod parts;
pub mod plan;
pub mod pool;
pub mod report;
mod rim;
pub mod run;
pub mod score;
pub mod select;
pub mod tails;
