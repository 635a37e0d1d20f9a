//! What `simulate rtcp`, `verify` and `export` promise.

#![allow(clippy::unwrap_used)] // a test that cannot go on should stop

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use serde_json::Value;

const NEW: &str = "schema = 1\nname = \"cell 3\"\n[head]\ndelta_x_mm = 0.283\nr_mm = 214.7\nstandoff_mm = 1.5\n\
                   [table]\nxc_mm = 412.3\nyc_mm = -87.6\nzc_mm = -310.2\n[target]\nposition_mm = [80.0, 0.0, 100.0]\n";

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.put("new.toml", NEW);
        folder.put("old.toml", &NEW.replace("0.283", "0.250").replace("214.7", "214.65"));
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    /// Runs the command in the folder: exit code, standard output, standard error.
    fn run(&self, arguments: &str) -> (i32, String, String) {
        let output = Command::cargo_bin("pivotsight")
            .unwrap()
            .current_dir(&self.0)
            .args(arguments.split_whitespace())
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
    }

    fn json(&self, arguments: &str) -> (i32, Value) {
        let (code, out, err) = self.run(&format!("{arguments} --format json"));
        (code, serde_json::from_str(&out).unwrap_or_else(|_| panic!("{arguments}: {err}")))
    }
}

fn rms(json: &Value, which: &str) -> f64 {
    json[which]["rms_mm"].as_f64().unwrap()
}

#[test]
fn a_plan_is_simulated_measured_and_verified() {
    let folder = Folder::new();
    for control in ["siemens", "fanuc", "heidenhain", "linuxcnc"] {
        let (code, _, err) =
            folder.run(&format!("verify --machine new.toml --plan plan --control {control}"));
        assert_eq!(code, 0, "{err}");
        let program = std::fs::read_to_string(folder.path("plan/sweep.nc")).unwrap();
        assert!(program.matches("80.0").count() >= 60, "{program}");
    }
    let (code, out, err) = folder
        .run("simulate rtcp --model new.toml --data plan/poses.csv --now old.toml --format csv");
    assert_eq!(code, 0, "{err}");
    assert!(
        out.starts_with("b_deg,c_deg,dir_b,dir_c,dx_mm,dy_mm,dz_mm\n") && out.lines().count() == 61
    );
    // The target stands 20 µm from where the file has it: that must not count as a deviation.
    let shifted: String = out
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if i > 0 {
                let c = cells[1].parse::<f64>().unwrap().to_radians();
                let offset = [-0.02 * c.cos(), -0.02 * c.sin(), 0.01];
                for k in 0..3 {
                    cells[4 + k] = (cells[4 + k].parse::<f64>().unwrap() + offset[k]).to_string();
                }
            }
            cells.join(",") + "\n"
        })
        .collect();
    folder.put("sweep.csv", &shifted);

    let (code, json) =
        folder.json("verify --machine new.toml --now old.toml --data sweep.csv --report report");
    assert_eq!((code, &json["verdict"]), (0, &Value::from("pass")));
    assert!(rms(&json, "before") > 0.02 && rms(&json, "after") < 1e-7, "{json}");
    let offset: [f64; 3] = serde_json::from_value(json["target_offset_mm"].clone()).unwrap();
    assert!((offset[0] - 0.02).abs() < 1e-7 && (offset[2] + 0.01).abs() < 1e-7, "{offset:?}");
    let plot = std::fs::read_to_string(folder.path("report/sweep.svg")).unwrap();
    assert!(plot.contains("predicted") && plot.contains("dz, mm"));
    // Without the old values the same sweep says that the machine does not hold the point.
    let (code, json) = folder.json("verify --machine new.toml --data sweep.csv");
    assert_eq!((code, &json["verdict"]), (1, &Value::from("fail")));
}

#[test]
fn a_sweep_without_errors_has_no_deviations() {
    let folder = Folder::new();
    folder.put("poses.csv", "b_deg,c_deg,temp_c\n-90,0,20.5\n45,120,21\n");
    let (code, json) = folder.json("simulate rtcp --model new.toml --data poses.csv");
    assert_eq!(code, 0);
    for row in json["rows"].as_array().unwrap() {
        assert!(row["temp_c"].as_f64().unwrap() > 20.0);
        assert!(["dx_mm", "dy_mm", "dz_mm"].iter().all(|k| row[k].as_f64().unwrap().abs() < 1e-9));
    }
    let (code, out, err) = folder.run("verify --machine new.toml --data poses.csv");
    assert!(code == 2 && out.is_empty() && err.contains("dx_mm"), "{err}");
}

