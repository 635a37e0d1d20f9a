//! Regression of pictures with expected results: a folder a case, run as a user would run it.
//!
//! A case folder holds `case.toml` (`args`, as on the command line after `pivotsight`, run in the case's folder;
//! optionally `exit_code`) and `expected.csv` (`key,value,tolerance`; words have no tolerance), which a case with exit code 2 can
//! do without.

use std::path::{Path, PathBuf};
use std::process::Command;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::batch::limits::{number, u95_key};
use crate::error::{Error, Result, nearest};
use crate::output::{escape, flatten, write_whole};
use crate::table::Table;
use crate::tomlfile;

/// The file of expected values in a case's folder.
const EXPECTED: &str = "expected.csv";
/// What a case runs.
const CASE: &str = "case.toml";
/// What a case must leave to the program that compares.
const OWN: [&str; 3] = ["--format", "--quiet", "-q"];
/// Names no file, which turns the user's defaults off.
const NO_DEFAULTS: &str = "none";
/// Set where a case runs: one that runs cases would never end.
const WITHIN: &str = "PIVOTSIGHT_WITHIN_A_CASE";

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CaseFile {
    args: Vec<String>,
    #[serde(default)]
    exit_code: i32,
}

/// How one case went.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Case {
    /// The folder's name.
    pub case: String,
    /// The folder.
    #[serde(skip)]
    pub folder: PathBuf,
    /// Whether everything is as expected.
    pub passed: bool,
    /// Why it could not even be compared.
    pub problem: Option<String>,
    /// A line an expected value.
    pub checks: Vec<Check>,
}

/// One expected value against what came.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Check {
    /// Key of the result, nested keys joined with `.`.
    pub key: String,
    /// What `expected.csv` says.
    pub expected: String,
    /// What came; empty if the result has no such key.
    pub actual: String,
    /// The result's key that is most like one it does not have.
    pub likely: Option<String>,
    /// Allowed difference.
    pub tolerance: Option<f64>,
    /// Actual minus expected.
    pub drift: Option<f64>,
    /// Whether it is within tolerance.
    pub passed: bool,
}

/// Runs every case under `folder` (each folder with a `case.toml`, or `folder` itself) with `program`. A lone case that cannot be run is an
/// error, one of several fails with its reason; `propose` gives a case without expected values some to hold ([`update`] writes them).
pub fn run(folder: &Path, program: &Path, propose: bool) -> Result<Vec<Case>> {
    if std::env::var_os(WITHIN).is_some() {
        return Err(Error::file(folder, "a case cannot run cases", "correct its case.toml"));
    }
    let mut folders = Vec::new();
    if folder.join(CASE).is_file() {
        folders.push(folder.to_owned());
    } else {
        for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, "read", e))? {
            let entry = entry.map_err(|e| Error::io(folder, "read", e))?.path();
            if entry.join(CASE).is_file() {
                folders.push(entry);
            }
        }
    }
    if folders.is_empty() {
        return Err(Error::file(
            folder,
            "holds no case",
            "a case is a folder with case.toml and expected.csv",
        ));
    }
    folders.sort();
    let lone = folders.len() == 1;
    let run = |case: &PathBuf| match one(case, program, propose) {
        Err(e) if !lone => Ok(Case {
            case: name(case),
            folder: case.clone(),
            passed: false,
            problem: Some(e.to_string()),
            checks: Vec::new(),
        }),
        other => other,
    };
    folders.par_iter().map(run).collect()
}

fn name(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The files that say what is run and expected.
pub fn files(cases: &[Case]) -> impl Iterator<Item = PathBuf> {
    cases.iter().flat_map(|case| [CASE, EXPECTED].map(|name| case.folder.join(name)))
}

/// Takes what came as expected, where it no longer holds, and tells which tables were written: keys that the results do not have stay as
/// they are.
pub fn update(cases: &[Case]) -> Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    let wanted = |case: &&Case| case.problem.is_none() && case.checks.iter().any(came);
    for case in cases.iter().filter(wanted) {
        let path = case.folder.join(EXPECTED);
        rewrite(&path, &case.checks)?;
        written.push(path);
    }
    Ok(written)
}

