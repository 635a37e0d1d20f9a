//! Alignment: truth from a tilted blank, the path follows the blank, round trips, refusals by line, held paths.

#![allow(clippy::unwrap_used)]

use std::fmt::Write;
use std::path::Path;

use assert_cmd::Command;
use nalgebra::{Rotation3, Vector3};
use pivotsight::align::apply::{Options, apply};
use pivotsight::align::{Alignment, Touches, fit};
use pivotsight::machine::{Machine, ToolPose};
use pivotsight::table::Table;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};

/// A blank that lies at `shift`, tilted so that `Ry(b) Rx(a)` levels it: touches with noise.
fn touches(
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

fn fitted(csv: &str, options: &fit::Options) -> Alignment {
    let table =
        Table::parse("t.csv", csv.as_bytes(), &["kind", "x_mm", "y_mm", "z_mm"], &[]).unwrap();
    fit(&Touches::from_table(&table).unwrap(), options, &mut Vec::new()).unwrap()
}

const IDEAL: fit::Options =
    fit::Options { z_ideal_mm: 50.0, center_ideal_mm: [0.0, 0.0], c_deg: 0.0, touch_u_mm: None };

/// One touch of five that is 5 mm off leaves a tilt that nobody should cut by, and says so.
#[test]
fn a_touch_far_off_the_face_is_told() {
    let good = touches(0.3, -0.2, Vector3::zeros(), 5, 0.003, 3);
    let fit = |csv: &str| {
        let table = Table::parse("t.csv", csv.as_bytes(), &["kind", "x_mm", "y_mm", "z_mm"], &[]);
        let mut told = Vec::new();
        let alignment = fit(&Touches::from_table(&table.unwrap()).unwrap(), &IDEAL, &mut told);
        told.extend(alignment.unwrap().doubts());
        told
    };
    assert!(fit(&good).is_empty());
    let wrong: Vec<String> = good
        .lines()
        .enumerate()
        .map(|(i, line)| match (i, line.rsplit_once(',')) {
            (2, Some((head, z))) => format!("{head},{}", z.parse::<f64>().unwrap() + 5.0),
            _ => line.to_owned(),
        })
        .collect();
    let told = fit(&wrong.join("\n")).join("; ");
    assert!(told.contains("off their plane") && told.contains("° only"), "{told}");
}

#[test]
fn sides_touched_at_different_heights_give_one_axis() {
    let (a, b) = (0.8f64.to_radians(), (-1.3f64).to_radians());
    let level = Rotation3::from_axis_angle(&Vector3::y_axis(), b)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), a);
    let mut csv = String::from("kind,x_mm,y_mm,z_mm\n");
    for (x, y) in [(-90.0, -90.0), (90.0, -90.0), (0.0, 90.0)] {
        let p = level.inverse() * Vector3::new(x, y, 50.0);
        writeln!(csv, "face,{:.9},{:.9},{:.9}", p.x, p.y, p.z).unwrap();
    }
    let axis = level.inverse() * Vector3::new(5.0, 2.0, 0.0);
    let up = level.inverse() * Vector3::z();
    let at = |z: f64| axis + up * ((z - axis.z) / up.z);
    for side in [-150.0, 150.0] {
        let (x, y) = (at(20.0), at(-80.0));
        writeln!(csv, "side_x,{:.9},{:.9},{:.9}", x.x + side, x.y, x.z).unwrap();
        writeln!(csv, "side_y,{:.9},{:.9},{:.9}", y.x, y.y + side, y.z).unwrap();
    }
    let alignment = fitted(&csv, &IDEAL);
    let (center, expected) = (alignment.center_mm.unwrap(), at(alignment.center_z_mm));
    assert!((center[0] - expected.x).abs() < 1e-6 && (center[1] - expected.y).abs() < 1e-6);
}

