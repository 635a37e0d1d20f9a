//! Effects in RTCP deviations that change with temperature and time, and those of the linear axes.

use crate::diagnose::data::rtcp::Rtcp;
use crate::diagnose::effects::rtcp::{L, length};
use crate::diagnose::effects::{Words, drifted, lagged};
use crate::diagnose::experiment::Parameter;

/// Growth with temperature and drift with time.
pub fn time_effects(l: &mut L, data: &Rtcp) {
    thermal_growth(l, data);
    drift_time(l, data);
}

fn thermal_growth(l: &mut L, data: &Rtcp) {
    l.effect(
        Words {
            name: "thermal-growth",
            meaning: "the head grows longer with temperature, with a lag",
            evidence: "along the head against temperature",
            best: "one pose repeated while the machine warms up and cools down",
            varies_with: &["temp_c", "t_s"],
        },
        data.needs(&["temp_c"]),
    );
    let lags: Vec<f64> = [0.05, 0.12, 0.3, 0.7].iter().map(|f| f * data.duration_s()).collect();
    for datum in [false, true] {
        for lag in [false, true] {
            for reference in 0..3 {
                if lag && data.duration_s() <= 0.0 {
                    continue;
                }
                let mut parameters = vec![Parameter::linear("mm_per_c", 0.005)];
                match reference {
                    1 => parameters.push(length("offset_mm")),
                    2 => parameters.push(Parameter::switch("from_start", 1.0)),
                    _ => {}
                }
                if lag {
                    parameters.push(Parameter::shape("lag_s", &lags));
                }
                if datum {
                    parameters.push(Parameter::switch("datum", 1.0));
                }
                l.form(parameters, move |data, p, errors| {
                    let lag_at = if reference == 0 { 1 } else { 2 };
                    let warm = if lag {
                        lagged(&data.t_s, &data.temp_c, p[lag_at].abs().max(1e-3))
                    } else {
                        data.temp_c.clone()
                    };
                    let zero = if reference == 2 { data.first_temp_c() } else { 20.0 };
                    let offset = if reference == 1 { p[1] } else { 0.0 };
                    for (e, t) in errors.iter_mut().zip(&warm) {
                        let growth = p[0] * (t - zero) + offset;
                        e.head.dr += growth;
                        if datum {
                            e.datum.dr += growth;
                        }
                    }
                });
            }
        }
    }
}

fn drift_time(l: &mut L, data: &Rtcp) {
    l.effect(
        Words {
            name: "drift-time",
            meaning: "the tool moves against the table as time goes by",
            evidence: "all outputs against time",
            best: "one pose repeated through the run, poses in random order",
            varies_with: &["t_s"],
        },
        data.needs(&["t_s"]),
    );
    let rises: Vec<f64> = [0.1, 0.2, 0.4, 0.8].iter().map(|f| f * data.duration_s()).collect();
    for saturating in [false, true] {
        for axes in [&[0, 1, 2][..], &[0], &[1], &[2]] {
            let unit = if saturating { "mm" } else { "mm_per_h" };
            let mut parameters: Vec<Parameter> = axes
                .iter()
                .map(|a| Parameter::linear(format!("{}_{unit}", ["x", "y", "z"][*a]), 0.02))
                .collect();
            if saturating {
                parameters.push(Parameter::shape("rise_s", &rises));
            }
            l.form(parameters, move |data, p, errors| {
                let start = data.start_s();
                for (e, t) in errors.iter_mut().zip(&data.t_s) {
                    let size = drifted(t - start, p.get(axes.len()).copied());
                    for (k, a) in axes.iter().enumerate() {
                        e.shift[*a] += p[k] * size;
                    }
                }
            });
        }
    }
}

/// The place of an axis at which what grows along it is nil: there the machine was set right.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Datum {
    /// Its zero.
    Zero,
    /// The C axis; for Z the table (`datum = 1`).
    Table,
    /// Z as it stands with the head upright (`datum = 2`).
    Upright,
}

impl Datum {
    /// Those of an axis that differ in what they do to an output: there is no choice to pay for between forms that are one.
    fn of(data: &Rtcp, axis: usize, output: usize) -> Vec<Self> {
        let mut list = vec![Self::Zero];
        for datum in [Self::Table, Self::Upright] {
            let apart = |other: &Self| {
                (other.place_mm(data, axis) - datum.place_mm(data, axis)).abs() > 1e-6
            };
            let tells = datum == Self::Table || axis == 2 && output != 2;
            if tells && list.iter().all(apart) {
                list.push(datum);
            }
        }
        list
    }

    fn switch(self) -> Option<Parameter> {
        match self {
            Self::Zero => None,
            Self::Table => Some(Parameter::switch("datum", 1.0)),
            Self::Upright => Some(Parameter::switch("datum", 2.0)),
        }
    }

    fn place_mm(self, data: &Rtcp, axis: usize) -> f64 {
        match self {
            Self::Zero => 0.0,
            Self::Table => data.geometry.centre[axis],
            Self::Upright => {
                let upright = data.b_deg.iter().zip(&data.commanded);
                let upright = upright.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
                upright.map_or(0.0, |(_, place)| place[axis])
            }
        }
    }
}

/// Scales and squareness of the linear axes.
pub fn linear_effects(l: &mut L, data: &Rtcp) {
    type Row = (&'static str, &'static str, usize, usize, f64);
    let rows: [Row; 6] = [
        ("squareness-xy", "Y is not square to X (C0Y)", 0, 1, -1.0),
        ("squareness-xz", "Z is not square to X (B0Z)", 0, 2, 1.0),
        ("squareness-yz", "Z is not square to Y (A0Z)", 1, 2, -1.0),
        ("scale-x", "X goes too far (EXX)", 0, 0, 1.0),
        ("scale-y", "Y goes too far (EYY)", 1, 1, 1.0),
        ("scale-z", "Z goes too far (EZZ)", 2, 2, 1.0),
    ];
    for (name, meaning, output, input, sign) in rows {
        let evidence = "the deviation against the axis' place";
        let best = "long moves: B over its whole range and the target far out";
        l.effect(Words { name, meaning, evidence, best, varies_with: &[] }, None);
        // The other axis may be taken for the straight one: then its own error shows.
        let legs = [("um_per_m", output, input), ("other_leg_um_per_m", input, output)];
        let legs = &legs[..if output == input { 1 } else { 2 }];
        for &(name, output, input) in legs {
            for datum in Datum::of(data, input, output) {
                let mut parameters = vec![Parameter::linear(name, 20.0)];
                parameters.extend(datum.switch());
                l.form(parameters, move |data, p, errors| {
                    let from = datum.place_mm(data, input);
                    for (e, place) in errors.iter_mut().zip(&data.commanded) {
                        e.shift[output] += sign * p[0] * 1e-6 * (place[input] - from);
                    }
                });
            }
        }
        if output == input {
            // A screw's pitch or a warm bed: the scale grows towards one end.
            let parameters = ["um_per_m", "um_per_m2"].map(|name| Parameter::linear(name, 20.0));
            l.form(parameters.into(), move |data, p, errors| {
                for (e, place) in errors.iter_mut().zip(&data.commanded) {
                    let metres = 1e-3 * place[output];
                    e.shift[output] += 1e-3 * (p[0] + p[1] * metres) * metres;
                }
            });
        }
    }
}
