//! `machine.toml`: what the control is told about the machine, and what is known of its faults.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::machine::axis::{Axis, AxisName, Side};
use crate::machine::chain::Chain;
use crate::machine::entered::is_entered;
use crate::{tomlfile, units};

/// A machine file. Lengths in mm, angles in degrees; `docs/machine.md` explains each key.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// Version of the file's form: 1.
    pub schema: u32,
    /// What the user calls it.
    #[serde(default)]
    pub name: String,
    /// +1: a positive C turns the table counter-clockwise seen from above; -1: the other way (ISO 841).
    #[serde(default = "plus_one")]
    pub c_sense: i32,
    /// From the head's rotary axis to the nozzle.
    #[serde(default = "Head::unsaid")]
    pub head: Head,
    /// The table's rotary axis in machine coordinates.
    #[serde(default)]
    pub table: Table,
    /// A point on the table that is observed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<Target>,
    /// Which axis carries which; head B / table C where left out.
    #[serde(default, skip_serializing_if = "Kinematics::is_default")]
    pub kinematics: Kinematics,
    /// Lines, senses and limits of axes where they differ from the usual.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<String, AxisEntry>,
    /// Faults of the machine the control does not know of, by the names of the effects library.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<Effect>,
}

/// `[head]`: the vector from the rotary axis to the nozzle at zero is `(delta_x, 0, -r)`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// From the rotary axis to the optical axis, along X.
    #[serde(default)]
    pub delta_x_mm: f64,
    /// From the rotary axis down to the nozzle's end face.
    #[serde(default = "unsaid", skip_serializing_if = "is_zero")]
    pub r_mm: f64,
    /// From the nozzle's end face down to the tool point (the focus).
    #[serde(default)]
    pub standoff_mm: f64,
}

impl Head {
    fn unsaid() -> Self {
        Self { r_mm: unsaid(), ..Self::default() }
    }
}

/// A head of which nothing is known: no head has its nozzle on the axis.
fn is_zero(r_mm: &f64) -> bool {
    *r_mm == 0.0
}

/// What a file does not say and must, where its machine has it: a number that is no length.
fn unsaid() -> f64 {
    f64::MIN
}

/// `[table]`: the C axis at the table's surface, in machine coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Machine X.
    #[serde(default)]
    pub xc_mm: f64,
    /// Machine Y.
    #[serde(default)]
    pub yc_mm: f64,
    /// Machine Z.
    #[serde(default)]
    pub zc_mm: f64,
}

/// `[target]`: an observed point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// In the table frame.
    pub position_mm: [f64; 3],
}

/// `[kinematics]`: the order of the axes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kinematics {
    /// As ISO 10791-6 writes it: `w` work, the axes that carry it, `b` bed, the axes that carry the
    /// tool, `t` tool.
    pub order: String,
}

impl Default for Kinematics {
    fn default() -> Self {
        Self { order: "w C b X Y Z B t".into() }
    }
}

impl Kinematics {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// `[axes.<letter>]`: one axis where it differs from the usual.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisEntry {
    /// A point of a rotary axis' line at zero: in the table frame for a table axis, from the tool
    /// point for a head axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_mm: Option<[f64; 3]>,
    /// The axis' direction in the machine frame, of any length.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// 1: positive values turn what the axis carries right-handed about its direction; -1: the
    /// other way. For C in the table give `c_sense` instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sense: Option<i32>,
    /// Travel of a linear axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limits_mm: Option<[f64; 2]>,
    /// Travel of a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limits_deg: Option<[f64; 2]>,
}

/// `[[effects]]`: one fault and its size; the effects library gives the names their meaning, or the entry itself has formulas.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Effect {
    /// The library's name, or any other with formulas.
    pub name: String,
    /// The kind of data that formulas are of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    /// What it adds to each output of such data, mm: formulas of columns and parameters (`docs/diagnose.md`).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub outputs: BTreeMap<String, String>,
    /// Parameters by name, with the unit in the name.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// Half-widths of the parameters' 95 % intervals, where they were measured.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters_u95: BTreeMap<String, f64>,
}

fn plus_one() -> i32 {
    1
}

impl Machine {
    /// Head B, table C (the machine of the RTCP method): head vector and C axis at zero until set.
    pub fn head_b_table_c(head: Head, table: Table) -> Self {
        Self {
            schema: 1,
            name: String::new(),
            c_sense: 1,
            head,
            table,
            target: None,
            kinematics: Kinematics::default(),
            axes: BTreeMap::new(),
            effects: Vec::new(),
        }
    }

