//! Pictures made to mislead: does what gives a number give a right one?
//!
//! Painted by [`crate::paint`] and [`crate::plate`], which share nothing with the program's own renderer. A result is wrong where the
//! offset is off by more than three times its stated u95, or where there is no burn to measure.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::frame::Picture;
use pivotsight::measure::burn;
use rayon::prelude::*;

use crate::plate::{MM_PER_PX, Plate, SORTS, Sort};
use crate::stats::{quantile, share};

/// How one picture was answered.
enum Answer {
    Refused(String),
    /// Worst error in units of its u95, and error of the offset, mm; infinite where there is nothing to measure.
    Number {
        ratio: f64,
        error_mm: f64,
    },
}

/// Prints how many results are wrong, by sort; seeds of the wrong ones go to standard error.
pub fn table(cases: u64, seed: u64) {
    let answers: Vec<(Sort, u64, Answer)> = (0..cases)
        .into_par_iter()
        .map(|i| {
            let (sort, own) = (SORTS[i as usize % SORTS.len()], seed * 1_000_000 + i);
            (sort, own, answer(&Plate::draw(sort, own)))
        })
        .collect();
    let mut by_sort: BTreeMap<Sort, Vec<&Answer>> = BTreeMap::new();
    for (sort, own, answer) in &answers {
        by_sort.entry(*sort).or_default().push(answer);
        match answer {
            Answer::Number { ratio, error_mm } if *ratio > 3.0 => {
                eprintln!("wrong: {sort:?} {own}: {ratio:.1} u95, {:.1} µm", 1e3 * error_mm);
            }
            Answer::Refused(why) if std::env::var_os("VERBOSE").is_some() => {
                eprintln!("refused: {sort:?} {own}: {why}");
            }
            _ => {}
        }
    }
    println!(
        "| sort | pictures | refused | median µm | off by more than 1 u95 | by more than 3 u95 |"
    );
    println!("|---|---|---|---|---|---|");
    by_sort.iter().for_each(|(sort, list)| row(sort.words(), list));
    row("**all**", &answers.iter().map(|a| &a.2).collect::<Vec<_>>());
}

fn row(name: &str, answers: &[&Answer]) {
    let numbers: Vec<(f64, f64)> = answers
        .iter()
        .filter_map(|a| match a {
            Answer::Number { ratio, error_mm } => Some((*ratio, *error_mm)),
            Answer::Refused(_) => None,
        })
        .collect();
    let (all, given) = (answers.len(), numbers.len());
    let beyond = |k: f64| share(numbers.iter().filter(|n| n.0 > k).count(), given);
    let errors: Vec<f64> = numbers.iter().map(|n| 1e3 * n.1).collect();
    println!(
        "| {name} | {all} | {} | {:.2} | {} | {} |",
        share(all - given, all),
        quantile(&errors, 0.5),
        beyond(1.0),
        beyond(3.0)
    );
}

fn answer(plate: &Plate) -> Answer {
    let mapping = Mapping::Scale { mm_per_px: MM_PER_PX, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let options = burn::Options { near_mm: plate.near_mm, ..burn::Options::default() };
    let result = Picture::decode("hostile", &plate.file)
        .and_then(|picture| burn::measure(&picture, &calibration, &options, "hostile"));
    match (result, plate.offset_mm) {
        (Err(e), _) => Answer::Refused(e.to_string()),
        (Ok(_), None) => Answer::Number { ratio: f64::INFINITY, error_mm: f64::INFINITY },
        (Ok(m), Some(truth)) => {
            let error = Vector2::from(m.report.offset.offset_mm) - truth;
            let ratio = |k: usize| error[k].abs() / m.report.offset.offset_u95_mm[k];
            Answer::Number { ratio: ratio(0).max(ratio(1)), error_mm: error.norm() }
        }
    }
}

/// Writes the picture of a seed, named as the list of wrong ones names it, and says how it is answered.
pub fn one(sort: &str, seed: u64, path: &str) {
    let Some(sort) = SORTS.iter().find(|s| format!("{s:?}").eq_ignore_ascii_case(sort)) else {
        return println!("sorts: {SORTS:?}");
    };
    let plate = Plate::draw(*sort, seed);
    if let Err(e) = std::fs::write(path, &plate.file) {
        println!("{path}: {e}");
    }
    println!("{MM_PER_PX} mm/px, true offset {:?} mm, near {:?}", plate.offset_mm, plate.near_mm);
    match answer(&plate) {
        Answer::Refused(why) => println!("refused: {why}"),
        Answer::Number { ratio, error_mm } => {
            println!("off by {:.2} µm, {ratio:.2} u95", 1e3 * error_mm);
        }
    }
}
