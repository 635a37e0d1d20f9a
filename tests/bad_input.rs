//! Bad input of every kind, through the whole command line: exit code 2, a message that names what is wrong and
//! where, nothing half written, and never a panic.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

#[path = "common/line.rs"]
mod line;

use line::run;
use std::path::Path;

thread_local! {
    /// What a test found, so that all of it is seen at once.
    static FOUND: std::cell::RefCell<Vec<String>> = const { std::cell::RefCell::new(Vec::new()) };
}

/// The program refuses: exit code 2, all the words in its message, nothing on standard output, no files left over.
fn refused(dir: &Path, line: &str, words: &[&str]) {
    let before = listing(dir);
    let output = run(dir, line);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let mut wrong = Vec::new();
    if output.status.code() != Some(2) {
        wrong.push(format!("exit code {:?}", output.status.code()));
    }
    if message.contains("panicked") || message.trim().is_empty() {
        wrong.push("broke".into());
    }
    wrong.extend(words.iter().filter(|w| !message.contains(**w)).map(|w| format!("no '{w}'")));
    if !output.stdout.is_empty() {
        wrong.push("printed a result".into());
    }
    let after = listing(dir);
    if after != before {
        wrong.push(format!("left something behind: {after:?}"));
    }
    if !wrong.is_empty() {
        let text = format!("{line}\n  {}\n  {}", wrong.join(", "), message.trim());
        FOUND.with_borrow_mut(|found| found.push(text));
    }
}

/// A folder with one good file of every kind; when it goes, the test is judged.
struct Workshop(tempfile::TempDir);

impl Workshop {
    fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            FOUND.with_borrow(|found| assert!(found.is_empty(), "\n{}", found.join("\n")));
        }
    }
}

