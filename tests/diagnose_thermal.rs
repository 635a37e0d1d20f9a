//! Diagnosis of thermal data: axes that differ, sensors that stop, a run that starts warm, heat that soaks in.

#[path = "common/diagnose.rs"]
mod common;

use std::fmt::Write as _;

use common::{BAR, answer, class, diagnose, normal, run};
use serde_json::Value;

/// Two axes with head coefficients of their own; then one of them moved by the room, from the first reading on.
#[test]
fn thermal_axes_differ_and_the_room_moves_one_of_them() {
    for room in [0.0, 0.01] {
        let mut normal = normal();
        let mut csv =
            String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c,ambient_c\n");
        for k in 0..30 {
            let t = 600.0 * f64::from(k);
            let (h1, h2) = (9.0 * (1.0 - (-t / 3000.0).exp()), 5.0 * (t / 4000.0).sin());
            let ambient = 1.5 * ((t / 1700.0 + 1.0).sin() - 1.0_f64.sin());
            for (axis, a, b, slope) in [("x", 0.004, -0.002, 1e-5), ("z", -0.001, 0.003, 8e-6)] {
                let screw = 6.0 * (1.0 - (-t / 5000.0).exp()) + if axis == "x" { 1.0 } else { 0.0 };
                let cold = if axis == "x" { 1.0 } else { 0.0 };
                for place in [0.0, 150.0, 300.0] {
                    let own = if axis == "x" { room * ambient } else { 0.0 };
                    let error = a * h1 + b * h2 + slope * (screw - cold) * place + own;
                    let error = error + 0.001 * normal();
                    writeln!(
                        csv,
                        "{t},{axis},{place},{error:.6},{:.3},{:.3},{:.3},{:.3}",
                        screw + 21.0,
                        h1 + 21.0,
                        h2 + 21.0,
                        ambient + 21.0
                    )
                    .unwrap();
                }
            }
        }
        let report = answer("thermal", BAR, &csv);
        if room == 0.0 {
            assert_eq!(report["verdict"], "consistent", "{}", report["unnamed"]);
        } else {
            assert_eq!(report["effects"][0]["name"], "ambient", "{}", report["unnamed"]);
        }
    }
}

/// What no effect of the library does, on one axis of two: a support that gives way, a knock. Neither gets a name, both a place.
#[test]
fn what_one_axis_does_alone_gets_no_name_but_its_axis() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("machine.toml"), BAR).unwrap();
    for versus in ["position_mm", "t_s"] {
        let hidden = |t: f64, place: f64| match versus {
            "t_s" => f64::from(u8::from(t > 8000.0)),
            _ => (-0.5 * ((place - 200.0) / 60.0).powi(2)).exp(),
        };
        let mut normal = normal();
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
        for k in 0..24 {
            for (axis, slope, travel) in [("X", 1e-5, 600.0), ("Y", 8e-6, 450.0)] {
                for step in 0..9 {
                    let t = 600.0 * f64::from(k) + 10.0 * f64::from(step);
                    let head = 8.0 * (1.0 - (-t / 3000.0).exp());
                    let screw = 6.0 * (1.0 - (-t / 5000.0).exp());
                    let place = travel * f64::from(step) / 8.0;
                    let own = if axis == "Y" { 0.004 * hidden(t, place) } else { 0.0 };
                    let error = 0.003 * head + slope * screw * place + own + 0.001 * normal();
                    let (screw, head) = (screw + 21.0, head + 21.0);
                    writeln!(csv, "{t},{axis},{place},{error:.6},{screw:.3},{head:.3}").unwrap();
                }
            }
        }
        std::fs::write(folder.join("data.csv"), csv).unwrap();
        let report = diagnose("thermal", folder);
        assert_eq!(report["verdict"], "unknown", "{}", report["effects"]);
        assert_eq!(report["unnamed"][0]["output"], "error_mm on Y", "{}", report["unnamed"]);
        assert_eq!(report["unnamed"][0]["versus"], versus, "{}", report["unnamed"]);
        let data = ["diagnose", "thermal", "--data", "data.csv", "--format", "json", "--model"];
        let write = ["machine.toml", "--write-model", "found.toml"];
        assert!(run(&[&data[..], &write].concat(), folder).status.success());
        let again = run(&[&data[..], &["found.toml"]].concat(), folder);
        let again: Value = serde_json::from_slice(&again.stdout).unwrap();
        assert_eq!(again["verdict"], "consistent", "{}", again["unnamed"]);
    }
}

