//! A sweep of deviations: reading, grouping by angle and direction, and how noisy the readings are.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Options, astray, copies};
use crate::error::{Error, Result};
use crate::table::Table;
use crate::uncertainty::{K95, k95, rounding_mm, scatters_more};
use crate::units;

/// The way the axis came to the angle.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, schemars::JsonSchema,
)]
pub enum Direction {
    /// Towards larger angles.
    #[serde(rename = "+")]
    Up,
    /// Towards smaller angles.
    #[serde(rename = "-")]
    Down,
}

impl Direction {
    /// The direction a cell means; `None` if the word is not known.
    pub fn parse(word: &str) -> Option<Self> {
        match word.to_ascii_lowercase().as_str() {
            "+" | "1" | "+1" | "1.0" | "up" | "forward" | "fwd" | "pos" | "positive" => {
                Some(Self::Up)
            }
            "-" | "-1" | "-1.0" | "down" | "reverse" | "rev" | "neg" | "negative" => {
                Some(Self::Down)
            }
            _ => None,
        }
    }
}

/// All readings at one angle from one direction.
#[derive(Debug, Clone)]
pub struct Group {
    /// The commanded angle.
    pub angle_deg: f64,
    /// The approach, where the sweep tells it.
    pub dir: Option<Direction>,
    /// How many readings there are.
    pub readings: usize,
    /// Their mean.
    pub mean_mm: f64,
    /// The old table's entry as it stands in the file, 0 where there is none.
    comp_deg: f64,
}

/// Deviations over angle, direction and run.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// One for each angle and direction, by rising angle.
    pub groups: Vec<Group>,
    /// What was left out.
    pub warnings: Vec<String>,
    noise: Noise,
}

/// How much a reading scatters.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    /// Standard deviation of one reading against its run.
    pub reading_mm: f64,
    /// Degrees of freedom behind it.
    pub reading_dof: f64,
    /// Standard deviation of a whole run's shift (the indicator zeroed anew).
    pub run_mm: f64,
    /// Standard deviation of the runs' means as seen, their readings' noise included.
    between_mm: f64,
    /// Standard uncertainty by the readings' last digit.
    rounding_mm: f64,
    /// Number of runs.
    pub runs: usize,
    /// What the figures rest on.
    pub source: NoiseSource,
    /// Whether repeats scatter by more than the user says.
    is_doubted: bool,
    /// Whether repeats do not scatter at all, though what the user says hardly ever leaves them so.
    is_copied: bool,
}

/// Repeats that are all alike are copies where noise would leave them so more seldom.
const SELDOM: f64 = 1e-3;

/// Where the noise figure comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseSource {
    /// The user's figure.
    Given,
    /// Repeated runs.
    Repeats,
    /// How rough the curve is from angle to angle: an upper bound.
    Roughness,
    /// Too few readings to tell.
    Unknown,
}

pub(super) struct Reading {
    pub group: usize,
    pub run: String,
    pub deviation_mm: f64,
    pub row: usize,
}

impl Sweep {
    /// Reads `angle_deg,deviation_mm` and optionally `dir`, `run`, `comp_deg`.
    pub fn read(path: impl AsRef<Path>, modulo: bool) -> Result<Self> {
        let table = Table::read(path, &["angle_deg", "deviation_mm"], &["dir", "run", "comp_deg"])?;
        Self::from_table(&table, modulo)
    }

