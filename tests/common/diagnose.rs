//! Diagnoses data that a test has written into a folder.

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

pub const BAR: &str = "schema = 1\n[head]\ndelta_x_mm = 0.0\nr_mm = 400.0\n";

pub fn run(arguments: &[&str], folder: &Path) -> std::process::Output {
    let mut command = Command::cargo_bin("pivotsight").unwrap();
    command.current_dir(folder).args(arguments).output().unwrap()
}

pub fn diagnose(kind: &str, folder: &Path) -> Value {
    let arguments =
        ["diagnose", kind, "--model", "machine.toml", "--data", "data.csv", "--format", "json"];
    let output = run(&arguments, folder);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The answer to data of a machine.
pub fn answer(kind: &str, machine: &str, csv: &str) -> Value {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("machine.toml"), machine).unwrap();
    std::fs::write(folder.path().join("data.csv"), csv).unwrap();
    diagnose(kind, folder.path())
}

/// Standard normal numbers.
pub fn normal() -> impl FnMut() -> f64 {
    let mut state = 20_261_u64;
    let mut uniform = move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0
}

/// The named effect and its rivals.
pub fn class(report: &Value) -> Vec<&str> {
    let effect = &report["effects"][0];
    let rivals = effect["confusable_with"].as_array().into_iter().flatten();
    rivals.chain([&effect["name"]]).filter_map(Value::as_str).collect()
}
