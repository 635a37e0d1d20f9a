//! What may be seen in captures of a check rod: the scene file and the scenes that come with the program.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::camera::{Camera, Optics, Sensor};
use super::draw::{Dice, Draw};
use super::plan::Captures;
use super::scene::{self, AsScene, Preset};
use super::surface::{Light, Specks, Surface};
use crate::error::Result;

/// A rod's scene file: every number fixed or drawn ([`Draw`]).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RodScene {
    schema: u32,
    kind: String,
    #[serde(skip)]
    pub(super) origin: PathBuf,
    /// Optics and geometry.
    #[serde(default)]
    pub camera: Optics,
    /// From light to numbers.
    #[serde(default)]
    pub sensor: Sensor,
    /// How the scene is lit.
    #[serde(default)]
    pub light: Light,
    /// The end face's metal.
    #[serde(default)]
    pub surface: Surface,
    /// The rod.
    #[serde(default)]
    pub rod: Rod,
    /// Where the C axis is and how the rod sits on it.
    #[serde(default)]
    pub axis: Axis,
    /// What is photographed.
    #[serde(default)]
    pub captures: Captures,
    /// Dirt in each capture, half of it on the rim.
    #[serde(default)]
    pub dirt: Specks,
}

/// `[rod]`: the rod and the table behind it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rod {
    /// Nominal diameter of the rod, the outer edge (default 12 to 25).
    pub diameter_mm: Draw,
    /// Width of the chamfer, 0 for none (default 0.3).
    pub chamfer_mm: Draw,
    /// Radiance of the chamfer where the light falls on it (default 0.95).
    pub chamfer_lit: Draw,
    /// Radiance of the chamfer on the far side from the light (default 0.12).
    pub chamfer_dark: Draw,
    /// Radiance of the table (default 0.15; above the face's for a lit table).
    pub table: Draw,
    /// Relative unevenness of the table (default 0).
    pub table_mottle: Draw,
    /// Direction the light comes from, from X towards Y (default any).
    pub light_deg: Draw,
    /// How much of the table's light the rod's shadow takes (default 0.5).
    pub shadow: Draw,
    /// Length of the shadow (default 0.6).
    pub shadow_mm: Draw,
    /// Width over which both edges fade from 90 % to 10 %, before the optics (default 0.005).
    pub softness_mm: Draw,
    /// Standard deviation of the rod's form about its nominal circle (default 0).
    pub form_rms_mm: Draw,
    /// Correlation length of that along the rim (default 2).
    pub form_length_mm: Draw,
    /// Whether the end face is turned (lines around its centre) or ground (straight lines) (default true).
    pub turned: bool,
}

impl Default for Rod {
    fn default() -> Self {
        Self {
            diameter_mm: [12.0, 25.0].into(),
            chamfer_mm: 0.3.into(),
            chamfer_lit: 0.95.into(),
            chamfer_dark: 0.12.into(),
            table: 0.15.into(),
            table_mottle: 0.0.into(),
            light_deg: [0.0, 360.0].into(),
            shadow: 0.5.into(),
            shadow_mm: 0.6.into(),
            softness_mm: 0.005.into(),
            form_rms_mm: 0.0.into(),
            form_length_mm: 2.0.into(),
            turned: true,
        }
    }
}

/// `[axis]`: the C axis and the rod's seat.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Axis {
    /// The C axis in machine coordinates (default within ±50).
    pub center_mm: [Draw; 2],
    /// Distance of the rod's centre from the C axis (default 0).
    pub eccentricity_mm: Draw,
    /// Direction of that at C = 0 (default any).
    pub eccentricity_deg: Draw,
    /// +1: positive C turns the table counter-clockwise seen from above; -1: clockwise (default 1).
    pub c_sense: i8,
}

impl Default for Axis {
    fn default() -> Self {
        Self {
            center_mm: [[-50.0, 50.0].into(), [-50.0, 50.0].into()],
            eccentricity_mm: 0.0.into(),
            eccentricity_deg: [0.0, 360.0].into(),
            c_sense: 1,
        }
    }
}

impl AsScene for RodScene {
    const KIND: &'static str = "rod";
    fn header(&self) -> (u32, &str) {
        (self.schema, &self.kind)
    }
    fn origin_mut(&mut self) -> &mut PathBuf {
        &mut self.origin
    }
}

impl RodScene {
    /// Reads a scene file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        scene::read(path.as_ref())
    }

    /// A scene that comes with the program (`src/render/presets/rod-*.toml`).
    pub fn preset(preset: Preset) -> Result<Self> {
        let texts = [
            include_str!("presets/rod-clean.toml"),
            include_str!("presets/rod-typical.toml"),
            include_str!("presets/rod-hard.toml"),
        ];
        scene::preset(preset, texts)
    }

    /// The camera that this seed draws.
    pub fn draw_camera(&self, seed: u64) -> Result<Camera> {
        self.camera.draw(&mut Dice::new(&self.origin, seed, 0))
    }
}
