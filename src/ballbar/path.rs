//! Paths on which the bar keeps its length: positions, equal steps along the arc, G-code.

use std::fmt::Write;

use crate::error::{Error, Result};

/// The lengths of a set-up; the defaults are the source's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    /// Length of the bar.
    pub bar_mm: f64,
    /// From the B axis to the tool ball.
    pub pivot_mm: f64,
    /// Base ball under the B axis at zero: how far below.
    pub below_mm: f64,
}

impl Default for Setup {
    fn default() -> Self {
        Self { bar_mm: 400.0, pivot_mm: 400.0, below_mm: 800.0 }
    }
}

impl Setup {
    /// Whether the lengths are lengths.
    pub fn validate(&self) -> Result<()> {
        for (option, v) in [
            ("--bar-mm", self.bar_mm),
            ("--pivot-mm", self.pivot_mm),
            ("--below-mm", self.below_mm),
        ] {
            if !(v.is_finite() && (1.0..1e5).contains(&v)) {
                return Err(Error::option(
                    option,
                    format!("{v} is no length in mm"),
                    "give 1 to 100000",
                ));
            }
        }
        Ok(())
    }
}

/// Which linear axis moves with B.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Z and B: the source's.
    Zb,
    /// X and B, Z still: sees the B axis without the Z axis.
    Xb,
}

/// A path: what moves, and where the base cup is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// What moves.
    pub kind: Kind,
    /// Base cup off the plane of motion.
    pub cup_y_mm: f64,
    /// With a shifted cup: the same bar and a smaller motion; otherwise the same motion and a longer bar.
    pub keep_bar: bool,
}

/// The part of a path that is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// First B angle.
    pub from_deg: f64,
    /// Last B angle.
    pub to_deg: f64,
    /// Number of equal steps along the arc.
    pub steps: usize,
}

/// Where the axes are at one point of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// B angle.
    pub b_rad: f64,
    /// X position.
    pub x_mm: f64,
    /// Z position, up; the source's Z is its negative.
    pub up_mm: f64,
}

impl Pose {
    /// The tool ball's place: X, up.
    fn tool_mm(&self, setup: &Setup) -> [f64; 2] {
        let (sin, cos) = self.b_rad.sin_cos();
        [self.x_mm - setup.pivot_mm * sin, self.up_mm - setup.pivot_mm * cos]
    }

    /// How far the tool ball goes to another pose.
    fn apart_mm(&self, other: &Self, setup: &Setup) -> f64 {
        let (a, b) = (self.tool_mm(setup), other.tool_mm(setup));
        (b[0] - a[0]).hypot(b[1] - a[1])
    }
}

impl Path {
    /// The source's path.
    pub const SOURCE: Self = Self { kind: Kind::Zb, cup_y_mm: 0.0, keep_bar: false };

    /// Reads `zb`, `xb`, with the base cup's shift in Y `zb-y150`, `xb-y-80` (the same motion, a longer bar) or `zbk-y150`,
    /// `xbk-y-80` (the same bar, another motion).
    pub fn parse(name: &str) -> Result<Self> {
        let fail = || {
            Error::option(
                format!("path '{name}'"),
                "is not known",
                "write zb or xb, with the base cup's shift in Y as in zb-y150 or (same bar) zbk-y150",
            )
        };
        let (kind, shift) = match name.split_once("-y") {
            Some((kind, y)) => (kind, y.parse::<f64>().map_err(|_| fail())?),
            None => (name, 0.0),
        };
        let (kind, keep_bar) = match kind {
            "zb" => (Kind::Zb, false),
            "zbk" => (Kind::Zb, true),
            "xb" => (Kind::Xb, false),
            "xbk" => (Kind::Xb, true),
            _ => return Err(fail()),
        };
        if !(shift.is_finite() && shift.abs() < 1e5) {
            return Err(fail());
        }
        Ok(Self { kind, cup_y_mm: shift, keep_bar })
    }

    /// The name [`Path::parse`] reads.
    pub fn name(&self) -> String {
        let kind = if self.kind == Kind::Zb { "zb" } else { "xb" };
        let keep = if self.keep_bar { "k" } else { "" };
        match self.cup_y_mm {
            0.0 => kind.to_owned(),
            y => format!("{kind}{keep}-y{y}"),
        }
    }

    /// Length of the bar this path needs.
    pub fn bar_mm(&self, setup: &Setup) -> f64 {
        if self.keep_bar { setup.bar_mm } else { setup.bar_mm.hypot(self.cup_y_mm) }
    }