#[test]
fn the_path_lands_on_the_tilted_blank_and_not_on_its_mirror_image() {
    let shift = Vector3::new(3.0, -2.0, 1.5);
    let alignment = fitted(&touches(0.8, -1.3, shift, 3, 0.0, 0), &IDEAL);
    assert!((alignment.a_deg - 0.8).abs() < 1e-7 && (alignment.b_deg + 1.3).abs() < 1e-7);
    // A point of the part, where the program has it, must come to lie where the blank has it.
    let level = Rotation3::from_axis_angle(&Vector3::y_axis(), (-1.3f64).to_radians())
        * Rotation3::from_axis_angle(&Vector3::x_axis(), 0.8f64.to_radians());
    for p in [Vector3::new(0.0, 0.0, 50.0), Vector3::new(70.0, -40.0, 10.0)] {
        let on_blank = level.inverse() * p + shift;
        let moved = alignment.motion() * nalgebra::Point3::from(p);
        assert!((moved.coords - on_blank).norm() < 1e-6, "{moved} {on_blank}");
    }
}

#[test]
fn stated_intervals_hold() {
    let shift = Vector3::new(0.4, -0.3, 0.2);
    let truth = fitted(&touches(0.3, 0.5, shift, 8, 0.0, 0), &IDEAL);
    let [cx, cy] = truth.center_mm.unwrap();
    for (touch_u_mm, face) in [(None, 8), (Some(0.003), 3)] {
        let (mut inside, mut all) = (0, 0);
        for seed in 0..300 {
            let options = fit::Options { touch_u_mm, ..IDEAL };
            let got = fitted(&touches(0.3, 0.5, shift, face, 0.003, seed), &options);
            let ([x, y], [ux, uy]) = (got.center_mm.unwrap(), got.center_u95_mm.unwrap());
            for (value, true_value, u95) in [
                (got.a_deg, truth.a_deg, got.a_u95_deg),
                (got.b_deg, truth.b_deg, got.b_u95_deg),
                (got.dz_mm, truth.dz_mm, got.dz_u95_mm),
                (x, cx, ux),
                (y, cy, uy),
            ] {
                all += 1;
                inside += usize::from((value - true_value).abs() <= u95);
            }
        }
        let percent = 100.0 * inside as f64 / all as f64;
        assert!((92.5..97.5).contains(&percent), "{percent} %");
    }
}

fn machine() -> Machine {
    Machine::read("docs/examples/machine-ac.toml").unwrap()
}

/// A path over a dome, away from the pole.
fn dome(lines: usize) -> Vec<ToolPose> {
    (0..lines)
        .map(|i| {
            let t = 0.0007 * i as f64;
            let tilt = 0.4 + 0.2 * (2.0 * t).sin();
            let direction = Vector3::new(tilt.sin() * t.cos(), tilt.sin() * t.sin(), tilt.cos());
            ToolPose { position_mm: Vector3::new(80.0 * t.cos(), 70.0 * t.sin(), 40.0), direction }
        })
        .collect()
}

fn write_cl(path: &Path, poses: &[ToolPose]) {
    let mut text = String::from("x_mm,y_mm,z_mm,i,j,k\n");
    for ToolPose { position_mm: p, direction: d } in poses {
        writeln!(text, "{:.9},{:.9},{:.9},{:.12},{:.12},{:.12}", p.x, p.y, p.z, d.x, d.y, d.z)
            .unwrap();
    }
    std::fs::write(path, text).unwrap();
}

/// All numbers of a file, line by line.
fn numbers(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .map(|l| {
            l.split([',', ' '])
                .filter_map(|w| {
                    w.trim_start_matches(|c: char| c.is_ascii_alphabetic()).parse().ok()
                })
                .collect()
        })
        .collect()
}

