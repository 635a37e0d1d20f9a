//! Calibration targets to print: what is on them, in mm, and where their points are.

mod aruco;
mod paper;

pub use paper::{Page, pdf, svg};

use std::str::FromStr;

use nalgebra::Vector2;

/// Side of a marker over the side of its square: the white border round it is one of the marker's modules wide.
pub const MARKER_SHARE: f64 = 0.75;
/// A dot's diameter over the distance of neighbouring dots.
const DOT_SHARE: f64 = 0.5;
/// Modules along a marker's side: 4 bits and the black border.
const MODULES: usize = 6;

/// What the target shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A chessboard with ArUco markers (`DICT_4X4_100`) in its white squares: may be seen in part.
    Charuco,
    /// A plain chessboard.
    Chessboard,
    /// Dots on a square grid.
    Dots,
}

impl Kind {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Charuco => "charuco",
            Self::Chessboard => "chessboard",
            Self::Dots => "dots",
        }
    }
}

/// A target: squares (or dots) across and down, and their distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// What it shows.
    pub kind: Kind,
    /// Squares or dots across.
    pub columns: usize,
    /// Squares or dots down.
    pub rows: usize,
    /// Side of a square, or distance of neighbouring dots.
    pub pitch_mm: f64,
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}x{}:{}", self.kind.word(), self.columns, self.rows, self.pitch_mm)
    }
}

impl FromStr for Target {
    type Err = String;

    /// Reads `kind:COLUMNSxROWS:PITCH_MM`.
    fn from_str(text: &str) -> Result<Self, String> {
        let form = || {
            format!(
                "'{text}' is no target: write KIND:COLUMNSxROWS:PITCH_MM, as charuco:11x7:15, chessboard:10x7:25 (squares, not inner corners) or dots:9x7:10"
            )
        };
        let mut parts = text.split(':');
        let (Some(kind), Some(size), Some(pitch), None) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(form());
        };
        let kind = [Kind::Charuco, Kind::Chessboard, Kind::Dots]
            .into_iter()
            .find(|k| k.word() == kind)
            .ok_or_else(form)?;
        let (columns, rows) = size.split_once('x').ok_or_else(form)?;
        let target = Self {
            kind,
            columns: columns.parse().map_err(|_| form())?,
            rows: rows.parse().map_err(|_| form())?,
            pitch_mm: pitch.parse().map_err(|_| form())?,
        };
        target.check()?;
        Ok(target)
    }
}

impl Target {
    fn check(&self) -> Result<(), String> {
        if !(3..=100).contains(&self.columns) || !(3..=100).contains(&self.rows) {
            return Err(format!("{self}: choose 3 to 100 columns and rows"));
        }
        if !(self.pitch_mm.is_finite() && (0.01..=1000.0).contains(&self.pitch_mm)) {
            return Err(format!("{self}: the pitch must be between 0.01 and 1000 mm"));
        }
        if self.kind == Kind::Charuco && self.rows.is_multiple_of(2) {
            return Err(format!(
                "{self}: choose an odd number of rows; with an even one OpenCV's versions disagree on the pattern"
            ));
        }
        if self.kind == Kind::Charuco && self.columns * self.rows / 2 > aruco::DICT_4X4_100.len() {
            return Err(format!(
                "{self}: has {} markers, the dictionary {}; choose fewer squares",
                self.columns * self.rows / 2,
                aruco::DICT_4X4_100.len()
            ));
        }
        Ok(())
    }

    /// Width and height of the pattern.
    pub fn size_mm(&self) -> Vector2<f64> {
        Vector2::new(self.columns as f64, self.rows as f64) * self.pitch_mm
    }

    /// Radius of the dots; 0 where there are none.
    pub fn dot_radius_mm(&self) -> f64 {
        if self.kind == Kind::Dots { 0.5 * DOT_SHARE * self.pitch_mm } else { 0.0 }
    }

