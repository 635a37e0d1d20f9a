//! The sweep to measure: which poses, in which order, and the program that drives through them.
//!
//! Angles are irregular, so that no error over one axis looks like another; the order is mixed, so
//! that drift does not look like an error over the angle; both directions of approach occur; every
//! second pose is repeated at once, which shows the noise.

use std::fmt::Write;
use std::path::Path;

use crate::error::{Error, Result};
use crate::machine::{AxisName, Chain, Machine, Side};
use crate::rtcp::export::Control;

/// How far before a pose its approach begins, so that its direction is sure.
const RUN_UP_DEG: f64 = 4.0;

/// The rotary axes' angles in degrees, and the directions they are approached in (+1 or -1).
pub type Pose = ([f64; 2], [f64; 2]);

/// A sweep to drive through.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The rotary axes, in the order of the machine's joints.
    pub axes: [AxisName; 2],
    /// In the order to drive to them.
    pub poses: Vec<Pose>,
    /// Whether C alone turns the table.
    c_alone: bool,
}

impl Plan {
    /// `count` different poses (C over a turn, other axes within ±90°, all within their limits), every second one twice.
    ///
    /// # Errors
    /// An axis whose limits leave no room for poses and the run-up to them.
    pub fn new(chain: &Chain, count: usize) -> Result<Self> {
        let axes = chain.rotary_names();
        let [first, second] = axes.map(|axis| range(chain, axis));
        let (first, second) = (first?, second?);
        // Multiples of the golden ratio and of √2, without their whole parts, fill each range evenly
        // and never repeat.
        let steps = [0.618_033_988_749_895, std::f64::consts::SQRT_2 - 1.0];
        let mut poses = Vec::new();
        for i in 0..count {
            let at = |k: usize, [low, high]: [f64; 2]| {
                let part = (0.5 + steps[k] * (i + 1) as f64).fract();
                ((low + (high - low) * part) * 100.0).round() / 100.0
            };
            // All four pairs of directions, among the poses that are repeated, too.
            let side = |minus: bool| if minus { -1.0 } else { 1.0 };
            let pair = i / 2;
            let ways = [side(pair % 2 == 1), side((pair / 2 + i) % 2 == 1)];
            let pose = ([at(0, first), at(1, second)], ways);
            poses.push(pose);
            if i % 2 == 1 {
                poses.push(pose);
            }
        }
        let on_table = chain.axes().iter().filter(|a| a.name.is_rotary() && a.side == Side::Table);
        let c_alone = on_table.map(|a| a.name).eq([AxisName::C]);
        Ok(Self { axes, poses, c_alone })
    }

    /// The poses as CSV, ready to have `dx_mm,dy_mm,dz_mm` added.
    pub fn csv(&self) -> String {
        let [a, b] = self.axes.map(AxisName::column_deg);
        let mut text = format!("{a},{b},dir_{},dir_{}\n", &a[..1], &b[..1]);
        for ([b, c], [db, dc]) in &self.poses {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{b:.2},{c:.2},{db:.0},{dc:.0}");
        }
        text
    }

    /// The program that holds `target_mm` (table frame) in every pose. Workpiece zero: the table frame's, the C axis at the table surface
    /// where C turns the table alone.
    pub fn gcode(&self, target_mm: [f64; 3], control: Control) -> String {
        let [x, y, z] = target_mm;
        let [first, second] = self.axes.map(AxisName::letter);
        let conversational = control == Control::Heidenhain;
        let note = |text: &str| match control {
            Control::Siemens | Control::Heidenhain => format!("; {text}\n"),
            _ => format!("({text})\n"),
        };
        let turn = |[b, c]: [f64; 2]| {
            if conversational {
                format!("L X{x:+.4} Y{y:+.4} Z{z:+.4} {first}{b:+.3} {second}{c:+.3} F2000\n")
            } else {
                format!("G1 X{x:.4} Y{y:.4} Z{z:.4} {first}{b:.3} {second}{c:.3} F2000\n")
            }
        };
        let (begin, wait, end) = match control {
            Control::Siemens => ("G71 G90 G54\nTRAORI\n", "G4 F2\n", "TRAFOOF\nM30\n"),
            Control::Heidenhain => (
                "BEGIN PGM SWEEP MM\nM128\n",
                "CYCL DEF 9.0 DWELL TIME\nCYCL DEF 9.1 DWELL 2\n",
                "M129\nEND PGM SWEEP MM\n",
            ),
            Control::Fanuc => ("%\nO1000\nG21 G90 G54\nG43.4 H1\n", "G4 P2000\n", "G49\nM30\n%\n"),
            Control::Linuxcnc | Control::Sheet => ("G21 G90 G54\n", "G4 P2\n", "M2\n"),
        };
        let mut text = begin.to_owned();
        let zero = match self.c_alone {
            true => "C axis at the table surface",
            false => "the machine file's table frame",
        };
        text += &note(&format!("Workpiece zero: {zero}. Watch the first run at low feed."));
        for (i, &([b, c], [db, dc])) in self.poses.iter().enumerate() {
            text += &note(&format!("pose {} of {}", i + 1, self.poses.len()));
            text += &turn([b - db * RUN_UP_DEG, c - dc * RUN_UP_DEG]);
            text += &turn([b, c]);
            text += wait;
        }
        text + end
    }
}

/// A sweep to measure, ready to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct Suggested {
    /// How many poses, those that are repeated included.
    pub poses: usize,
    /// How many of them are repeats.
    pub repeats: usize,
    /// Names and contents: the poses as a table, and the program that drives through them.
    pub files: [(&'static str, String); 2],
}

/// The sweep of `count` different poses about the target of a machine whose file is `path`.
///
/// # Errors
/// A machine without a target, a count that is no sweep's, and as [`Plan::new`].
pub fn suggest(
    machine: &Machine,
    path: &Path,
    count: usize,
    control: Control,
) -> Result<Suggested> {
    let Some(target) = machine.target else {
        let fix =
            "say where the target stands: [target] position_mm = [x, y, z] in the table frame";
        return Err(Error::field(path, None, "target", "is missing", fix));
    };
    if !(4..=10_000).contains(&count) {
        return Err(Error::option("--poses", format!("is {count}"), "give 4 to 10000"));
    }
    let plan = Plan::new(&machine.chain()?, count)?;
    let files = [("poses.csv", plan.csv()), ("sweep.nc", plan.gcode(target.position_mm, control))];
    Ok(Suggested { poses: plan.poses.len(), repeats: plan.poses.len() - count, files })
}

/// What of its range an axis can be sent to with a run-up to either side; one that counts from elsewhere is shown as much
/// of a turn.
fn range(chain: &Chain, name: AxisName) -> Result<[f64; 2]> {
    let [low, high] = if name == AxisName::C { [0.0, 360.0] } else { [-90.0, 90.0] };
    let limits = chain.axis(name).map_or([low, high], |a| a.limits.map(f64::to_degrees));
    let run = RUN_UP_DEG + 1.0;
    let (least, most) = (limits[0] + run, limits[1] - run);
    let start = if name == AxisName::C { low.min(most - (high - low)).max(least) } else { low };
    let [from, to] = [start.max(least), (start + high - low).min(most)];
    if from >= to {
        return Err(Error::measure(
            "plan",
            format!(
                "{name:?} has no room for poses: its limits are {:.1}° and {:.1}°, and each is driven to from {RUN_UP_DEG}° beside it",
                limits[0], limits[1]
            ),
            "widen the axis' limits in the machine file, or measure with your own poses",
        ));
    }
    Ok([from, to])
}