#[test]
fn a_hundred_thousand_lines_go_there_and_back_to_a_nanometre_and_post_to_the_machine() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name);
    let alignment = fitted(&touches(0.8, -1.3, Vector3::new(3.0, -2.0, 1.5), 5, 0.0, 0), &IDEAL);
    // Without limits: with them the program may rightly come back on the other side of the pole.
    let (machine, there) = (Machine::table_a_c(0.05, 60.0), Options::default());
    let back = Options { inverse: true, ..Options::default() };
    let poses = dome(100_000);
    write_cl(&file("in.cl"), &poses);
    apply(&alignment, &machine, &file("in.cl"), &file("on.cl"), &there).unwrap();
    apply(&alignment, &machine, &file("on.cl"), &file("back.cl"), &back).unwrap();
    for (a, b) in numbers(&file("in.cl")).iter().zip(numbers(&file("back.cl"))) {
        assert!(a.iter().zip(&b).all(|(x, y)| (x - y).abs() < 1e-6), "{a:?} {b:?}");
    }

    let report = apply(&alignment, &machine, &file("in.cl"), &file("on.nc"), &there).unwrap();
    // What the machine then does, by its forward kinematics, is the moved CL data.
    let chain = machine.chain().unwrap();
    let posted: Vec<Vec<f64>> =
        numbers(&file("on.nc")).into_iter().skip(2).filter(|r| r.len() == 6).collect();
    let moved = numbers(&file("on.cl"));
    assert_eq!(posted.len() as u64, 100_000 + report.log.added);
    if report.log.added == 0 {
        for (q, want) in posted.iter().zip(&moved[1..]) {
            let pose = chain.forward(&[q[1], q[2], q[3], q[4].to_radians(), q[5].to_radians()]);
            let (p, d) = (pose.position_mm, pose.direction);
            let got = [p.x, p.y, p.z, d.x, d.y, d.z];
            assert!(got.iter().zip(want).all(|(a, b)| (a - b).abs() < 3e-6), "{got:?} {want:?}");
        }
    }
    let fine = Options { decimals: Some(9), ..Options::default() };
    apply(&alignment, &machine, &file("on.nc"), &file("on2.nc"), &fine).unwrap();
    apply(
        &alignment,
        &machine,
        &file("on2.nc"),
        &file("on3.nc"),
        &Options { inverse: true, ..fine },
    )
    .unwrap();
    for (a, b) in numbers(&file("on.nc")).iter().zip(numbers(&file("on3.nc"))) {
        assert!(a.iter().zip(&b).all(|(x, y)| (x - y).abs() < 1e-6), "{a:?} {b:?}");
    }
}

#[test]
fn a_straight_path_stays_straight_between_the_points() {
    let dir = tempfile::tempdir().unwrap();
    let (cl, nc) = (dir.path().join("p.cl"), dir.path().join("p.nc"));
    // Two long moves; the second passes one degree from the pole.
    std::fs::write(
        &cl,
        "80 0 40 0.45 0 0.8930286\n0 80 40 0 0.45 0.8930286\n0 -80 40 0.02 -0.45 0.8928046\n",
    )
    .unwrap();
    let alignment = fitted(&touches(0.0, 0.0, Vector3::zeros(), 4, 0.0, 0), &IDEAL);
    let report = apply(&alignment, &machine(), &cl, &nc, &Options::default()).unwrap();
    assert!(report.log.added > 20 && report.log.long_rotary.count > 0);
    assert_eq!(report.log.not_held.count, 0);
    let corners = [
        Vector3::new(80.0, 0.0, 40.0),
        Vector3::new(0.0, 80.0, 40.0),
        Vector3::new(0.0, -80.0, 40.0),
    ];
    assert_on_path(&nc, &machine(), &corners);
}

#[test]
fn a_path_that_nearly_meets_the_pole_is_held() {
    let dir = tempfile::tempdir().unwrap();
    let (cl, nc) = (dir.path().join("p.cl"), dir.path().join("p.nc"));
    let head_b = dir.path().join("m.toml");
    std::fs::write(
        &head_b,
        "schema = 1\nname = \"m\"\n[head]\ndelta_x_mm = 0.3\nr_mm = 214.7\nstandoff_mm = 1\n\
         [table]\nxc_mm = 400\nyc_mm = -87\nzc_mm = -310\n",
    )
    .unwrap();
    let alignment = fitted(&touches(0.0, 0.0, Vector3::zeros(), 4, 0.0, 0), &IDEAL);
    for machine in [machine(), Machine::read(&head_b).unwrap()] {
        // The tool's direction passes the C axis at `miss` rad: C turns by nearly half a turn there.
        for miss in [0.0, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3] {
            let text = format!(
                "60 80 40 {miss} 0.02 0.9998\n60 40 40 {miss} 0.003 0.9999955\n\
                 60 -30 40 {miss} -0.004 0.999992\n60 -80 40 {miss} -0.02 0.9998\n"
            );
            std::fs::write(&cl, text).unwrap();
            let log = apply(&alignment, &machine, &cl, &nc, &Options::default()).unwrap().log;
            assert_eq!(log.not_held.count, 0, "passing at {miss}");
            assert!(log.added < 4096);
            let ends = [Vector3::new(60.0, 80.0, 40.0), Vector3::new(60.0, -80.0, 40.0)];
            assert_on_path(&nc, &machine, &ends);
        }
    }
}

