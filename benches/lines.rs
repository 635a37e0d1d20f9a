//! Lines a second of what works between a program, its machine and its control: `cargo bench --bench lines`.

#![allow(clippy::unwrap_used)]

use std::fmt::Write;
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pivotsight::align::apply::{Options, apply};
use pivotsight::align::{Touches, fit};
use pivotsight::machine::Machine;
use pivotsight::thermal::compensate::{self, Compensator};
use pivotsight::thermal::simulate::Truth;
use pivotsight::thermal::{fit as fit_thermal, head, screw};

const LINES: usize = 20_000;

/// A path over a dome, away from the pole.
fn program() -> String {
    let mut text = String::from("x_mm,y_mm,z_mm,i,j,k\n");
    for i in 0..LINES {
        let t = 0.0007 * i as f64;
        let tilt = 0.4 + 0.2 * (2.0 * t).sin();
        let (x, y) = (80.0 * t.cos(), 70.0 * t.sin());
        let (i, j, k) = (tilt.sin() * t.cos(), tilt.sin() * t.sin(), tilt.cos());
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{x:.9},{y:.9},40,{i:.12},{j:.12},{k:.12}");
    }
    text
}

fn aligned(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    std::fs::write(file("in.cl"), program()).unwrap();
    let touches = Touches::read("docs/examples/blank.csv").unwrap();
    let ideal = fit::Options {
        z_ideal_mm: 50.0,
        center_ideal_mm: [0.0, 0.0],
        c_deg: 0.0,
        touch_u_mm: None,
    };
    let alignment = fit::fit(&touches, &ideal, &mut Vec::new()).unwrap();
    let machine = Machine::read("docs/examples/machine-ac.toml").unwrap();
    let mut group = criterion.benchmark_group("align apply, files and all");
    group.throughput(Throughput::Elements(LINES as u64)).sample_size(20);
    for (name, from, to) in [
        ("CL to CL", "in.cl", "on.cl"),
        ("CL to NC", "in.cl", "on.nc"),
        ("NC to NC", "on.nc", "again.nc"),
    ] {
        let options = Options::default();
        let moved = || apply(&alignment, &machine, &file(from), &file(to), &options).unwrap();
        group.bench_function(name, |b| b.iter(|| black_box(moved().lines)));
    }
    group.finish();
}

fn compensated(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let truth = Truth::sample(6);
    std::fs::write(file("head.csv"), truth.head_csv(400, 1)).unwrap();
    std::fs::write(file("screw.csv"), truth.screw_csv(&[0.0, 5.0, 10.0], 11, 2)).unwrap();
    let head = head::Data::read(file("head.csv"), &[]).unwrap();
    let screws = screw::Data::read(file("screw.csv")).unwrap();
    let (head_options, screw_options) = (head::Options::default(), screw::Options::default());
    let (head, screws) = (Some((&head, &head_options)), Some((&screws, &screw_options)));
    let model = fit_thermal(head, screws, Vec::new(), &mut Vec::new()).unwrap();
    let mut compensator = Compensator::new(model, compensate::Options::default());
    let line = "{\"position_mm\":{\"x\":700,\"y\":900,\"z\":200},\"screw_c\":{\"x\":24,\"y\":25,\"z\":23},\
                \"head_c\":[5,3,4,3,2,1]}";
    let mut group = criterion.benchmark_group("thermal compensate");
    group.throughput(Throughput::Elements(1));
    group.bench_function("three axes, six sensors", |b| {
        b.iter(|| compensator.answer_line(black_box(line)));
    });
    group.finish();
}

criterion_group!(benches, aligned, compensated);
criterion_main!(benches);