#[test]
fn an_effect_of_the_library_is_the_same_change_of_the_chain_and_verify_takes_it_out() {
    let folder = Folder::new();
    let effects = "[[effects]]\nname = \"pivot-offset-x\"\nparameters = { delta_x_mm = 0.033 }\n\
                   [[effects]]\nname = \"pivot-length\"\nparameters = { r_mm = 0.05 }\n";
    let old = std::fs::read_to_string(folder.path("old.toml")).unwrap();
    folder.put("faulty.toml", &(old + effects));
    folder.put("poses.csv", "b_deg,c_deg\n0,0\n-90,30\n-35,200\n20,75\n55,310\n90,140\n");
    let rows = |arguments: &str| -> Vec<[f64; 3]> {
        let (code, json) = folder.json(arguments);
        assert_eq!(code, 0);
        let row = |r: &Value| ["dx_mm", "dy_mm", "dz_mm"].map(|k| r[k].as_f64().unwrap());
        json["rows"].as_array().unwrap().iter().map(row).collect()
    };
    let by_library = rows("simulate rtcp --model faulty.toml --data poses.csv");
    let by_chain = rows("simulate rtcp --model new.toml --now old.toml --data poses.csv");
    for (a, b) in by_library.iter().zip(&by_chain) {
        // Where the datum was taken is a constant of the sweep, which B = 0 shows.
        let miss = (0..3).map(|i| (a[i] - by_library[0][i]) - (b[i] - by_chain[0][i]));
        assert!(miss.map(f64::abs).fold(0.0, f64::max) < 1e-9, "{a:?} {b:?}");
    }
    let (_, out, _) = folder.run("simulate rtcp --model faulty.toml --data poses.csv --format csv");
    folder.put("sweep.csv", &out);
    let (code, json) = folder.json("verify --machine faulty.toml --data sweep.csv");
    assert_eq!(
        (code, &json["verdict"]),
        (1, &Value::from("fail")),
        "the machine does not hold the point"
    );
    assert!(
        rms(&json, "before") > 0.02 && rms(&json, "after") < 1e-7,
        "the model says why: {json}"
    );
}

#[test]
fn every_control_gets_the_vectors_and_no_unmarked_guess() {
    let folder = Folder::new();
    for (control, must) in [
        ("siemens", "$TC_CARR4[1]=-0.2830 ; I2 x"),
        ("siemens", "N24550 $MC_TRAFO5_BASE_TOOL_1[2]=214.7000"),
        ("fanuc", "N19680P21 "),
        ("fanuc", "N19709P-0.2830"),
        ("heidenhain", "MachAxis  C"),
        ("linuxcnc", "setp maxkins.pivot-length 216.2"),
        ("sheet", "I3 = (412.3000, -87.6000, -310.2000)"),
    ] {
        let (code, out, _) = folder.run(&format!("export --machine new.toml --control {control}"));
        assert_eq!(code, 0);
        assert!(out.contains(must), "{control}: {out}");
        let (_, json) = folder.json(&format!("export --machine new.toml --control {control}"));
        let texts: String =
            json["files"].as_array().unwrap().iter().map(|f| f["text"].as_str().unwrap()).collect();
        for p in json["parameters"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|p| p["confidence"] == "unconfirmed")
        {
            let marked = format!("NOT CONFIRMED: {}", p["meaning"].as_str().unwrap());
            assert!(texts.contains(&marked), "{control}: {p}");
        }
    }
}

