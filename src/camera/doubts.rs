//! What looks wrong about a calibration. It is told, and taken as it stands: only the user knows.

use crate::camera::{Calibration, Mapping, View};
use crate::units;

impl Calibration {
    /// A scale or plane that looks as if it were in another unit, or a plane seen as in a mirror where the file names none.
    pub fn doubts(&self) -> Vec<String> {
        match &self.mapping {
            &Mapping::Scale { mm_per_px, .. } => {
                units::pixel("the calibration's mm_per_px", mm_per_px).into_iter().collect()
            }
            Mapping::Pinhole { lens, mirrored, .. } => {
                let view =
                    View::new(&self.mapping, lens.width_px as usize, lens.height_px as usize);
                let size = units::pixel("a pixel, by the calibration's [plane],", view.pixel_mm());
                size.into_iter().chain(mirror_image(&view, *mirrored)).collect()
            }
        }
    }
}

/// A mirror image turns corrections the wrong way; it is most often a wrong sign.
fn mirror_image(view: &View, is_said: bool) -> Option<String> {
    (view.is_mirror_image() && !is_said).then(|| {
        "the calibration's [plane] maps the picture as in a mirror: correct a sign of its homography_mm, or write \
         mirrored = true below it if the camera looks through a mirror"
            .into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mirror image is doubted unless the file says that the camera looks through a mirror.
    #[test]
    fn a_mirror_that_no_file_names_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        let doubts = |down: f64, more: &str| {
            let text = format!(
                "schema = 1\n[camera]\nwidth_px = 1600\nheight_px = 1200\nfx_px = 3520.0\nfy_px = 3520.0\ncx_px = 799.5\n\
                 cy_px = 599.5\ndistortion = [0.1, 0.0, 0.0, 0.0, 0.0]\n[plane]\n\
                 homography_mm = [[35.0, 0.0, 0.0], [0.0, {down:?}, 0.0], [0.0, 0.0, 1.0]]\n{more}"
            );
            std::fs::write(&path, text).unwrap();
            Calibration::read(&path).unwrap().doubts()
        };
        assert!(doubts(-35.0, "").is_empty());
        assert!(doubts(35.0, "")[0].contains("mirrored = true"));
        assert!(doubts(35.0, "mirrored = true\n").is_empty());
    }
}
