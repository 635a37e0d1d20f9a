//! `pivotsight solve`: from a session's readings to the values a control wants.

use std::fmt::Write;
use std::path::PathBuf;

use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::cli::{Global, Outcome, Status, envelope};
use crate::error::Result;
use crate::machine::Machine;
use crate::output::{Document, write_whole};
use crate::rtcp::solve::{Solved, solve};
use crate::rtcp::{Session, deviation};
use crate::uncertainty::{Measured, Verdict};

/// Finds ΔX, R, the C axis and I1..I4 from contact readings and the rod's centre
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The session file
    #[arg(value_name = "SESSION.toml")]
    session: PathBuf,
    /// Write the machine file these numbers make (not where the check touch fails)
    #[arg(long, value_name = "FILE")]
    write_machine: Option<PathBuf>,
}

/// B angles at which a change of the control's values is shown.
const SHOWN_DEG: [f64; 6] = [-90.0, -45.0, -30.0, 30.0, 45.0, 90.0];

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let session = Session::read(&args.session)?;
    let solved = solve(&session.readings)?;
    let machine = solved.machine(&session.name, session.c_sense, session.standoff_mm.value);
    let mut warnings = session.warnings.clone();
    warnings.extend(doubts(&solved));
    let check_failed = solved.check.is_some_and(|c| c.verdict == Verdict::Fail);
    match &args.write_machine {
        Some(path) if check_failed => {
            warnings
                .push(format!("{}: not written, because the check touch fails", path.display()));
        }
        Some(path) => write_whole(path, machine.to_toml().as_bytes())?,
        None => {}
    }
    warnings.iter().for_each(|w| global.say(format!("warning: {w}")));

    let change = session.control.as_ref().map(|now| change(now, &machine)).transpose()?;
    let verdicts: Vec<Verdict> =
        session.limits.iter().map(|l| l.verdict).chain(solved.check.map(|c| c.verdict)).collect();
    let good = verdicts.iter().all(|&v| v == Verdict::Pass);
    let json = as_json(args, &session, &solved, change.as_ref(), &warnings);
    let table = as_table(&session, &solved, change.as_ref());
    Ok(Outcome {
        document: Some(Document::single(json, table)),
        status: if good { Status::Good } else { Status::OutOfTolerance },
    })
}

