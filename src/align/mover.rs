//! Moves a tool path line by line, each in its own form.

use std::path::Path;

use nalgebra::Vector3;

use super::apply::Form;
use super::cl::{self, Record, Refusal};
use super::nc::{self, Block, Modal};
use super::post::{Poster, straight};
use crate::error::Error;
use crate::machine::{Chain, Joints, Motion, ToolPose};

/// Why a line stopped the program.
pub(super) enum Stop {
    Refused(Refusal),
    Failed(Error),
}

impl Stop {
    pub(super) fn at(self, path: &Path, line: u64) -> Error {
        match self {
            Self::Refused((reason, fix)) => Error::field(path, Some(line), "block", reason, fix),
            Self::Failed(Error::Measure { reason, fix, .. }) => {
                Error::field(path, Some(line), "block", reason, fix)
            }
            Self::Failed(other) => other,
        }
    }
}

/// Moves a program line by line.
pub(super) struct Mover {
    pub(super) motion: Motion,
    pub(super) chain: Chain,
    pub(super) poster: Poster,
    pub(super) letters: [char; 5],
    pub(super) to: Form,
    pub(super) rtcp: bool,
    pub(super) decimals: usize,
    pub(super) modal_direction: Vector3<f64>,
    pub(super) last_pose: Option<ToolPose>,
    /// Axis values of the program as read, mm and rad.
    pub(super) programmed: [Option<f64>; 5],
    pub(super) modal: Modal,
    pub(super) rapid_next: bool,
    pub(super) separator: char,
    pub(super) feed: f64,
    /// Points added to the move at hand: how far along it, and the joints there.
    pub(super) through: Vec<(f64, Joints)>,
}

impl Mover {
    fn moved(&self, pose: &ToolPose) -> ToolPose {
        ToolPose {
            position_mm: self.motion.rotation * pose.position_mm + self.motion.translation.vector,
            direction: self.motion.rotation * pose.direction,
        }
    }

    pub(super) fn cl(
        &mut self,
        line: u64,
        text: &str,
        from: Form,
        out: &mut String,
    ) -> std::result::Result<(), Stop> {
        let record = match from {
            Form::Apt => cl::parse_apt(text, &mut self.modal_direction),
            _ => cl::parse_cl(text, &mut self.modal_direction),
        };
        let pose = match record.map_err(Stop::Refused)? {
            Record::Pose(pose) => self.moved(&pose),
            Record::Other(other) => {
                return self.other(line, other, from, out).map_err(Stop::Refused);
            }
        };
        match self.to {
            Form::Cl => {
                if text.contains(',') && from == Form::Cl {
                    self.separator = ',';
                }
                cl::write(out, &pose, self.separator, self.decimals);
                self.poster.log.moves += 1;
            }
            Form::Apt => {
                let word = if text.trim_start().to_ascii_uppercase().starts_with("FROM") {
                    "FROM/"
                } else {
                    "GOTO/"
                };
                out.push_str(word);
                cl::write(out, &pose, ',', self.decimals);
                self.poster.log.moves += 1;
            }
            Form::Nc => {
                let start = self.last_pose.unwrap_or(pose);
                let hint = self.poster.last().unwrap_or([0.0; 5]);
                let held = !self.rtcp && !self.rapid_next;
                let mut through = std::mem::take(&mut self.through);
                let end = self
                    .poster
                    .go(line, &hint, held, |t| straight(&start, &pose, t), &mut through)
                    .map_err(Stop::Failed)?;
                let code = if std::mem::take(&mut self.rapid_next) { "G0" } else { "G1" };
                for (_, q) in through.iter().chain([&(1.0, end)]) {
                    out.push_str(code);
                    self.axes(out, q, &pose);
                    out.push('\n');
                }
                self.through = through;
            }
        }
        self.last_pose = Some(pose);
        Ok(())
    }

    /// A line that moves nothing, in the output's form.
    fn other(
        &mut self,
        line: u64,
        text: &str,
        from: Form,
        out: &mut String,
    ) -> Result<(), Refusal> {
        /// Statements that do nothing at a machine.
        const SAY_ONLY: [&str; 8] =
            ["PARTNO", "REMARK", "PPRINT", "MULTAX", "FINI", "END", "UNITS", "FEDRAT"];
        if self.to == from {
            out.push_str(text);
            out.push('\n');
            return Ok(());
        }
        let upper = text.trim().to_ascii_uppercase();
        if self.to != Form::Nc || from != Form::Apt || upper.is_empty() {
            return Ok(());
        }
        if upper.starts_with("RAPID") {
            self.rapid_next = true;
            return Ok(());
        }
        match cl::feed_mm_min(text)? {
            Some(feed) if feed == self.feed => {}
            Some(feed) => {
                self.feed = feed;
                out.push_str(&format!("F{feed}\n"));
            }
            None => {
                if !upper.starts_with("$$") && !SAY_ONLY.iter().any(|word| upper.starts_with(word))
                {
                    self.poster.log.left_out.add(line);
                }
                out.push('(');
                out.extend(
                    text.trim().chars().map(|c| if matches!(c, '(' | ')') { ' ' } else { c }),
                );
                out.push_str(")\n");
            }
        }
        Ok(())
    }

