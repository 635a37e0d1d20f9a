//! What may be seen in a picture of a burn: the scene file and the scenes that come with the program.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::beam::Machine;
use super::camera::{Camera, Optics, Sensor};
use super::draw::{Dice, Draw};
use super::mark::Profile;
use super::scene::{self, AsScene, Preset};
use super::surface::{Light, Specks, Surface};
use crate::error::Result;

/// A burn's scene file: every number fixed or drawn ([`Draw`]).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BurnScene {
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
    /// Bare metal.
    #[serde(default)]
    pub surface: Surface,
    /// The ring.
    #[serde(default)]
    pub ring: Ring,
    /// The spot.
    #[serde(default)]
    pub spot: Spot,
    /// Spatter around the ring.
    #[serde(default)]
    pub spatter: Specks,
    /// The machine that burnt both; it then places the spot.
    pub machine: Option<Machine>,
}

/// `[ring]`: the mark burnt from high up, its outer edge being what is measured.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ring {
    /// Its centre in the plane (default within ±0.4).
    pub center_mm: [Draw; 2],
    /// Nominal outer radius (default 2.2 to 3.4).
    pub radius_mm: Draw,
    /// Inner over outer radius; 0 is a disc (default 0 or 0.62).
    pub inner_ratio: Draw,
    /// Radiance of the burnt metal (default 0.22).
    pub level: Draw,
    /// Relative unevenness of the burnt metal, in blotches of 0.1 mm (default 0).
    pub mottle: Draw,
    /// Width over which the edge fades from 90 % to 10 % (default 0.03).
    pub softness_mm: Draw,
    /// How it fades: "gaussian" (default), "logistic", "ramp".
    pub profile: Profile,
    /// Standard deviation of the contour about its nominal circle (default 0).
    pub ragged_rms_mm: Draw,
    /// Correlation length of that along the contour (default 0.2).
    pub ragged_length_mm: Draw,
    /// Relative unevenness of the burn's depth around the ring (default 0).
    pub uneven: Draw,
    /// Number of arcs that are missing (default 0).
    pub missing_arcs: Draw,
    /// Length of a missing arc (default 20 to 60).
    pub missing_deg: Draw,
    /// Strength of the heat tint at the edge, relative to the metal (default 0).
    pub halo: Draw,
    /// Distance over which the tint falls to 37 % (default 0.4).
    pub halo_mm: Draw,
}

impl Default for Ring {
    fn default() -> Self {
        Self {
            center_mm: [[-0.4, 0.4].into(), [-0.4, 0.4].into()],
            radius_mm: [2.2, 3.4].into(),
            inner_ratio: Draw::Any { any: vec![0.0, 0.62] },
            level: 0.22.into(),
            mottle: 0.0.into(),
            softness_mm: 0.03.into(),
            profile: Profile::Gaussian,
            ragged_rms_mm: 0.0.into(),
            ragged_length_mm: 0.2.into(),
            uneven: 0.0.into(),
            missing_arcs: 0.0.into(),
            missing_deg: [20.0, 60.0].into(),
            halo: 0.0.into(),
            halo_mm: 0.4.into(),
        }
    }
}

/// `[spot]`: the mark burnt from close by.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spot {
    /// Spot minus ring (default within ±0.05, or as `[machine]` says).
    pub offset_mm: Option<[Draw; 2]>,
    /// Nominal radius (default 0.3 to 0.6).
    pub radius_mm: Draw,
    /// Radiance (default 0.05 or 0.9).
    pub level: Draw,
    /// Width over which the edge fades from 90 % to 10 % (default 0.03).
    pub softness_mm: Draw,
    /// How it fades.
    pub profile: Profile,
    /// Standard deviation of the contour about its nominal circle (default 0).
    pub ragged_rms_mm: Draw,
    /// Correlation length of that along the contour (default 0.15).
    pub ragged_length_mm: Draw,
}

impl Default for Spot {
    fn default() -> Self {
        Self {
            offset_mm: None,
            radius_mm: [0.3, 0.6].into(),
            level: Draw::Any { any: vec![0.05, 0.9] },
            softness_mm: 0.03.into(),
            profile: Profile::Gaussian,
            ragged_rms_mm: 0.0.into(),
            ragged_length_mm: 0.15.into(),
        }
    }
}

impl AsScene for BurnScene {
    const KIND: &'static str = "burn";
    fn header(&self) -> (u32, &str) {
        (self.schema, &self.kind)
    }
    fn origin_mut(&mut self) -> &mut PathBuf {
        &mut self.origin
    }
}

impl BurnScene {
    /// Reads a scene file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        scene::read(path.as_ref())
    }

    /// A scene that comes with the program (`src/render/presets/burn-*.toml`).
    pub fn preset(preset: Preset) -> Result<Self> {
        let texts = [
            include_str!("presets/burn-clean.toml"),
            include_str!("presets/burn-typical.toml"),
            include_str!("presets/burn-hard.toml"),
        ];
        scene::preset(preset, texts)
    }

    /// The camera that this seed draws.
    pub fn draw_camera(&self, seed: u64) -> Result<Camera> {
        self.camera.draw(&mut Dice::new(&self.origin, seed, 0))
    }
}
