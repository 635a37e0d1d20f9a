//! Antialiased strokes and letters on an RGB picture.

use font8x8::{BASIC_FONTS, LATIN_FONTS, UnicodeFonts};
use nalgebra::Vector2;

/// A colour.
pub type Rgb = [u8; 3];

/// An RGB picture to draw on. Coordinates are its own pixels, centres at whole numbers.
#[derive(Debug, Clone)]
pub struct Canvas {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue, row by row.
    pub data: Vec<u8>,
}

impl Canvas {
    /// A canvas of one colour.
    pub fn new(width: usize, height: usize, colour: Rgb) -> Self {
        Self { width, height, data: colour.repeat(width * height) }
    }

    /// Lays `colour` over a pixel with opacity `alpha`; outside the canvas nothing happens.
    pub fn blend(&mut self, x: i64, y: i64, colour: Rgb, alpha: f64) {
        if x < 0 || y < 0 || x >= self.width as i64 || y >= self.height as i64 {
            return;
        }
        let at = 3 * (y as usize * self.width + x as usize);
        for (old, new) in self.data[at..at + 3].iter_mut().zip(colour) {
            *old = (f64::from(*old) * (1.0 - alpha) + f64::from(new) * alpha).round() as u8;
        }
    }

    /// A straight stroke with round ends.
    pub fn line(&mut self, a: Vector2<f64>, b: Vector2<f64>, width: f64, colour: Rgb) {
        let half = 0.5 * width;
        let reach = Vector2::repeat(half + 1.0);
        let size = Vector2::new(self.width as f64, self.height as f64);
        let low = (a.inf(&b) - reach).sup(&Vector2::zeros());
        let high = (a.sup(&b) + reach).inf(&size);
        if !(low.x <= high.x && low.y <= high.y) {
            return;
        }
        let along = b - a;
        let squared = along.norm_squared();
        for y in low.y as i64..=high.y as i64 {
            for x in low.x as i64..=high.x as i64 {
                let p = Vector2::new(x as f64, y as f64) - a;
                let t = if squared > 0.0 { (p.dot(&along) / squared).clamp(0.0, 1.0) } else { 0.0 };
                let cover = (half + 0.5 - (p - along * t).norm()).clamp(0.0, 1.0);
                if cover > 0.0 {
                    self.blend(x, y, colour, cover);
                }
            }
        }
    }

    /// A filled dot.
    pub fn dot(&mut self, at: Vector2<f64>, radius: f64, colour: Rgb) {
        self.line(at, at, 2.0 * radius, colour);
    }

    /// An arrow with its head at `to`.
    pub fn arrow(&mut self, from: Vector2<f64>, to: Vector2<f64>, width: f64, colour: Rgb) {
        self.line(from, to, width, colour);
        let Some(back) = (from - to).try_normalize(1e-9) else { return };
        let side = Vector2::new(-back.y, back.x);
        let length = (5.0 * width).min(0.6 * (from - to).norm());
        for s in [1.0, -1.0] {
            self.line(to, to + (back + side * (0.55 * s)) * length, width, colour);
        }
    }

    /// A filled rectangle of opacity `alpha`.
    pub fn fill(&mut self, low: [usize; 2], high: [usize; 2], colour: Rgb, alpha: f64) {
        for y in low[1]..high[1].min(self.height) {
            for x in low[0]..high[0].min(self.width) {
                self.blend(x as i64, y as i64, colour, alpha);
            }
        }
    }

    /// Text with its top left corner at `(x, y)`, letters 8·`scale` pixels wide and high.
    pub fn text(&mut self, x: usize, y: usize, scale: usize, text: &str, colour: Rgb) {
        for (i, letter) in text.chars().enumerate() {
            let Some(rows) = BASIC_FONTS.get(letter).or_else(|| LATIN_FONTS.get(letter)) else {
                continue;
            };
            for (r, bits) in rows.iter().enumerate() {
                for c in (0..8).filter(|c| bits >> c & 1 == 1) {
                    let (left, top) = (x + (8 * i + c) * scale, y + r * scale);
                    self.fill([left, top], [left + scale, top + scale], colour, 1.0);
                }
            }
        }
    }
}