    /// As [`Sweep::read`], from a table.
    pub fn from_table(table: &Table, modulo: bool) -> Result<Self> {
        let mut by_place: BTreeMap<(i64, Option<Direction>), usize> = BTreeMap::new();
        let mut groups: Vec<Group> = Vec::new();
        let mut readings = Vec::new();
        let (rows, mut warnings) = copies::runs_once(table);
        warnings.extend(units::angles("angle_deg", &table.column("angle_deg")?));
        warnings.extend(units::errors("deviation_mm", &table.column("deviation_mm")?));
        let comp = table.optional_column("comp_deg")?.unwrap_or_default();
        warnings.extend(units::corrections("comp_deg", &comp));
        for row in rows {
            let angle = table.number(row, "angle_deg")?;
            let angle_deg = if modulo { angle.rem_euclid(360.0) } else { angle };
            let dir = match (table.has("dir"), table.text(row, "dir")) {
                (false, _) | (true, "") => None,
                (true, word) => Some(Direction::parse(word).ok_or_else(|| {
                    table.error(row, "dir", format!("'{word}' is no direction"), "write + or -")
                })?),
            };
            let comp_deg = if table.has("comp_deg") { table.number(row, "comp_deg")? } else { 0.0 };
            // Angles closer than a millionth of a degree are the same place; 360° is 0° on an endless axis.
            let mut place = (angle_deg * 1e6).round() as i64;
            if modulo && place == 360_000_000 {
                place = 0;
            }
            let group = *by_place.entry((place, dir)).or_insert_with(|| {
                let angle_deg = place as f64 / 1e6;
                groups.push(Group { angle_deg, dir, readings: 0, mean_mm: 0.0, comp_deg });
                groups.len() - 1
            });
            if (groups[group].comp_deg - comp_deg).abs() > 1e-9 {
                return Err(table.error(
                    row,
                    "comp_deg",
                    format!("{comp_deg} differs from {} at the same angle", groups[group].comp_deg),
                    "one table must have been active during all runs; give its one value",
                ));
            }
            let deviation_mm = table.number(row, "deviation_mm")?;
            // Without a run the n-th readings of all places are one: its shift is common to them.
            let run = match table.text(row, "run") {
                "" => format!(" {}", groups[group].readings),
                run => run.to_owned(),
            };
            groups[group].readings += 1;
            readings.push(Reading { group, run, deviation_mm, row });
        }
        astray::leave_out(table, &mut groups, &mut readings, &mut warnings);
        readings.iter().for_each(|r| groups[r.group].mean_mm += r.deviation_mm);
        if groups.iter().any(|g| g.dir.is_none()) && groups.iter().any(|g| g.dir.is_some()) {
            return Err(Error::file(
                table.path(),
                "some rows have a direction and some do not",
                "fill the column 'dir' in every row, or remove it",
            ));
        }
        groups.iter_mut().for_each(|g| g.mean_mm /= g.readings as f64);
        let read: Vec<f64> = readings.iter().map(|r| r.deviation_mm).collect();
        let noise = Noise { rounding_mm: rounding_mm(&read), ..estimate_noise(&groups, &readings) };
        groups.sort_by(|a, b| a.angle_deg.total_cmp(&b.angle_deg).then(a.dir.cmp(&b.dir)));
        Ok(Self { groups, warnings, noise })
    }

    /// The noise of a reading: the user's figure if there is one.
    pub fn noise(&self, given_mm: Option<f64>) -> Noise {
        match given_mm {
            // How whole runs shift is no noise of a reading: the runs still tell it.
            Some(reading_mm) => Noise {
                reading_mm,
                reading_dof: f64::INFINITY,
                source: NoiseSource::Given,
                is_doubted: self.noise.source == NoiseSource::Repeats
                    && scatters_more(self.noise.reading_mm, self.noise.reading_dof, reading_mm),
                is_copied: self.noise.source == NoiseSource::Repeats
                    && self.noise.reading_mm == 0.0
                    && self.alike_by_chance(reading_mm) < SELDOM,
                ..self.noise
            },
            None => self.noise,
        }
    }

    /// The chance that noise leaves all repeats alike: of two readings, the last digit over 2 √π standard deviations.
    fn alike_by_chance(&self, reading_mm: f64) -> f64 {
        let digit_mm = self.noise.rounding_mm * 12f64.sqrt();
        let two = (digit_mm / (2.0 * std::f64::consts::PI.sqrt() * reading_mm)).min(1.0);
        two.powi(self.groups.iter().map(|g| g.readings as i32 - 1).sum())
    }

