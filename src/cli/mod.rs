//! The command line: parses, calls the library, prints. One file per command.

mod align;
mod ballbar;
mod batch;
mod burn;
mod calib;
mod capture;
mod center;
mod circles;
mod config;
mod demo;
mod diagnose;
mod export;
mod global;
mod history;
mod machine;
mod outcome;
mod outfiles;
mod pages;
mod pictures;
mod regress;
mod render;
mod report;
mod rod;
mod rotary;
mod rtcp;
mod schema;
mod simulate;
mod solve;
mod thermal;
mod verify;

use std::io::Write;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

pub use global::Global;
pub use outcome::{Outcome, Status, envelope, result, rows};

use crate::error::{Error, Result};
use crate::store::Store;
use global::complain;
use outfiles::Files;

/// Measures a five-axis laser machine's rotary axes with a camera and computes what to type into the control.
#[derive(Debug, Parser)]
#[command(name = "pivotsight", version = crate::cv::version(), about, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Burn(burn::Args),
    Calib(calib::Args),
    Capture(capture::Args),
    Center(center::Args),
    Circles(circles::Args),
    Align(align::Args),
    Ballbar(ballbar::Args),
    Batch(batch::Args),
    Completions(pages::CompletionsArgs),
    Config(config::Args),
    Demo(demo::Args),
    Diagnose(diagnose::Args),
    Export(export::Args),
    History(history::Args),
    Machine(machine::Args),
    Man(pages::ManArgs),
    Regress(regress::Args),
    Render(render::Args),
    Report(report::Args),
    Rod(rod::Args),
    Rotary(rotary::Args),
    Rtcp(rtcp::Args),
    Schema(schema::Args),
    Simulate(simulate::Args),
    Solve(solve::Args),
    Thermal(thermal::Args),
    Verify(verify::Args),
}

/// The whole command line. A negative number is a value wherever one is taken: what is wrong with it the library says.
fn command() -> clap::Command {
    fn with_negative(command: clap::Command) -> clap::Command {
        command
            .mut_args(|a| {
                let takes = a.get_action().takes_values() && !a.is_allow_hyphen_values_set();
                if takes { a.allow_negative_numbers(true) } else { a }
            })
            .mut_subcommands(with_negative)
    }
    with_negative(Cli::command())
}

/// Runs the program with the process's own arguments.
pub fn run() -> ExitCode {
    let fail = |error: Error| {
        complain(format_args!("pivotsight: {error}"));
        Status::BadInput.code()
    };
    let arguments = match config::arguments(std::env::args_os().collect()) {
        Ok(arguments) => arguments,
        Err(error) => return fail(error),
    };
    let mut command = command();
    let parsed = command
        .try_get_matches_from_mut(&arguments)
        .and_then(|matches| Ok((Cli::from_arg_matches(&matches)?, matches)));
    let (mut cli, matches) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => error.exit(),
    };
    match Files::plan(&command, &matches, out_is_folder(&cli.command)) {
        Ok(files) => cli.global.files = files,
        Err(error) => return fail(error),
    }
    if let Some(path) = &cli.global.records
        && is_kept(&cli.command)
        && let Err(error) = Store::check(path)
    {
        return fail(error);
    }
    let words: Vec<String> = arguments.iter().map(|a| a.to_string_lossy().into_owned()).collect();
    let global = &cli.global;
    global.note(words.join(" "));
    global.detail(format_args!("pivotsight {}: {}", env!("CARGO_PKG_VERSION"), words.join(" ")));
    let begun = Instant::now();
    let status = dispatch(&cli).and_then(|outcome| {
        if is_kept(&cli.command) {
            history::told(global, history::keep(global, &words, &outcome));
        }
        let takes_out = out_is_folder(&cli.command) || makes_file(&cli.command);
        hand_out(global, !takes_out, outcome)
    });
    let took =
        format!("{:.3} s, {} threads", begun.elapsed().as_secs_f64(), rayon::current_num_threads());
    match status {
        Ok(status) => {
            global.detail(format_args!("{}: exit code {}, {took}", status.word(), status.number()));
            global.note(format_args!("ended: {}", status.word()));
            status.code()
        }
        Err(error) => {
            global.note(format_args!("ended: {error}"));
            fail(error)
        }
    }
}

