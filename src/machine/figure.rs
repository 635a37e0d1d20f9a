//! A drawing of the head B / table C machine's frames and vectors as SVG, with a machine's own
//! numbers. Not to scale.

use std::fmt::Write;

use crate::machine::Machine;

const INK: &str = "#222";
const HEAD: &str = "#0072b2";
const TABLE: &str = "#009e73";
const GHOST: &str = "#999";

/// Where things stand in the side view, px: the C axis, the table's surface, the B axis, the
/// nozzle's end face.
const C_X: f64 = 190.0;
const TABLE_Y: f64 = 400.0;
const B: [f64; 2] = [300.0, 130.0];
const NOZZLE: [f64; 2] = [345.0, 310.0];
const STANDOFF: f64 = 36.0;
/// The middle of the view from above.
const TOP: [f64; 2] = [640.0, 250.0];

/// The figure: side view (X to the right, Z up, Y away) and view from above.
pub fn frames_svg(machine: &Machine) -> String {
    let mut s = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 840 470\" width=\"840\" height=\"470\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <defs><marker id=\"tip\" viewBox=\"0 0 8 8\" refX=\"7\" refY=\"4\" markerWidth=\"8\" markerHeight=\"8\" orient=\"auto-start-reverse\"><path d=\"M0 0 8 4 0 8z\" fill=\"context-stroke\"/></marker></defs>\n\
         <rect width=\"840\" height=\"470\" fill=\"white\"/>\n",
    );
    side_view(&mut s, machine);
    top_view(&mut s, machine);
    s + "</svg>\n"
}

fn side_view(s: &mut String, m: &Machine) {
    text(s, 20.0, 28.0, INK, "Side view: X right, Z up, Y away from you (mm, not to scale)");
    // Table, C axis, table frame.
    line(s, [50.0, TABLE_Y], [470.0, TABLE_Y], TABLE, 3.0, false);
    line(s, [C_X, 60.0], [C_X, 440.0], TABLE, 1.0, true);
    text(s, C_X - 42.0, 54.0, TABLE, "C axis");
    arrow(s, [C_X, TABLE_Y], [C_X + 55.0, TABLE_Y], TABLE);
    arrow(s, [C_X, TABLE_Y], [C_X, TABLE_Y - 55.0], TABLE);
    text(s, C_X + 44.0, TABLE_Y - 7.0, TABLE, "x");
    text(s, C_X + 6.0, TABLE_Y - 46.0, TABLE, "z");
    let p = m.table_point();
    let place = format!("T: X_C {:.4}, Y_C {:.4}, Z_C {:.4}", p.x, p.y, p.z);
    text(s, C_X + 8.0, TABLE_Y + 24.0, TABLE, &place);
    // Head at B = 0.
    line(s, [NOZZLE[0], 70.0], [NOZZLE[0], TABLE_Y], HEAD, 1.0, true);
    text(s, NOZZLE[0] + 6.0, 78.0, HEAD, "optical axis");
    nozzle(s, NOZZLE, 0.0, HEAD);
    arrow(s, B, [B[0], NOZZLE[1]], HEAD);
    text(s, B[0] - 80.0, 270.0, HEAD, &format!("R {:.4}", m.head.r_mm));
    arrow(s, [B[0], NOZZLE[1]], NOZZLE, HEAD);
    text(s, B[0] - 80.0, NOZZLE[1] + 18.0, HEAD, &format!("ΔX {:+.4}", m.head.delta_x_mm));
    let tip = [NOZZLE[0], NOZZLE[1] + STANDOFF];
    arrow(s, NOZZLE, tip, INK);
    text(s, tip[0] + 8.0, tip[1] - 10.0, INK, &format!("stand-off {:.4}", m.head.standoff_mm));
    text(s, tip[0] + 8.0, tip[1] + 6.0, INK, "tool point");
    circle(s, tip, 3.0, INK, INK);
    // The B axis, and the nozzle at B = ±90°, where it points to -X.
    let sense = m.b_sense();
    circle(s, B, 8.0, HEAD, "white");
    line(s, [B[0] - 5.0, B[1] - 5.0], [B[0] + 5.0, B[1] + 5.0], HEAD, 1.5, false);
    line(s, [B[0] - 5.0, B[1] + 5.0], [B[0] + 5.0, B[1] - 5.0], HEAD, 1.5, false);
    text(s, B[0] + 14.0, B[1] + 4.0, HEAD, "B axis (+Y, away)");
    let turned = [B[0] - (NOZZLE[1] - B[1]), B[1] + (NOZZLE[0] - B[0])];
    nozzle(s, turned, 90.0, GHOST);
    text(
        s,
        turned[0] - 70.0,
        turned[1] - 30.0,
        GHOST,
        if sense > 0.0 { "B = +90°" } else { "B = -90°" },
    );
    arc(s, B, 100.0, [100.0, 170.0], sense, HEAD);
    text(s, B[0] - 70.0, B[1] + 50.0, HEAD, "+B");
}