    /// Table A under table C; the A axis lies `offset_mm` from the C axis along Y and `below_mm`
    /// under the table surface.
    pub fn table_a_c(offset_mm: f64, below_mm: f64) -> Self {
        Self::preset("w C A b X Y Z t", &[("A", [0.0, offset_mm, -below_mm])])
    }

    /// Head C that carries head B; both axes meet `pivot_mm` above the tool point.
    pub fn head_c_b(pivot_mm: f64) -> Self {
        let point = [0.0, 0.0, pivot_mm];
        Self::preset("w b X Y Z C B t", &[("B", point), ("C", point)])
    }

    fn preset(order: &str, points: &[(&str, [f64; 3])]) -> Self {
        let mut machine = Self::head_b_table_c(Head::default(), Table::default());
        machine.kinematics.order = order.into();
        for &(name, point) in points {
            let entry = AxisEntry { point_mm: Some(point), ..AxisEntry::default() };
            machine.axes.insert(name.into(), entry);
        }
        machine
    }

    /// Reads and checks a machine file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::checked(path, tomlfile::read(path)?, true)
    }

    /// As [`Machine::read`], for what does not depend on where the head's rotary axis is: R may be missing.
    pub fn read_without_head(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::checked(path, tomlfile::read(path)?, false)
    }

    /// As [`Machine::read`], from text; `path` is only the name used in messages.
    pub fn parse(path: impl AsRef<Path>, text: &str) -> Result<Self> {
        let path = path.as_ref();
        Self::checked(path, tomlfile::parse(path, text)?, true)
    }

    /// Lengths that look as if they were in another unit than mm.
    pub fn doubts(&self) -> Vec<String> {
        let Head { delta_x_mm, r_mm, .. } = self.head;
        let r = units::pivot("the machine's head.r_mm", r_mm);
        r.or_else(|| units::beside("the machine's head.delta_x_mm", delta_x_mm, r_mm))
            .into_iter()
            .collect()
    }

    /// What a user should know where an observed point is not named.
    pub fn without_target(&self) -> Option<String> {
        self.target.is_none().then(|| {
            "the machine file has no [target]: it is taken to lie on the C axis at the table's surface, \
             which hides effects that grow with its radius and height"
                .into()
        })
    }

    fn checked(path: &Path, mut machine: Self, needs_head: bool) -> Result<Self> {
        let named = |(field, reason, fix)| Error::field(path, None, field, reason, fix);
        // A head that does not turn, or whose axes' lines are given, needs no R.
        let in_head = machine.kinematics.order.split('b').nth(1).unwrap_or("");
        let turns = |name: char| {
            in_head.contains(name)
                && machine.axes.get(&name.to_string()).is_none_or(|a| a.point_mm.is_none())
        };
        let is_said = machine.head.r_mm != unsaid();
        let is_needed = needs_head && ['A', 'B'].into_iter().any(turns);
        if is_needed && (!is_said || machine.head.r_mm == 0.0) {
            let reason =
                if is_said { "is 0: the nozzle would be on the axis" } else { "is missing" };
            return Err(named((
                "head.r_mm".to_owned(),
                reason.to_owned(),
                "give R in mm, from the head's rotary axis down to the nozzle's end face: [head] r_mm = 214.7",
            )));
        }
        if !is_said {
            machine.head.r_mm = 0.0;
        }
        machine.check().map_err(named)?;
        machine.chain().map_err(|e| {
            Error::file(path, format!("does not describe a machine: {e}"), "correct the file")
        })?;
        Ok(machine)
    }

    /// The text of the file.
    pub fn to_toml(&self) -> String {
        // These plain structures always serialise.
        toml::to_string(self).unwrap_or_default()
    }

    /// What a result that is made from [`Machine::chain`] does not hold.
    pub fn effects_left_out(&self) -> Option<String> {
        let names: Vec<&str> = self.effects.iter().map(|e| e.name.as_str()).collect();
        (!names.is_empty()).then(|| {
            format!(
                "the machine's errors ([[effects]]: {}) are not in these numbers: they are what [head] and [table] say",
                names.join(", ")
            )
        })
    }

    /// This machine's numbers in what else a file says of the same machine: its target, travel, and the errors that numbers of the
    /// control do not stand for.
    pub fn within(&self, old: &Self) -> Self {
        let mut new =
            Self { head: self.head, table: self.table, c_sense: self.c_sense, ..old.clone() };
        if !self.name.is_empty() {
            new.name = self.name.clone();
        }
        for (letter, axis) in &mut new.axes {
            axis.sense = self.axes.get(letter).and_then(|a| a.sense);
        }
        for (letter, axis) in &self.axes {
            new.axes.entry(letter.clone()).or_insert(*axis);
        }
        new.effects.retain(|e| !is_entered(e));
        new
    }

    /// What of a file is more than the numbers of its head and table, in words; none where nothing is.
    pub fn more_than_numbers(&self) -> Option<String> {
        let parts = [
            (self.target.is_some(), "[target]"),
            (
                self.axes.values().any(|a| a.limits_mm.or(a.limits_deg).is_some()),
                "limits of [axes]",
            ),
            (!self.effects.is_empty(), "[[effects]]"),
        ];
        let there: Vec<&str> = parts.iter().filter(|p| p.0).map(|p| p.1).collect();
        (!there.is_empty()).then(|| there.join(", "))
    }

    /// The chain the control believes in: the numbers of the file, without its effects.
    pub fn chain(&self) -> Result<Chain> {
        let wrong = |reason: String| {
            Error::measure("kinematics.order", reason, "write it like \"w C b X Y Z B t\"")
        };
        let letters: Vec<char> =
            self.kinematics.order.chars().filter(|c| !c.is_whitespace()).collect();
        let bed = letters.iter().position(|&c| c == 'b');
        let (Some('w'), Some('t'), Some(bed), 8) =
            (letters.first(), letters.last(), bed, letters.len())
        else {
            return Err(wrong(format!(
                "'{}' needs w, b, t and five axes between them",
                self.kinematics.order
            )));
        };
        let mut axes = Vec::with_capacity(5);
        for (i, &letter) in
            letters.iter().enumerate().filter(|&(i, _)| i != 0 && i != bed && i != 7)
        {
            let name = AxisName::from_letter(letter)
                .ok_or_else(|| wrong(format!("'{letter}' is no axis")))?;
            axes.push(self.axis(name, if i < bed { Side::Table } else { Side::Head })?);
        }
        let axes: [Axis; 5] =
            axes.try_into().map_err(|_| wrong("needs exactly five axes".into()))?;
        for name in self.axes.keys() {
            if !axes.iter().any(|a| a.name.to_string() == *name) {
                return Err(wrong(format!("has no axis for the section [axes.{name}]")));
            }
        }
        Chain::new(axes, self.table_point())
    }

    /// The table frame's origin at zero, in the machine frame.
    pub fn table_point(&self) -> Vector3<f64> {
        Vector3::new(self.table.xc_mm, self.table.yc_mm, self.table.zc_mm)
    }

    /// The observed target in the table frame; the origin where the file names none.
    pub fn target_point(&self) -> Vector3<f64> {
        self.target.map_or_else(Vector3::zeros, |t| Vector3::from(t.position_mm))
    }

    /// From the head's rotary axis to the tool point at zero: `(ΔX, 0, -(R + s))`.
    pub fn head_vector(&self) -> Vector3<f64> {
        Vector3::new(self.head.delta_x_mm, 0.0, -(self.head.r_mm + self.head.standoff_mm))
    }

    /// Sense of B: 1 where a positive B turns the nozzle towards -X, -1 where towards +X.
    pub fn b_sense(&self) -> f64 {
        f64::from(self.axes.get("B").and_then(|b| b.sense).unwrap_or(1))
    }

    fn axis(&self, name: AxisName, side: Side) -> Result<Axis> {
        let entry = self.axes.get(&name.to_string()).copied().unwrap_or_default();
        let direction = entry.direction.map_or_else(|| name.direction(), Vector3::from);
        let mut axis = if name.is_rotary() {
            let table_c = name == AxisName::C && side == Side::Table;
            let sense = entry.sense.unwrap_or(if table_c { self.c_sense } else { 1 });
            let point = match (side, entry.point_mm) {
                (Side::Head, Some(p)) => Vector3::from(p),
                (Side::Head, None) => -self.head_vector(),
                (Side::Table, p) => {
                    self.table_point() + p.map_or_else(Vector3::zeros, Vector3::from)
                }
            };
            Axis::rotary(name, side, f64::from(sense), direction, point)?
        } else {
            Axis::linear(name, side, direction)?
        };
        if let Some(limits) = entry.limits_mm {
            axis.limits = limits;
        }
        if let Some(limits) = entry.limits_deg {
            axis.limits = limits.map(f64::to_radians);
        }
        Ok(axis)
    }
}
