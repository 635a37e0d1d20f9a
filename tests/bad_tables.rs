//! What is wrong inside a file: cells and keys that are misspelt, missing, impossible or doubtful, rows that stand twice.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

#[path = "common/line.rs"]
mod line;
#[path = "common/workshop.rs"]
mod workshop;

use line::run;
use workshop::{refused, workshop};

#[test]
fn wrong_cells_are_named_with_line_and_column() {
    let dir = workshop();
    let dir = dir.path();
    let says = |file: &str, text: &str, line: &str, words: &[&str]| {
        std::fs::write(dir.join(file), text).unwrap();
        refused(dir, line, words);
    };
    let rotary = "rotary t.csv --pivot-mm 573";
    says("t.csv", "angle_deg,deviation_mm\n0,0.1\n5,NaN\n", rotary, &["t.csv:3", "deviation_mm"]);
    says("t.csv", "angle_deg,deviation_mm\n0,0.1\n5,\n", rotary, &["t.csv:3", "deviation_mm"]);
    says("t.csv", "angle_deg,deviation_mm\n0,1\n,\n", rotary, &["t.csv:3", "is empty"]);
    says("t.csv", "Angle_deg,deviation_mm\n0,1\n", rotary, &["did you mean 'angle_deg'?"]);
    says("t.csv", "angle_deg,deviation_mm\n0,0,1\n", rotary, &["t.csv:2", "decimal comma"]);
    says("t.csv", "angle_deg,deviation_mm\n0,1e999\n", rotary, &["t.csv:2", "deviation_mm"]);
    says(
        "t.csv",
        "angle_deg,deviation_um\n0,1\n",
        rotary,
        &["deviation_um", "known columns", "deviation_mm"],
    );
    says("t.csv", "angle_deg;deviation_mm\n0;1\n", rotary, &["separated by ';'"]);
    let titled = "Sweep of 12 March\nangle_deg,deviation_mm\n0,1\n";
    says("t.csv", titled, rotary, &["t.csv:1", "begin lines above the header with #"]);
    let zeros = "b_deg,c_deg,dx_mm,dy_mm,dz_mm\n0,0,0,0,0\n10,0,0,0,0\n20,5,0,0,0\n30,9,0,0,0\n";
    std::fs::write(dir.join("m.toml"), "schema = 1\n[head]\nr_mm = 214.7\n").unwrap();
    says(
        "z.csv",
        zeros,
        "verify --machine m.toml --data z.csv",
        &["z.csv", "zeros alone", "fill in"],
    );
    says(
        "d.toml",
        "schema = 1\n[head]\nr_mm = 214,7\n",
        "machine d.toml",
        &["d.toml:3", "a point"],
    );
    says("t.csv", "angle_deg,deviation_mm,deviation_mm\n0,1,1\n", rotary, &["twice"]);
    says("t.csv", "angle_deg,deviation_mm\n", rotary, &["no rows"]);
    // Lines are counted with what stands before them, as a spreadsheet on Windows writes them.
    says(
        "t.csv",
        "# ours\r\n\r\nangle_deg,deviation_mm,,\r\n0,0.1,,\r\n\r\n# so\r\n5,x,,\r\n",
        rotary,
        &["t.csv:7", "deviation_mm"],
    );
    says("t.csv", "angle_deg,deviation_mm\n0,0.1,,3\n", rotary, &["t.csv:2", "4 fields"]);
    // Micrometres under the name of millimetres, degrees where millimetres are due.
    says("t.csv", "angle_deg,deviation_mm\n0,80\n5,9000\n10,7000\n", rotary, &["check the units"]);
    let rod = "rod t.csv --calib calib.toml";
    says("t.csv", "image,x_mm\nburn.png,1\n", rod, &["y_mm", "missing"]);
    says("t.csv", "image,x_mm,y_mm\nnone.png,1,2\nnone.png,2,2\n", rod, &["none.png"]);
    let dir_x = "image,x_mm,y_mm,dir_x\nburn.png,1,2,1\nb.png,2,2,7\n";
    says("t.csv", dir_x, rod, &["t.csv:3", "dir_x", "not a direction"]);
    let rtcp = "rtcp inverse --machine machine.toml --poses t.csv";
    says("t.csv", "x_mm,y_mm,z_mm,b_deg,c_deg\n1,2,3,4,inf\n", rtcp, &["t.csv:2", "c_deg"]);
    says("t.csv", "x_mm,y_mm,z_mm,a_deg,c_deg\n1,2,3,4,5\n", rtcp, &["a_deg"]);
    says("t.csv", "x_mm,y_mm,z_mm,b_deg,c_deg\n1,2,3,40000,5\n", rtcp, &["t.csv:2", "b_deg"]);
    let directed = "b_deg,c_deg,dx_mm,dy_mm,dz_mm,dir_b\n0,0,1,0,0,1\n10,0,0,0,1,up\n20,5,0,0,0,1\n30,9,0,0,0,1\n";
    let verify = "verify --machine m.toml --data t.csv";
    says("t.csv", directed, verify, &["t.csv:3", "dir_b", "'up'"]);
    says("t.csv", &directed.replace("up", "7"), verify, &["t.csv:3", "dir_b", "not a direction"]);
    let hot = "head_1_c,displacement_mm\n0,0\n8000,0.01\n4,0.02\n";
    says("t.csv", hot, "thermal fit --head t.csv", &["t.csv:3", "head_1_c", "8000"]);
    // TOML: unknown keys, wrong types, impossible numbers.
    let solve = "solve t.toml";
    let session = std::fs::read_to_string(dir.join("session.toml")).unwrap();
    says("t.toml", &session.replace("x1_mm", "x1_inch"), solve, &["t.toml", "x1_inch"]);
    says("t.toml", &session.replace("637.2948", "\"637,2948\""), solve, &["t.toml:"]);
    says("t.toml", &session.replace("637.2948", "nan"), solve, &["t.toml", "x1_mm"]);
    says("t.toml", &session.replace("x1_mm = 637.2948\n", ""), solve, &["t.toml", "x1_mm"]);
    let above = |text: &str| text.replace("standoff_mm = 1.5", "standoff_mm = -300.0");
    says("t.toml", &above(&session), solve, &["t.toml", "head.standoff_mm", "above the B axis"]);
    let machine = std::fs::read_to_string(dir.join("machine.toml")).unwrap();
    says(
        "t.toml",
        &machine.replace("214.7001", "-214.7001"),
        "machine t.toml",
        &["t.toml", "r_mm"],
    );
    says("t.toml", &machine.replace("214.7001", "0.0"), "machine t.toml", &["r_mm", "is 0"]);
    says("t.toml", &above(&machine), "machine t.toml", &["head.standoff_mm", "above the B axis"]);
    says(
        "t.toml",
        &machine.replace("schema = 1", "schema = 9"),
        "machine t.toml",
        &["t.toml", "9"],
    );
    let calib = std::fs::read_to_string(dir.join("calib.toml")).unwrap();
    let burn = "burn burn.png --calib t.toml";
    says("t.toml", &calib.replace("fx_px", "fx_mm"), burn, &["t.toml", "fx_mm"]);
    says("t.toml", &calib.replace("cx_px = ", "cx_px = 9999"), burn, &["t.toml", "cx_px"]);
    says("t.toml", "schema = 1\n[scale]\nmm_per_px = 0.0\n", burn, &["t.toml", "mm_per_px"]);
    let curved = format!("{calib}\n[sensor]\ngamma = 0.0\n");
    says("t.toml", &curved, burn, &["t.toml", "sensor.gamma", "2.2"]);
    says("t.toml", "schema = 1\n", burn, &["t.toml", "[camera]"]);
}

