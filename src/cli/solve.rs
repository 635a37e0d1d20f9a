//! `pivotsight solve`: from a session's readings to the values a control wants.

use std::fmt::Write;
use std::path::PathBuf;

use crate::cli::outfiles::OutFile;
use crate::cli::{Global, Outcome, Status, result};
use crate::error::Result;
use crate::output::Document;
use crate::rtcp::Session;
use crate::rtcp::doubts::doubts;
use crate::rtcp::report::Solution;
use crate::rtcp::solve::solve;
use crate::rtcp::solved_file::to_write;
use crate::uncertainty::Verdict;

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
    let machine = solved.machine(&session.name, session.c_sense, session.standoff_mm.value);
    let solution =
        Solution::new(&session, &solved, &machine).map_err(|e| e.in_file(&args.session, None))?;
    let mut warnings = session.warnings.clone();
    warnings.extend(doubts(&solved, &solution));
    if let Some(path) = &args.write_machine
        && let Some(machine) = to_write(&session, &solved, machine, path, &mut warnings)?
    {
        global.write(path, machine.to_toml().as_bytes())?;
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));

    let json = result("solve", &args.session, &warnings, &solution);
    let good = solution.verdict.is_none_or(|v| v == Verdict::Pass);
    let status = if good { Status::Good } else { Status::OutOfTolerance };
    Ok(Outcome { document: Some(Document::single(json, table(&solution))), status })
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
