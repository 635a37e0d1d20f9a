//! Columns that thermal effects follow: rises, rates, lags, and what a dead sensor misses.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::data::columns::Columns;
use crate::fit::robust::range;

/// One value a row.
pub type Column = Vec<f64>;

impl Columns {
    /// Coldest readings of the axes' screws.
    pub fn coldest_of_axes(&self) -> Vec<f64> {
        let coldest = |axis| self.of_series("screw_c", axis).fold(f64::INFINITY, f64::min);
        (0..self.series_names.len()).map(coldest).collect()
    }

    /// A column's values on one axis.
    fn of_series(&self, name: &str, axis: usize) -> impl Iterator<Item = f64> {
        let own = self.series.iter().zip(self.get(name)).filter(move |(s, _)| **s == axis);
        own.map(|(_, v)| *v)
    }

    /// First values of a column on the axes.
    pub fn first_of_axes(&self, name: &str) -> Vec<f64> {
        let t = self.get("t_s");
        let own = |axis| (0..t.len()).filter(move |r| self.series[*r] == axis);
        let first = |axis| own(axis).min_by(|a, b| t[*a].total_cmp(&t[*b]));
        let axes = 0..self.series_names.len();
        axes.map(|axis| first(axis).map_or(0.0, |row| self.get(name)[row])).collect()
    }

    /// The value of a column at the first time.
    pub fn first(&self, name: &str) -> f64 {
        let t = self.get("t_s");
        let first = (0..t.len()).min_by(|a, b| t[*a].total_cmp(&t[*b])).unwrap_or(0);
        self.get(name).get(first).copied().unwrap_or(0.0)
    }

    /// Smoothed rate of change of a column in time, per second.
    pub fn rates(&self, values: &[f64]) -> Vec<f64> {
        slopes(self.get("t_s"), values)
    }
}

/// Rise of each row's screw above its coldest reading of the run.
pub fn rises(data: &Columns) -> Vec<f64> {
    let screw = data.get("screw_c").iter().zip(&data.series);
    screw.map(|(c, axis)| c - data.coldest[*axis]).collect()
}

/// Rise of each row's screw above the temperature at which its slope is zero.
pub fn above_zero(data: &Columns) -> Vec<f64> {
    let screw = data.get("screw_c").iter().zip(&data.series);
    screw.map(|(c, axis)| c - data.t0_c[*axis]).collect()
}

/// Position of each row in metres.
pub fn metres(data: &Columns) -> Vec<f64> {
    data.get("position_mm").iter().map(|p| p / 1000.0).collect()
}

/// The same from a place in the axis' travel: -1 is its low end, 0 its middle, 1 its high end.
pub fn metres_from(data: &Columns, place: f64) -> Vec<f64> {
    let origin = |axis| {
        let (low, high) = range(&data.of_series("position_mm", axis).collect::<Vec<f64>>());
        0.5 * (low + high) + 0.5 * place * (high - low)
    };
    let origins: Vec<f64> = (0..data.series_names.len()).map(origin).collect();
    let places = data.get("position_mm").iter().zip(&data.series);
    places.map(|(p, axis)| (p - origins[*axis]) / 1000.0).collect()
}

/// The room's temperature above a reference.
pub fn ambient_from(data: &Columns, reference_c: f64) -> Vec<f64> {
    data.get("ambient_c").iter().map(|c| c - reference_c).collect()
}

/// Middle of the range.
pub fn middle(values: &[f64]) -> f64 {
    let (low, high) = range(values);
    0.5 * (low + high)
}

/// Whether each row's screw last went up (1) or down (-1).
pub fn went(data: &Columns) -> Vec<f64> {
    let mut out = vec![0.0; data.series.len()];
    let t = data.get("t_s");
    for axis in 0..data.series_names.len() {
        let mut rows = data.rows_of(axis);
        rows.sort_by(|a, b| t[*a].total_cmp(&t[*b]));
        let screw: Vec<f64> = rows.iter().map(|r| data.get("screw_c")[*r]).collect();
        let changes = screw.windows(2).map(|pair| pair[1] - pair[0]);
        let first = changes.clone().find(|c| *c != 0.0).unwrap_or(0.0);
        let mut way = first.signum();
        out[rows[0]] = way;
        for (row, change) in rows[1..].iter().zip(changes) {
            way = if change == 0.0 { way } else { change.signum() };
            out[*row] = way;
        }
    }
    out
}

