//! `pivotsight solve`: from a session's readings to the values a control wants.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use crate::cli::outfiles::OutFile;
use crate::cli::{Global, Outcome, Status, result};
use crate::error::{Error, Result};
use crate::machine::{Machine, is_entered};
use crate::output::Document;
use crate::rtcp::Session;
use crate::rtcp::report::{Replaced, Solution};
use crate::rtcp::solve::{Check, Solved, solve};
use crate::uncertainty::Verdict;

/// A value of the control that changes by more is doubted, mm.
const MOST_CHANGE_MM: f64 = 1.0;

/// Finds ΔX, R, the C axis and I1..I4 from contact readings and the rod's centre
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The session file
    #[arg(value_name = "SESSION.toml")]
    session: PathBuf,
    /// Write the machine file these numbers make (not where the check touch fails)
    #[arg(long, value_name = "FILE")]
    write_machine: Option<OutFile>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let session = Session::read(&args.session)?;
    global.reads(&args.session, &session.files)?;
    let solved = solve(&session.readings).map_err(|e| e.in_file(&args.session, None))?;
    let mut machine = solved.machine(&session.name, session.c_sense, session.standoff_mm.value);
    let solution = Solution::new(&session, &solved, &machine)?;
    let mut warnings = session.warnings.clone();
    warnings.extend(doubts(&solved));
    warnings.extend(solution.change.iter().flat_map(|c| c.values.iter().filter_map(leap)));
    let check_failed = solved.check.is_some_and(|c| c.verdict == Verdict::Fail);
    match &args.write_machine {
        Some(path) if check_failed => {
            warnings
                .push(format!("{}: not written, because the check touch fails", path.display()));
        }
        Some(path) => {
            match session.control.as_ref().filter(|c| c.from_file).map(|c| &c.machine) {
                Some(old) => {
                    let gone = old.effects.iter().filter(|e| is_entered(e));
                    warnings.extend(gone.map(|e| {
                        format!(
                            "{} is not in the file written: the number is measured anew",
                            e.name
                        )
                    }));
                    machine = machine.within(old);
                }
                None => keeps_more(path)?,
            }
            global.write(path, machine.to_toml().as_bytes())?;
        }
        None => {}
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));

    let json = result("solve", &args.session, &warnings, &solution);
    let good = solution.verdict.is_none_or(|v| v == Verdict::Pass);
    let status = if good { Status::Good } else { Status::OutOfTolerance };
    Ok(Outcome { document: Some(Document::single(json, table(&solution))), status })
}

/// Refuses to write numbers over a machine file that holds more than numbers.
fn keeps_more(path: &Path) -> Result<()> {
    let there = path.is_file().then(|| Machine::read(path).ok()?.more_than_numbers()).flatten();
    match there {
        Some(parts) => Err(Error::option(
            "--write-machine",
            format!("{} holds {parts}, which would be lost", path.display()),
            "name it in the session ([control] machine = \"...\") and write a new file: what it holds beside the numbers is kept there",
        )),
        None => Ok(()),
    }
}

/// Results that are possible but unlikely.
fn doubts(solved: &Solved) -> Vec<String> {
    let mut warnings = Vec::new();
    if solved.b_sense < 0 {
        warnings.push(
            "the nozzle swings towards +X as B grows on this machine (axes.B sense = -1): see that the signs of touch.b1_deg and b2_deg are right"
                .into(),
        );
    }
    if solved.delta_x_mm.value.abs() > 0.1 * solved.r_mm.value {
        warnings.push(format!(
            "ΔX = {:.3} mm is more than a tenth of R: are the touches and the rod's centre in the same coordinates?",
            solved.delta_x_mm.value
        ));
    }
    if solved.check.is_none() {
        warnings.push(
            "touch.x45_mm is not given: no check touch tells whether a sign, a reading or the rod's diameter is wrong"
                .into(),
        );
    }
    if let Some(check) = solved.check.filter(|c| c.verdict == Verdict::Fail) {
        warnings.push(format!(
            "CHECK FAILED: at B = {:.1}° the nozzle should touch at X = {:.4} mm but touched at {:.4} mm, off by {:+.4} ± {:.4} mm: a sign, a reading or the rod's diameter is wrong; do not use these values",
            check.b_rad.to_degrees(),
            check.predicted_mm,
            check.measured_mm,
            check.difference_mm.value,
            check.difference_mm.u95()
        ));
    }
    let unlikely = |c: &Check| c.difference_mm.value.abs() > c.difference_mm.u95();
    if let Some(check) = solved.check.filter(|c| c.verdict == Verdict::Pass && unlikely(c)) {
        warnings.push(format!(
            "the check touch is off by {:+.4} ± {:.4} mm: one of twenty is off by more than its interval by chance, and the check fails from {:.4} mm on; touch again before these values are used",
            check.difference_mm.value,
            check.difference_mm.u95(),
            check.limit_mm
        ));
    }
    warnings
}

