//! `pivotsight diagnose`: what the machine model lacks, by name where the evidence allows it.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args as ClapArgs;

use crate::cli::outfiles::OutFile;
use crate::cli::{Global, Outcome, result};
use crate::diagnose::files::{Diagnosed, Options, diagnose, plan};
use crate::diagnose::load::Source;
use crate::diagnose::page;
use crate::diagnose::report::{Detectable, NamedEffect, Outlier, Report};
use crate::error::{Error, Result};
use crate::machine::DataKind;
use crate::output::Document;

/// Find where simulation and measurement part, and name what is missing
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// The kind of data
    #[arg(value_enum)]
    kind: DataKind,
    /// Measured data (columns: docs/diagnose.md)
    #[arg(long, value_name = "DATA.csv")]
    data: PathBuf,
    /// The machine file the control's numbers stand in
    #[arg(long, value_name = "machine.toml")]
    model: Option<PathBuf>,
    /// The camera's calibration file (rod)
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// The rod's nominal diameter, where the plan is a table of captures (x_mm,y_mm,c_deg,...) without edge points
    #[arg(long, value_name = "D", requires = "plan_only")]
    diameter_mm: Option<f64>,
    /// A TOML file with effects of your own, as formulas of the columns (docs/diagnose.md)
    #[arg(long, value_name = "FILE")]
    effects: Option<PathBuf>,
    /// Standard deviation of one value where it is known; otherwise it is taken from repeats and the data
    #[arg(long, value_name = "S")]
    noise_mm: Option<f64>,
    /// Write the machine file with the named effects added, and as formulas the shapes without a name
    #[arg(long, value_name = "FILE")]
    write_model: Option<OutFile>,
    /// Write the captures that tell confusable effects apart, as a CSV table
    #[arg(long, value_name = "FILE")]
    write_next: Option<OutFile>,
    /// Write a page with plots before and after into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Only say what this plan can and cannot show; the measured columns are not needed (of a rod's captures give --diameter-mm)
    #[arg(long, conflicts_with_all = ["write_model", "write_next", "report"])]
    plan_only: bool,
}

/// What is printed.
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)] // Only described.
pub enum Output {
    Diagnosed(Box<Report>),
    Planned(Planned),
}

/// What a plan can show.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Planned {
    /// The kind of data.
    kind: String,
    /// Standard deviation of one value.
    noise_mm: f64,
    /// Every effect of the library.
    detectable: Vec<Detectable>,
}

/// Refuses options that are of another kind of data: each with its kind and whether it is given.
pub(super) fn is_of_kind(kind: DataKind, options: &[(&str, DataKind, bool)]) -> Result<()> {
    let other = options.iter().find(|(_, of, given)| *given && *of != kind);
    other.map_or(Ok(()), |(option, of, _)| {
        let reason = format!("is not used for {} data", kind.name());
        Err(Error::option(*option, reason, format!("leave it out, it is for {}", of.name())))
    })
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    is_of_kind(
        args.kind,
        &[
            ("--calib", DataKind::Rod, args.calib.is_some()),
            ("--diameter-mm", DataKind::Rod, args.diameter_mm.is_some()),
        ],
    )?;
    let source = Source {
        kind: args.kind,
        data: args.data.clone(),
        model: args.model.clone(),
        calib: args.calib.clone(),
        effects: args.effects.clone(),
        diameter_mm: args.diameter_mm,
        measured: !args.plan_only,
    };
    if let Some(folder) = &args.report {
        global.makes("--report", folder, ["index.html"])?;
    }
    let mut warnings = Vec::new();
    let experiment = source.load(&mut warnings)?;
    // Told at once: they may be why the rest fails.
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let told = warnings.len();
    let input = args.data.display().to_string();
    if args.plan_only {
        let noise_mm = args.noise_mm.ok_or_else(|| {
            Error::option(
                "--noise-mm",
                "is missing: what can be seen depends on it",
                "give the standard deviation of one value in mm",
            )
        })?;
        let list = plan(&source, experiment.as_ref(), noise_mm)?;
        let table = plan_table(&list);
        let planned = Planned { kind: experiment.kind().name().into(), noise_mm, detectable: list };
        let json = result("diagnose", input, &warnings, &planned);
        return Ok(Outcome::good(Document::single(json, table)));
    }
    let options = Options { noise_mm: args.noise_mm, with_model: args.write_model.is_some() };
    let Diagnosed { report, model, warnings: found } =
        diagnose(&source, experiment.as_ref(), options)?;
    warnings.extend(found);
    if let (Some(model), Some(path)) = (&model, &args.write_model) {
        global.write(path, model.to_toml().as_bytes())?;
    }
    if let Some(path) = &args.write_next {
        match &report.next_measurement {
            Some(next) if !next.captures.is_empty() => global.write(path, next.csv().as_bytes())?,
            _ => warnings.push(format!(
                "{} is not written: no capture would tell effects apart",
                path.display()
            )),
        }
    }
    warnings[told..].iter().for_each(|w| global.say(format_args!("warning: {w}")));
    if let Some(folder) = &args.report {
        let page = page::html(experiment.as_ref(), &report);
        global.write_into(folder, "index.html", page.as_bytes())?;
    }
    let json = result("diagnose", input, &warnings, &report);
    Ok(Outcome::good(Document::single(json, table(&report))))
}

