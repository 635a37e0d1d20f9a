//! Accuracy tables: errors against known truth, against the physical limit, and against the stated intervals.
//!
//! `cargo run --release --example accuracy -- discs [RUNS] | burns [CASES] [SEED] | rods [CASES] [SEED] |
//! hostile [CASES] [SEED] | picture SORT SEED FILE`

mod discs;
mod hostile;
mod paint;
mod plate;
mod rendered;
mod stats;

fn main() {
    let mut words = std::env::args().skip(1);
    let what = words.next().unwrap_or_default();
    let mut number =
        |otherwise: u64| words.next().and_then(|w| w.parse().ok()).unwrap_or(otherwise);
    match what.as_str() {
        "discs" => discs::table(number(100)),
        "burns" => rendered::burns(number(50), number(1)),
        "rods" => rendered::rods(number(10), number(1)),
        "hostile" => hostile::table(number(320), number(1)),
        "picture" => {
            let rest: Vec<String> = words.collect();
            let seed = rest.get(1).and_then(|w| w.parse().ok());
            match (&rest[..], seed) {
                ([sort, _, file], Some(seed)) => hostile::one(sort, seed, file),
                _ => println!("accuracy picture SORT SEED FILE"),
            }
        }
        _ => println!(
            "accuracy discs [RUNS] | burns [CASES] [SEED] | rods [CASES] [SEED] | hostile [CASES] [SEED] | picture SORT SEED FILE"
        ),
    }
}
