//! The program in a folder of its own, and a session file for it.

use std::path::Path;
use std::process::{Command, Output};

pub fn run(dir: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("pivotsight"));
    let config = dir.join("config.toml");
    let config = if config.exists() { config.display().to_string() } else { "none".into() };
    command.current_dir(dir).env("PIVOTSIGHT_CONFIG", config).args(args).output().unwrap()
}

pub fn ok(dir: &Path, args: &[&str]) -> String {
    let output = run(dir, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

pub fn refused(dir: &Path, args: &[&str], words: &str) {
    let output = run(dir, args);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {message}");
    assert!(message.contains(words), "{message}");
}

/// A folder with a session file for `solve`, the one measurement that needs no picture.
pub fn session() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    write_session(dir.path(), 0.283);
    dir
}

pub fn write_session(dir: &Path, delta_x_mm: f64) {
    let (r, d, x) = (214.7, 20.0, 100.0);
    let text = format!(
        "[rod]\ndiameter_mm = {d}\ndiameter_u_mm = 0.0005\ncenter_mm = [{x}, -50.0]\ncenter_u_mm = [0.0005, 0.0005]\n\
         [touch]\nx1_mm = {}\nx1_u_mm = 0.001\nx2_mm = {}\nx2_u_mm = 0.001\nz_table_mm = -300.0\nz_table_u_mm = 0.002\n\
         b1_deg = 90\nb2_deg = -90\n",
        x + d / 2.0 + r + delta_x_mm,
        x - d / 2.0 - r + delta_x_mm,
    );
    std::fs::write(dir.join("session.toml"), text).unwrap();
}
