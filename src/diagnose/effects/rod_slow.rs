//! Effects in a check rod's edge points that change with time and temperature.

use crate::diagnose::data::rod::Rod;
use crate::diagnose::effects::rod::{L, SIZE};
use crate::diagnose::effects::{Words, drifted, lagged, words};
use crate::diagnose::experiment::Parameter;

/// Drift with time and temperature, and the rod's growth.
pub fn time_effects(l: &mut L, data: &Rod) {
    let lags: Vec<f64> = [0.05, 0.12, 0.3, 0.7].iter().map(|f| f * data.duration_s()).collect();
    drift_time(l, data);
    drift_temperature(l, data, &lags);
    rod_growth(l, data, &lags);
}

fn drift_time(l: &mut L, data: &Rod) {
    l.effect(
        Words {
            varies_with: &["t_s"],
            ..words(
                "drift-time",
                "the rod moves against the head as time goes by",
                "the centre against time",
                "one place repeated through the run, captures in random order",
            )
        },
        data.needs(&["t_s"]),
    );
    let rises: Vec<f64> = [0.1, 0.2, 0.4, 0.8].iter().map(|f| f * data.duration_s()).collect();
    for saturating in [false, true] {
        for axes in [&[0, 1][..], &[0], &[1]] {
            let unit = if saturating { "mm" } else { "mm_per_h" };
            let mut parameters: Vec<Parameter> = axes
                .iter()
                .map(|a| Parameter::linear(format!("{}_{unit}", ["x", "y"][*a]), 0.01))
                .collect();
            if saturating {
                parameters.push(Parameter::shape("rise_s", &rises));
            }
            l.form(parameters, move |data, p, errors| {
                let start = data.start_s();
                for (e, t) in errors.iter_mut().zip(&data.t_s) {
                    let size = drifted(t - start, p.get(axes.len()).copied());
                    axes.iter().enumerate().for_each(|(k, a)| e.centre[*a] += p[k] * size);
                }
            });
        }
    }
}

fn drift_temperature(l: &mut L, data: &Rod, lags: &[f64]) {
    l.effect(
        Words {
            varies_with: &["temp_c"],
            ..words(
                "drift-temperature",
                "the rod moves against the head with temperature",
                "the centre against temperature",
                "one place repeated while the machine warms up and cools down",
            )
        },
        data.needs(&["temp_c"]),
    );
    for lag in [false, true] {
        if lag && data.duration_s() <= 0.0 {
            continue;
        }
        for axes in [&[0, 1][..], &[0], &[1]] {
            let mut parameters: Vec<Parameter> = axes
                .iter()
                .map(|a| Parameter::linear(format!("{}_mm_per_c", ["x", "y"][*a]), SIZE))
                .collect();
            if lag {
                parameters.push(Parameter::shape("lag_s", lags));
            }
            l.form(parameters, move |data, p, errors| {
                let warm = data.warmth(lag.then(|| p[axes.len()]));
                for (e, t) in errors.iter_mut().zip(&warm) {
                    axes.iter().enumerate().for_each(|(k, a)| e.centre[*a] += p[k] * (t - 20.0));
                }
            });
        }
    }
}

fn rod_growth(l: &mut L, data: &Rod, lags: &[f64]) {
    l.effect(
        Words {
            varies_with: &["temp_c"],
            ..words(
                "rod-growth",
                "the rod grows thicker with temperature",
                "the radius against temperature",
                "a wide span of temperatures",
            )
        },
        data.needs(&["temp_c"]),
    );
    for lag in [false, true] {
        if lag && data.duration_s() <= 0.0 {
            continue;
        }
        let mut parameters = vec![Parameter::linear("radius_mm_per_c", 1e-4)];
        if lag {
            parameters.push(Parameter::shape("lag_s", lags));
        }
        l.form(parameters, move |data, p, errors| {
            let warm = data.warmth(lag.then(|| p[1]));
            errors.iter_mut().zip(&warm).for_each(|(e, t)| e.radius += p[0] * (t - 20.0));
        });
    }
}

impl Rod {
    /// The temperature, lagged where a lag is given.
    fn warmth(&self, lag_s: Option<f64>) -> Vec<f64> {
        match lag_s {
            Some(lag) if !self.t_s.is_empty() => {
                lagged(&self.t_s, &self.temp_c, lag.abs().max(1e-3))
            }
            _ => self.temp_c.clone(),
        }
    }
}
