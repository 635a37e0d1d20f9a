//! Values over time, and whether they drift by more than their uncertainty.

use std::collections::{BTreeMap, HashMap, HashSet};

use serde::Serialize;
use serde_json::Value;

use super::Record;
use crate::batch::limits::{number, u95_key};
use crate::clock::{DAY_S, parse, utc};
use crate::fit::tails::{ln_chi2_tail, ln_f_tail};
use crate::plot::{Figure, Panel};
use crate::uncertainty::{K95, k95, text};

/// What is followed over time: command, key, name, key of its limit.
const FOLLOWED: [(&str, &str, &str, Option<&str>); 25] = [
    ("burn", "offset_mm.0", "offset X, mm", None),
    ("burn", "offset_mm.1", "offset Y, mm", None),
    ("burn", "distance_mm", "concentricity, mm", Some("tolerance_mm")),
    ("burn-mean", "offset_mm.0", "offset X, mm", None),
    ("burn-mean", "offset_mm.1", "offset Y, mm", None),
    ("burn-mean", "distance_mm", "concentricity, mm", Some("tolerance_mm")),
    ("rod", "axis_center_mm.0", "X_C, mm", None),
    ("rod", "axis_center_mm.1", "Y_C, mm", None),
    ("rod", "rod_centers.0.center_mm.0", "rod's centre X, mm", None),
    ("rod", "rod_centers.0.center_mm.1", "rod's centre Y, mm", None),
    ("rod", "diameter_mm", "rod diameter, mm", None),
    ("solve", "xc_mm", "X_C, mm", None),
    ("solve", "yc_mm", "Y_C, mm", None),
    ("solve", "xb_mm", "X_B, mm", None),
    ("solve", "zb_mm", "Z_B, mm", None),
    ("solve", "delta_x_mm", "ΔX, mm", None),
    ("solve", "r_mm", "R, mm", None),
    ("verify", "worst_mm", "largest true deviation, mm", Some("tolerance_mm")),
    ("rotary", "summary.before_max_mm", "largest deviation, mm", Some("tolerance_mm")),
    ("calib-check", "deviation_mm", "diameter's deviation, mm", None),
    ("calib-check", "scale_error_percent", "scale error, %", None),
    ("calib-check", "rotation_error_deg", "turn, °", None),
    ("calib-check", "field_error_mm", "largest error in the frame, mm", None),
    ("calib-laser", "offset_mm.0", "laser X, mm", None),
    ("calib-laser", "offset_mm.1", "laser Y, mm", None),
];

/// Chance of a false alarm.
const ALARM: f64 = 1e-3;

/// Values that scatter as they do with such a chance, were their uncertainties right, have others.
const SCATTERED: f64 = 0.01;

/// One value over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// The command it came from.
    pub command: String,
    /// The key in its result.
    pub key: String,
    /// For axes and messages.
    pub label: String,
    /// The newest limit.
    pub limit: Option<f64>,
    /// (days since 1970, value, u95), oldest first.
    pub points: Vec<(f64, f64, f64)>,
}

/// A change beyond uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Drift {
    /// The command.
    pub command: String,
    /// The key.
    pub key: String,
    /// `step` (the newest differs from those before) or `trend` (a slope over time).
    pub kind: String,
    /// The change: newest minus mean of those before, or over the whole time.
    pub change: f64,
    /// Half-width of its 95 % interval.
    pub change_u95: f64,
    /// A sentence.
    pub text: String,
}

/// The followed values of these records, each command and key a series. A burn that was measured again from the same picture counts
/// once, as it was measured last: that is no further evidence. (The table of a rod's captures may name other pictures each time.)
pub fn series(records: &[Record]) -> Vec<Series> {
    let mut all: BTreeMap<usize, Series> = BTreeMap::new();
    let file = |r: &Record| r.input_sha256.clone().filter(|_| r.command == "burn");
    let newest: HashMap<_, &Record> = records.iter().filter_map(|r| Some((file(r)?, r))).collect();
    let mut told = HashSet::new();
    for record in records {
        let again = file(record).is_some_and(|file| !told.insert(file));
        let value = file(record).and_then(|file| newest.get(&file).copied()).unwrap_or(record);
        let (Some(time), Some(result)) = (parse(&record.time_utc), value.result.as_object()) else {
            continue;
        };
        if again {
            continue;
        }
        // At one table angle a rod's centre stands for the C axis: other values, followed by themselves.
        let one_angle = result.get("axis_separated") == Some(&Value::Bool(false));
        let other = if one_angle { "axis_center_mm" } else { "rod_centers" };
        for (i, (command, key, label, limit)) in FOLLOWED.iter().enumerate() {
            if key.starts_with(other) {
                continue;
            }
            let Some(value) = number(result, key).filter(|_| record.command == *command) else {
                continue;
            };
            let u95 = u95_key(key).and_then(|k| number(result, &k)).unwrap_or(0.0);
            let series = all.entry(i).or_insert_with(|| Series {
                command: (*command).into(),
                key: (*key).into(),
                label: (*label).into(),
                limit: None,
                points: Vec::new(),
            });
            series.points.push((time as f64 / DAY_S, value, u95));
            series.limit = limit.and_then(|k| number(result, k)).or(series.limit);
        }
    }
    all.into_values().collect()
}

