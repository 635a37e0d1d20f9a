//! Poses through the machine's kinematics, as `rtcp` turns them: tool points into machine coordinates and back.

use std::path::Path;

use nalgebra::Vector3;

use crate::error::{Error, Result};
use crate::machine::{AxisName, Chain, Machine, ToolPose};
use crate::table::Table;
use crate::units;

/// Which way poses are turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Way {
    /// Tool points in the table frame → machine coordinates that hold them there
    Inverse,
    /// Machine coordinates → tool points in the table frame
    Forward,
}

/// The answer: rows under their columns' names.
#[derive(Debug, Clone, PartialEq)]
pub struct Poses {
    /// The columns, `..._mm` and `..._deg`; which they are depends on the machine's rotary axes and on the way.
    pub names: Vec<String>,
    /// A row a pose, or one a solution.
    pub rows: Vec<Row>,
    /// Units that look wrong, poses out of reach, and what of the machine file is not in the answer.
    pub warnings: Vec<String>,
}

/// Counts, then numbers, then a note.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Pose and solution from 1 on; none where each pose has one answer.
    pub counts: Vec<usize>,
    /// Lengths in mm, angles in degrees.
    pub numbers: Vec<f64>,
    /// What is special about a solution.
    pub note: Option<String>,
}

/// Turns the poses of a CSV: `x_mm,y_mm,z_mm` and the machine's two rotary axes (`b_deg,c_deg`) give one answer each; towards the machine
/// `x_mm,y_mm,z_mm` and the tool's direction `i,j,k` give all solutions.
///
/// # Errors
/// A table with other columns, cells that are no numbers, a direction of no length.
pub fn turn(machine: &Machine, poses: &Path, way: Way) -> Result<Poses> {
    let chain = machine.chain()?;
    let rotary = chain.rotary_names().map(AxisName::column_deg);
    let optional = [rotary[0].as_str(), &rotary[1], "i", "j", "k"];
    let table = Table::read(poses, &["x_mm", "y_mm", "z_mm"], &optional)?;
    let directed = way == Way::Inverse && table.has("i");
    let needed = if directed { &optional[2..] } else { &optional[..2] };
    for name in &optional {
        let either = format!("give {},{} or i,j,k, not both", rotary[0], rotary[1]);
        let (reason, fix) = match (needed.contains(name), table.has(name)) {
            (true, false) => ("is missing", "add the column"),
            (false, true) => ("does not go with the others", either.as_str()),
            _ => continue,
        };
        let field = format!("column '{name}'");
        return Err(Error::field(poses, None, field, reason, fix));
    }
    let mut turned = if directed {
        all_solutions(&chain, &table, &rotary)?
    } else {
        one_by_one(&chain, &table, &rotary, way)?
    };
    turned.warnings.extend(machine.doubts());
    turned.warnings.extend(machine.effects_left_out());
    Ok(turned)
}

/// The rotary axes are given: one answer a pose.
fn one_by_one(chain: &Chain, table: &Table, rotary: &[String; 2], way: Way) -> Result<Poses> {
    let output = match way {
        Way::Inverse => ["jx_mm", "jy_mm", "jz_mm"],
        Way::Forward => ["px_mm", "py_mm", "pz_mm"],
    };
    let input = ["x_mm", "y_mm", "z_mm", &rotary[0], &rotary[1]];
    let mut rows = Vec::with_capacity(table.rows());
    let mut outside = 0;
    for r in 0..table.rows() {
        let mut pose = [0.0; 5];
        for (value, name) in pose.iter_mut().zip(input) {
            *value = table.number(r, name)?;
        }
        let [x, y, z, a, b] = pose;
        let turned = [a.to_radians(), b.to_radians()];
        let (joints, result) = match way {
            Way::Inverse => {
                let q = chain.inverse_at(&Vector3::new(x, y, z), turned);
                (q, [q[0], q[1], q[2]])
            }
            Way::Forward => {
                let q = [x, y, z, turned[0], turned[1]];
                (q, chain.forward(&q).position_mm.into())
            }
        };
        outside += usize::from(chain.outside(&joints).is_some());
        let numbers = pose.into_iter().chain(result).collect();
        rows.push(Row { counts: Vec::new(), numbers, note: None });
    }
    let mut warnings = Vec::new();
    for name in rotary {
        warnings.extend(units::angles(name, &table.column(name)?));
    }
    warnings.extend(out_of_limits(outside, rows.len()));
    let names = input.into_iter().chain(output).map(str::to_owned).collect();
    Ok(Poses { names, rows, warnings })
}

/// A count of the poses that the axes do not reach.
fn out_of_limits(outside: usize, poses: usize) -> Option<String> {
    (outside > 0).then(|| format!("{outside} of {poses} poses lie outside the axes' limits"))
}

/// The tool's direction is given: a row for each solution, with the turns nearest to the last pose's.
fn all_solutions(chain: &Chain, table: &Table, rotary: &[String; 2]) -> Result<Poses> {
    let given = ["x_mm", "y_mm", "z_mm", "i", "j", "k"];
    let mut rows = Vec::new();
    let (mut unreachable, mut outside) = (0, 0);
    let mut near = [0.0; 5];
    for r in 0..table.rows() {
        let mut pose = [0.0; 6];
        for (value, name) in pose.iter_mut().zip(given) {
            *value = table.number(r, name)?;
        }
        let [x, y, z, i, j, k] = pose;
        let direction = Vector3::new(i, j, k);
        if !ToolPose::is_direction(&direction) {
            let reason = format!("the length of i, j, k is {:.6}", direction.norm());
            let fix =
                "give the tool's direction, from the tool point up the tool, as a unit vector";
            return Err(table.error(r, "i", reason, fix));
        }
        let position_mm = Vector3::new(x, y, z);
        let solutions = chain.inverse(&ToolPose { position_mm, direction }, &near);
        unreachable += usize::from(solutions.is_empty());
        // Those within the limits come first.
        outside += usize::from(solutions.first().is_some_and(|s| s.outside.is_some()));
        near = solutions.first().map_or(near, |s| s.joints);
        for (n, s) in solutions.iter().enumerate() {
            let [jx, jy, jz, a, b] = s.joints;
            let numbers = vec![jx, jy, jz, a.to_degrees(), b.to_degrees()];
            let mut notes: Vec<String> = s.singularity.iter().map(ToString::to_string).collect();
            notes.extend(s.outside.map(|axis| format!("{axis} outside its limits")));
            rows.push(Row { counts: vec![r + 1, n + 1], numbers, note: Some(notes.join("; ")) });
        }
    }
    let mut warnings = Vec::new();
    if unreachable > 0 {
        let all = table.rows();
        warnings
            .push(format!("{unreachable} of {all} directions are out of the rotary axes' reach"));
    }
    warnings.extend(out_of_limits(outside, table.rows()));
    let [a, b] = rotary;
    let names = ["pose", "solution", "jx_mm", "jy_mm", "jz_mm", a, b, "note"];
    Ok(Poses { names: names.map(str::to_owned).to_vec(), rows, warnings })
}
