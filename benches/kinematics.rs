//! Poses a second through the head B / table C machine, on one core: `cargo bench --bench kinematics`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Vector3;
use pivotsight::machine::{Head, Machine, Table, ToolPose};
use std::hint::black_box;

const POSES: usize = 1000;

fn kinematics(criterion: &mut Criterion) {
    let head = Head { delta_x_mm: 0.283, r_mm: 214.7, standoff_mm: 1.5 };
    let machine =
        Machine::head_b_table_c(head, Table { xc_mm: 412.3, yc_mm: -87.6, zc_mm: -310.2 });
    let Ok(chain) = machine.chain() else { return };
    let poses: Vec<(Vector3<f64>, [f64; 2])> = (0..POSES)
        .map(|i| {
            let t = i as f64 * 0.001;
            (Vector3::new(80.0 * t, 50.0 - 90.0 * t, 30.0 * t), [1.5 - 3.0 * t, 6.0 * t])
        })
        .collect();
    let directed: Vec<ToolPose> =
        poses.iter().map(|(p, [b, c])| chain.forward(&[p.x, p.y, p.z, *b, *c])).collect();

    let mut group = criterion.benchmark_group("head B, table C");
    group.throughput(Throughput::Elements(POSES as u64));
    group.bench_function("inverse, rotary axes given", |b| {
        b.iter(|| poses.iter().map(|(p, r)| chain.inverse_at(black_box(p), *r)[0]).sum::<f64>());
    });
    group.bench_function("inverse, all solutions", |b| {
        b.iter(|| {
            directed.iter().map(|p| chain.inverse(black_box(p), &[0.0; 5]).len()).sum::<usize>()
        });
    });
    group.bench_function("forward", |b| {
        b.iter(|| {
            let at = |(p, r): &(Vector3<f64>, [f64; 2])| {
                chain.forward(black_box(&[p.x, p.y, p.z, r[0], r[1]])).position_mm.x
            };
            poses.iter().map(at).sum::<f64>()
        });
    });
    group.finish();
}

criterion_group!(benches, kinematics);
criterion_main!(benches);
