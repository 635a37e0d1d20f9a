//! How the axes go along a ball bar path: which way, how fast, how far since they last turned back.

use nalgebra::Vector3;

use crate::diagnose::data::ballbar::turned;
use crate::diagnose::data::columns::Columns;

/// Z stands still where it goes no farther per radian of B, mm.
const STILL_MM: f64 = 1e-3;

/// How far Z goes per radian of B where both together keep the bar's length.
pub(super) fn slope_mm(data: &Columns, row: usize) -> f64 {
    let Some(cup) = data.cups.get(data.series[row]) else { return 0.0 };
    let along = data.tool(row) - cup.place_mm;
    let arm = turned(data.get("b_deg")[row].to_radians(), data.head);
    let swing = Vector3::new(arm.z, 0.0, -arm.x);
    // Where the bar is level, Z does nothing for its length.
    -along.dot(&swing) / along.z.abs().max(0.1 * cup.bar_mm).copysign(along.z)
}

/// Which way Z goes in every row where B goes up: 1 up, -1 down, 0 where it stands still. From the places next to the row's on its path, so
/// that it does not matter which axis keeps the bar's length. Where it turns back it stands still, or `came` says the way it came there.
pub(super) fn z_ways(data: &Columns, came: bool) -> Vec<f64> {
    let (b_deg, z_mm, dir) = (data.get("b_deg"), data.get("z_mm"), data.get("dir"));
    let mut ways = vec![0.0; b_deg.len()];
    for series in 0..data.series_names.len() {
        let mut rows = data.rows_of(series);
        if data.stands_still("z_mm", &rows) {
            continue;
        }
        rows.sort_by(|a, b| b_deg[*a].total_cmp(&b_deg[*b]));
        // Places nearer to one another than this are one, reached again.
        let step_deg = match rows[..] {
            [first, .., last] => (b_deg[last] - b_deg[first]) / rows.len() as f64,
            _ => continue,
        };
        let (mut before, mut after) = (0, 0);
        for &row in &rows {
            let near = |at: &usize, sign: f64| sign * (b_deg[*at] - b_deg[row]) >= 0.5 * step_deg;
            while before + 1 < rows.len() && near(&rows[before + 1], -1.0) {
                before += 1;
            }
            while after + 1 < rows.len() && !near(&rows[after], 1.0) {
                after += 1;
            }
            // At an end of the path its own place is the nearest.
            let low = if near(&rows[before], -1.0) { rows[before] } else { row };
            let (dz_mm, db_deg) = (z_mm[rows[after]] - z_mm[low], b_deg[rows[after]] - b_deg[low]);
            let upwards = dir.get(row).is_none_or(|dir| *dir > 0.0);
            let came_mm =
                if upwards { z_mm[row] - z_mm[low] } else { z_mm[rows[after]] - z_mm[row] };
            let still_mm = STILL_MM * db_deg.to_radians();
            if dz_mm.abs() > still_mm {
                ways[row] = dz_mm.signum();
            } else if came && came_mm.abs() > still_mm {
                ways[row] = came_mm.signum();
            }
        }
    }
    ways
}

/// How far B has gone in every row since it last turned back, degrees; infinite before it ever did. Rows without a time stand in the order
/// of the run.
pub(super) fn since_turn_deg(data: &Columns) -> Vec<f64> {
    let (b_deg, t_s, dir) = (data.get("b_deg"), data.get("t_s"), data.get("dir"));
    let mut way_deg = vec![f64::INFINITY; b_deg.len()];
    if dir.len() < b_deg.len() {
        return way_deg;
    }
    for series in 0..data.series_names.len() {
        let (mut turn_deg, mut rows) = (None, data.rows_of(series));
        if t_s.len() == b_deg.len() {
            rows.sort_by(|a, b| t_s[*a].total_cmp(&t_s[*b]));
        }
        for pair in rows.windows(2) {
            let [before, row] = [pair[0], pair[1]];
            if dir[before] * dir[row] < 0.0 {
                turn_deg = Some(b_deg[before]);
            }
            way_deg[row] = turn_deg.map_or(f64::INFINITY, |turn: f64| (b_deg[row] - turn).abs());
        }
    }
    way_deg
}

/// How fast B moves in every row, from its nearest neighbour in time that goes the same way.
pub(super) fn speeds_rad_s(data: &Columns) -> Vec<f64> {
    let (b_deg, t_s, dir) = (data.get("b_deg"), data.get("t_s"), data.get("dir"));
    let mut speeds = vec![0.0; data.series.len()];
    if t_s.len() < speeds.len() {
        return speeds;
    }
    for series in 0..data.series_names.len() {
        let mut rows = data.rows_of(series);
        rows.sort_by(|a, b| t_s[*a].total_cmp(&t_s[*b]));
        let mut nearest_s = vec![f64::INFINITY; speeds.len()];
        for pair in rows.windows(2).map(|w| [w[0], w[1]]) {
            let [before, after] = pair;
            let step_s = t_s[after] - t_s[before];
            if step_s > 0.0 && dir[before] == dir[after] {
                for row in pair {
                    if step_s < nearest_s[row] {
                        nearest_s[row] = step_s;
                        speeds[row] = (b_deg[after] - b_deg[before]).to_radians() / step_s;
                    }
                }
            }
        }
    }
    speeds
}
