//! Ball bar lengths without any effect: where the tool is, where each path's base cup is, and the bars between them.

use std::collections::BTreeSet;

use nalgebra::{Rotation3, Vector3};

use crate::ballbar::Path;
use crate::diagnose::data::columns::Columns;
use crate::diagnose::data::cups::{Cup, find, straight_below};
use crate::diagnose::experiment::Parameter;

/// Completes the columns (Z from the path that keeps the bar's length, its sense from the data, each path's cup) and gives the
/// nuisances: each bar's length, and each path's cup.
pub fn prepare(data: &mut Columns, measured: &[f64], warnings: &mut Vec<String>) -> Vec<Parameter> {
    data.z_sense = 1.0;
    let linked: Vec<f64> = data.get("b_deg").iter().map(|b| linked_z(data, *b)).collect();
    let given = data.get("z_mm").to_vec();
    if given.is_empty() {
        warnings.push(
            "there is no column z_mm: Z is taken as linked to B, 2R (1 - cos B) downwards".into(),
        );
        data.numbers.insert("z_mm", linked);
        data.find_cups(measured);
    } else {
        // ISO 841 counts Z upwards; the method's own text counts the way down.
        let sense = |s: f64| {
            let mut other = data.clone();
            other.z_sense = s;
            other.numbers.insert("z_mm", given.iter().map(|g| s * g).collect());
            let misses = other.find_cups(measured);
            (other, misses, -s * alike_mm2(&given, &linked))
        };
        let (up, down) = (sense(1.0), sense(-1.0));
        // Short paths fit either way.
        let alike = (0.5..2.0).contains(&(up.1 / down.1)) || up.1.max(down.1) < 0.1;
        let turned = if alike { down.2 < up.2 } else { down.1 < up.1 };
        *data = if turned { down.0 } else { up.0 };
    }
    data.free_cups();
    let bars = data.cups.iter().map(|cup| cup.bar).max().unwrap_or(0);
    let more = (1..=bars).map(|bar| format!("bar{}_mm", bar + 1));
    let bars = std::iter::once("bar_mm".to_owned()).chain(more);
    let mut nuisances: Vec<Parameter> = bars.map(|bar| Parameter::linear(bar, 0.05)).collect();
    for (cup, name) in data.cups.iter().zip(&data.series_names) {
        nuisances.extend(of_cup(cup, name));
        if cup.side_assumed {
            warnings.push(format!(
                "path '{name}': the cup lies {:.1} mm beside the plane of motion, on which side the lengths do not tell: taken as +Y \
                 (on the other side tilts and squareness-yz change their sign; a path named like zb-y-150 says it)",
                cup.place_mm.y
            ));
        }
    }
    nuisances
}

/// Where a path's cup is: x, z, and y where that is free.
pub fn of_cup(cup: &Cup, path: &str) -> impl Iterator<Item = Parameter> {
    let label = if path.is_empty() { String::new() } else { format!("{path}_") };
    let place_mm = cup.place_mm;
    let axes = [0, 2].into_iter().chain(cup.y_is_free.then_some(1));
    axes.map(move |axis| Parameter {
        start: place_mm[axis],
        ..Parameter::linear(format!("{label}cup_{}_mm", ["x", "y", "z"][axis]), 0.05)
    })
}

/// How far two columns go the same way: the sum of their products, each from its mean.
fn alike_mm2(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let (a_mm, b_mm) = (mean(a), mean(b));
    a.iter().zip(b).map(|(x, y)| (x - a_mm) * (y - b_mm)).sum()
}

/// Z = 2R (1 - cos B) downwards keeps the bar's length over a cup 2R below the pivot (docs/diagnose.md).
fn linked_z(data: &Columns, b_deg: f64) -> f64 {
    -2.0 * data.head.norm() * (1.0 - b_deg.to_radians().cos())
}

/// Where X and Z go next on a path, keeping the bar's length: the one of them that stands still on it stays, and X where both have moved.
/// Where X has no column it is zero.
pub fn next_place(data: &Columns, path: usize, b_deg: f64) -> [f64; 2] {
    let rows = data.rows_of(path);
    let last = |name: &str| rows.last().and_then(|row| data.get(name).get(*row)).copied();
    let x_mm = last("x_mm").unwrap_or(0.0);
    let linked = [x_mm, linked_z(data, b_deg)];
    let Some(cup) = data.cups.get(path) else { return linked };
    let from_cup = turned(b_deg.to_radians(), data.head) - cup.place_mm;
    let level = |along: f64| cup.bar_mm.powi(2) - along.powi(2) - from_cup.y.powi(2);
    let still = |name: &str| data.stands_still(name, &rows);
    match last("z_mm") {
        Some(z_mm) if still("z_mm") && !still("x_mm") => {
            let rest = level(from_cup.z + z_mm).max(0.0).sqrt();
            // On the side of the cup that the path is on.
            let side = data.tool(rows[rows.len() - 1]).x - cup.place_mm.x;
            [rest.copysign(side) - from_cup.x, z_mm]
        }
        _ => {
            let rest = level(from_cup.x + x_mm);
            if rest < 0.0 { linked } else { [x_mm, rest.sqrt() - from_cup.z] }
        }
    }
}

