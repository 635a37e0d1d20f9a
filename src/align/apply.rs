//! Streams a program through an alignment: line by line in, moved and posted out.

use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;

use nalgebra::Vector3;

use super::Alignment;
use super::cl::{self, Record, Refusal};
use super::nc::{self, Block, Modal};
use super::post::{Log, Poster, straight};
use crate::error::{Error, Result};
use crate::frame::named::ends_in;
use crate::machine::{Chain, Joints, Machine, Motion, ToolPose};
use crate::output::write_streamed;

/// The longest line of a program, in bytes.
const MOST_LINE: u64 = 1 << 20;

/// How a program is written.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize, schemars::JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// Lines of x y z i j k
    Cl,
    /// APT with GOTO/
    Apt,
    /// G0 and G1 with rotary words
    Nc,
}

impl Form {
    /// What a file's name says.
    pub fn of_name(path: &Path) -> Option<Self> {
        let forms: [(Self, &[&str]); 3] = [
            (Self::Cl, &["cl", "csv", "txt", "xyz"]),
            (Self::Apt, &["apt", "cls", "cldata", "aptsource"]),
            (Self::Nc, &["nc", "ngc", "mpf", "spf", "tap", "cnc", "gcode", "iso", "eia", "g"]),
        ];
        forms.into_iter().find(|(_, endings)| ends_in(path, endings)).map(|(form, _)| form)
    }
}

/// How a program is moved.
#[derive(Debug, Clone)]
pub struct Options {
    /// Form of the input; `None`: by its name.
    pub from: Option<Form>,
    /// Form of the output; `None`: by its name, else as the input.
    pub to: Option<Form>,
    /// Moves the path back.
    pub inverse: bool,
    /// Most a straight move of the joints may leave the path.
    pub tolerance_mm: f64,
    /// Digits after the point of a length; `None`: 9 for CL data, 6 for NC code.
    pub decimals: Option<usize>,
    /// The control's RTCP is on: linear words are tool points on the work.
    pub rtcp: bool,
    /// Feed of NC code made from CL data.
    pub feed_mm_min: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            from: None,
            to: None,
            inverse: false,
            tolerance_mm: 0.005,
            decimals: None,
            rtcp: false,
            feed_mm_min: 1000.0,
        }
    }
}

/// What was done.
#[derive(Debug, Clone, serde::Serialize, schemars::JsonSchema)]
pub struct Report {
    /// Lines read.
    pub lines: u64,
    /// Form of the input.
    pub from: Form,
    /// Form of the output.
    pub to: Form,
    /// What happened on the way.
    pub log: Log,
}

/// Moves `input` to `output`.
pub fn apply(
    alignment: &Alignment,
    machine: &Machine,
    input: &Path,
    output: &Path,
    options: &Options,
) -> Result<Report> {
    if !(options.tolerance_mm.is_finite() && options.tolerance_mm > 0.0) {
        return Err(Error::option("--tolerance-mm", "is not above 0", "give for example 0.005"));
    }
    if !(options.feed_mm_min.is_finite() && options.feed_mm_min > 0.0) {
        return Err(Error::option("--feed-mm-min", "is not above 0", "give a feed"));
    }
    if options.decimals.is_some_and(|d| d > 12) {
        return Err(Error::option("--decimals", "is out of range", "give 0 to 12"));
    }
    let from = options.from.or_else(|| Form::of_name(input)).ok_or_else(|| {
        Error::option(
            "--from",
            format!("'{}' does not say what it holds", input.display()),
            "give cl, apt or nc",
        )
    })?;
    let to = options.to.or_else(|| Form::of_name(output)).unwrap_or(from);
    if from == Form::Nc && to == Form::Apt {
        return Err(Error::option("--to", "NC code is not turned into APT", "give nc or cl"));
    }
    if to == Form::Nc && options.decimals == Some(0) {
        return Err(Error::option(
            "--decimals",
            "0 leaves no decimal point, and many controls read X12 as 12 increments",
            "give 1 to 12",
        ));
    }
    let motion = if options.inverse { alignment.motion().inverse() } else { alignment.motion() };
    let chain = machine.chain()?;
    let letters = chain.names().map(|n| n.letter());
    let mut mover = Mover {
        motion,
        poster: Poster::new(chain.clone(), options.tolerance_mm),
        chain,
        letters,
        to,
        rtcp: options.rtcp,
        decimals: options.decimals.unwrap_or(if to == Form::Nc { 6 } else { 9 }),
        modal_direction: Vector3::z(),
        last_pose: None,
        programmed: [None; 5],
        modal: Modal::default(),
        rapid_next: false,
        separator: ' ',
        feed: options.feed_mm_min,
        through: Vec::new(),
    };
    let file = crate::input::open(input)?;
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let (mut lines, mut windows) = (0, false);
    write_streamed(output, |file| {
        let mut writer = BufWriter::with_capacity(1 << 18, file);
        let (mut bytes, mut out) = (Vec::new(), String::new());
        if from != Form::Nc && to == Form::Nc {
            out.push_str(&format!("G21 G90 G94\nF{}\n", options.feed_mm_min));
        }
        loop {
            bytes.clear();
            let mut line = reader.by_ref().take(MOST_LINE);
            if line.read_until(b'\n', &mut bytes).map_err(|e| Error::io(input, "read", e))? == 0 {
                break;
            }
            lines += 1;
            if bytes.len() as u64 == MOST_LINE {
                let reason = format!("is longer than {MOST_LINE} bytes");
                return Err(Error::field(input, Some(lines), "line", reason, "give a program"));
            }
            windows = bytes.ends_with(b"\r\n") || windows && !bytes.ends_with(b"\n");
            let text = std::str::from_utf8(&bytes).map_err(|_| {
                Error::field(input, Some(lines), "text", "is not UTF-8", "save it as plain text")
            })?;
            let text = text.trim_end_matches(['\n', '\r']);
            let text = if lines == 1 { text.trim_start_matches('\u{feff}') } else { text };
            let done = match from {
                Form::Nc => mover.nc(lines, text, &mut Block::default(), &mut out),
                Form::Cl | Form::Apt => mover.cl(lines, text, from, &mut out),
            };
            done.map_err(|stop| stop.at(input, lines))?;
            if windows {
                out = out.replace('\n', "\r\n");
            }
            writer.write_all(out.as_bytes()).map_err(|e| Error::io(output, "write", e))?;
            out.clear();
        }
        if mover.poster.log.moves == 0 {
            let fix = "give CL data, APT or NC code with moves";
            return Err(Error::file(input, "holds no move", fix));
        }
        writer.flush().map_err(|e| Error::io(output, "write", e))
    })?;
    Ok(Report { lines, from, to, log: mover.poster.log })
}

