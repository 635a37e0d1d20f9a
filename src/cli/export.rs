//! `pivotsight export`: the machine's numbers for a control.

use std::fmt::Write;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::cli::{Global, Outcome, envelope};
use crate::error::Result;
use crate::machine::Machine;
use crate::output::{Document, create_folder, write_whole};
use crate::rtcp::export::{Confidence, Control, differences, export};

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
    /// Write the files into this folder instead of printing them
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let made = export(&Machine::read(&args.machine)?, args.control)?;
    let unconfirmed =
        made.parameters.iter().filter(|p| p.confidence == Confidence::Unconfirmed).count();
    let mut warnings = Vec::new();
    if unconfirmed > 0 {
        warnings.push(format!(
            "{unconfirmed} of {} values are marked NOT CONFIRMED: check them against the control's manual",
            made.parameters.len()
        ));
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    if let Some(dir) = &args.dir {
        create_folder(dir)?;
        for (name, text) in &made.files {
            write_whole(dir.join(name), text.as_bytes())?;
        }
    }

    let mut map = envelope("export", &args.machine, &warnings);
    let rows: Vec<Value>;
    let mut table = String::new();
    // Writing to a String cannot fail.
    if let Some(old) = &args.diff {
        let before = export(&Machine::read(old)?, args.control)?;
        let changed = differences(&before, &made);
        rows = changed
            .iter()
            .map(|(p, o, n)| {
                json!({"name": p.name, "unit": p.unit, "old": o, "new": n, "change": n - o,
                       "meaning": p.meaning, "confidence": p.confidence})
            })
            .collect();
        map.insert("changes".into(), rows.clone().into());
        if changed.is_empty() {
            table += "nothing changes\n";
        } else {
            let _ =
                writeln!(table, "{:<36} {:>12} {:>12} {:>10}", "parameter", "old", "new", "change");
        }
        for (p, o, n) in &changed {
            let mark = if p.confidence == Confidence::Unconfirmed { "NOT CONFIRMED: " } else { "" };
            let _ = writeln!(
                table,
                "{:<36} {o:>12.4} {n:>12.4} {:>+10.4}  {mark}{}",
                p.name,
                n - o,
                p.meaning
            );
        }
    } else {
        rows = made
            .parameters
            .iter()
            .map(|p| {
                json!({"name": p.name, "value": p.value, "unit": p.unit, "meaning": p.meaning,
                       "confidence": p.confidence})
            })
            .collect();
        map.insert("parameters".into(), rows.clone().into());
        let files = made.files.iter().map(|(name, text)| json!({"name": name, "text": text}));
        map.insert("files".into(), files.collect());
        let several = made.files.len() > 1;
        for (name, text) in &made.files {
            match &args.dir {
                Some(dir) => drop(writeln!(table, "{}", dir.join(name).display())),
                None if several => drop(writeln!(table, "==> {name} <==\n{text}")),
                None => table += text,
            }
        }
    }
    Ok(Outcome::good(Document { json: Value::Object(map), rows, table }))
}