/// The sign of rates, soft where they are below half of what is usual: a turn takes its time.
pub fn softly(rates: &[f64]) -> Vec<f64> {
    let usual = (rates.iter().map(|r| r * r).sum::<f64>() / rates.len().max(1) as f64).sqrt();
    rates.iter().map(|rate| (2.0 * rate / usual.max(1e-300)).tanh()).collect()
}

/// Whether each row's screw warms up (1) or cools down (-1): as the readings about it show, or where those are too few or too much alike,
/// as it comes from those before or goes to those after, whichever are much nearer; else from the ones to the others.
pub fn goes(data: &Columns) -> Vec<f64> {
    let mut out: Vec<f64> = heating(data).iter().map(|rate| rate.signum()).collect();
    for axis in 0..data.series_names.len() {
        let rows = data.rows_of(axis);
        let of = |name: &str| rows.iter().map(|r| data.get(name)[*r]).collect::<Vec<f64>>();
        for (row, way) in rows.iter().zip(ways(&of("t_s"), &of("screw_c"))) {
            out[*row] = way.unwrap_or(out[*row]);
        }
    }
    out
}

/// How fast each row's screw warms up, °C per second.
pub fn heating(data: &Columns) -> Vec<f64> {
    let mut out = vec![0.0; data.series.len()];
    for axis in 0..data.series_names.len() {
        let rows = data.rows_of(axis);
        let of = |name: &str| rows.iter().map(|r| data.get(name)[*r]).collect::<Vec<f64>>();
        for (row, slope) in rows.iter().zip(slopes(&of("t_s"), &of("screw_c"))) {
            out[*row] = slope;
        }
    }
    out
}

/// The sensor whose reading stops changing first, for at least a tenth of the run, while others or the screw go on. One that never changed
/// at all has not stopped, nor has one that has come to rest where it began.
pub fn dead_sensor(data: &Columns) -> Option<usize> {
    let rows = data.series.len();
    let stuck = |sensor: usize| gone(data, sensor).iter().filter(|g| **g > 0.0).count();
    (0..data.head_c.len())
        .map(|sensor| (stuck(sensor), sensor))
        .filter(|(stuck, _)| *stuck > (rows / 10).max(5) && *stuck < rows)
        .filter(|(_, sensor)| !rests(data, *sensor) && others_go_on(data, *sensor))
        .max_by_key(|(stuck, sensor)| (*stuck, std::cmp::Reverse(*sensor)))
        .map(|(_, sensor)| sensor)
}

/// Whether a reading that no longer changes has come, step by step, to where it was at first.
fn rests(data: &Columns, sensor: usize) -> bool {
    /// Parts of its range that count as the same place, and as a step.
    const SAME: f64 = 0.02;
    const STEP: f64 = 0.2;
    let readings: Vec<f64> = in_time(data).into_iter().map(|r| data.head_c[sensor][r]).collect();
    let (low, high) = range(&readings);
    let (Some(first), Some(last)) = (readings.first(), readings.last()) else { return false };
    let before = readings.iter().rfind(|v| *v != last).unwrap_or(last);
    (last - first).abs() < SAME * (high - low) && (last - before).abs() < STEP * (high - low)
}

/// Whether another sensor or the screw still changes while a sensor's reading no longer does.
fn others_go_on(data: &Columns, sensor: usize) -> bool {
    /// By this part of its range.
    const GOES_ON: f64 = 0.1;
    let gone = gone(data, sensor);
    let goes_on = |column: &[f64]| {
        let later = column.iter().zip(&gone).filter(|(_, g)| **g > 0.0).map(|(v, _)| *v);
        let (all, later) = (range(column), range(&later.collect::<Vec<f64>>()));
        later.1 - later.0 > GOES_ON * (all.1 - all.0)
    };
    let others = (0..data.head_c.len()).filter(|o| *o != sensor).map(|o| &data.head_c[o][..]);
    others.chain([data.get("screw_c")]).any(goes_on)
}

