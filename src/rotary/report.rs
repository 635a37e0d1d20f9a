//! What the correction hands back: rows, a summary, and their words and plots.

use serde::Serialize;

use super::sweep::NoiseSource;
use super::{Direction, Noise, Options, PRINTED_RULE_DEG_PER_MM};
use crate::plot::{Figure, Panel};
use crate::uncertainty::Verdict;

/// One angle (and direction) of the table.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Row {
    /// Commanded angle.
    pub angle_deg: f64,
    /// Approach, where the sweep tells it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dir: Option<Direction>,
    /// Number of readings averaged.
    pub readings: usize,
    /// Mean deviation.
    pub deviation_mm: f64,
    /// Half-width of its 95 % interval.
    pub deviation_u95_mm: Option<f64>,
    /// Angle error `atan(deviation / L)`.
    pub error_deg: f64,
    /// Half-width of its 95 % interval; `None` where nothing tells the noise.
    pub error_u95_deg: Option<f64>,
    /// The old entry, absolute, sense +1.
    pub comp_old_deg: f64,
    /// The new entry.
    pub comp_new_deg: f64,
    /// The deviation the new entry leaves, if the axis repeats: where a table is written, as the control holds it.
    pub predicted_deviation_mm: f64,
    /// Half-width of the 95 % interval for the next reading around it.
    pub predicted_u95_mm: Option<f64>,
    /// Why a row needs a second look.
    pub flags: Vec<Flag>,
}

/// Why a row was treated as it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Flag {
    /// The deviation is within the dead band: the entry stays.
    DeadBand,
    /// The error is smaller than its uncertainty.
    WithinNoise,
}

/// What the rounded shop rule would have done.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Rule {
    /// The rule's correction per millimetre.
    pub deg_per_mm: f64,
    /// The true correction per millimetre at this L.
    pub exact_deg_per_mm: f64,
    /// How much too large the rule's corrections are.
    pub over_correction_percent: f64,
    /// The largest deviation the rule's own table would leave.
    pub worst_left_mm: f64,
}

/// The sweep in a few numbers.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Summary {
    /// Distance from axis to tool point.
    pub pivot_mm: f64,
    /// Largest deviation before.
    pub before_max_mm: f64,
    /// Half-width of a place's 95 % interval, the widest of all; null where nothing tells the noise. The largest of many is seen too large: near
    /// a limit the verdict is on the safe side.
    pub before_max_u95_mm: Option<f64>,
    /// Largest deviation expected after: what is left plus its 95 % half-width.
    pub after_max_mm: f64,
    /// Largest deviation left by the table alone.
    pub after_table_max_mm: f64,
    /// Mean of (up - down) over angles measured from both sides, as an angle.
    pub reversal_deg: Option<f64>,
    /// Standard deviation of one reading.
    pub noise_mm: Option<f64>,
    /// What that figure rests on.
    pub noise_source: NoiseSource,
    /// Standard deviation of a whole run's shift.
    pub run_shift_mm: f64,
    /// The rounded shop rule, beside the truth.
    pub printed_rule: Rule,
}

impl Summary {
    pub(super) fn of(rows: &[Row], options: &Options, noise: &Noise) -> Self {
        let max = |f: &dyn Fn(&Row) -> f64| rows.iter().map(f).fold(0.0, f64::max);
        let length = options.pivot_mm;
        let exact = (1.0 / length).atan().to_degrees();
        let worst_left_mm = max(&|r| {
            let moved = if r.flags.contains(&Flag::DeadBand) {
                0.0
            } else {
                PRINTED_RULE_DEG_PER_MM * r.deviation_mm
            };
            (length * (r.error_deg - moved).to_radians().tan()).abs()
        });
        let known = noise.source != NoiseSource::Unknown;
        let [after_max_mm, after_table_max_mm] = after(rows);
        Self {
            pivot_mm: length,
            before_max_mm: max(&|r| r.deviation_mm.abs()),
            before_max_u95_mm: rows
                .iter()
                .map(|r| r.deviation_u95_mm)
                .reduce(|a, b| Some(a?.max(b?)))
                .flatten(),
            after_max_mm,
            after_table_max_mm,
            reversal_deg: reversal(rows),
            noise_mm: known.then_some(noise.reading_mm),
            noise_source: noise.source,
            run_shift_mm: noise.run_mm,
            printed_rule: Rule {
                deg_per_mm: PRINTED_RULE_DEG_PER_MM,
                exact_deg_per_mm: exact,
                over_correction_percent: 100.0 * (PRINTED_RULE_DEG_PER_MM / exact - 1.0),
                worst_left_mm,
            },
        }
    }
}

/// Nobody minds what a table's steps leave below this.
const LEAST_COST_MM: f64 = 1e-3;

/// The largest deviation expected with the next reading's scatter, and without.
fn after(rows: &[Row]) -> [f64; 2] {
    let max = |f: &dyn Fn(&Row) -> f64| rows.iter().map(f).fold(0.0, f64::max);
    [
        max(&|r| r.predicted_deviation_mm.abs() + r.predicted_u95_mm.unwrap_or(0.0)),
        max(&|r| r.predicted_deviation_mm.abs()),
    ]
}

fn reversal(rows: &[Row]) -> Option<f64> {
    let gaps: Vec<f64> = rows
        .windows(2)
        .filter(|w| w[0].angle_deg == w[1].angle_deg)
        .map(|w| w[0].error_deg - w[1].error_deg)
        .collect();
    (!gaps.is_empty()).then(|| gaps.iter().sum::<f64>() / gaps.len() as f64)
}

