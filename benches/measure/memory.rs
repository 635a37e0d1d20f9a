//! Peak memory of one worker, from the operating system, in a process of its own: nothing is freed that it could reuse.

use std::process::Command;

use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::{Error, Result};
use pivotsight::frame::Picture;
use pivotsight::measure::burn;

use crate::work::{Burn, one_thread};

const FRAME_KB: f64 = 4000.0 * 3000.0 / 1024.0;

/// Prints the peak for one picture and for several in turn.
pub fn table(burns: &[Burn]) -> Result<()> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("temporary folder", "create", e))?;
    let mut files = Vec::new();
    for (i, b) in burns.iter().enumerate() {
        let path = folder.path().join(format!("{i}.png"));
        std::fs::write(&path, &b.png).map_err(|e| Error::io(&path, "write", e))?;
        files.push(path);
    }
    let program = std::env::current_exe().map_err(|e| Error::io("this program", "find", e))?;
    for count in [1, files.len()] {
        let run = Command::new(&program).arg("peak").args(&files[..count]).output();
        let text = run.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
        println!("\npeak memory of a worker, {count} pictures: {}", text.unwrap_or_default());
    }
    Ok(())
}

/// Reads and measures the files one after the other and prints the peak beyond what the process began with.
pub fn peak(files: &[String]) -> Result<()> {
    let Some(before) = status("VmRSS:") else {
        println!("not known on this system");
        return Ok(());
    };
    one_thread(|| {
        for file in files {
            // Any scale does: what is measured is memory.
            let mapping = Mapping::Scale { mm_per_px: 0.0032, rotation_deg: 0.0 };
            let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
            let measured = Picture::read(file)
                .and_then(|p| burn::measure(&p, &calibration, &burn::Options::default(), file));
            drop(measured);
        }
    });
    let peak = status("VmHWM:").unwrap_or(f64::NAN) - before;
    println!("{:.1} MB, {:.1} frames", peak / 1024.0, peak / FRAME_KB);
    Ok(())
}

/// A line of the process's status in kB (Linux).
fn status(key: &str) -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    text.lines().find(|l| l.starts_with(key))?.split_whitespace().nth(1)?.parse().ok()
}
