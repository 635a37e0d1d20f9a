//! Where in the frame a lens calibration has seen the target, and how well the points fit.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::Vector2;

use super::CIRCLES;
use super::canvas::Canvas;
use crate::calib::lens::{CELLS, Calibrated};
use crate::error::{Error, Result};

/// Width of the picture, about.
const WIDTH_PX: f64 = 1200.0;

/// The coverage as PNG: a dot for every point in its view's colour, its residual as a stroke, empty cells shaded.
pub fn coverage(made: &Calibrated) -> Result<Vec<u8>> {
    let r = &made.report;
    let zoom = WIDTH_PX / f64::from(r.width_px);
    let (w, h) = (WIDTH_PX as usize, (f64::from(r.height_px) * zoom) as usize);
    let mut canvas = Canvas::new(w, h + 60, [24, 26, 30]);
    let at = |p: Vector2<f64>| (p + Vector2::repeat(0.5)) * zoom;
    let cell = Vector2::new(w as f64 / CELLS.0 as f64, h as f64 / CELLS.1 as f64);
    for row in 0..CELLS.1 {
        for col in 0..CELLS.0 {
            let low = cell.component_mul(&Vector2::new(col as f64, row as f64));
            let here = |p: Vector2<f64>| {
                p.x >= low.x && p.y >= low.y && p.x < low.x + cell.x && p.y < low.y + cell.y
            };
            let empty = !made.seen.iter().any(|s| here(at(s.pixel)));
            let colour = if empty { [110, 45, 45] } else { [38, 42, 48] };
            let inner = low + cell - Vector2::repeat(2.0);
            canvas.fill(
                [low.x as usize, low.y as usize],
                [inner.x as usize, inner.y as usize],
                colour,
                1.0,
            );
        }
    }
    // A typical residual is drawn a tenth of a cell long.
    let factor = (0.1 * cell.x / (r.rms_px * zoom).max(1e-6)).min(1e4);
    let factor = 10f64.powf(factor.log10().floor()).max(1.0);
    for s in &made.seen {
        let colour = CIRCLES[s.view % CIRCLES.len()];
        let p = at(s.pixel);
        canvas.line(p, p + s.residual_px * zoom * factor, 1.4, colour);
        canvas.dot(p, 2.2, colour);
    }
    let used = r.views.iter().filter(|v| v.used).count();
    let words = [
        format!(
            "{used} of {} views, {} points, {:.0} % of the frame covered, rms {:.3} px",
            r.views.len(),
            made.seen.len(),
            100.0 * r.coverage,
            r.rms_px
        ),
        format!("strokes: residuals x {factor:.0}   red: nothing seen here"),
    ];
    for (i, line) in words.iter().enumerate() {
        canvas.text(10, h + 12 + 22 * i, 2, line, [232, 232, 232]);
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&canvas.data, w as u32, canvas.height as u32, ExtendedColorType::Rgb8)
        .map_err(|e| {
            Error::measure("coverage", format!("cannot be encoded ({e})"), "report this")
        })?;
    Ok(bytes)
}