fn top_view(s: &mut String, m: &Machine) {
    text(s, TOP[0] - 120.0, 28.0, INK, "From above: X right, Y up");
    circle(s, TOP, 110.0, TABLE, "none");
    circle(s, TOP, 4.0, TABLE, TABLE);
    text(s, TOP[0] + 8.0, TOP[1] + 18.0, TABLE, "C axis");
    // The machine's directions at the corner, the table frame turned by a positive C.
    let corner = [TOP[0] - 120.0, TOP[1] + 175.0];
    arrow(s, corner, [corner[0] + 50.0, corner[1]], INK);
    arrow(s, corner, [corner[0], corner[1] - 50.0], INK);
    text(s, corner[0] + 54.0, corner[1] + 4.0, INK, "X");
    text(s, corner[0] - 4.0, corner[1] - 56.0, INK, "Y");
    let turned = f64::from(m.c_sense) * 25f64.to_radians();
    for (name, angle) in [("x", turned), ("y", turned + std::f64::consts::FRAC_PI_2)] {
        let end = |r: f64| [TOP[0] + r * angle.cos(), TOP[1] - r * angle.sin()];
        arrow(s, TOP, end(90.0), TABLE);
        text(s, end(98.0)[0] - 3.0, end(98.0)[1] + 4.0, TABLE, name);
    }
    line(s, TOP, [TOP[0] + 110.0, TOP[1]], GHOST, 1.0, true);
    arc(s, TOP, 125.0, [0.0, -25.0 * f64::from(m.c_sense)], 1.0, TABLE);
    text(s, TOP[0] + 132.0, TOP[1] - 26.0 * f64::from(m.c_sense) + 4.0, TABLE, "+C");
    text(
        s,
        TOP[0] - 30.0,
        TOP[1] + 160.0,
        TABLE,
        &format!("table turned by C, c_sense = {}", m.c_sense),
    );
}

/// A nozzle whose end face's middle is `at`, pointing down turned clockwise by `turn_deg`.
fn nozzle(s: &mut String, at: [f64; 2], turn_deg: f64, colour: &str) {
    let _ = writeln!(
        s,
        "<path d=\"M-7 0 H7 L16 -34 H-16 Z\" transform=\"translate({} {}) rotate({turn_deg})\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
        at[0], at[1]
    );
}

/// An arc from the first to the second angle (degrees from +x, clockwise on the page), with its tip
/// at the end, or at the start where `sense` is negative.
fn arc(s: &mut String, c: [f64; 2], r: f64, deg: [f64; 2], sense: f64, colour: &str) {
    let [a, b] = deg.map(|d| {
        let (sin, cos) = d.to_radians().sin_cos();
        [c[0] + r * cos, c[1] + r * sin]
    });
    let sweep = i32::from(deg[1] > deg[0]);
    let marker = if sense > 0.0 { "marker-end" } else { "marker-start" };
    let _ = writeln!(
        s,
        "<path d=\"M{:.1} {:.1} A{r} {r} 0 0 {sweep} {:.1} {:.1}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\" {marker}=\"url(#tip)\"/>",
        a[0], a[1], b[0], b[1]
    );
}

fn line(s: &mut String, a: [f64; 2], b: [f64; 2], colour: &str, width: f64, dashed: bool) {
    let dash = if dashed { " stroke-dasharray=\"8 4\"" } else { "" };
    let _ = writeln!(
        s,
        "<line x1=\"{}\" y1=\"{}\" x2=\"{}\" y2=\"{}\" stroke=\"{colour}\" stroke-width=\"{width}\"{dash}/>",
        a[0], a[1], b[0], b[1]
    );
}

fn arrow(s: &mut String, a: [f64; 2], b: [f64; 2], colour: &str) {
    let _ = writeln!(
        s,
        "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\" stroke-width=\"2\" marker-end=\"url(#tip)\"/>",
        a[0], a[1], b[0], b[1]
    );
}

fn circle(s: &mut String, c: [f64; 2], r: f64, stroke: &str, fill: &str) {
    let _ = writeln!(
        s,
        "<circle cx=\"{}\" cy=\"{}\" r=\"{r}\" stroke=\"{stroke}\" stroke-width=\"2\" fill=\"{fill}\"/>",
        c[0], c[1]
    );
}

fn text(s: &mut String, x: f64, y: f64, colour: &str, words: &str) {
    let _ = writeln!(s, "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{colour}\">{words}</text>");
}