/// Rows in the order of time.
fn in_time(data: &Columns) -> Vec<usize> {
    let t = data.get("t_s");
    let mut order: Vec<usize> = (0..t.len()).collect();
    order.sort_by(|a, b| t[*a].total_cmp(&t[*b]));
    order
}

/// 1 from when on a sensor's reading no longer changes, 0 before.
pub fn gone(data: &Columns, sensor: usize) -> Vec<f64> {
    let (order, column) = (in_time(data), &data.head_c[sensor]);
    let last = order.last().map_or(0.0, |row| column[*row]);
    let changes = order.iter().rposition(|row| column[*row] != last);
    let mut out = vec![0.0; column.len()];
    order[changes.map_or(0, |i| i + 1)..].iter().for_each(|row| out[*row] = 1.0);
    out
}

/// What a sensor that has stopped misses, as the others and their past tell: how it followed them before says how it would have
/// gone on. `None` where there is no other, or too little of its own.
pub fn missed(data: &Columns, sensor: usize) -> Option<Column> {
    /// Parts of the run by which it may come after the others.
    const LATER: [f64; 3] = [0.02, 0.08, 0.2];
    /// What the others do not tell of it apart is shared.
    const RIDGE: f64 = 1e-4;
    let (t, column, gone) = (data.get("t_s"), &data.head_c[sensor], gone(data, sensor));
    let (start, end) = data.times_s();
    let mut told: Vec<Column> = vec![vec![1.0; column.len()]];
    for other in (0..data.head_c.len()).filter(|o| *o != sensor) {
        let read = &data.head_c[other];
        told.push(read.clone());
        told.extend(LATER.map(|part| super::lagged(t, read, part * (end - start))));
    }
    let alive: Vec<usize> = (0..column.len()).filter(|row| gone[*row] == 0.0).collect();
    if told.len() < 2 || alive.len() < 3 * told.len() {
        return None;
    }
    let sizes: Vec<f64> =
        told.iter().map(|c| alive.iter().map(|r| c[*r] * c[*r]).sum::<f64>().sqrt()).collect();
    let design =
        DMatrix::from_fn(alive.len(), told.len(), |i, c| told[c][alive[i]] / sizes[c].max(1e-12));
    let read = DVector::from_fn(alive.len(), |i, _| column[alive[i]]);
    let mut normal = design.tr_mul(&design);
    (0..told.len()).for_each(|i| normal[(i, i)] += RIDGE);
    let share = normal.cholesky()?.solve(&design.tr_mul(&read));
    let would = |row: usize| -> f64 {
        (0..told.len()).map(|c| share[c] * told[c][row] / sizes[c].max(1e-12)).sum()
    };
    Some((0..column.len()).map(|row| gone[row] * (would(row) - column[row])).collect())
}

/// Time of the first row of those that are 1.
pub fn first_gone_s(data: &Columns, gone: &[f64]) -> f64 {
    let since = data.get("t_s").iter().zip(gone).filter(|(_, g)| **g > 0.0);
    since.map(|(t, _)| *t).fold(f64::INFINITY, f64::min)
}

/// What rises from 0 at a time towards 1.
pub fn risen(data: &Columns, from_s: f64, rise_s: f64) -> Column {
    data.get("t_s").iter().map(|t| super::risen((t - from_s).max(0.0), rise_s)).collect()
}

/// `count` hat functions of time between a sensor's last change and the end.
pub fn hats(data: &Columns, sensor: usize, count: usize) -> Vec<Vec<f64>> {
    let t = data.get("t_s");
    let gone = gone(data, sensor);
    let from = first_gone_s(data, &gone);
    let step = (data.times_s().1 - from).max(1e-9) / (count - 1) as f64;
    let at = |t: f64, i: usize| (1.0 - ((t - from) / step - i as f64).abs()).max(0.0);
    let hat = |i| t.iter().zip(&gone).map(|(t, gone)| gone * at(*t, i)).collect();
    (0..count).map(hat).collect()
}

