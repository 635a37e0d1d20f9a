//! The new table as text for a control.
//!
//! Senses: a result's entry adds to the commanded angle. Siemens counts the other way ("a positive
//! compensation value causes the axis to move in the negative direction", Function Manual K3), LinuxCNC's
//! trim and Fanuc's pulses count the same way; each file says which sense it is written in.

use std::fmt::Write;

use super::curve::Curve;
use super::{Direction, Report, Row};
use crate::error::{Error, Result, above_zero};

/// For which control a table is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Control {
    /// `angle_deg,comp_deg` or `angle_deg,comp_plus_deg,comp_minus_deg`
    Csv,
    /// SINUMERIK `$AA_ENC_COMP` archive
    Siemens,
    /// FANUC stored pitch error data (No. 10000 and up) with its parameters
    Fanuc,
    /// LinuxCNC `COMP_FILE` of type 1
    Linuxcnc,
}

/// How a table is written.
#[derive(Debug, Clone)]
pub struct Options {
    /// The control.
    pub control: Control,
    /// The axis' name there.
    pub axis: String,
    /// The axis' number (FANUC).
    pub axis_number: u32,
    /// The least step of an entry: 0.0001° suits most controls.
    pub resolution_deg: f64,
    /// Distance between table points; `None`: the smallest measured step.
    pub step_deg: Option<f64>,
    /// CSV entries are steps from one angle to the next.
    pub incremental: bool,
    /// FANUC: number of the table point at the reference angle.
    pub reference_point: u32,
    /// FANUC: the reference position's angle.
    pub reference_deg: f64,
}

/// Even grid with the values of one direction, or of both.
struct Grid {
    angles: Vec<f64>,
    up: Vec<f64>,
    down: Option<Vec<f64>>,
}

impl Grid {
    fn of(report: &Report, options: &Options) -> Result<Self> {
        let both =
            Curve::of(report, Some(Direction::Up)).zip(Curve::of(report, Some(Direction::Down)));
        if let Some((up, down)) = both {
            let angles = up.grid(options.step_deg)?;
            let values = |c: &Curve| angles.iter().map(|&a| c.at(a)).collect();
            return Ok(Self { up: values(&up), down: Some(values(&down)), angles });
        }
        let only = [None, Some(Direction::Up), Some(Direction::Down)]
            .into_iter()
            .find_map(|d| Curve::of(report, d))
            .ok_or_else(|| {
                Error::measure("table", "the sweep has no rows", "measure some angles")
            })?;
        let angles = only.grid(options.step_deg)?;
        Ok(Self { up: angles.iter().map(|&a| only.at(a)).collect(), down: None, angles })
    }

    fn step(&self) -> f64 {
        if self.angles.len() > 1 { self.angles[1] - self.angles[0] } else { 0.0 }
    }

    /// Which point is the reference position.
    fn at_reference(&self, options: &Options) -> Option<usize> {
        self.angles.iter().position(|a| (a - options.reference_deg).abs() < 1e-6 * self.step())
    }

    /// What a table of steps for each direction leaves out: how far these are apart at the reference position, degrees. None where it holds values, or one
    /// direction.
    fn lost_in_steps(&self, options: &Options) -> Option<f64> {
        let down = self
            .down
            .as_ref()
            .filter(|_| options.control == Control::Csv && options.incremental)?;
        self.at_reference(options).map(|at| down[at] - self.up[at])
    }

    /// Mean of (down - up), degrees; none where directions are not told.
    fn reversal(&self) -> Option<f64> {
        let down = self.down.as_ref()?;
        Some(down.iter().zip(&self.up).map(|(d, u)| d - u).sum::<f64>() / down.len() as f64)
    }

    /// FANUC: entries are whole numbers from -7 to 7 of this many detection units.
    fn magnification(&self, options: &Options) -> f64 {
        let columns = std::iter::once(&self.up).chain(&self.down);
        let steps = columns.flat_map(|v| v.windows(2).map(|w| (w[1] - w[0]).abs()));
        let largest = steps.fold(0.0, f64::max);
        (largest / options.resolution_deg / 7.0 - 1e-9).ceil().max(1.0)
    }

