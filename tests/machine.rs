//! What the machine model promises: one chain, forwards, backwards and by derivative, for any order of axes; the
//! contract's formulas; the machine file; and a real control's own joint positions.

#![allow(clippy::unwrap_used)] // a test that cannot go on should stop

use std::f64::consts::{PI, TAU};
use std::path::Path;

use assert_cmd::Command;
use nalgebra::{Rotation3, Vector3};
use pivotsight::machine::{
    AxisName, Chain, ComponentError, Curve, Effect, Head, Joints, LocationError, Machine,
    Singularity, Table, ToolPose,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MAXKINS: &str = "../shared/data/kinematics/linuxcnc_maxkins.csv";
const ORDERS: [&str; 9] = [
    "w C b X Y Z B t",
    "w C A b X Y Z t",
    "w C B Y X b Z t",
    "w b X Y Z C B t",
    "w b Z X Y C A t",
    "w b X Y Z A B t",
    "w X Y b Z C A t",
    "w B b Z Y X A t",
    "w A B b X Z Y t",
];

fn cell() -> Machine {
    let head = Head { delta_x_mm: 0.283, r_mm: 214.7, standoff_mm: 1.5 };
    Machine::head_b_table_c(head, Table { xc_mm: 412.3, yc_mm: -87.6, zc_mm: -310.2 })
}

/// A machine with every axis somewhere odd, as real ones are.
fn odd(order: &str) -> Machine {
    let mut machine = cell();
    machine.kinematics.order = order.into();
    let table = order.split('b').next().unwrap_or("");
    for letter in ['A', 'B', 'C'].into_iter().filter(|&l| order.contains(l)) {
        let place = if table.contains(letter) { -1.0 } else { 1.0 };
        let entry = machine.axes.entry(letter.to_string()).or_default();
        entry.point_mm = Some([12.0, -7.0 * place, 90.0 * place]);
        entry.sense = (letter != 'C' || !table.contains('C')).then_some(-1);
    }
    machine
}

/// Puts location errors and component errors on every axis.
fn worsened(mut chain: Chain) -> Chain {
    for (i, axis) in chain.names().into_iter().enumerate() {
        let size = 1e-4 * (1.0 + i as f64);
        for sort in AxisName::ALL {
            let name =
                if axis.is_rotary() || (sort.is_rotary() && sort.component() != axis.component()) {
                    format!("{sort}O{axis}")
                } else if sort == axis {
                    format!("E{axis}{axis}")
                } else {
                    continue;
                };
            chain.add_location_error(name.parse::<LocationError>().unwrap(), size).unwrap();
            let curve = if axis.is_rotary() {
                Curve::Harmonics {
                    period: TAU,
                    terms: vec![[1.0, size, -size], [2.0, size / 3.0, size]],
                }
            } else {
                Curve::Table(vec![(-1000.0, -3.0 * size), (0.0, size), (1000.0, 2.0 * size)])
            };
            chain.set_component_error(&ComponentError { axis, way: sort, curve }).unwrap();
        }
    }
    chain
}

fn random_joints(rng: &mut ChaCha8Rng) -> Joints {
    std::array::from_fn(|i| {
        if i < 3 { rng.random_range(-400.0..400.0) } else { rng.random_range(-1.9..1.9) }
    })
}

#[test]
fn forward_undoes_inverse_for_every_order_of_axes_errors_and_all() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for order in ORDERS {
        let ideal = odd(order).chain().unwrap();
        for chain in [ideal.clone(), worsened(ideal)] {
            for _ in 0..50 {
                let q = random_joints(&mut rng);
                let pose = chain.forward(&q);
                let jacobian = chain.jacobian(&q);
                let turns = jacobian.fixed_view::<3, 2>(3, 3);
                if turns.column(0).cross(&turns.column(1)).norm() < 0.05 {
                    continue; // next to a singular direction
                }
                let solutions = chain.inverse(&pose, &q);
                assert!((1..=2).contains(&solutions.len()), "{order}: {solutions:?}");
                for s in &solutions {
                    let back = chain.forward(&s.joints);
                    assert!((back.position_mm - pose.position_mm).norm() < 1e-9, "{order} {s:?}");
                    assert!((back.direction - pose.direction).norm() < 1e-9, "{order} {s:?}");
                }
                let miss =
                    (0..5).map(|i| (solutions[0].joints[i] - q[i]).abs()).fold(0.0, f64::max);
                assert!(
                    miss < 1e-6,
                    "{order}: the nearest solution is the one it came from, {miss}"
                );
                let held = chain.inverse_at(&pose.position_mm, [q[3], q[4]]);
                assert!((0..3).all(|i| (held[i] - q[i]).abs() < 1e-9), "{order}");
            }
        }
    }
}

