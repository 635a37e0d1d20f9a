//! Readings that lie far from the others of their place: a slip of the pen, a knock on the indicator.

use std::collections::BTreeMap;

use super::sweep::{Group, Reading};
use crate::fit::robust::{median, scatter};
use crate::table::Table;

/// How many times as far as readings usually lie.
const FAR: f64 = 10.0;
/// No reading nearer is worth a word, mm.
const LEAST_MM: f64 = 0.003;
/// One of so many readings may be a slip; where more lie far off the readings scatter so.
const OFTEN: usize = 20;
/// Readings of a place of which one can be told from the others.
const SEVERAL: usize = 3;

/// A reading far from the others.
struct Astray {
    /// Its place in the list.
    reading: usize,
    /// How far it lies from the middle of its place's readings.
    off_mm: f64,
    /// Whether the place has enough others to know that it is this one.
    is_told: bool,
}

/// Leaves out readings that lie far from the others of their place, where these tell which it is, with a word on each.
pub(super) fn leave_out(
    table: &Table,
    groups: &mut [Group],
    readings: &mut Vec<Reading>,
    warnings: &mut Vec<String>,
) {
    let astray = astray(readings);
    for a in &astray {
        let r = &readings[a.reading];
        let done = if a.is_told { "left out" } else { "one of them is wrong: read it again" };
        warnings.push(format!(
            "line {}: {} mm at {}° lies {:+.4} mm from the others of its place: {done}",
            table.line(r.row),
            r.deviation_mm,
            groups[r.group].angle_deg,
            a.off_mm
        ));
    }
    for a in astray.iter().rev().filter(|a| a.is_told) {
        groups[readings.remove(a.reading).group].readings -= 1;
    }
}

/// Readings of one place (`Reading::group`) against each other, each run's own shift aside.
fn astray(readings: &[Reading]) -> Vec<Astray> {
    let middle = |values: &[f64]| match values.len() {
        // Of two the upper one would stand for both.
        2 => 0.5 * (values[0] + values[1]),
        _ => median(&mut values.to_vec()),
    };
    let mut places: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    readings.iter().for_each(|r| places.entry(r.group).or_default().push(r.deviation_mm));
    let places: BTreeMap<usize, (f64, usize)> =
        places.into_iter().map(|(place, list)| (place, (middle(&list), list.len()))).collect();
    let from_place = |r: &Reading| r.deviation_mm - places[&r.group].0;
    let mut runs: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let repeated = || readings.iter().filter(|r| places[&r.group].1 > 1);
    repeated().for_each(|r| runs.entry(&r.run).or_default().push(from_place(r)));
    let shifts: BTreeMap<&str, f64> =
        runs.into_iter().map(|(run, list)| (run, middle(&list))).collect();
    let off = |r: &Reading| from_place(r) - shifts.get(r.run.as_str()).unwrap_or(&0.0);
    // The one in the middle of its place says nothing of the scatter.
    let mut sizes: Vec<f64> = repeated().map(|r| off(r).abs()).filter(|size| *size > 0.0).collect();
    if sizes.is_empty() {
        return Vec::new();
    }
    let least = (FAR * scatter(&mut sizes)).max(LEAST_MM);
    let far = |(reading, r): (usize, &Reading)| {
        let (off_mm, readings) = (off(r), places[&r.group].1);
        let is_told = readings >= SEVERAL;
        (readings > 1 && off_mm.abs() > least).then_some(Astray { reading, off_mm, is_told })
    };
    let all: Vec<Astray> = readings.iter().enumerate().filter_map(far).collect();
    // Of two readings that differ both are told.
    let slips = all.iter().map(|a| if a.is_told { 2 } else { 1 }).sum::<usize>().div_ceil(2);
    if slips > readings.len().div_ceil(OFTEN) { Vec::new() } else { all }
}

#[cfg(test)]
mod tests {
    use crate::rotary::Sweep;
    use crate::table::Table;

    /// Three runs over eight places, each run with its own shift; one reading of the second is off.
    fn swept(runs: usize, off_mm: f64) -> Sweep {
        let mut csv = String::from("angle_deg,deviation_mm,run\n");
        for run in 0..runs {
            for place in 0..8 {
                let noise = 0.001 * ((run * 7 + place * 5) % 11) as f64 / 5.0;
                let slip = if (run, place) == (1, 3) { off_mm } else { 0.0 };
                let read = 0.01 * place as f64 + 0.004 * run as f64 + noise + slip;
                csv += &format!("{},{read:.4},{run}\n", 10 * place);
            }
        }
        let table = Table::parse("s.csv", csv, &["angle_deg", "deviation_mm"], &["run"]).unwrap();
        Sweep::from_table(&table, false).unwrap()
    }

    #[test]
    fn a_slip_is_named_and_left_out_where_others_tell() {
        assert!(swept(3, 0.0).warnings.is_empty(), "{:?}", swept(3, 0.0).warnings);
        let sweep = swept(3, 0.05);
        assert!(sweep.warnings[0].starts_with("line 13: "), "{:?}", sweep.warnings);
        assert!((sweep.groups[3].readings, sweep.warnings.len()) == (2, 1), "{:?}", sweep.warnings);
        let sweep = swept(2, 0.05);
        assert_eq!((sweep.groups[3].readings, sweep.warnings.len()), (2, 2));
        assert!(sweep.warnings[0].contains("one of them is wrong"), "{:?}", sweep.warnings);
    }
}