/// The corrected table with everything known of it.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// One row for each angle and direction, by rising angle.
    pub rows: Vec<Row>,
    /// The sweep in a few numbers.
    pub summary: Summary,
    /// Largest deviation allowed; null where none was given.
    pub tolerance_mm: Option<f64>,
    /// Of the largest deviation measured; null without a tolerance.
    pub verdict: Option<Verdict>,
    /// Whether the axis turns without end.
    #[serde(skip)]
    pub modulo: bool,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Report {
    /// Expects what a control's table leaves, whose steps and straight lines may differ from the new entries; `entries_deg` are
    /// what it adds at each row's angle. A table that costs more than the readings' noise, or leaves more than there was, is told.
    pub fn expect(&mut self, entries_deg: &[f64]) {
        let length = self.summary.pivot_mm;
        let mut costs = None;
        for (row, entry) in self.rows.iter_mut().zip(entries_deg) {
            let left_deg = row.error_deg + entry - row.comp_old_deg;
            let left_mm = length * left_deg.to_radians().tan();
            let more = left_mm.abs() - row.predicted_deviation_mm.abs();
            if more > row.predicted_u95_mm.unwrap_or(0.0).max(LEAST_COST_MM) {
                let worst = costs.get_or_insert((more, row.angle_deg, left_mm));
                if more > worst.0 {
                    *worst = (more, row.angle_deg, left_mm);
                }
            }
            row.predicted_deviation_mm = left_mm;
        }
        [self.summary.after_max_mm, self.summary.after_table_max_mm] = after(&self.rows);
        if let Some((_, angle_deg, left_mm)) = costs {
            let worse = self.summary.after_table_max_mm > self.summary.before_max_mm;
            self.warnings.push(format!(
                "the table as written leaves {left_mm:+.4} mm at {angle_deg}°{}: its points are too far apart or its steps too coarse; \
                 give a smaller --step-deg or --resolution-deg",
                if worse { ", more than there was" } else { "" }
            ));
        }
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let mut out = String::from(
            "   angle  dir  deviation mm    error °      ±95 %   old comp °  new comp °  left mm\n",
        );
        for r in &self.rows {
            let dir = match r.dir {
                None => "",
                Some(Direction::Up) => "+",
                Some(Direction::Down) => "-",
            };
            let u = r.error_u95_deg.map_or("?".into(), |u| format!("{u:.5}"));
            out.push_str(&format!(
                "{:8.3} {dir:>4} {:+13.4} {:+10.5} {u:>10} {:+12.4} {:+11.4} {:+8.4}{}\n",
                r.angle_deg,
                r.deviation_mm,
                r.error_deg,
                r.comp_old_deg,
                r.comp_new_deg,
                // Adding zero turns a tiny negative remainder's sign off once rounded.
                (r.predicted_deviation_mm * 1e4).round() / 1e4 + 0.0,
                if r.flags.contains(&Flag::DeadBand) { "  dead band" } else { "" },
            ));
        }
        let s = &self.summary;
        out.push_str(&format!(
            "\nlargest deviation: {:.4} mm before, {:.4} mm expected after (table {:.4} mm + noise)\n",
            s.before_max_mm, s.after_max_mm, s.after_table_max_mm
        ));
        if let Some((limit, verdict)) = self.tolerance_mm.zip(self.verdict) {
            let u95 = s.before_max_u95_mm.map_or("?".into(), |u| format!("{u:.4}"));
            out.push_str(&format!(
                "as measured {:.4} ± {u95} mm, limit {limit} mm: {verdict}\n",
                s.before_max_mm
            ));
        }
        if let Some(reversal) = s.reversal_deg {
            out.push_str(&format!("reversal (up - down, mean): {reversal:+.5}°\n"));
        }
        let rule = &s.printed_rule;
        out.push_str(&format!(
            "at L = {} mm 0.01 mm is {:.5}°; the rounded rule 0.01 mm = 0.001° would correct {:.1} % too {}\n\
             and leave up to {:.4} mm\n",
            s.pivot_mm,
            0.01 * rule.exact_deg_per_mm,
            rule.over_correction_percent.abs(),
            if rule.over_correction_percent < 0.0 { "little" } else { "much" },
            rule.worst_left_mm
        ));
        out
    }

    /// Deviations before and expected after, and the table before and after.
    pub fn figure(&self, dead_band_mm: f64) -> Figure {
        let mut deviations = Panel::new("angle, °", "RTCP deviation, mm")
            .title("Deviation before, and expected after");
        let mut table = Panel::new("angle, °", "compensation, °").title("Compensation table");
        for (dir, word) in
            [(None, ""), (Some(Direction::Up), " (+)"), (Some(Direction::Down), " (-)")]
        {
            let rows: Vec<&Row> = self.rows.iter().filter(|r| r.dir == dir).collect();
            if rows.is_empty() {
                continue;
            }
            let before: Vec<_> = rows
                .iter()
                .map(|r| (r.angle_deg, r.deviation_mm, r.deviation_u95_mm.unwrap_or(0.0)))
                .collect();
            let pick = |f: fn(&Row) -> f64| -> Vec<_> {
                rows.iter().map(|r| (r.angle_deg, f(r))).collect()
            };
            deviations = deviations
                .points_with_bars(format!("before{word}, ±95 %"), &before)
                .line(format!("after{word}"), &pick(|r| r.predicted_deviation_mm));
            table = table
                .line(format!("old{word}"), &pick(|r| r.comp_old_deg))
                .line(format!("new{word}"), &pick(|r| r.comp_new_deg));
        }
        if dead_band_mm > 0.0 {
            deviations = deviations.limit("dead band", dead_band_mm).limit("", -dead_band_mm);
        }
        Figure::new("Rotary axis correction").panel(deviations).panel(table)
    }
}
