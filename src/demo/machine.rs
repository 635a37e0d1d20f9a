//! The demo's virtual machine: it knows its own errors, burns, takes pictures and reads contacts. What
//! measures it sees pictures, machine coordinates and readings, nothing else.

use nalgebra::Vector2;
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::error::Result;
use crate::render::burn::{self, Beam, Machine as BurnMachine, RenderedBurn};
use crate::render::rod::{self, RenderedRod};
use crate::render::{BurnScene, Preset, RodScene, stream_rng};

/// Height of the nozzle over the plate for the ring and for the spot.
pub const BURN_HEIGHTS_MM: [f64; 2] = [50.0, 3.0];
/// Radius of the nozzle's rim.
pub const NOZZLE_RIM_MM: f64 = 2.5;
/// Standard deviation of one contact reading.
pub const CONTACT_U_MM: f64 = 0.001;
/// C angles at which the rod is photographed; contacts are made at the first.
pub const C_ANGLES_DEG: [f64; 3] = [0.0, 120.0, 240.0];
/// C angles for a diagnosis: irregular, so that no harmonic repeats on them.
const MANY_C_ANGLES_DEG: [f64; 9] = [0.0, 43.0, 77.0, 121.0, 160.0, 203.0, 248.0, 281.0, 322.0];

/// What is true of the machine.
#[derive(Debug, Clone)]
pub struct VirtualMachine {
    /// How its head leans: B's zero and the flange.
    pub beam: Beam,
    /// From the B axis to the optical axis, along X.
    pub delta_x_mm: f64,
    /// From the B axis to the nozzle's end face.
    pub r_mm: f64,
    /// The C axis at the table's surface, in machine coordinates.
    pub axis_mm: [f64; 3],
    /// The check rod's diameter.
    pub rod_diameter_mm: f64,
    /// How far the rod sits beside the C axis, and in which direction at C = 0.
    pub eccentricity: (f64, f64),
    rng: ChaCha8Rng,
    seed: u64,
}

impl VirtualMachine {
    /// A machine with errors that `seed` draws.
    pub fn new(seed: u64) -> Self {
        let mut rng = stream_rng(seed, 77);
        let mut signed = |low: f64, high: f64| {
            let size = rng.random_range(low..high);
            if rng.random::<bool>() { -size } else { size }
        };
        let beam = Beam { b_error_deg: signed(0.03, 0.08), flange_tilt_deg: signed(0.02, 0.06) };
        let delta_x_mm = signed(0.1, 0.5);
        let r_mm = 214.0 + signed(0.2, 1.0);
        let axis_mm = [
            rng.random_range(300.0..320.0),
            rng.random_range(180.0..200.0),
            rng.random_range(-402.0..-398.0),
        ];
        let rod_diameter_mm = rng.random_range(15.995..16.005);
        let eccentricity =
            (rng.random_range(0.01..0.04), rng.random_range(0.0..std::f64::consts::TAU));
        Self { beam, delta_x_mm, r_mm, axis_mm, rod_diameter_mm, eccentricity, rng, seed }
    }

    /// Burns ring and spot on a plate and photographs them.
    pub fn burn_test(&self, number: u64) -> Result<RenderedBurn> {
        let mut scene = BurnScene::preset(Preset::Typical)?;
        scene.machine = Some(BurnMachine {
            b_error_deg: self.beam.b_error_deg.into(),
            flange_tilt_deg: self.beam.flange_tilt_deg.into(),
            ring_height_mm: BURN_HEIGHTS_MM[0].into(),
            spot_height_mm: BURN_HEIGHTS_MM[1].into(),
        });
        let camera = scene.draw_camera(self.seed)?;
        burn::render_with(&scene, &camera, self.seed.wrapping_mul(1000).wrapping_add(number))
    }

    /// The operator turns B's zero and shims the flange.
    pub fn correct(&mut self, b_deg: f64, shim_deg: f64) {
        self.beam.b_error_deg += b_deg;
        self.beam.flange_tilt_deg += shim_deg;
    }