/// Whether a case passes once what came is expected.
pub fn settles(case: &Case) -> bool {
    case.problem.is_none() && case.checks.iter().all(|c| c.passed || came(c))
}

/// Whether something else came than what is expected.
fn came(check: &Check) -> bool {
    !check.passed && !check.actual.is_empty()
}

fn one(folder: &Path, program: &Path, propose: bool) -> Result<Case> {
    let file = folder.join(CASE);
    let case: CaseFile = tomlfile::read(&file)?;
    let own = |arg: &&String| OWN.iter().any(|o| arg.split('=').next() == Some(o));
    if let Some(arg) = case.args.iter().find(own) {
        let fix = "leave it out: a case prints its result as JSON, and that is compared";
        return Err(Error::field(file, None, "args", format!("has {arg}"), fix));
    }
    // Where nothing is measured there is nothing to hold but the exit code.
    let path = folder.join(EXPECTED);
    let known = match path.exists() {
        false if case.exit_code == 2 => Some(Vec::new()),
        false if propose => None,
        _ => Some(expected(&path)?),
    };
    // Case files must mean the same on every machine: no defaults of the user's.
    let output = Command::new(program)
        .args(&case.args)
        .args(["--format", "json", "--quiet"])
        .current_dir(folder)
        .env("PIVOTSIGHT_CONFIG", NO_DEFAULTS)
        .env(WITHIN, "1")
        .output()
        .map_err(|e| Error::io(program, "start", e))?;
    let code = output.status.code().unwrap_or(-1);
    let parsed = serde_json::from_slice::<Value>(&output.stdout);
    let mut problem = (code != case.exit_code).then(|| {
        // Of several pictures each has its own reason in the result.
        let failed = parsed.iter().flat_map(|result| result["results"].as_array());
        let reasons = failed.flatten().filter_map(|one| one["error"].as_str());
        let said = String::from_utf8_lossy(&output.stderr);
        let said: Vec<&str> = reasons.chain([said.trim()]).filter(|s| !s.is_empty()).collect();
        let text = format!("exit code {code} instead of {}: {}", case.exit_code, said.join("; "));
        text.trim_end_matches(": ").to_owned()
    });
    let result: Value = parsed.unwrap_or_else(|e| {
        let silent = output.stdout.is_empty();
        if problem.is_none() && !known.as_ref().is_some_and(Vec::is_empty) {
            problem = Some(match silent {
                true => {
                    "nothing was printed to compare (with --out a result goes to its file)".into()
                }
                false => format!("the result is not JSON ({e})"),
            });
        }
        Value::Null
    });
    let cells = flatten(&result);
    let held = match known {
        // A run that printed nothing has nothing to hold them against.
        Some(_) if result.is_null() => Vec::new(),
        Some(known) => known,
        None => proposed(&result, &cells),
    };
    let checks: Vec<Check> = held
        .into_iter()
        .map(|(key, value, tolerance)| check(&cells, key, value, tolerance))
        .collect();
    let passed = problem.is_none() && checks.iter().all(|c| c.passed);
    Ok(Case { case: name(folder), folder: folder.to_owned(), passed, problem, checks })
}

/// A key of a result, the value it is to have, and by how much it may differ.
type Held = (String, String, Option<f64>);

/// What is worth holding in a result: what it is, its verdict, and the numbers whose uncertainty stands beside them, to a tenth of it.
fn proposed(result: &Value, cells: &[(String, &Value)]) -> Vec<Held> {
    /// Of the interval, and the least tolerance.
    const PART: f64 = 0.1;
    const LEAST: f64 = 1e-6;
    let hold = |(key, value): &(String, &Value)| -> Option<Held> {
        let tolerance = match value {
            Value::String(_) if key == "schema" || key.ends_with("verdict") => None,
            Value::Number(_) => {
                let u95 = number(result.as_object()?, &u95_key(key)?)?;
                Some(format!("{:.1e}", (PART * u95).max(LEAST)).parse().ok()?)
            }
            _ => return None,
        };
        Some((key.clone(), String::new(), tolerance))
    };
    cells.iter().filter_map(hold).collect()
}