    /// The table as the control holds it.
    fn in_steps(mut self, options: &Options) -> Self {
        let r = options.resolution_deg;
        match options.control {
            Control::Csv | Control::Linuxcnc => {
                // Steps of both directions begin at one zero.
                if let (Some(lost), Some(down)) = (self.lost_in_steps(options), &mut self.down) {
                    down.iter_mut().for_each(|v| *v -= lost);
                }
                self.each(|v| rounded(v, r));
            }
            Control::Siemens => {
                // One table for both directions; the mean reversal is a machine datum of its own.
                if let (Some(reversal), Some(down)) = (self.reversal(), &mut self.down) {
                    let half = 0.5 * rounded(reversal, r);
                    for (u, d) in self.up.iter_mut().zip(down) {
                        let mean = rounded(0.5 * (*u + *d), r);
                        (*u, *d) = (mean - half, mean + half);
                    }
                } else {
                    self.each(|v| rounded(v, r));
                }
            }
            Control::Fanuc => {
                let unit = self.magnification(options) * r;
                let zero = self.at_reference(options).map_or(0.0, |at| self.up[at]);
                self.each(|v| zero + rounded(v - zero, unit));
            }
        }
        self
    }

    fn each(&mut self, change: impl Fn(f64) -> f64) {
        self.up.iter_mut().chain(self.down.iter_mut().flatten()).for_each(|v| *v = change(*v));
    }

    fn ends(&self) -> (f64, f64) {
        (self.angles[0], self.angles[self.angles.len() - 1])
    }
}

/// What the written table adds at each row's angle, degrees: its points in the control's steps and straight lines between them.
pub fn as_written(report: &Report, options: &Options) -> Result<Vec<f64>> {
    let Grid { angles, up, down } = Grid::of(report, options)?.in_steps(options);
    let curve = |values: Vec<f64>| Curve::through(angles.iter().copied().zip(values).collect());
    let (up, down) = (curve(up), down.map(curve));
    let turn = |angle: f64| if report.modulo { angle.rem_euclid(360.0) } else { angle };
    let entry = |row: &Row| match (&down, row.dir) {
        (Some(down), Some(Direction::Down)) => down.at(turn(row.angle_deg)),
        _ => up.at(turn(row.angle_deg)),
    };
    Ok(report.rows.iter().map(entry).collect())
}

/// The part of the correction that a table of steps cannot hold, degrees: at the reference position it is zero. `None` where
/// it is too small to enter, or the table holds values.
pub fn left_at_reference_deg(report: &Report, options: &Options) -> Result<Option<f64>> {
    let steps = match options.control {
        Control::Csv => options.incremental,
        Control::Fanuc => true,
        Control::Siemens | Control::Linuxcnc => false,
    };
    if !steps {
        return Ok(None);
    }
    let grid = Grid::of(report, options)?;
    let left = grid.at_reference(options).map_or(0.0, |i| grid.up[i]);
    Ok((left.abs() >= 0.5 * options.resolution_deg).then_some(left))
}

/// How far apart both directions' entries are at the reference position, degrees, where columns of steps begin at zero there. `None` where it is too small to
/// enter, or the table holds it.
pub fn left_between_directions_deg(report: &Report, options: &Options) -> Result<Option<f64>> {
    let lost = Grid::of(report, options)?.lost_in_steps(options);
    Ok(lost.filter(|lost| lost.abs() >= 0.5 * options.resolution_deg))
}

/// The table's text.
pub fn text(report: &Report, options: &Options) -> Result<String> {
    above_zero("--resolution-deg", options.resolution_deg, "give for example 0.0001")?;
    if options.axis.is_empty() || !options.axis.chars().all(|c| c.is_ascii_alphanumeric()) {
        return Err(Error::option(
            "--axis",
            "is no axis name",
            "give letters and digits, for example B",
        ));
    }
    let grid = Grid::of(report, options)?;
    match options.control {
        Control::Csv => Ok(csv(&grid, options)),
        Control::Siemens => Ok(siemens(&grid, report.modulo, options)),
        Control::Fanuc => fanuc(&grid, report.modulo, options),
        Control::Linuxcnc => linuxcnc(&grid, options),
    }
}

