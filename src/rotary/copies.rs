//! A run of a sweep that is a copy of another one counts once: it would make the noise seem smaller.

use std::collections::BTreeMap;

use crate::table::Table;

/// Fewest readings that can show a copy: of fewer, all may be alike by chance.
const LEAST_READINGS: usize = 4;

/// What a run reads at each place.
type Readings = BTreeMap<Vec<String>, String>;

/// Its label, its readings and its rows.
type Run = ((String, usize), Readings, Vec<usize>);

/// A run is taken for a copy where it would read as another one more seldom by chance.
const SELDOM: f64 = 1e-3;

/// Whether the run may well read as an earlier one by chance: readings with a coarse last digit often agree. How often, the
/// other runs tell.
fn by_chance(run: usize, runs: &[Run]) -> bool {
    let others: Vec<&Readings> =
        runs.iter().enumerate().filter(|(i, _)| *i != run).map(|(_, r)| &r.1).collect();
    let (mut alike, mut compared) = (0.5, 1.0);
    for (i, one) in others.iter().enumerate() {
        for other in &others[..i] {
            let pairs = one.iter().filter_map(|(place, a)| Some((a, other.get(place)?)));
            for (a, b) in pairs {
                alike += f64::from(u8::from(a == b));
                compared += 1.0;
            }
        }
    }
    let often: f64 = alike / compared;
    often.powi(runs[run].1.len() as i32) > SELDOM
}

/// The rows that count, and what the others are. Without a column `run` the n-th readings of all places are a run. Where all
/// runs are alike the indicator may be too coarse to tell them apart: they stay, and the noise says so.
pub fn runs_once(table: &Table) -> (Vec<usize>, Vec<String>) {
    let mut runs: Vec<Run> = Vec::new();
    let (mut times, mut index) = (BTreeMap::new(), BTreeMap::new());
    for row in 0..table.rows() {
        let run = table.text(row, "run").to_owned();
        let (mut place, mut reading) = (Vec::new(), String::new());
        for (name, text) in table.cells(row) {
            match name {
                "deviation_mm" => reading = text,
                "angle_deg" | "dir" => place.push(text),
                _ => {}
            }
        }
        let nth = times.entry((run.clone(), place.clone())).or_insert(0);
        *nth += 1;
        let label = (run, *nth);
        let at = *index.entry(label).or_insert_with_key(|label| {
            runs.push((label.clone(), Readings::new(), Vec::new()));
            runs.len() - 1
        });
        runs[at].1.insert(place, reading);
        runs[at].2.push(row);
    }
    let (mut left_out, mut warnings) = (Vec::new(), Vec::new());
    for (i, (label, readings, rows)) in runs.iter().enumerate() {
        let same = runs[..i].iter().find(|other| other.1 == *readings);
        let tells = runs.iter().any(|r| r.1 != *readings && r.1.keys().eq(readings.keys()));
        let copied = || !by_chance(i, &runs);
        if let Some((first, ..)) =
            same.filter(|_| tells && readings.len() >= LEAST_READINGS && copied())
        {
            let name = |l: &(String, usize)| match l.0.as_str() {
                "" => format!("{}", l.1),
                run => format!("'{run}'"),
            };
            left_out.extend(rows);
            warnings.push(format!(
                "{}: run {} left out, it reads as run {} at all {} places: a copy counts once",
                table.path().display(),
                name(label),
                name(first),
                readings.len()
            ));
        }
    }
    ((0..table.rows()).filter(|row| !left_out.contains(row)).collect(), warnings)
}