/// A run that starts warm, its screw's slope zero at 20 °C: an error in the cold state is no other zero of the screw, nor is it
/// a channel's to which nothing is connected.
#[test]
fn a_constant_is_named_where_the_run_starts_warm() {
    let mut normal = normal();
    let mut csv =
        String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c,head_3_c\n");
    for k in 0..25 {
        let t = 600.0 * f64::from(k);
        let (h1, h2) = (8.0 * (1.0 - (-t / 3000.0).exp()), 4.0 * (t / 4000.0).sin());
        let screw = 22.0 + 5.0 * (t / 4500.0).sin().abs();
        for place in [0.0, 200.0, 400.0, 600.0, 800.0] {
            let error = 0.004 * h1 - 0.002 * h2 + (screw - 20.0) * (1.1e-5 * place - 0.003);
            let error = error + 0.03 + 0.001 * normal();
            writeln!(csv, "{t},x,{place},{error:.6},{screw:.3},{h1:.3},{h2:.3},5.000").unwrap();
        }
    }
    let report = answer("thermal", BAR, &csv);
    assert_eq!(report["verdict"], "named", "{report:#}");
    assert_eq!(report["effects"][0]["name"], "head-constant");
    assert!(report["warnings"].to_string().contains("head_3_c never changes"), "{report:#}");
}

/// A head warms and cools twice; one of two sensors, slower than the other, stops when it has begun to cool. What it misses is told by how
/// it followed the other. And a drift with the root of time is one name.
#[test]
fn a_sensor_that_stops_before_the_head_does_and_heat_that_soaks_in_have_their_names() {
    let lag = |t: f64, after: f64| 1.0 - (-t.max(0.0) / after).exp();
    let cycle = |t: f64, after: f64| {
        let switched = [0.0, 6000.0, 10_000.0, 15_000.0];
        let sum = |(i, at): (usize, &f64)| {
            if i % 2 == 0 { lag(t - at, after) } else { -lag(t - at, after) }
        };
        9.0 * switched.iter().enumerate().map(sum).sum::<f64>()
    };
    for (stops, soaks_mm, expected) in [(true, 0.0, "sensor-dead"), (false, 0.01, "drift-time")] {
        let mut normal = normal();
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c\n");
        for k in 0..60 {
            let t = 350.0 * f64::from(k);
            let [fast, slow] = [900.0, 2500.0].map(|after| cycle(t, after));
            let read = if stops { cycle(t.min(7500.0), 2500.0) } else { slow };
            let soaked = soaks_mm * (t / 3600.0).sqrt();
            for place in [0.0, 200.0, 400.0, 600.0] {
                let error = 0.002 * fast + 0.004 * slow + soaked + 0.0008 * normal();
                writeln!(csv, "{t},x,{place},{error:.6},21.0,{fast:.3},{read:.3}").unwrap();
            }
        }
        let report = answer("thermal", BAR, &csv);
        let effects = report["effects"].as_array().unwrap();
        assert_eq!(
            (effects.len(), &report["verdict"]),
            (1, &"named".into()),
            "{expected}: {effects:#?}"
        );
        assert!(class(&report).contains(&expected), "{effects:#?}");
    }
}

/// A sensor seen to stop is among the names of what it leaves; a constant and a curve over position are two names, no polynomial.
#[test]
fn stopped_sensors_and_pairs_have_their_names() {
    let report = |stops: bool| {
        let mut normal = normal();
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
        for k in 0..30 {
            let t = 600.0 * f64::from(k);
            let rise = |t: f64| 9.0 * (1.0 - (-t / 3000.0).exp());
            let (screw, head) = (6.0 * (1.0 - (-t / 5000.0).exp()), rise(t));
            let read = if stops { rise(t.min(6000.0)) } else { head };
            for place in [0.0, 150.0, 300.0, 450.0, 600.0] {
                let more = if stops { 0.0 } else { 0.004 + 2e-8 * place * place };
                let error = 0.004 * head + 1e-5 * screw * place + more + 0.0005 * normal();
                writeln!(csv, "{t},x,{place},{error:.6},{:.3},{read:.3}", screw + 21.0).unwrap();
            }
        }
        answer("thermal", BAR, &csv)
    };
    let dead = report(true);
    assert!(class(&dead).contains(&"sensor-dead"), "{dead:#}");
    let pair = report(false);
    assert_eq!(pair["verdict"], "named", "{}", pair["unnamed"]);
    let names: Vec<_> = pair["effects"].as_array().into_iter().flatten().collect();
    assert!(names.len() == 2 && names.iter().any(|e| e["name"] == "position-quadratic"));
}

