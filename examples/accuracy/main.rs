//! Accuracy tables: errors against known truth, against the physical limit, and against the stated intervals.
//!
//! `cargo run --release --example accuracy -- ` and one of [`USAGE`].

mod coverage;
mod decoded;
mod discs;
mod holdout;
mod hostile;
mod paint;
mod peers;
mod plate;
mod stats;

const USAGE: &str = "discs [RUNS]
coverage burns|circles|rods [CASES] [SEED] [LEVEL]    (VERBOSE=1: a line for each picture)
holdout burns|rods [CASES] [SEED] [LEVEL]    (the same)
hostile [CASES] [SEED]
holdout-picture burn|rod LEVEL SEED FILE    (writes one of them; of a rod, FILE-1.png, FILE-2.png ...)
picture SORT SEED FILE    (writes one of the hostile pictures)
discs-for-peers FOLDER [COUNT]    (for tools/peers/discs)";

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let word = |i: usize| words.get(i).map_or("", String::as_str);
    let number = |i: usize, otherwise: u64| word(i).parse().unwrap_or(otherwise);
    match word(0) {
        "discs" => discs::table(number(1, 100)),
        "coverage" if coverage::table(word(1), number(2, 50), number(3, 1), word(4)) => {}
        "holdout" if holdout::table(word(1), number(2, 40), number(3, 1), word(4)) => {}
        "holdout-picture" if holdout::picture(word(1), word(2), number(3, 1), word(4)) => {}
        "hostile" => hostile::table(number(1, 320), number(2, 1)),
        "picture" => hostile::one(word(1), number(2, 1), word(3)),
        "discs-for-peers" => {
            if let Err(e) = peers::write(word(1), number(2, 60)) {
                println!("{e}");
            }
        }
        _ => println!("{USAGE}"),
    }
}