/// Results that are possible but unlikely.
fn doubts(solved: &Solved) -> Vec<String> {
    let mut warnings = Vec::new();
    if solved.b_sense < 0 {
        warnings.push(
            "X1 < X2: a positive B turns the nozzle towards +X on this machine (axes.B sense = -1)"
                .into(),
        );
    }
    if solved.delta_x_mm.value.abs() > 0.1 * solved.r_mm.value {
        warnings.push(format!(
            "ΔX = {:.3} mm is more than a tenth of R: are the touches and the rod's centre in the same coordinates?",
            solved.delta_x_mm.value
        ));
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
    warnings
}

/// What typing the new values into the control changes.
struct Change {
    /// Name, value now, new value.
    values: Vec<(&'static str, f64, f64)>,
    /// B in degrees, and how far the tool point goes astray with the present values, seen from B = 0.
    astray: Vec<(f64, Vector3<f64>)>,
}

fn change(now: &Machine, new: &Machine) -> Result<Change> {
    let values = vec![
        ("delta_x_mm", now.head.delta_x_mm, new.head.delta_x_mm),
        ("r_mm", now.head.r_mm, new.head.r_mm),
        ("xc_mm", now.table.xc_mm, new.table.xc_mm),
        ("yc_mm", now.table.yc_mm, new.table.yc_mm),
        ("zc_mm", now.table.zc_mm, new.table.zc_mm),
    ];
    // The stand-off is the cutting process', not the machine's: the same on both sides.
    let mut now = now.clone();
    now.head.standoff_mm = new.head.standoff_mm;
    let (control, real) = (now.chain()?, new.chain()?);
    let at = |b_deg: f64| deviation(&control, &real, &Vector3::zeros(), [b_deg.to_radians(), 0.0]);
    let astray = SHOWN_DEG.iter().map(|&b| (b, at(b) - at(0.0))).collect();
    Ok(Change { values, astray })
}

fn as_json(
    args: &Args,
    session: &Session,
    solved: &Solved,
    change: Option<&Change>,
    warnings: &[String],
) -> Value {
    let mut map = envelope("solve", &args.session, warnings);
    let mut put = |name: &str, m: Measured| {
        map.insert(format!("{name}_mm"), json!(m.value));
        map.insert(format!("{name}_u95_mm"), json!(m.u95()));
    };
    put("xb", solved.xb_mm);
    put("zb", solved.zb_mm);
    put("xc", solved.xc_mm);
    put("yc", solved.yc_mm);
    put("delta_x", solved.delta_x_mm);
    put("r", solved.r_mm);
    put("r_focus", focus(solved, session));
    for (i, vector) in solved.vectors_mm().iter().enumerate() {
        map.insert(format!("i{}_mm", i + 1), json!(vector));
    }
    map.insert("b_sense".into(), json!(solved.b_sense));
    let limits = session.limits.iter().map(|l| {
        json!({"step": l.step, "what": l.what, "value_mm": l.value_mm.value, "u95_mm": l.value_mm.u95(),
               "limit_mm": l.limit_mm, "verdict": l.verdict})
    });
    map.insert("limits".into(), limits.collect());
    if let Some(c) = solved.check {
        let check = json!({"b_deg": c.b_rad.to_degrees(), "measured_mm": c.measured_mm, "predicted_mm": c.predicted_mm,
            "difference_mm": c.difference_mm.value, "difference_u95_mm": c.difference_mm.u95(), "verdict": c.verdict});
        map.insert("check_touch".into(), check);
    }
    if let Some(change) = change {
        let values = change.values.iter().map(
            |(name, now, new)| json!({"name": name, "now": now, "new": new, "change": new - now}),
        );
        let astray = change
            .astray
            .iter()
            .map(|(b, d)| json!({"b_deg": b, "dx_mm": d.x, "dy_mm": d.y, "dz_mm": d.z}));
        map.insert(
            "change".into(),
            json!({"values": values.collect::<Value>(), "removes": astray.collect::<Value>()}),
        );
    }
    Value::Object(map)
}

fn focus(solved: &Solved, session: &Session) -> Measured {
    Measured {
        value: solved.r_mm.value + session.standoff_mm.value,
        u: solved.r_mm.u.hypot(session.standoff_mm.u),
    }
}

fn as_table(session: &Session, solved: &Solved, change: Option<&Change>) -> String {
    let mut t = String::new();
    // Writing to a String cannot fail.
    for l in &session.limits {
        let _ = writeln!(
            t,
            "{}  {:<32} {:8.4} ± {:.4} mm  (limit {} mm)  {}",
            l.step,
            l.what,
            l.value_mm.value,
            l.value_mm.u95(),
            l.limit_mm,
            l.verdict
        );
    }
    let lines = [
        ("S2", "X_C", "C axis", solved.xc_mm),
        ("S2", "Y_C", "C axis", solved.yc_mm),
        ("S3", "X_B", "B axis over the rod", solved.xb_mm),
        ("S3", "Z_B", "nozzle on the table", solved.zb_mm),
        ("S4", "ΔX", "B axis to optical axis", solved.delta_x_mm),
        ("S5", "R", "B axis to nozzle", solved.r_mm),
        ("S5", "R+s", "B axis to focus", focus(solved, session)),
    ];
    for (step, name, meaning, m) in lines {
        let _ = writeln!(t, "{step}  {name:<4} {meaning:<24} {:12.4} ± {:.4} mm", m.value, m.u95());
    }
    for (i, v) in solved.vectors_mm().iter().enumerate() {
        let _ = writeln!(t, "S6  I{}  ({:.4}, {:.4}, {:.4}) mm", i + 1, v[0], v[1], v[2]);
    }
    if let Some(c) = solved.check {
        let _ = writeln!(
            t,
            "check touch at B = {:.1}°: X {:.4} mm, predicted {:.4} mm, off by {:+.4} ± {:.4} mm: {}",
            c.b_rad.to_degrees(),
            c.measured_mm,
            c.predicted_mm,
            c.difference_mm.value,
            c.difference_mm.u95(),
            c.verdict
        );
    }
    if let Some(change) = change {
        let _ = writeln!(t, "\nwhat changes in the control      now          new       change");
        for (name, now, new) in &change.values {
            let _ = writeln!(t, "  {name:<20} {now:13.4} {new:12.4} {:12.4}", new - now);
        }
        let _ = writeln!(
            t,
            "error of the tool point with the present values, seen from B = 0 (the change removes it)"
        );
        for (b, d) in &change.astray {
            let _ =
                writeln!(t, "  B {b:>5}°   dx {:+.4}   dy {:+.4}   dz {:+.4} mm", d.x, d.y, d.z);
        }
    }
    t
}
