//! What `solve` doubts of what it found: possible, but more likely a mix-up.

use super::report::{Replaced, Solution};
use super::solve::{Check, Solved};
use crate::uncertainty::Verdict;

/// A value of the control that changes by more is doubted, mm.
const MOST_CHANGE_MM: f64 = 1.0;

/// What is doubted of a solution: results that are possible but unlikely, and values of the control that leap.
pub fn doubts(solved: &Solved, solution: &Solution) -> Vec<String> {
    let leaps = solution.change.iter().flat_map(|c| c.values.iter().filter_map(leap));
    unlikely(solved).into_iter().chain(leaps).collect()
}

/// Results that are possible but unlikely.
fn unlikely(solved: &Solved) -> Vec<String> {
    let mut warnings = Vec::new();
    if solved.b_sense < 0 {
        warnings.push(
            "the nozzle swings towards +X as B grows on this machine (axes.B sense = -1): see that the signs of touch.b1_deg and b2_deg are right"
                .into(),
        );
    }
    if solved.delta_x_mm.value.abs() > 0.1 * solved.r_mm.value {
        warnings.push(format!(
            "ΔX = {:.3} mm is more than a tenth of R: are the touches and the rod's centre in the same coordinates?",
            solved.delta_x_mm.value
        ));
    }
    if solved.check.is_none() {
        warnings.push(
            "touch.x45_mm is not given: no check touch tells whether a sign, a reading or the rod's diameter is wrong"
                .into(),
        );
    }
    if let Some(check) = solved.check.filter(|c| c.verdict == Verdict::Fail) {
        warnings.push(format!(
            "CHECK FAILED: at B = {:.1}° the nozzle should touch at X = {:.4} mm but touched at {:.4} mm, off by {:+.4} ± {:.4} mm: a sign, a reading or the rod's diameter is wrong; do not use these values",
            check.b_rad.to_degrees(),
            check.predicted_mm,
            check.measured_mm,
            check.difference_mm.value,
            check.difference_mm.u95()
        ));
    }
    let is_off = |c: &Check| c.difference_mm.value.abs() > c.difference_mm.u95();
    if let Some(check) = solved.check.filter(|c| c.verdict == Verdict::Pass && is_off(c)) {
        warnings.push(format!(
            "the check touch is off by {:+.4} ± {:.4} mm: one of twenty is off by more than its interval by chance, and the check fails from {:.4} mm on; touch again before these values are used",
            check.difference_mm.value,
            check.difference_mm.u95(),
            check.limit_mm
        ));
    }
    warnings
}

/// A value that changes by more than machines move. One that the control holds as zero was perhaps never set.
fn leap(v: &Replaced) -> Option<String> {
    (v.now != 0.0 && v.change.abs() > MOST_CHANGE_MM).then(|| {
        format!(
            "{} changes by {:+.4} mm, from {:.4} to {:.4} mm: over {MOST_CHANGE_MM} mm is more likely a mix-up (a sign, X with Y, another machine, other coordinates) than a machine that moved; check [control] and the readings before it is typed in",
            v.name, v.change, v.now, v.new
        )
    })
}
