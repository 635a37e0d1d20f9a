//! Blind test of the diagnosis: a generator written apart from the library hides effects, the diagnosis sees only the data,
//! and the answers are scored with Wilson intervals.
//!
//! `cargo run --profile quick --example blind -- rtcp 200 [seed]`; the seed is drawn at run time unless given.

mod plain;
mod plans;

mod rod;
mod rtcp;
mod score;

use pivotsight::diagnose::experiment::PlannedCapture;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A hidden truth: what was put into the data.
#[derive(Debug, Clone, Default)]
pub struct Truth {
    /// Library names hidden.
    pub names: Vec<&'static str>,
    /// Variable of an effect outside the library.
    pub unknown: Option<&'static str>,
}

/// One sealed case: the data as the diagnosis gets it, and the truth.
pub struct Case {
    /// CSV text.
    pub csv: String,
    /// Noise figure handed over, if any.
    pub noise_mm: Option<f64>,
    /// The truth.
    pub truth: Truth,
    /// Measures further captures of the same machine: more lines of CSV.
    pub more: More,
}

/// Measures planned captures.
pub type More = Box<dyn FnMut(&[PlannedCapture]) -> String>;

fn main() {
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
        let plain = ["burn", "thermal", "ballbar"].contains(&kind);
        if plain && (sort.known > 1 || sort.unknown > 0 || sort.poor) {
            continue;
        }
        if only.as_deref().is_some_and(|o| !sort.name.contains(o)) {
            continue;
        }
        let mut tally = score::Tally::default();
        let started = std::time::Instant::now();
        for index in 0..count {
            let case_rng = ChaCha8Rng::seed_from_u64(rng.random());
            let mut case = match kind {
                "rtcp" => rtcp::case(sort, index, case_rng),
                "rod" => rod::case(sort, index, case_rng),
                "burn" | "thermal" | "ballbar" => plain::case(kind, sort, index, case_rng),
                other => {
                    eprintln!("no generator for '{other}'");
                    std::process::exit(2);
                }
            };
            tally.add(sort, &mut case, kind);
        }
        tally.print(sort, started.elapsed().as_secs_f64() / count as f64);
    }
}
