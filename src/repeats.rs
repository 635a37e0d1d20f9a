//! What stands twice in a table counts once, and the user is told: a copy knows nothing new, and intervals that
//! count it are too narrow.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;
use std::path::{Path, PathBuf};

use crate::error::Result;
use crate::fit::robust::median;
use crate::hash;
use crate::table::Table;
use crate::uncertainty::last_digit;

/// Lines named in a warning; the rest are counted.
const MOST_LINES: usize = 10;

/// For each item the first one with the same key, where it is not itself.
pub fn firsts<K: Eq + Hash>(keys: impl IntoIterator<Item = K>) -> Vec<Option<usize>> {
    let mut seen = HashMap::new();
    let first = |(i, key)| Some(*seen.entry(key).or_insert(i)).filter(|&first| first != i);
    keys.into_iter().enumerate().map(first).collect()
}

/// What each picture is known by: its bytes where another is as long, or its path. A pipe would be waited for.
pub fn contents(paths: &[impl AsRef<Path>]) -> Vec<String> {
    let length =
        |p: &Path| std::fs::metadata(p).ok().filter(std::fs::Metadata::is_file).map(|m| m.len());
    let lengths: Vec<Option<u64>> = paths.iter().map(|p| length(p.as_ref())).collect();
    let mut times = HashMap::new();
    lengths.iter().for_each(|l| *times.entry(l).or_insert(0) += 1);
    let content = |(path, length): (&Path, &Option<u64>)| {
        let hash = length.filter(|_| times[length] > 1).and_then(|_| hash::of_file(path).ok());
        hash.unwrap_or_else(|| path.display().to_string())
    };
    paths.iter().map(AsRef::as_ref).zip(&lengths).map(content).collect()
}

/// The rows of a table that count: of rows that are alike in every column, the first. A warning names
/// the others.
pub fn rows_once(table: &Table, warnings: &mut Vec<String>) -> Vec<usize> {
    let firsts = firsts((0..table.rows()).map(|row| table.cells(row)));
    once(table, &firsts, "a row", warnings)
}

/// Leaves out the copies among measured rows. Where time goes on rows that are alike in every column are copies. Without it they may be
/// repeats that read alike by chance in the columns `readings`: how seldom that is, the repeats that differ tell.
pub fn measured_once(table: &mut Table, readings: &[&str], warnings: &mut Vec<String>) {
    let times = (0..table.rows()).map(|row| table.text(row, "t_s"));
    if times.collect::<HashSet<_>>().len() > 1 || !alike_by_chance(table, readings) {
        let rows = rows_once(table, warnings);
        table.keep(&rows);
    }
}

/// Pairs of repeats that are compared: each row with so many before it.
const COMPARED: usize = 8;
/// Repeats are taken for copies where as many would be alike more seldom by chance.
const SELDOM: f64 = 1e-3;
/// Readings whose repeats differ by fewer last digits than this, in the middle, are alike often: how often, those tell whose other readings
/// differ, unless it is so often that few do.
const COARSE: f64 = 4.0;
const OFTEN: f64 = 0.4;

/// Whether as many rows as are alike in every column may be so by chance, readings being rounded to their last digit.
fn alike_by_chance(table: &Table, readings: &[&str]) -> bool {
    let readings: Vec<&str> = readings.iter().copied().filter(|name| table.has(name)).collect();
    if readings.is_empty() {
        return true;
    }
    let mut places: HashMap<Vec<(&str, String)>, Vec<usize>> = HashMap::new();
    for row in 0..table.rows() {
        let mut cells = table.cells(row);
        cells.retain(|(name, _)| !readings.contains(name));
        places.entry(cells).or_default().push(row);
    }
    let value = |row: usize, name: &str| table.number(row, name).unwrap_or(f64::NAN);
    let (mut alike, mut apart) = (0.0, vec![Vec::new(); readings.len()]);
    for rows in places.values() {
        for (i, row) in rows.iter().enumerate() {
            for other in &rows[i.saturating_sub(COMPARED)..i] {
                let by = |name: &&str| (value(*row, name) - value(*other, name)).abs();
                let by: Vec<f64> = readings.iter().map(by).collect();
                if by.iter().all(|b| *b == 0.0) {
                    alike += 1.0;
                } else {
                    apart.iter_mut().zip(by).for_each(|(all, b)| all.push(b));
                }
            }
        }
    }
    // The chance that rounding makes two normal readings one: the last digit over 2 √π standard deviations.
    let chance = |(name, by): (&&str, &mut Vec<f64>)| {
        let digit = last_digit(&table.column(name).unwrap_or_default());
        let sd = (by.iter().map(|b| b * b).sum::<f64>() / (2 * by.len()) as f64).sqrt();
        let same = (by.iter().filter(|b| **b == 0.0).count() as f64 + 0.5) / (by.len() + 1) as f64;
        if median(by) >= COARSE * digit {
            digit / (2.0 * std::f64::consts::PI.sqrt() * sd)
        } else if same < OFTEN {
            same
        } else {
            1.0
        }
    };
    let pairs = alike + apart[0].len() as f64;
    let expected = if apart[0].is_empty() {
        0.0
    } else {
        pairs * readings.iter().zip(&mut apart).map(chance).product::<f64>()
    };
    // Chernoff's bound of a Poisson count.
    alike <= expected || alike * (1.0 + (expected / alike).ln()) - expected > SELDOM.ln()
}