    /// The old table as absolute values in the sense +1, one for each group.
    pub(super) fn old_table(&self, options: &Options) -> Result<Vec<f64>> {
        let mut old: Vec<f64> =
            self.groups.iter().map(|g| options.comp_sense * g.comp_deg).collect();
        if !options.incremental {
            return Ok(old);
        }
        let reference = options.reference_deg;
        for dir in [None, Some(Direction::Up), Some(Direction::Down)] {
            let members: Vec<usize> =
                (0..old.len()).filter(|&i| self.groups[i].dir == dir).collect();
            if members.is_empty() {
                continue;
            }
            let mut sum = 0.0;
            for &i in &members {
                sum += old[i];
                old[i] = sum;
            }
            let zero = members
                .iter()
                .find(|&&i| (self.groups[i].angle_deg - reference).abs() < 1e-6)
                .map(|&i| old[i])
                .ok_or_else(|| {
                    Error::option(
                        "--reference-deg",
                        format!("the sweep has no angle {reference}°"),
                        "give the angle at which the incremental table is zero",
                    )
                })?;
            members.iter().for_each(|&i| old[i] -= zero);
        }
        Ok(old)
    }
}

impl Noise {
    /// Half-width of the 95 % interval of the mean of some readings; `None` if unknown.
    ///
    /// Readings and runs each with their own factor: two runs that happen to shift alike say little of how runs shift, and pooled
    /// degrees of freedom (Welch-Satterthwaite) would believe them.
    pub fn u95_of_mean(&self, readings: usize) -> Option<f64> {
        let from_reading = k95(self.reading_dof) * self.reading_mm / (readings as f64).sqrt();
        // A place that some of the runs saw has only their shifts averaged.
        let (runs, seen_by) = (self.runs.max(1) as f64, readings.clamp(1, self.runs.max(1)) as f64);
        let from_run = if self.between_mm > 0.0 {
            k95(runs - 1.0) * self.between_mm / seen_by.sqrt()
        } else {
            0.0
        };
        // Readings that scatter by less than their last digit are all rounded alike.
        let alike = self.reading_mm < self.rounding_mm * 0.5 * 12f64.sqrt();
        let from_rounding = if alike { K95 * self.rounding_mm } else { 0.0 };
        let all = from_reading.hypot(from_run).hypot(from_rounding);
        (self.source != NoiseSource::Unknown).then_some(all)
    }

    /// The same of one more reading about its true mean.
    pub(super) fn u95_of_next(&self) -> f64 {
        k95(self.reading_dof) * self.reading_mm.hypot(self.run_mm)
    }

    pub(super) fn warning(&self) -> Option<String> {
        match self.source {
            NoiseSource::Repeats if self.reading_mm == 0.0 => Some(
                "repeated readings are all alike: the indicator's resolution hides its noise, or a run was copied; \
                 give --noise-mm"
                    .to_owned(),
            ),
            NoiseSource::Given if self.is_doubted => Some(
                "repeated readings scatter by more than --noise-mm says: the intervals are too narrow".to_owned(),
            ),
            NoiseSource::Given if self.is_copied => Some(
                "repeated readings are all alike, which noise of --noise-mm would not leave them: a run was copied, and the intervals are too \
                 narrow; leave the copy out"
                    .to_owned(),
            ),
            NoiseSource::Given if self.runs < 2 => Some(
                "one run: how much the indicator's zero shifts from run to run is in no interval; repeat the sweep"
                    .to_owned(),
            ),
            NoiseSource::Given | NoiseSource::Repeats => None,
            NoiseSource::Roughness => Some(
                "no repeated runs: the noise is taken from how rough the curve is, and how much the indicator's zero shifts \
                 from run to run is in no interval; repeat the sweep"
                    .to_owned(),
            ),
            NoiseSource::Unknown => Some(
                "one run of too few angles: no uncertainty can be told; repeat the sweep or give --noise-mm"
                    .to_owned(),
            ),
        }
    }
}

