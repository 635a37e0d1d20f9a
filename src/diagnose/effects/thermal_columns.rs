//! Columns that thermal effects follow: rises, rates, places.

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

/// How far each row's screw is from either end of what it goes through: 0 where it is coldest or hottest, 1 midway.
pub fn midway(data: &Columns) -> Vec<f64> {
    of_each_screw(data, |_, screw_c| {
        let (low, high) = range(screw_c);
        let half = (0.5 * (high - low)).max(1e-9);
        screw_c.iter().map(|c| ((c - low) * (high - c)).max(0.0) / (half * half)).collect()
    })
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

/// The sign of rates, soft where they are below half of what is usual: a turn takes its time.
pub fn softly(rates: &[f64]) -> Vec<f64> {
    let usual = (rates.iter().map(|r| r * r).sum::<f64>() / rates.len().max(1) as f64).sqrt();
    rates.iter().map(|rate| (2.0 * rate / usual.max(1e-300)).tanh()).collect()
}

/// How fast each row's screw warms up, °C per second.
pub fn heating(data: &Columns) -> Vec<f64> {
    of_each_screw(data, slopes)
}

/// What is worked out for the rows of each axis from times and temperatures of its screw.
pub fn of_each_screw<T: Copy + Default>(
    data: &Columns,
    work: impl Fn(&[f64], &[f64]) -> Vec<T>,
) -> Vec<T> {
    let mut out = vec![T::default(); data.series.len()];
    for axis in 0..data.series_names.len() {
        let rows = data.rows_of(axis);
        let of = |name: &str| rows.iter().map(|r| data.get(name)[*r]).collect::<Vec<f64>>();
        for (row, value) in rows.iter().zip(work(&of("t_s"), &of("screw_c"))) {
            out[*row] = value;
        }
    }
    out
}

/// What rises from 0 at a time towards 1.
pub fn risen(data: &Columns, from_s: f64, rise_s: f64) -> Column {
    data.get("t_s").iter().map(|t| super::risen((t - from_s).max(0.0), rise_s)).collect()
}

/// The product of two columns.
pub fn times(a: &[f64], b: &[f64]) -> Column {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// Readings in the order of time; those of one time, which have no order, are their mean.
pub struct Readings {
    /// Different times.
    pub times_s: Vec<f64>,
    /// What was read then.
    pub values: Vec<f64>,
    /// Which of them each row has.
    pub of_row: Vec<usize>,
}

impl Readings {
    /// From the rows' times and values.
    pub fn new(times_s: &[f64], values: &[f64]) -> Self {
        let order = super::in_time(times_s);
        let mut new =
            Self { times_s: Vec::new(), values: Vec::new(), of_row: vec![0; times_s.len()] };
        for rows in order.chunk_by(|a, b| times_s[*a] == times_s[*b]) {
            rows.iter().for_each(|row| new.of_row[*row] = new.times_s.len());
            new.times_s.push(times_s[rows[0]]);
            new.values.push(rows.iter().map(|r| values[*r]).sum::<f64>() / rows.len() as f64);
        }
        new
    }

    /// What holds for each reading, row by row.
    pub fn by_row<T: Copy>(&self, of_reading: &[T]) -> Vec<T> {
        self.of_row.iter().map(|i| of_reading[*i]).collect()
    }
}

/// Slope of values in time, from the readings before to those after, a sixtieth of the run away at least: rows taken at
/// one stop have one temperature.
fn slopes(times_s: &[f64], values: &[f64]) -> Vec<f64> {
    let read = Readings::new(times_s, values);
    let t = &read.times_s;
    let (Some(first), Some(last)) = (t.first(), t.last()) else { return Vec::new() };
    let apart = (last - first) / 60.0;
    let slope = |at: &f64| {
        let before = t.partition_point(|t| *t <= at - apart).saturating_sub(1);
        let after = t.partition_point(|t| *t < at + apart).min(t.len() - 1);
        let dt = t[after] - t[before];
        if dt > 0.0 { (read.values[after] - read.values[before]) / dt } else { 0.0 }
    };
    read.by_row(&t.iter().map(slope).collect::<Vec<f64>>())
}
