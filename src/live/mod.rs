//! Live pictures: a camera, a video file, a folder of pictures or an MJPEG stream; guiding an operator by them, and storing
//! captures with the machine's position.

pub mod average;
pub mod center;
mod feed;
mod jpeg;
mod mjpeg;
mod source;
pub mod store;
mod track;

pub use feed::{Event, Feed, Stats};
pub use source::{Shot, files};
