//! Thermal data without any effect: `error = Σ a_i t_i + slope (T - T₀)(P - P₀)`, its coefficients fitted.

use nalgebra::{DMatrix, DVector, Vector3};

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::thermal::library;
use crate::diagnose::effects::thermal_columns::{Column, metres, times};
use crate::diagnose::effects::thermal_sensors::dead_sensor;
use crate::diagnose::experiment::{Active, Parameter};
use crate::diagnose::outliers::{few, slipped};

/// What the data ask of the baseline beside slope and zero of every axis' screw.
#[derive(Debug, Clone, Copy, Default)]
pub struct Baseline {
    /// Every axis has head coefficients of its own; otherwise all share them.
    own_heads: bool,
    /// Where a screw's slope is zero.
    cold: Cold,
}

/// T₀ of the screws.
#[derive(Debug, Clone, Copy, Default)]
enum Cold {
    /// Each screw's coldest reading.
    #[default]
    Coldest,
    /// The coldest reading of all screws.
    ColdestOfAll,
    /// Each screw's first reading.
    First,
    /// The reference temperature of length, 20 °C.
    Reference,
    /// None of these, and the same for all: found with the other coefficients, as an offset from the coldest reading of all.
    FreeForAll,
    /// The same for each screw by itself, from its own coldest reading.
    Free,
}

impl Cold {
    fn is_free(self) -> bool {
        matches!(self, Self::FreeForAll | Self::Free)
    }
}

/// How much less likely than a named effect it is beforehand that T₀ is none of the usual ones, twice in nats.
const FREE_BEFOREHAND: f64 = 6.0;

/// Most effects beside which a baseline is chosen.
const MOST_EFFECTS: usize = 2;

impl Baseline {
    /// The likeliest by the Bayesian information criterion, with or without any one or two effects, which would else be made up for by
    /// another T₀: coefficients that are not needed, or a T₀ that is free, would hide effects. Slipped readings have no say: one of them could
    /// make any of these the likeliest.
    pub fn of(data: &Columns, error_mm: &[f64]) -> Self {
        let mut kept: Vec<usize> = (0..error_mm.len()).collect();
        loop {
            let y = DVector::from_iterator(kept.len(), kept.iter().map(|i| error_mm[*i]));
            let mut choices = vec![Cold::Coldest, Cold::First, Cold::Reference, Cold::Free];
            if data.series_names.len() > 1 {
                choices.extend([Cold::ColdestOfAll, Cold::FreeForAll]);
            }
            let all = choices.into_iter().flat_map(|cold| of_cold(data, cold, &kept, &y));
            let Some((_, left, best)) = all.min_by(|a, b| a.0.total_cmp(&b.0)) else {
                return Self::default();
            };
            let mut slipped = slipped(&left).into_iter();
            let mut fewer = kept.clone();
            fewer.retain(|_| slipped.next() == Some(false));
            if fewer.len() == kept.len() || !few(error_mm.len() - fewer.len(), error_mm.len()) {
                return best;
            }
            kept = fewer;
        }
    }

    /// The criterion with none of the effects or with those one by one that make it least, and what they leave.
    fn criterion(
        &self,
        mut columns: DMatrix<f64>,
        effects: &[(DMatrix<f64>, usize)],
        data: &Columns,
        kept: &[usize],
        y: &DVector<f64>,
    ) -> (f64, DVector<f64>) {
        let rows = y.len() as f64;
        if self.cold.is_free() {
            columns = self.with_free_t0(data, columns, kept, y);
        }
        let mut basis = orthonormal(&columns.select_rows(kept), 1e-9);
        let mut left = y - &basis * basis.tr_mul(y);
        // Another T₀ than the usual one is a choice like a coefficient more.
        let mut chosen = basis.ncols() + usize::from(!matches!(self.cold, Cold::Coldest));
        let choice = 2.0 * (effects.len().max(1) as f64).ln();
        let free = if self.cold.is_free() { choice + FREE_BEFOREHAND } else { 0.0 };
        let of = |left: &DVector<f64>, coefficients: usize| {
            let least = (1e-12 * y.norm_squared()).max(f64::MIN_POSITIVE);
            rows * left.norm_squared().max(least).ln() + coefficients as f64 * rows.ln() + free
        };
        let mut best = of(&left, chosen);
        for more in 1..=MOST_EFFECTS {
            let with = |(effect, shapes): &(DMatrix<f64>, usize)| {
                let own = orthonormal(&(effect - &basis * basis.tr_mul(effect)), 1e-6);
                let (left, chosen) =
                    (&left - &own * own.tr_mul(&left), chosen + own.ncols() + shapes);
                (of(&left, chosen) + more as f64 * choice, own, left, chosen)
            };
            let next = effects.iter().map(with).min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((value, own, rest, count)) = next.filter(|next| next.0 < best) else { break };
            let columns: Vec<_> = basis.column_iter().chain(own.column_iter()).collect();
            basis = DMatrix::from_columns(&columns);
            (best, left, chosen) = (value, rest, count);
        }
        (best, left)
    }

