//! Calibrating: the measuring plane and the laser with the machine as the ruler, targets and lenses, and whether a
//! calibration still holds.

mod board_view;
mod bundle;
pub mod check;
mod homography;
pub mod laser;
pub mod lens;
mod lens_doubts;
pub mod mark;
pub mod plane;
pub mod register;
pub mod target;
mod unseen_lens;