    /// Points across and down that a detector finds: inner corners, or dots.
    pub fn grid(&self) -> (usize, usize) {
        match self.kind {
            Kind::Dots => (self.columns, self.rows),
            _ => (self.columns - 1, self.rows - 1),
        }
    }

    /// Where these points are, row by row from the top left; x right, y down, from the pattern's top left corner.
    pub fn points_mm(&self) -> Vec<Vector2<f64>> {
        let (across, down) = self.grid();
        let first = if self.kind == Kind::Dots { 0.5 } else { 1.0 };
        (0..down)
            .flat_map(|r| (0..across).map(move |c| Vector2::new(c as f64, r as f64)))
            .map(|p| (p + Vector2::repeat(first)) * self.pitch_mm)
            .collect()
    }

    /// What is printed, later shapes over earlier ones.
    pub fn shapes(&self) -> Vec<Shape> {
        let mut list = Vec::new();
        let mut markers = aruco::DICT_4X4_100.iter();
        let p = self.pitch_mm;
        for r in 0..self.rows {
            for c in 0..self.columns {
                let corner = Vector2::new(c as f64, r as f64) * p;
                match self.kind {
                    Kind::Dots => {
                        let center = corner + Vector2::repeat(0.5 * p);
                        list.push(Shape::Disc { center, radius: self.dot_radius_mm() });
                    }
                    _ if (r + c).is_multiple_of(2) => {
                        list.push(Shape::Box { corner, size: Vector2::repeat(p), ink: true });
                    }
                    Kind::Charuco => {
                        if let Some(bits) = markers.next() {
                            marker(&mut list, corner, p, *bits);
                        }
                    }
                    Kind::Chessboard => {}
                }
            }
        }
        list
    }
}

/// A black square with the marker's white modules on it: runs along rows, then along columns, so that no seam shows.
fn marker(list: &mut Vec<Shape>, square: Vector2<f64>, pitch: f64, bits: u16) {
    let side = MARKER_SHARE * pitch;
    let corner = square + Vector2::repeat(0.5 * (pitch - side));
    let module = side / MODULES as f64;
    list.push(Shape::Box { corner, size: Vector2::repeat(side), ink: true });
    for upright in [false, true] {
        let turned = |v: Vector2<f64>| if upright { v.yx() } else { v };
        for line in 0..4 {
            let white = |i: usize| {
                let (r, c) = if upright { (i, line) } else { (line, i) };
                bits >> (15 - 4 * r - c) & 1 == 1
            };
            let mut i = 0;
            while i < 4 {
                let run = (i..4).take_while(|&i| white(i)).count();
                if run > usize::from(upright) {
                    let at = turned(Vector2::new((i + 1) as f64, (line + 1) as f64)) * module;
                    let size = turned(Vector2::new(run as f64, 1.0)) * module;
                    list.push(Shape::Box { corner: corner + at, size, ink: false });
                }
                i += run.max(1);
            }
        }
    }
}

/// One printed shape, in mm from the pattern's top left corner, y down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// An upright rectangle, black or white.
    Box {
        /// Its top left corner.
        corner: Vector2<f64>,
        /// Width and height.
        size: Vector2<f64>,
        /// Black or white.
        ink: bool,
    },
    /// A black dot.
    Disc {
        /// Its centre.
        center: Vector2<f64>,
        /// Its radius.
        radius: f64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_read_and_nonsense_is_refused() {
        for text in ["charuco:11x7:15", "chessboard:10x7:25", "dots:9x7:2.5"] {
            let target: Target = text.parse().unwrap();
            assert_eq!(target.to_string(), text);
            let (across, down) = target.grid();
            assert_eq!(target.points_mm().len(), across * down);
        }
        for text in [
            "",
            "charuco",
            "charuco:11x8:15",
            "charuco:31x31:5",
            "dots:9x7:-1",
            "dots:9x7:1:2",
            "grid:9x7:1",
        ] {
            assert!(text.parse::<Target>().is_err(), "{text}");
        }
    }
}