impl Series {
    /// Looks for a step (the newest value against the weighted mean of those before) and for a trend (weighted
    /// straight line). Where values scatter more than their uncertainty says, the scatter counts.
    pub fn drift(&self) -> Vec<Drift> {
        let mut found = Vec::new();
        // One that does not say how sure it is can be neither a step nor part of a trend.
        let points: Vec<_> = self.points.iter().copied().filter(|p| p.2 > 0.0).collect();
        let Some(((last_day, last, last_u95), before)) = points.split_last() else {
            return found;
        };
        let first_day = points[0].0;
        let mut add = |kind: &str, change: f64, (u, dof): (f64, f64), what: String| {
            if ln_f_tail((change / u).powi(2), 1.0, dof) < ALARM.ln() {
                let change_u95 = k95(dof) * u;
                found.push(Drift {
                    command: self.command.clone(),
                    key: self.key.clone(),
                    kind: kind.into(),
                    change,
                    change_u95,
                    text: format!(
                        "{}: {what} {}{}",
                        self.label,
                        if change > 0.0 { "+" } else { "" },
                        text(change, change_u95)
                    ),
                });
            }
        };
        if let Some((mean, u, scatter)) = constant(before) {
            // The newest scatters as those before do.
            add(
                "step",
                last - mean,
                (u.hypot(last_u95 / K95) * scatter.excess, scatter.dof),
                match before.len() {
                    1 => "the newest differs from the one before by".into(),
                    n => format!("the newest differs from the {n} before by"),
                },
            );
        }
        if let Some((slope, u, scatter)) = line(&points) {
            let days = last_day - first_day;
            let u = (u * days * scatter.excess, scatter.dof);
            add("trend", slope * days, u, format!("trend over {days:.1} days"));
        }
        found
    }

    fn panel(&self) -> Panel {
        let origin = self.points[0].0;
        let interval = |p: &(f64, f64, f64)| (p.0 - origin, p.1 - p.2, p.1 + p.2);
        let shifted: Vec<_> = self.points.iter().map(interval).collect();
        let line: Vec<_> = self.points.iter().map(|p| (p.0 - origin, p.1)).collect();
        let since = utc((origin * DAY_S).round() as u64)[..16].replace('T', " ");
        let panel = Panel::new(format!("days since {since}"), self.label.clone())
            .title(format!("{} {}", self.command, self.key))
            .band("95 % interval", &shifted)
            .line("", &line)
            .points("", &line);
        match self.limit {
            Some(limit) => panel.limit("limit", limit),
            None => panel,
        }
    }
}

/// The followed values of one record, each with its name, interval and unit.
pub fn values(record: &Record) -> Vec<String> {
    let Some(result) = record.result.as_object() else { return Vec::new() };
    series(std::slice::from_ref(record))
        .iter()
        .filter_map(|s| {
            let value = number(result, &s.key)?;
            let u95 = u95_key(&s.key).and_then(|k| number(result, &k));
            let value = u95.map_or_else(|| format!("{value:.4}"), |u95| text(value, u95));
            let (name, unit) = s.label.split_once(", ").unwrap_or((&s.label, ""));
            Some(format!("{name} {value} {unit}"))
        })
        .collect()
}

/// All series as one figure.
pub fn figure(series: &[Series]) -> Figure {
    series.iter().fold(Figure::new("History").columns(2), |figure, s| figure.panel(s.panel()))
}

/// Weighted mean, its standard uncertainty, and the scatter, which one point does not show.
fn constant(points: &[(f64, f64, f64)]) -> Option<(f64, f64, Scatter)> {
    let weights = weights(points)?;
    let sum: f64 = weights.iter().sum();
    let mean = points.iter().zip(&weights).map(|(p, w)| w * p.1).sum::<f64>() / sum;
    let chi2: f64 = points.iter().zip(&weights).map(|(p, w)| w * (p.1 - mean).powi(2)).sum();
    Some((mean, 1.0 / sum.sqrt(), Scatter::of(chi2, points.len() - 1)))
}

