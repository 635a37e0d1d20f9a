//! The session file as it is written: keys and defaults.

use std::path::PathBuf;

use serde::Deserialize;

/// The file as written; `docs/solve.md` explains each key.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub schema: Option<u32>,
    #[serde(default)]
    pub name: String,
    #[serde(default = "plus_one")]
    pub c_sense: i32,
    #[serde(default)]
    pub burn: Option<Burn>,
    #[serde(default)]
    pub checks: Checks,
    pub rod: Rod,
    pub touch: Touch,
    #[serde(default)]
    pub head: HeadEntry,
    #[serde(default)]
    pub control: Option<Control>,
}

/// S1: the last burn test.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Burn {
    pub result: Option<PathBuf>,
    pub offset_mm: Option<[f64; 2]>,
    pub offset_u_mm: Option<OneOrTwo>,
    #[serde(default = "ring_height")]
    pub ring_height_mm: f64,
    #[serde(default = "spot_height")]
    pub spot_height_mm: f64,
    #[serde(default = "hundredth")]
    pub tolerance_mm: f64,
}

/// S2: the dial indicator on the rod.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checks {
    pub rod_parallel_mm: Option<f64>,
    pub rod_runout_mm: Option<f64>,
    #[serde(default = "micrometre")]
    pub indicator_u_mm: f64,
    #[serde(default = "hundredth")]
    pub tolerance_mm: f64,
}

impl Default for Checks {
    fn default() -> Self {
        Self {
            rod_parallel_mm: None,
            rod_runout_mm: None,
            indicator_u_mm: micrometre(),
            tolerance_mm: hundredth(),
        }
    }
}

/// S2: the rod's centre and diameter.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rod {
    pub result: Option<PathBuf>,
    pub diameter_mm: Option<f64>,
    pub diameter_u_mm: Option<f64>,
    pub center_mm: Option<[f64; 2]>,
    pub center_u_mm: Option<OneOrTwo>,
    pub eccentricity_mm: Option<f64>,
}

/// S3: the contact readings.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Touch {
    pub x1_mm: f64,
    pub x1_u_mm: Option<f64>,
    pub x2_mm: f64,
    pub x2_u_mm: Option<f64>,
    pub z_table_mm: f64,
    pub z_table_u_mm: Option<f64>,
    #[serde(default = "plus_90")]
    pub b1_deg: f64,
    #[serde(default = "minus_90")]
    pub b2_deg: f64,
    pub x45_mm: Option<f64>,
    pub x45_u_mm: Option<f64>,
    #[serde(default = "plus_45")]
    pub b45_deg: f64,
    pub c_deg: Option<f64>,
    pub b_zero_u_deg: Option<f64>,
    #[serde(default)]
    pub b_position_u_deg: f64,
    pub nozzle_rim_radius_mm: Option<f64>,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadEntry {
    #[serde(default)]
    pub standoff_mm: f64,
    #[serde(default)]
    pub standoff_u_mm: f64,
}

/// What the control holds now.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Control {
    pub machine: Option<PathBuf>,
    pub delta_x_mm: Option<f64>,
    pub r_mm: Option<f64>,
    pub xc_mm: Option<f64>,
    pub yc_mm: Option<f64>,
    pub zc_mm: Option<f64>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged)]
pub enum OneOrTwo {
    One(f64),
    Two([f64; 2]),
}

impl OneOrTwo {
    pub fn pair(self) -> [f64; 2] {
        match self {
            Self::One(v) => [v, v],
            Self::Two(pair) => pair,
        }
    }
}

fn plus_one() -> i32 {
    1
}
fn plus_90() -> f64 {
    90.0
}
fn minus_90() -> f64 {
    -90.0
}
fn plus_45() -> f64 {
    45.0
}
fn hundredth() -> f64 {
    0.01
}
fn ring_height() -> f64 {
    50.0
}
fn spot_height() -> f64 {
    3.0
}
fn micrometre() -> f64 {
    0.001
}