/// Sweeps far apart in time of a screw that turns between them, and beside its plateau hardly moves: which way it goes is told by the
/// readings of a sweep or by the sweep next to it, not by those hours before.
#[test]
fn a_hysteresis_is_named_where_sweeps_are_few_and_the_screw_turns_between_them() {
    // What the screw tends to, and from when on.
    let tends = [(0.0, 7.0), (6200.0, 5.5), (9300.0, 7.0), (11_000.0, 0.0)];
    let screw = |t: f64| {
        let mut now = 0.0;
        for (i, (from, to)) in tends.iter().enumerate().take_while(|(_, (from, _))| *from <= t) {
            let until = tends.get(i + 1).map_or(t, |next| next.0.min(t));
            now = to + (now - to) * (-(until - from) / 2600.0).exp();
        }
        now
    };
    let mut normal = normal();
    let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
    let starts = [
        0.0, 890.0, 7060.0, 7740.0, 9600.0, 10_120.0, 12_170.0, 12_790.0, 13_700.0, 14_560.0,
        15_260.0, 17_380.0, 17_870.0, 19_130.0,
    ];
    for start in starts {
        for step in 0..6 {
            let (t, place) = (start + 8.0 * f64::from(step), 120.0 * f64::from(step));
            let way = (screw(t + 1.0) - screw(t)).signum();
            let head = 9.0 * (t / 4000.0).sin().abs();
            let error = 0.003 * head + 9e-6 * screw(t) * place + 0.004 * way + 0.001 * normal();
            writeln!(csv, "{t},x,{place},{error:.6},{:.2},{head:.2}", 20.0 + screw(t)).unwrap();
        }
    }
    let report = answer("thermal", BAR, &csv);
    let effects = report["effects"].as_array().unwrap();
    assert_eq!((effects.len(), &report["verdict"]), (1, &"named".into()), "{effects:#?}");
    assert!(class(&report).contains(&"heating-hysteresis"), "{effects:#?}");
}

/// Of two sensors the one that stopped is dead, not the one that has cooled down and rests; and where nothing but rest is seen, none is.
#[test]
fn a_sensor_that_has_come_to_rest_is_not_dead() {
    for stops in [true, false] {
        let mut normal = normal();
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c\n");
        for k in 0..50 {
            let t = 400.0 * f64::from(k);
            let warm = |t: f64, after: f64| {
                let up = 1.0 - (-t.min(5000.0) / after).exp();
                up * (-(t - 5000.0).max(0.0) / after).exp()
            };
            let (fast, slow) = (6.0 * warm(t, 500.0), 4.0 * warm(t, 2500.0));
            let read = if stops { 4.0 * warm(t.min(6000.0), 2500.0) } else { slow };
            let screw = 20.0 + 5.0 * warm(t, 4000.0);
            for place in [0.0, 300.0, 600.0] {
                let error = 0.002 * fast + 0.004 * slow + 0.001 * normal();
                writeln!(csv, "{t},x,{place},{error:.6},{screw:.2},{fast:.2},{read:.2}").unwrap();
            }
        }
        let report = answer("thermal", BAR, &csv);
        let warnings = report["warnings"].to_string();
        assert!(!warnings.contains("head_1_c no longer"), "{warnings}");
        assert_eq!(warnings.contains("head_2_c no longer"), stops, "{warnings}");
    }
}

/// Where there is no other sensor and the screw stays as it is, a reading that stops in the midst of a change is a dead sensor's.
#[test]
fn an_only_sensor_that_stops_in_the_midst_of_a_change_is_dead() {
    let mut normal = normal();
    let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
    for k in 0..40 {
        let t = 400.0 * f64::from(k);
        let head = |t: f64| 8.0 * (t / 3000.0).sin();
        for place in [0.0, 300.0, 600.0] {
            let error = 0.004 * head(t) + 0.001 * normal();
            let read = head(t.min(7500.0));
            writeln!(csv, "{t},x,{place},{error:.6},21.00,{read:.2}").unwrap();
        }
    }
    let report = answer("thermal", BAR, &csv);
    assert!(report["warnings"].to_string().contains("head_1_c no longer"), "{report:#}");
    assert!(class(&report).contains(&"sensor-dead"), "{report:#}");
}

