//! A target on paper, true to scale: SVG and PDF.

use std::fmt::Write;

use nalgebra::Vector2;

use super::{Kind, Shape, Target};
use crate::output::escape;

/// Paper sizes, portrait, smallest first.
const PAPERS: [(&str, f64, f64); 5] = [
    ("A4", 210.0, 297.0),
    ("A3", 297.0, 420.0),
    ("A2", 420.0, 594.0),
    ("A1", 594.0, 841.0),
    ("A0", 841.0, 1189.0),
];
/// Free border of the page, which printers cannot print on.
const BORDER_MM: f64 = 8.0;
/// Room for the caption below the pattern.
const CAPTION_MM: f64 = 14.0;
/// Height of the caption's letters.
const LETTERS_MM: f64 = 3.0;

/// A page with the target in its middle.
#[derive(Debug, Clone, PartialEq)]
pub struct Page {
    /// Name of the paper, or "cut to size".
    pub paper: String,
    /// Width and height of the page.
    pub size_mm: Vector2<f64>,
    /// The pattern's top left corner on it.
    corner_mm: Vector2<f64>,
    /// Length of the bar that proves the scale.
    bar_mm: f64,
    caption: String,
    shapes: Vec<Shape>,
}

impl Page {
    /// Lays the target out on the smallest paper that takes it with a white border of a pitch.
    pub fn new(target: &Target) -> Self {
        let pattern = target.size_mm();
        let white = target.pitch_mm.clamp(BORDER_MM, 40.0);
        let wanted = pattern + Vector2::new(2.0 * white, 2.0 * white + CAPTION_MM);
        let turned = |&(name, w, h): &(&'static str, f64, f64)| [(name, w, h), (name, h, w)];
        let fits =
            PAPERS.iter().flat_map(turned).find(|(_, w, h)| wanted.x <= *w && wanted.y <= *h);
        let (paper, size_mm) = match fits {
            Some((name, w, h)) => (name.to_owned(), Vector2::new(w, h)),
            None => ("cut to size".to_owned(), wanted),
        };
        let free = size_mm - pattern - Vector2::new(0.0, CAPTION_MM);
        let bar_mm =
            [200.0, 100.0, 50.0, 20.0].into_iter().find(|b| *b <= 0.6 * size_mm.x).unwrap_or(10.0);
        let dictionary = if target.kind == Kind::Charuco { ", markers DICT_4X4_100" } else { "" };
        Self {
            paper,
            size_mm,
            corner_mm: free / 2.0,
            bar_mm,
            caption: format!(
                "{target}{dictionary}. Print at 100 %, glue onto something flat. This bar must measure {bar_mm} mm."
            ),
            shapes: target.shapes(),
        }
    }

    /// Left end of the bar; the caption stands below it.
    fn bar(&self) -> Vector2<f64> {
        Vector2::new(BORDER_MM, self.size_mm.y - BORDER_MM - LETTERS_MM - 2.0)
    }
}

/// The page as SVG, one user unit a millimetre.
pub fn svg(page: &Page) -> String {
    let (w, h) = (page.size_mm.x, page.size_mm.y);
    let mut t = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        t,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\">"
    );
    let _ = writeln!(t, "<rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>");
    let _ = writeln!(t, "<g shape-rendering=\"geometricPrecision\">");
    for shape in &page.shapes {
        let _ = match *shape {
            Shape::Box { corner, size, ink } => {
                let at = page.corner_mm + corner;
                let colour = if ink { "#000" } else { "#fff" };
                writeln!(
                    t,
                    "<rect x=\"{:.5}\" y=\"{:.5}\" width=\"{:.5}\" height=\"{:.5}\" fill=\"{colour}\"/>",
                    at.x, at.y, size.x, size.y
                )
            }
            Shape::Disc { center, radius } => {
                let at = page.corner_mm + center;
                writeln!(t, "<circle cx=\"{:.5}\" cy=\"{:.5}\" r=\"{radius:.5}\"/>", at.x, at.y)
            }
        };
    }
    let bar = page.bar();
    let (left, right, y) = (bar.x, bar.x + page.bar_mm, bar.y);
    let _ = writeln!(t, "</g>");
    let _ = writeln!(
        t,
        "<path d=\"M{left} {y}H{right}M{left} {}V{}M{right} {}V{}\" stroke=\"#000\" stroke-width=\"0.2\"/>",
        y - 1.5,
        y + 1.5,
        y - 1.5,
        y + 1.5
    );
    let _ = writeln!(
        t,
        "<text x=\"{left}\" y=\"{}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"{LETTERS_MM}\">{}</text>\n</svg>",
        y + 2.0 + LETTERS_MM,
        escape(&page.caption)
    );
    t
}