#[test]
fn the_jacobian_is_the_derivative() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for order in ORDERS {
        let chain = worsened(odd(order).chain().unwrap());
        let q = random_joints(&mut rng);
        let jacobian = chain.jacobian(&q);
        for i in 0..5 {
            let h = if i < 3 { 1e-3 } else { 1e-5 };
            let at = |d: f64| {
                let mut moved = q;
                moved[i] += d;
                chain.forward(&moved)
            };
            let (up, down) = (at(h), at(-h));
            let position = (up.position_mm - down.position_mm) / (2.0 * h);
            let direction = (up.direction - down.direction) / (2.0 * h);
            let column = jacobian.column(i);
            assert!((column.fixed_rows::<3>(0) - position).norm() < 1e-6, "{order} joint {i}");
            assert!((column.fixed_rows::<3>(3) - direction).norm() < 1e-8, "{order} joint {i}");
        }
    }
}

#[test]
fn the_contracts_formula_is_the_chain() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for c_sense in [1, -1] {
        let machine = Machine { c_sense, ..cell() };
        let chain = machine.chain().unwrap();
        for _ in 0..100 {
            let [x, y, z, b, c] = random_joints(&mut rng);
            let p = Vector3::new(x, y, z);
            let v0 = machine.head_vector();
            let t = machine.table_point()
                + Rotation3::from_axis_angle(&Vector3::z_axis(), f64::from(c_sense) * c) * p;
            let v = Rotation3::from_axis_angle(&Vector3::y_axis(), b) * v0;
            let expected = t - (v - v0);
            let q = chain.inverse_at(&p, [b, c]);
            assert!((Vector3::new(q[0], q[1], q[2]) - expected).norm() < 1e-10);
        }
    }
}

#[test]
fn location_errors_of_the_b_axis_act_like_errors_of_the_head_vector() {
    let mut machine = cell();
    let mut shifted = machine.chain().unwrap();
    shifted.add_location_error("XOB".parse().unwrap(), -0.05).unwrap();
    shifted.add_location_error("Z0B".parse().unwrap(), 0.02).unwrap();
    machine.head.delta_x_mm += 0.05;
    machine.head.r_mm += 0.02;
    let chain = machine.chain().unwrap();
    for b in [-1.2, 0.0, 0.7] {
        let q = [10.0, 20.0, 30.0, b, 0.4];
        assert!((shifted.forward(&q).position_mm - chain.forward(&q).position_mm).norm() < 1e-12);
    }
}

#[test]
fn singular_poses_are_named_and_limits_kept() {
    let mut machine = cell();
    machine.axes.entry("B".into()).or_default().limits_deg = Some([-100.0, 100.0]);
    machine.axes.entry("C".into()).or_default().limits_deg = Some([-360.0, 360.0]);
    let chain = machine.chain().unwrap();
    let straight = ToolPose { position_mm: Vector3::new(5.0, 6.0, 7.0), direction: Vector3::z() };
    let near = [0.0, 0.0, 0.0, 0.3, 1.25];
    let s = chain.inverse(&straight, &near);
    assert_eq!(s.len(), 1);
    assert_eq!(s[0].singularity, Some(Singularity::Free(AxisName::C)));
    assert_eq!((s[0].joints[3], s[0].joints[4]), (0.0, 1.25), "the free axis stays where it is");
    assert!((chain.forward(&s[0].joints).position_mm - straight.position_mm).norm() < 1e-9);

    // The tool leaning 60°: B = ±60°; down past the limit: both are outside.
    for (lean, inside) in [(60.0_f64, true), (120.0, false)] {
        let q = [0.0, 0.0, 0.0, lean.to_radians(), 0.5];
        let s = chain.inverse(&chain.forward(&q), &[0.0, 0.0, 0.0, 0.0, 6.0]);
        assert_eq!(s.len(), 2);
        assert!(s.iter().all(|s| s.outside.is_none() == inside));
        assert!((s[0].joints[3] + s[1].joints[3]).abs() < 1e-12);
        assert!(s.iter().all(|s| s.joints[4].abs() <= TAU), "{s:?}");
    }

    // A nutating head (B tilted 45°) cannot point down again past its cone.
    let mut nutating = Machine::head_c_b(200.0);
    nutating.axes.entry("B".into()).or_default().direction = Some([0.0, 1.0, 1.0]);
    let chain = nutating.chain().unwrap();
    let level = chain.forward(&[0.0, 0.0, 0.0, PI, 0.0]);
    assert!(level.direction.z.abs() < 1e-12, "half a turn brings the tool level");
    let edge = chain.inverse(&level, &[0.0; 5]);
    assert_eq!(edge[0].singularity, Some(Singularity::Edge));
    let below = ToolPose { direction: Vector3::new(0.6, 0.0, -0.8), ..level };
    assert!(chain.inverse(&below, &[0.0; 5]).is_empty());
}

