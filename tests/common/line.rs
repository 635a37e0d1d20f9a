//! Runs the program with a line of words.

use std::path::Path;
use std::process::{Command, Output};

/// Runs the program in `dir`; `{root}` in an argument is the project's folder.
pub fn run(dir: &Path, line: &str) -> Output {
    let root = env!("CARGO_MANIFEST_DIR");
    Command::new(assert_cmd::cargo::cargo_bin!("pivotsight"))
        .current_dir(dir)
        .env("PIVOTSIGHT_CONFIG", "none")
        .args(line.split_whitespace().map(|word| word.replace("{root}", root)))
        .output()
        .unwrap()
}