/// Weighted slope, its standard uncertainty, and the scatter. Needs four points that span some time.
fn line(points: &[(f64, f64, f64)]) -> Option<(f64, f64, Scatter)> {
    let weights = weights(points).filter(|w| w.len() >= 4)?;
    let sum: f64 = weights.iter().sum();
    let mean = |f: fn(&(f64, f64, f64)) -> f64| {
        points.iter().zip(&weights).map(|(p, w)| w * f(p)).sum::<f64>() / sum
    };
    let (t, y) = (mean(|p| p.0), mean(|p| p.1));
    let stt: f64 = points.iter().zip(&weights).map(|(p, w)| w * (p.0 - t).powi(2)).sum();
    let sty: f64 = points.iter().zip(&weights).map(|(p, w)| w * (p.0 - t) * (p.1 - y)).sum();
    if stt <= 0.0 {
        return None;
    }
    let slope = sty / stt;
    let chi2: f64 =
        points.iter().zip(&weights).map(|(p, w)| w * (p.1 - y - slope * (p.0 - t)).powi(2)).sum();
    Some((slope, 1.0 / stt.sqrt(), Scatter::of(chi2, points.len() - 2)))
}

/// How values scatter: by what their uncertainties say, or clearly more.
struct Scatter {
    /// By how much more (Birge ratio).
    excess: f64,
    /// Degrees of freedom behind that; infinite where the stated uncertainties hold.
    dof: f64,
}

impl Scatter {
    fn of(chi2: f64, dof: usize) -> Self {
        let dof = dof as f64;
        match dof > 0.0 && ln_chi2_tail(chi2, dof) < SCATTERED.ln() {
            true => Self { excess: (chi2 / dof).sqrt(), dof },
            false => Self { excess: 1.0, dof: f64::INFINITY },
        }
    }
}

/// 1/u² of every point; `None` without any.
fn weights(points: &[(f64, f64, f64)]) -> Option<Vec<f64>> {
    (!points.is_empty()).then(|| points.iter().map(|p| (K95 / p.2).powi(2)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn made(n: usize, value: impl Fn(f64) -> f64, rng: &mut rand_chacha::ChaCha8Rng) -> Series {
        let mut point = |i: usize| {
            let noise: f64 = StandardNormal.sample(&mut *rng);
            (i as f64, value(i as f64) + 0.001 * noise, 0.001 * K95)
        };
        let points = (0..n).map(&mut point).collect();
        Series {
            command: "solve".into(),
            key: "r_mm".into(),
            label: "R, mm".into(),
            limit: None,
            points,
        }
    }

    #[test]
    fn the_plot_is_as_tall_as_the_values_and_their_intervals() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let svg = figure(&[made(12, |_| 214.7, &mut rng)]).to_svg();
        assert!(svg.contains(">214.700<") && !svg.contains(">200<"), "{svg}");
    }

    #[test]
    fn steady_values_raise_no_alarm_and_real_changes_do() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let alarms = |value: &dyn Fn(f64) -> f64, kind: &str, rng: &mut rand_chacha::ChaCha8Rng| {
            (0..300).filter(|_| made(12, value, rng).drift().iter().any(|d| d.kind == kind)).count()
        };
        for kind in ["step", "trend"] {
            assert!(alarms(&|_| 214.7, kind, &mut rng) <= 3);
        }
        assert!(alarms(&|t| 214.7 + if t > 10.5 { 0.006 } else { 0.0 }, "step", &mut rng) >= 290);
        assert!(alarms(&|t| 214.7 + 0.0008 * t, "trend", &mut rng) >= 290);
        // Of two values the intervals alone tell.
        let two = |by: f64| {
            let step = made(2, |t| 214.7 + by * t, &mut rand_chacha::ChaCha8Rng::seed_from_u64(3));
            step.drift().len()
        };
        assert_eq!((two(0.0), two(0.05)), (0, 1));
        // Values that scatter five times as much as they say raise no more, but for few, which tell little of how they scatter.
        let scattered = |n: usize, rng: &mut rand_chacha::ChaCha8Rng| {
            let mut series = made(n, |_| 214.7, rng);
            series.points.iter_mut().for_each(|p| p.2 /= 5.0);
            series
        };
        for (n, most) in [(6, 45), (12, 6), (30, 6)] {
            let mut drifts = |_: &usize| !scattered(n, &mut rng).drift().is_empty();
            let alarms = (0..1000).filter(|i| drifts(i)).count();
            assert!(alarms <= most, "{n}: {alarms} of 1000");
        }
    }
}
