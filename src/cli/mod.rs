//! The command line: parses, calls the library, prints. One file per command.

mod align;
mod ballbar;
mod diagnose;
mod export;
mod machine;
mod render;
mod rotary;
mod rtcp;
mod simulate;
mod solve;
mod thermal;
mod verify;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use crate::error::{Error, Result};
use crate::output::{Document, Format, write_whole};

/// Measures a five-axis laser machine's rotary axes with a camera and computes what to type into the control.
#[derive(Debug, Parser)]
#[command(name = "pivotsight", version, about, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

/// Options every command has.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// How the result is printed
    #[arg(long, value_enum, default_value = "table", global = true)]
    pub format: Format,
    /// Write the result to FILE (whole or not at all) instead of standard output
    #[arg(long, value_name = "FILE", global = true)]
    pub out: Option<PathBuf>,
    /// No progress and no warnings on standard error
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Say more on standard error
    #[arg(long, short, action = clap::ArgAction::Count, global = true)]
    pub verbose: u8,
}

impl Global {
    /// Prints a progress line or warning on standard error unless `--quiet`.
    pub fn say(&self, message: impl std::fmt::Display) {
        if !self.quiet {
            eprintln!("{message}");
        }
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    Align(align::Args),
    Diagnose(diagnose::Args),
    Render(render::Args),
    Ballbar(ballbar::Args),
    Rotary(rotary::Args),
    Thermal(thermal::Args),
    Export(export::Args),
    Machine(machine::Args),
    Rtcp(rtcp::Args),
    Simulate(simulate::Args),
    Solve(solve::Args),
    Verify(verify::Args),
}

/// What a command hands back: something to print, and how it went.
#[derive(Debug)]
pub struct Outcome {
    /// The result; `None` where the command already wrote what it makes.
    pub document: Option<Document>,
    /// The exit code's meaning.
    pub status: Status,
}

/// The meaning of an exit code (`docs/conventions.md`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// 0: measured, within tolerance or no tolerance applies.
    Good,
    /// 1: measured, and the verdict is `fail` or `undecided`.
    OutOfTolerance,
    /// 3: several inputs, and some of them failed.
    SomeFailed,
    /// 2: nothing measured.
    BadInput,
}

impl Outcome {
    /// A result with no tolerance, or within it.
    pub fn good(document: Document) -> Self {
        Self { document: Some(document), status: Status::Good }
    }
}

impl Status {
    fn code(self) -> ExitCode {
        ExitCode::from(match self {
            Self::Good => 0,
            Self::OutOfTolerance => 1,
            Self::BadInput => 2,
            Self::SomeFailed => 3,
        })
    }
}

/// Runs the program with the process's own arguments.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    match dispatch(&cli).and_then(|outcome| print(&cli.global, outcome)) {
        Ok(status) => status.code(),
        Err(error) => {
            eprintln!("pivotsight: {error}");
            Status::BadInput.code()
        }
    }
}

fn dispatch(cli: &Cli) -> Result<Outcome> {
    let global = &cli.global;
    match &cli.command {
        Command::Align(args) => align::run(args, global),
        Command::Diagnose(args) => diagnose::run(args, global),
        Command::Render(args) => render::run(args, global),
        Command::Ballbar(args) => ballbar::run(args, global),
        Command::Rotary(args) => rotary::run(args, global),
        Command::Thermal(args) => thermal::run(args, global),
        Command::Export(args) => export::run(args, global),
        Command::Machine(args) => machine::run(args, global),
        Command::Rtcp(args) => rtcp::run(args, global),
        Command::Simulate(args) => simulate::run(args, global),
        Command::Solve(args) => solve::run(args, global),
        Command::Verify(args) => verify::run(args, global),
    }
}

/// Prints the document where the user asked for it. A closed pipe is not an error.
fn print(global: &Global, outcome: Outcome) -> Result<Status> {
    let Some(document) = outcome.document else { return Ok(outcome.status) };
    let text = document.text(global.format);
    match &global.out {
        Some(path) => write_whole(path, text.as_bytes())?,
        None => match std::io::stdout().write_all(text.as_bytes()) {
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                return Err(Error::io("standard output", "write", e));
            }
            _ => {}
        },
    }
    Ok(outcome.status)
}

/// The keys every JSON result begins with; the command's own keys follow.
pub fn envelope(
    command: &str,
    input: impl serde::Serialize,
    warnings: &[String],
) -> serde_json::Map<String, serde_json::Value> {
    let mut map = serde_json::Map::new();
    map.insert("schema".into(), format!("pivotsight.{command}/1").into());
    map.insert("version".into(), env!("CARGO_PKG_VERSION").into());
    map.insert("input".into(), serde_json::to_value(input).unwrap_or_default());
    map.insert("warnings".into(), warnings.into());
    map
}
