//! Every JSON output keeps the schema the program prints for it, and has the keys other programs read.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

#[path = "common/line.rs"]
mod line;
#[path = "common/schema.rs"]
mod schema;

use std::collections::BTreeSet;
use std::path::Path;

use line::run;
use schema::{schema, unlike_its_schema};
use serde_json::{Value, json};

fn prepare(dir: &Path, line: &str) {
    let output = run(dir, line);
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Runs a command and holds its JSON against its schema; the exit code is the caller's business.
fn valid(dir: &Path, line: &str) -> Value {
    let output = run(dir, &format!("{line} --format json --quiet"));
    let problem = String::from_utf8_lossy(&output.stderr);
    let result: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{line}: no JSON ({e}): {problem}"));
    let wrong = unlike_its_schema(&result);
    assert!(wrong.is_empty(), "{line}:\n{}", wrong.join("\n"));
    result
}

/// What other programs rely on (the keys of the envelope are checked everywhere).
fn has(result: &Value, pointers: &[&str]) {
    for pointer in pointers {
        assert!(result.pointer(pointer).is_some(), "{} has no {pointer}", result["schema"]);
    }
}

const BURN: [&str; 22] = [
    "/image",
    "/ring/center_mm/1",
    "/ring/center_px/1",
    "/ring/diameter_mm",
    "/ring/center_u95_mm/1",
    "/spot/edge_points",
    "/spot/arc_coverage",
    "/spot/form_rms_mm",
    "/offset_mm/1",
    "/offset_u95_mm/1",
    "/offset_cov_mm2/1/1",
    "/distance_mm",
    "/distance_u95_mm",
    "/zone_mm",
    "/zone_u95_mm",
    "/tolerance_mm",
    "/verdict",
    "/correction/b_deg",
    "/correction/shim_deg",
    "/correction/shim_mm",
    "/correction/shim_u95_mm",
    "/warnings",
];

#[test]
fn every_output_keeps_its_schema() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let write = |name: &str, text: &str| std::fs::write(dir.join(name), text).unwrap();
    let mut seen = BTreeSet::new();
    let mut check = |line: &str, pointers: &[&str]| -> Value {
        let result = valid(dir, line);
        has(&result, &["/version", "/input", "/warnings"]);
        has(&result, pointers);
        let id = result["schema"].as_str().unwrap();
        seen.insert(id.trim_start_matches("pivotsight.").trim_end_matches("/1").to_owned());
        result
    };

    // Pictures.
    let burns = "{root}/images/burn-clean";
    check(&format!("burn {burns}/burn-0001.png --calib {burns}/calib.toml --flange-mm 100"), &BURN);
    let several =
        format!("burn {burns}/burn-0001.png {burns}/calib.toml --calib {burns}/calib.toml");
    check(&several, &["/results/0/offset_mm", "/results/1/error"]);
    check(
        &format!(
            "burn {burns}/burn-0001.png {burns}/burn-0002.png --calib {burns}/calib.toml --mean"
        ),
        &["/mean/tests", "/mean/offset_mm/1", "/mean/verdict", "/mean/p_agree"],
    );
    check(
        &format!(
            "circles {burns}/burn-0001.png --calib {burns}/calib.toml --expect-mm 5.75 --expect-mm 0.81"
        ),
        &[
            "/circles/1/expect_mm",
            "/circles/0/center_mm/1",
            "/circles/0/center_px/1",
            "/circles/0/diameter_mm",
            "/circles/0/center_u95_mm/1",
            "/circles/0/diameter_u95_mm",
            "/circles/0/edge_points",
            "/circles/0/arc_coverage",
            "/circles/0/form_rms_mm",
            "/pairs/0/a",
            "/pairs/0/b",
            "/pairs/0/offset_mm/1",
            "/pairs/0/distance_mm",
            "/pairs/0/distance_u95_mm",
            "/pairs/0/zone_mm",
            "/pairs/0/zone_u95_mm",
        ],
    );
    std::fs::create_dir(dir.join("shots")).unwrap();
    let burn = Path::new(env!("CARGO_MANIFEST_DIR")).join("images/burn-clean/burn-0001.png");
    std::fs::copy(burn, dir.join("shots/1.png")).unwrap();
    write("at.csv", "x_mm,y_mm\n10,20\n");
    check(
        "capture shots --store stored --positions at.csv",
        &["/manifest", "/results/0/image", "/results/0/x_mm", "/received"],
    );
    check(
        &format!(
            "center shots --calib {burns}/calib.toml --diameter-mm 5.75 --u95-mm 1 --at 1,2 --store kept --timeout-s 20"
        ),
        &["/offset_mm/1", "/move_mm/1", "/verdict", "/center_machine_mm/1", "/stored"],
    );
    let rods = "{root}/images/rod-typical";
    check(
        &format!("rod {rods}/rod-0001.csv --calib {rods}/calib.toml --points points.csv"),
        &[
            "/rod_centers/0/c_deg",
            "/rod_centers/0/center_mm/1",
            "/rod_centers/0/center_u95_mm/1",
            "/axis_center_mm/1",
            "/axis_center_u95_mm/1",
            "/eccentricity_mm",
            "/diameter_mm",
            "/diameter_u95_mm",
            "/form_rms_mm",
            "/captures/0",
        ],
    );
    check("render burn --preset clean --binning 4 --out-dir rendered", &["/results/0/truth"]);
    check("render rod --preset clean --binning 4 --out-dir rendered", &["/results/0/truth"]);
    check("demo --out-dir demo", &["/closed"]);
    check("demo --hidden-effect --out-dir hidden", &["/found", "/gap/heldout_after_rms_mm"]);
    write(
        "job.toml",
        "schema = 1\ncalib = \"rendered/calib.toml\"\n[measure.burn]\n[limits]\nzone_mm = { max = 1.0 }\n",
    );
    check("batch rendered/*.png --job job.toml --dry-run", &["/dry_run", "/images/0"]);
    check(
        "batch rendered/burn-0001.png --job job.toml --out batch",
        &["/statistics/0/column", "/files/0"],
    );
    check("regress {root}/images/burn-clean", &["/cases/0/checks/0/drift"]);

    // Machine.
    let machine = "{root}/calib/machine.toml";
    check(
        "solve {root}/calib/session.toml --records records.sqlite",
        &[
            "/xb_mm",
            "/zb_mm",
            "/xc_mm",
            "/yc_mm",
            "/delta_x_mm",
            "/r_mm",
            "/xb_u95_mm",
            "/zb_u95_mm",
            "/xc_u95_mm",
            "/yc_u95_mm",
            "/delta_x_u95_mm",
            "/r_u95_mm",
            "/i1_mm/2",
            "/i2_mm/2",
            "/i3_mm/2",
            "/i4_mm/2",
            "/budget/0/share_percent",
        ],
    );
    check("history --records records.sqlite", &["/records/0/result/delta_x_mm"]);
    check("history export --records records.sqlite", &["/records/0/input_sha256"]);
    check(&format!("machine {machine}"), &["/axes/0/name"]);
    check(&format!("export --machine {machine} --control siemens"), &["/parameters/0/value"]);
    write("other.toml", "schema = 1\n[head]\ndelta_x_mm = 0.25\nr_mm = 214.6\n");
    check(
        &format!("export --machine {machine} --control fanuc --diff other.toml"),
        &["/changes/0/change"],
    );
    write("poses.csv", "x_mm,y_mm,z_mm,b_deg,c_deg\n10,20,30,40,50\n");
    check(&format!("rtcp inverse --machine {machine} --poses poses.csv"), &["/poses/0/jx_mm"]);
    check(&format!("rtcp forward --machine {machine} --poses poses.csv"), &["/poses/0/px_mm"]);
    write("directions.csv", "x_mm,y_mm,z_mm,i,j,k\n10,20,30,0.6,0,0.8\n");
    check(&format!("rtcp inverse --machine {machine} --poses directions.csv"), &["/poses/1/note"]);
    check(&format!("verify --machine {machine} --plan sweep"), &["/files/1"]);
    let sweep = "--data sweep/poses.csv --noise-mm 0.001";
    check(&format!("simulate rtcp --model {machine} {sweep}"), &["/rows/0/dx_mm"]);
    prepare(
        dir,
        &format!("simulate rtcp --model {machine} {sweep} --format csv --out measured.csv"),
    );
    check(
        &format!("verify --machine {machine} --data measured.csv --report page"),
        &["/before/worst_mm", "/after/rms_mm", "/rows/0/left_mm", "/plot"],
    );
    check(
        &format!("diagnose rtcp --model {machine} --data measured.csv"),
        &[
            "/verdict",
            "/noise_mm",
            "/effects",
            "/unnamed",
            "/gap/heldout_after_rms_mm",
            "/next_measurement",
        ],
    );
    check(
        &format!(
            "diagnose rtcp --model {machine} --data measured.csv --plan-only --noise-mm 0.001"
        ),
        &["/detectable/0/name"],
    );

    // Pages.
    prepare(
        dir,
        &format!(
            "verify --machine {machine} --data measured.csv --format json --out verified.json"
        ),
    );
    check("report verified.json", &["/page"]);

    // Other methods.
    check(
        "rotary {root}/docs/examples/k197-1.csv --pivot-mm 573",
        &[
            "/rows/0/angle_deg",
            "/rows/0/error_deg",
            "/rows/0/error_u95_deg",
            "/rows/0/comp_old_deg",
            "/rows/0/comp_new_deg",
        ],
    );
    check(
        "align {root}/docs/examples/blank.csv",
        &[
            "/a_deg",
            "/b_deg",
            "/dz_mm",
            "/center_mm",
            "/a_u95_deg",
            "/b_u95_deg",
            "/dz_u95_mm",
            "/center_u95_mm",
        ],
    );
    prepare(dir, "align {root}/docs/examples/blank.csv --format json --out align.json");
    let apply = "align apply --align align.json --machine {root}/docs/examples/machine-ac.toml";
    check(&format!("{apply} {{root}}/docs/examples/path.apt moved.nc"), &["/log/moves"]);
    check("ballbar plan", &["/rows/600/length_mm"]);
    check("ballbar simulate --error X0B=0.01 --noise-mm 0.001", &["/rows/0/length_mm"]);
    prepare(dir, "ballbar simulate --error X0B=0.01 --noise-mm 0.001 --format csv --out bar.csv");
    check(
        "ballbar decouple --data bar.csv",
        &[
            "/rank",
            "/singular_values/0",
            "/visible/0/name",
            "/visible/0/value",
            "/visible/0/unit",
            "/visible/0/u95",
            "/not_visible/0",
            "/combinations",
            "/swarm/0/value",
        ],
    );
    prepare(dir, "thermal simulate heat");
    check("thermal fit --head heat/head.csv --screw heat/screw.csv", &["/head", "/screws/0/t0_c"]);
    prepare(dir, "thermal fit --head heat/head.csv --screw heat/screw.csv --out model.json");
    check("thermal compensate --model model.json --table heat/day.csv", &["/rows/0/correction_mm"]);
    write("bar.toml", "schema = 1\n[head]\ndelta_x_mm = 0.1\nr_mm = 400.0\n");
    check("simulate ballbar --model bar.toml --data bar.csv", &["/kind", "/rows/0/length_mm"]);
    check(
        &format!(
            "calib check {burns}/burn-0001.png --calib {burns}/calib.toml --diameter-mm 5.751"
        ),
        &["/verdict", "/results/0/deviation_mm"],
    );
    check("calib target chessboard:8x6:5 --out target.svg", &["/points"]);
    check("config", &["/defaults"]);
    // These need a machine that moves, or OpenCV: tests/calib.rs and tests/opencv.rs hold them against their schemas.
    seen.extend(["calib-camera", "calib-laser", "calib-plane"].map(str::to_owned));
    let all: Value = serde_json::from_slice(&run(dir, "schema --format json").stdout).unwrap();
    let all: BTreeSet<String> = serde_json::from_value(all["schemas"].clone()).unwrap();
    assert_eq!(seen, all, "commands checked here, and commands with a schema");
}

#[test]
fn a_schema_is_versioned_and_refuses_what_is_wrong() {
    let dir = tempfile::tempdir().unwrap();
    let burn = schema("burn");
    assert_eq!(burn["$id"], "https://pivotsight.github.io/schema/burn-1.json");
    assert_eq!(burn["properties"]["schema"]["const"], "pivotsight.burn/1");
    let validator = jsonschema::validator_for(&burn).unwrap();
    let nothing =
        json!({"schema": "pivotsight.burn/1", "version": "0", "input": "a.png", "warnings": []});
    assert!(!validator.is_valid(&nothing));
    let mut failed = nothing;
    failed["image"] = json!("a.png");
    failed["error"] = json!("a.png: no ring");
    assert!(validator.is_valid(&failed));
    failed["schema"] = json!("pivotsight.burn/2");
    assert!(!validator.is_valid(&failed));
    assert_eq!(run(dir.path(), "schema brun").status.code(), Some(2));
}
