//! Pivotsight measures where a five-axis laser machine's rotary axes really are, with a camera, and
//! computes what to type into the control.
//!
//! Data flows one way, and so do the modules: pixels ([`frame`]) → edges → fits → measurements →
//! machine → results. The command line ([`cli`]) only parses, calls and prints.

#![warn(clippy::unwrap_used)]

pub mod align;
pub mod ballbar;
pub(crate) mod batch;
pub mod calib;
pub mod camera;
pub mod cli;
pub(crate) mod clock;
pub mod cv;
pub mod demo;
pub mod diagnose;
pub(crate) mod draw;
pub(crate) mod earlier;
pub(crate) mod edge;
pub mod error;
pub(crate) mod find;
pub mod fit;
pub mod frame;
pub(crate) mod hash;
pub(crate) mod input;
pub mod live;
pub mod machine;
pub mod measure;
pub mod output;
pub(crate) mod parquet;
pub mod plot;
pub(crate) mod regress;
pub mod render;
pub(crate) mod repeats;
pub(crate) mod report;
pub mod rotary;
pub mod rtcp;
pub(crate) mod store;
pub mod table;
pub mod thermal;
pub(crate) mod tomlfile;
pub mod uncertainty;
pub(crate) mod units;

pub use error::{Error, Result};