/// The posted moves, joints straight between them, stay by the polyline through `corners`.
fn assert_on_path(nc: &Path, machine: &Machine, corners: &[Vector3<f64>]) {
    let chain = machine.chain().unwrap();
    let rows: Vec<Vec<f64>> = numbers(nc).into_iter().filter(|r| r.len() == 6).collect();
    let joints = |r: &[f64]| [r[1], r[2], r[3], r[4].to_radians(), r[5].to_radians()];
    for pair in rows.windows(2) {
        let (a, b) = (joints(&pair[0]), joints(&pair[1]));
        for part in [0.2, 0.4, 0.6, 0.8] {
            let q = std::array::from_fn(|i| a[i] + part * (b[i] - a[i]));
            let p = chain.forward(&q).position_mm;
            let off = corners
                .windows(2)
                .map(|c| {
                    let along = c[1] - c[0];
                    let t = ((p - c[0]).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                    (p - c[0] - along * t).norm()
                })
                .fold(f64::INFINITY, f64::min);
            assert!(off < 0.0075, "{off} mm off the path at {p}");
        }
    }
}

#[test]
fn what_cannot_be_moved_is_refused_by_line_number() {
    let dir = tempfile::tempdir().unwrap();
    let alignment = fitted(&touches(0.5, 0.5, Vector3::zeros(), 4, 0.0, 0), &IDEAL);
    let first = "G21 G90 (start)\nG1 X0 Y0 Z100 A-20 C0 F500\n";
    for (name, text, words) in [
        ("a.nc", format!("{first}G2 X10 Y0 I5 J0\n"), "a.nc:3: block: G2 is an arc"),
        ("a.nc", format!("{first}N30 G03 X10 Y0 R5\n"), "G3 is an arc"),
        ("a.nc", format!("{first}G81 X10 Y0 Z-5 R2\n"), "G81 is a canned cycle"),
        ("a.nc", format!("{first}CYCLE83(1,2)\n"), "CYCLE is a canned cycle"),
        ("a.nc", format!("{first}G91\n"), "incremental"),
        ("a.nc", format!("{first}G1 X=R1\n"), "X' is not followed"),
        ("a.nc", format!("{first}G1 X#101\n"), "'X' is not followed"),
        ("a.nc", format!("{first}G41 D1 X5\n"), "cutter radius"),
        ("a.nc", format!("{first}M98 P100\n"), "subprogram"),
        ("a.nc", format!("{first}G1 B5\n"), "does not have"),
        ("a.nc", format!("{first}G1 X5 STOPRE Y5\n"), "own"),
        ("a.nc", format!("{first}TRAORI\n"), "--rtcp"),
        ("a.nc", format!("{first}G43.4 H1\n"), "--rtcp"),
        ("a.nc", format!("{first}G1 X1e-05\n"), "X1e-... has a power of ten"),
        ("a.nc", format!("{first}G28 Z0\nG1 X5\n"), "a.nc:4: block: the position of Y"),
        ("a.nc", "G1 Z5\n".into(), "position of X is not known"),
        ("a.nc", "X0 Y0 Z0 A0 C0\n".into(), "before any G0 or G1"),
        ("a.nc", format!("{first}G1 A-125\n"), "axis A would leave its limits"),
        ("a.nc", "(nothing)\n".into(), "holds no move"),
        ("a.cl", "1 2 3 0 0 1\n1 2\n".into(), "a.cl:2: block: has 2 numbers"),
        ("a.cl", "1 2 3 0 0 2\n".into(), "unit vector"),
        ("a.cl", "1 2 NaN 0 0 1\n".into(), "no coordinate"),
        ("a.apt", "GOTO/1,2,3\nCIRCLE/0,0,0,0,0,1,5\n".into(), "a.apt:2: block: CIRCLE is an arc"),
        ("a.nc", format!("{first}M128\n"), "--rtcp"),
        ("rtcp.nc", format!("{first}M129\nG1 X5\n"), "rtcp.nc:4: block: moves while RTCP is"),
        ("rtcp.nc", format!("{first}TRAFOOF\nG1 X5\n"), "moves while RTCP is switched off"),
        ("rtcp.nc", format!("{first}G49\nG0 Z9\nG43.4 H1\n"), "moves while RTCP is switched off"),
        (
            "a.nc",
            format!("{first}G55\nG1 X5\n"),
            "a.nc:4: block: moves after the zero offset changed",
        ),
        ("a.nc", format!("G54.1 P1\n{first}G54.1 P3\nG1 X5\n"), "zero offset changed"),
        ("a.nc", format!("G43 H1\n{first}G43 H2\nG1 X5\n"), "tool or its length changed"),
        ("a.nc", format!("G54 P1\n{first}G54 P2\nG1 X5\n"), "zero offset changed"),
        ("a.nc", format!("T1 D1\n{first}T2 D1\nG1 X5\n"), "tool or its length changed"),
        ("a.nc", format!("T1 M6\n{first}T2 M6\nG1 X5\n"), "tool or its length changed"),
        ("a.nc", format!("G43 H1\n{first}G49\nG1 X5\n"), "tool or its length changed"),
        ("a.apt", "CYCLE/DRILL,5\n".into(), "canned cycle"),
        ("a.apt", "UNITS/INCHES\nGOTO/1,2,3,0,0,1\n".into(), "in inches"),
        ("a.apt", "CUTCOM/LEFT\n".into(), "cutter compensation"),
        ("a.apt", "CALL/SUB\n".into(), "subprogram"),
        ("a.apt", "TRANS/0,0,5\n".into(), "a shift"),
        (
            "a.apt",
            "FEDRAT/.3,MMPR\nGOTO/1,2,3,0,0,1\n".into(),
            "a.apt:1: block: FEDRAT gives the feed as MMPR",
        ),
    ] {
        let input = dir.path().join(name);
        std::fs::write(&input, text).unwrap();
        let output = dir.path().join("out.nc");
        let options = Options { rtcp: name == "rtcp.nc", ..Options::default() };
        let message =
            apply(&alignment, &machine(), &input, &output, &options).unwrap_err().to_string();
        assert!(message.contains(words), "{words}: {message}");
        assert!(!output.exists(), "a refused program leaves no half of itself");
    }
    // Switched off at the end, or before it is switched on, RTCP does no harm, nor do statements that move nothing.
    let rtcp = Options { rtcp: true, ..Options::default() };
    for (name, text, options) in [
        ("a.nc", "G49\nG43.4 H1\nG1 X0 Y0 Z100 A-20 C0 F500\nG49\nM30\n", &rtcp),
        ("a.nc", "G43.4 H1\nG1 X0 Y0 Z100 A-20 C0 F500\nG43.4 H2\nG1 X5\n", &rtcp),
        (
            "a.nc",
            "G54\nG43 H1\nG1 X0 Y0 Z100 A-20 C0 F500\nG54 G1 X5\nT2 H5\nX6\nG49\nM30\n",
            &Options::default(),
        ),
        ("a.apt", "UNITS/MM\nORIGIN/0,0,0\nCUTCOM/OFF\nGOTO/1,2,3,0,0,1\n", &Options::default()),
    ] {
        let input = dir.path().join(name);
        std::fs::write(&input, text).unwrap();
        apply(&alignment, &machine(), &input, &dir.path().join("out.nc"), options).unwrap();
    }
    // A feed in inches is one in mm; what each machine has its own words for is counted.
    let (input, output) = (dir.path().join("ipm.apt"), dir.path().join("ipm.nc"));
    std::fs::write(&input, "FEDRAT/30,IPM\nSPINDL/900,CLW\nGOTO/1,2,3,0,0,1\nFINI\n").unwrap();
    let report = apply(&alignment, &machine(), &input, &output, &Options::default()).unwrap();
    assert!(std::fs::read_to_string(output).unwrap().contains("F762\n"));
    assert_eq!(report.log.left_out.first_lines, [2]);
    // What moves nothing passes as it stands, words in place, and inverse time is shared out.
    let input = dir.path().join("a.nc");
    std::fs::write(&input, "%\nO100 (JOB)\nG21 G90 G54\nT5 M6\nG4 X1.5\nG0 X0 Y0 Z100 A-20 C0 S900 M3\nG93\nN9 G1 C90 F2 M7 M5 (TURN)\nM30\n").unwrap();
    let output = dir.path().join("out.nc");
    apply(&alignment, &machine(), &input, &output, &Options::default()).unwrap();
    let text = std::fs::read_to_string(output).unwrap();
    assert!(text.starts_with("%\nO100 (JOB)\nG21 G90 G54\nT5 M6\nG4 X1.5\nG0 S900 M3 X"), "{text}");
    assert!(text.contains("(TURN)\n") && text.ends_with("M30\n"), "{text}");
    // What begins with a move does so on its first block, what ends with it on its last.
    let begins = text.lines().position(|l| l.contains("M7")).unwrap();
    let ends = text.lines().position(|l| l.contains("M5")).unwrap();
    assert!(text.lines().nth(begins).unwrap().contains("(TURN)"), "{text}");
    assert!(ends > begins && ends + 2 == text.lines().count(), "{text}");
    let rates: Vec<f64> = text
        .lines()
        .filter_map(|l| l.split_whitespace().find_map(|w| w.strip_prefix('F')?.parse().ok()))
        .collect();
    assert!(
        rates.len() > 1 && (rates.iter().map(|f| 1.0 / f).sum::<f64>() - 0.5).abs() < 1e-4,
        "{rates:?}"
    );
    // And evenly: the table turns at about one speed however unlike the pieces are.
    let turns: Vec<f64> = text
        .lines()
        .filter_map(|l| l.split_whitespace().find_map(|w| w.strip_prefix('C')?.parse().ok()))
        .collect();
    let speeds: Vec<f64> =
        turns.windows(2).zip(&rates).map(|(c, f)| (c[1] - c[0]).abs() * f).collect();
    let range = speeds.iter().fold((f64::MAX, 0.0_f64), |r, s| (r.0.min(*s), r.1.max(*s)));
    assert!(range.1 < 1.5 * range.0, "{speeds:?}");
}

#[test]
fn the_command_measures_applies_and_names_bad_touches() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name);
    let command = || {
        let mut c = Command::cargo_bin("pivotsight").unwrap();
        c.args(["--quiet", "align"]);
        c
    };
    let out = command()
        .args(["docs/examples/blank.csv", "--z-ideal-mm", "50", "--format", "json"])
        .output()
        .unwrap();
    std::fs::write(file("a.json"), &out.stdout).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(json["schema"], "pivotsight.align/1");
    assert!((json["center_mm"][0].as_f64().unwrap() - 5.41).abs() < 1e-9);
    command()
        .arg("apply")
        .args(["--machine", "docs/examples/machine-ac.toml", "docs/examples/path.apt", "--align"])
        .arg(file("a.json"))
        .arg(file("p.nc"))
        .assert()
        .success();
    // A program as an editor on Windows saves it: read all the same, and its line ends kept.
    let path = std::fs::read_to_string("docs/examples/path.apt").unwrap();
    std::fs::write(file("w.apt"), format!("\u{feff}{}", path.replace('\n', "\r\n"))).unwrap();
    let mut windows = command();
    windows.args(["apply", "--machine", "docs/examples/machine-ac.toml", "--align"]);
    windows.args(["a.json", "w.apt", "w.nc"].map(file)).assert().success();
    let [unix, windows] = ["p.nc", "w.nc"].map(|name| std::fs::read_to_string(file(name)).unwrap());
    assert_eq!(unix.replace('\n', "\r\n"), windows);
    // Three numbers with decimal commas, or six without.
    std::fs::write(file("c.cl"), "10,0 20,0 0,1\n").unwrap();
    let mut comma = command();
    comma.args(["apply", "--machine", "docs/examples/machine-ac.toml", "--align"]);
    let out =
        comma.args(["a.json", "c.cl", "c.out"].map(file)).assert().code(2).get_output().clone();
    assert!(String::from_utf8(out.stderr).unwrap().contains("decimal points"));
    for (text, words) in [
        ("face,0,0,0\nface,1,1,0\n", "2 face points"),
        ("face,0,0,0\nface,10,10,0\nface,20,20,0\n", "on a line"),
        ("face,0,0,0\nface,0,10,0\nface,0,0,10\n", "45"),
        ("edge,0,0,0\n", "'edge'"),
        ("face,0,0,0\nface,9,0,0\nface,0,9,0\nside_x,5,0,0\n", "one side_x"),
        ("face,0,0,0\nface,9,0,0\nface,0,9,0\nside_x,5,0,0\nside_x,5,0,0\n", "one side"),
        ("face,0,0,0\nface,9,0,0\nface,0,9,0\nside_x,5,0,0\nside_x,5.1,9,0\n", "one side"),
    ] {
        std::fs::write(file("t.csv"), format!("kind,x_mm,y_mm,z_mm\n{text}")).unwrap();
        let out = command().arg(file("t.csv")).assert().code(2).get_output().clone();
        let message = String::from_utf8(out.stderr).unwrap();
        assert!(message.contains(words), "{words}: {message}");
    }
}