fn listing(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|n| n.to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn workshop() -> Workshop {
    let dir = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (from, to) in [
        ("images/burn-clean/burn-0001.png", "burn.png"),
        ("images/burn-clean/calib.toml", "calib.toml"),
        ("calib/machine.toml", "machine.toml"),
        ("calib/session.toml", "session.toml"),
        ("docs/examples/blank.csv", "blank.csv"),
        ("docs/examples/path.apt", "path.apt"),
        ("docs/examples/machine-ac.toml", "ac.toml"),
        ("docs/examples/k197-1.csv", "sweep.csv"),
    ] {
        std::fs::copy(root.join(from), dir.path().join(to)).unwrap();
    }
    for line in [
        "align blank.csv --format json --out align.json",
        "ballbar simulate --format csv --noise-mm 0.001 --out bar.csv",
        "thermal simulate heat",
        "thermal fit --head heat/head.csv --screw heat/screw.csv --out model.json",
        "verify --machine machine.toml --plan .",
        "simulate rtcp --model machine.toml --data poses.csv --noise-mm 0.001 --format csv --out rtcp.csv",
        "solve session.toml --format json --out solve.json --records records.sqlite",
    ] {
        let output = run(dir.path(), line);
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("joints.csv", "x_mm,y_mm,z_mm,b_deg,c_deg\n1,2,3,4,5\n");
    write("captures.csv", "image,x_mm,y_mm\nburn.png,0,0\nburn.png,1,0\nburn.png,0,1\n");
    write("job.toml", "schema = 1\ncalib = \"calib.toml\"\n[measure.burn]\n");
    Workshop(dir)
}

/// Every place where the program reads a file, marked `@`, with a file that is good there.
const READERS: [&str; 32] = [
    "burn @burn.png --calib calib.toml",
    "burn burn.png --calib @calib.toml",
    "circles @burn.png --calib calib.toml --expect-mm 5.75",
    "circles burn.png --calib @calib.toml --expect-mm 5.75",
    "rod @captures.csv --calib calib.toml",
    "rod captures.csv --calib @calib.toml",
    "solve @session.toml",
    "rotary @sweep.csv --pivot-mm 573",
    "align @blank.csv",
    "align apply --align @align.json --machine ac.toml path.apt out.nc",
    "align apply --align align.json --machine @ac.toml path.apt out.nc",
    "align apply --align align.json --machine ac.toml --from apt @path.apt out.nc",
    "ballbar decouple --data @bar.csv",
    "thermal fit --head @heat/head.csv",
    "thermal fit --screw @heat/screw.csv",
    "thermal compensate --model @model.json --table heat/day.csv",
    "thermal compensate --model model.json --table @heat/day.csv",
    "verify --machine @machine.toml --data rtcp.csv",
    "verify --machine machine.toml --data @rtcp.csv",
    "verify --machine machine.toml --now @machine.toml --data rtcp.csv",
    "diagnose rtcp --model @machine.toml --data rtcp.csv",
    "diagnose rtcp --model machine.toml --data @rtcp.csv",
    "simulate rtcp --model @machine.toml --data poses.csv",
    "simulate rtcp --model machine.toml --data @poses.csv",
    "rtcp inverse --machine @machine.toml --poses joints.csv",
    "rtcp inverse --machine machine.toml --poses @joints.csv",
    "machine @machine.toml",
    "export --machine @machine.toml --control siemens",
    "render burn @machine.toml --out-dir rendered",
    "batch burn.png --job @job.toml --out batch",
    "report @solve.json --out page.html",
    "history --records @records.sqlite",
];

#[test]
fn whatever_a_file_holds_it_is_refused_by_name_and_never_breaks_the_program() {
    let dir = workshop();
    let dir = dir.path();
    let noise: Vec<u8> =
        (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let picture = std::fs::read(dir.join("burn.png")).unwrap();
    let bad: [(&str, Vec<u8>); 6] = [
        ("empty", Vec::new()),
        ("spaces", b"\n\n  \n".to_vec()),
        ("noise", noise),
        ("picture", picture[..1000].to_vec()),
        ("letter", b"Dear all,\n\nthe numbers are in the other file; see \"you\n".to_vec()),
        ("page", b"<!DOCTYPE html><html><body>404</body></html>\n".to_vec()),
    ];
    for reader in READERS {
        let (head, tail) = reader.split_once('@').unwrap();
        let (file, tail) = tail.split_once(' ').unwrap_or((tail, ""));
        // What stands there must work, or a refusal below says nothing; `render` and `rod` are only refused.
        let good = run(dir, &reader.replace('@', "")).status.code();
        let only_bad = reader.starts_with("render") || reader.starts_with("rod");
        assert!(only_bad || good == Some(0) || good == Some(1), "{reader}: {good:?}");
        for made in ["out.nc", "rendered", "batch", "page.html"] {
            let path = dir.join(made);
            drop(std::fs::remove_dir_all(&path).or_else(|_| std::fs::remove_file(&path)));
        }
        let extension = file.rsplit('.').next().unwrap();
        let line = |name: &str| format!("{head}{name}.{extension} {tail}");
        refused(dir, &line("nosuchfile"), &["nosuchfile."]);
        for (name, bytes) in &bad {
            let file = format!("{name}.{extension}");
            std::fs::write(dir.join(&file), bytes).unwrap();
            if file == "empty.sqlite" || file == "spaces.sqlite" {
                continue; // An empty database is one without records.
            }
            refused(dir, &line(name), &[&file]);
        }
    }
}

#[test]
fn pictures_that_lie_about_themselves_are_refused() {
    let dir = workshop();
    let dir = dir.path();
    let picture = std::fs::read(dir.join("burn.png")).unwrap();
    let burn = |name: &str, bytes: &[u8], words: &[&str]| {
        std::fs::write(dir.join(name), bytes).unwrap();
        refused(dir, &format!("burn {name} --calib calib.toml"), &[&[name], words].concat());
    };
    burn("half.png", &picture[..picture.len() / 2], &["cut short"]);
    burn("head.png", &picture[..20], &[]);
    burn("really.png", b"kind,x_mm\nface,1\n", &["is not a picture"]);
    let mut jpeg = std::io::Cursor::new(Vec::new());
    let whole = image::open(dir.join("burn.png")).unwrap();
    whole.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    burn("half.jpg", &jpeg[..jpeg.len() * 9 / 10], &["cut short", "end marker"]);
    // 60,000 × 60,000 pixels claimed in a few bytes, and 20,000 × 20,000 really compressed to little.
    let mut huge = picture.clone();
    huge[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    burn("huge.png", &huge, &[]);
    burn("huge.pgm", b"P5 60000 60000 255\n", &[]);
    let flat = image::GrayImage::from_pixel(20_000, 20_000, image::Luma([7]));
    flat.save(dir.join("bomb.png")).unwrap();
    refused(dir, "burn bomb.png --calib calib.toml", &["bomb.png"]);
    // Readable, and still not what is asked for.
    image::GrayImage::from_pixel(640, 480, image::Luma([90])).save(dir.join("small.png")).unwrap();
    refused(dir, "burn small.png --calib calib.toml", &["small.png", "640", "calib"]);
    image::GrayImage::from_pixel(800, 600, image::Luma([90])).save(dir.join("flat.png")).unwrap();
    refused(dir, "burn flat.png --calib calib.toml", &["flat.png", "ring"]);
    refused(dir, "circles flat.png --calib calib.toml --expect-mm 5", &["flat.png", "5"]);
    refused(dir, "rod captures.csv --calib calib.toml", &["captures.csv:3", "another position"]);
}

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
    says("t.csv", dir_x, rod, &["t.csv:3", "dir_x", "no direction"]);
    let rtcp = "rtcp inverse --machine machine.toml --poses t.csv";
    says("t.csv", "x_mm,y_mm,z_mm,b_deg,c_deg\n1,2,3,4,inf\n", rtcp, &["t.csv:2", "c_deg"]);
    says("t.csv", "x_mm,y_mm,z_mm,a_deg,c_deg\n1,2,3,4,5\n", rtcp, &["a_deg"]);
    // TOML: unknown keys, wrong types, impossible numbers.
    let solve = "solve t.toml";
    let session = std::fs::read_to_string(dir.join("session.toml")).unwrap();
    says("t.toml", &session.replace("x1_mm", "x1_inch"), solve, &["t.toml", "x1_inch"]);
    says("t.toml", &session.replace("637.2948", "\"637,2948\""), solve, &["t.toml:"]);
    says("t.toml", &session.replace("637.2948", "nan"), solve, &["t.toml", "x1_mm"]);
    says("t.toml", &session.replace("x1_mm = 637.2948\n", ""), solve, &["t.toml", "x1_mm"]);
    let machine = std::fs::read_to_string(dir.join("machine.toml")).unwrap();
    says(
        "t.toml",
        &machine.replace("214.7001", "-214.7001"),
        "machine t.toml",
        &["t.toml", "r_mm"],
    );
    says(
        "t.toml",
        &machine.replace("schema = 1", "schema = 9"),
        "machine t.toml",
        &["t.toml", "9"],
    );
    let calib = std::fs::read_to_string(dir.join("calib.toml")).unwrap();
    let burn = "burn burn.png --calib t.toml";
    says("t.toml", &calib.replace("fx_px", "fx_mm"), burn, &["t.toml", "fx_mm"]);
    says("t.toml", "schema = 1\n[scale]\nmm_per_px = 0.0\n", burn, &["t.toml", "mm_per_px"]);
    let curved = format!("{calib}\n[sensor]\ngamma = 0.0\n");
    says("t.toml", &curved, burn, &["t.toml", "sensor.gamma", "2.2"]);
    says("t.toml", "schema = 1\n", burn, &["t.toml", "[camera]"]);
}

#[test]
fn slips_of_the_hand_get_a_hint() {
    let dir = workshop();
    let dir = dir.path();
    refused(dir, "burn brun.png --calib calib.toml", &["brun.png", "did you mean 'burn.png'?"]);
    refused(dir, "burn burn.png --calib clib.toml", &["did you mean 'calib.toml'?"]);
    refused(dir, "thermal fit --head heta/head.csv", &["did you mean 'heat'?"]);
    refused(dir, "report heat", &["heat", "batch"]);
    refused(dir, "batch burn.png --job job.toml --out blank.csv", &["blank.csv", "folder"]);
    refused(dir, "burm burn.png", &["burn"]);
    refused(dir, "burn burn.png --calb calib.toml", &["--calib"]);
    refused(dir, "burn burn.png --calib calib.toml --tolerance-mm=-1", &["--tolerance-mm"]);
    refused(dir, "burn burn.png --calib calib.toml --tolerance-mm 0,01", &["0,01"]);
    refused(dir, "burn . --calib calib.toml", &["folder"]);
    refused(dir, "batch b*.jpg --job job.toml --out o", &["b*.jpg", "nothing to measure"]);
    refused(dir, "rotary sweep.csv --pivot-mm 0", &["--pivot-mm"]);
    refused(dir, "circles burn.png --calib calib.toml --expect-mm 900", &["900"]);
    let one = "circles burn.png --calib calib.toml --expect-mm 5.75 --expect-mm";
    refused(dir, &format!("{one} 5.3"), &["one circle only", "5.75", "5.3"]);
    refused(dir, &format!("{one} 5.75"), &["5.75", "twice"]);
}

#[test]
fn a_failed_run_leaves_the_old_result_as_it_was() {
    let dir = workshop();
    let dir = dir.path();
    std::fs::write(dir.join("old.json"), "precious").unwrap();
    refused(dir, "solve nosuch.toml --out old.json", &["nosuch.toml"]);
    assert_eq!(std::fs::read_to_string(dir.join("old.json")).unwrap(), "precious");
    refused(dir, "solve session.toml --out no/where/new.json", &["no/where", "does not exist"]);
    refused(dir, "solve session.toml --out heat", &["heat", "is a folder"]);
    refused(dir, "solve session.toml --write-machine no/where/m.toml", &["does not exist"]);
}

#[test]
fn outputs_never_replace_inputs_nor_each_other_and_come_together() {
    let dir = workshop();
    let dir = dir.path();
    let session = std::fs::read(dir.join("session.toml")).unwrap();
    std::fs::write(dir.join("one.csv"), "image,x_mm,y_mm\nburn.png,0,0\n").unwrap();
    let copy = |from: &str, to: &str| {
        std::fs::copy(dir.join(from), dir.join(to)).unwrap();
    };
    copy("burn.png", "b.overlay.png");
    copy("burn.png", "b.png");
    let two = "image,x_mm,y_mm\nb.png,0,0\nb.overlay.png,1,0\n";
    std::fs::write(dir.join("two.csv"), two).unwrap();
    copy("machine.toml", "tool_carrier.spf");
    copy("machine.toml", "old.toml");
    copy("rtcp.csv", "index.html");
    let text = String::from_utf8(session.clone()).unwrap();
    let text = text.replace("[control]", "[control]\nmachine = \"old.toml\"");
    std::fs::write(dir.join("session2.toml"), text).unwrap();
    for (line, words) in [
        ("solve session.toml --out session.toml", ["--out", "session.toml"]),
        ("solve session.toml --out heat/../session.toml", ["--out", "SESSION.toml"]),
        ("solve session.toml --write-machine ./session.toml", ["--write-machine", "another name"]),
        ("solve session.toml --out a.toml --write-machine a.toml", ["a.toml", "another name"]),
        ("solve session.toml --log session.toml", ["--log", "session.toml"]),
        ("rod one.csv --calib calib.toml --points burn.png", ["--points", "one.csv"]),
        ("rod one.csv --calib calib.toml --points calib.toml", ["--points", "--calib"]),
        ("burn b.png b.overlay.png --calib calib.toml --overlay .", ["--overlay", "IMAGE"]),
        ("rod two.csv --calib calib.toml --overlay .", ["--overlay", "two.csv"]),
        ("export --machine tool_carrier.spf --control siemens --dir .", ["--dir", "--machine"]),
        ("diagnose rtcp --model machine.toml --data index.html --report .", ["--report", "--data"]),
        ("solve session2.toml --write-machine old.toml", ["--write-machine", "session2.toml"]),
    ] {
        refused(dir, line, &words);
    }
    assert_eq!(std::fs::read(dir.join("session.toml")).unwrap(), session);
    if Path::new("/dev/full").exists() {
        refused(dir, "solve session.toml --write-machine m.toml --out /dev/full", &["/dev/full"]);
    }
}

#[cfg(unix)]
#[test]
fn what_never_ends_is_refused() {
    let dir = workshop();
    let dir = dir.path();
    let made = std::process::Command::new("mkfifo").arg(dir.join("pipe.csv")).status();
    if made.is_ok_and(|status| status.success()) {
        refused(dir, "rotary pipe.csv --pivot-mm 573", &["pipe.csv", "is a named pipe"]);
        refused(dir, "machine pipe.csv", &["pipe.csv", "is a named pipe"]);
    }
    if Path::new("/dev/zero").exists() {
        refused(dir, "machine /dev/zero", &["/dev/zero", "larger than"]);
        refused(dir, "report /dev/zero --out page.html", &["/dev/zero", "larger than"]);
    }
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

#[test]
fn a_page_is_made_of_results_only() {
    let dir = workshop();
    let dir = dir.path();
    for (text, word) in [
        (r#"{"a": 1}"#, "not a result"),
        ("[1, 2]", "not a result"),
        (r#"{"schema": "pivotsight.foo/1", "a": 1}"#, "nothing that a page shows"),
        (r#"{"schema": "pivotsight.burn/2", "distance_mm": 1}"#, "version 1"),
    ] {
        std::fs::write(dir.join("f.json"), text).unwrap();
        refused(dir, "report f.json", &["f.json", word]);
    }
    refused(
        dir,
        "align apply --align align.json --machine ac.toml path.apt out.nc --decimals 0",
        &["--decimals", "decimal point"],
    );
}

#[cfg(unix)]
#[test]
fn a_link_to_nothing_is_called_one() {
    let dir = workshop();
    let dir = dir.path();
    std::os::unix::fs::symlink("gone/calib.toml", dir.join("link.toml")).unwrap();
    let listed = listing(dir);
    refused(dir, "burn burn.png --calib link.toml", &["link.toml", "a link to 'gone/calib.toml'"]);
    assert_eq!(listing(dir), listed);
}

/// A name that JSON cannot hold is refused, never a panic half way.
#[cfg(unix)]
#[test]
fn names_that_are_not_utf_8_are_refused() {
    use std::os::unix::ffi::OsStrExt;
    let dir = workshop();
    let name = std::ffi::OsStr::from_bytes(b"b\xff.png");
    std::fs::copy(dir.path().join("burn.png"), dir.path().join(name)).unwrap();
    let output = std::process::Command::new(assert_cmd::cargo::cargo_bin!("pivotsight"))
        .current_dir(dir.path())
        .env("PIVOTSIGHT_CONFIG", "none")
        .arg("burn")
        .arg(name)
        .args(["--calib", "calib.toml", "--format", "json"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("IMAGE") && said.contains("UTF-8"), "{said}");
}