    /// The axes at a B angle; `None` where the bar does not reach.
    pub fn pose(&self, setup: &Setup, b_rad: f64) -> Option<Pose> {
        let (sin, cos) = b_rad.sin_cos();
        let (bar2, r) = (self.bar_mm(setup).powi(2) - self.cup_y_mm.powi(2), setup.pivot_mm);
        match self.kind {
            // (R sin)² + y² + (below - Z - R cos)² = L²
            Kind::Zb => {
                let rest = bar2 - (r * sin).powi(2);
                let up_mm = r * cos + rest.sqrt() - setup.below_mm;
                (rest > 0.0).then_some(Pose { b_rad, x_mm: 0.0, up_mm })
            }
            Kind::Xb => {
                let up_mm = 1.25 * r - setup.below_mm;
                let rest = bar2 - (1.25 * r - r * cos).powi(2);
                (rest > 0.0).then(|| Pose { b_rad, x_mm: r * sin + rest.sqrt(), up_mm })
            }
        }
    }

    /// `steps + 1` poses from one angle to another with equal distances between tool points: at equal times, constant speed.
    pub fn plan(&self, setup: &Setup, range: Range) -> Result<Vec<Pose>> {
        let Range { from_deg, to_deg, steps } = range;
        setup.validate()?;
        if !(1..=100_000).contains(&steps)
            || !from_deg.is_finite()
            || !to_deg.is_finite()
            || from_deg == to_deg
        {
            return Err(Error::option(
                "--from-deg, --to-deg, --steps",
                "make no path",
                "give two angles and 1 to 100000 steps",
            ));
        }
        let fine = 16 * steps;
        let angle =
            |i: usize| (from_deg + (to_deg - from_deg) * i as f64 / fine as f64).to_radians();
        let mut lengths = Vec::with_capacity(fine + 1);
        let mut last: Option<Pose> = None;
        let mut total = 0.0;
        for i in 0..=fine {
            let pose = self.pose(setup, angle(i)).ok_or_else(|| {
                Error::measure(
                    format!("path {}", self.name()),
                    format!(
                        "the bar of {} mm does not reach at B = {:.2}°",
                        setup.bar_mm,
                        angle(i).to_degrees()
                    ),
                    "give a smaller range of B, a longer bar or a smaller shift of the cup",
                )
            })?;
            total += last.map_or(0.0, |before| before.apart_mm(&pose, setup));
            lengths.push(total);
            last = Some(pose);
        }
        let mut poses = Vec::with_capacity(steps + 1);
        for k in 0..=steps {
            let wanted = total * k as f64 / steps as f64;
            let i = lengths.partition_point(|&l| l < wanted).clamp(1, fine);
            let part = (wanted - lengths[i - 1]) / (lengths[i] - lengths[i - 1]);
            let b = angle(i - 1) + (angle(i) - angle(i - 1)) * part;
            poses.extend(self.pose(setup, b));
        }
        Ok(poses)
    }
}

/// How far the tool ball goes from one pose of a plan to the next.
pub fn step_mm(setup: &Setup, poses: &[Pose]) -> f64 {
    poses.windows(2).next().map_or(0.0, |p| p[0].apart_mm(&p[1], setup))
}

/// By how much the bar's length may change between two blocks, where the axes go straight.
const CHORD_MM: f64 = 0.0005;

impl Path {
    /// The poses with further ones between them, so that the axes, going straight from each to the next, keep the bar's length; with each
    /// the part of a step's time that it takes to get there.
    fn driven(&self, setup: &Setup, poses: &[Pose]) -> Vec<(Pose, f64)> {
        let mut list: Vec<(Pose, f64)> = poses.first().map(|p| (*p, 0.0)).into_iter().collect();
        for pair in poses.windows(2) {
            self.drive(setup, [pair[0], pair[1]], 1.0, &mut list);
        }
        list
    }

    fn drive(&self, setup: &Setup, [from, to]: [Pose; 2], part: f64, list: &mut Vec<(Pose, f64)>) {
        /// No step is parted more finely.
        const LEAST_PART: f64 = 1.0 / 65_536.0;
        let half = |a: f64, b: f64| 0.5 * (a + b);
        let straight = Pose {
            b_rad: half(from.b_rad, to.b_rad),
            x_mm: half(from.x_mm, to.x_mm),
            up_mm: half(from.up_mm, to.up_mm),
        };
        let [x, up] = straight.tool_mm(setup);
        let length = x.hypot(up + setup.below_mm).hypot(self.cup_y_mm);
        let leaves = (length - self.bar_mm(setup)).abs() > CHORD_MM && part > LEAST_PART;
        match self.pose(setup, straight.b_rad).filter(|_| leaves) {
            // Half of the way of B is half of the time: no axis jumps.
            Some(middle) => {
                self.drive(setup, [from, middle], 0.5 * part, list);
                self.drive(setup, [middle, to], 0.5 * part, list);
            }
            None => list.push((to, part)),
        }
    }
}