/// As [`rows_once`] for rows that each name a picture in the column `image`, with where it is: beside the table unless
/// absolute. Rows of one picture, or of a copy of it, count once where all else is alike. One picture at two positions is
/// refused; a copy there is told, and stays.
pub fn pictures_once(table: &Table, warnings: &mut Vec<String>) -> Result<Vec<(usize, PathBuf)>> {
    let folder = table.path().parent().unwrap_or(Path::new(""));
    let name = |row: usize| table.text(row, "image");
    if let Some(row) = (0..table.rows()).find(|&row| name(row).is_empty()) {
        return Err(table.error(row, "image", "is empty", "name a picture"));
    }
    let paths: Vec<PathBuf> = (0..table.rows()).map(|row| folder.join(name(row))).collect();
    let mut firsts = firsts(contents(&paths));
    for (row, entry) in firsts.iter_mut().enumerate() {
        let Some(first) = *entry else { continue };
        let beside = |row: usize| table.cells(row).into_iter().filter(|(name, _)| *name != "image");
        if beside(row).eq(beside(first)) {
            continue;
        }
        let (image, line) = (name(row), table.line(first));
        if paths[row] == paths[first] {
            return Err(table.error(
                row,
                "image",
                format!(
                    "'{image}' is the picture of line {line}, there at another position or time"
                ),
                "give each row its own picture",
            ));
        }
        warnings.push(format!(
            "{}:{}: '{image}' is a copy of the picture of line {line}, there at another position or time: one is wrong",
            table.path().display(),
            table.line(row)
        ));
        *entry = None;
    }
    let rows = once(table, &firsts, "a picture", warnings);
    Ok(rows.into_iter().map(|row| (row, paths[row].clone())).collect())
}

fn once(
    table: &Table,
    firsts: &[Option<usize>],
    what: &str,
    warnings: &mut Vec<String>,
) -> Vec<usize> {
    let lines: Vec<String> = (0..firsts.len())
        .filter(|&row| firsts[row].is_some())
        .map(|row| table.line(row).to_string())
        .collect();
    if !lines.is_empty() {
        let more = if lines.len() > MOST_LINES { ", ..." } else { "" };
        warnings.push(format!(
            "{}: {} left out, {what} that stands twice counts once: line {}{more}",
            table.path().display(),
            lines.len(),
            lines[..lines.len().min(MOST_LINES)].join(", ")
        ));
    }
    (0..firsts.len()).filter(|&row| firsts[row].is_none()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Rows of `places` places read `times` times with noise of 1.5 µm, the first `copies` of them pasted again below.
    fn kept(places: usize, times: usize, decimals: usize, copies: usize) -> usize {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut rows = Vec::new();
        for place in 0..places {
            for _ in 0..times {
                let [dx, dy] = [0.01, 0.02].map(|mean| mean + 1.5e-3 * noise());
                rows.push(format!("{place},{dx:.decimals$},{dy:.decimals$}"));
            }
        }
        rows.extend(rows[..copies].to_vec());
        let text = format!("b_deg,dx_mm,dy_mm\n{}\n", rows.join("\n"));
        let mut table = Table::parse("t.csv", text, &["b_deg", "dx_mm", "dy_mm"], &[]).unwrap();
        let mut warnings = Vec::new();
        measured_once(&mut table, &["dx_mm", "dy_mm"], &mut warnings);
        assert_eq!(warnings.is_empty(), table.rows() == rows.len(), "{warnings:?}");
        table.rows()
    }

    #[test]
    fn pasted_rows_count_once_and_coarse_repeats_stay() {
        assert_eq!(kept(20, 3, 5, 0), 60);
        assert_eq!(kept(20, 3, 5, 2), 60);
        assert_eq!(kept(80, 1, 5, 80), 80);
        // Some of these agree by chance.
        assert_eq!(kept(20, 3, 3, 0), 60);
        // Repeats that all agree tell nothing but their last digit.
        assert_eq!(kept(20, 9, 2, 0), 20);
        assert_eq!(kept(20, 3, 3, 20), 60);
    }
}
