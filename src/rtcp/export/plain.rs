//! A plain sheet: the numbers, what they mean, and the formula to check them with.

use std::fmt::Write;

use super::{Export, Parameter, header};
use crate::machine::Machine;

pub(super) fn export(machine: &Machine) -> Export {
    let (head, c) = (machine.head, machine.table_point());
    let parameters = vec![
        Parameter::mm("delta_x", head.delta_x_mm, "from the B axis to the optical axis, along X"),
        Parameter::mm("r", head.r_mm, "from the B axis to the nozzle's end face"),
        Parameter::mm("standoff", head.standoff_mm, "from the nozzle's end face to the tool point"),
        Parameter::mm("xc", c.x, "C axis, machine X"),
        Parameter::mm("yc", c.y, "C axis, machine Y"),
        Parameter::mm("zc", c.z, "table surface, machine Z"),
        Parameter::code(
            "b_sense",
            machine.b_sense(),
            "1: a positive B turns the nozzle towards -X",
        ),
        Parameter::code(
            "c_sense",
            f64::from(machine.c_sense),
            "1: a positive C turns the table counter-clockwise",
        ),
    ];
    let mut text = header(machine, "Machine sheet").join("\n") + "\n\n";
    for p in &parameters {
        let _ = writeln!(text, "{:<9} {:>12} {:<3} {}", p.name, p.text(), p.unit, p.meaning);
    }
    let v = [head.delta_x_mm, 0.0, -head.r_mm];
    let _ = writeln!(text, "\nI1 = ({:.4}, {:.4}, {:.4})   I2 = -I1", v[0], v[1], v[2]);
    let _ = writeln!(text, "I3 = ({:.4}, {:.4}, {:.4})   I4 = -I3", c.x, c.y, c.z);
    text += "\nTo hold the table point p at B, C:\n";
    text += "  (X, Y, Z) = (xc, yc, zc) + Rz(c_sense C) p - (Ry(b_sense B) - 1) (delta_x, 0, -(r + standoff))\n";
    Export { parameters, files: vec![("sheet.txt".into(), text)] }
}
