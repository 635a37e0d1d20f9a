//! `pivotsight completions` and `pivotsight man`: what shells and manuals need, made from the commands themselves.

use std::path::PathBuf;

use clap::CommandFactory;

use super::{Cli, Global, Outcome, Status};
use crate::error::{Error, Result};
use crate::output::{Document, create_folder, write_whole};

/// Print a completion script for a shell
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: clap_complete::Shell,
}

/// Write man pages: one for the program and one a command
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Print this command's page instead of writing all
    command: Option<String>,
}

/// Runs `completions`.
pub fn completions(args: &CompletionsArgs) -> Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "pivotsight", &mut script);
    text(script)
}

/// Runs `man`.
pub fn man(args: &ManArgs, global: &Global) -> Result<Outcome> {
    let mut program = Cli::command();
    program.build();
    if let Some(name) = &args.command {
        let command = program.find_subcommand(name).ok_or_else(|| {
            Error::option("COMMAND", format!("'{name}' is not a command"), "see pivotsight --help")
        })?;
        return text(page(command)?);
    }
    let Some(folder) = global.out.clone() else { return text(page(&program)?) };
    create_folder(&folder)?;
    let write = |command: &clap::Command, name: String| -> Result<PathBuf> {
        let path = folder.join(format!("{name}.1"));
        write_whole(&path, &page(command)?)?;
        Ok(path)
    };
    write(&program, "pivotsight".into())?;
    let mut count = 1;
    for command in program.get_subcommands().filter(|c| c.get_name() != "help") {
        write(command, format!("pivotsight-{}", command.get_name()))?;
        count += 1;
    }
    global.say(format!("wrote {count} pages to {}", folder.display()));
    Ok(Outcome { document: None, status: Status::Good })
}

fn page(command: &clap::Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone())
        .render(&mut page)
        .map_err(|e| Error::io("man page", "write", e))?;
    Ok(page)
}

fn text(bytes: Vec<u8>) -> Result<Outcome> {
    let text = String::from_utf8_lossy(&bytes).into_owned();
    Ok(Outcome::good(Document::single(serde_json::Value::String(text.clone()), text)))
}