/// Sides that are rougher than the face say so by themselves, and four points of a face may agree by chance.
#[test]
fn rough_sides_and_few_points_have_intervals_that_hold() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(6);
    let mut draw = |sd: f64| Normal::new(0.0, sd).unwrap().sample(&mut random);
    let (mut held, mut worst): (usize, f64) = (0, 0.0);
    for _ in 0..100 {
        let mut out = String::from("kind,x_mm,y_mm,z_mm\n");
        for (x, y) in [(-50, -50), (50, -50), (50, 50), (-50, 50), (0, 10), (20, -30), (-30, 0)] {
            writeln!(out, "face,{x},{y},{:.6}", 50.0 + draw(0.001)).unwrap();
        }
        for side in [-60.0, 60.0] {
            for along in [-40.0, -20.0, 0.0, 20.0, 40.0] {
                writeln!(out, "side_x,{:.6},{along},30", side + draw(0.004)).unwrap();
                writeln!(out, "side_y,{along},{:.6},30", side + draw(0.004)).unwrap();
            }
        }
        let found = fitted(&out, &IDEAL);
        held += usize::from(found.center_mm.unwrap()[0].abs() < found.center_u95_mm.unwrap()[0]);
        let mut few = String::from("kind,x_mm,y_mm,z_mm\n");
        for (x, y) in [(-50, -50), (50, -50), (50, 50), (-50, 50)] {
            writeln!(few, "face,{x},{y},{:.6}", 50.0 + draw(0.002)).unwrap();
        }
        let found = fitted(&few, &IDEAL);
        worst = worst.max(found.dz_mm.abs() / found.dz_u95_mm);
    }
    assert!(held > 90, "{held} of 100");
    assert!(worst < 3.0, "{worst}");
}

