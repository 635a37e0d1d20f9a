//! Heidenhain iTNC 530: the kinematics description table.
//!
//! The columns, and that the sequence starts at the tool reference point, are from the technical
//! manual (iTNC 530 HSCI); the signs of the transformations are not confirmed on a control.

use std::fmt::Write;

use super::{Export, Parameter, header};
use crate::machine::Machine;

pub(super) fn export(machine: &Machine) -> Export {
    let (head, c) = (machine.head, machine.table_point());
    let parameters = vec![
        Parameter::mm("Trans X (head)", -head.delta_x_mm, "from the nozzle to the B axis")
            .unconfirmed(),
        Parameter::mm("Trans Z (head)", head.r_mm, "from the nozzle to the B axis").unconfirmed(),
        Parameter::mm("Trans X (table)", c.x, "from the machine datum to the C axis").unconfirmed(),
        Parameter::mm("Trans Y (table)", c.y, "from the machine datum to the C axis").unconfirmed(),
        Parameter::mm("Trans Z (table)", c.z, "from the machine datum to the table surface")
            .unconfirmed(),
    ];
    let trans = |i: usize, axis: char| ("Trans", axis, Some(&parameters[i]));
    let rows = [
        ("ToolAxis", 'Z', None),
        trans(0, 'X'),
        trans(1, 'Z'),
        ("MachAxis", 'B', None),
        ("MachAxis", 'Z', None),
        ("MachAxis", 'Y', None),
        ("MachAxis", 'X', None),
        ("MachBase", ' ', None),
        trans(2, 'X'),
        trans(3, 'Y'),
        trans(4, 'Z'),
        ("MachAxis", 'C', None),
    ];
    let mut text = String::new();
    for line in header(machine, "Heidenhain iTNC 530, kinematics description") {
        let _ = writeln!(text, "; {line}");
    }
    let _ = writeln!(
        text,
        "; R ends at the nozzle: the tool length is the stand-off, {:.4} mm",
        head.standoff_mm
    );
    let _ = writeln!(
        text,
        "; B turns {} about Y, the table turns {} about Z for a positive C: check the axes' signs in the control",
        hand(machine.b_sense()),
        hand(f64::from(machine.c_sense))
    );
    let _ = writeln!(
        text,
        "; cycle 451 measures the same chain with a probe and states its own uncertainty: compare"
    );
    let _ = writeln!(text, "{:<4}{:<10}{:<6}{:>14}  DOC", "NR", "KEY", "AXIS", "COORD");
    for (i, (key, axis, parameter)) in rows.iter().enumerate() {
        let (coordinate, doc) =
            parameter.map_or((String::new(), String::new()), |p| (p.text(), p.comment()));
        let _ = writeln!(text, "{i:<4}{key:<10}{axis:<6}{coordinate:>14}  {doc}");
    }
    Export { parameters, files: vec![("kinematics.txt".into(), text)] }
}

fn hand(sense: f64) -> &'static str {
    if sense > 0.0 { "right-handed" } else { "left-handed" }
}
