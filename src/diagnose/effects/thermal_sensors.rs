//! Head sensors that stop: which one, since when, and what it misses.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::thermal::{L, form, one};
use crate::diagnose::effects::thermal_columns::{Column, risen, times};
use crate::diagnose::effects::{Words, in_time, lagged, words};
use crate::fit::robust::range;

/// Adds what a head sensor that stands still leaves out.
pub fn dead(l: &mut L, data: &Columns, axes: &[String], lags: &[f64]) {
    /// A sensor seen to stop is likelier to be what is missing than anything not seen, nats.
    const DEAD_BEFOREHAND: f64 = 5.0;
    let stopped = dead_sensor(data);
    let still = stopped.or_else(|| still_sensor(data));
    let alive = still.is_none().then(|| "no head sensor is seen to stop".into());
    let dead = words(
        "sensor-dead",
        "a head sensor stands still: its share of the growth is missing",
        "as the other sensors and time, from the moment on",
        "look at the sensor's column: it no longer changes",
    );
    l.effect(Words { varies_with: &["t_s"], ..dead }, alive);
    if stopped.is_some() {
        l.beforehand(DEAD_BEFOREHAND);
    }
    let Some(k) = still else { return };
    // It would have gone on to another level.
    form(l, axes, &[one("mm", 0.01)], Some(("rise_s", lags)), move |data, rise_s| {
        let gone = gone(data, k);
        vec![times(&gone, &risen(data, first_gone_s(data, &gone), rise_s))]
    });
    for other in (0..data.head_c.len()).filter(|o| *o != k) {
        as_another(l, axes, lags, [k, other], stopped.is_some());
    }
    if stopped.is_some() {
        since_it_stopped(l, data, axes, k);
    }
}

/// The sensor would have followed another that the same heat warms, late: what it misses of that at once is the other's own, unless
/// it once read. Where it then stopped at a reading that was none, it misses as much from then on.
fn as_another(l: &mut L, axes: &[String], lags: &[f64], [k, other]: [usize; 2], stopped: bool) {
    let named = |how: &str| one(format!("{how}_{}_mm_per_c", other + 1), 1e-3);
    let amounts = [named("late"), named("at_once"), one("level_mm", 0.01)];
    for count in if stopped { 2..=3 } else { 1..=1 } {
        form(l, axes, &amounts[..count], Some(("lag_s", lags)), move |data, lag_s| {
            let (gone, read) = (gone(data, k), &data.head_c[other]);
            let late = lagged(data.get("t_s"), read, lag_s.abs().max(1e-3));
            [since(data, &gone, &late), since(data, &gone, read), gone][..count].to_vec()
        });
    }
}

/// How a column has changed since the first of those rows that are 1; zero before.
fn since(data: &Columns, gone: &[f64], column: &[f64]) -> Column {
    let from = first_gone(data, gone).map_or(0.0, |row| column[row]);
    column.iter().zip(gone).map(|(c, gone)| gone * (c - from)).collect()
}

/// What a sensor misses from when on it no longer changes.
fn since_it_stopped(l: &mut L, data: &Columns, axes: &[String], k: usize) {
    /// Places in time between which what it should have read goes straight.
    const KNOTS: [usize; 3] = [6, 10, 20];
    form(l, axes, &[one("offset_mm", 0.01)], None, move |data, _| vec![gone(data, k)]);
    if missed(data, k).is_some() {
        form(l, axes, &[one("missed_mm_per_c", 1e-3)], None, move |data, _| {
            vec![missed(data, k).unwrap_or_default()]
        });
    }
    // It would have followed the others, or gone its own way.
    for other in (0..data.head_c.len()).filter(|o| *o != k) {
        let name = format!("follows_{}_mm_per_c", other + 1);
        form(l, axes, &[one(name, 1e-3)], None, move |data, _| {
            let apart = data.head_c[other].iter().zip(&data.head_c[k]).map(|(a, b)| a - b);
            vec![times(&gone(data, k), &apart.collect::<Column>())]
        });
    }
    for count in KNOTS {
        let knots: Vec<_> =
            (1..=count).map(|i| one(format!("knot_{i}_of_{count}_mm"), 0.01)).collect();
        form(l, axes, &knots, None, move |data, _| hats(data, k, count));
    }
}

/// A sensor that never changes while another goes by degrees: it may never have read anything, or nothing may be connected to it.
fn still_sensor(data: &Columns) -> Option<usize> {
    const GOES_C: f64 = 2.0;
    let change = |read: &Column| {
        let (low, high) = range(read);
        high - low
    };
    let goes = data.head_c.iter().any(|read| change(read) > GOES_C);
    data.head_c.iter().position(|read| change(read) == 0.0).filter(|_| goes)
}