#[test]
fn surplus_elements_of_an_array_are_named() {
    let dir = workshop();
    let dir = dir.path();
    let text = std::fs::read_to_string(dir.join("calib.toml")).unwrap();
    let line = text.lines().find(|l| l.starts_with("distortion")).unwrap();
    let longer = text.replace(line, "distortion = [0, 0, 0, 0, 0, 0, 0, 0]");
    std::fs::write(dir.join("long.toml"), longer).unwrap();
    refused(dir, "burn burn.png --calib long.toml", &["long.toml:", "camera.distortion", "8"]);
}

#[test]
fn rows_that_stand_twice_count_once_and_are_named() {
    let dir = workshop();
    let dir = dir.path();
    let bar = std::fs::read_to_string(dir.join("bar.csv")).unwrap();
    let again: String = bar.lines().skip(1).map(|l| format!("{l}\n")).collect();
    std::fs::write(dir.join("twice.csv"), format!("{bar}{again}")).unwrap();
    let once = run(dir, "ballbar decouple --data bar.csv");
    let twice = run(dir, "ballbar decouple --data twice.csv");
    assert_eq!(once.stdout, twice.stdout);
    let said = String::from_utf8_lossy(&twice.stderr).into_owned();
    assert!(said.contains("twice.csv") && said.contains("counts once"), "{said}");
    // A sweep whose every second pose is measured again tells its noise; a copy of it tells no more.
    let mut sweep = String::from("b_deg,c_deg,dx_mm,dy_mm,dz_mm\n");
    for i in 0..18 {
        let (b, c) = (f64::from(i % 12) * 10.0 - 60.0, f64::from(i % 12) * 25.0);
        let d = [7, 11, 13].map(|k| f64::from(i * k % 5) * 0.001);
        sweep += &format!("{b},{c},{},{},{}\n", d[0], d[1], d[2]);
    }
    let rows = sweep.split_once('\n').unwrap().1;
    std::fs::write(dir.join("sweep.csv"), &sweep).unwrap();
    std::fs::write(dir.join("sweep2.csv"), format!("{sweep}{rows}")).unwrap();
    let once = run(dir, "verify --machine machine.toml --data sweep.csv");
    let twice = run(dir, "verify --machine machine.toml --data sweep2.csv");
    assert_eq!(once.stdout, twice.stdout);
    assert!(String::from_utf8_lossy(&once.stdout).contains("poses measured again"), "{once:?}");
    let said = String::from_utf8_lossy(&twice.stderr).into_owned();
    assert!(said.contains("sweep2.csv: 18 left out") && said.contains("line 20,"), "{said}");
}

