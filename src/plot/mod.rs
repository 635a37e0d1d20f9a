//! Small charts as SVG text: lines, points with error bars, bands and limits, in one or several panels.
//!
//! The output is deterministic, escaped and self-contained, so it can stand in a file, a page or a test.
//! Values that are not finite are left out; a line breaks there.
//!
//! ```
//! use pivotsight::plot::{Figure, Panel};
//!
//! let panel = Panel::new("B angle, °", "deviation, mm")
//!     .points_with_bars("run 1", &[(0.0, 0.001, 0.002), (5.0, 0.004, 0.002)])
//!     .limit("limit", 0.015);
//! assert!(Figure::new("Before").panel(panel).to_svg().starts_with("<svg"));
//! ```

mod scale;
mod svg;

use std::path::{Path, PathBuf};

use crate::error::Result;

/// Colours that stay apart for colour-blind readers (Okabe and Ito), in the order series get them.
const PALETTE: [&str; 7] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#444444"];

/// One picture of one or more panels.
#[derive(Debug, Clone, Default)]
pub struct Figure {
    title: String,
    panels: Vec<Panel>,
    columns: usize,
}

impl Figure {
    /// A figure with a title and no panels yet; panels stand below each other.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), panels: Vec::new(), columns: 1 }
    }

    /// Puts this many panels side by side (at least one).
    #[must_use]
    pub fn columns(mut self, columns: usize) -> Self {
        self.columns = columns.max(1);
        self
    }

    /// Adds a panel.
    #[must_use]
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// The whole figure as an `<svg>` element.
    pub fn to_svg(&self) -> String {
        svg::draw(self)
    }

    /// Writes the figure to `folder/name.svg`, creating the folder; returns the path.
    pub fn write(&self, folder: impl AsRef<Path>, name: &str) -> Result<PathBuf> {
        crate::output::create_folder(&folder)?;
        let path = folder.as_ref().join(format!("{name}.svg"));
        crate::output::write_whole(&path, self.to_svg().as_bytes())?;
        Ok(path)
    }
}

/// One pair of axes and what is drawn in it.
#[derive(Debug, Clone, Default)]
pub struct Panel {
    title: String,
    x_label: String,
    y_label: String,
    series: Vec<Series>,
    equal_scale: bool,
}

#[derive(Debug, Clone)]
struct Series {
    name: String,
    shape: Shape,
}

#[derive(Debug, Clone)]
enum Shape {
    Line(Vec<(f64, f64)>),
    /// x, y, half-length of the vertical error bar (0: none).
    Points(Vec<(f64, f64, f64)>),
    /// x, lower, upper.
    Band(Vec<(f64, f64, f64)>),
    /// A horizontal line over the whole panel.
    Limit(f64),
}

impl Panel {
    /// A panel with axis labels, each "quantity, unit".
    pub fn new(x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self { x_label: x_label.into(), y_label: y_label.into(), ..Self::default() }
    }

    /// A heading above the panel.
    #[must_use]
    pub fn title(mut self, title: impl Into<String>) -> Self {
        self.title = title.into();
        self
    }

    /// One unit is as long on x as on y: for maps of positions.
    #[must_use]
    pub fn equal_scale(mut self) -> Self {
        self.equal_scale = true;
        self
    }

    /// Points (x, y) joined in the order given.
    #[must_use]
    pub fn line(self, name: impl Into<String>, points: &[(f64, f64)]) -> Self {
        self.with(name, Shape::Line(points.to_vec()))
    }

    /// Points (x, y) as dots.
    #[must_use]
    pub fn points(self, name: impl Into<String>, points: &[(f64, f64)]) -> Self {
        self.with(name, Shape::Points(points.iter().map(|&(x, y)| (x, y, 0.0)).collect()))
    }

    /// Points (x, y, half-width of the interval) as dots with vertical bars.
    #[must_use]
    pub fn points_with_bars(self, name: impl Into<String>, points: &[(f64, f64, f64)]) -> Self {
        self.with(name, Shape::Points(points.to_vec()))
    }

    /// A shaded region (x, lower, upper).
    #[must_use]
    pub fn band(self, name: impl Into<String>, points: &[(f64, f64, f64)]) -> Self {
        self.with(name, Shape::Band(points.to_vec()))
    }

    /// A dashed horizontal line.
    #[must_use]
    pub fn limit(self, name: impl Into<String>, y: f64) -> Self {
        self.with(name, Shape::Limit(y))
    }

    fn with(mut self, name: impl Into<String>, shape: Shape) -> Self {
        self.series.push(Series { name: name.into(), shape });
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Figure {
        let curve: Vec<_> =
            (0..60).map(|i| (f64::from(i), (f64::from(i) / 9.0).sin() * 0.01)).collect();
        let band: Vec<_> = curve.iter().map(|&(x, y)| (x, y - 0.002, y + 0.002)).collect();
        let dots: Vec<_> = curve.iter().step_by(6).map(|&(x, y)| (x, y + 0.001, 0.0015)).collect();
        Figure::new("A <b> & \"c\"")
            .columns(2)
            .panel(
                Panel::new("B angle, °", "deviation, mm")
                    .title("left")
                    .band("95 %", &band)
                    .line("fit", &curve)
                    .points_with_bars("run 1", &dots)
                    .limit("limit", 0.012),
            )
            .panel(
                Panel::new("x, mm", "y, mm")
                    .equal_scale()
                    .points("", &[(0.0, 0.0), (100.0, 1.0), (f64::NAN, 2.0)]),
            )
    }

    #[test]
    fn text_is_escaped_and_nothing_that_is_not_finite_is_drawn() {
        let svg = sample().to_svg();
        assert!(svg.contains("A &lt;b&gt; &amp; &quot;c&quot;"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert_eq!(svg, sample().to_svg());
        assert_eq!(svg.matches("<circle").count(), 10 + 2 + 1, "points and one legend mark");
    }

    #[test]
    fn empty_and_constant_data_still_draw() {
        for panel in [
            Panel::default(),
            Panel::new("x", "y").line("flat", &[(1.0, 5.0), (1.0, 5.0)]),
            Panel::new("x", "y").points("huge", &[(1e300, -1e300), (-1e300, 1e300)]),
            Panel::new("x", "y").points("tiny", &[(1e-300, 0.0), (2e-300, 1e9)]),
        ] {
            let svg = Figure::new("").panel(panel).to_svg();
            assert!(svg.ends_with("</svg>\n") && !svg.contains("NaN"), "{svg}");
        }
    }
}