/// Rounded to the control's least step, without a minus on zero.
fn rounded(value: f64, step: f64) -> f64 {
    (value / step).round() * step + 0.0
}

/// Digits that show the least step.
fn decimals(step: f64) -> usize {
    (-step.log10()).ceil().clamp(0.0, 9.0) as usize
}

fn number(value: f64, step: f64) -> String {
    let text = format!("{:.*}", decimals(step), rounded(value, step));
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    }
}

/// An angle with no more digits than it needs, at least one after the point.
fn short(angle: f64) -> String {
    format!("{:?}", rounded(angle, 1e-6))
}

fn csv(grid: &Grid, options: &Options) -> String {
    let columns: Vec<&Vec<f64>> = std::iter::once(&grid.up).chain(grid.down.as_ref()).collect();
    let word = if options.incremental { "step" } else { "comp" };
    let mut out = match columns.len() {
        1 => format!("angle_deg,{word}_deg\n"),
        _ => format!("angle_deg,{word}_plus_deg,{word}_minus_deg\n"),
    };
    let r = options.resolution_deg;
    let reference = grid.at_reference(options);
    for (i, angle) in grid.angles.iter().enumerate() {
        let _ = write!(out, "{}", short(*angle));
        for values in &columns {
            // Steps of the rounded table, so that their sum has no drift; it is zero at the reference.
            let before = match (options.incremental, i) {
                (false, _) => 0.0,
                (true, 0) => reference.map_or(0.0, |at| rounded(values[at], r)),
                (true, _) => rounded(values[i - 1], r),
            };
            let _ = write!(out, ",{}", number(rounded(values[i], r) - before, r));
        }
        out.push('\n');
    }
    out
}

fn siemens(grid: &Grid, modulo: bool, options: &Options) -> String {
    let axis = &options.axis;
    let mut out = format!(
        "%_N_AX_EEC_INI\nCHANDATA(1)\n; {axis}: encoder compensation in degrees; a positive value moves the axis in its negative direction\n\
         ; needs MD38000 $MA_MM_ENC_COMP_MAX_POINTS >= {}; write with MD32700 $MA_ENC_COMP_ENABLE[0] = 0, then set it to 1 and reference the axis\n",
        grid.angles.len()
    );
    let mut values = grid.up.clone();
    if let (Some(down), Some(reversal)) = (&grid.down, grid.reversal()) {
        values.iter_mut().zip(down).for_each(|(u, d)| *u = 0.5 * (*u + d));
        let _ = writeln!(
            out,
            "; values are the mean of both directions; backlash {}: add it to MD32450 $MA_BACKLASH[0] (positive: the axis stays behind its encoder)",
            number(-reversal, options.resolution_deg)
        );
    }
    for (i, value) in values.iter().enumerate() {
        let _ =
            writeln!(out, "$AA_ENC_COMP[0,{i},{axis}]={}", number(-value, options.resolution_deg));
    }
    let (low, high) = grid.ends();
    let _ = write!(
        out,
        "$AA_ENC_COMP_STEP[0,{axis}]={}\n$AA_ENC_COMP_MIN[0,{axis}]={}\n$AA_ENC_COMP_MAX[0,{axis}]={}\n\
         $AA_ENC_COMP_IS_MODULO[0,{axis}]={}\nM17\n",
        short(grid.step()),
        short(low),
        short(high),
        u8::from(modulo)
    );
    out
}

fn linuxcnc(grid: &Grid, options: &Options) -> Result<String> {
    // The motion module's fixed table size (EMCMOT_COMP_SIZE).
    const MOST: usize = 256;
    if grid.angles.len() > MOST {
        return Err(Error::option(
            "--step-deg",
            format!("{} points; LinuxCNC takes {MOST}", grid.angles.len()),
            "give a larger step",
        ));
    }
    let down = grid.down.as_ref().unwrap_or(&grid.up);
    let r = options.resolution_deg;
    let mut out = String::new();
    for ((angle, up), down) in grid.angles.iter().zip(&grid.up).zip(down) {
        let _ = writeln!(out, "{angle:.6} {} {}", number(*up, r), number(*down, r));
    }
    Ok(out)
}

