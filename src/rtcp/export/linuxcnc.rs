//! LinuxCNC: an ini and a hal file for `maxkins` (head B / table C) that run without hardware.
//!
//! maxkins has the C axis at its XY origin and the B axis `pivot-length` above the tool point; the
//! offset ΔX goes in through the U axis, which is parked at -ΔX. A positive C turns the table
//! clockwise (`c_sense = -1`). A positive B turns the nozzle towards +X (B sense -1) in Debian 12's
//! package; newer versions have the pin `conventional-directions`, which turns that round.
//! `tools/linuxcnc-check` compares the joints of the real control with this program's.

use std::fmt::Write;

use super::{Confidence, Export, Parameter, header};
use crate::machine::Machine;

/// Axis letter, joint number, travel, speed and acceleration (mm or degrees, per second).
const JOINTS: [(char, usize, [f64; 2], f64); 9] = [
    ('X', 0, [-2000.0, 2000.0], 500.0),
    ('Y', 1, [-2000.0, 2000.0], 500.0),
    ('Z', 2, [-2000.0, 2000.0], 500.0),
    ('A', 3, [-360.0, 360.0], 360.0),
    ('B', 4, [-180.0, 180.0], 360.0),
    ('C', 5, [-36000.0, 36000.0], 360.0),
    ('U', 6, [-50.0, 50.0], 50.0),
    ('V', 7, [-50.0, 50.0], 50.0),
    ('W', 8, [-50.0, 50.0], 50.0),
];

pub(super) fn export(machine: &Machine) -> Export {
    let head = machine.head;
    let (b, c) = (machine.b_sense(), f64::from(machine.c_sense));
    let mut conventional = Parameter::code(
        "maxkins.conventional-directions",
        f64::from(u8::from(b > 0.0)),
        format!("a positive B turns the nozzle towards {}X", if b > 0.0 { '-' } else { '+' }),
    );
    if c > 0.0 {
        conventional.meaning =
            "maxkins turns the table clockwise for a positive C, this machine the other way: \
                                give the C motor the other direction and programs the other sign"
                .into();
        conventional.confidence = Confidence::Unconfirmed;
    }
    let parameters = vec![
        Parameter::mm(
            "maxkins.pivot-length",
            head.r_mm + head.standoff_mm,
            "B axis to tool point, R + stand-off",
        ),
        Parameter::mm("[JOINT_6]HOME", -head.delta_x_mm, "U is parked at -delta_x"),
        conventional,
    ];
    Export {
        files: vec![
            ("pivotsight.ini".into(), ini(machine)),
            ("pivotsight.hal".into(), hal(machine, &parameters)),
        ],
        parameters,
    }
}

fn comment(machine: &Machine, what: &str) -> String {
    header(machine, what).iter().map(|l| format!("# {l}\n")).collect()
}

fn ini(machine: &Machine) -> String {
    let mut t = comment(machine, "LinuxCNC, maxkins");
    let c = machine.table_point();
    let _ = writeln!(
        t,
        "# World zero is the C axis at the table surface. Joint 0 reads X - xc - delta_x, joint 1 Y - yc, joint 2 Z - zc,\n\
         # with xc = {:.4}, yc = {:.4}, zc = {:.4}, delta_x = {:.4}: set HOME_OFFSET of a real machine accordingly.",
        c.x, c.y, c.z, machine.head.delta_x_mm
    );
    t += "
[EMC]
MACHINE = pivotsight
VERSION = 1.1

[DISPLAY]
# Headless: commands come over a socket. For a screen write axis instead.
DISPLAY = linuxcncrsh

[TASK]
TASK = milltask
CYCLE_TIME = 0.001

[RS274NGC]
PARAMETER_FILE = pivotsight.var

[EMCMOT]
EMCMOT = motmod
SERVO_PERIOD = 1000000

[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1

[HAL]
HALFILE = pivotsight.hal

[KINS]
KINEMATICS = maxkins
JOINTS = 9

[TRAJ]
COORDINATES = X Y Z A B C U V W
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 50
MAX_LINEAR_VELOCITY = 500
DEFAULT_ANGULAR_VELOCITY = 90
MAX_ANGULAR_VELOCITY = 360
";
    let limits = |letter: char, usual: [f64; 2]| {
        let entry = machine.axes.get(&letter.to_string());
        entry.and_then(|e| e.limits_deg.or(e.limits_mm)).unwrap_or(usual)
    };
    for (letter, joint, usual, speed) in JOINTS {
        let [low, high] = limits(letter, usual);
        let home = if letter == 'U' { 0.0 - machine.head.delta_x_mm } else { 0.0 };
        // U has to reach the place where it is parked.
        let [low, high] = [low.min(home), high.max(home)];
        // World coordinates and joints differ for X, Y, Z, so an axis' limits cannot be its joint's.
        let [axis_low, axis_high] = if joint < 3 { usual } else { [low, high] };
        let kind = if matches!(letter, 'A' | 'B' | 'C') { "ANGULAR" } else { "LINEAR" };
        let acceleration = 4.0 * speed;
        let _ = write!(
            t,
            "\n[AXIS_{letter}]\nMIN_LIMIT = {axis_low}\nMAX_LIMIT = {axis_high}\nMAX_VELOCITY = {speed}\nMAX_ACCELERATION = {acceleration}\n\
             \n[JOINT_{joint}]\nTYPE = {kind}\nMIN_LIMIT = {low}\nMAX_LIMIT = {high}\nMAX_VELOCITY = {speed}\nMAX_ACCELERATION = {acceleration}\n\
             FERROR = 5\nMIN_FERROR = 5\nHOME = {home}\nHOME_OFFSET = {home}\nHOME_SEARCH_VEL = 0\nHOME_LATCH_VEL = 0\nHOME_SEQUENCE = 0\n"
        );
    }
    t
}

fn hal(machine: &Machine, parameters: &[Parameter]) -> String {
    let mut t = comment(machine, "LinuxCNC, maxkins, every joint looped back");
    t += "loadrt [KINS]KINEMATICS\n\
          loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS\n\
          addf motion-command-handler servo-thread\n\
          addf motion-controller servo-thread\n";
    let [pivot, _, conventional] = parameters else { return t };
    let _ = writeln!(t, "# {}\nsetp {} {:.6}", pivot.comment(), pivot.name, pivot.value);
    let _ = writeln!(t, "# {}", conventional.comment());
    if conventional.value > 0.0 {
        t += "# needs a LinuxCNC with this pin; Debian 12's package has none and turns the other way\n";
        let _ = writeln!(t, "setp {} 1", conventional.name);
    }
    for (_, joint, _, _) in JOINTS {
        let _ =
            writeln!(t, "net joint{joint} joint.{joint}.motor-pos-cmd joint.{joint}.motor-pos-fb");
    }
    t += "net estop-loop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in\n\
          net tool-prepare iocontrol.0.tool-prepare iocontrol.0.tool-prepared\n\
          net tool-change iocontrol.0.tool-change iocontrol.0.tool-changed\n";
    t
}