/// A value that changes by more than machines move. One that the control holds as zero was perhaps never set.
fn leap(v: &Replaced) -> Option<String> {
    (v.now != 0.0 && v.change.abs() > MOST_CHANGE_MM).then(|| {
        format!(
            "{} changes by {:+.4} mm, from {:.4} to {:.4} mm: over {MOST_CHANGE_MM} mm is more likely a mix-up (a sign, X with Y, another machine, other coordinates) than a machine that moved; check [control] and the readings before it is typed in",
            v.name, v.change, v.now, v.new
        )
    })
}

fn table(s: &Solution) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    for l in &s.limits {
        let _ = writeln!(
            t,
            "{}  {:<32} {:8.4} ± {:.4} mm  (limit {} mm)  {}",
            l.step, l.what, l.value_mm, l.u95_mm, l.limit_mm, l.verdict
        );
    }
    let lines = [
        ("S2", "X_C", "C axis", s.xc_mm, s.xc_u95_mm),
        ("S2", "Y_C", "C axis", s.yc_mm, s.yc_u95_mm),
        ("S3", "X_B", "B axis over the rod", s.xb_mm, s.xb_u95_mm),
        ("S3", "Z_B", "nozzle on the table", s.zb_mm, s.zb_u95_mm),
        ("S4", "ΔX", "B axis to optical axis", s.delta_x_mm, s.delta_x_u95_mm),
        ("S5", "R", "B axis to nozzle", s.r_mm, s.r_u95_mm),
        ("S5", "R+s", "B axis to focus", s.r_focus_mm, s.r_focus_u95_mm),
    ];
    for (step, name, meaning, value, u95) in lines {
        let _ = writeln!(t, "{step}  {name:<4} {meaning:<24} {value:12.4} ± {u95:.4} mm");
    }
    for (i, v) in [s.i1_mm, s.i2_mm, s.i3_mm, s.i4_mm].iter().enumerate() {
        let _ = writeln!(t, "S6  I{}  ({:.4}, {:.4}, {:.4}) mm", i + 1, v[0], v[1], v[2]);
    }
    if let Some(c) = &s.check_touch {
        let _ = writeln!(
            t,
            "check touch at B = {:.1}°: X {:.4} mm, predicted {:.4} mm, off by {:+.4} ± {:.4} mm (limit {:.4} mm): {}",
            c.b_deg,
            c.measured_mm,
            c.predicted_mm,
            c.difference_mm,
            c.difference_u95_mm,
            c.limit_mm,
            c.verdict
        );
    }
    if let Some(change) = &s.change {
        let _ = writeln!(t, "\nwhat changes in the control      now          new       change");
        for v in &change.values {
            let _ = writeln!(t, "  {:<20} {:13.4} {:12.4} {:12.4}", v.name, v.now, v.new, v.change);
        }
        let _ = writeln!(
            t,
            "error of the tool point with the present values, seen from B = 0 (the change removes it)"
        );
        for a in &change.removes {
            let _ = writeln!(
                t,
                "  B {:>5}°   dx {:+.4}   dy {:+.4}   dz {:+.4} mm",
                a.b_deg, a.dx_mm, a.dy_mm, a.dz_mm
            );
        }
    }
    t
}