#[test]
fn next_to_a_singular_direction_the_pose_is_still_held() {
    for order in ["w C b X Y Z B t", "w C A b X Y Z t", "w b X Y Z C B t"] {
        let mut machine = cell();
        machine.kinematics.order = order.into();
        let chain = machine.chain().unwrap();
        for exponent in 0..=16 {
            let lean = 10f64.powi(-exponent);
            for direction in
                [Vector3::new(lean, -0.3 * lean, 1.0), Vector3::new(0.2 * lean, lean, -1.0)]
            {
                let pose = ToolPose {
                    position_mm: Vector3::new(50.0, -20.0, 30.0),
                    direction: direction.normalize(),
                };
                let solutions = chain.inverse(&pose, &[0.0; 5]);
                assert!(!solutions.is_empty(), "{order} {lean}");
                for s in solutions {
                    let back = chain.forward(&s.joints);
                    assert!(
                        (back.position_mm - pose.position_mm).norm() < 1e-9,
                        "{order} {lean} {s:?}"
                    );
                    // What is called singular is within 1e-7 rad of it.
                    assert!(
                        (back.direction - pose.direction).norm() < 1.1e-7,
                        "{order} {lean} {s:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_machine_file_goes_round_and_refuses_what_it_does_not_know() {
    let text = r#"
schema = 1
name = "cell 3"
c_sense = -1
x_serial = 17

[head]
delta_x_mm = 0.283
r_mm = 214.7
standoff_mm = 1.5

[table]
xc_mm = 412.3
yc_mm = -87.6
zc_mm = -310.2

[target]
position_mm = [80.0, 0.0, 100.0]

[axes.B]
sense = -1
limits_deg = [-110.0, 110.0]

[[effects]]
name = "b-backlash"
parameters = { width_deg = 0.0042 }
"#;
    let machine = Machine::parse("m.toml", text).unwrap();
    let effect = Effect {
        name: "b-backlash".into(),
        parameters: [("width_deg".to_owned(), 0.0042)].into(),
        ..Effect::default()
    };
    assert_eq!(machine.effects, [effect]);
    assert_eq!(Machine::parse("again.toml", &machine.to_toml()).unwrap(), machine);

    for (from, to, words) in [
        ("schema = 1", "schema = 2", "schema: is 2"),
        ("c_sense = -1", "c_sense = 0", "c_sense: is 0"),
        ("r_mm = 214.7", "r_m = 0.2147", "r_m"),
        ("r_mm = 214.7", "r_mm = nan", "head"),
        ("limits_deg = [-110.0, 110.0]", "limits_deg = [110.0, -110.0]", "axes.B: limits"),
        ("[axes.B]", "[axes.C]", "give c_sense"),
        ("[axes.B]", "[kinematics]\norder = \"w b X Y Z C B t\"\n[axes.B]", "c_sense: is for a C"),
        ("[axes.B]", "[axes.A]", "no axis for the section [axes.A]"),
        ("[axes.B]", "[kinematics]\norder = \"w C b X Y Z t\"\n[axes.B]", "five axes"),
    ] {
        let message = Machine::parse("m.toml", &text.replace(from, to)).unwrap_err().to_string();
        assert!(message.contains("m.toml") && message.contains(words), "{words}: {message}");
    }
}

fn rtcp(way: &str, machine: &Path, poses: &Path) -> String {
    let output = Command::cargo_bin("pivotsight")
        .unwrap()
        .args(["rtcp", way, "--format", "csv", "--machine"])
        .arg(machine)
        .arg("--poses")
        .arg(poses)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn numbers(text: &str) -> Vec<Vec<f64>> {
    let rows = text.lines().filter(|l| !l.starts_with('#')).skip(1);
    rows.map(|l| l.split(',').map(|c| c.parse().unwrap()).collect()).collect()
}

#[test]
fn a_real_controls_joint_positions_are_reproduced() {
    let Ok(reference) = std::fs::read_to_string(MAXKINS) else {
        println!("skipped: {MAXKINS} is not here");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let machine = folder.path().join("machine.toml");
    let text = "schema = 1\nc_sense = -1\n[head]\ndelta_x_mm = -0.283\nr_mm = 214.7\n";
    std::fs::write(&machine, text).unwrap();
    let reference = numbers(&reference);
    let poses = folder.path().join("poses.csv");
    let lines: String = reference
        .iter()
        .map(|r| format!("{:.9},{:.9},{:.9},{:.9},{:.9}\n", r[0], r[1], r[2], r[3], r[4]))
        .collect();
    std::fs::write(&poses, format!("x_mm,y_mm,z_mm,b_deg,c_deg\n{lines}")).unwrap();
    let out = rtcp("inverse", &machine, &poses);
    assert!(out.starts_with("x_mm,y_mm,z_mm,b_deg,c_deg,jx_mm,jy_mm,jz_mm\n"));
    let found = numbers(&out);
    assert_eq!(found.len(), reference.len());
    let worst = found
        .iter()
        .zip(&reference)
        .flat_map(|(f, r)| (0..8).map(|i| (f[i] - r[i]).abs()))
        .fold(0.0, f64::max);
    assert!(worst <= 1e-6, "{worst}");

    // And back: machine coordinates → the tool points it started from.
    let lines: String = found
        .iter()
        .map(|r| format!("{:.9},{:.9},{:.9},{:.9},{:.9}\n", r[5], r[6], r[7], r[3], r[4]))
        .collect();
    std::fs::write(&poses, format!("x_mm,y_mm,z_mm,b_deg,c_deg\n{lines}")).unwrap();
    let back = numbers(&rtcp("forward", &machine, &poses));
    let worst = back
        .iter()
        .zip(&reference)
        .flat_map(|(f, r)| (0..3).map(|i| (f[5 + i] - r[i]).abs()))
        .fold(0.0, f64::max);
    assert!(worst <= 3e-9, "{worst}");
}

#[test]
fn the_machine_command_lists_the_axes_and_draws_the_frames() {
    let folder = tempfile::tempdir().unwrap();
    let (machine, figure) = (folder.path().join("machine.toml"), folder.path().join("frames.svg"));
    std::fs::write(&machine, cell().to_toml()).unwrap();
    let command = Command::cargo_bin("pivotsight")
        .unwrap()
        .args(["machine", "--format", "json"])
        .arg(&machine)
        .arg("--figure")
        .arg(&figure)
        .assert()
        .success();
    let json: serde_json::Value = serde_json::from_slice(&command.get_output().stdout).unwrap();
    let names: String =
        json["axes"].as_array().unwrap().iter().map(|a| a["name"].as_str().unwrap()).collect();
    assert_eq!(names, "CXYZB");
    assert!(std::fs::read_to_string(figure).unwrap().contains("ΔX +0.2830"));
}

#[test]
fn a_machine_in_metres_is_doubted() {
    let folder = tempfile::tempdir().unwrap();
    let (machine, poses) = (folder.path().join("machine.toml"), folder.path().join("p.csv"));
    std::fs::write(&poses, "x_mm,y_mm,z_mm,b_deg,c_deg\n0,0,0,30,0\n").unwrap();
    for (r_mm, doubted) in [(0.2147, true), (214.7, false)] {
        let mut cell = cell();
        cell.head.r_mm = r_mm;
        std::fs::write(&machine, cell.to_toml()).unwrap();
        for args in [
            &["machine"][..],
            &["rtcp", "inverse", "--machine"],
            &["export", "--control", "sheet", "--machine"],
        ] {
            let mut command = Command::cargo_bin("pivotsight").unwrap();
            command.args(args).arg(&machine);
            if args[0] == "rtcp" {
                command.arg("--poses").arg(&poses);
            }
            let out = command.assert().success().get_output().clone();
            let said = String::from_utf8(out.stderr).unwrap();
            assert_eq!(
                said.contains("if it is in metres, write 214.7"),
                doubted,
                "{args:?}: {said}"
            );
        }
    }
}

#[test]
fn a_tool_direction_gives_all_solutions_and_names_the_singular_one() {
    let folder = tempfile::tempdir().unwrap();
    let (machine, poses) = (folder.path().join("machine.toml"), folder.path().join("poses.csv"));
    std::fs::write(&machine, cell().to_toml() + "[axes.B]\nlimits_deg = [-100.0, 45.0]\n").unwrap();
    std::fs::write(&poses, "x_mm,y_mm,z_mm,i,j,k\n5,6,7,0.866025403784,0,0.5\n5,6,7,0,0,1\n")
        .unwrap();
    let out = rtcp("inverse", &machine, &poses);
    let rows: Vec<Vec<&str>> = out.lines().map(|l| l.split(',').collect()).collect();
    assert_eq!(
        rows[0],
        "pose,solution,jx_mm,jy_mm,jz_mm,b_deg,c_deg,note".split(',').collect::<Vec<_>>()
    );
    let b: Vec<f64> = rows[1..].iter().map(|r| r[5].parse().unwrap()).collect();
    assert!((b[0] + 60.0).abs() < 1e-6 && (b[1] - 60.0).abs() < 1e-6 && b[2] == 0.0, "{out}");
    assert_eq!(rows[2][7], "B outside its limits");
    assert_eq!(rows[3][7], "tool along C: C is free");
    assert_eq!(rows.len(), 4, "{out}");
    // A pose that no solution within the limits holds is counted; one that another solution holds is not.
    std::fs::write(&poses, "x_mm,y_mm,z_mm,i,j,k\n5,6,7,0.866025403784,0,0.5\n5,6,7,0,0,-1\n")
        .unwrap();
    let output = Command::cargo_bin("pivotsight")
        .unwrap()
        .args(["rtcp", "inverse", "--machine"])
        .args([&machine, Path::new("--poses"), &poses])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("warning: 1 of 2 poses lie outside the axes' limits"), "{said}");
}

#[test]
fn bad_poses_are_refused_by_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let machine = folder.path().join("machine.toml");
    std::fs::write(&machine, cell().to_toml()).unwrap();
    for (text, words) in [
        ("x_mm,y_mm,z_mm,b_deg\n1,2,3,4\n", "column 'c_deg': is missing"),
        ("x_mm,y_mm,z_mm,b_deg,c_rad\n1,2,3,4,5\n", "column 'c_rad': is not known"),
        ("x_mm,y_mm,z_mm,b_deg,c_deg\n1,2,NaN,4,5\n", ":2: column 'z_mm'"),
        ("", "is empty"),
        ("x_mm,y_mm,z_mm,i,j,k\n1,2,3,0,0,0\n", "length of i, j, k is 0.000000"),
        (
            "x_mm,y_mm,z_mm,i,j,k\n1,2,3,0,0,1\n1,2,3,0,0,5\n",
            ":3: column 'i': the length of i, j, k is 5",
        ),
        ("x_mm,y_mm,z_mm,i,j,k,b_deg\n1,2,3,0,0,1,5\n", "column 'b_deg': does not go"),
    ] {
        let poses = folder.path().join("poses.csv");
        std::fs::write(&poses, text).unwrap();
        let output = Command::cargo_bin("pivotsight")
            .unwrap()
            .args(["rtcp", "inverse", "--machine"])
            .arg(&machine)
            .arg("--poses")
            .arg(&poses)
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(words) && output.stdout.is_empty(), "{message}");
    }
}
