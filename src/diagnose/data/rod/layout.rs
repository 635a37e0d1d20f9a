//! What `rod` data are to the fit: outputs, variables and random parts of every edge point.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, Vector2};

use super::Rod;
use crate::diagnose::algebra::orthonormal;
use crate::diagnose::data::sites;
use crate::diagnose::experiment::{Direction, Layout, Variable};
use crate::fit::robust::range;

/// Captures that see more of the rim than this show its lobes.
const WHOLE_DEG: f64 = 240.0;

/// A rod whose rim lies all at one distance from the frame's middle, within this part of its radius, says nothing over that distance.
const LEAST_SPREAD: f64 = 0.02;

/// How much of the rim the middle one of the captures sees, degrees.
fn seen_deg(angles: &[f64], capture: &[usize], captures: usize) -> f64 {
    let mut by_capture = vec![Vec::new(); captures];
    angles.iter().zip(capture).for_each(|(a, g)| by_capture[*g].push(a.to_degrees()));
    let mut seen: Vec<f64> = by_capture
        .into_iter()
        .filter(|a| a.len() > 1)
        .map(|mut a| {
            a.sort_by(f64::total_cmp);
            let round = 360.0 - (a[a.len() - 1] - a[0]);
            360.0 - a.windows(2).map(|w| w[1] - w[0]).fold(round, f64::max)
        })
        .collect();
    seen.sort_by(f64::total_cmp);
    seen.get(seen.len() / 2).copied().unwrap_or(0.0)
}

/// The layout of captures and their points.
pub(super) fn layout(data: &Rod, values: Vec<f64>, c_deg: &[f64]) -> Layout {
    let points = values.len();
    let normals = &data.rays;
    let angles: Vec<f64> = normals.iter().map(|n| n.y.atan2(n.x)).collect();
    let spread = |c: &[f64]| data.capture.iter().map(|&g| c[g]).collect::<Vec<f64>>();
    let mut variables = Vec::new();
    let mut add = |name: &'static str, values: Vec<f64>, angle: bool, within: bool| {
        variables.push(Variable { name, values, angle, within });
    };
    let (x, y): (Vec<f64>, Vec<f64>) = data.place.iter().map(|p| (p.x, p.y)).unzip();
    add("x_mm", spread(&x), false, false);
    add("y_mm", spread(&y), false, false);
    for (name, column, angle) in [
        ("c_deg", c_deg, true),
        ("t_s", &data.t_s, false),
        ("temp_c", &data.temp_c, false),
        ("dir_x", &data.dir_x, false),
        ("dir_y", &data.dir_y, false),
    ] {
        if !column.is_empty() {
            add(name, spread(column), angle, false);
        }
    }
    let degrees = |a: f64| a.to_degrees().rem_euclid(360.0);
    add("edge_angle_deg", angles.iter().map(|a| degrees(*a)).collect(), true, true);
    let own = |i: usize| {
        degrees(angles[i] - data.c_rad.get(data.capture[i]).copied().unwrap_or_default())
    };
    let rim_deg: Vec<f64> = (0..points).map(own).collect();
    if !c_deg.is_empty() {
        add("rod_angle_deg", rim_deg.clone(), true, true);
    }
    // Where the point is expected: its own place holds its error, and would explain it.
    let radius = values.iter().sum::<f64>() / points.max(1) as f64;
    let offset = |i: usize| data.pole + normals[i] * radius - data.place[data.capture[i]];
    let [eu, ev] = data.axes;
    add("frame_u_mm", (0..points).map(|i| eu.dot(&offset(i))).collect(), false, true);
    add("frame_v_mm", (0..points).map(|i| ev.dot(&offset(i))).collect(), false, true);
    let from_middle: Vec<f64> = (0..points).map(|i| offset(i).norm()).collect();
    let (least, most) = range(&from_middle);
    if most - least > LEAST_SPREAD * radius {
        add("frame_radius_mm", from_middle, false, true);
    }
    let column = |f: &dyn Fn(f64) -> f64| angles.iter().map(|a| f(*a)).collect::<Vec<f64>>();
    let directions = vec![
        Direction::whole("x", normals.iter().map(|n| n.x).collect()),
        Direction::whole("y", normals.iter().map(|n| n.y).collect()),
        Direction::whole("radius", vec![1.0; points]),
    ];
    let wave = |k: f64| vec![column(&|a| (k * a).cos()), column(&|a| (k * a).sin())];
    let mut random = vec![wave(1.0)];
    if seen_deg(&angles, &data.capture, data.place.len()) > WHOLE_DEG {
        random.extend([vec![vec![1.0; points]], wave(2.0), wave(3.0)]);
    } else {
        // On a short arc radius, lobes and slope cannot be told from a shift of the capture: there what it bends beyond one.
        let shift = wave(1.0);
        random.extend(bends(&angles, &shift, &data.capture, data.place.len()).map(|b| vec![b]));
    }
    let mut keys: Vec<&[f64]> = vec![&x, &y];
    if !c_deg.is_empty() {
        keys.push(c_deg);
    }
    Layout {
        sites: sites(&keys, data.place.len()),
        groups: data.capture.clone(),
        classes: vec![0; points],
        values,
        directions,
        variables,
        chains: chains(&angles, &data.capture, data.place.len()),
        random,
        rim_deg,
    }
}

