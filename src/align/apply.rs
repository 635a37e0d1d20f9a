//! Streams a program through an alignment: line by line in, moved and posted out.

use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;

use nalgebra::Vector3;

use super::Alignment;
use super::mover::Mover;
use super::nc::{Block, Modal};
use super::post::{Log, Poster};
use crate::error::{Error, Result, above_zero};
use crate::frame::named::ends_in;
use crate::machine::Machine;
use crate::output::write_streamed;

/// The longest line of a program, in bytes.
const MOST_LINE: u64 = 1 << 20;

/// No machine moves as fast.
const MOST_FEED_MM_MIN: f64 = 1e6;

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

impl Options {
    /// Checks them; what the input and the output hold, as said or by their names.
    fn forms(&self, input: &Path, output: &Path) -> Result<(Form, Form)> {
        above_zero("--tolerance-mm", self.tolerance_mm, "give for example 0.005")?;
        above_zero("--feed-mm-min", self.feed_mm_min, "give a feed")?;
        if self.feed_mm_min > MOST_FEED_MM_MIN {
            let fix = "give a feed in mm/min, 1000000 at most";
            return Err(Error::option("--feed-mm-min", "is faster than any machine", fix));
        }
        if self.decimals.is_some_and(|d| d > 12) {
            return Err(Error::option("--decimals", "is out of range", "give 0 to 12"));
        }
        let from = self.from.or_else(|| Form::of_name(input)).ok_or_else(|| {
            Error::option(
                "--from",
                format!("'{}' does not say what it holds", input.display()),
                "give cl, apt or nc",
            )
        })?;
        let to = self.to.or_else(|| Form::of_name(output)).unwrap_or(from);
        if from == Form::Nc && to == Form::Apt {
            return Err(Error::option("--to", "NC code is not turned into APT", "give nc or cl"));
        }
        if to == Form::Nc && self.decimals == Some(0) {
            return Err(Error::option(
                "--decimals",
                "0 leaves no decimal point, and many controls read X12 as 12 increments",
                "give 1 to 12",
            ));
        }
        if let Some(d) = self.decimals
            && 0.5 * 0.1f64.powi(d as i32) > self.tolerance_mm
        {
            let reason =
                format!("{d} rounds by more than --tolerance-mm, {} mm", self.tolerance_mm);
            return Err(Error::option("--decimals", reason, "give more, or a wider tolerance"));
        }
        Ok((from, to))
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
    let (from, to) = options.forms(input, output)?;
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
            if !next_line(&mut reader, &mut bytes, input, lines + 1)? {
                break;
            }
            lines += 1;
            windows = bytes.ends_with(b"\r\n") || windows && !bytes.ends_with(b"\n");
            let text = text_of(&bytes, input, lines)?;
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

/// Reads a line with its end, whole; `false` where there is no more.
fn next_line(
    reader: &mut impl BufRead,
    bytes: &mut Vec<u8>,
    input: &Path,
    number: u64,
) -> Result<bool> {
    bytes.clear();
    let read = reader.take(MOST_LINE).read_until(b'\n', bytes);
    read.map_err(|e| Error::io(input, "read", e))?;
    if bytes.len() as u64 == MOST_LINE {
        let reason = format!("is longer than {MOST_LINE} bytes");
        return Err(Error::field(input, Some(number), "line", reason, "give a program"));
    }
    Ok(!bytes.is_empty())
}

/// A line's text without its end, nor the mark that a file may begin with.
fn text_of<'b>(bytes: &'b [u8], input: &Path, number: u64) -> Result<&'b str> {
    let text = std::str::from_utf8(bytes).map_err(|_| {
        Error::field(input, Some(number), "text", "is not UTF-8", "save it as plain text")
    })?;
    let text = text.trim_end_matches(['\n', '\r']);
    Ok(if number == 1 { text.trim_start_matches('\u{feff}') } else { text })
}