/// A machine of other rotary axes has their columns, letters and limits.
#[test]
fn a_table_about_a_and_c_is_swept_about_a_and_c() {
    let folder = Folder::new();
    let machine = |y: f64| {
        format!(
            "schema = 1\nname = \"trunnion\"\n[kinematics]\norder = \"w C A b X Y Z t\"\n[axes.A]\n\
             point_mm = [0.0, {y}, -60.0]\nlimits_deg = [-120.0, 30.0]\n[target]\nposition_mm = [50.0, 20.0, 10.0]\n"
        )
    };
    folder.put("new.toml", &machine(0.05));
    folder.put("old.toml", &machine(0.02));
    let (code, _, err) = folder.run("verify --machine new.toml --plan plan");
    assert_eq!(code, 0, "{err}");
    let program = std::fs::read_to_string(folder.path("plan/sweep.nc")).unwrap();
    assert!(program.contains(" A") && !program.contains(" B"), "{program}");
    let (code, out, err) = folder
        .run("simulate rtcp --model new.toml --data plan/poses.csv --now old.toml --format csv");
    assert_eq!(code, 0, "{err}");
    assert!(out.starts_with("a_deg,c_deg,dir_a,dir_c,dx_mm,dy_mm,dz_mm\n"), "{out}");
    let numbers =
        |line: &str| -> Vec<f64> { line.split(',').map(|c| c.parse().unwrap()).collect() };
    let rows: Vec<Vec<f64>> = out.lines().skip(1).map(numbers).collect();
    assert!(rows.iter().all(|r| r[0] > -90.0 && r[0] < 26.0));
    // Poses are repeated from either side of both axes.
    let repeats = rows.windows(2).filter(|w| w[0][..2] == w[1][..2]).map(|w| [w[0][2], w[0][3]]);
    let sides: std::collections::BTreeSet<String> = repeats.map(|s| format!("{s:?}")).collect();
    assert_eq!(sides.len(), 4, "{sides:?}");
    folder.put("sweep.csv", &out);
    let (code, json) = folder.json("verify --machine new.toml --now old.toml --data sweep.csv");
    assert_eq!((code, &json["verdict"]), (0, &Value::from("pass")));
    assert!(rms(&json, "before") > 0.005 && rms(&json, "after") < 1e-7, "{json}");
    assert!(json["rows"][0]["a_deg"].is_number() && json["rows"][0]["b_deg"].is_null());
}

#[test]
fn a_plan_stays_within_the_limits_of_an_axis() {
    let folder = Folder::new();
    for ([low, high], spread) in [([-360, 0], 300.0), ([-180, 180], 300.0), ([-500, 500], 330.0)] {
        let machine = format!("{NEW}[axes.C]\nlimits_deg = [{low}.0, {high}.0]\n");
        folder.put("limited.toml", &machine);
        let (code, _, err) = folder.run("verify --machine limited.toml --plan limited");
        assert_eq!(code, 0, "{err}");
        let csv = std::fs::read_to_string(folder.path("limited/poses.csv")).unwrap();
        let c = csv.lines().skip(1).map(|l| l.split(',').nth(1).unwrap().parse::<f64>().unwrap());
        let [least, most] =
            c.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], c| [a.min(c), b.max(c)]);
        // The program drives there from 4° beside it.
        assert!(least > f64::from(low) + 4.0 && most < f64::from(high) - 4.0, "{least} {most}");
        assert!(most - least > spread && most - least < 360.0, "{least} {most}");
    }
    folder.put("tight.toml", &format!("{NEW}[axes.C]\nlimits_deg = [-3.0, 3.0]\n"));
    let (code, _, err) = folder.run("verify --machine tight.toml --plan tight");
    assert!(code == 2 && err.contains("C has no room") && !folder.path("tight").exists(), "{err}");
}

#[test]
fn a_difference_names_what_changes_and_nothing_else() {
    let folder = Folder::new();
    let (_, json) = folder.json("export --machine new.toml --control fanuc --diff old.toml");
    let names: Vec<&str> =
        json["changes"].as_array().unwrap().iter().map(|c| c["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["19666", "19709"]);
    assert!((json["changes"][0]["change"].as_f64().unwrap() - 0.05).abs() < 1e-9);
    let (_, out, _) = folder.run("export --machine new.toml --control fanuc --diff new.toml");
    assert_eq!(out, "nothing changes\n");
    // A stand-off stands in a remark alone, and is no less told where a code of 0 or 1 changes, too.
    for more in ["", "[axes.B]\nsense = -1\n"] {
        let new = format!("schema = 1\n[head]\nr_mm = 214.7\nstandoff_mm = 2.1\n{more}");
        folder.put("off.toml", &new);
        folder.put("on.toml", "schema = 1\n[head]\nr_mm = 214.7\nstandoff_mm = 1.0\n");
        let (_, out, _) = folder.run("export --machine off.toml --control fanuc --diff on.toml");
        assert!(out.contains("stand-off, 2.1000 mm"), "{out}");
    }
}

#[test]
fn a_machine_of_another_kind_is_not_exported_as_if_it_were_this_one() {
    let folder = Folder::new();
    folder.put("ac.toml", "schema = 1\n[kinematics]\norder = \"w C A b X Y Z t\"\n[axes.A]\npoint_mm = [0.0, 50.0, 0.0]\n");
    let (code, out, err) = folder.run("export --machine ac.toml --control siemens");
    assert!(code == 2 && out.is_empty() && err.contains("head B / table C"), "{err}");
    assert!(Path::new(&folder.path("ac.toml")).exists());
}
