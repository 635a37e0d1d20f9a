//! A blank as it was touched: its face and sides, tilted and shifted by as much as is asked.

use std::fmt::Write;

use nalgebra::{Rotation3, Vector3};
use pivotsight::align::{Alignment, Touches, fit};
use pivotsight::table::Table;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

/// A blank that lies at `shift`, tilted so that `Ry(b) Rx(a)` levels it: touches with noise.
pub fn touches(
    a_deg: f64,
    b_deg: f64,
    shift: Vector3<f64>,
    face: usize,
    noise: f64,
    seed: u64,
) -> String {
    let level = Rotation3::from_axis_angle(&Vector3::y_axis(), b_deg.to_radians())
        * Rotation3::from_axis_angle(&Vector3::x_axis(), a_deg.to_radians());
    let place = |p: Vector3<f64>| level.inverse() * p + shift;
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || Normal::new(0.0, noise).unwrap().sample(&mut random);
    let mut out = String::from("kind,x_mm,y_mm,z_mm\n");
    for i in 0..face {
        let t = std::f64::consts::TAU * i as f64 / face as f64 + 0.4;
        let p = place(Vector3::new(120.0 * t.cos(), 120.0 * t.sin(), 50.0));
        writeln!(out, "face,{:.9},{:.9},{:.9}", p.x, p.y, p.z + draw()).unwrap();
    }
    // Touches along X and Y at one height: the cylinder's axis there, and equal distances on both sides.
    let axis = level.inverse() * Vector3::z();
    let foot = place(Vector3::zeros());
    let center = foot + axis * ((20.0 - foot.z) / axis.z);
    for (kind, axis) in [("side_x", 0), ("side_y", 1)] {
        for side in [-150.0, 150.0] {
            let p = center + Vector3::ith(axis, side + draw());
            writeln!(out, "{kind},{:.9},{:.9},{:.9}", p.x, p.y, p.z).unwrap();
        }
    }
    out
}

pub fn fitted(csv: &str, options: &fit::Options) -> Alignment {
    let table =
        Table::parse("t.csv", csv.as_bytes(), &["kind", "x_mm", "y_mm", "z_mm"], &[]).unwrap();
    fit(&Touches::from_table(&table).unwrap(), options, &mut Vec::new()).unwrap()
}

pub const IDEAL: fit::Options =
    fit::Options { z_ideal_mm: 50.0, center_ideal_mm: [0.0, 0.0], c_deg: 0.0, touch_u_mm: None };
