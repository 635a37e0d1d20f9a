//! `pivotsight demo`: the whole method on a virtual machine.

use std::fmt::Write;
use std::path::PathBuf;

use super::{Global, Outcome, Status, result};
use crate::demo::{self, HiddenReport, Report};
use crate::error::Result;
use crate::output::Document;
use crate::uncertainty::Verdict;

/// The whole method on a virtual machine: burn, measure, correct, solve
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the pictures
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    out_dir: PathBuf,
    /// Draws another machine
    #[arg(long, default_value_t = 6)]
    seed: u64,
    /// A machine with an effect its model lacks: photograph, measure, diagnose, correct the model
    #[arg(long)]
    hidden_effect: bool,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let options = demo::Options { seed: args.seed, folder: args.out_dir.clone() };
    let input = serde_json::json!({ "seed": args.seed, "out_dir": args.out_dir });
    let (json, text, good) = if args.hidden_effect {
        global.say("a check rod is photographed on a machine whose model lacks an effect ...");
        let report = demo::run_hidden(&options)?;
        let json = result("demo-hidden-effect", input, &[], &report);
        (json, hidden_story(&report, args), report.found)
    } else {
        global.say("a virtual machine is burnt, photographed, measured and corrected ...");
        let report = demo::run(&options)?;
        (result("demo", input, &[], &report), story(&report, args), report.closed)
    };
    let status = if good { Status::Good } else { Status::OutOfTolerance };
    Ok(Outcome { document: Some(Document::single(json, text)), status })
}

/// The hidden effect's report for people.
fn hidden_story(r: &HiddenReport, args: &Args) -> String {
    let um = |mm: f64| 1000.0 * mm;
    let mut s = String::new();
    let _ = writeln!(
        s,
        "Hidden in the machine: {}, {:.2} µm wide; the model knows nothing of it",
        r.hidden,
        um(r.true_width_mm)
    );
    let _ =
        writeln!(s, "{} pictures of the rod, measured and compared with the model:", r.captures);
    let _ = writeln!(s, "  verdict  {}: {}", r.verdict.word(), r.named.join(", "));
    if let (Some(width), Some(u95)) = (r.found_width_mm, r.found_width_u95_mm) {
        let _ = writeln!(s, "  {:<8} {:.2} ± {:.2} µm", r.hidden, um(width), um(u95));
    }
    let g = &r.gap;
    let _ = writeln!(
        s,
        "  gap      {:.2} -> {:.2} µm rms; on captures held out {:.2} -> {:.2} µm; noise {:.2} µm",
        um(g.before_rms_mm),
        um(g.after_rms_mm),
        um(g.heldout_before_rms_mm),
        um(g.heldout_after_rms_mm),
        um(g.noise_rms_mm)
    );
    let _ = writeln!(
        s,
        "The model corrected (corrected.toml) and compared again:\n  verdict  {}; gap {:.2} µm rms",
        r.verdict_corrected.word(),
        um(r.rms_corrected_mm)
    );
    let _ = writeln!(
        s,
        "{}; pictures, before/index.html and after/index.html in {}",
        if r.found { "The effect is found" } else { "The effect is NOT found" },
        args.out_dir.display()
    );
    s
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
        let mean = match test.mean_of {
            1 => String::new(),
            n => format!(", mean of the last {n}"),
        };
        let _ = writeln!(
            s,
            "Burn test {}{mean}: truly B leans {b:+.4}° and the flange {a:+.4}°\n  \
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
        } else if test.verdict != Verdict::Pass {
            let _ = writeln!(s, "  within its uncertainty: burn again as it stands");
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