    pub(super) fn nc<'a>(
        &mut self,
        line: u64,
        text: &'a str,
        block: &mut Block<'a>,
        out: &mut String,
    ) -> std::result::Result<(), Stop> {
        nc::parse(text, &self.letters, self.rtcp, &mut self.modal, block).map_err(Stop::Refused)?;
        if block.away {
            self.programmed = [None; 5];
            self.poster.forget();
        }
        if !block.moves {
            if self.to == Form::Nc {
                out.push_str(text);
                out.push('\n');
            }
            return Ok(());
        }
        let [start, target] = self.programmed_move(block)?;
        let (chain, motion, rtcp) = (&self.chain, self.motion, self.rtcp);
        let path = |t: f64| -> ToolPose {
            let q: Joints = std::array::from_fn(|i| start[i] + t * (target[i] - start[i]));
            let mut pose = chain.forward(&q);
            if rtcp {
                pose.position_mm = Vector3::new(q[0], q[1], q[2]);
            }
            ToolPose {
                position_mm: motion.rotation * pose.position_mm + motion.translation.vector,
                direction: motion.rotation * pose.direction,
            }
        };
        // The new rotary values move as the programmed ones do, whole turns included.
        let hint: Joints = match self.poster.last() {
            Some(last) => std::array::from_fn(|i| last[i] + target[i] - start[i]),
            None => target,
        };
        let rapid = self.modal.rapid == Some(true);
        let pose = path(1.0);
        let mut through = std::mem::take(&mut self.through);
        let end = self
            .poster
            .go(line, &hint, !rapid && !rtcp, path, &mut through)
            .map_err(Stop::Failed)?;
        if self.to == Form::Cl {
            for (t, _) in &through {
                cl::write(out, &path(*t), ' ', self.decimals);
            }
            cl::write(out, &pose, ' ', self.decimals);
            self.through = through;
            return Ok(());
        }
        self.blocks(block, &through, &end, &pose, out);
        self.through = through;
        Ok(())
    }

    /// Where a block's move starts and ends as programmed, which is kept for the next one.
    fn programmed_move(&mut self, block: &Block<'_>) -> std::result::Result<[Joints; 2], Stop> {
        let before = self.programmed;
        for (i, value) in block.axes.iter().enumerate() {
            if let Some(v) = value {
                if !v.is_finite() || v.abs() > 1e6 {
                    let reason = format!("{} {v} is out of range", self.letters[i]);
                    return Err(Stop::Refused((reason, "correct it")));
                }
                self.programmed[i] = Some(if i < 3 { *v } else { v.to_radians() });
            }
        }
        if let Some(i) = self.programmed.iter().position(Option::is_none) {
            let reason = format!("the position of {} is not known yet", self.letters[i]);
            return Err(Stop::Refused((
                reason,
                "name all five axes in the first move (and after G28, G30, G53)",
            )));
        }
        let target: Joints = self.programmed.map(|v| v.unwrap_or(0.0));
        Ok([std::array::from_fn(|i| before[i].unwrap_or(target[i])), target])
    }

    /// A moved block, and one for each point added to its move.
    fn blocks(
        &self,
        block: &Block<'_>,
        through: &[(f64, Joints)],
        end: &Joints,
        pose: &ToolPose,
        out: &mut String,
    ) {
        /// M words that end or stop something once the whole move is made.
        const LAST: [f64; 9] = [0.0, 1.0, 2.0, 5.0, 9.0, 17.0, 30.0, 60.0, 99.0];
        let ends = |letter: char, digits: &str| {
            letter == 'M' && digits.parse::<f64>().is_ok_and(|m| LAST.contains(&m))
        };
        let mut done = 0.0;
        for (n, (t, q)) in through.iter().chain([&(1.0, *end)]).enumerate() {
            let part = t - std::mem::replace(&mut done, *t);
            for &(letter, digits) in &block.words {
                // Added points repeat only the feed of inverse time, which counts for each block.
                let feed = letter == 'F' && self.modal.inverse_time;
                let here = if ends(letter, digits) { n == through.len() } else { n == 0 };
                if !here && !feed {
                    continue;
                }
                out.push(letter);
                match digits.parse::<f64>() {
                    Ok(value) if feed && part < 1.0 => cl::number(out, value / part, 6),
                    _ => out.push_str(digits),
                }
                out.push(' ');
            }
            if out.ends_with(' ') {
                out.pop();
            }
            self.axes(out, q, pose);
            if n == 0 {
                for comment in &block.comments {
                    out.push(' ');
                    out.push_str(comment);
                }
            }
            out.push('\n');
        }
    }

    /// Appends the five axis words.
    fn axes(&self, out: &mut String, q: &Joints, pose: &ToolPose) {
        for (i, value) in q.iter().enumerate() {
            if !out.is_empty() && !out.ends_with('\n') {
                out.push(' ');
            }
            out.push(self.letters[i]);
            match i {
                0..3 if self.rtcp => cl::number(out, pose.position_mm[i], self.decimals),
                0..3 => cl::number(out, *value, self.decimals),
                _ => cl::number(out, value.to_degrees(), self.decimals + 2),
            }
        }
    }
}
