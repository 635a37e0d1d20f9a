//! Siemens 840D, mixed kinematics: the orientable tool carrier `$TC_CARR` and the machine data of
//! transformation type 56.
//!
//! The pairing of I1..I4 with both sets, and I1 = -I2, I4 = -I3 for fixed-mounted machines, are
//! from the commissioning manual (SINUMERIK Operate IM9, "Swivel head + swivel table"); so is that
//! a table's axis direction is reversed.

use std::fmt::Write;

use super::{Export, Parameter, header};
use crate::machine::Machine;

/// I1..I4, V1, V2: name, first index of `$TC_CARR`, machine data number and name, meaning.
const VECTORS: [(&str, usize, u32, &str, &str); 6] = [
    ("I1", 1, 24560, "$MC_TRAFO5_JOINT_OFFSET_1", "closes the tool side, I1 = -I2"),
    ("I2", 4, 24550, "$MC_TRAFO5_BASE_TOOL_1", "from the nozzle to the B axis"),
    ("I3", 15, 24558, "$MC_TRAFO5_JOINT_OFFSET_PART_1", "from the machine reference to the C axis"),
    ("I4", 18, 24500, "$MC_TRAFO5_PART_OFFSET_1", "closes the table side, I4 = -I3"),
    ("V1", 7, 24570, "$MC_TRAFO5_AXIS1_1", "direction of B, which turns the tool"),
    ("V2", 10, 24572, "$MC_TRAFO5_AXIS2_1", "direction of C, reversed because it turns the table"),
];

pub(super) fn export(machine: &Machine) -> Export {
    let (dx, r) = (machine.head.delta_x_mm, machine.head.r_mm);
    let c = machine.table_point();
    let vectors = [
        [dx, 0.0, -r],
        [-dx, 0.0, r],
        [c.x, c.y, c.z],
        [-c.x, -c.y, -c.z],
        [0.0, machine.b_sense(), 0.0],
        [0.0, 0.0, -f64::from(machine.c_sense)],
    ];
    let parameter = |name: String, k: usize, i: usize, meaning: &str| {
        let meaning = format!("{} {}: {meaning}", VECTORS[k].0, ['x', 'y', 'z'][i]);
        if k < 4 {
            Parameter::mm(name, vectors[k][i], meaning)
        } else {
            // What the maker's text leaves open is which way round counts as positive.
            Parameter::code(name, vectors[k][i], meaning).unconfirmed()
        }
    };
    let mut carrier = Vec::new();
    let mut data = vec![Parameter::code(
        "MD24100 $MC_TRAFO_TYPE_1",
        56.0,
        "mixed kinematics: the tool and the table turn",
    )];
    for (k, &(_, first, number, name, meaning)) in VECTORS.iter().enumerate() {
        for i in 0..3 {
            carrier.push(parameter(format!("$TC_CARR{}[1]", first + i), k, i, meaning));
            data.push(parameter(format!("MD{number} {name}[{i}]"), k, i, meaning));
        }
    }
    let note = format!(
        "; R ends at the nozzle: the stand-off of {:.4} mm belongs into the tool length ($TC_DP3)\n",
        machine.head.standoff_mm
    );
    let mut first = comment(machine, "Siemens 840D, orientable tool carrier 1");
    first += &note;
    for p in &carrier {
        let _ = writeln!(first, "{}={} ; {}", p.name, p.text(), p.comment());
    }
    first += "$TC_CARR23[1]=\"M\" ; kinematics: tool and part turn\nM17\n";
    let mut second = comment(machine, "Siemens 840D, machine data of the five-axis transformation");
    second += &note;
    for p in &data {
        let _ =
            writeln!(second, "{}={} ; {}", p.name.replacen("MD", "N", 1), p.text(), p.comment());
    }
    second += "M17\n";
    carrier.extend(data);
    Export {
        parameters: carrier,
        files: vec![("tool_carrier.spf".into(), first), ("machine_data.tea".into(), second)],
    }
}

fn comment(machine: &Machine, what: &str) -> String {
    header(machine, what).iter().map(|l| format!("; {l}\n")).collect()
}