/// Stored pitch error data: point `reference + k` holds the change over the section that ends at
/// `k · step` from the reference position, in units of the least step times a magnification, -7 to +7.
fn fanuc(grid: &Grid, modulo: bool, options: &Options) -> Result<String> {
    let step = grid.step();
    let Some(before) = grid.at_reference(options).filter(|_| step > 0.0) else {
        return Err(Error::option(
            "--reference-deg",
            format!("{}° is no point of the table", options.reference_deg),
            "give the reference position's angle, on the table's grid",
        ));
    };
    let before = before as u32;
    let sections = grid.angles.len() as u32 - 1;
    // The points of an endless axis go once round from the reference position.
    let from_reference = |values: &Vec<f64>| -> Vec<f64> {
        if !modulo {
            return values.clone();
        }
        (0..=sections).map(|i| values[((before + i) % sections.max(1)) as usize]).collect()
    };
    let (up, down) = (from_reference(&grid.up), grid.down.as_ref().map(from_reference));
    let before = if modulo { 0 } else { before };
    let first = (options.reference_point + 1).checked_sub(before).ok_or_else(|| {
        Error::option(
            "--reference-point",
            "leaves no room for the points below it",
            "give a larger number",
        )
    })?;
    let magnification = grid.magnification(options);
    if magnification > 100.0 {
        return Err(Error::option(
            "--resolution-deg",
            format!("its largest step needs a magnification of {magnification}, above 100"),
            "give the control's detection unit, or a smaller --step-deg",
        ));
    }
    let unit = magnification * options.resolution_deg;
    let (axis, last) = (options.axis_number, first + sections - 1);
    let at_reference = up[before as usize];
    let mut out = format!(
        "%\n(AXIS {} NO.{axis}: PULSES MOVE THE AXIS IN ITS POSITIVE DIRECTION; DETECTION UNIT {} DEG, STEPS OF {unit:.4} DEG)\n\
         N3620A{axis}P{}\nN3621A{axis}P{}\nN3622A{axis}P{last}\nN3623A{axis}P{magnification}\nN3624A{axis}P{}\n",
        options.axis,
        options.resolution_deg,
        options.reference_point,
        if modulo { options.reference_point } else { first },
        short(step),
    );
    if at_reference.abs() >= 0.5 * options.resolution_deg {
        let _ = writeln!(
            out,
            "(THIS TABLE IS 0 AT THE REFERENCE POSITION: SHIFT THE AXIS BY {} DEG THERE, OR ALL OF IT STAYS)",
            number(at_reference, options.resolution_deg)
        );
    }
    if modulo {
        let _ = writeln!(out, "N3625A{axis}P360.");
    }
    let columns = std::iter::once((&up, first)).chain(down.as_ref().map(|d| (d, last + 1)));
    for (values, start) in columns {
        let mut reference = at_reference;
        if start > first {
            let gap = (values[before as usize] - at_reference) / options.resolution_deg;
            // What is written is what the steps count from.
            reference += gap.round() * options.resolution_deg;
            let _ = writeln!(
                out,
                "(TRAVEL IN THE NEGATIVE DIRECTION)\nN3605A{axis}B00000001\nN3626A{axis}P{start}\nN3627A{axis}P{:.0}",
                gap + 0.0
            );
        }
        // Steps of the rounded running value, so that rounding does not add up.
        let running: Vec<i64> =
            values.iter().map(|v| ((v - reference) / unit).round() as i64).collect();
        for (i, w) in running.windows(2).enumerate() {
            let _ = writeln!(out, "N{}P{}", 10_000 + start + i as u32, w[1] - w[0]);
        }
    }
    out.push_str("%\n");
    Ok(out)
}