/// The page as PDF 1.4.
pub fn pdf(page: &Page) -> Vec<u8> {
    const POINTS: f64 = 72.0 / 25.4;
    let h = page.size_mm.y;
    let mut c = String::new();
    // One unit a millimetre, y up. Writing to a String cannot fail.
    let _ = writeln!(c, "{POINTS:.9} 0 0 {POINTS:.9} 0 0 cm");
    for shape in &page.shapes {
        let _ = match *shape {
            Shape::Box { corner, size, ink } => {
                let at = page.corner_mm + corner;
                let gray = u8::from(!ink);
                writeln!(
                    c,
                    "{gray} g {:.5} {:.5} {:.5} {:.5} re f",
                    at.x,
                    h - at.y - size.y,
                    size.x,
                    size.y
                )
            }
            Shape::Disc { center, radius } => {
                let at = page.corner_mm + center;
                writeln!(c, "0 g {}", disc(at.x, h - at.y, radius))
            }
        };
    }
    let bar = page.bar();
    let (left, right, y) = (bar.x, bar.x + page.bar_mm, h - bar.y);
    let _ = writeln!(
        c,
        "0.2 w {left} {y:.5} m {right} {y:.5} l {left} {} m {left} {} l {right} {} m {right} {} l S",
        y - 1.5,
        y + 1.5,
        y - 1.5,
        y + 1.5
    );
    let words = page.caption.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)");
    let _ = writeln!(
        c,
        "BT 0 g /F1 {LETTERS_MM} Tf {left} {:.5} Td ({words}) Tj ET",
        y - 2.0 - LETTERS_MM
    );
    let objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {:.5} {:.5}] /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>",
            page.size_mm.x * POINTS,
            h * POINTS
        ),
        format!("<< /Length {} >>\nstream\n{c}endstream", c.len()),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
    ];
    let mut file = String::from("%PDF-1.4\n");
    let mut places = Vec::new();
    for (i, object) in objects.iter().enumerate() {
        places.push(file.len());
        let _ = write!(file, "{} 0 obj\n{object}\nendobj\n", i + 1);
    }
    let table = file.len();
    let _ = write!(file, "xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    for place in places {
        let _ = writeln!(file, "{place:010} 00000 n ");
    }
    let _ = write!(
        file,
        "trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n",
        objects.len() + 1
    );
    file.into_bytes()
}

/// A filled circle of four Bézier curves (off by 0.03 % of the radius).
fn disc(x: f64, y: f64, r: f64) -> String {
    let k = 0.552_284_75 * r;
    let curve = |a: [f64; 6]| a.map(|v| format!("{v:.5}")).join(" ") + " c";
    format!(
        "{:.5} {y:.5} m {} {} {} {} f",
        x + r,
        curve([x + r, y + k, x + k, y + r, x, y + r]),
        curve([x - k, y + r, x - r, y + k, x - r, y]),
        curve([x - r, y - k, x - k, y - r, x, y - r]),
        curve([x + k, y - r, x + r, y - k, x + r, y])
    )
}
