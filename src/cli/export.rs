//! `pivotsight export`: the machine's numbers for a control.

use std::fmt::Write;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::outfiles::OutFile;
use crate::cli::{Global, Outcome, result, rows};
use crate::diagnose::catalogue;
use crate::error::Result;
use crate::machine::{Machine, entered};
use crate::output::Document;
use crate::rtcp::export::{Confidence, Control, Export, Parameter, differences, export};

/// Writes the machine's numbers the way a control wants them
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The machine file
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// The control
    #[arg(long, value_enum)]
    control: Control,
    /// Show only what changes against the machine file the control was set from
    #[arg(long, value_name = "OLD")]
    diff: Option<PathBuf>,
    /// Write the machine file these numbers make: what its effects correct in [head] and [table] is in them
    #[arg(long, value_name = "FILE")]
    write_machine: Option<OutFile>,
    /// Write the files into this folder instead of printing them
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
}

/// What is printed.
#[derive(Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Output {
    /// Everything the control takes.
    Whole { parameters: Vec<Parameter>, files: Vec<File> },
    /// What differs from another machine file.
    Changes {
        changes: Vec<Change>,
        /// Lines of the files that change beside these values.
        lines: Vec<Line>,
    },
}

/// A file for the control.
#[derive(Serialize, JsonSchema)]
pub struct File {
    name: String,
    text: String,
}

/// A value that changes.
#[derive(Serialize, JsonSchema)]
pub struct Change {
    /// As the control names it.
    name: String,
    /// `mm`, or empty for a code.
    unit: &'static str,
    old: f64,
    new: f64,
    change: f64,
    meaning: String,
    confidence: Confidence,
}

/// A line that changes in one of the files.
#[derive(Serialize, JsonSchema)]
pub struct Line {
    file: String,
    line: String,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let machine = Machine::read(&args.machine)?;
    catalogue::check(&machine).map_err(|e| e.in_file(&args.machine, None))?;
    let (machine, folded) = entered(&machine);
    let made = export(&machine, args.control)?;
    let unconfirmed =
        made.parameters.iter().filter(|p| p.confidence == Confidence::Unconfirmed).count();
    let mut warnings = machine.doubts();
    warnings.extend(folded.iter().map(|e| {
        format!(
            "{} is {:.4} here, {:.4} in the machine file: its effect {} is entered",
            e.key, e.new_mm, e.now_mm, e.effect
        )
    }));
    warnings.extend(machine.effects_left_out());
    if let Some(path) = &args.write_machine {
        global.write(path, machine.to_toml().as_bytes())?;
    }
    if unconfirmed > 0 {
        warnings.push(format!(
            "{unconfirmed} of {} values are marked NOT CONFIRMED: check them against the control's manual",
            made.parameters.len()
        ));
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    if let Some(dir) = &args.dir {
        global.makes("--dir", dir, made.files.iter().map(|(name, _)| name))?;
        for (name, text) in &made.files {
            global.write_into(dir, name, text.as_bytes())?;
        }
    }

    let mut table = String::new();
    // Writing to a String cannot fail.
    let (output, rows) = if let Some(old) = &args.diff {
        let before = export(&Machine::read(old)?, args.control)?;
        let changes = differences(&before, &made);
        let lines = other_lines(&before, &made, &changes);
        let changes: Vec<Change> = changes
            .into_iter()
            .map(|(p, old, new)| Change {
                name: p.name,
                unit: p.unit,
                old,
                new,
                change: new - old,
                meaning: p.meaning,
                confidence: p.confidence,
            })
            .collect();
        if changes.is_empty() && lines.is_empty() {
            table += "nothing changes\n";
        }
        if !changes.is_empty() {
            let _ =
                writeln!(table, "{:<36} {:>12} {:>12} {:>10}", "parameter", "old", "new", "change");
        }
        for c in &changes {
            let mark = if c.confidence == Confidence::Unconfirmed { "NOT CONFIRMED: " } else { "" };
            let _ = writeln!(
                table,
                "{:<36} {:>12.4} {:>12.4} {:>+10.4}  {mark}{}",
                c.name, c.old, c.new, c.change, c.meaning
            );
        }
        for Line { file, line } in &lines {
            let _ = writeln!(table, "{file}: {line}");
        }
        let rows = rows(&changes);
        (Output::Changes { changes, lines }, rows)
    } else {
        let several = made.files.len() > 1;
        for (name, text) in &made.files {
            match &args.dir {
                Some(dir) => drop(writeln!(table, "{}", dir.join(name).display())),
                None if several => drop(writeln!(table, "==> {name} <==\n{text}")),
                None => table += text,
            }
        }
        let rows = rows(&made.parameters);
        let files = made.files.into_iter().map(|(name, text)| File { name, text }).collect();
        (Output::Whole { parameters: made.parameters, files }, rows)
    };
    let json = result("export", &args.machine, &warnings, &output);
    Ok(Outcome::good(Document { json, rows, table }))
}

/// Lines of the new files that are no line of the old ones with the changed values put in: a stand-off or a sense that only a remark
/// tells.
fn other_lines(old: &Export, new: &Export, changes: &[(Parameter, f64, f64)]) -> Vec<Line> {
    let of_value = |p: &Parameter, value: f64| Parameter { value, ..p.clone() }.text();
    let texts: Vec<(String, String)> =
        changes.iter().map(|(p, old, new)| (of_value(p, *old), of_value(p, *new))).collect();
    let explained = |before: &str, now: &str| {
        let (before, now) = (numbers_apart(before), numbers_apart(now));
        before.len() == now.len()
            && before.iter().zip(&now).all(|(b, n)| {
                b == n || texts.iter().any(|(old, new)| (old.as_str(), new.as_str()) == (*b, *n))
            })
    };
    let mut lines = Vec::new();
    for (name, text) in &new.files {
        let before = old.files.iter().find(|(n, _)| n == name).map_or("", |(_, text)| text);
        let is_new = |line: &&str| !before.lines().any(|b| explained(b, line));
        lines.extend(
            text.lines()
                .filter(is_new)
                .map(|line| Line { file: name.clone(), line: line.trim().to_owned() }),
        );
    }
    lines
}

/// A line cut into its numbers and what is between them.
fn numbers_apart(line: &str) -> Vec<&str> {
    let of_number = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
    let mut rest = line;
    std::iter::from_fn(|| {
        let first = of_number(rest.chars().next()?);
        let end = rest.find(|c| of_number(c) != first).unwrap_or(rest.len());
        let (part, left) = rest.split_at(end);
        rest = left;
        Some(part)
    })
    .collect()
}