/// Rows of one time have no order: which way a screw goes between them is noise, in whatever order they are written.
#[test]
fn rows_of_one_time_may_stand_in_any_order() {
    let mut normal = normal();
    let mut rows = Vec::new();
    for k in 0..40 {
        let t = 400.0 * f64::from(k);
        let (screw, head) = (5.0 * (t / 5000.0).sin(), 6.0 * (t / 3000.0).sin().abs());
        for place in [0.0, 200.0, 400.0, 600.0] {
            let way = (t / 5000.0).cos().signum();
            let error = 0.003 * head + 9e-6 * screw * place + 0.003 * way + 0.001 * normal();
            let read = 21.0 + screw + 0.05 * normal();
            rows.push(format!("{t},x,{place},{error:.6},{read:.3},{head:.3}"));
        }
    }
    let named = |rows: &[String]| {
        let head = "t_s,axis,position_mm,error_mm,screw_c,head_1_c\n";
        let report = answer("thermal", BAR, &(head.to_owned() + &rows.join("\n")));
        (
            report["verdict"].clone(),
            report["effects"].as_array().unwrap().len(),
            class(&report).join(" "),
        )
    };
    let written = named(&rows);
    rows.reverse();
    assert_eq!(written, named(&rows));
    assert!(written.2.contains("heating-hysteresis"), "{written:?}");
}

/// A screw that is warmed and cooled twice, and an error that lags behind in a loop: an ellipse, or the two parabolas of friction in many
/// places. It is closed where the screw turns, so that no jump tells of it.
#[test]
fn a_loop_that_is_closed_at_its_ends_is_a_hysteresis() {
    for power in [0.5, 1.0] {
        let mut normal = normal();
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
        let mut rise = 0.0_f64;
        for k in 0..60 {
            let t = 300.0 * f64::from(k);
            let (tends, way) = if (k / 15) % 2 == 0 { (8.4, 1.0) } else { (-0.4, -1.0) };
            let head = 7.0 * (1.0 - (-t / 4000.0).exp());
            let open = way * (rise * (8.0 - rise) / 16.0).powf(power);
            for place in [0.0, 200.0, 400.0, 600.0] {
                let error = 0.003 * head + 9e-6 * rise * place + 0.006 * open + 0.001 * normal();
                writeln!(csv, "{t},x,{place},{error:.6},{:.3},{head:.3}", 20.5 + rise).unwrap();
            }
            rise = (rise + (tends - rise) * (1.0 - (-300.0_f64 / 1500.0).exp())).clamp(0.0, 8.0);
        }
        let report = answer("thermal", BAR, &csv);
        let effects = report["effects"].as_array().unwrap();
        assert_eq!((effects.len(), &report["verdict"]), (1, &"named".into()), "{effects:#?}");
        assert_eq!(effects[0]["name"], "heating-hysteresis");
        let half_width = effects[0]["parameters"]["loop_half_width_mm"].as_f64();
        assert!((half_width.unwrap() - 0.006).abs() < 6e-4, "{effects:#?}");
    }
}

/// One of two head sensors reads the same from the first row on. Where its part of the head grows it is among the names of what is
/// missing; where nothing is connected to it nothing is said but a warning.
#[test]
fn a_sensor_that_never_read_anything_may_be_dead() {
    for part_mm_per_c in [0.004, 0.0] {
        let mut normal = normal();
        let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c\n");
        let (mut fast, mut slow) = (0.0, 0.0);
        for k in 0..60 {
            let t = 300.0 * f64::from(k);
            let heated = if (k / 15) % 2 == 0 { 9.0 } else { 1.0 };
            for place in [0.0, 200.0, 400.0, 600.0] {
                let error = 0.002 * fast + part_mm_per_c * slow + 0.001 * normal();
                writeln!(csv, "{t},x,{place},{error:.6},21.0,{fast:.3},20.000").unwrap();
            }
            fast += (heated - fast) * (1.0 - (-300.0_f64 / 900.0).exp());
            slow += (heated - slow) * (1.0 - (-300.0_f64 / 3000.0).exp());
        }
        let report = answer("thermal", BAR, &csv);
        assert!(report["warnings"].to_string().contains("head_2_c never changes"), "{report:#}");
        if part_mm_per_c == 0.0 {
            assert_eq!(report["verdict"], "consistent", "{report:#}");
        } else {
            assert_eq!(report["verdict"], "named", "{}", report["unnamed"]);
            assert!(class(&report).contains(&"sensor-dead"), "{report:#}");
        }
    }
}