fn table(r: &Report) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        t,
        "verdict   {}  ({} captures, {} values, {}: {})",
        r.verdict.word(),
        r.captures,
        r.observations,
        r.noise_text(),
        r.noise_source
    );
    r.effects.iter().for_each(|e| t.push_str(&effect_lines(e)));
    for e in &r.in_the_control {
        let u95 = e.u95_mm.map_or(String::new(), |u| format!(" ± {u:.4}"));
        let _ = writeln!(
            t,
            "control   {} {:.4} -> {:.4}{u95} mm, if it is {}",
            e.key, e.now_mm, e.new_mm, e.effect
        );
    }
    for u in &r.unnamed {
        let _ = writeln!(t, "unnamed   {}", u.text);
    }
    let g = &r.gap;
    let described = g
        .with_unnamed_rms_mm
        .map_or(String::new(), |rms| format!(" ({:.2} with what has no name)", 1e3 * rms));
    let _ = writeln!(
        t,
        "gap       {:.2} -> {:.2} µm rms{described}; on captures held out {:.2} -> {:.2} µm; noise {:.2} µm",
        1e3 * g.before_rms_mm,
        1e3 * g.after_rms_mm,
        1e3 * g.heldout_before_rms_mm,
        1e3 * g.heldout_after_rms_mm,
        1e3 * g.noise_rms_mm
    );
    for w in r.places.iter().take(3) {
        let place = match w.from == w.to {
            true => format!("= {:.2}", w.from),
            false => format!("{:.2} .. {:.2}", w.from, w.to),
        };
        let _ = writeln!(
            t,
            "where     {} at {} {place}: {:.2} µm rms before",
            w.output,
            w.versus,
            1e3 * w.rms_mm
        );
    }
    if let Some(next) = &r.next_measurement {
        let _ = writeln!(t, "next      {}", next.text);
        let (places, more) = next.places();
        for row in &places {
            let cells: String = row.iter().map(|cell| format!(" {cell:>12}")).collect();
            let _ = writeln!(t, "         {cells}");
        }
        if more > 0 {
            let _ = writeln!(t, "          and {more} more: --write-next FILE writes them all");
        }
    }
    t.push_str(&outliers_line(&r.outliers));
    t
}

/// A named effect: its parameters, what fits as well, what was corrected of its form.
fn effect_lines(e: &NamedEffect) -> String {
    let mut t = String::new();
    let _ =
        writeln!(t, "effect    {}: {} ({:.0} % of the gap)", e.name, e.meaning, e.share_percent);
    for (name, value) in &e.parameters {
        match e.parameters_u95.get(name) {
            Some(u) => {
                let _ = writeln!(t, "            {name} = {value:.6} ± {u:.6}");
            }
            None => {
                let _ = writeln!(t, "            {name} = {value}");
            }
        }
    }
    if !e.confusable_with.is_empty() {
        let own = 100.0 * e.weight;
        let _ = writeln!(t, "            fits as well: {} (itself {own:.0} %)", e.class());
    }
    if !e.form_corrected_over.is_empty() {
        let _ = writeln!(
            t,
            "            its size changes with {} more than the library's forms say",
            e.form_corrected_over.join(", ")
        );
    }
    t
}

fn outliers_line(outliers: &[Outlier]) -> String {
    /// So many are listed; all are in the JSON.
    const LISTED: usize = 6;
    if outliers.is_empty() {
        return String::new();
    }
    let named = outliers.iter().take(LISTED).map(|o| match o.column {
        Some(column) => format!("row {} {column}", o.row),
        None => format!("row {}", o.row),
    });
    let more = if outliers.len() > LISTED { ", …" } else { "" };
    let list = named.collect::<Vec<_>>().join(", ");
    format!("outliers  {} values set aside: {list}{more}\n", outliers.len())
}

/// A size with three digits that count.
fn significant(value: f64) -> String {
    let decimals = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}

fn plan_table(list: &[Detectable]) -> String {
    let mut t = format!("{:18} smallest size seen 19 times of 20\n", "effect");
    for d in list {
        let what = match &d.untestable {
            Some(why) => format!("cannot be tested: {why}"),
            None => d
                .least
                .iter()
                .map(|(name, v)| format!("{name} {}", significant(*v)))
                .collect::<Vec<_>>()
                .join(", "),
        };
        let _ = write!(t, "{:18} {what}", d.name);
        if !d.aliases.is_empty() {
            let _ = write!(t, "  (looks like {})", d.aliases.join(", "));
        }
        t.push('\n');
    }
    t
}
