//! Pictures with known truth, written from the physics of imaging: a scene in plane millimetres is
//! area-sampled through lens and tilt, blurred, lit, and read by a noisy sensor.
//!
//! This side is the rival of the measuring side: the two share the camera's geometry
//! ([`crate::camera`]) and nothing else. A scene file or a preset describes what may be seen, each
//! number fixed or drawn; a seed picks one picture out of it, the same on any number of threads.

mod beam;
pub mod burn;
mod burn_scene;
pub mod camera;
mod draw;
mod expose;
mod mark;
mod noise;
mod picture;
mod plan;
pub mod rod;
mod rod_scene;
mod scene;
pub mod series;
mod surface;
pub mod target;

pub use burn::BurnScene;
pub use draw::Draw;
pub(crate) use draw::stream_rng;
pub use picture::Picture;
pub use rod::RodScene;
pub use scene::Preset;
