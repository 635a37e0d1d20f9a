//! An overlay picture: the frame dimmed, marks in its pixels, and a panel of text below it.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::Vector2;

use super::canvas::{Canvas, Rgb};
use crate::camera::View;
use crate::error::{Error, Result};
use crate::fit::Circle;
use crate::frame::{Frame, Gray};

/// Edge points the fit rests on.
pub const USED: Rgb = [60, 220, 90];
/// Edge points that were rejected.
pub const REJECTED: Rgb = [255, 60, 60];
/// Letters.
const INK: Rgb = [232, 232, 232];
/// Letters that matter less.
const FAINT: Rgb = [160, 160, 160];
/// The panel.
const PANEL: Rgb = [24, 26, 30];
/// Widest overlay of a frame, px.
const WIDEST: usize = 2400;
/// Narrowest overlay of a frame, px.
const NARROWEST: usize = 1000;

/// Free space round the panel's text, in pixels of its letters.
const PAD: usize = 8;

/// A line of the panel and its colour.
#[derive(Debug, Clone)]
pub struct Line(pub String, pub Rgb);

impl Line {
    /// A line in plain ink.
    pub fn plain(text: impl Into<String>) -> Self {
        Self(text.into(), INK)
    }

    /// A line in faint ink.
    pub fn faint(text: impl Into<String>) -> Self {
        Self(text.into(), FAINT)
    }
}

/// The overlay while it is drawn.
pub struct Sheet<'a> {
    canvas: Canvas,
    view: &'a View,
    /// Canvas pixels a frame pixel.
    zoom: f64,
    /// Stroke width.
    pub stroke: f64,
    frame_height: usize,
}

impl<'a> Sheet<'a> {
    /// A dimmed copy of the frame, its own range of brightness stretched; small frames enlarged, large ones reduced.
    pub fn new(frame: &Frame, view: &'a View) -> Self {
        let (reduce, enlarge) =
            (frame.width().div_ceil(WIDEST).max(1), NARROWEST.div_ceil(frame.width()).max(1));
        let gray: Gray<f32> = frame.reduce(reduce);
        let (width, height) = (gray.width * enlarge, gray.height * enlarge);
        let (dark, bright) = range(&gray.data);
        let mut canvas = Canvas::new(width, height, [0; 3]);
        for (i, pixel) in canvas.data.chunks_exact_mut(3).enumerate() {
            let (x, y) = (i % width / enlarge, i / width / enlarge);
            let t = ((gray.data[y * gray.width + x] - dark) / (bright - dark)).clamp(0.0, 1.0);
            pixel.fill((12.0 + 150.0 * t) as u8);
        }
        let zoom = enlarge as f64 / reduce as f64;
        let stroke = (width as f64 / 800.0).clamp(1.3, 3.0);
        Self { canvas, view, zoom, stroke, frame_height: height }
    }

    /// Frame pixel → canvas pixel: both count from the middle of their first pixel.
    pub fn at(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        (pixel + Vector2::repeat(0.5)) * self.zoom - Vector2::repeat(0.5)
    }

    /// A place of the plane on the canvas.
    pub fn at_mm(&self, place_mm: Vector2<f64>) -> Vector2<f64> {
        self.at(self.view.to_pixel(place_mm))
    }

    /// Edge points, the rejected ones last so that they are seen.
    pub fn points(&mut self, points: impl Iterator<Item = (Vector2<f64>, bool)> + Clone) {
        for wanted in [true, false] {
            let colour = if wanted { USED } else { REJECTED };
            for (pixel, _) in points.clone().filter(|(_, used)| *used == wanted) {
                self.canvas.dot(self.at(pixel), 0.9 * self.stroke, colour);
            }
        }
    }

    /// A circle of the plane as the camera sees it.
    pub fn circle(&mut self, circle: Circle, colour: Rgb) {
        const SIDES: usize = 360;
        let place = |i: usize| {
            let (sin, cos) = (i as f64 / SIDES as f64 * std::f64::consts::TAU).sin_cos();
            circle.center + Vector2::new(cos, sin) * circle.radius
        };
        for i in 0..SIDES {
            let (a, b) = (self.at_mm(place(i)), self.at_mm(place(i + 1)));
            self.canvas.line(a, b, 0.6 * self.stroke, colour);
        }
    }

    /// A cross at a place of the plane, its arms along the plane's axes.
    pub fn cross(&mut self, place_mm: Vector2<f64>, arm_px: f64, colour: Rgb) {
        let middle = self.at_mm(place_mm);
        let step = self.view.pixel_mm();
        for axis in [Vector2::x(), Vector2::y()] {
            let Some(way) = (self.at_mm(place_mm + axis * step) - middle).try_normalize(1e-9)
            else {
                continue;
            };
            let arm = way * arm_px * self.stroke;
            self.canvas.line(middle - arm, middle + arm, 0.8 * self.stroke, colour);
        }
    }

    /// An arrow along an offset in the plane, enlarged by a round factor to about `reach_px` canvas pixels. Gives the factor.
    pub fn offset(
        &mut self,
        from_mm: Vector2<f64>,
        offset_mm: Vector2<f64>,
        reach_px: f64,
        colour: Rgb,
    ) -> f64 {
        let start = self.at_mm(from_mm);
        let true_length = (self.at_mm(from_mm + offset_mm) - start).norm();
        let factor = round_down(reach_px / true_length.max(1e-9)).clamp(1.0, 1e4);
        let end = self.at_mm(from_mm + offset_mm * factor);
        self.canvas.arrow(start, end, 1.6 * self.stroke, colour);
        factor
    }

