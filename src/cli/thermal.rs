//! `pivotsight thermal fit|compensate|simulate`.

use std::io::{BufRead, Read, Write};
use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Global, Outcome, Status, result, rows};
use crate::error::{Error, Result, above_zero};
use crate::output::{Document, Format, write_streamed};
use crate::thermal::compensate::{self, Compensator};
use crate::thermal::{self, Model, head, screw, simulate, verify};

/// Thermal error of head and screws: fit a model, compensate in real time
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Fit(FitArgs),
    Compensate(CompensateArgs),
    Simulate(SimulateArgs),
}

/// Fit head sensors and screw slopes; --out writes the model file
#[derive(Debug, clap::Args)]
struct FitArgs {
    /// CSV with head_1_c..head_n_c,displacement_mm
    #[arg(long, value_name = "HEAD.csv", required_unless_present = "screw")]
    head: Option<PathBuf>,
    /// CSV with axis,screw_c,position_mm,error_mm
    #[arg(long, value_name = "SCREW.csv")]
    screw: Option<PathBuf>,
    /// At most this many head sensors; more in the file are selected from
    #[arg(long, requires = "head", value_name = "N", default_value_t = head::MOST_SENSORS)]
    max_sensors: usize,
    /// Select sensors even if the file has no more than that
    #[arg(long, requires = "head")]
    select: bool,
    /// Temperatures of the cold head, one for each sensor (default: readings are rises above it)
    #[arg(long, requires = "head", value_name = "C,C,...", value_delimiter = ',')]
    cold_c: Vec<f64>,
    /// Whether a constant is fitted beside the head sensors
    #[arg(long, requires = "head", value_enum, default_value = "auto")]
    constant: head::Constant,
    /// Axes the head's displacement acts on (default: all, as the source has it)
    #[arg(long, requires = "head", value_name = "AXIS,...", value_delimiter = ',')]
    head_axes: Vec<String>,
    /// Reference position of an axis, for example x=0 (default: where the error lines meet)
    #[arg(long, requires = "screw", value_name = "AXIS=MM", value_delimiter = ',', value_parser = pair)]
    p0_mm: Vec<(String, f64)>,
    /// Temperature at which an axis' slope is zero (default: from the data)
    #[arg(long, requires = "screw", value_name = "AXIS=C", value_delimiter = ',', value_parser = pair)]
    t0_c: Vec<(String, f64)>,
    /// Write thermal.svg to DIR
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
}

/// Read JSON lines, answer each with a correction; or correct a whole table
#[derive(Debug, clap::Args)]
struct CompensateArgs {
    /// The file `thermal fit --out` wrote
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// CSV with axis,position_mm,screw_c,head_*_c and optionally error_mm, instead of JSON lines
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Take a head sensor as stuck once it has stood still while another moved by this much
    #[arg(long, value_name = "C")]
    stuck_c: Option<f64>,
    /// With --table and error_mm: write compensation.svg to DIR
    #[arg(long, value_name = "DIR", requires = "table")]
    plot: Option<PathBuf>,
}

/// Write head.csv, screw.csv and day.csv of a machine whose errors are known
#[derive(Debug, clap::Args)]
struct SimulateArgs {
    /// Folder to write to
    dir: PathBuf,
    /// Sensors on the head; the first four matter
    #[arg(long, default_value_t = 6)]
    sensors: usize,
    /// Rows of the head's run
    #[arg(long, default_value_t = 400)]
    rows: usize,
    /// Same seed, same files
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn pair(text: &str) -> std::result::Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("write AXIS=VALUE, for example x=20")?;
    let value: f64 = value.trim().parse().map_err(|_| format!("'{value}' is not a number"))?;
    if value.is_finite() {
        Ok((name.trim().to_ascii_lowercase(), value))
    } else {
        Err("is not finite".into())
    }
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.command {
        Command::Fit(args) => fit(args, global),
        Command::Compensate(args) => match &args.table {
            Some(table) => correct_table(args, table, global),
            None => stream(args, global),
        },
        Command::Simulate(args) => write_simulation(args, global),
    }
}

