//! Overlay pictures: what was measured, drawn over the frame so that a person can judge it at a glance.

mod canvas;
mod coverage;
mod sheet;

pub use coverage::coverage;

use nalgebra::Vector2;

use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::fit::Circle;
use crate::frame::{Channel, Frame, Picture};
use crate::live::center;
use crate::measure::burn::{self, ToleranceKind};
use crate::measure::{circles, ring::Ring, rod};
use crate::uncertainty::{Verdict, text};
use canvas::Rgb;
use sheet::{Line, REJECTED, Sheet, USED};

/// One colour for each circle, in order.
const CIRCLES: [Rgb; 5] =
    [[80, 190, 255], [255, 190, 60], [220, 120, 255], [120, 255, 220], [255, 140, 140]];
/// The offset's arrow.
const OFFSET: Rgb = [255, 255, 80];

/// The overlay of a burn test as PNG.
pub fn burn(
    picture: &Picture,
    calibration: &Calibration,
    measured: &burn::Measured,
    title: &str,
) -> Result<Vec<u8>> {
    let report = &measured.report;
    let frame = picture.frame(report.channel);
    let view = calibration.view(frame.width(), frame.height())?;
    let mut sheet = Sheet::new(&frame, &view);
    let factor = rings(&mut sheet, &[&measured.ring, &measured.spot]);
    sheet.scale_bar();
    let found = &report.offset;
    let (value, u95, kind) = match found.tolerance_kind {
        ToleranceKind::Distance => (found.distance_mm, found.distance_u95_mm, "distance"),
        ToleranceKind::Zone => (found.zone_mm, found.zone_u95_mm, "zone"),
    };
    let (word, colour) = match found.verdict {
        Verdict::Pass => ("PASS", USED),
        Verdict::Fail => ("FAIL", REJECTED),
        Verdict::Undecided => ("UNDECIDED", CIRCLES[1]),
    };
    let headline = Line(
        format!("{word}  {kind} {} mm, limit {} mm", text(value, u95), found.tolerance_mm),
        colour,
    );
    let c = &found.correction;
    let lines = [
        Line::plain(format!(
            "offset spot - ring  dx {} mm  dy {} mm",
            text(found.offset_mm[0], found.offset_u95_mm[0]),
            text(found.offset_mm[1], found.offset_u95_mm[1])
        )),
        Line::plain(format!(
            "turn B by {}°  shim by {}°",
            text(c.b_deg, c.b_u95_deg),
            text(c.shim_deg, c.shim_u95_deg)
        )),
        circle_line("ring", &report.ring, CIRCLES[0]),
        circle_line("spot", &report.spot, CIRCLES[1]),
        legend(Some(factor)),
        Line::faint(title),
    ];
    sheet.finish(&headline, &lines)
}

/// The overlay of expected circles as PNG.
pub fn circles(
    picture: &Picture,
    calibration: &Calibration,
    measured: &circles::Measured,
    title: &str,
) -> Result<Vec<u8>> {
    let report = &measured.report;
    let frame = picture.frame(report.channel);
    let view = calibration.view(frame.width(), frame.height())?;
    let mut sheet = Sheet::new(&frame, &view);
    let factor = rings(&mut sheet, &measured.rings.iter().collect::<Vec<_>>());
    sheet.scale_bar();
    let headline = match report.pairs.first() {
        Some(p) => format!("distance {} mm", text(p.distance_mm, p.distance_u95_mm)),
        None => format!("{} circle", report.circles.len()),
    };
    let mut lines: Vec<Line> = report
        .circles
        .iter()
        .enumerate()
        .map(|(i, c)| circle_line(&format!("circle {i}"), &c.circle, CIRCLES[i % CIRCLES.len()]))
        .collect();
    lines.extend(report.pairs.iter().map(|p| {
        Line::plain(format!(
            "{} to {}  dx {:+.5}  dy {:+.5}  distance {} mm",
            p.a,
            p.b,
            p.offset_mm[0],
            p.offset_mm[1],
            text(p.distance_mm, p.distance_u95_mm)
        ))
    }));
    lines.push(legend((report.pairs.len() == 1).then_some(factor)));
    lines.push(Line::faint(title));
    sheet.finish(&Line::plain(headline), &lines)
}

/// The overlay of a picture in which nothing could be measured as PNG: the frame, where the plane's origin is, and why.
/// None where the calibration does not fit the picture, which is then why.
pub fn refused(
    picture: &Picture,
    calibration: &Calibration,
    channel: Channel,
    why: &Error,
) -> Option<Vec<u8>> {
    let frame = picture.frame(channel);
    let view = calibration.view(frame.width(), frame.height()).ok()?;
    let mut sheet = Sheet::new(&frame, &view);
    sheet.cross(Vector2::zeros(), 20.0, OFFSET);
    sheet.scale_bar();
    let mut lines = sheet.wrapped(&why.to_string());
    lines.push(Line("yellow cross: X 0, Y 0".into(), OFFSET));
    sheet.finish(&Line("NOT MEASURED".into(), REJECTED), &lines).ok()
}

