//! NC code read block by block: what moves the axes, what may pass, and what cannot be moved.

use super::cl::Refusal;

/// One block, taken apart.
#[derive(Debug, Clone, Default)]
pub struct Block<'a> {
    /// Everything but axis words and comments, as it stands, in order.
    pub words: Vec<(char, &'a str)>,
    /// New values of the five axes in the order of the machine's joints; degrees for rotary ones.
    pub axes: [Option<f64>; 5],
    /// Comments, as they stand.
    pub comments: Vec<&'a str>,
    /// Moves the axes along a path that is known.
    pub moves: bool,
    /// Moves the axes somewhere only the control knows (G28, G30, G53).
    pub away: bool,
}

/// What stays in force from block to block.
#[derive(Debug, Clone, Copy, Default)]
pub struct Modal {
    /// G0 (true) or G1 (false), once one of them was programmed.
    pub rapid: Option<bool>,
    /// G93: F is one over the time of the block.
    pub inverse_time: bool,
    /// RTCP has been switched off in the program itself.
    pub rtcp_off: bool,
    /// What the program's numbers count from, and what they did at its first move.
    datum: Datum,
    first_datum: Option<Datum>,
}

/// Zero offset and tool length in force: which of the control's entries, as their values are not in the program.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Datum {
    /// G54 to G59.3, G500 to G599; in tenths.
    zero: Option<i64>,
    /// P of G54.1.
    further: Option<i64>,
    /// H of G43.
    offset: Option<i64>,
    /// T as last programmed, and of the tool in use.
    chosen: Option<i64>,
    tool: Option<i64>,
    /// D, of a Siemens control's tool.
    edge: Option<i64>,
}

impl Datum {
    /// What a block's words choose.
    fn choose(&mut self, words: &[(char, &str)]) {
        let value = |letter: char| {
            let digits = words.iter().rev().find(|w| w.0 == letter).map(|w| w.1);
            digits.and_then(|d| d.parse::<f64>().ok())
        };
        for (_, digits) in words.iter().filter(|w| w.0 == 'G') {
            let code = digits.parse().map_or(0, tenths);
            match code {
                540..=593 | 5000..=5999 => {
                    (self.zero, self.further) = (Some(code), None);
                    // G54 P2 is short for G54.1 P2.
                    if code == 540 || code == 541 {
                        self.further = value('P').map(tenths);
                    }
                }
                430..=439 => {
                    self.offset = value('H').map_or(self.offset, |h| Some(tenths(h)));
                }
                490 | 491 => self.offset = None,
                _ => {}
            }
        }
        // Of a tool its own length and, on Siemens controls, its edge; a tool that is chosen counts once it is changed.
        self.chosen = value('T').map(tenths).or(self.chosen);
        let changes = words.iter().any(|w| w.0 == 'M' && w.1.parse() == Ok(6.0));
        if changes || value('D').is_some() {
            self.tool = self.chosen;
        }
        self.edge = value('D').map(tenths).or(self.edge);
    }
}

/// G codes have a decimal at most.
fn tenths(value: f64) -> i64 {
    (value * 10.0).round() as i64
}

impl Modal {
    /// A word that switches RTCP on, which has to be known of.
    fn turn_rtcp_on(&mut self, rtcp: bool) -> Result<(), Refusal> {
        self.rtcp_off = false;
        let fix = "give --rtcp: positions are then tool points";
        if rtcp { Ok(()) } else { Err(("switches RTCP on".into(), fix)) }
    }

    /// A move must be one, of tool points where those are moved, and count from where the first one does.
    fn may_move(&mut self, rtcp: bool) -> Result<(), Refusal> {
        if self.rapid.is_none() {
            return Err(("moves before any G0 or G1".into(), "program G0 or G1 first"));
        }
        if rtcp && self.rtcp_off {
            return Err((
                "moves while RTCP is switched off".into(),
                "cut such moves out, or switch it on before: with --rtcp positions are tool points",
            ));
        }
        self.same_datum(rtcp)
    }

    /// A move whose numbers count from elsewhere than the first one's, by how much only the control knows. Tool points do not depend on
    /// the tool's length.
    fn same_datum(&mut self, rtcp: bool) -> Result<(), Refusal> {
        let first = *self.first_datum.get_or_insert(self.datum);
        let zero = |d: Datum| (d.zero, d.further);
        if zero(first) != zero(self.datum) {
            return Err((
                "moves after the zero offset changed (G54 to G59), whose value is not in the program".into(),
                "choose it before the first move, or move the parts of the program each by itself",
            ));
        }
        let length = |d: Datum| (d.offset, d.tool, d.edge);
        if !rtcp && length(first) != length(self.datum) {
            return Err((
                "moves after the tool or its length changed (T, D, G43 H, G49), whose value is not in the program".into(),
                "choose it before the first move, or move the parts of the program each by itself",
            ));
        }
        Ok(())
    }
}