fn fit(args: &FitArgs, global: &Global) -> Result<Outcome> {
    if let Some(c) = args.cold_c.iter().find(|c| !c.is_finite()) {
        return Err(Error::option(
            "--cold-c",
            format!("{c} is no temperature"),
            "give numbers in °C",
        ));
    }
    let head_options = head::Options {
        max_sensors: args.max_sensors,
        select: args.select,
        cold_c: args.cold_c.clone(),
        constant: args.constant,
    };
    let screw_options = screw::Options { p0_mm: args.p0_mm.clone(), t0_c: args.t0_c.clone() };
    let head_data = args.head.as_ref().map(|p| head::Data::read(p, &args.cold_c)).transpose()?;
    let screw_data = args.screw.as_ref().map(screw::Data::read).transpose()?;
    let mut warnings = Vec::new();
    let head_axes = args.head_axes.iter().map(|a| a.to_ascii_lowercase()).collect();
    let model = thermal::fit(
        head_data.as_ref().map(|d| (d, &head_options)),
        screw_data.as_ref().map(|d| (d, &screw_options)),
        head_axes,
        &mut warnings,
    )?;
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));
    if let Some(folder) = &args.plot {
        global.write_into(folder, "thermal.svg", model.figure().to_svg().as_bytes())?;
    }
    let input = json!({ "head": args.head, "screw": args.screw });
    let document = Document::single(result("thermal-fit", input, &warnings, &model), model.text());
    // The result is the model file, so --out gets JSON whatever is printed for people.
    match &global.out {
        Some(path) => {
            global.write(path, document.text(Format::Json).as_bytes())?;
            global.say(document.table.trim_end());
            Ok(Outcome { document: None, status: Status::Good })
        }
        None => Ok(Outcome::good(document)),
    }
}

fn compensator(args: &CompensateArgs) -> Result<Compensator> {
    args.stuck_c.map_or(Ok(()), |c| above_zero("--stuck-c", c, "give for example 5"))?;
    Ok(Compensator::new(Model::read(&args.model)?, compensate::Options { stuck_c: args.stuck_c }))
}

/// One line in, one line out, at once: a control waits for each answer.
fn stream(args: &CompensateArgs, global: &Global) -> Result<Outcome> {
    if global.format == Format::Csv {
        let fix = "leave it out, or give a table with --table";
        return Err(Error::option("--format csv", "is no form of the answers to JSON lines", fix));
    }
    let mut compensator = compensator(args)?;
    let mut bad = 0;
    match &global.out {
        Some(path) => write_streamed(path, |file| {
            bad = answer(&mut compensator, file)?;
            Ok(())
        })?,
        None => bad = answer(&mut compensator, &mut std::io::stdout().lock())?,
    }
    Ok(Outcome { document: None, status: if bad > 0 { Status::SomeFailed } else { Status::Good } })
}

/// A reading takes some hundred bytes.
const MOST_LINE: u64 = 1 << 20;

/// Answers what comes on standard input; gives how many lines could not be read.
fn answer(compensator: &mut Compensator, output: &mut dyn Write) -> Result<usize> {
    let failed = |action, e| Error::io("standard input or output", action, e);
    let mut input = std::io::stdin().lock();
    let (mut bytes, mut answer) = (Vec::new(), Vec::new());
    let mut bad = 0;
    loop {
        bytes.clear();
        let most = &mut (&mut input).take(MOST_LINE);
        if most.read_until(b'\n', &mut bytes).map_err(|e| failed("read", e))? == 0 {
            return Ok(bad);
        }
        if bytes.len() as u64 == MOST_LINE && !bytes.ends_with(b"\n") {
            let fix = "send one JSON object a line";
            return Err(Error::file("standard input", "has a line of over a megabyte", fix));
        }
        let line = String::from_utf8_lossy(&bytes);
        if line.trim().is_empty() {
            continue;
        }
        let result = compensator.answer_line(&line);
        bad += usize::from(result.flags.iter().any(|f| f.starts_with("bad-line")));
        answer.clear();
        serde_json::to_writer(&mut answer, &result).map_err(|e| failed("write", e.into()))?;
        answer.push(b'\n');
        match output.write_all(&answer).and_then(|()| output.flush()) {
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => return Ok(bad),
            other => other.map_err(|e| failed("write", e))?,
        }
    }
}

fn correct_table(args: &CompensateArgs, table: &Path, global: &Global) -> Result<Outcome> {
    let report = verify::correct(&mut compensator(args)?, table)?;
    if let Some(folder) = &args.plot {
        let figure = report.figure().to_svg();
        global.write_into(folder, "compensation.svg", figure.as_bytes())?;
    }
    let warnings = report.doubts();
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let json = result("thermal-compensate", table, &warnings, &report);
    Ok(Outcome::good(Document { json, rows: rows(&report.rows), table: report.text() }))
}

fn write_simulation(args: &SimulateArgs, global: &Global) -> Result<Outcome> {
    if !(1..=60).contains(&args.sensors) || !(20..=1_000_000).contains(&args.rows) {
        return Err(Error::option(
            "--sensors, --rows",
            "out of range",
            "give 1 to 60 and 20 to 1000000",
        ));
    }
    let truth = simulate::Truth::sample(args.sensors);
    for (name, text) in [
        ("head.csv", truth.head_csv(args.rows, args.seed)),
        ("screw.csv", truth.screw_csv(&[0.0, 5.0, 10.0, 15.0, 20.0], 11, args.seed + 1)),
        ("day.csv", truth.day_csv(120, args.seed + 2)),
    ] {
        global.write_into(&args.dir, name, text.as_bytes())?;
    }
    Ok(Outcome { document: None, status: Status::Good })
}
