//! Pivotsight measures where a five-axis laser machine's rotary axes really are, with a camera, and
//! computes what to type into the control.
//!
//! Data flows one way, and so do the modules: pixels ([`frame`]) → edges → fits → measurements →
//! machine → results. The command line ([`cli`]) only parses, calls and prints.

#![warn(clippy::unwrap_used)]

pub mod align;
pub mod ballbar;
pub mod batch;
pub mod calib;
pub mod camera;
pub mod cli;
pub mod clock;
pub mod cv;
pub mod demo;
pub mod diagnose;
pub mod draw;
pub mod edge;
pub mod error;
pub mod find;
pub mod fit;
pub mod frame;
pub mod hash;
pub mod input;
pub mod live;
pub mod machine;
pub mod measure;
pub mod output;
pub mod parquet;
pub mod plot;
pub mod regress;
pub mod render;
pub mod repeats;
pub mod report;
pub mod rotary;
pub mod rtcp;
pub mod store;
pub mod table;
pub mod thermal;
pub mod tomlfile;
pub mod uncertainty;
pub mod units;

pub use error::{Error, Result};