/// A time given in seconds.
fn seconds(option: &str, s: f64) -> Result<Duration> {
    Duration::try_from_secs_f64(s).map_err(|_| {
        Error::option(option, format!("{s} is not a time"), "give seconds, zero or more")
    })
}

/// Whether the command's result goes into the records.
fn is_kept(command: &Command) -> bool {
    use Command::{Completions, Config, Demo, History, Man, Regress, Render, Report, Schema};
    // What is only made, or tells of results that are kept, is no measurement.
    !matches!(
        command,
        Completions(_)
            | Config(_)
            | Demo(_)
            | History(_)
            | Man(_)
            | Regress(_)
            | Render(_)
            | Report(_)
            | Schema(_)
    )
}

/// Whether `--out` names a folder of what the command makes, not its printed result.
fn out_is_folder(command: &Command) -> bool {
    matches!(command, Command::Batch(_) | Command::Man(_))
}

/// Whether `--out` names the file the command makes, not its printed result.
fn makes_file(command: &Command) -> bool {
    match command {
        Command::Report(_) => true,
        Command::Calib(args) => args.makes_file(),
        _ => false,
    }
}

fn dispatch(cli: &Cli) -> Result<Outcome> {
    let global = &cli.global;
    match &cli.command {
        Command::Burn(args) => burn::run(args, global),
        Command::Calib(args) => calib::run(args, global),
        Command::Capture(args) => capture::run(args, global),
        Command::Center(args) => center::run(args, global),
        Command::Circles(args) => circles::run(args, global),
        Command::Align(args) => align::run(args, global),
        Command::Ballbar(args) => ballbar::run(args, global),
        Command::Batch(args) => batch::run(args, global),
        Command::Completions(args) => pages::completions(args),
        Command::Config(args) => config::run(args, global),
        Command::Demo(args) => demo::run(args, global),
        Command::Diagnose(args) => diagnose::run(args, global),
        Command::Export(args) => export::run(args, global),
        Command::History(args) => history::run(args, global),
        Command::Machine(args) => machine::run(args, global),
        Command::Man(args) => pages::man(args, global),
        Command::Regress(args) => regress::run(args, global),
        Command::Render(args) => render::run(args, global),
        Command::Report(args) => report::run(args, global),
        Command::Rod(args) => rod::run(args, global),
        Command::Rotary(args) => rotary::run(args, global),
        Command::Rtcp(args) => rtcp::run(args, global),
        Command::Schema(args) => schema::run(args),
        Command::Simulate(args) => simulate::run(args, global),
        Command::Solve(args) => solve::run(args, global),
        Command::Thermal(args) => thermal::run(args, global),
        Command::Verify(args) => verify::run(args, global),
    }
}

/// Prints the document where the user asked for it, and lets the files beside it appear. A closed pipe is not an error.
fn hand_out(global: &Global, to_out: bool, outcome: Outcome) -> Result<Status> {
    let text = outcome.document.map(|document| document.text(global.format));
    match (&global.out, text) {
        (Some(path), Some(text)) if to_out => global.files.add(path, text.as_bytes())?,
        (_, Some(text)) => match std::io::stdout().write_all(text.as_bytes()) {
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                return Err(Error::io("standard output", "write", e));
            }
            _ => {}
        },
        (_, None) => {}
    }
    for path in global.files.publish()? {
        global.say(format_args!("wrote {}", path.display()));
    }
    Ok(outcome.status)
}

/// A place in the plane, as `--near-mm` and its like take it.
fn place(text: &str) -> std::result::Result<[f64; 2], String> {
    let parts: Vec<f64> = text.split(',').map_while(|v| v.trim().parse().ok()).collect();
    match parts[..] {
        [x, y] if x.is_finite() && y.is_finite() && text.matches(',').count() == 1 => Ok([x, y]),
        _ => Err("give two numbers in mm: X,Y".into()),
    }
}
