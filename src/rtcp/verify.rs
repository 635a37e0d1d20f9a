//! Whether a correction holds: a measured RTCP sweep against the machine model.

use nalgebra::Vector3;

use crate::machine::Chain;
use crate::plot::{Figure, Panel};
use crate::rtcp::sweep::{Size, Sweep, remove_target_offset};
use crate::uncertainty::{K95, Verdict};

/// What to compare with.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// The largest deviation allowed.
    pub tolerance_mm: f64,
    /// Standard uncertainty of a measured component.
    pub noise_mm: f64,
    /// Whether the control held other values than the model's, so that the prediction is what the
    /// new values would remove.
    pub corrected: bool,
}

/// A sweep compared with its prediction; the target's place is fitted in each.
#[derive(Debug, Clone)]
pub struct Report {
    /// As measured.
    pub measured: Vec<Vector3<f64>>,
    /// As the model predicts.
    pub predicted: Vec<Vector3<f64>>,
    /// What the model leaves.
    pub rest: Vec<Vector3<f64>>,
    /// Where the target really is, seen from where the model has it, in the table frame.
    pub target_offset_mm: Vector3<f64>,
    /// Size of the measured deviations.
    pub before: Size,
    /// Size of what the model leaves.
    pub after: Size,
    /// Of the largest deviation: measured, or left once the model's values are in the control.
    pub verdict: Verdict,
}

/// Compares measured deviations with predicted ones ([`super::sweep::predict`]), row by row; `real`
/// tells how the target turns with the table.
pub fn verify(
    real: &Chain,
    rotary: &[[f64; 2]],
    measured: &[Vector3<f64>],
    mut predicted: Vec<Vector3<f64>>,
    options: Options,
) -> Report {
    let mut rest: Vec<Vector3<f64>> = measured.iter().zip(&predicted).map(|(m, p)| m - p).collect();
    let target_offset_mm = remove_target_offset(real, rotary, &mut rest);
    let mut measured = measured.to_vec();
    remove_target_offset(real, rotary, &mut measured);
    remove_target_offset(real, rotary, &mut predicted);
    let (before, after) = (Size::of(&measured), Size::of(&rest));
    let judged = if options.corrected { after } else { before };
    let verdict = Verdict::of(judged.worst_mm, K95 * options.noise_mm, options.tolerance_mm);
    Report { measured, predicted, rest, target_offset_mm, before, after, verdict }
}

/// Measured and predicted deviations along X, Y, Z, over B (left) and over C (right).
pub fn figure(sweep: &Sweep, report: &Report, noise_mm: f64) -> Figure {
    let mut figure = Figure::new("RTCP sweep: measured and predicted").columns(2);
    for (i, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
        for (k, name) in ['B', 'C'].into_iter().enumerate() {
            let over = |d: &[Vector3<f64>]| -> Vec<(f64, f64)> {
                let mut points: Vec<(f64, f64)> = sweep
                    .rotary_rad
                    .iter()
                    .zip(d)
                    .map(|(r, d)| (r[k].to_degrees(), d[i]))
                    .collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                points
            };
            let bars: Vec<(f64, f64, f64)> =
                over(&report.measured).iter().map(|p| (p.0, p.1, K95 * noise_mm)).collect();
            figure = figure.panel(
                Panel::new(format!("{name}, °"), format!("d{axis}, mm"))
                    .points_with_bars("measured", &bars)
                    .points("predicted", &over(&report.predicted))
                    .points("left", &over(&report.rest)),
            );
        }
    }
    figure
}