/// The sensor whose reading stops changing first, for at least a tenth of the rows, while others or the screw go on or in the midst of a
/// change. One that never changed at all has not stopped, nor has one that has come to rest where it began.
pub fn dead_sensor(data: &Columns) -> Option<usize> {
    let rows = data.series.len();
    let stopped = |sensor: usize| {
        let gone = gone(data, sensor);
        let stuck = gone.iter().filter(|g| **g > 0.0).count();
        let is_dead = stuck > (rows / 10).max(5)
            && stuck < rows
            && !rests(data, sensor)
            && (others_go_on(data, sensor, &gone) || stops_short(data, sensor, &gone));
        is_dead.then_some((stuck, std::cmp::Reverse(sensor)))
    };
    (0..data.head_c.len()).filter_map(stopped).max().map(|(_, sensor)| sensor.0)
}

/// Whether a reading that no longer changes has come, step by step, to where it was at first.
fn rests(data: &Columns, sensor: usize) -> bool {
    /// Parts of its range that count as the same place, and as a step.
    const SAME: f64 = 0.02;
    const STEP: f64 = 0.2;
    let order = in_time(data.get("t_s"));
    let readings: Vec<f64> = order.into_iter().map(|r| data.head_c[sensor][r]).collect();
    let (low, high) = range(&readings);
    let (Some(first), Some(last)) = (readings.first(), readings.last()) else { return false };
    let before = readings.iter().rfind(|v| *v != last).unwrap_or(last);
    (last - first).abs() < SAME * (high - low) && (last - before).abs() < STEP * (high - low)
}

/// Whether another sensor or the screw still changes while a sensor's reading no longer does.
fn others_go_on(data: &Columns, sensor: usize, gone: &[f64]) -> bool {
    /// By this part of its range and so many degrees: readings flicker.
    const GOES_ON: f64 = 0.1;
    const LEAST_C: f64 = 0.2;
    let goes_on = |column: &[f64]| {
        let later = column.iter().zip(gone).filter(|(_, g)| **g > 0.0).map(|(v, _)| *v);
        let (all, later) = (range(column), range(&later.collect::<Vec<f64>>()));
        later.1 - later.0 > (GOES_ON * (all.1 - all.0)).max(LEAST_C)
    };
    let others = (0..data.head_c.len()).filter(|o| *o != sensor).map(|o| &data.head_c[o][..]);
    others.chain([data.get("screw_c")]).any(goes_on)
}

/// Whether a reading stops in the midst of a change: one that settles changes ever less.
fn stops_short(data: &Columns, sensor: usize, gone: &[f64]) -> bool {
    /// Part of the run before it stops, and of its range that it then changes by.
    const BEFORE: f64 = 0.05;
    const CHANGES: f64 = 0.05;
    let (t, column) = (data.get("t_s"), &data.head_c[sensor]);
    let (start, end) = data.times_s();
    let stop = first_gone_s(data, gone);
    let at = |from: f64| (0..t.len()).filter(move |r| t[*r] >= from && t[*r] <= stop);
    let late: Vec<f64> = at(stop - BEFORE * (end - start)).map(|r| column[r]).collect();
    let ((low, high), (least, most)) = (range(&late), range(column));
    high - low > CHANGES * (most - least)
}

/// 1 from when on a sensor's reading no longer changes, 0 before.
fn gone(data: &Columns, sensor: usize) -> Vec<f64> {
    let (order, column) = (in_time(data.get("t_s")), &data.head_c[sensor]);
    let last = order.last().map_or(0.0, |row| column[*row]);
    let changes = order.iter().rposition(|row| column[*row] != last);
    let mut out = vec![0.0; column.len()];
    order[changes.map_or(0, |i| i + 1)..].iter().for_each(|row| out[*row] = 1.0);
    out
}

/// What a sensor that has stopped misses, as the others and their past tell: how it followed them before says how it would have
/// gone on. `None` where there is no other, or too little of its own.
fn missed(data: &Columns, sensor: usize) -> Option<Column> {
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
        told.extend(LATER.map(|part| lagged(t, read, part * (end - start))));
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

/// The first row, in time, of those that are 1.
fn first_gone(data: &Columns, gone: &[f64]) -> Option<usize> {
    let t = data.get("t_s");
    (0..gone.len()).filter(|row| gone[*row] > 0.0).min_by(|a, b| t[*a].total_cmp(&t[*b]))
}

/// Its time.
fn first_gone_s(data: &Columns, gone: &[f64]) -> f64 {
    first_gone(data, gone).map_or(f64::INFINITY, |row| data.get("t_s")[row])
}

/// `count` hat functions of time between a sensor's last change and the end.
fn hats(data: &Columns, sensor: usize, count: usize) -> Vec<Vec<f64>> {
    let t = data.get("t_s");
    let gone = gone(data, sensor);
    let from = first_gone_s(data, &gone);
    let step = (data.times_s().1 - from).max(1e-9) / (count - 1) as f64;
    let at = |t: f64, i: usize| (1.0 - ((t - from) / step - i as f64).abs()).max(0.0);
    let hat = |i| t.iter().zip(&gone).map(|(t, gone)| gone * at(*t, i)).collect();
    (0..count).map(hat).collect()
}