/// The product of two columns.
pub fn times(a: &[f64], b: &[f64]) -> Column {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// The way each of some values goes (1 or -1); `None` where neither the readings about it tell, less than a sixtieth of the run away,
/// nor those next before or after, one of which is much nearer.
fn ways(times_s: &[f64], values: &[f64]) -> Vec<Option<f64>> {
    /// Times as far away as the nearer ones.
    const MUCH: f64 = 2.0;
    let (first, last) = range(times_s);
    let apart = (last - first) / 60.0;
    let mut sorted: Vec<f64> = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let steps = sorted.windows(2).map(|w| w[1] - w[0]).filter(|step| *step > 1e-9);
    let rounded_sd = steps.fold(f64::INFINITY, f64::min) / 12.0f64.sqrt();
    let from_sides = |i: usize| {
        let far = |side: f64| {
            let away = (0..times_s.len()).map(|k| (side * (times_s[k] - times_s[i]), values[k]));
            away.filter(|(dt, _)| *dt >= apart).min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let (before, after) = (far(-1.0), far(1.0));
        let gap = |side: Option<(f64, f64)>| side.map_or(f64::INFINITY, |(dt, _)| dt);
        let change = if MUCH * gap(before) < gap(after) {
            values[i] - before?.1
        } else if MUCH * gap(after) < gap(before) {
            after?.1 - values[i]
        } else {
            return None;
        };
        (change != 0.0).then_some(change.signum())
    };
    (0..times_s.len())
        .map(|i| {
            let near = (0..times_s.len()).filter(|k| (times_s[*k] - times_s[i]).abs() < apart);
            let near: Vec<[f64; 2]> = near.map(|k| [times_s[k], values[k]]).collect();
            way_along(&near, rounded_sd).or_else(|| from_sides(i))
        })
        .collect()
}

/// The sign of the slope of a line through points, where it is clear; `least_sd` is how well values are known at best.
fn way_along(points: &[[f64; 2]], least_sd: f64) -> Option<f64> {
    /// Points that make a line at least, and standard errors that its slope must have.
    const FEWEST: usize = 4;
    const CLEAR: f64 = 3.0;
    if points.len() < FEWEST {
        return None;
    }
    let n = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|p| p[axis]).sum::<f64>() / n;
    let middle = [mean(0), mean(1)];
    let product = |a: usize, b: usize| -> f64 {
        points.iter().map(|p| (p[a] - middle[a]) * (p[b] - middle[b])).sum()
    };
    let (tt, tv) = (product(0, 0), product(0, 1));
    let left = (product(1, 1) - tv * tv / tt).max(0.0) / (n - 2.0);
    let clear = tv.abs() > CLEAR * left.sqrt().max(least_sd) * tt.sqrt();
    clear.then_some(tv.signum())
}

/// Slope of values in time, from the readings before to those after, a sixtieth of the run away at least: rows taken at
/// one stop have one temperature.
fn slopes(times_s: &[f64], values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..times_s.len()).collect();
    order.sort_by(|a, b| times_s[*a].total_cmp(&times_s[*b]));
    let sorted: Vec<f64> = order.iter().map(|i| times_s[*i]).collect();
    let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else { return Vec::new() };
    let apart = (last - first) / 60.0;
    let mut out = vec![0.0; values.len()];
    for &i in &order {
        let before = sorted.partition_point(|t| *t <= times_s[i] - apart).saturating_sub(1);
        let after = sorted.partition_point(|t| *t < times_s[i] + apart).min(sorted.len() - 1);
        let dt = sorted[after] - sorted[before];
        let change = values[order[after]] - values[order[before]];
        out[i] = if dt > 0.0 { change / dt } else { 0.0 };
    }
    out
}