/// Scatter of readings: against run and place where there are repeats, else between neighbours.
fn estimate_noise(groups: &[Group], readings: &[Reading]) -> Noise {
    let names: std::collections::BTreeSet<&str> = readings.iter().map(|r| r.run.as_str()).collect();
    let runs: Vec<&str> = names.into_iter().collect();
    let repeats = readings.len() - groups.len();
    if repeats == 0 {
        return roughness(groups);
    }
    // Shift of each run against the mean of the places it visited.
    let mut shift = vec![(0.0, 0usize); runs.len()];
    let index = |r: &Reading| runs.iter().position(|&n| n == r.run).unwrap_or(0);
    for r in readings.iter().filter(|r| groups[r.group].readings > 1) {
        let s = &mut shift[index(r)];
        s.0 += r.deviation_mm - groups[r.group].mean_mm;
        s.1 += 1;
    }
    let shift_of = |i: usize| if shift[i].1 > 0 { shift[i].0 / shift[i].1 as f64 } else { 0.0 };
    let used = shift.iter().filter(|s| s.1 > 0).count();
    let free = repeats.saturating_sub(used.saturating_sub(1)).max(1);
    let split = used > 1 && repeats > used - 1;
    let sum: f64 = readings
        .iter()
        .map(|r| {
            let own = if split { shift_of(index(r)) } else { 0.0 };
            (r.deviation_mm - groups[r.group].mean_mm - own).powi(2)
        })
        .sum();
    let dof = if split { free } else { repeats } as f64;
    // Alike readings differ by how their binary fractions round.
    let variance = if sum > NOTHING_MM2 { sum / dof } else { 0.0 };
    let (mut run_variance, mut between_mm) = (0.0, 0.0);
    if split {
        let places = readings.len() as f64 / used as f64;
        let between: f64 =
            (0..runs.len()).map(|i| shift_of(i).powi(2)).sum::<f64>() / (used - 1) as f64;
        run_variance = (between - variance / places).max(0.0);
        between_mm = between.sqrt();
    }
    Noise {
        reading_mm: variance.sqrt(),
        reading_dof: dof,
        run_mm: run_variance.sqrt(),
        between_mm,
        rounding_mm: 0.0,
        runs: used.max(1),
        source: NoiseSource::Repeats,
        is_doubted: false,
        is_copied: false,
    }
}

/// Less than this is no scatter, mm².
const NOTHING_MM2: f64 = 1e-20;

/// Noise from second differences along each direction: var(a - 2b + c) = 6 σ².
fn roughness(groups: &[Group]) -> Noise {
    let mut sum = 0.0;
    let mut count = 0.0;
    for dir in [None, Some(Direction::Up), Some(Direction::Down)] {
        let mut line: Vec<&Group> = groups.iter().filter(|g| g.dir == dir).collect();
        line.sort_by(|a, b| a.angle_deg.total_cmp(&b.angle_deg));
        for w in line.windows(3) {
            // The middle against the straight line through its neighbours, for uneven steps too.
            let span = w[2].angle_deg - w[0].angle_deg;
            let t = (w[1].angle_deg - w[0].angle_deg) / span;
            let gap = w[1].mean_mm - (1.0 - t) * w[0].mean_mm - t * w[2].mean_mm;
            sum += gap * gap / (1.0 + (1.0 - t).powi(2) + t * t);
            count += 1.0;
        }
    }
    let source = if count >= 3.0 { NoiseSource::Roughness } else { NoiseSource::Unknown };
    let variance = if count > 0.0 { sum / count } else { 0.0 };
    // Neighbouring differences share readings: about half of them are independent.
    Noise {
        reading_mm: variance.sqrt(),
        reading_dof: (0.5 * count).max(1.0),
        run_mm: 0.0,
        between_mm: 0.0,
        rounding_mm: 0.0,
        runs: 1,
        source,
        is_doubted: false,
        is_copied: false,
    }
}
