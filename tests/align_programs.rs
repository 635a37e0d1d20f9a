//! Programs moved to where the blank lies: round trips, straight paths, held poles, refusals by line.

#![allow(clippy::unwrap_used)]

#[path = "common/blank.rs"]
mod blank;

use std::fmt::Write;
use std::path::Path;

use blank::{IDEAL, fitted, touches};
use nalgebra::Vector3;
use pivotsight::align::apply::{Options, apply};
use pivotsight::machine::{Machine, ToolPose};

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