/// Why a line stopped the program.
enum Stop {
    Refused(Refusal),
    Failed(Error),
}

impl Stop {
    fn at(self, path: &Path, line: u64) -> Error {
        match self {
            Self::Refused((reason, fix)) => Error::field(path, Some(line), "block", reason, fix),
            Self::Failed(Error::Measure { reason, fix, .. }) => {
                Error::field(path, Some(line), "block", reason, fix)
            }
            Self::Failed(other) => other,
        }
    }
}

struct Mover {
    motion: Motion,
    chain: Chain,
    poster: Poster,
    letters: [char; 5],
    to: Form,
    rtcp: bool,
    decimals: usize,
    modal_direction: Vector3<f64>,
    last_pose: Option<ToolPose>,
    /// Axis values of the program as read, mm and rad.
    programmed: [Option<f64>; 5],
    modal: Modal,
    rapid_next: bool,
    separator: char,
    feed: f64,
    through: Vec<Joints>,
}

impl Mover {
    fn moved(&self, pose: &ToolPose) -> ToolPose {
        ToolPose {
            position_mm: self.motion.rotation * pose.position_mm + self.motion.translation.vector,
            direction: self.motion.rotation * pose.direction,
        }
    }

    fn cl(
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
                self.other(other, from, out);
                return Ok(());
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
                for q in through.iter().chain([&end]) {
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
    fn other(&mut self, text: &str, from: Form, out: &mut String) {
        if self.to == from {
            out.push_str(text);
            out.push('\n');
            return;
        }
        let upper = text.trim().to_ascii_uppercase();
        if self.to != Form::Nc || from != Form::Apt || upper.is_empty() {
            return;
        }
        if upper.starts_with("RAPID") {
            self.rapid_next = true;
        } else if let Some(feed) = upper
            .strip_prefix("FEDRAT/")
            .and_then(|r| r.split(',').find_map(|w| w.trim().parse::<f64>().ok()))
            .filter(|f| f.is_finite() && *f > 0.0 && *f != self.feed)
        {
            self.feed = feed;
            out.push_str(&format!("F{feed}\n"));
        } else {
            out.push('(');
            out.extend(text.trim().chars().map(|c| if matches!(c, '(' | ')') { ' ' } else { c }));
            out.push_str(")\n");
        }
    }

    fn nc<'a>(
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
        let start: Joints = std::array::from_fn(|i| before[i].unwrap_or(target[i]));
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
            cl::write(out, &pose, ' ', self.decimals);
            self.through = through;
            return Ok(());
        }
        let parts = through.len() as f64 + 1.0;
        for (n, q) in through.iter().chain([&end]).enumerate() {
            for &(letter, digits) in &block.words {
                // Added points repeat only the feed of inverse time, which counts for each block.
                let feed = letter == 'F' && self.modal.inverse_time;
                if n > 0 && !feed {
                    continue;
                }
                out.push(letter);
                match digits.parse::<f64>() {
                    Ok(value) if feed && parts > 1.0 => cl::number(out, value * parts, 6),
                    _ => out.push_str(digits),
                }
                out.push(' ');
            }
            if out.ends_with(' ') {
                out.pop();
            }
            self.axes(out, q, &pose);
            if n == 0 {
                for comment in &block.comments {
                    out.push(' ');
                    out.push_str(comment);
                }
            }
            out.push('\n');
        }
        self.through = through;
        Ok(())
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