/// The points of each capture along its edge, a step being as far as most neighbours are apart; it starts where the edge does.
fn chains(angles: &[f64], capture: &[usize], captures: usize) -> Vec<Vec<(usize, f64)>> {
    let chain = |mut rows: Vec<usize>| -> Vec<(usize, f64)> {
        rows.sort_by(|a, b| angles[*a].total_cmp(&angles[*b]));
        let count = rows.len();
        let to_next =
            |k: &usize| (angles[rows[(k + 1) % count]] - angles[rows[*k]]).rem_euclid(TAU);
        let gaps: Vec<f64> = (0..count).map(|k| to_next(&k)).collect();
        let first = (0..count).max_by(|a, b| gaps[*a].total_cmp(&gaps[*b])).map_or(0, |k| k + 1);
        let mut sorted = gaps.clone();
        sorted.sort_by(f64::total_cmp);
        let step = sorted.get(count / 2).copied().unwrap_or(0.0).max(1e-9);
        let order = (0..count).map(|k| (first + k) % count);
        let along = order.scan(0.0, |at, k| {
            let here = (rows[k], *at);
            *at += gaps[k] / step;
            Some(here)
        });
        along.collect()
    };
    by_capture(capture, captures).into_iter().map(chain).collect()
}

/// The points of each capture.
fn by_capture(capture: &[usize], captures: usize) -> Vec<Vec<usize>> {
    let mut rows = vec![Vec::new(); captures];
    capture.iter().enumerate().for_each(|(i, &g)| rows[g].push(i));
    rows
}

/// An even and an odd bend of each capture's arc, as no shift of the capture makes them; root mean square 1.
fn bends(angles: &[f64], shift: &[Vec<f64>], capture: &[usize], captures: usize) -> [Vec<f64>; 2] {
    let mut bends = [(); 2].map(|()| vec![0.0; angles.len()]);
    for rows in by_capture(capture, captures) {
        let middle: Vector2<f64> =
            rows.iter().map(|&i| Vector2::new(angles[i].cos(), angles[i].sin())).sum();
        let along = |i: usize| {
            let own = Vector2::new(angles[i].cos(), angles[i].sin());
            middle.perp(&own).atan2(middle.dot(&own))
        };
        let columns = DMatrix::from_fn(rows.len(), 4, |r, c| match c {
            0 | 1 => shift[c][rows[r]],
            2 => along(rows[r]).powi(2),
            _ => along(rows[r]),
        });
        let basis = orthonormal(&columns, 1e-6);
        for (bend, column) in bends.iter_mut().zip(basis.column_iter().skip(2)) {
            let scale = (rows.len() as f64).sqrt();
            rows.iter().zip(column.iter()).for_each(|(&i, v)| bend[i] = scale * v);
        }
    }
    bends
}
