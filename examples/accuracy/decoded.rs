//! A rendered rod's captures as they are after writing and reading their files.

use nalgebra::Vector2;
use pivotsight::camera::View;
use pivotsight::error::Result;
use pivotsight::frame::{Channel, Frame, Picture};
use pivotsight::measure::rod::Capture;
use pivotsight::render::rod::RenderedRod;

/// A picture and how the camera sees the plane in it.
pub type Shown = (Frame, View);

/// The captures and what each shows.
pub fn captures(made: &RenderedRod) -> Result<(Vec<Capture>, Vec<Shown>)> {
    let each = made.captures.iter().enumerate().map(|(i, capture)| {
        let picture = Picture::decode("rendered", &capture.picture.png()?)?;
        let (width, height) = picture.size();
        let view = made.camera.calibration.view(width, height)?;
        let place_mm = Vector2::from(capture.machine_mm);
        let shown = Capture::in_memory(format!("capture {i}"), place_mm, capture.c_deg);
        Ok((shown, (picture.into_frame(Channel::Luminance), view)))
    });
    each.collect::<Result<Vec<_>>>().map(|list| list.into_iter().unzip())
}
