//! A machine's numbers as each control wants them: names, units, signs, and how sure it is that
//! they mean that.
//!
//! One file per control. A value whose meaning is not confirmed from the maker's own text is
//! written with a comment that says so.

mod fanuc;
mod heidenhain;
mod linuxcnc;
mod plain;
mod siemens;

use crate::error::{Error, Result};
use crate::machine::{Kinematics, Machine};

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

/// One parameter that differs between two machines: name, old value, new value.
pub type Difference = (Parameter, f64, f64);

/// The parameters that change when `new` replaces `old`, by more than the export's last decimal.
pub fn differences(old: &Export, new: &Export) -> Vec<Difference> {
    let of_old = |name: &str| old.parameters.iter().find(|p| p.name == name);
    new.parameters
        .iter()
        .filter_map(|p| of_old(&p.name).map(|o| (p.clone(), o.value, p.value)))
        .filter(|(_, o, n)| (o - n).abs() >= 0.5e-4)
        .collect()
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
