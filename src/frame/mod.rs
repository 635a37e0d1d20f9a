//! Picture files → gray frames: decoding, choice of channel, reduced pictures.

mod decode;
mod gray;
mod grays;
pub mod jpeg;
pub mod named;

pub use decode::{Channel, Picture};
pub use gray::{Frame, Gray, MOST_JOINED, Pixel, Sample};
