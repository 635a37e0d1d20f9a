//! Fanuc 30i: parameters of tool centre point control for five-axis machining, mixed type.
//!
//! 19680, 19681, 19684, 19686 and 19709-19711 (with the points D and E, and the holder offset
//! 19666) are described in the maker's additional manual A-79348E; the others are marked.

use std::fmt::Write;

use super::{Export, Parameter, header};
use crate::machine::Machine;

pub(super) fn export(machine: &Machine) -> Export {
    let left_handed = |sense: f64| f64::from(u8::from(sense < 0.0));
    let c = machine.table_point();
    let head = machine.head;
    let mut parameters = vec![
        Parameter::code(
            "19680",
            21.0,
            "mixed type: first rotary axis turns the tool, second the table",
        ),
        Parameter::code("19681", 4.0, "controlled-axis number of B where the axes are X Y Z B C"),
        Parameter::code("19682", 2.0, "B turns about Y; 1 is X, 2 Y, 3 Z").unconfirmed(),
        Parameter::code(
            "19684",
            left_handed(machine.b_sense()),
            "sense of B: 0 right-handed, 1 left-handed",
        ),
        Parameter::code("19686", 5.0, "controlled-axis number of C where the axes are X Y Z B C"),
        Parameter::code("19687", 3.0, "C turns about Z; 1 is X, 2 Y, 3 Z").unconfirmed(),
        Parameter::code(
            "19689",
            left_handed(f64::from(machine.c_sense)),
            "sense of the table's own turning: 0 right-handed, 1 left-handed",
        )
        .unconfirmed(),
        Parameter::code("19697", 3.0, "reference tool axis direction: +Z").unconfirmed(),
        Parameter::mm("19666", head.r_mm, "tool holder offset: R, nozzle to B axis along the tool"),
    ];
    let table = ["19700", "19701", "19702"];
    for (i, name) in table.into_iter().enumerate() {
        let meaning = format!(
            "rotary table position {}: the C axis in machine coordinates",
            ['X', 'Y', 'Z'][i]
        );
        parameters.push(Parameter::mm(name, c[i], meaning).unconfirmed());
    }
    let offset = ["19709", "19710", "19711"];
    for (i, name) in offset.into_iter().enumerate() {
        let value = if i == 0 { -head.delta_x_mm } else { 0.0 };
        let meaning = format!(
            "{} of the vector from the tool axis to the B axis at B = 0",
            ['X', 'Y', 'Z'][i]
        );
        parameters.push(Parameter::mm(name, value, meaning));
    }
    let mut text = String::from("%\n");
    for line in header(machine, "Fanuc 30i, tool centre point control") {
        let _ = writeln!(text, "({})", line);
    }
    let _ = writeln!(
        text,
        "(R ends at the nozzle: the tool length offset is the stand-off, {:.4} mm)",
        head.standoff_mm
    );
    for p in &parameters {
        let _ = writeln!(text, "N{}P{} ({})", p.name, p.text(), p.comment());
    }
    text += "%\n";
    Export { parameters, files: vec![("parameters.txt".into(), text)] }
}