/// Words of several letters that move nothing.
const HARMLESS: [&str; 6] = ["STOPRE", "MSG", "FNORM", "FFWON", "FFWOF", "SOFT"];

/// Reads a block. `letters` are the machine's axis letters in the order of its joints.
pub fn parse<'a>(
    line: &'a str,
    letters: &[char; 5],
    rtcp: bool,
    modal: &mut Modal,
    block: &mut Block<'a>,
) -> Result<(), Refusal> {
    block.words.clear();
    block.comments.clear();
    block.axes = [None; 5];
    (block.moves, block.away) = (false, false);
    let text = line.trim_end();
    if text.starts_with('/') {
        return Err((
            "is a block that the operator may skip".into(),
            "remove the slash or the block",
        ));
    }
    if text.starts_with('%') {
        return Ok(());
    }
    let dwells = words(text, letters, rtcp, modal, block)?;
    modal.datum.choose(&block.words);
    if dwells || block.away {
        // X is a time, or the goal is the control's: the block passes as it stands.
        return Ok(());
    }
    if block.axes.iter().any(Option::is_some) {
        modal.may_move(rtcp)?;
        block.moves = true;
    }
    Ok(())
}

/// Reads what stands in a block, word by word; hands back whether it dwells.
fn words<'a>(
    text: &'a str,
    letters: &[char; 5],
    rtcp: bool,
    modal: &mut Modal,
    block: &mut Block<'a>,
) -> Result<bool, Refusal> {
    let bytes = text.as_bytes();
    let mut i = 0;
    let mut dwells = false;
    while i < bytes.len() {
        let c = bytes[i];
        match c {
            b' ' | b'\t' => i += 1,
            b';' => {
                block.comments.push(&text[i..]);
                break;
            }
            b'(' => {
                let end =
                    text[i..].find(')').ok_or(("has an open comment".to_owned(), "close it"))?;
                block.comments.push(&text[i..=i + end]);
                i += end + 1;
            }
            c if c.is_ascii_alphabetic() => {
                let run = bytes[i..]
                    .iter()
                    .take_while(|b| b.is_ascii_alphabetic() || **b == b'_')
                    .count();
                if run > 1 {
                    word(&text[i..], run, rtcp, modal, block)?;
                    break;
                }
                let letter = c.to_ascii_uppercase() as char;
                let number = number(letter, text, &mut i)?;
                dwells |= letter_word(letter, number, letters, rtcp, modal, block)?;
            }
            c => {
                let shown = text[i..].chars().next().unwrap_or(c as char);
                return Err((
                    format!("'{shown}' is not understood"),
                    "only plain ISO blocks can be moved",
                ));
            }
        }
    }
    Ok(dwells)
}

/// Takes a word of one letter, the place of an axis or another; hands back whether it dwells.
fn letter_word<'a>(
    letter: char,
    (digits, value): (&'a str, f64),
    letters: &[char; 5],
    rtcp: bool,
    modal: &mut Modal,
    block: &mut Block<'a>,
) -> Result<bool, Refusal> {
    if let Some(axis) = letters.iter().position(|&l| l == letter) {
        return match block.axes[axis].replace(value) {
            Some(_) => Err((format!("has {letter} twice"), "keep one of them")),
            None => Ok(false),
        };
    }
    let mut dwells = false;
    match letter {
        'G' => dwells = g_code(value, rtcp, modal, block)?,
        'M' if value == 128.0 => modal.turn_rtcp_on(rtcp)?,
        'M' if value == 129.0 => modal.rtcp_off = true,
        _ => check_letter(letter, value)?,
    }
    block.words.push((letter, digits));
    Ok(dwells)
}