    /// The baseline's columns (slope and zero of each axis first) with those of T₀: what a degree makes of the errors, with slope
    /// and zero as they are without it.
    fn with_free_t0(
        &self,
        data: &Columns,
        columns: DMatrix<f64>,
        kept: &[usize],
        y: &DVector<f64>,
    ) -> DMatrix<f64> {
        let Ok(found) = columns.select_rows(kept).svd(true, true).solve(y, 1e-9) else {
            return columns;
        };
        let rows = metres(data).into_iter().zip(&data.series);
        let a_degree = rows.map(|(m, axis)| m * found[2 * axis] + found[2 * axis + 1]);
        let a_degree: Column = a_degree.collect();
        let more = match self.cold {
            Cold::FreeForAll => vec![a_degree],
            _ => (0..data.series_names.len()).map(|axis| on(data, axis, &a_degree)).collect(),
        };
        let all = columns.column_iter().map(|c| c.iter().copied().collect()).chain(more);
        let all: Vec<Column> = all.collect();
        DMatrix::from_fn(data.series.len(), all.len(), |r, c| all[c][r])
    }

    /// T₀ of each axis.
    fn t0_c(&self, data: &Columns) -> Vec<f64> {
        match self.cold {
            Cold::Coldest | Cold::Free => data.coldest.clone(),
            Cold::ColdestOfAll | Cold::FreeForAll => {
                let coldest = data.coldest.iter().copied().fold(f64::INFINITY, f64::min);
                vec![coldest; data.coldest.len()]
            }
            Cold::First => data.first_of_axes("screw_c"),
            Cold::Reference => vec![20.0; data.series_names.len()],
        }
    }

    /// Columns of the baseline.
    fn columns(&self, data: &Columns) -> DMatrix<f64> {
        let t0 = self.t0_c(data);
        let screw = data.get("screw_c").iter().zip(&data.series);
        let warm: Column = screw.map(|(c, axis)| c - t0[*axis]).collect();
        let along = times(&warm, &metres(data));
        let axes = 0..data.series_names.len();
        let mut list: Vec<Column> =
            axes.clone().flat_map(|axis| [on(data, axis, &along), on(data, axis, &warm)]).collect();
        if self.own_heads {
            list.extend(axes.flat_map(|axis| data.head_c.iter().map(move |h| on(data, axis, h))));
        } else {
            list.extend(data.head_c.iter().cloned());
        }
        DMatrix::from_fn(data.series.len(), list.len(), |r, c| list[c][r])
    }
}

/// Both baselines with a T₀ on the rows that are kept: criterion, what is left, and which it is.
fn of_cold(
    data: &Columns,
    cold: Cold,
    kept: &[usize],
    y: &DVector<f64>,
) -> [(f64, DVector<f64>, Baseline); 2] {
    let mut data = data.clone();
    data.t0_c = Baseline { own_heads: false, cold }.t0_c(&data);
    let mut effects = single_effects(&data);
    effects.iter_mut().for_each(|(columns, _)| *columns = columns.select_rows(kept));
    [false, true].map(|own_heads| {
        let baseline = Baseline { own_heads, cold };
        let columns = baseline.columns(&data);
        let (criterion, left) = baseline.criterion(columns, &effects, &data, kept, y);
        (criterion, left, baseline)
    })
}

/// A column where a row is of this axis, and zero elsewhere.
fn on(data: &Columns, axis: usize, column: &[f64]) -> Column {
    let rows = column.iter().zip(&data.series);
    rows.map(|(v, s)| if *s == axis { *v } else { 0.0 }).collect()
}

