//! A folder with one good file of every kind, and what a refusal must be: exit code 2, a message that names what is
//! wrong and where, nothing half written, and never a panic.

use std::path::Path;

use crate::line::run;

thread_local! {
    /// What a test found, so that all of it is seen at once.
    static FOUND: std::cell::RefCell<Vec<String>> = const { std::cell::RefCell::new(Vec::new()) };
}

/// The program refuses: exit code 2, all the words in its message, nothing on standard output, no files left over.
pub fn refused(dir: &Path, line: &str, words: &[&str]) {
    let before = listing(dir);
    let output = run(dir, line);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let mut wrong = Vec::new();
    if output.status.code() != Some(2) {
        wrong.push(format!("exit code {:?}", output.status.code()));
    }
    if message.contains("panicked") || message.trim().is_empty() {
        wrong.push("broke".into());
    }
    wrong.extend(words.iter().filter(|w| !message.contains(**w)).map(|w| format!("no '{w}'")));
    if !output.stdout.is_empty() {
        wrong.push("printed a result".into());
    }
    let after = listing(dir);
    if after != before {
        wrong.push(format!("left something behind: {after:?}"));
    }
    if !wrong.is_empty() {
        let text = format!("{line}\n  {}\n  {}", wrong.join(", "), message.trim());
        FOUND.with_borrow_mut(|found| found.push(text));
    }
}

/// A folder with one good file of every kind; when it goes, the test is judged.
pub struct Workshop(tempfile::TempDir);

impl Workshop {
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            FOUND.with_borrow(|found| assert!(found.is_empty(), "\n{}", found.join("\n")));
        }
    }
}

pub fn listing(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|n| n.to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

pub fn workshop() -> Workshop {
    let dir = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (from, to) in [
        ("images/burn-clean/burn-0001.png", "burn.png"),
        ("images/burn-clean/calib.toml", "calib.toml"),
        ("calib/machine.toml", "machine.toml"),
        ("calib/session.toml", "session.toml"),
        ("docs/examples/blank.csv", "blank.csv"),
        ("docs/examples/path.apt", "path.apt"),
        ("docs/examples/machine-ac.toml", "ac.toml"),
        ("docs/examples/k197-1.csv", "sweep.csv"),
    ] {
        std::fs::copy(root.join(from), dir.path().join(to)).unwrap();
    }
    for line in [
        "align blank.csv --format json --out align.json",
        "ballbar simulate --format csv --noise-mm 0.001 --out bar.csv",
        "thermal simulate heat",
        "thermal fit --head heat/head.csv --screw heat/screw.csv --out model.json",
        "verify --machine machine.toml --plan .",
        "simulate rtcp --model machine.toml --data poses.csv --noise-mm 0.001 --format csv --out rtcp.csv",
        "solve session.toml --format json --out solve.json --records records.sqlite",
    ] {
        let output = run(dir.path(), line);
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("joints.csv", "x_mm,y_mm,z_mm,b_deg,c_deg\n1,2,3,4,5\n");
    write("captures.csv", "image,x_mm,y_mm\nburn.png,0,0\nburn.png,1,0\nburn.png,0,1\n");
    write("job.toml", "schema = 1\ncalib = \"calib.toml\"\n[measure.burn]\n");
    Workshop(dir)
}