/// A sensor that stops before it has shown how it follows the other: what it misses goes with the other in part at once and in part
/// late, as a lag of the head does; but it was seen to stop.
#[test]
fn a_sensor_that_stops_early_would_have_followed_the_other() {
    let mut normal = normal();
    let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c\n");
    let (mut fast, mut slow, mut read) = (0.0, 0.0, 0.0);
    for (k, heated) in [9.0, 2.0, 6.0, 0.0, 8.0, 1.0].into_iter().enumerate() {
        for step in 12 * k..12 * (k + 1) {
            if step < 6 {
                read = slow;
            }
            for place in [0.0, 300.0] {
                let (t, error) = (300 * step, 0.002 * fast + 0.006 * slow + 0.001 * normal());
                writeln!(csv, "{t},x,{place},{error:.6},21.0,{fast:.2},{read:.2}").unwrap();
            }
            fast += (heated - fast) * (1.0 - (-300.0_f64 / 900.0).exp());
            slow += (heated - slow) * (1.0 - (-300.0_f64 / 2500.0).exp());
        }
    }
    let report = answer("thermal", BAR, &csv);
    let effects = report["effects"].as_array().unwrap();
    assert_eq!((effects.len(), &report["verdict"]), (1, &"named".into()), "{effects:#?}");
    assert_eq!(effects[0]["name"], "sensor-dead", "{effects:#?}");
}

/// Two axes in one warm-up and cooling down: an error in the cold state, and on one of them a curved slope, which with another zero of
/// the screws would pass for both.
#[test]
fn two_effects_are_no_other_zero_of_the_screws() {
    let mut normal = normal();
    let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c,head_2_c\n");
    for k in 0..24 {
        let t = 400.0 * f64::from(k);
        let cycle = |after: f64| {
            (1.0 - (-t.min(8000.0) / after).exp()) * (-(t - 8000.0).max(0.0) / after).exp()
        };
        let (h1, h2, rise) = (9.0 * cycle(1500.0), 5.0 * cycle(4000.0), 6.0 * cycle(3000.0));
        for (axis, cold, slope, curved) in [("x", 22.0, 1e-5, 0.0), ("z", 23.0, 8e-6, 1e-6)] {
            for place in [0.0, 150.0, 300.0] {
                let screw = (slope * rise + curved * rise * rise) * place;
                let error = 0.004 * h1 - 0.002 * h2 + screw + 0.012 + 0.001 * normal();
                let screw = cold + rise;
                writeln!(csv, "{t},{axis},{place},{error:.6},{screw:.3},{h1:.3},{h2:.3}").unwrap();
            }
        }
    }
    let report = answer("thermal", BAR, &csv);
    let effects = report["effects"].as_array().unwrap();
    let mut names: Vec<_> = effects.iter().filter_map(|e| e["name"].as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["head-constant", "screw-nonlinear"], "{effects:#?}");
    assert_eq!(report["verdict"], "named", "{}", report["unnamed"]);
}

/// The machine warms up while it is measured for the first time: two of its screws are never as cold as the zero that all have in common.
#[test]
fn screws_that_share_their_zero_start_at_different_temperatures() {
    let mut normal = normal();
    let mut csv = String::from("t_s,axis,position_mm,error_mm,screw_c,head_1_c\n");
    for k in 0..30 {
        for (n, (axis, slope, ends)) in
            [("x", 1.1e-5, 6.0), ("y", 0.9e-5, 9.0), ("z", 1.2e-5, 7.5)].into_iter().enumerate()
        {
            let t = 600.0 * f64::from(k) + 200.0 * n as f64;
            let head = 8.0 * (1.0 - (-t / 3000.0).exp());
            let screw = ends * (1.0 - (-t / 2600.0).exp());
            for place in [0.0, 150.0, 300.0, 450.0] {
                let error = 0.003 * head + slope * screw * place + 0.0006 * normal();
                let (screw, head) = (screw + 21.0, head + 21.0);
                writeln!(csv, "{t},{axis},{place},{error:.6},{screw:.3},{head:.3}").unwrap();
            }
        }
    }
    let report = answer("thermal", BAR, &csv);
    assert_eq!(report["verdict"], "consistent", "{} {}", report["effects"], report["unnamed"]);
}