    /// Photographs the check rod's rim, four times at each C angle.
    pub fn photograph_rod(&self) -> Result<RenderedRod> {
        rod::render(&self.rod_scene()?, self.seed)
    }

    /// The rod as it stands on the machine.
    fn rod_scene(&self) -> Result<RodScene> {
        let mut scene = RodScene::preset(Preset::Typical)?;
        scene.camera = scene.camera.binned(2);
        scene.rod.chamfer_mm = 0.3.into();
        scene.rod.diameter_mm = self.rod_diameter_mm.into();
        scene.axis.center_mm = [self.axis_mm[0].into(), self.axis_mm[1].into()];
        scene.axis.eccentricity_mm = self.eccentricity.0.into();
        scene.axis.eccentricity_deg = self.eccentricity.1.to_degrees().into();
        scene.captures.c_deg = C_ANGLES_DEG.to_vec();
        scene.captures.per_angle = 4.0.into();
        scene.captures.position_noise_mm = 0.0003.into();
        Ok(scene)
    }

    /// Photographs the check rod, set up true on the C axis, at many C angles in random order.
    pub fn photograph_many(&self) -> Result<RenderedRod> {
        let mut scene = self.rod_scene()?;
        scene.axis.eccentricity_mm = 0.0.into();
        // A polished master before a plain background: form and texture would be found, and called unknown beside the effect.
        scene.rod.form_rms_mm = 0.0.into();
        scene.surface.texture = 0.0.into();
        scene.rod.table_mottle = 0.0.into();
        scene.captures.c_deg = MANY_C_ANGLES_DEG.to_vec();
        let mut rendered = rod::render(&scene, self.seed)?;
        rendered.captures.shuffle(&mut stream_rng(self.seed, 79));
        Ok(rendered)
    }

    /// Machine X at which the nozzle, told to stand at `b_deg`, touches the rod; the rod stands at
    /// C = 0. The face's middle is at `X - ΔX + ΔX cos B - R sin B`; its rim reaches further.
    pub fn touch_rod(&mut self, b_deg: f64) -> f64 {
        let (sin, cos) = (b_deg + self.beam.b_error_deg).to_radians().sin_cos();
        let rod = self.axis_mm[0] + self.eccentricity.0 * self.eccentricity.1.cos();
        let side = sin.signum();
        let contact = rod + side * (self.rod_diameter_mm / 2.0 + NOZZLE_RIM_MM * cos.abs());
        contact + self.delta_x_mm * (1.0 - cos) + self.r_mm * sin + self.contact_noise()
    }

    /// Machine Z at which the nozzle at B = 0 touches the table.
    pub fn touch_table(&mut self) -> f64 {
        let (sin, cos) = self.beam.b_error_deg.to_radians().sin_cos();
        // The face's middle hangs R cos B + ΔX sin B below the B axis instead of R; its rim lower still.
        let hangs = self.r_mm * cos + self.delta_x_mm * sin + NOZZLE_RIM_MM * sin.abs();
        self.axis_mm[2] + hangs - self.r_mm + self.contact_noise()
    }

    /// Where the tool point goes wrong, in X and Z, when B turns to `b_deg` under a control that
    /// believes ΔX and R to be these.
    pub fn rtcp_error_mm(&self, control_delta_x_mm: f64, control_r_mm: f64, b_deg: f64) -> f64 {
        let moved = |delta_x: f64, r: f64, b_deg: f64| {
            let (sin, cos) = b_deg.to_radians().sin_cos();
            Vector2::new(delta_x * (cos - 1.0) - r * sin, -delta_x * sin - r * (cos - 1.0))
        };
        (moved(self.delta_x_mm, self.r_mm, b_deg) - moved(control_delta_x_mm, control_r_mm, b_deg))
            .norm()
    }

    fn contact_noise(&mut self) -> f64 {
        let normal: f64 = StandardNormal.sample(&mut self.rng);
        CONTACT_U_MM * normal
    }
}
