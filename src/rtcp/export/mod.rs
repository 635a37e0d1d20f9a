//! A machine's numbers as each control wants them: names, units, signs, and how sure it is that
//! they mean that.
//!
//! One file per control. A value whose meaning is not confirmed from the maker's own text is
//! written with a comment that says so.

mod changes;
mod fanuc;
mod heidenhain;
mod linuxcnc;
mod plain;
mod siemens;

pub use changes::{Change, Changes, Line, changes};

use crate::error::{Error, Result};
use crate::machine::{Kinematics, Machine, entered};

/// The controls there is an export for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Control {
    /// Siemens 840D: orientable tool carrier and transformation machine data
    Siemens,
    /// Fanuc 30i: tool centre point control parameters
    Fanuc,
    /// Heidenhain iTNC 530: kinematics description table
    Heidenhain,
    /// LinuxCNC: ini and hal files for maxkins, runnable without hardware
    Linuxcnc,
    /// A plain sheet for people
    Sheet,
}

/// How far the meaning of a parameter is confirmed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Confidence {
    /// The maker's own text says so, or the control was run with it.
    Confirmed,
    /// Name or sign not confirmed: try it with care.
    Unconfirmed,
}

/// One value for the control.
#[derive(Debug, Clone, PartialEq, serde::Serialize, schemars::JsonSchema)]
pub struct Parameter {
    /// As the control names it.
    pub name: String,
    /// The value; integers are written without decimals.
    pub value: f64,
    /// `mm`, or empty for a code.
    pub unit: &'static str,
    /// What it is here.
    pub meaning: String,
    /// Whether that is sure.
    pub confidence: Confidence,
}

impl Parameter {
    fn mm(name: impl Into<String>, value: f64, meaning: impl Into<String>) -> Self {
        // Adding zero turns -0 into 0.
        let (name, meaning) = (name.into(), meaning.into());
        Self { name, value: value + 0.0, unit: "mm", meaning, confidence: Confidence::Confirmed }
    }

    fn code(name: impl Into<String>, value: f64, meaning: impl Into<String>) -> Self {
        Self { unit: "", ..Self::mm(name, value, meaning) }
    }

    fn unconfirmed(self) -> Self {
        Self { confidence: Confidence::Unconfirmed, ..self }
    }

    /// The value as the control reads it.
    pub fn text(&self) -> String {
        if self.unit.is_empty() {
            format!("{:.0}", self.value)
        } else {
            format!("{:.4}", (1e4 * self.value).round() / 1e4 + 0.0)
        }
    }

    /// The meaning, with a warning where it is not confirmed.
    fn comment(&self) -> String {
        match self.confidence {
            Confidence::Confirmed => self.meaning.clone(),
            Confidence::Unconfirmed => format!("NOT CONFIRMED: {}", self.meaning),
        }
    }
}

/// What to load into or type at a control.
#[derive(Debug, Clone, PartialEq)]
pub struct Export {
    /// The values, one by one.
    pub parameters: Vec<Parameter>,
    /// File names and contents.
    pub files: Vec<(String, String)>,
}

/// The machine for a control. Only head B / table C machines have exports.
pub fn export(machine: &Machine, control: Control) -> Result<Export> {
    let moved = machine.axes.iter().any(|(_, a)| a.point_mm.is_some() || a.direction.is_some());
    if machine.kinematics != Kinematics::default() || moved {
        return Err(Error::measure(
            format!("machine '{}'", machine.name),
            "is not a plain head B / table C machine",
            "export knows that kind alone so far; use the vectors of the machine file by hand",
        ));
    }
    Ok(match control {
        Control::Siemens => siemens::export(machine),
        Control::Fanuc => fanuc::export(machine),
        Control::Heidenhain => heidenhain::export(machine),
        Control::Linuxcnc => linuxcnc::export(machine),
        Control::Sheet => plain::export(machine),
    })
}

/// A machine file's numbers for a control, and what is to be said of them.
#[derive(Debug, Clone)]
pub struct Report {
    /// The machine with the numbers its effects correct entered.
    pub machine: Machine,
    /// Its numbers for the control.
    pub export: Export,
    /// What was entered, what is left out, what is not confirmed.
    pub warnings: Vec<String>,
}

/// As [`export()`], with what the machine file's effects correct entered first.
///
/// # Errors
/// As [`export()`].
pub fn entered_export(machine: &Machine, control: Control) -> Result<Report> {
    let (machine, folded) = entered(machine);
    let export = export(&machine, control)?;
    let mut warnings = machine.doubts();
    warnings.extend(folded.iter().map(|e| {
        format!(
            "{} is {:.4} here, {:.4} in the machine file: its effect {} is entered",
            e.key, e.new_mm, e.now_mm, e.effect
        )
    }));
    warnings.extend(machine.effects_left_out());
    let all = export.parameters.len();
    let unconfirmed =
        export.parameters.iter().filter(|p| p.confidence == Confidence::Unconfirmed).count();
    if unconfirmed > 0 {
        warnings.push(format!(
            "{unconfirmed} of {all} values are marked NOT CONFIRMED: check them against the control's manual"
        ));
    }
    Ok(Report { machine, export, warnings })
}

/// The lines every file begins with, without the comment sign.
fn header(machine: &Machine, what: &str) -> Vec<String> {
    vec![
        format!(
            "{what}, for machine '{}'",
            machine.name.replace(|c: char| c.is_control() || "()%;".contains(c), " ")
        ),
        format!("written by pivotsight {}", env!("CARGO_PKG_VERSION")),
        "Lengths in mm. X, Y, Z say where the head is relative to the table, as in ISO 841.".into(),
        "After loading, hold a point at B = 90 and B = -90: a wrong sign shows as twice delta_x."
            .into(),
    ]
}