fn expected(path: &Path) -> Result<Vec<Held>> {
    if !path.exists() {
        return Err(Error::file(
            path,
            "the table of expected values is missing",
            "run with --update to have one written, or write it: the header key,value,tolerance, then a line for each key of the result \
             to hold, such as r_mm,0,0.001",
        ));
    }
    let table = Table::read(path, &["key", "value", "tolerance"], &[])?;
    (0..table.rows())
        .map(|row| {
            let tolerance = match table.text(row, "tolerance") {
                "" => None,
                _ => Some(table.number(row, "tolerance")?),
            };
            if tolerance.is_some_and(|t| t < 0.0) {
                return Err(table.error(row, "tolerance", "is negative", "give zero or more"));
            }
            if tolerance.is_some() {
                table.number(row, "value")?;
            }
            Ok((table.text(row, "key").to_owned(), table.text(row, "value").to_owned(), tolerance))
        })
        .collect()
}

fn check(
    cells: &[(String, &Value)],
    key: String,
    expected: String,
    tolerance: Option<f64>,
) -> Check {
    let found = cells.iter().find(|(name, _)| *name == key).map(|c| c.1);
    let likely = match found {
        None => nearest(&key, cells.iter().map(|c| c.0.as_str())),
        Some(_) => None,
    };
    let actual = match found {
        None => String::new(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    };
    let drift = match (expected.parse::<f64>(), actual.parse::<f64>()) {
        (Ok(a), Ok(b)) => Some(b - a),
        _ => None,
    };
    let passed = match tolerance {
        Some(tolerance) => drift.is_some_and(|d| d.abs() <= tolerance),
        None => actual == expected,
    };
    Check { key, expected, actual, likely, tolerance, drift, passed }
}

impl Check {
    /// What is expected, in words.
    pub fn wanted(&self) -> &str {
        if self.expected.is_empty() { "nothing yet" } else { &self.expected }
    }

    /// What came, in words.
    pub fn got(&self) -> String {
        match (&self.likely, self.actual.is_empty()) {
            (Some(key), true) => format!("nothing: did you mean the key '{key}'?"),
            (None, true) => "nothing".into(),
            _ => self.actual.clone(),
        }
    }
}

fn rewrite(path: &Path, checks: &[Check]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Writing to memory cannot fail.
    let _ = writer.write_record(["key", "value", "tolerance"]);
    for c in checks {
        let value = if c.passed || c.actual.is_empty() { &c.expected } else { &c.actual };
        let _ = writer.write_record([
            c.key.as_str(),
            value,
            &c.tolerance.map(|t| t.to_string()).unwrap_or_default(),
        ]);
    }
    write_whole(path, &writer.into_inner().unwrap_or_default())
}

/// The cases as JUnit XML, which every CI server shows.
pub fn junit(cases: &[Case]) -> String {
    let failures = cases.iter().filter(|c| !c.passed).count();
    let mut xml = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"pivotsight regress\" tests=\"{}\" failures=\"{failures}\">\n",
        cases.len()
    );
    for case in cases {
        xml += &format!("  <testcase classname=\"regress\" name=\"{}\"", escape(&case.case));
        if case.passed {
            xml += "/>\n";
            continue;
        }
        let wrong = case
            .checks
            .iter()
            .filter(|c| !c.passed)
            .map(|c| format!("{}: expected {}, got {}", c.key, c.wanted(), c.got()));
        let text = case.problem.iter().cloned().chain(wrong).collect::<Vec<_>>().join("; ");
        xml += &format!(">\n    <failure message=\"{}\"/>\n  </testcase>\n", escape(&text));
    }
    xml + "</testsuite>\n"
}
