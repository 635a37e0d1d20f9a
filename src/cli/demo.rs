//! `pivotsight demo`: the whole method on a virtual machine.

use std::fmt::Write;
use std::path::PathBuf;

use super::{Global, Outcome, Status, result};
use crate::demo::{self, Report, hidden};
use crate::error::Result;
use crate::output::Document;

/// The whole method on a virtual machine: burn, measure, correct, solve
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the pictures
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    out_dir: PathBuf,
    /// Draws another machine
    #[arg(long, default_value_t = 3)]
    seed: u64,
    /// Hide an effect in the machine instead, find it in pictures of a rod, name it and correct the model
    #[arg(long)]
    hidden_effect: bool,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    if args.hidden_effect {
        return hidden(args, global);
    }
    global.say("a virtual machine is burnt, photographed, measured and corrected ...");
    let report = demo::run(&demo::Options { seed: args.seed, folder: args.out_dir.clone() })?;
    let input = serde_json::json!({ "seed": args.seed, "out_dir": args.out_dir });
    let json = result("demo", input, &[], &report);
    let status = if report.closed { Status::Good } else { Status::OutOfTolerance };
    Ok(Outcome { document: Some(Document::single(json, story(&report, args))), status })
}

/// The demo of the diagnosis.
fn hidden(args: &Args, global: &Global) -> Result<Outcome> {
    global
        .say("a rod is photographed on a machine with a hidden effect, measured and diagnosed ...");
    let report = hidden::run(&hidden::Options { seed: args.seed, folder: args.out_dir.clone() })?;
    let input = serde_json::json!({ "seed": args.seed, "out_dir": args.out_dir });
    let json = result("demo-hidden", input, &[], &report);
    let um = |mm: f64| 1000.0 * mm;
    let mut s = format!("{} pictures of the rod; diagnose says:\n", report.pictures);
    let _ = writeln!(s, "  verdict   {}", report.verdict.word());
    for e in &report.effects {
        let _ = writeln!(
            s,
            "  effect    {}: {} ({:.0} % of the gap)",
            e.name, e.meaning, e.share_percent
        );
        for (name, value) in &e.parameters {
            let u95 = e.parameters_u95.get(name).copied().unwrap_or_default();
            let _ = writeln!(s, "              {name} = {value:.4} ± {u95:.4}");
        }
        if !e.confusable_with.is_empty() {
            let _ = writeln!(s, "              fits as well: {}", e.confusable_with.join(", "));
        }
    }
    for u in &report.unnamed {
        let _ = writeln!(s, "  unnamed   {}", u.text);
    }
    let g = &report.gap;
    let _ = writeln!(
        s,
        "  gap       {:.2} -> {:.2} µm rms; on captures held out {:.2} -> {:.2} µm; noise {:.2} µm",
        um(g.before_rms_mm),
        um(g.after_rms_mm),
        um(g.heldout_before_rms_mm),
        um(g.heldout_after_rms_mm),
        um(g.noise_rms_mm)
    );
    let _ = writeln!(s, "With the corrected model: {}", report.corrected_verdict.word());
    let h = &report.hidden;
    let _ = writeln!(s, "Hidden was {}: {} = {:.4}", h.name, h.parameter, h.value);
    let _ = writeln!(
        s,
        "{}; pictures, tables, models and pages in {}",
        if report.closed { "The gap is closed" } else { "The gap is NOT closed" },
        args.out_dir.display()
    );
    let status = if report.closed { Status::Good } else { Status::OutOfTolerance };
    Ok(Outcome { document: Some(Document::single(json, s)), status })
}

/// The report for people.
fn story(report: &Report, args: &Args) -> String {
    let mut s = String::new();
    let um = |mm: f64| 1000.0 * mm;
    for (i, test) in report.burn_tests.iter().enumerate() {
        let [b, a] = test.true_tilt_deg;
        let [x, y] = test.offset_mm;
        let [ux, uy] = test.offset_u95_mm;
        let [tx, ty] = test.true_offset_mm;
        let _ = writeln!(
            s,
            "Burn test {}: truly B leans {b:+.4}° and the flange {a:+.4}°\n  \
             offset   x {:+7.1} ± {:.1} µm (true {:+.1}), y {:+7.1} ± {:.1} µm (true {:+.1})\n  \
             distance {:7.1} ± {:.1} µm, limit 10 µm: {}",
            i + 1,
            um(x),
            um(ux),
            um(tx),
            um(y),
            um(uy),
            um(ty),
            um(test.distance_mm),
            um(test.distance_u95_mm),
            test.verdict,
        );
        if let Some([b, shim]) = test.correction_deg {
            let _ = writeln!(s, "  turn B by {b:+.4}° and the flange by {shim:+.4}°");
        }
    }
    let _ = writeln!(s, "\nRod photographed at three C angles, touched at B = ±90°, solved (mm):");
    let _ = writeln!(s, "  {:<16}{:>12}{:>12}{:>9}", "", "true", "found", "± u95");
    for v in &report.values {
        let mark = if v.within_u95 { "" } else { "  outside" };
        let _ = writeln!(
            s,
            "  {:<16}{:>12.4}{:>12.4}{:>9.4}{mark}",
            v.name.trim_end_matches("_mm"),
            v.true_mm,
            v.found_mm,
            v.u95_mm
        );
    }
    for (i, [x, y, z]) in report.vectors_mm.iter().enumerate() {
        let _ = writeln!(s, "  I{} = ({x:.4}, {y:.4}, {z:.4})", i + 1);
    }
    let _ = writeln!(
        s,
        "\nTool point's largest error for B within ±90°: {:.3} mm before, {:.4} mm after",
        report.rtcp_before_mm, report.rtcp_after_mm
    );
    let _ = writeln!(
        s,
        "{}; pictures in {}",
        if report.closed { "The loop is closed" } else { "The loop is NOT closed" },
        args.out_dir.display()
    );
    s
}