/// The number that belongs to a letter, which stands at `at`; leads behind it.
fn number<'a>(letter: char, text: &'a str, at: &mut usize) -> Result<(&'a str, f64), Refusal> {
    let bytes = text.as_bytes();
    let start = *at + 1;
    let gap = bytes[start..].iter().take_while(|b| **b == b' ').count();
    let length = bytes[start + gap..]
        .iter()
        .take_while(|b| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+'))
        .count();
    let digits = &text[start + gap..start + gap + length];
    let value: f64 = digits.parse().map_err(|_| {
        (
            format!("'{letter}' is not followed by a number"),
            "expressions and parameters cannot be moved: write plain numbers",
        )
    })?;
    let end = start + gap + length;
    // A program that writes numbers may write 1e-5; the control would read X1 and a word E.
    if let [b'e' | b'E', b'0'..=b'9' | b'-' | b'+', ..] = bytes[end..] {
        return Err((
            format!("{letter}{digits}{}... has a power of ten", &text[end..end + 2]),
            "write plain numbers (and a word E after a blank)",
        ));
    }
    if bytes.get(end) == Some(&b'=') {
        return Err((
            format!("sets {letter}{digits}"),
            "parameters cannot be moved: write plain numbers",
        ));
    }
    *at = end;
    Ok((digits, value))
}

/// Refuses letters that move what the machine does not have, or lead where is not seen.
fn check_letter(letter: char, value: f64) -> Result<(), Refusal> {
    match letter {
        'X' | 'Y' | 'Z' | 'A' | 'B' | 'C' | 'U' | 'V' | 'W' => Err((
            format!("moves {letter}, which the machine file does not have"),
            "correct the machine file",
        )),
        'I' | 'J' | 'K' | 'R' => {
            Err((format!("has {letter}: arcs and cycles cannot be moved"), "post it as G1 points"))
        }
        'L' => Err(call("L")),
        'M' if value == 98.0 || value == 198.0 => Err(call("M98")),
        _ => Ok(()),
    }
}

fn call(word: &str) -> Refusal {
    (format!("{word} calls a subprogram, whose moves are not seen"), "post it without subprograms")
}

/// Judges a G code; whether it makes the block a dwell.
fn g_code(
    value: f64,
    rtcp: bool,
    modal: &mut Modal,
    block: &mut Block<'_>,
) -> Result<bool, Refusal> {
    let code = tenths(value);
    let arc =
        |what: &str| (format!("G{value} is {what}, which cannot be moved"), "post it as G1 points");
    match code {
        0 => modal.rapid = Some(true),
        10 => modal.rapid = Some(false),
        20 | 30 => return Err(arc("an arc")),
        40 => return Ok(true),
        50..=69 => return Err(arc("a curve")),
        200 | 700 => return Err(("programs in inches".into(), "post it in mm (G21)")),
        280 | 300 | 530 => block.away = true,
        330..=339 | 630 => return Err(arc("thread cutting")),
        410 | 420 => {
            return Err((
                "has cutter radius compensation on".into(),
                "post the tool centre's path",
            ));
        }
        730..=769 | 780 | 790 | 810..=899 => return Err(arc("a canned cycle")),
        910 => return Err(("is incremental".into(), "post it in absolute coordinates (G90)")),
        930 => modal.inverse_time = true,
        940 | 950 => modal.inverse_time = false,
        434 | 435 => modal.turn_rtcp_on(rtcp)?,
        490 | 491 => modal.rtcp_off = true,
        90
        | 100
        | 170..=199
        | 210
        | 400
        | 430..=499
        | 540..=620
        | 640..=649
        | 710
        | 800
        | 900
        | 960..=999 => {}
        5000..=5999 => {}
        _ => {
            return Err((
                format!("G{value} is not known here"),
                "remove it if it moves nothing, or post without it",
            ));
        }
    }
    Ok(false)
}

/// A word of several letters: harmless ones pass as a comment of the block, the rest is refused.
fn word<'a>(
    rest: &'a str,
    run: usize,
    rtcp: bool,
    modal: &mut Modal,
    block: &mut Block<'a>,
) -> Result<(), Refusal> {
    let name = rest[..run].to_ascii_uppercase();
    match name.as_str() {
        "TRAORI" => modal.turn_rtcp_on(rtcp)?,
        "TRAFOOF" if rtcp => modal.rtcp_off = true,
        _ if HARMLESS.contains(&name.as_str()) => {}
        _ if name.starts_with("CYCLE")
            || name.starts_with("POCKET")
            || name.starts_with("HOLES")
            || name == "MCALL" =>
        {
            return Err((
                format!("{name} is a canned cycle, which cannot be moved"),
                "post it as G1 points",
            ));
        }
        _ if name.starts_with("CIP") || name.starts_with("CT") || name == "CR" => {
            return Err((
                format!("{name} is an arc, which cannot be moved"),
                "post it as G1 points",
            ));
        }
        _ => {
            return Err((
                format!("{name} is not known here"),
                "only plain ISO blocks can be moved",
            ));
        }
    }
    let after = rest[run..].trim();
    if !(after.is_empty() || after.starts_with(['(', ';'])) {
        return Err((format!("has more words after {name}"), "write it in a block of its own"));
    }
    block.comments.push(rest);
    Ok(())
}
