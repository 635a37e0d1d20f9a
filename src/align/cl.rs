//! Cutter-location records: `x y z i j k` lines and APT `GOTO/`.

use std::fmt::Write;

use nalgebra::Vector3;

use crate::machine::ToolPose;

/// A line of CL data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Record<'a> {
    /// A pose.
    Pose(ToolPose),
    /// Something that moves nothing.
    Other(&'a str),
}

/// Why a line cannot be moved, and what to do.
pub type Refusal = (String, &'static str);

/// Reads `x y z [i j k]`, separated by blanks or commas; a header, blank lines and comments (`#`, `$$`) move nothing.
/// Without a vector the `modal` one holds.
pub fn parse_cl<'a>(line: &'a str, modal: &mut Vector3<f64>) -> Result<Record<'a>, Refusal> {
    let text = line.trim();
    if text.is_empty() || text.starts_with('#') || text.starts_with("$$") {
        return Ok(Record::Other(line));
    }
    let letters =
        text.starts_with(|c: char| c.is_alphabetic()) && !text.starts_with(['n', 'N', 'i', 'I']);
    if letters && text.starts_with(['x', 'X']) {
        return Ok(Record::Other(line));
    }
    // 10,0 20,0 0,1 may be three numbers or six.
    let mut parts = text.split_whitespace();
    let comma_within = |part: &str| part.trim_end_matches(',').contains(',');
    if text.contains([' ', '\t', ';']) && parts.any(comma_within) {
        return Err((
            "has commas within numbers or between some of them only".into(),
            "write decimal points, and separate all numbers by blanks or all by commas",
        ));
    }
    let numbers = text.split([',', ' ', '\t', ';']).filter(|w| !w.is_empty());
    pose(numbers, modal).map(Record::Pose)
}

/// Reads APT: `GOTO/` and `FROM/` are poses; what moves along curves or relatively is refused.
pub fn parse_apt<'a>(line: &'a str, modal: &mut Vector3<f64>) -> Result<Record<'a>, Refusal> {
    let code = line.split("$$").next().unwrap_or("").trim();
    if code.ends_with('$') {
        return Err(("is continued on the next line".into(), "write each statement on one line"));
    }
    let word = code.split('/').next().unwrap_or("").trim();
    let is = |name: &str| word.eq_ignore_ascii_case(name);
    if is("GOTO") || is("FROM") {
        let rest = code.split_once('/').map_or("", |r| r.1);
        return pose(rest.split(',').map(str::trim), modal).map(Record::Pose);
    }
    let upper = code.to_ascii_uppercase();
    if is("UNITS") && upper.contains("INCH") {
        return Err(("is a program in inches".into(), "post it in mm"));
    }
    // Switched off, or by nothing, they move nothing.
    let rest = upper.split_once('/').map_or("", |r| r.1);
    let nothing = |word: &str| word.trim().parse() == Ok(0.0);
    let off = ["OFF", "NOMORE"].contains(&rest.trim()) || rest.split(',').all(nothing);
    for (name, what) in [
        ("CIRCLE", "an arc"),
        ("MOVARC", "an arc"),
        ("ARCSLP", "an arc"),
        ("CYCLE", "a canned cycle"),
        ("GODLTA", "a relative move"),
        ("COPY", "a copied path"),
        ("TRACUT", "a transformation"),
        ("TRANS", "a shift"),
        ("ORIGIN", "a shift"),
        ("ROTABL", "a move of the table"),
        ("CUTCOM", "cutter compensation"),
        ("CALL", "a subprogram"),
    ] {
        if is(name) && !off {
            return Err((
                format!("{name} is {what}, which cannot be moved"),
                "post it as GOTO points",
            ));
        }
    }
    Ok(Record::Other(line))
}

/// The feed that a statement of APT sets, in mm/min; `None` where it sets none. One per revolution or of inverse time is refused: it is no F of the code
/// that is written.
pub fn feed_mm_min(statement: &str) -> Result<Option<f64>, Refusal> {
    const MM_PER_INCH: f64 = 25.4;
    let upper = statement.trim().to_ascii_uppercase();
    let Some(rest) = upper.strip_prefix("FEDRAT/") else { return Ok(None) };
    let (mut feed, mut factor) = (None, 1.0);
    for word in rest.split(',').map(str::trim).filter(|word| !word.is_empty()) {
        match (word.parse::<f64>(), word) {
            (Ok(value), _) => feed = feed.or(Some(value)),
            (Err(_), "MMPM" | "MMPMIN" | "PERMIN" | "NOMORE") => {}
            (Err(_), "IPM") => factor = MM_PER_INCH,
            (Err(_), unit) => {
                let reason = format!("FEDRAT gives the feed as {unit}, and F is in mm/min here");
                return Err((reason, "post it in mm/min, FEDRAT/800"));
            }
        }
    }
    Ok(feed.map(|feed| feed * factor).filter(|feed| feed.is_finite() && *feed > 0.0))
}

fn pose<'a>(
    words: impl Iterator<Item = &'a str>,
    modal: &mut Vector3<f64>,
) -> Result<ToolPose, Refusal> {
    let mut values = [0.0; 6];
    let mut count = 0;
    for word in words {
        if count == 6 {
            return Err(("has more than six numbers".into(), "give x y z i j k"));
        }
        let value: f64 =
            word.parse().map_err(|_| (format!("'{word}' is not a number"), "give x y z i j k"))?;
        if !value.is_finite() || value.abs() > 1e6 {
            return Err((format!("'{word}' is no coordinate in mm"), "correct it"));
        }
        values[count] = value;
        count += 1;
    }
    let [x, y, z, i, j, k] = values;
    match count {
        3 => {}
        6 => {
            let direction = Vector3::new(i, j, k);
            let norm = direction.norm();
            if !ToolPose::is_direction(&direction) {
                return Err((
                    format!("the tool vector's length is {norm:.6}"),
                    "give a unit vector i j k",
                ));
            }
            *modal = direction / norm;
        }
        n => return Err((format!("has {n} numbers"), "give x y z or x y z i j k")),
    }
    Ok(ToolPose { position_mm: Vector3::new(x, y, z), direction: *modal })
}

/// Appends a number without a minus on zero.
pub fn number(out: &mut String, value: f64, decimals: usize) {
    let start = out.len();
    let _ = write!(out, "{value:.decimals$}");
    if out[start..].starts_with('-') && out[start + 1..].bytes().all(|b| b == b'0' || b == b'.') {
        out.remove(start);
    }
}

/// Appends `x y z i j k`; vectors with three digits more, so that they stay unit vectors.
pub fn write(out: &mut String, pose: &ToolPose, separator: char, decimals: usize) {
    for (n, (v, digits)) in pose
        .position_mm
        .iter()
        .map(|v| (v, decimals))
        .chain(pose.direction.iter().map(|v| (v, decimals + 3)))
        .enumerate()
    {
        if n > 0 {
            out.push(separator);
        }
        number(out, *v, digits);
    }
    out.push('\n');
}