/// Touches of a level face all round the same way: more of them make their height no surer than the digit.
#[test]
fn coarse_readings_that_agree_are_no_surer_than_their_digit() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    let (mut high, mut across) = (0, 0);
    for _ in 0..200 {
        let coarse = |mm: f64| (100.0 * mm).round() / 100.0;
        let noise = Normal::new(0.0, 0.0005).unwrap();
        let [z, x, y, tilt] = std::array::from_fn(|_| random.random_range(-0.01..0.01));
        let mut draw = || noise.sample(&mut random);
        let mut out = String::from("kind,x_mm,y_mm,z_mm\n");
        for at in [[-50, -50], [50, -50], [50, 50], [-50, 50], [0, 10], [20, -30], [-30, 0]] {
            let height = 50.0 + z + 0.005 * tilt * f64::from(at[0]) + draw();
            writeln!(out, "face,{},{},{:.2}", at[0], at[1], coarse(height)).unwrap();
        }
        for side in [-60.0, 60.0] {
            for along in [-20, 0, 20] {
                writeln!(out, "side_x,{:.2},{along},30", coarse(side + x + draw())).unwrap();
                writeln!(out, "side_y,{along},{:.2},30", coarse(side + y + draw())).unwrap();
            }
        }
        let found = fitted(&out, &IDEAL);
        let (center, u95) = (found.center_mm.unwrap(), found.center_u95_mm.unwrap());
        high += usize::from((found.dz_mm - z).abs() < found.dz_u95_mm);
        across += usize::from((center[0] - x).abs() < u95[0]);
    }
    assert!(high >= 184 && across >= 184, "{high} and {across} of 200");
}
