//! Runs the program for its JSON.

use assert_cmd::Command;
use serde_json::Value;

/// What it prints (null where that is no JSON), its exit code and its messages.
pub fn run(args: &[&str]) -> (Value, Option<i32>, String) {
    let out = Command::cargo_bin("pivotsight")
        .unwrap()
        .args(args)
        .args(["--format", "json"])
        .output()
        .unwrap();
    let json = serde_json::from_slice(&out.stdout).unwrap_or(Value::Null);
    (json, out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
}