/// Columns of every testable form of the library, and how many numbers of its shape are chosen.
fn single_effects(data: &Columns) -> Vec<(DMatrix<f64>, usize)> {
    let library = library(data);
    let rows = data.series.len();
    let mut list = Vec::new();
    for (effect, info) in library.infos.iter().enumerate().filter(|(_, i)| i.untestable.is_none()) {
        for (form, parameters) in info.forms.iter().enumerate() {
            let linear: Vec<usize> =
                (0..parameters.len()).filter(|i| parameters[*i].grid.is_empty()).collect();
            for values in Parameter::grid_points(parameters) {
                let mut columns = DMatrix::zeros(rows, linear.len());
                for (c, &i) in linear.iter().enumerate() {
                    let mut values = values.clone();
                    values[i] = 1.0;
                    let active = [Active { effect, form, values }];
                    let errors = library.errors(data, rows, &active);
                    errors.iter().enumerate().for_each(|(r, e)| columns[(r, c)] = e.x);
                }
                list.push((columns, parameters.len() - linear.len()));
            }
        }
    }
    list
}

/// Coefficients of the baseline: of the head's sensors, then slope, zero and (where it is free) T₀ of each axis' screw.
fn nuisances(data: &Columns) -> Vec<Parameter> {
    let heads = |axis: &str| {
        (1..=data.head_c.len())
            .map(|k| Parameter::linear(format!("{axis}head_{k}_mm_per_c"), 1e-3))
            .collect::<Vec<_>>()
    };
    let names = &data.series_names;
    let mut list = match data.thermal.own_heads {
        true => names.iter().flat_map(|name| heads(&format!("{name}_"))).collect(),
        false => heads(""),
    };
    for name in names {
        list.push(Parameter::linear(format!("{name}_slope_per_c"), 1e-6));
        list.push(Parameter::linear(format!("{name}_zero_mm_per_c"), 1e-3));
        if matches!(data.thermal.cold, Cold::Free) {
            list.push(Parameter::linear(format!("{name}_t0_above_coldest_c"), 1.0));
        }
    }
    if matches!(data.thermal.cold, Cold::FreeForAll) {
        list.push(Parameter::linear("t0_above_coldest_c", 1.0));
    }
    list
}

/// Baseline plus the effects' error.
pub fn predict(data: &Columns, nuisances: &[f64], row: usize, error: Vector3<f64>) -> [f64; 2] {
    let own_heads = data.thermal.own_heads;
    let (sensors, axis) = (data.head_c.len(), data.series[row]);
    let sets = if own_heads { data.series_names.len() } else { 1 };
    let heads = &nuisances[if own_heads { sensors * axis } else { 0 }..];
    let head: f64 = data.head_c.iter().zip(heads).map(|(c, a)| c[row] * a).sum();
    let coefficients = if matches!(data.thermal.cold, Cold::Free) { 3 } else { 2 };
    let own = &nuisances[sensors * sets + coefficients * axis..];
    let above_c = match data.thermal.cold {
        Cold::Free => own[2],
        Cold::FreeForAll => nuisances[nuisances.len() - 1],
        _ => 0.0,
    };
    let warm = data.get("screw_c")[row] - data.t0_c[axis] - above_c;
    let screw = warm * (own[0] * data.get("position_mm")[row] + own[1]);
    [head + screw + error.x, 0.0]
}

/// Completes the columns (coldest readings, what the data ask of the baseline) and gives the coefficients.
pub fn prepare(data: &mut Columns, error_mm: &[f64], warnings: &mut Vec<String>) -> Vec<Parameter> {
    warnings.extend(dead_sensor_warning(data));
    data.coldest = data.coldest_of_axes();
    if error_mm.len() == data.series.len() {
        data.thermal = Baseline::of(data, error_mm);
    }
    data.t0_c = data.thermal.t0_c(data);
    nuisances(data)
}

/// What a user should know of a sensor that has stopped.
fn dead_sensor_warning(data: &Columns) -> Option<String> {
    let number = dead_sensor(data)? + 1;
    Some(format!("head_{number}_c no longer changes while the run goes on: is the sensor dead?"))
}