#[test]
fn a_diagnosis_counts_copies_once_and_doubts_what_no_machine_shows() {
    let dir = workshop();
    let dir = dir.path();
    let write = |name: &str, text: &str| std::fs::write(dir.join(name), text).unwrap();
    let sweep = std::fs::read_to_string(dir.join("rtcp.csv")).unwrap();
    let mut lines = sweep.lines();
    let mut timed = format!("{},t_s\n", lines.next().unwrap());
    lines.enumerate().for_each(|(i, line)| timed += &format!("{line},{}\n", 10 * i));
    let again = timed.lines().skip(5).take(20).fold(timed.clone(), |all, line| all + line + "\n");
    write("once.csv", &timed);
    write("twice.csv", &again);
    let [once, twice] = ["once", "twice"]
        .map(|name| run(dir, &format!("diagnose rtcp --model machine.toml --data {name}.csv")));
    let said = |output: &std::process::Output| String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(once.stdout, twice.stdout);
    assert!(said(&twice).contains("twice.csv: 20 left out"), "{}", said(&twice));
    assert!(!said(&once).contains("left out"), "{}", said(&once));
    let own = "schema = 1\n[[effects]]\nname = \"pull\"\nkind = \"rtcp\"\nparameters = { pull_mm = { typical = 0.5 } }\n\
               outputs = { dx_mm = \"pull_mm * b_deg\" }\n";
    write("own.toml", own);
    let own = run(dir, "diagnose rtcp --model machine.toml --data once.csv --effects own.toml");
    assert!(said(&own).contains("own.toml: effects 'pull' adds up to 44.4 mm"), "{}", said(&own));
    let without: String = timed
        .lines()
        .map(|l| {
            l.split(',')
                .enumerate()
                .filter(|(i, _)| *i != 4)
                .map(|(_, cell)| cell)
                .collect::<Vec<_>>()
                .join(",")
                + "\n"
        })
        .collect();
    write("without.csv", &without);
    let wanted = ["without.csv", "dz_mm"];
    refused(dir, "diagnose rtcp --model machine.toml --data without.csv", &wanted);
    let few: String = timed.lines().take(4).map(|line| format!("{line}\n")).collect();
    write("few.csv", &few);
    refused(
        dir,
        "diagnose rtcp --model machine.toml --data few.csv",
        &["few.csv: rtcp", "too few"],
    );
    // A rim that reaches out of the picture.
    let mut points = String::from("capture,x_mm,y_mm,u_px,v_px\n");
    for i in 0..40 {
        let (s, c) = (0.157 * f64::from(i)).sin_cos();
        points += &format!("a,0,0,{},{}\n", 400.0 + 320.0 * c, 300.0 + 320.0 * s);
    }
    write("points.csv", &points);
    let rim = run(dir, "simulate rod --data points.csv --calib calib.toml");
    assert!(said(&rim).contains("lie outside of the 800×600 px"), "{}", said(&rim));
}

#[test]
fn what_is_misspelt_in_a_file_is_found_before_anything_is_measured() {
    let dir = workshop();
    let dir = dir.path();
    let machine = std::fs::read_to_string(dir.join("machine.toml")).unwrap();
    let effect = |name: &str| {
        let text = format!("{machine}\n[[effects]]\nname = \"{name}\"\nparameters = {{}}\n");
        std::fs::write(dir.join("m.toml"), text).unwrap();
    };
    effect("b-backlach");
    let simulate = "simulate rtcp --model m.toml --data poses.csv";
    refused(dir, simulate, &["m.toml", "effects", "b-backlach", "did you mean 'b-backlash'?"]);
    refused(dir, "diagnose rtcp --model m.toml --data rtcp.csv", &["m.toml", "'b-backlash'?"]);
    // Another kind's effect is no slip.
    effect("head-lag");
    assert!(run(dir, simulate).status.success());
    let job = |text: &str, words: &[&str]| {
        std::fs::write(dir.join("t.toml"), format!("schema = 1\ncalib = \"calib.toml\"\n{text}"))
            .unwrap();
        refused(dir, "batch burn.png --job t.toml --out made", &[&["t.toml"], words].concat());
    };
    let burn = "[measure.burn]\n[limits]\n";
    job(&format!("{burn}distnace_mm = {{ max = 1 }}\n"), &["limits.distnace_mm", "'distance_mm'?"]);
    job(&format!("{burn}\"ring.center_mm.2\" = {{ max = 1 }}\n"), &["ring.center_mm.2"]);
    job(&format!("{burn}distance_mm = {{ maxx = 1 }}\n"), &["maxx"]);
    job("[measure.burn]\ntolerance_mm = -1\n", &["tolerance_mm"]);
    let pair =
        "[measure.circles]\nexpect_mm = [5.75]\n[limits]\n\"pairs.0.distance_mm\" = { max = 1 }\n";
    job(pair, &["pairs.0.distance_mm", "1 circles"]);
}
