//! Blind test of the diagnosis: a generator written apart from the library hides effects, the diagnosis sees only the data,
//! and the answers are scored with Wilson intervals once all are given: until then the truths are in a file that has no name.
//!
//! `cargo run --profile quick --example blind -- rtcp 200 [seed] [sort]`; the seed is drawn at run time unless given. Kinds: `rtcp`,
//! `rod` (24 edge points a capture), `rod100` (100 of them), `burn`, `thermal`, `thermal3` (three axes), `ballbar`, `ballbar2` (two paths).

mod plain;
mod plans;

mod rod;
mod rtcp;
mod score;
mod sealed;

use pivotsight::diagnose::experiment::PlannedCapture;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use sealed::Sealed;

/// One case: all that the diagnosis gets. Its truth is put away before.
pub struct Case {
    /// CSV text.
    pub csv: String,
    /// Noise figure handed over, if any.
    pub noise_mm: Option<f64>,
    /// Measures further captures of the same machine: more lines of CSV.
    pub more: More,
}

/// Measures planned captures.
pub type More = Box<dyn FnMut(&[PlannedCapture]) -> String>;

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let kind = arguments.first().map_or("rtcp", String::as_str);
    let count: usize = arguments.get(1).and_then(|a| a.parse().ok()).unwrap_or(200);
    let seed: u64 = arguments.get(2).and_then(|a| a.parse().ok()).unwrap_or_else(|| {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        now.map_or(1, |d| d.as_nanos() as u64)
    });
    let only = arguments.get(3).cloned();
    println!("{kind}: {count} cases of each sort, seed {seed}");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for sort in score::SORTS {
        let plain = ["burn", "thermal", "thermal3", "ballbar", "ballbar2"].contains(&kind);
        // These plans have no repeats, and are not made poor.
        if plain && (sort.unknown > 1 || sort.poor) {
            continue;
        }
        if only.as_deref().is_some_and(|o| !sort.name.contains(o)) {
            continue;
        }
        let mut sealed = Sealed::new()?;
        let mut answers = Vec::new();
        let started = std::time::Instant::now();
        for index in 0..count {
            let case_rng = ChaCha8Rng::seed_from_u64(rng.random());
            let (mut case, truth) = match kind {
                "rtcp" => rtcp::case(sort, index, case_rng),
                "rod" => rod::case(sort, index, 24, case_rng),
                "rod100" => rod::case(sort, index, 100, case_rng),
                _ if plain => plain::case(kind, sort, index, case_rng),
                other => {
                    eprintln!("no generator for '{other}'");
                    std::process::exit(2);
                }
            };
            sealed.put(truth)?;
            answers.push(score::answer(&mut case, kind));
        }
        let seconds = started.elapsed().as_secs_f64() / count as f64;
        let mut tally = score::Tally::default();
        for (truth, answer) in sealed.open()?.iter().zip(&answers) {
            tally.add(sort, truth, answer);
        }
        tally.print(sort, seconds);
    }
    Ok(())
}
