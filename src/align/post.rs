//! From tool poses on the blank to the machine's joints: nearest solution, limits, singularities, and extra points
//! where a straight move of the joints would leave the path.

use nalgebra::Vector3;

use crate::error::{Error, Result};
use crate::machine::{Chain, Joints, ToolPose};

/// Most halvings of one move: where the tool passes a singular pose at the 1e-7 rad at which it counts as met, a
/// rotary axis turns by half a turn within some 1e-7 of the move.
const DEEPEST: u32 = 32;
/// Most points added in one move.
const MOST_ADDED: usize = 4096;
/// A rotary move longer than this is reported.
const LONG_MOVE_RAD: f64 = 0.5;

/// What happened on the way; line numbers count from 1.
#[derive(Debug, Clone, Default, serde::Serialize, schemars::JsonSchema)]
pub struct Log {
    /// Poses posted.
    pub moves: u64,
    /// Points added so that the path is held.
    pub added: u64,
    /// Poses where a rotary axis may take any value or two solutions meet.
    pub singular: Lines,
    /// Moves that turn a rotary axis by more than 28.6° (0.5 rad).
    pub long_rotary: Lines,
    /// The largest of them.
    pub largest_rotary_deg: f64,
    /// Statements of APT that each machine has its own words for: comments of the NC code.
    pub left_out: Lines,
    /// Moves that leave the path by more than the tolerance in spite of added points.
    pub not_held: Lines,
}

/// A count and the first few line numbers.
#[derive(Debug, Clone, Default, serde::Serialize, schemars::JsonSchema)]
pub struct Lines {
    /// How many.
    pub count: u64,
    /// The first ten.
    pub first_lines: Vec<u64>,
}

impl Lines {
    pub(super) fn add(&mut self, line: u64) {
        self.count += 1;
        if self.first_lines.len() < 10 && self.first_lines.last() != Some(&line) {
            self.first_lines.push(line);
        }
    }
}

/// Posts poses one after the other.
#[derive(Debug)]
pub struct Poster {
    chain: Chain,
    tolerance_mm: f64,
    last: Option<Joints>,
    /// What happened.
    pub log: Log,
}

impl Poster {
    /// For a machine; moves are held within `tolerance_mm`.
    pub fn new(chain: Chain, tolerance_mm: f64) -> Self {
        Self { chain, tolerance_mm, last: None, log: Log::default() }
    }

    /// Where the machine stands.
    pub fn last(&self) -> Option<Joints> {
        self.last
    }

    /// Forgets where the machine stands.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// Joints for the end of a move along `path` (t from 0 to 1), near `hint`; points to go through before it are
    /// put in `through`, each with its t. `held` says whether the path between matters.
    pub fn go(
        &mut self,
        line: u64,
        hint: &Joints,
        held: bool,
        path: impl Fn(f64) -> ToolPose,
        through: &mut Vec<(f64, Joints)>,
    ) -> Result<Joints> {
        through.clear();
        let ends = self.solve(line, &path(1.0), hint)?;
        let mut end = ends[0];
        let turn_to =
            |start: &Joints, q: &Joints| (q[3] - start[3]).abs().max((q[4] - start[4]).abs());
        if let Some(start) = self.last {
            if held && turn_to(&start, &end) > 0.0 {
                // The nearest solution may lie on the branch that the path does not lead to: then the other one.
                let mut reached = false;
                for candidate in &ends {
                    through.clear();
                    if self.split(line, (0.0, &start), (1.0, candidate), &path, DEEPEST, through)? {
                        (end, reached) = (*candidate, true);
                        break;
                    }
                }
                if !reached {
                    through.clear();
                    self.log.not_held.add(line);
                }
            }
            let turn = turn_to(&start, &end);
            if turn > LONG_MOVE_RAD {
                self.log.long_rotary.add(line);
                self.log.largest_rotary_deg = self.log.largest_rotary_deg.max(turn.to_degrees());
            }
        }
        self.log.moves += 1;
        self.log.added += through.len() as u64;
        self.last = Some(end);
        Ok(end)
    }

    /// The joints for a pose within the limits, nearest first.
    fn solve(&mut self, line: u64, pose: &ToolPose, near: &Joints) -> Result<Vec<Joints>> {
        let solutions = self.chain.inverse(pose, near);
        let subject = || format!("line {line}");
        let Some(best) = solutions.first() else {
            return Err(Error::measure(
                subject(),
                "the machine cannot point the tool this way",
                "check the alignment's tilt and the machine file's axes",
            ));
        };
        if let Some(axis) = best.outside {
            return Err(Error::measure(
                subject(),
                format!("axis {axis} would leave its limits"),
                "move the blank, or correct the limits in the machine file",
            ));
        }
        if best.singularity.is_some() {
            self.log.singular.add(line);
        }
        Ok(solutions.iter().filter(|s| s.outside.is_none()).map(|s| s.joints).collect())
    }

    /// Adds the middle where a straight move of the joints leaves the path, and looks at both halves; whether
    /// that holds the path.
    fn split(
        &mut self,
        line: u64,
        from: (f64, &Joints),
        to: (f64, &Joints),
        path: &impl Fn(f64) -> ToolPose,
        depth: u32,
        through: &mut Vec<(f64, Joints)>,
    ) -> Result<bool> {
        let along = |part: f64| -> (f64, Joints) {
            (
                from.0 + part * (to.0 - from.0),
                std::array::from_fn(|i| from.1[i] + part * (to.1[i] - from.1[i])),
            )
        };
        // The middle shows a bow, the quarter an S.
        let off = [0.5, 0.25].into_iter().any(|part| {
            let (t, q) = along(part);
            (self.chain.forward(&q).position_mm - path(t).position_mm).norm() > self.tolerance_mm
        });
        if !off {
            return Ok(true);
        }
        if depth == 0 || through.len() >= MOST_ADDED {
            return Ok(false);
        }
        let (t, near) = along(0.5);
        let ways = self.solve(line, &path(t), &near)?;
        // Between two points of one branch the path stays on it, however near it passes a singular pose: there the
        // other branch may be nearer to the middle of the joints, and a jump to it and back would leave the path.
        let side = self.chain.branch(from.1);
        let one = side * self.chain.branch(to.1) > 0.0;
        let on_it = |q: &&Joints| one && self.chain.branch(q) * side > 0.0;
        let middle = *ways.iter().find(on_it).unwrap_or(&ways[0]);
        if !self.split(line, from, (t, &middle), path, depth - 1, through)? {
            return Ok(false);
        }
        through.push((t, middle));
        self.split(line, (t, &middle), to, path, depth - 1, through)
    }
}

/// The straight path between two poses; the direction turns evenly.
pub fn straight(from: &ToolPose, to: &ToolPose, t: f64) -> ToolPose {
    if t >= 1.0 {
        return *to;
    }
    let mixed = from.direction * (1.0 - t) + to.direction * t;
    let angle = from.direction.cross(&to.direction).norm().atan2(from.direction.dot(&to.direction));
    let direction: Vector3<f64> = if angle < 1e-9 {
        mixed
    } else {
        (from.direction * ((1.0 - t) * angle).sin() + to.direction * (t * angle).sin())
            / angle.sin().max(1e-12)
    };
    ToolPose { position_mm: from.position_mm + (to.position_mm - from.position_mm) * t, direction }
}
