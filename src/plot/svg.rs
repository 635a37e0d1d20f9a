//! Draws a figure: layout, axes, series, legend.

use std::fmt::Write;

use super::scale::Scale;
use super::{Figure, PALETTE, Panel, Shape};
use crate::output::escape;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 340.0;
const MARGIN_LEFT: f64 = 78.0;
/// Where the vertical axis' label stands.
const Y_LABEL: f64 = 15.0;
/// Least distance of its ticks.
const Y_SPACING: f64 = 36.0;
const MARGIN_RIGHT: f64 = 18.0;
const MARGIN_BOTTOM: f64 = 50.0;
const TITLE: f64 = 40.0;
const LEGEND_ROW: f64 = 18.0;
/// Mean width of a letter of the 12 px font: enough to lay out a legend.
const LETTER: f64 = 6.6;

/// A rectangle in pixels.
#[derive(Clone, Copy)]
struct Area {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

pub fn draw(figure: &Figure) -> String {
    let columns = figure.columns.clamp(1, figure.panels.len().max(1));
    // On a page as wide as paper three in a row must still be read.
    let panel_width = match columns {
        1 => WIDTH,
        2 => 560.0,
        _ => 340.0,
    };
    let rows = figure.panels.len().div_ceil(columns);
    let width = panel_width * columns as f64;
    let height = TITLE + HEIGHT * rows as f64;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" role=\"img\" font-family=\"sans-serif\" font-size=\"12\" \
         fill=\"#222\">\n<title>{0}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
         <text x=\"14\" y=\"26\" font-size=\"17\" font-weight=\"bold\">{0}</text>\n",
        escape(&figure.title)
    );
    for (i, panel) in figure.panels.iter().enumerate() {
        let left = panel_width * (i % columns) as f64;
        let top = TITLE + HEIGHT * (i / columns) as f64;
        draw_panel(
            &mut out,
            panel,
            Area { left, top, right: left + panel_width, bottom: top + HEIGHT },
        );
    }
    out.push_str("</svg>\n");
    out
}

fn draw_panel(out: &mut String, panel: &Panel, outer: Area) {
    let mut top = outer.top + 8.0;
    if !panel.title.is_empty() {
        text(
            out,
            outer.left + MARGIN_LEFT,
            top + 12.0,
            "start",
            &panel.title,
            " font-weight=\"bold\"",
        );
        top += 20.0;
    }
    let mut area = Area {
        left: outer.left + MARGIN_LEFT,
        right: outer.right - MARGIN_RIGHT,
        top: draw_legend(out, panel, outer, top) + 6.0,
        bottom: outer.bottom - MARGIN_BOTTOM,
    };
    // Long numbers must not run into the label beside them.
    let letters = |y: &Scale| y.ticks(Y_SPACING).iter().map(|t| t.1.chars().count()).max();
    let written = LETTER * letters(&scales(panel, area).1).unwrap_or(0) as f64;
    area.left = outer.left + MARGIN_LEFT.max(written + Y_LABEL + 16.0);
    let (x, y) = scales(panel, area);
    draw_axes(out, panel, outer.left + Y_LABEL, area, &x, &y);
    for (i, series) in panel.series.iter().enumerate() {
        draw_shape(out, &series.shape, colour(i, &series.shape), area, &x, &y);
    }
}

/// Draws the names of the series in rows; returns where the rows end.
fn draw_legend(out: &mut String, panel: &Panel, outer: Area, top: f64) -> f64 {
    let start = outer.left + MARGIN_LEFT;
    let (mut x, mut y) = (start, top);
    let named = panel.series.iter().enumerate().filter(|(_, s)| !s.name.is_empty());
    let mut any = false;
    for (i, series) in named {
        let width = 42.0 + LETTER * series.name.chars().count() as f64;
        if any && x + width > outer.right {
            x = start;
            y += LEGEND_ROW;
        }
        any = true;
        let colour = colour(i, &series.shape);
        let middle = y + 8.0;
        let _ = match series.shape {
            Shape::Points(_) => {
                writeln!(
                    out,
                    "<circle cx=\"{}\" cy=\"{middle}\" r=\"3\" fill=\"{colour}\"/>",
                    x + 9.0
                )
            }
            Shape::Band(_) => writeln!(
                out,
                "<rect x=\"{x}\" y=\"{}\" width=\"18\" height=\"10\" fill=\"{colour}\" fill-opacity=\"0.25\"/>",
                middle - 5.0
            ),
            Shape::Line(_) | Shape::Limit(_) => writeln!(
                out,
                "<path d=\"M{x} {middle}h18\" stroke=\"{colour}\" stroke-width=\"1.6\"{}/>",
                dash(&series.shape)
            ),
        };
        text(out, x + 23.0, middle + 4.0, "start", &series.name, "");
        x += width;
    }
    if any { y + LEGEND_ROW } else { top }
}