/// G-code of a path there and back, in inverse time so that the tool ball keeps its speed. `zero_mm` is where the machine's
/// X and Z stand at the path's zero (B axis above the base cup).
pub fn gcode(
    path: &Path,
    setup: &Setup,
    poses: &[Pose],
    feed_mm_min: f64,
    zero_mm: [f64; 2],
) -> String {
    let driven = path.driven(setup, poses);
    let step_mm = step_mm(setup, poses);
    let mut out = format!(
        "(ball bar path {}: {} points, {step_mm:.4} mm apart at {feed_mm_min} mm/min)\nG90 G94\n",
        path.name(),
        poses.len()
    );
    if driven.len() > poses.len() {
        let more = driven.len() - poses.len();
        let _ = writeln!(out, "({more} blocks between them, where the axes would leave the arc)");
    }
    let words = |p: &Pose| {
        format!(
            "X{:.4} Z{:.4} B{:.4}",
            zero_mm[0] + p.x_mm + 0.0,
            zero_mm[1] + p.up_mm + 0.0,
            p.b_rad.to_degrees() + 0.0
        )
    };
    if let Some((first, _)) = driven.first() {
        let _ = writeln!(out, "G1 {} F500\nM0 (mount the bar)\nG93", words(first));
    }
    let there = driven.windows(2).map(|p| (p[1].0, p[1].1));
    let back = driven.windows(2).rev().map(|p| (p[0].0, p[1].1));
    for (to, part) in there.chain(back) {
        let _ = writeln!(out, "G1 {} F{:.4}", words(&to), feed_mm_min / (step_mm * part));
    }
    out.push_str("G94\nM30\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// On every path the axes go straight from block to block, and the bar keeps its length all the way.
    #[test]
    fn programs_keep_the_bars_length_between_their_points() {
        let setup = Setup::default();
        for (name, steps) in [("zb", 600), ("xb", 600), ("xbk-y150", 60), ("zbk-y150", 60)] {
            let path = Path::parse(name).unwrap();
            let range = Range { from_deg: 0.0, to_deg: -60.0, steps };
            let poses = path.plan(&setup, range).unwrap();
            let code = gcode(&path, &setup, &poses, 500.0, [0.0, 0.0]);
            let number = |line: &str, letter: char| -> f64 {
                line.split(' ').find_map(|w| w.strip_prefix(letter)?.parse().ok()).unwrap()
            };
            let at = |line: &str| ['X', 'Z', 'B'].map(|letter| number(line, letter));
            let rows: Vec<[f64; 3]> =
                code.lines().filter(|l| l.starts_with("G1")).map(at).collect();
            // Steps of 0.7 mm need hardly any blocks between them, of 7 mm some nine each.
            assert!(rows.len() < 1300, "{name}: {} blocks", rows.len());
            for pair in rows.windows(2) {
                for part in [0.25, 0.5, 0.75] {
                    let [x, z, b]: [f64; 3] =
                        std::array::from_fn(|i| pair[0][i] + part * (pair[1][i] - pair[0][i]));
                    let (sin, cos) = b.to_radians().sin_cos();
                    let (x, up) = (x - 400.0 * sin, z - 400.0 * cos + 800.0);
                    let off = x.hypot(up).hypot(path.cup_y_mm) - path.bar_mm(&setup);
                    assert!(off.abs() < 0.001, "{name}: {off} mm at B = {b}");
                }
            }
        }
    }

    #[test]
    fn the_source_path_has_its_steps() {
        let setup = Setup::default();
        let poses =
            Path::SOURCE.plan(&setup, Range { from_deg: 0.0, to_deg: -60.0, steps: 600 }).unwrap();
        assert_eq!(poses.len(), 601);
        for pair in poses.windows(2) {
            let tool = |p: &Pose| [p.x_mm - 400.0 * p.b_rad.sin(), p.up_mm - 400.0 * p.b_rad.cos()];
            let (a, b) = (tool(&pair[0]), tool(&pair[1]));
            assert!(
                ((a[0] - b[0]).hypot(a[1] - b[1]) - 400.0 * std::f64::consts::PI / 1800.0).abs()
                    < 1e-6
            );
            assert!((pair[0].up_mm + 800.0 * (1.0 - pair[0].b_rad.cos())).abs() < 1e-9);
        }
        assert!((poses[600].up_mm + 400.0).abs() < 1e-9);
    }
}
