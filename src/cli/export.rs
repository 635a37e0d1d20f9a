//! `pivotsight export`: the machine's numbers for a control.

use std::fmt::Write;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::outfiles::OutFile;
use crate::cli::{Global, Outcome, result, rows};
use crate::diagnose::catalogue;
use crate::error::Result;
use crate::machine::Machine;
use crate::output::Document;
use crate::rtcp::export::{
    Change, Changes, Confidence, Control, Line, Parameter, Report, changes, entered_export, export,
};

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

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let machine = Machine::read(&args.machine)?;
    catalogue::check(&machine).map_err(|e| e.in_file(&args.machine, None))?;
    let Report { machine, export: made, warnings } = entered_export(&machine, args.control)?;
    if let Some(path) = &args.write_machine {
        global.write(path, machine.to_toml().as_bytes())?;
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
        let Changes { values: changes, lines } = changes(&before, &made);
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