/// The bar's length at a row. Nuisances: the bars; each path's cup x and z, and y where it is free.
pub fn predict(data: &Columns, nuisances: &[f64], row: usize, error: Vector3<f64>) -> [f64; 2] {
    let path = data.series[row];
    let from_here = data.cups[path..].iter().map(|cup| 2 + usize::from(cup.y_is_free));
    let cup = &nuisances[nuisances.len() - from_here.sum::<usize>()..];
    let own = &data.cups[path];
    let y = if own.y_is_free { cup[2] } else { own.place_mm.y };
    let d = data.tool(row) + error - Vector3::new(cup[0], y, cup[1]);
    [d.norm() + nuisances[own.bar], 0.0]
}

/// A vector of the head at a B angle.
pub fn turned(b_rad: f64, v: Vector3<f64>) -> Vector3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), b_rad) * v
}

impl Columns {
    /// The tool point at a row, from the pivot's place at zero.
    pub fn tool(&self, row: usize) -> Vector3<f64> {
        let x = self.get("x_mm").get(row).copied().unwrap_or(0.0);
        let b_rad = self.get("b_deg")[row].to_radians();
        turned(b_rad, self.head) + Vector3::new(x, 0.0, self.get("z_mm")[row])
    }

    /// Which cups beside the plane are free to lie elsewhere there. Where a bar hardly changes on any of its paths, and none of their cups
    /// lies in the plane, one of them and the bar's length are the same to all lengths, but for what an effect does to these.
    fn free_cups(&mut self) {
        /// Of the bar's length.
        const CHANGES: f64 = 0.01;
        let tells = |(path, cup): (usize, &Cup)| {
            let lengths = self.rows_of(path).into_iter().map(|r| cup.distance(&self.tool(r)));
            let (low, high) = lengths.fold((f64::MAX, 0.0f64), |(a, b), l| (a.min(l), b.max(l)));
            (!cup.is_beside() || high - low > CHANGES * high).then_some(cup.bar)
        };
        let mut told: BTreeSet<usize> = self.cups.iter().enumerate().filter_map(tells).collect();
        for cup in &mut self.cups {
            cup.y_is_free = cup.is_beside() && !told.insert(cup.bar);
        }
    }

    /// Which bar each cup has.
    fn find_bars(cups: &mut [Cup]) {
        /// Of the length: errors change that of a path by less, another bar is another size.
        const SAME: f64 = 0.01;
        let mut bars_mm: Vec<f64> = Vec::new();
        for cup in cups {
            let same = |bar_mm: &f64| (cup.bar_mm - bar_mm).abs() < SAME * bar_mm;
            cup.bar = bars_mm.iter().position(same).unwrap_or_else(|| {
                bars_mm.push(cup.bar_mm);
                bars_mm.len() - 1
            });
        }
    }

    /// Finds every path's cup and gives the root mean square of what the lengths then miss.
    fn find_cups(&mut self, measured: &[f64]) -> f64 {
        let (mut cups, mut squares) = (Vec::new(), 0.0);
        for (path, name) in self.series_names.iter().enumerate() {
            let rows = self.rows_of(path);
            let tools: Vec<Vector3<f64>> = rows.iter().map(|r| self.tool(*r)).collect();
            let lengths: Vec<f64> = rows.iter().filter_map(|r| measured.get(*r)).copied().collect();
            let mean = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
            let beside_mm = Path::parse(name).map_or(0.0, |path| path.cup_y_mm);
            if lengths.len() < tools.len() || mean <= 0.0 {
                let bar_mm = self.head.norm().hypot(beside_mm);
                cups.push(straight_below(beside_mm, &self.head, bar_mm));
                continue;
            }
            let below = straight_below(beside_mm, &self.head, mean);
            let (cup, miss_mm) = find(below, &tools, &lengths);
            squares += miss_mm.powi(2) * rows.len() as f64;
            cups.push(cup);
        }
        Self::find_bars(&mut cups);
        self.cups = cups;
        (squares / self.series.len().max(1) as f64).sqrt()
    }
}
