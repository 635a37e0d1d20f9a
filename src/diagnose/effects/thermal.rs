//! Effects in thermal data, beyond the model `error = Σ a_i t_i + slope (T - T₀)(P - P₀)` with its coefficients fitted.

use nalgebra::Vector3;

use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::{Library, Words, lagged};
use crate::diagnose::experiment::Parameter;
use crate::diagnose::generic::range;

type L = Library<Columns, Vector3<f64>>;

/// Baseline plus the effects' error: head coefficients, then slope and zero of each axis' screw.
pub fn predict(data: &Columns, nuisances: &[f64], row: usize, error: Vector3<f64>) -> [f64; 2] {
    let sensors = data.head_c.len();
    let head: f64 = data.head_c.iter().zip(nuisances).map(|(c, a)| c[row] * a).sum();
    let axis = &nuisances[sensors + 2 * data.series[row]..];
    let warm = rise(data, row);
    [head + warm * (axis[0] * data.get("position_mm")[row] + axis[1]) + error.x, 0.0]
}

/// Rise of the screw above its coldest reading of the run.
fn rise(data: &Columns, row: usize) -> f64 {
    let screw = data.get("screw_c");
    screw[row] - range(screw).0
}

/// Adds one parameter times a function of the row.
fn term(
    l: &mut L,
    name: impl Into<std::borrow::Cow<'static, str>>,
    typical: f64,
    f: impl Fn(&Columns, usize) -> f64 + Send + Sync + 'static,
) {
    l.form(vec![Parameter::linear(name, typical)], move |data, p, errors| {
        errors.iter_mut().enumerate().for_each(|(row, e)| e.x += p[0] * f(data, row));
    });
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Columns) -> L {
    let mut l = L::default();
    let words =
        |name, meaning, evidence, best| Words { name, meaning, evidence, best, varies_with: &[] };
    let no_head = || data.head_c.is_empty().then(|| "there is no head sensor column".to_owned());
    let cycle = "a full cycle of warming up and cooling down";
    let (start, end) = data.times_s();
    let span = end - start;
    let lags: Vec<f64> = [0.02, 0.06, 0.15, 0.4].iter().map(|f| f * span).collect();
    let sensors = data.head_c.len();
    l.effect(
        words(
            "head-lag",
            "the head follows its sensors late",
            "after quick changes of the head's temperature",
            cycle,
        ),
        no_head(),
    );
    for k in 0..sensors {
        l.form(
            vec![
                Parameter::linear(format!("head_{}_mm_per_c", k + 1), 1e-3),
                Parameter::shape("lag_s", &lags),
            ],
            move |data, p, errors| {
                let warm = lagged(data.get("t_s"), &data.head_c[k], p[1].abs().max(1e-3));
                // Only the lag: what the sensor itself explains stays in the baseline.
                errors
                    .iter_mut()
                    .enumerate()
                    .for_each(|(row, e)| e.x += p[0] * (warm[row] - data.head_c[k][row]));
            },
        );
    }
    if sensors > 1 {
        let mut all: Vec<Parameter> =
            (1..=sensors).map(|k| Parameter::linear(format!("head_{k}_mm_per_c"), 1e-3)).collect();
        all.push(Parameter::shape("lag_s", &lags));
        l.form(all, move |data, p, errors| {
            for k in 0..sensors {
                let warm = lagged(data.get("t_s"), &data.head_c[k], p[sensors].abs().max(1e-3));
                errors
                    .iter_mut()
                    .enumerate()
                    .for_each(|(row, e)| e.x += p[k] * (warm[row] - data.head_c[k][row]));
            }
        });
    }
    l.effect(
        words(
            "head-constant",
            "the error is not zero in the cold state",
            "mean of all errors",
            "readings in the cold state",
        ),
        None,
    );
    term(&mut l, "offset_mm", 0.01, |_, _| 1.0);
    l.effect(
        words(
            "head-nonlinear",
            "the head's growth against its sensors is curved",
            "at the highest head temperatures",
            cycle,
        ),
        no_head(),
    );
    for k in 0..sensors {
        term(&mut l, format!("head_{}_um_per_c2", k + 1), 0.1, move |data, row| {
            1e-3 * data.head_c[k][row].powi(2)
        });
    }
    let screw = data.needs(&["screw_c"]);
    l.effect(
        words(
            "screw-nonlinear",
            "the slope of the error over position against screw temperature is curved",
            "at the highest screw temperatures and far positions",
            "the axis over its whole travel at three or more temperatures",
        ),
        screw.clone(),
    );
    term(&mut l, "per_c2", 1e-7, |data, row| {
        rise(data, row).powi(2) * data.get("position_mm")[row]
    });
    term(&mut l, "centred_per_c2", 1e-7, |data, row| {
        rise(data, row).powi(2) * (data.get("position_mm")[row] - middle(data.get("position_mm")))
    });
    l.effect(
        words(
            "position-quadratic",
            "the error is curved over position",
            "middle against both ends of the travel",
            "the axis over its whole travel in even steps",
        ),
        data.needs(&["position_mm"]),
    );
    let centred = |data: &Columns, row: usize| {
        let p = data.get("position_mm");
        (p[row] - middle(p)) / 1000.0
    };
    term(&mut l, "mm_per_m2", 0.01, |data, row| (data.get("position_mm")[row] / 1000.0).powi(2));
    term(&mut l, "centred_mm_per_m2", 0.01, move |data, row| centred(data, row).powi(2));
    term(&mut l, "warm_mm_per_m2_c", 0.01, |data, row| {
        rise(data, row) * (data.get("position_mm")[row] / 1000.0).powi(2)
    });
    l.effect(
        words(
            "heating-hysteresis",
            "warming up and cooling down differ at the same temperature",
            "the two branches of a cycle",
            cycle,
        ),
        screw,
    );
    let sign = |data: &Columns| {
        slopes(data.get("t_s"), data.get("screw_c"))
            .iter()
            .map(|s| s.signum())
            .collect::<Vec<f64>>()
    };
    l.form(vec![Parameter::linear("half_width_mm", 0.01)], move |data, p, errors| {
        errors.iter_mut().zip(sign(data)).for_each(|(e, s)| e.x += p[0] * s);
    });
    l.form(vec![Parameter::linear("half_width_per_m", 0.01)], move |data, p, errors| {
        let place = data.get("position_mm");
        errors
            .iter_mut()
            .zip(sign(data))
            .enumerate()
            .for_each(|(r, (e, s))| e.x += p[0] * s * place[r] / 1000.0);
    });
    l.form(vec![Parameter::linear("rate_mm_h_per_c", 0.01)], |data, p, errors| {
        let rate = slopes(data.get("t_s"), data.get("screw_c"));
        errors.iter_mut().zip(rate).for_each(|(e, r)| e.x += p[0] * r * 3600.0 / 1000.0);
    });
    if sensors > 0 {
        l.form(vec![Parameter::linear("head_half_width_mm", 0.01)], |data, p, errors| {
            let rate = slopes(data.get("t_s"), &data.head_c[0]);
            errors.iter_mut().zip(rate).for_each(|(e, r)| e.x += p[0] * r.signum());
        });
    }
    l.effect(
        words(
            "ambient",
            "the room's temperature moves the machine",
            "error against ambient_c",
            "a day and a night",
        ),
        data.needs(&["ambient_c"]),
    );
    term(&mut l, "mm_per_c", 1e-3, |data, row| data.get("ambient_c")[row] - 20.0);
    term(&mut l, "centred_mm_per_c", 1e-3, |data, row| {
        data.get("ambient_c")[row] - middle(data.get("ambient_c"))
    });
    l.effect(
        words(
            "drift-time",
            "the error grows as time goes by",
            "error against time",
            "the cold state again at the end",
        ),
        data.needs(&["t_s"]),
    );
    term(&mut l, "mm_per_h", 0.01, move |data, row| (data.get("t_s")[row] - start) / 3600.0);
    l.form(
        vec![Parameter::linear("mm", 0.01), Parameter::shape("rise_s", &lags)],
        move |data, p, errors| {
            let rise = p[1].abs().max(1e-3);
            errors
                .iter_mut()
                .zip(data.get("t_s"))
                .for_each(|(e, t)| e.x += p[0] * (1.0 - (-(t - start) / rise).exp()));
        },
    );
    l.effect(
        words(
            "sensor-dead",
            "a head sensor has stopped: its share of the growth is missing",
            "as the other sensors and time, from the moment on",
            "look at the sensor's column: it no longer changes",
        ),
        dead_sensor(data).is_none().then(|| "every head sensor keeps changing".to_owned()),
    );
    if let Some(k) = dead_sensor(data) {
        // The dead sensor would have followed the others.
        for other in (0..sensors).filter(|o| *o != k) {
            term(&mut l, format!("follows_{}_mm_per_c", other + 1), 1e-3, move |data, row| {
                if row >= stuck_from(&data.head_c[k]) {
                    data.head_c[other][row] - data.head_c[k][row]
                } else {
                    0.0
                }
            });
        }
        term(&mut l, "offset_mm", 0.01, move |data, row| {
            f64::from(u8::from(row >= stuck_from(&data.head_c[k])))
        });
    }
    l
}

fn middle(values: &[f64]) -> f64 {
    let (low, high) = range(values);
    0.5 * (low + high)
}

/// The first sensor whose reading stops changing for at least a tenth of the run.
fn dead_sensor(data: &Columns) -> Option<usize> {
    data.head_c.iter().position(|c| {
        let from = stuck_from(c);
        c.len() - from > (c.len() / 10).max(5)
    })
}

/// The row from which a column no longer changes.
fn stuck_from(column: &[f64]) -> usize {
    let last = column.last().copied().unwrap_or(0.0);
    column.iter().rposition(|v| *v != last).map_or(0, |i| i + 1)
}

/// Smoothed rate of change of a column in time, per second.
fn slopes(times_s: &[f64], values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..times_s.len()).collect();
    order.sort_by(|a, b| times_s[*a].total_cmp(&times_s[*b]));
    let reach = (order.len() / 25).max(2);
    let mut out = vec![0.0; values.len()];
    for (k, &i) in order.iter().enumerate() {
        let (a, b) = (order[k.saturating_sub(reach)], order[(k + reach).min(order.len() - 1)]);
        let dt = times_s[b] - times_s[a];
        out[i] = if dt > 0.0 { (values[b] - values[a]) / dt } else { 0.0 };
    }
    out
}
