//! Effects in thermal data.
//!
//! An effect may show alike on all axes, on each axis by its own amount or on one alone: every form comes in all ways.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::diagnose::data::columns::Columns;
use crate::diagnose::effects::thermal_columns::{
    Column, above_zero, ambient_from, heating, metres, metres_from, middle, midway, risen, rises,
    softly, times,
};
use crate::diagnose::effects::thermal_sensors::dead;
use crate::diagnose::effects::thermal_ways::{goes, went};
use crate::diagnose::effects::{Library, Words, held, lagged, words};
use crate::diagnose::experiment::Parameter;

pub(super) type L = Library<Columns, Vector3<f64>>;
/// A first-order lag: times, values, lag.
type Lag = fn(&[f64], &[f64], f64) -> Column;

/// A form's columns, from the data and the parameter that is not linear.
type Made = dyn Fn(&Columns, f64) -> Vec<Column> + Send + Sync;

/// Adds a form with an amount for each of the columns, one with such amounts for each axis, and one of each axis alone. `shape` is a
/// parameter that is not linear.
pub(super) fn form(
    l: &mut L,
    axes: &[String],
    amounts: &[(String, f64)],
    shape: Option<(&'static str, &[f64])>,
    columns: impl Fn(&Columns, f64) -> Vec<Column> + Send + Sync + 'static,
) {
    on_axes(l, axes, amounts, shape, Arc::new(columns));
}

/// Compiled once, not for every form.
fn on_axes(
    l: &mut L,
    axes: &[String],
    amounts: &[(String, f64)],
    shape: Option<(&'static str, &[f64])>,
    columns: Arc<Made>,
) {
    let count = amounts.len();
    let shaped = |mut list: Vec<Parameter>| {
        list.extend(shape.map(|(name, grid)| Parameter::shape(name, grid)));
        list
    };
    let common = amounts.iter().map(|(n, t)| Parameter::linear(n.clone(), *t)).collect();
    let alike = columns.clone();
    l.form(shaped(common), move |data, p, errors| {
        add(errors, &alike(data, p.get(count).copied().unwrap_or(0.0)), |_| Some(p));
    });
    if axes.len() < 2 {
        return;
    }
    let own = |axis: &String| {
        let named = |(n, t): &(String, f64)| Parameter::linear(format!("{axis}_{n}"), *t);
        amounts.iter().map(named).collect::<Vec<_>>()
    };
    for (only, axis) in axes.iter().enumerate() {
        let columns = columns.clone();
        l.form(shaped(own(axis)), move |data, p, errors| {
            let columns = columns(data, p.get(count).copied().unwrap_or(0.0));
            add(errors, &columns, |row| (data.series[row] == only).then_some(p));
        });
    }
    let (all, many) = (axes.iter().flat_map(own).collect(), count * axes.len());
    l.form(shaped(all), move |data, p, errors| {
        let columns = columns(data, p.get(many).copied().unwrap_or(0.0));
        add(errors, &columns, |row| Some(&p[count * data.series[row]..]));
    });
}

/// Adds amounts times columns to the errors of the rows that have amounts.
fn add<'a>(
    errors: &mut [Vector3<f64>],
    columns: &[Column],
    amounts: impl Fn(usize) -> Option<&'a [f64]>,
) {
    for (row, e) in errors.iter_mut().enumerate() {
        let amounts = amounts(row).into_iter().flatten();
        e.x += columns.iter().zip(amounts).map(|(c, a)| c[row] * a).sum::<f64>();
    }
}

fn ones(data: &Columns) -> Column {
    vec![1.0; data.series.len()]
}

/// The library, with what `data` cannot test marked.
pub fn library(data: &Columns) -> L {
    let mut l = L::default();
    let axes = data.series_names.clone();
    let span_s = data.times_s().1 - data.times_s().0;
    let lags: Vec<f64> = [0.01, 0.025, 0.06, 0.12, 0.2, 0.4].map(|f| f * span_s).to_vec();
    head(&mut l, data, &axes, &lags);
    screw_nonlinear(&mut l, data, &axes);
    position_quadratic(&mut l, data, &axes);
    heating_hysteresis(&mut l, data, &axes);
    slow(&mut l, data, &axes, &lags);
    dead(&mut l, data, &axes, &lags);
    l
}

/// A name with a typical size.
pub(super) fn one(name: impl Into<String>, typical: f64) -> (String, f64) {
    (name.into(), typical)
}

const CYCLE: &str = "a full cycle of warming up and cooling down";

fn head(l: &mut L, data: &Columns, axes: &[String], lags: &[f64]) {
    let sensors = data.head_c.len();
    let none = || data.head_c.is_empty().then(|| "there is no head sensor column".into());
    l.effect(
        Words {
            varies_with: &["t_s"],
            ..words(
                "head-lag",
                "the head follows its sensors late",
                "after quick changes of the head's temperature",
                CYCLE,
            )
        },
        none(),
    );
    let mut sets: Vec<Vec<usize>> = (0..sensors).map(|k| vec![k]).collect();
    if sensors > 1 {
        sets.push((0..sensors).collect());
    }
    // Between readings temperatures change steadily, or (a control that reads seldom) not at all.
    for (lag, follow) in [("lag_s", lagged as Lag), ("held_lag_s", held)] {
        for set in &sets {
            let amounts: Vec<_> =
                set.iter().map(|k| one(format!("head_{}_mm_per_c", k + 1), 1e-3)).collect();
            let set = set.clone();
            form(l, axes, &amounts, Some((lag, lags)), move |data, lag_s| {
                let late = |k: &usize| {
                    let head = &data.head_c[*k];
                    let late = follow(data.get("t_s"), head, lag_s.abs().max(1e-3));
                    // Only the lag: what the sensor itself explains stays in the baseline.
                    late.iter().zip(head).map(|(a, b)| a - b).collect()
                };
                set.iter().map(late).collect()
            });
        }
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
    form(l, axes, &[one("offset_mm", 0.01)], None, |data, _| vec![ones(data)]);
    l.effect(
        words(
            "head-nonlinear",
            "the head's growth against its sensors is curved",
            "at the highest head temperatures",
            CYCLE,
        ),
        none(),
    );
    for k in 0..sensors {
        let name = |unit: &str| format!("head_{}_{unit}", k + 1);
        let curved = move |data: &Columns| -> Vec<Column> {
            let head = &data.head_c[k];
            let square = head.iter().map(|c| 1e-3 * c * c).collect();
            vec![square, head.iter().map(|c| 1e-6 * c * c * c).collect()]
        };
        let amounts = [one(name("um_per_c2"), 0.1), one(name("nm_per_c3"), 10.0)];
        form(l, axes, &amounts[..1], None, move |data, _| curved(data)[..1].to_vec());
        form(l, axes, &amounts, None, move |data, _| curved(data));
    }
}

fn screw_nonlinear(l: &mut L, data: &Columns, axes: &[String]) {
    l.effect(
        Words {
            varies_with: &["screw_c", "position_mm"],
            ..words(
                "screw-nonlinear",
                "the slope of the error over position against screw temperature is curved",
                "at the highest screw temperatures and far positions",
                "the axis over its whole travel at three or more temperatures",
            )
        },
        data.needs(&["screw_c"]),
    );
    let curved = |data: &Columns| {
        let squares: Column = above_zero(data).iter().map(|c| c * c).collect();
        vec![times(data.get("position_mm"), &squares), squares]
    };
    form(l, axes, &[one("per_c2", 1e-7)], None, move |data, _| curved(data)[..1].to_vec());
    let both = [one("per_c2", 1e-7), one("zero_mm_per_c2", 1e-5)];
    form(l, axes, &both, None, move |data, _| curved(data));
}

fn position_quadratic(l: &mut L, data: &Columns, axes: &[String]) {
    l.effect(
        Words {
            varies_with: &["position_mm"],
            ..words(
                "position-quadratic",
                "the error is curved over position",
                "middle against both ends of the travel",
                "the axis over its whole travel in even steps",
            )
        },
        data.needs(&["position_mm"]),
    );
    form(l, axes, &[one("mm_per_m2", 0.01)], None, |data, _| {
        let metres = metres(data);
        vec![times(&metres, &metres)]
    });
    for (name, place) in [("centred", 0.0), ("from_low", -1.0), ("from_high", 1.0)] {
        form(l, axes, &[one(format!("{name}_mm_per_m2"), 0.01)], None, move |data, _| {
            let metres = metres_from(data, place);
            vec![times(&metres, &metres)]
        });
    }
    // Where both ends have been set right.
    form(l, axes, &[one("between_ends_mm_per_m2", 0.01)], None, |data, _| {
        vec![times(&metres_from(data, -1.0), &metres_from(data, 1.0))]
    });
    form(l, axes, &[one("warm_mm_per_m2_c", 0.01)], None, |data, _| {
        let metres = metres(data);
        vec![times(&rises(data), &times(&metres, &metres))]
    });
}

fn heating_hysteresis(l: &mut L, data: &Columns, axes: &[String]) {
    l.effect(
        Words {
            varies_with: &["screw_c", "position_mm"],
            ..words(
                "heating-hysteresis",
                "warming up and cooling down differ at the same temperature",
                "the two branches of a cycle",
                CYCLE,
            )
        },
        data.needs(&["screw_c"]),
    );
    // The way the temperature goes, or (it matters at the turns, where readings are few) the way it came.
    for (came, sign) in [("", goes as fn(&Columns) -> Column), ("came_", went)] {
        let named = |name: &str, typical| one(format!("{came}{name}"), typical);
        form(l, axes, &[named("half_width_mm", 0.01)], None, move |data, _| vec![sign(data)]);
        form(l, axes, &[named("half_width_per_m", 0.01)], None, move |data, _| {
            vec![times(&sign(data), &metres(data))]
        });
        // The place where it is nothing need not be the machine's zero.
        let anywhere = [named("half_width_mm", 0.01), named("half_width_per_m", 0.01)];
        form(l, axes, &anywhere, None, move |data, _| {
            let sign = sign(data);
            let along = times(&sign, &metres(data));
            vec![sign, along]
        });
        form(l, axes, &[named("half_width_mm_per_c", 1e-3)], None, move |data, _| {
            vec![times(&sign(data), &rises(data))]
        });
        let warm = [named("half_width_per_m_c", 1e-3), named("half_width_mm_per_c", 1e-3)];
        for count in [1, 2] {
            form(l, axes, &warm[..count], None, move |data, _| {
                let warm = times(&sign(data), &rises(data));
                [times(&warm, &metres(data)), warm][..count].to_vec()
            });
        }
    }
    // A loop that is closed where the screw turns: an ellipse, as a lag makes, or the parabolas of friction in many places (Rayleigh).
    let closed = |data: &Columns, power: f64| {
        let open = midway(data).iter().map(|m| m.powf(power.abs())).collect::<Column>();
        let loops = times(&goes(data), &open);
        vec![times(&loops, &metres(data)), loops]
    };
    let both = [one("loop_half_width_per_m", 0.01), one("loop_half_width_mm", 0.01)];
    for kept in [0..1, 1..2, 0..2] {
        let shape = Some(("loop_power", &[0.5, 1.0][..]));
        form(l, axes, &both[kept.clone()], shape, move |data, power| {
            closed(data, power)[kept.clone()].to_vec()
        });
    }
    form(l, axes, &[one("rate_mm_h_per_c", 0.01)], None, |data, _| {
        vec![heating(data).iter().map(|rate| rate * 3.6).collect()]
    });
    for k in 0..data.head_c.len() {
        let named = |soft: &str| one(format!("head_{}_{soft}half_width_mm", k + 1), 0.01);
        form(l, axes, &[named("")], None, move |data, _| {
            vec![data.rates(&data.head_c[k]).iter().map(|rate| rate.signum()).collect()]
        });
        form(l, axes, &[named("soft_")], None, move |data, _| {
            vec![softly(&data.rates(&data.head_c[k]))]
        });
    }
}

fn slow(l: &mut L, data: &Columns, axes: &[String], lags: &[f64]) {
    l.effect(
        Words {
            varies_with: &["t_s"],
            ..words(
                "ambient",
                "the room's temperature moves the machine",
                "error against ambient_c",
                "a day and a night",
            )
        },
        data.needs(&["ambient_c"]),
    );
    form(l, axes, &[one("mm_per_c", 1e-3)], None, |data, _| vec![ambient_from(data, 20.0)]);
    form(l, axes, &[one("from_first_mm_per_c", 1e-3)], None, |data, _| {
        vec![ambient_from(data, data.first("ambient_c"))]
    });
    form(l, axes, &[one("from_middle_mm_per_c", 1e-3)], None, |data, _| {
        vec![ambient_from(data, middle(data.get("ambient_c")))]
    });
    let free = [one("mm_per_c", 1e-3), one("zero_mm", 0.01)];
    form(l, axes, &free, None, |data, _| {
        vec![ambient_from(data, middle(data.get("ambient_c"))), ones(data)]
    });
    let late = [one("late_mm_per_c", 1e-3), one("zero_mm", 0.01)];
    form(l, axes, &late, Some(("lag_s", &lags[1..4])), |data, lag_s| {
        let ambient = ambient_from(data, middle(data.get("ambient_c")));
        vec![lagged(data.get("t_s"), &ambient, lag_s.abs().max(1e-3)), ones(data)]
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
    form(l, axes, &[one("mm_per_h", 0.01)], None, |data, _| {
        let start = data.times_s().0;
        vec![data.get("t_s").iter().map(|t| (t - start) / 3600.0).collect()]
    });
    form(l, axes, &[one("from_middle_mm_per_h", 0.01)], None, |data, _| {
        let middle = middle(data.get("t_s"));
        vec![data.get("t_s").iter().map(|t| (t - middle) / 3600.0).collect()]
    });
    // Heat that soaks into what is thick goes with the root of time.
    form(l, axes, &[one("mm_per_root_h", 0.01)], None, |data, _| {
        let start = data.times_s().0;
        vec![data.get("t_s").iter().map(|t| ((t - start) / 3600.0).sqrt()).collect()]
    });
    let (start, end) = data.times_s();
    let rises_s = [lags, &[end - start]].concat();
    form(l, axes, &[one("mm", 0.01)], Some(("rise_s", &rises_s)), |data, rise_s| {
        vec![risen(data, data.times_s().0, rise_s)]
    });
}
