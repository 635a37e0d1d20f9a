//! Whether a correction holds: a measured RTCP sweep against the machine model.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::fit::tails::f_quantile;
use crate::machine::Chain;
use crate::plot::{Figure, Panel};
use crate::rtcp::sweep::{Size, Sweep, remove_target_offset};
use crate::uncertainty::{K95, Verdict, k95, scatters_more};

/// What to compare with.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// The largest deviation allowed.
    pub tolerance_mm: f64,
    /// Standard uncertainty of a measured component; `None`: from poses measured again, else [`USUAL_NOISE_MM`].
    pub noise_mm: Option<f64>,
    /// Whether the control held other values than the model's, so that the prediction is what the
    /// new values would remove.
    pub corrected: bool,
}

/// What a touch trigger or an indicator repeats to, where nothing tells.
pub const USUAL_NOISE_MM: f64 = 0.001;
/// Degrees of freedom from which poses measured again tell the noise.
const LEAST_REPEATS: f64 = 6.0;

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
    /// Standard uncertainty of a measured component.
    pub noise_mm: f64,
    /// Where it is from.
    pub noise_source: &'static str,
    /// Why it may be another one.
    pub noise_doubt: Option<String>,
    /// The largest true deviation, as measured or left once the model's values are in the control: the middle of what it may be, as the
    /// largest of many that are seen was chosen for its noise, too.
    pub worst_mm: f64,
    /// Half-width of its 95 % interval.
    pub worst_u95_mm: f64,
    /// Size of the measured deviations.
    pub before: Size,
    /// Size of what the model leaves.
    pub after: Size,
    /// Of the largest deviation.
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
    let seen_mm = if options.corrected { after } else { before }.worst_mm;
    let repeats = repeatability(rotary, &rest);
    let (noise_mm, dof, noise_source) = match (options.noise_mm, repeats) {
        (Some(given), _) => (given, f64::INFINITY, "given"),
        (None, Some((seen, dof))) => (seen, dof, "poses measured again"),
        (None, None) => (USUAL_NOISE_MM, f64::INFINITY, "assumed"),
    };
    let lengths = if options.corrected { &rest } else { &measured };
    // Upwards one pose's own noise is enough: the truly largest deviation is seen no smaller than that makes it.
    let (down_mm, up_mm) = (worst_u95(lengths, noise_mm, dof), k95(dof) * noise_mm);
    let worst_mm = (seen_mm - 0.5 * (down_mm - up_mm)).max(0.0);
    let worst_u95_mm = seen_mm + up_mm - worst_mm;
    let verdict = Verdict::of(worst_mm, worst_u95_mm, options.tolerance_mm);
    Report {
        measured,
        predicted,
        rest,
        target_offset_mm,
        noise_mm,
        noise_source,
        noise_doubt: noise_doubt(options.noise_mm, repeats),
        worst_mm,
        worst_u95_mm,
        before,
        after,
        verdict,
    }
}

/// Standard deviation of a component at poses that were measured more than once, and its degrees of freedom; `None` where there are too
/// few, or where all agree to the last digit: then they were copied or read too coarsely, and tell nothing.
fn repeatability(rotary: &[[f64; 2]], d: &[Vector3<f64>]) -> Option<(f64, f64)> {
    let mut poses: BTreeMap<[i64; 2], Vec<Vector3<f64>>> = BTreeMap::new();
    for (r, d) in rotary.iter().zip(d) {
        poses.entry(r.map(|a| (a.to_degrees() * 1e6).round() as i64)).or_default().push(*d);
    }
    let (mut sum, mut dof) = (0.0, 0.0);
    for list in poses.values() {
        let mean = list.iter().sum::<Vector3<f64>>() / list.len() as f64;
        sum += list.iter().map(|d| (d - mean).norm_squared()).sum::<f64>();
        dof += 3.0 * (list.len() as f64 - 1.0);
    }
    (dof >= LEAST_REPEATS && sum > 0.0).then(|| ((sum / dof).sqrt(), dof))
}

/// What the poses measured again say against the noise that is given, or that nothing tells it.
fn noise_doubt(given_mm: Option<f64>, repeats: Option<(f64, f64)>) -> Option<String> {
    match (given_mm, repeats) {
        (Some(given), Some((seen, dof))) => scatters_more(seen, dof, given).then(|| {
            format!("poses measured again scatter by {seen:.4} mm, more than --noise-mm says: the interval is too narrow")
        }),
        (None, None) => Some(format!(
            "the noise is assumed, {USUAL_NOISE_MM} mm, and the interval stands on it: measure some poses again, or give --noise-mm"
        )),
        _ => None,
    }
}

/// How far the largest length may be above the truth (95 %), where the noise is known with `dof` degrees of freedom. The largest of many was
/// chosen for its noise too: it is off by no more than the largest noise of those that may be the largest.
fn worst_u95(d: &[Vector3<f64>], noise_mm: f64, dof: f64) -> f64 {
    let reach = |components: f64, rivals: usize| {
        let one_of_them = -(0.95_f64.ln() / rivals.max(1) as f64).exp_m1();
        noise_mm * (components * f_quantile(one_of_them.ln(), components, dof)).sqrt()
    };
    let worst = d.iter().map(Vector3::norm).fold(0.0, f64::max);
    let rivals = d.iter().filter(|d| d.norm() > worst - 2.0 * k95(dof) * noise_mm).count();
    // Far from where noise alone may bring one of all a length is off by the noise along it, nearer to zero by all three components'.
    let by_noise = reach(3.0, d.len());
    reach(if worst > 1.5 * by_noise { 1.0 } else { 3.0 }, rivals)
}

/// Measured and predicted deviations along X, Y, Z, over the first rotary axis (left) and over the second (right).
pub fn figure(sweep: &Sweep, report: &Report) -> Figure {
    let mut figure = Figure::new("RTCP sweep: measured and predicted").columns(2);
    for (i, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
        for (k, name) in sweep.axes.into_iter().enumerate() {
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
                over(&report.measured).iter().map(|p| (p.0, p.1, K95 * report.noise_mm)).collect();
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// The largest of many is chosen for its noise: of an exact machine too, and with a noise that few repeats tell.
    #[test]
    fn the_interval_of_the_largest_deviation_holds() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
        for (poses, dof) in [(20, f64::INFINITY), (300, f64::INFINITY), (20, 6.0)] {
            let mut held = 0;
            for _ in 0..200 {
                let d: Vec<Vector3<f64>> =
                    (0..poses).map(|_| Vector3::from_fn(|_, _| draw())).collect();
                let seen = match dof < 100.0 {
                    true => ((0..6).map(|_| draw().powi(2)).sum::<f64>() / 6.0).sqrt(),
                    false => 1.0,
                };
                let worst = d.iter().map(Vector3::norm).fold(0.0, f64::max);
                held += usize::from(worst < worst_u95(&d, seen, dof));
            }
            assert!(held > 182, "{poses} poses: {held} of 200");
        }
    }
}