fn scales(panel: &Panel, area: Area) -> (Scale, Scale) {
    let mut xs = Vec::new();
    let mut ys = Vec::new();
    for series in &panel.series {
        match &series.shape {
            Shape::Line(points) => {
                xs.extend(points.iter().map(|p| p.0));
                ys.extend(points.iter().map(|p| p.1));
            }
            Shape::Points(points) => {
                xs.extend(points.iter().map(|p| p.0));
                ys.extend(points.iter().flat_map(|p| [p.1 - p.2, p.1 + p.2]));
            }
            Shape::Band(points) => {
                xs.extend(points.iter().map(|p| p.0));
                ys.extend(points.iter().flat_map(|p| [p.1, p.2]));
            }
            Shape::Limit(level) => ys.push(*level),
        }
    }
    let mut x = Scale::fit(xs.into_iter(), area.left, area.right);
    let mut y = Scale::fit(ys.into_iter(), area.bottom, area.top);
    if panel.equal_scale {
        let per_pixel = x.per_pixel().max(y.per_pixel());
        x.widen(per_pixel);
        y.widen(per_pixel);
    }
    (x, y)
}

fn draw_axes(out: &mut String, panel: &Panel, label_x: f64, area: Area, x: &Scale, y: &Scale) {
    let Area { left, top, right, bottom } = area;
    // A narrow panel has ticks too.
    let spacing = ((x.pixel_high - x.pixel_low) / 5.0).clamp(45.0, 70.0);
    for (value, label) in x.ticks(spacing) {
        let px = x.pixel(value);
        let _ = writeln!(out, "<path d=\"M{px:.1} {top:.1}V{bottom:.1}\" stroke=\"#e4e4e4\"/>");
        text(out, px, bottom + 17.0, "middle", &label, "");
    }
    for (value, label) in y.ticks(Y_SPACING) {
        let py = y.pixel(value);
        let colour = if value == 0.0 { "#aaa" } else { "#e4e4e4" };
        let _ = writeln!(out, "<path d=\"M{left:.1} {py:.1}H{right:.1}\" stroke=\"{colour}\"/>");
        text(out, left - 7.0, py + 4.0, "end", &label, "");
    }
    let _ = writeln!(
        out,
        "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"#777\"/>",
        right - left,
        bottom - top
    );
    text(out, 0.5 * (left + right), bottom + 37.0, "middle", &panel.x_label, "");
    let (tx, ty) = (label_x, 0.5 * (top + bottom));
    let turn = format!(" transform=\"rotate(-90 {tx:.1} {ty:.1})\"");
    text(out, tx, ty, "middle", &panel.y_label, &turn);
}

fn draw_shape(out: &mut String, shape: &Shape, colour: &str, area: Area, x: &Scale, y: &Scale) {
    let finite = |v: &[f64]| v.iter().all(|v| v.abs() < 1e100);
    let _ = match shape {
        Shape::Line(points) => {
            let mut path = String::new();
            let mut pen = 'M';
            for &(px, py) in points {
                if finite(&[px, py]) {
                    let _ = write!(path, "{pen}{:.1} {:.1}", x.pixel(px), y.pixel(py));
                    pen = 'L';
                } else {
                    pen = 'M';
                }
            }
            writeln!(
                out,
                "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\" stroke-linejoin=\"round\"/>"
            )
        }
        Shape::Points(points) => {
            let radius = if points.len() > 400 { 1.5 } else { 3.0 };
            for &(px, py, half) in points.iter().filter(|p| finite(&[p.0, p.1, p.2])) {
                let (cx, cy) = (x.pixel(px), y.pixel(py));
                if half > 0.0 {
                    let (low, high) = (y.pixel(py - half), y.pixel(py + half));
                    let _ = writeln!(
                        out,
                        "<path d=\"M{0:.1} {low:.1}h6M{0:.1} {high:.1}h6M{cx:.1} {low:.1}V{high:.1}\" stroke=\"{colour}\"/>",
                        cx - 3.0
                    );
                }
                let _ = writeln!(
                    out,
                    "<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"{radius}\" fill=\"{colour}\"/>"
                );
            }
            Ok(())
        }
        Shape::Band(points) => {
            let kept: Vec<_> = points.iter().filter(|p| finite(&[p.0, p.1, p.2])).collect();
            let mut corners = String::new();
            let upper = kept.iter().map(|p| (p.0, p.2));
            for (px, py) in upper.chain(kept.iter().rev().map(|p| (p.0, p.1))) {
                let _ = write!(corners, "{:.1},{:.1} ", x.pixel(px), y.pixel(py));
            }
            writeln!(
                out,
                "<polygon points=\"{}\" fill=\"{colour}\" fill-opacity=\"0.25\"/>",
                corners.trim_end()
            )
        }
        Shape::Limit(level) if finite(&[*level]) => writeln!(
            out,
            "<path d=\"M{:.1} {:.1}H{:.1}\" stroke=\"{colour}\" stroke-width=\"1.6\"{}/>",
            area.left,
            y.pixel(*level),
            area.right,
            dash(shape)
        ),
        Shape::Limit(_) => Ok(()),
    };
}

/// Limits are grey, series have the palette's colours in order.
fn colour(index: usize, shape: &Shape) -> &'static str {
    if matches!(shape, Shape::Limit(_)) { "#777" } else { PALETTE[index % PALETTE.len()] }
}

fn dash(shape: &Shape) -> &'static str {
    if matches!(shape, Shape::Limit(_)) { " stroke-dasharray=\"6 4\"" } else { "" }
}

fn text(out: &mut String, x: f64, y: f64, anchor: &str, words: &str, more: &str) {
    if !words.is_empty() {
        let _ = writeln!(
            out,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{more}>{}</text>",
            escape(words)
        );
    }
}
