//! Corrects a rotary axis' pitch-error table from RTCP deviations.
//!
//! With RTCP on, an angle error ε of the axis moves the tool point by `L tan ε` along its circle, `L` being
//! the distance from the axis to the tool point. So `ε = atan(deviation / L)`, and the table entry becomes
//! `comp_new = comp_old - ε`: a positive entry adds to the commanded angle. `L` is measured, never assumed:
//! the rounded shop rule "0.01 mm = 0.001°" holds at L = 573 mm only.

mod astray;
mod copies;
pub mod curve;
pub mod export;
mod report;
pub mod simulate;
mod sweep;

pub use report::{Flag, Report, Row, Rule, Summary};
pub use sweep::{Direction, Group, Noise, Sweep};

use crate::error::{Error, Result, above_zero};
use crate::uncertainty::{K95, Verdict};
use crate::units;

/// Pitch errors of real axes are far smaller, deg.
const MOST_ERROR_DEG: f64 = 1.0;

/// Degrees of correction per millimetre of the shop rule "0.01 mm = 0.001°".
pub const PRINTED_RULE_DEG_PER_MM: f64 = 0.1;

/// What the correction needs to know besides the sweep.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Distance from the rotary axis to the tool point, measured.
    pub pivot_mm: f64,
    /// Its standard uncertainty; 0 leaves it out, with a warning.
    pub pivot_u_mm: f64,
    /// Deviations at or under this are left alone.
    pub dead_band_mm: f64,
    /// Standard uncertainty of one reading. `None`: taken from repeated runs, or else from the curve's roughness.
    pub noise_mm: Option<f64>,
    /// The axis turns without end: angles are taken modulo 360°.
    pub modulo: bool,
    /// -1 where the table read in counts the other way (a positive entry moves the axis in its negative
    /// direction, as on Siemens controls); results are always in the sense +1.
    pub comp_sense: f64,
    /// The old table's entries are steps from one angle to the next instead of absolute values.
    pub incremental: bool,
    /// Where the old incremental table is zero.
    pub reference_deg: f64,
    /// Largest deviation allowed, where the sweep is to be judged.
    pub tolerance_mm: Option<f64>,
}

impl Options {
    /// The defaults for a pivot length: no dead band, noise from the data, an absolute table.
    pub fn new(pivot_mm: f64) -> Self {
        Self {
            pivot_mm,
            pivot_u_mm: 0.0,
            dead_band_mm: 0.0,
            noise_mm: None,
            modulo: false,
            comp_sense: 1.0,
            incremental: false,
            reference_deg: 0.0,
            tolerance_mm: None,
        }
    }

    fn validate(&self) -> Result<()> {
        let fix = "give the measured distance from the rotary axis to the tool point in mm";
        above_zero("--pivot-mm", self.pivot_mm, fix)?;
        if let Some(limit) = self.tolerance_mm {
            above_zero("--tolerance-mm", limit, "give a length in mm")?;
        }
        for (option, value) in [
            ("--pivot-u-mm", self.pivot_u_mm),
            ("--dead-band-mm", self.dead_band_mm),
            ("--noise-mm", self.noise_mm.unwrap_or(0.0)),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::option(
                    option,
                    format!("{value} is out of range"),
                    "give 0 or more",
                ));
            }
        }
        if self.pivot_u_mm > 0.2 * self.pivot_mm {
            return Err(Error::option(
                "--pivot-u-mm",
                format!("{} is more than a fifth of L = {}", self.pivot_u_mm, self.pivot_mm),
                "measure L better; both are in mm",
            ));
        }
        if self.comp_sense.abs() != 1.0 {
            return Err(Error::option("--comp-sense", "is neither 1 nor -1", "give 1 or -1"));
        }
        if !self.reference_deg.is_finite() {
            return Err(Error::option("--reference-deg", "is not finite", "give an angle"));
        }
        Ok(())
    }
}

/// Turns a sweep of deviations into angle errors and a new table.
pub fn correct(sweep: &Sweep, options: &Options) -> Result<Report> {
    options.validate()?;
    let mut warnings = sweep.warnings.clone();
    let length = options.pivot_mm;
    warnings.extend(units::pivot("--pivot-mm", length));
    warnings.extend(units::limit("--dead-band-mm", options.dead_band_mm));
    warnings.extend(options.tolerance_mm.and_then(|mm| units::limit("--tolerance-mm", mm)));
    let error_deg = |mm: f64| (mm / length).atan().to_degrees();
    if let Some(bad) = sweep.groups.iter().find(|g| error_deg(g.mean_mm).abs() > MOST_ERROR_DEG) {
        return Err(Error::measure(
            format!("{:.3}°", bad.angle_deg),
            format!(
                "a mean deviation of {:.4} mm is no pitch error at L = {length} mm: it is {:.2}°, over {MOST_ERROR_DEG}°",
                bad.mean_mm,
                error_deg(bad.mean_mm)
            ),
            "check the units: both must be in mm",
        ));
    }
    if options.pivot_u_mm == 0.0 {
        warnings.push("the uncertainty of L is not in the result: give --pivot-u-mm".to_owned());
    }
    let noise = sweep.noise(options.noise_mm);
    warnings.extend(noise.warning());

    let old = sweep.old_table(options)?;
    let mut rows = Vec::with_capacity(sweep.groups.len());
    for (group, comp_old_deg) in sweep.groups.iter().zip(old) {
        let y = group.mean_mm;
        let error_deg = error_deg(y);
        let in_dead_band = y.abs() <= options.dead_band_mm + 1e-9;
        let comp_new_deg = if in_dead_band { comp_old_deg } else { comp_old_deg - error_deg };
        let deviation_u95_mm = noise.u95_of_mean(group.readings);
        // A wrong L makes the correction wrong in proportion.
        let by_length_mm =
            if in_dead_band { 0.0 } else { K95 * y.abs() * options.pivot_u_mm / length };
        // ∂ε/∂y = L / (L² + y²), ∂ε/∂L = -y / (L² + y²).
        let scale = 1.0 / (length * length + y * y);
        let from_length = (y * options.pivot_u_mm * scale).to_degrees();
        let error_u95_deg =
            deviation_u95_mm.map(|u| (length * u * scale).to_degrees().hypot(K95 * from_length));
        // The next reading scatters by itself around what is left.
        let predicted_u95_mm =
            deviation_u95_mm.map(|u| u.hypot(noise.u95_of_next()).hypot(by_length_mm));
        let mut flags = Vec::new();
        if in_dead_band {
            flags.push(Flag::DeadBand);
        }
        if error_u95_deg.is_some_and(|u| error_deg.abs() < u) {
            flags.push(Flag::WithinNoise);
        }
        let left_deg = error_deg + comp_new_deg - comp_old_deg;
        rows.push(Row {
            angle_deg: group.angle_deg,
            dir: group.dir,
            readings: group.readings,
            deviation_mm: y,
            deviation_u95_mm,
            error_deg,
            error_u95_deg,
            comp_old_deg,
            comp_new_deg,
            predicted_deviation_mm: length * left_deg.to_radians().tan(),
            predicted_u95_mm,
            flags,
        });
    }
    let summary = Summary::of(&rows, options, &noise);
    let judge = |limit| match summary.before_max_u95_mm {
        Some(u95) => Verdict::of(summary.before_max_mm, u95, limit),
        None => Verdict::Undecided,
    };
    Ok(Report {
        tolerance_mm: options.tolerance_mm,
        verdict: options.tolerance_mm.map(judge),
        summary,
        rows,
        modulo: options.modulo,
        warnings,
    })
}