    /// A bar of a round number of mm at the frame's lower left, with the plane's axes above it.
    pub fn scale_bar(&mut self) {
        let scale = self.letters();
        let px_per_mm = self.zoom / self.view.pixel_mm();
        let length_mm = round_down(0.22 * self.canvas.width as f64 / px_per_mm);
        let length = length_mm * px_per_mm;
        let margin = 3.0 * 8.0 * scale as f64 / 2.0;
        let y = self.frame_height as f64 - margin;
        let start = Vector2::new(margin, y);
        let end = Vector2::new(margin + length, y);
        let thick = 1.6 * self.stroke;
        self.canvas.line(start, end, thick, INK);
        for p in [start, end] {
            let tick = Vector2::new(0.0, 4.0 * self.stroke);
            self.canvas.line(p - tick, p + tick, thick, INK);
        }
        let top = y as usize - 12 * scale - (4.0 * self.stroke) as usize;
        self.canvas.text(margin as usize, top, scale, &format!("{length_mm} mm"), INK);
        self.axes(Vector2::new(margin + 4.0 * self.stroke, top as f64 - margin), scale);
    }

    /// Where machine X and Y point in the picture.
    fn axes(&mut self, corner: Vector2<f64>, scale: usize) {
        let middle = Vector2::new(self.view.width_px() as f64, self.view.height_px() as f64) / 2.0;
        let place = self.view.to_plane(middle);
        let step = 10.0 * self.view.pixel_mm();
        let arm = 40.0 * self.stroke;
        let ways: Vec<(Vector2<f64>, &str)> = [(Vector2::x(), "X"), (Vector2::y(), "Y")]
            .into_iter()
            .filter_map(|(axis, name)| {
                let way = self.at_mm(place + axis * step) - self.at_mm(place);
                Some((way.try_normalize(1e-9)? * arm, name))
            })
            .collect();
        // Into the frame, whichever way the axes point.
        let low = ways.iter().fold(Vector2::zeros(), |m: Vector2<f64>, (w, _)| m.inf(w));
        let high = ways.iter().fold(Vector2::zeros(), |m: Vector2<f64>, (w, _)| m.sup(w));
        let origin = corner - Vector2::new(low.x, high.y);
        for (way, name) in ways {
            self.canvas.arrow(origin, origin + way, self.stroke, INK);
            let letter = origin + way * 1.3 - Vector2::repeat(4.0 * scale as f64);
            self.canvas.text(
                letter.x.max(0.0) as usize,
                letter.y.max(0.0) as usize,
                scale,
                name,
                INK,
            );
        }
    }

    /// Size of the letters.
    fn letters(&self) -> usize {
        (self.canvas.width / 800).clamp(1, 3)
    }

    /// Words in as many lines of the panel as they take.
    pub fn wrapped(&self, words: &str) -> Vec<Line> {
        let scale = self.letters();
        let most = (self.canvas.width - 2 * PAD * scale) / (8 * scale);
        let mut lines: Vec<String> = Vec::new();
        for word in words.split_whitespace() {
            match lines.last_mut() {
                Some(line) if line.chars().count() + 1 + word.chars().count() <= most => {
                    line.push(' ');
                    line.push_str(word);
                }
                _ => lines.push(word.to_owned()),
            }
        }
        lines.into_iter().map(Line::plain).collect()
    }

    /// Appends the panel: a headline, then the lines. Gives the picture as PNG.
    pub fn finish(mut self, headline: &Line, lines: &[Line]) -> Result<Vec<u8>> {
        let scale = self.letters();
        let (pad, row) = (PAD * scale, 13 * scale);
        let top = self.canvas.height;
        let panel = 2 * pad + 2 * row + lines.len() * row;
        self.canvas.height += panel;
        self.canvas.data.extend(PANEL.repeat(self.canvas.width * panel));
        // Twice the size of the rest, where that fits.
        let width = 8 * headline.0.chars().count() * 2 * scale + 2 * pad;
        let large = if width <= self.canvas.width { 2 * scale } else { scale };
        self.canvas.text(pad, top + pad, large, &headline.0, headline.1);
        for (i, Line(text, colour)) in lines.iter().enumerate() {
            self.canvas.text(pad, top + pad + (2 + i) * row, scale, text, *colour);
        }
        let mut bytes = Vec::new();
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
            .write_image(
                &self.canvas.data,
                self.canvas.width as u32,
                self.canvas.height as u32,
                ExtendedColorType::Rgb8,
            )
            .map_err(|e| {
                Error::measure("overlay", format!("cannot be encoded ({e})"), "report this")
            })?;
        Ok(bytes)
    }
}

/// The frame's range of brightness without its extreme pixels.
fn range(data: &[f32]) -> (f32, f32) {
    let mut some: Vec<f32> = data.iter().step_by((data.len() / 20_000).max(1)).copied().collect();
    some.sort_by(f32::total_cmp);
    let at = |share: f64| some.get((share * some.len() as f64) as usize).copied().unwrap_or(0.0);
    let (low, high) = (at(0.002), at(0.995));
    (low, high.max(low + 1.0))
}

/// The largest of 1, 2, 5 times a power of ten that is not above `value`.
fn round_down(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return 1.0;
    }
    let power = 10f64.powf(value.log10().floor());
    [5.0, 2.0, 1.0].iter().map(|m| m * power).find(|v| *v <= value * (1.0 + 1e-9)).unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_numbers_are_1_2_5() {
        for (value, round) in [(0.9, 0.5), (1.0, 1.0), (47.0, 20.0), (0.0031, 0.002), (7e3, 5e3)] {
            assert!(
                (round_down(value) / round - 1.0).abs() < 1e-9,
                "{value}: {}",
                round_down(value)
            );
        }
        assert_eq!(round_down(f64::NAN), 1.0);
    }
}
