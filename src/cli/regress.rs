//! `pivotsight regress`: cases with expected results.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::outfiles::OutFile;
use super::{Global, Outcome, Status, result};
use crate::error::{Error, Result};
use crate::output::Document;
use crate::regress::{self, Case};

/// Run cases with expected results and show what drifted
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A folder of cases, or one case (a folder with case.toml and expected.csv)
    folder: PathBuf,
    /// Write the outcome as JUnit XML
    #[arg(long, value_name = "FILE")]
    junit: Option<OutFile>,
    /// Show what drifted and take the new values as expected; a case without expected values gets them
    #[arg(long)]
    update: bool,
}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output {
    /// Whether every case passed.
    passed: bool,
    /// Case by case.
    cases: Vec<Case>,
    /// The tables of expected values that were written.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    updated: Vec<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let program = std::env::current_exe().map_err(|e| Error::io("pivotsight", "find", e))?;
    let cases = regress::run(&args.folder, &program, args.update)?;
    global.reads(&args.folder, regress::files(&cases))?;
    let passed = cases.iter().all(|c| c.passed);
    let (mut good, mut updated) = (passed, Vec::new());
    if args.update {
        // The difference is shown before anything is overwritten.
        global.say(text(&cases).trim_end());
        updated = regress::update(&cases)?;
        good = cases.iter().all(regress::settles);
    }
    if let Some(path) = &args.junit {
        global.write(path, regress::junit(&cases).as_bytes())?;
    }
    let output = Output { passed, cases, updated };
    let json = result("regress", &args.folder, &[], &output);
    let cases = &output.cases;
    let rows = cases.iter().flat_map(|case| {
        let row = |mut row: serde_json::Value| {
            row["case"] = case.case.clone().into();
            row["problem"] = case.problem.clone().into();
            row
        };
        let checks =
            case.checks.iter().map(move |c| row(serde_json::to_value(c).unwrap_or_default()));
        // A case that holds nothing but its exit code, or fails by it, has a row all the same.
        let bare =
            case.checks.is_empty().then(|| row(serde_json::json!({ "passed": case.passed })));
        checks.chain(bare)
    });
    let status = if good { Status::Good } else { Status::OutOfTolerance };
    let wrote = output.updated.iter().map(|path| format!("wrote {}\n", path.display()));
    let table = text(cases) + &wrote.collect::<String>();
    let document = Document { rows: rows.collect(), json, table };
    Ok(Outcome { document: Some(document), status })
}

fn text(cases: &[Case]) -> String {
    let mut text = String::new();
    for case in cases {
        let _ = writeln!(text, "{} {}", if case.passed { "ok  " } else { "FAIL" }, case.case);
        if let Some(problem) = &case.problem {
            let _ = writeln!(text, "     {problem}");
        }
        for c in case.checks.iter().filter(|c| !c.passed) {
            let drift = match (c.drift, c.tolerance) {
                (Some(d), Some(t)) => format!(" (drift {d:+.3e}, tolerance {t:.1e})"),
                _ => String::new(),
            };
            let (key, expected, got) = (&c.key, c.wanted(), c.got());
            let _ = writeln!(text, "     {key}: expected {expected}, got {got}{drift}");
        }
    }
    let failed = cases.iter().filter(|c| !c.passed).count();
    let _ = writeln!(text, "{} cases, {failed} failed", cases.len());
    text
}
