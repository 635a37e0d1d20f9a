//! `pivotsight align`: touches in, tilt and centre out; `align apply` moves a program onto the blank.

use std::path::PathBuf;

use serde_json::json;

use super::outfiles::OutFile;
use super::{Global, Outcome, Status, place, result};
use crate::align::apply::{self, Form};
use crate::align::{self, Alignment, Touches, fit};
use crate::error::{Error, Result};
use crate::machine::Machine;
use crate::output::Document;

/// Find how a blank lies, and move CL data or NC code onto it
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    fit: FitArgs,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Apply(ApplyArgs),
}

#[derive(Debug, clap::Args)]
struct FitArgs {
    /// CSV with kind,x_mm,y_mm,z_mm; kind is face, side_x or side_y
    #[arg(required = true)]
    points: Option<PathBuf>,
    /// Height of the face in the program
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    z_ideal_mm: f64,
    /// The blank's axis in the program
    #[arg(long, value_name = "X,Y", default_value = "0,0", value_parser = place, allow_hyphen_values = true)]
    center_ideal_mm: [f64; 2],
    /// Turn of the path about the blank's axis
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    c_deg: f64,
    /// Standard uncertainty of a touch (default: from the face's residuals)
    #[arg(long, value_name = "MM")]
    touch_u_mm: Option<f64>,
    /// Write align.svg to DIR
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
}

/// Move a program onto the blank and post it for the machine
#[derive(Debug, clap::Args)]
struct ApplyArgs {
    /// The result of `align --format json`
    #[arg(long, value_name = "FILE.json")]
    align: PathBuf,
    /// The machine file
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// CL data (.cl .csv .txt), APT (.apt .cls) or NC code (.nc .ngc .mpf ...)
    input: PathBuf,
    /// Where the moved program goes; its name tells its form
    output: OutFile,
    /// Form of the input, where its name does not tell
    #[arg(long, value_enum)]
    from: Option<Form>,
    /// Form of the output, where its name does not tell
    #[arg(long, value_enum)]
    to: Option<Form>,
    /// Move the path back from the blank
    #[arg(long)]
    inverse: bool,
    /// Most that the tool's point may leave the path in a straight move of the joints; points are added to keep it. The
    /// tool's direction is held at the points alone
    #[arg(long, value_name = "MM", default_value_t = 0.005)]
    tolerance_mm: f64,
    /// Digits after the point (default: 9 for CL data, 6 for NC code; angles 2 more)
    #[arg(long, value_name = "N")]
    decimals: Option<usize>,
    /// The control's RTCP is on: X Y Z are tool points on the work
    #[arg(long)]
    rtcp: bool,
    /// Feed of NC code made from CL data
    #[arg(long, value_name = "F", default_value_t = 1000.0)]
    feed_mm_min: f64,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.command {
        Some(Command::Apply(args)) => apply_to(args, global),
        None => measure(&args.fit, global),
    }
}

fn measure(args: &FitArgs, global: &Global) -> Result<Outcome> {
    let points = args
        .points
        .as_ref()
        .ok_or_else(|| Error::option("POINTS.csv", "is missing", "give the file of touches"))?;
    let options = fit::Options {
        z_ideal_mm: args.z_ideal_mm,
        center_ideal_mm: args.center_ideal_mm,
        c_deg: args.c_deg,
        touch_u_mm: args.touch_u_mm,
    };
    let mut warnings = Vec::new();
    let touches = Touches::read(points)?;
    let alignment =
        align::fit(&touches, &options, &mut warnings).map_err(|e| e.measured_in(points))?;
    warnings.extend(alignment.doubts());
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    if let Some(folder) = &args.plot {
        global.write_into(folder, "align.svg", alignment.figure(&touches).to_svg().as_bytes())?;
    }
    let json = result("align", points, &warnings, &alignment);
    Ok(Outcome::good(Document::single(json, alignment.text())))
}

fn apply_to(args: &ApplyArgs, global: &Global) -> Result<Outcome> {
    let options = apply::Options {
        from: args.from,
        to: args.to,
        inverse: args.inverse,
        tolerance_mm: args.tolerance_mm,
        decimals: args.decimals,
        rtcp: args.rtcp,
        feed_mm_min: args.feed_mm_min,
    };
    let (alignment, machine) = (Alignment::read(&args.align)?, Machine::read(&args.machine)?);
    let report = apply::apply(&alignment, &machine, &args.input, &args.output, &options)?;
    let log = &report.log;
    let list = |l: &align::post::Lines| {
        let lines: Vec<String> = l.first_lines.iter().map(u64::to_string).collect();
        format!(
            "{} (lines {}{})",
            l.count,
            lines.join(", "),
            if l.count > 10 { ", ..." } else { "" }
        )
    };
    let mut warnings = machine.doubts();
    warnings.extend(alignment.doubts());
    if log.singular.count > 0 {
        warnings.push(format!("singular poses, a rotary axis is free: {}", list(&log.singular)));
    }
    if log.long_rotary.count > 0 {
        warnings.push(format!(
            "long rotary moves, up to {:.1}°: {}",
            log.largest_rotary_deg,
            list(&log.long_rotary)
        ));
    }
    if log.left_out.count > 0 {
        warnings.push(format!(
            "statements that each machine has its own words for (spindle, coolant, tool, stop) are comments now: {}",
            list(&log.left_out)
        ));
    }
    if log.not_held.count > 0 {
        warnings.push(format!(
            "the path is not held within {} mm: {}",
            args.tolerance_mm,
            list(&log.not_held)
        ));
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    let table = format!(
        "{} lines, {} moves, {} points added to hold {} mm; wrote {}\n",
        report.lines,
        log.moves,
        log.added,
        args.tolerance_mm,
        args.output.display()
    );
    let input = json!({ "align": args.align, "program": args.input });
    let json = result("align-apply", input, &warnings, &report);
    let status = if log.not_held.count > 0 { Status::OutOfTolerance } else { Status::Good };
    Ok(Outcome { document: Some(Document::single(json, table)), status })
}