/// The overlay of a live frame as PNG: the circle, the camera axis, and where to move.
pub fn center(frame: &Frame, view: &View, ring: &Ring, now: &center::Report) -> Result<Vec<u8>> {
    let mut sheet = Sheet::new(frame, view);
    rings(&mut sheet, &[ring]);
    sheet.cross(Vector2::zeros(), 20.0, OFFSET);
    let reach = 0.25 * frame.width().min(frame.height()) as f64;
    let factor = sheet.offset(Vector2::zeros(), now.offset_mm.into(), reach, OFFSET);
    sheet.scale_bar();
    let [x, y] = now.offset_mm;
    let [ux, uy] = now.offset_u95_mm;
    let headline = Line::plain(format!("move X {}  Y {} mm", text(x, ux), text(y, uy)));
    let lines = [
        Line::plain(format!(
            "offset of the centre from the camera axis, {} frames averaged",
            now.frames_used
        )),
        Line(
            format!("Ø {:.4} mm  edge found {:.0} %", now.diameter_mm, 100.0 * now.arc_coverage),
            CIRCLES[0],
        ),
        Line(format!("yellow cross: camera axis, arrow: offset x {factor}"), OFFSET),
        legend(None),
    ];
    sheet.finish(&headline, &lines)
}

/// The overlays of all captures of a rod as PNG, in their order; the pictures are read again.
pub fn rod_captures(
    captures: &[rod::Capture],
    calibration: &Calibration,
    measured: &rod::Measured,
    channel: Channel,
) -> Result<Vec<Vec<u8>>> {
    let one = |(index, capture): (usize, &rod::Capture)| {
        let frame = Picture::read(&capture.path)?.into_frame(channel);
        rod(&frame, calibration, measured, index)
    };
    captures.iter().enumerate().map(one).collect()
}

/// The same of captures in which no rod could be measured; those that cannot be drawn either are left out.
pub fn rod_refused(
    captures: &[rod::Capture],
    calibration: &Calibration,
    channel: Channel,
    why: &Error,
) -> Vec<(usize, Vec<u8>)> {
    let one = |(index, capture): (usize, &rod::Capture)| {
        let picture = Picture::read(&capture.path).ok()?;
        Some((index, refused(&picture, calibration, channel, why)?))
    };
    captures.iter().enumerate().filter_map(one).collect()
}

/// The overlay of one capture of the rod as PNG: the common circle over the arc that this capture shows.
pub fn rod(
    frame: &Frame,
    calibration: &Calibration,
    measured: &rod::Measured,
    capture: usize,
) -> Result<Vec<u8>> {
    let report = &measured.report;
    let view = calibration.view(frame.width(), frame.height())?;
    let mut sheet = Sheet::new(frame, &view);
    let circle = measured.circles[capture];
    sheet.circle(circle, CIRCLES[0]);
    let points = measured.points.iter().filter(|p| p.capture == capture);
    sheet.points(points.map(|p| (p.pixel, p.used)));
    sheet.cross(circle.center, 14.0, CIRCLES[0]);
    sheet.scale_bar();
    let name = if report.axis_separated { "C axis" } else { "rod" };
    let [x, y] = report.axis_center_mm;
    let [ux, uy] = report.axis_center_u95_mm;
    let headline = Line::plain(format!("{name}  X {}  Y {} mm", text(x, ux), text(y, uy)));
    let seen = &report.captures[capture];
    let lines = [
        Line::plain(format!("Ø {} mm", text(report.diameter_mm, report.diameter_u95_mm))),
        Line(
            format!(
                "this capture: edge used {:.0} %  residuals mean {:+.5}  rms {:.5} mm",
                100.0 * seen.arc_used,
                seen.residual_mean_mm,
                seen.residual_rms_mm
            ),
            CIRCLES[0],
        ),
        legend(None),
        Line::faint(format!("{}  X {} Y {} C {}", seen.image, seen.x_mm, seen.y_mm, seen.c_deg)),
    ];
    sheet.finish(&headline, &lines)
}

/// Edge points, circles and centres; with two circles the arrow between their centres. Gives its enlargement.
fn rings(sheet: &mut Sheet, rings: &[&Ring]) -> f64 {
    for (i, ring) in rings.iter().enumerate() {
        sheet.circle(ring.circle, CIRCLES[i % CIRCLES.len()]);
    }
    for (i, ring) in rings.iter().enumerate() {
        sheet.points(ring.trace.iter().copied());
        sheet.cross(ring.circle.center, 14.0 - 5.0 * (i % 2) as f64, CIRCLES[i % CIRCLES.len()]);
    }
    let &[a, b] = rings else { return 1.0 };
    // About half way to the smaller circle's edge.
    let reach = 0.5 * radius_px(sheet, a.circle).min(radius_px(sheet, b.circle));
    sheet.offset(a.circle.center, b.circle.center - a.circle.center, reach, OFFSET)
}

fn radius_px(sheet: &Sheet, circle: Circle) -> f64 {
    let rim = circle.center + Vector2::x() * circle.radius;
    (sheet.at_mm(rim) - sheet.at_mm(circle.center)).norm()
}

fn circle_line(name: &str, c: &crate::measure::CircleReport, colour: Rgb) -> Line {
    Line(
        format!(
            "{name}  Ø {} mm  edge found {:.0} %  form {:.4} mm rms",
            text(c.diameter_mm, c.diameter_u95_mm),
            100.0 * c.arc_coverage,
            c.form_rms_mm
        ),
        colour,
    )
}

fn legend(factor: Option<f64>) -> Line {
    let arrow = factor.map_or(String::new(), |f| format!(", arrow: offset x {f}"));
    Line::faint(format!("green: edge used, red: rejected{arrow}"))
}
