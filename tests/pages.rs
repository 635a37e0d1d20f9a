//! The pages that `report` makes: everything on one, seen in a browser, printed on A4.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

#[path = "common/program.rs"]
mod program;

use std::path::Path;
use std::process::{Command, Output};

use program::{ok, refused, run, session};

#[test]
fn a_report_is_one_page_that_needs_nothing_else() {
    let dir = session();
    let dir = dir.path();
    ok(dir, &["solve", "session.toml", "--format", "json", "--out", "solve.json"]);
    ok(dir, &["report", "solve.json", "--title", "Cell <3>"]);
    let page = std::fs::read_to_string(dir.join("solve.html")).unwrap();
    for word in [
        "Cell &lt;3&gt;",
        "class=\"verdict",
        "ΔX, B axis to optical axis, mm",
        "What to do next",
        "U (95 %)",
        "<td>I1</td>",
    ] {
        assert!(page.contains(word), "{word} is missing");
    }
    for outside in ["src=\"http", "href=\"http", "@import", "<script"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert_eq!(page.find("verdict").map(|v| v < page.find("<table").unwrap_or(0)), Some(true));
    // A machine file is no measurement, and its page does not call it one.
    std::fs::write(dir.join("machine.toml"), "schema = 1\n[head]\nr_mm = 180.0\n").unwrap();
    ok(dir, &["machine", "machine.toml", "--format", "json", "--out", "machine.json"]);
    ok(dir, &["report", "machine.json"]);
    let page = std::fs::read_to_string(dir.join("machine.html")).unwrap();
    assert!(page.contains("<b>COMPUTED</b>") && !page.contains("MEASURED"), "{page}");
    refused(dir, &["report", "session.toml"], "is not a JSON result");
    std::fs::write(dir.join("other.json"), "{\"a\": 1}").unwrap();
    refused(dir, &["report", "other.json"], "not a result of pivotsight");
    let text =
        r#"{"schema": "pivotsight.burn/1", "distance_mm": "0.01", "distance_u95_mm": 0.002}"#;
    std::fs::write(dir.join("text.json"), text).unwrap();
    refused(dir, &["report", "text.json"], "distance_mm is '0.01', not a number");
    refused(dir, &["report", "solve.json", "--picture", "session.toml"], "not PNG, JPEG or SVG");
}

/// A picture that was refused is no measurement, and its reason stands on the page.
#[test]
fn a_refused_picture_is_told_with_its_reason() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let text = r#"{"schema": "pivotsight.burn/1", "input": ["a.png"], "results": [{"image": "a.png", "error": "a.png: no ring was found"}]}"#;
    std::fs::write(dir.join("burn.json"), text).unwrap();
    ok(dir, &["report", "burn.json"]);
    let page = std::fs::read_to_string(dir.join("burn.html")).unwrap();
    assert!(page.contains("NOT MEASURED") && page.contains("no ring was found"), "{page}");
    assert!(!page.contains("No limit applies") && !page.contains("the offset must be gone"));
}

/// An uncertainty shows in two digits beside what it is of, however small.
#[test]
fn the_sizes_of_a_diagnosis_have_their_uncertainties() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let text = r#"{"schema": "pivotsight.diagnose/1", "verdict": "named", "effects": [{"name": "b-zero",
        "parameters": {"angle_deg": 0.00039512}, "parameters_u95": {"angle_deg": 0.0000118}}]}"#;
    std::fs::write(dir.join("found.json"), text).unwrap();
    ok(dir, &["report", "found.json"]);
    let page = std::fs::read_to_string(dir.join("found.html")).unwrap();
    assert!(page.contains("0.000395 ± 0.000012"), "{page}");
}

/// Headless Chromium's view of a page: its document after loading, and its width in the window.
fn browser(page: &Path, more: &[&str]) -> Option<Output> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let profile = tempfile::tempdir().unwrap();
    names.iter().find_map(|name| {
        Command::new(name)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--window-size=900,1200",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .args(more)
            .arg(format!("file://{}", page.display()))
            .output()
            .ok()
    })
}

#[test]
fn reports_stand_in_a_browser_and_print_on_a4() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let burns = root.join("images/burn-clean");
    // The page tells a calibration's age: this one is new.
    let calib = dir.join("calib.toml");
    std::fs::write(&calib, std::fs::read(burns.join("calib.toml")).unwrap()).unwrap();
    let (session, picture) = (root.join("calib/session.toml"), burns.join("burn-0001.png"));
    let [calib, session, picture] = [&calib, &session, &picture].map(|p| p.to_str().unwrap());
    let burn = run(
        dir,
        &[
            "burn",
            picture,
            "--calib",
            calib,
            "--overlay",
            "o",
            "--format",
            "json",
            "--out",
            "burn.json",
        ],
    );
    assert_eq!(burn.status.code(), Some(1));
    ok(dir, &["solve", session, "--format", "json", "--out", "solve.json"]);
    std::fs::write(
        dir.join("job.toml"),
        format!("schema = 1\ncalib = '{calib}'\noverlay = true\n[measure.burn]\n"),
    )
    .unwrap();
    run(dir, &["batch", picture, "--job", "job.toml", "--out", "batch"]);
    ok(dir, &["thermal", "simulate", "heat"]);
    let (head, screw) = ("heat/head.csv", "heat/screw.csv");
    ok(dir, &["thermal", "fit", "--head", head, "--screw", screw, "--out", "model.json"]);
    let lengths = ["--path", "zb,zb-y150", "--error", "X0B=0.02", "--noise-mm", "0.0005"];
    ok(
        dir,
        &[&["ballbar", "simulate", "--format", "csv", "--out", "bar.csv"], &lengths[..]].concat(),
    );
    let bar = ["ballbar", "decouple", "--data", "bar.csv", "--format", "json", "--out", "bar.json"];
    ok(dir, &bar);
    for result in ["burn.json", "solve.json", "batch", "model.json", "bar.json"] {
        ok(dir, &["report", result, "--quiet"]);
    }
    let expected: [(&str, &[&str]); 5] = [
        (
            "model.html",
            &[
                "X screw: slope at T max, µm/m",
                "head sensor 6, µm/°C",
                "Slopes of the screws",
                "thermal compensate",
            ],
        ),
        (
            "bar.html",
            &[
                "X0B, B axis off in X, mm",
                "Particle swarm",
                "together change no length",
                "Measure the path xbk-y150",
            ],
        ),
        (
            "burn.html",
            &[
                "FAIL",
                "Uncertainty budget",
                "edge of the spot",
                "0 days: last changed",
                "Turn B by",
            ],
        ),
        ("solve.html", &["PASS", "ΔX, B axis to optical axis", "touch X1", "rod parallel to Z"]),
        (
            "batch/summary.html",
            &["FAIL", "Pictures to look at", "burn-0001.png", "Out of limits: 1"],
        ),
    ];
    for (name, words) in expected {
        let page = dir.join(name);
        let text = std::fs::read_to_string(&page).unwrap();
        let loads = ["http://", "https://", "src=\"o/", "<link", "<script"];
        assert!(
            !loads.iter().any(|l| text.replace("http://www.w3.org/", "").contains(l)),
            "{name}"
        );
        // A script put into a copy tells what the browser made of the page.
        let probe = "<script>addEventListener('load', () => { const d = document; d.title = JSON.stringify({ \
             wide: d.documentElement.scrollWidth - innerWidth, \
             broken: [...d.images].filter(i => !i.naturalWidth).length, \
             pictures: d.images.length, words: d.body.innerText.length }) })</script></body>";
        let copy = dir.join("probe.html");
        std::fs::write(&copy, text.replace("</body>", probe)).unwrap();
        let Some(shown) = browser(&copy, &["--virtual-time-budget=3000", "--dump-dom"]) else {
            println!("chromium is not installed: the pages were not looked at in a browser");
            return;
        };
        let dom = String::from_utf8_lossy(&shown.stdout).into_owned();
        let title =
            dom.split("<title>").nth(1).and_then(|t| t.split("</title>").next()).unwrap_or("");
        let seen: serde_json::Value = serde_json::from_str(&title.replace("&quot;", "\""))
            .unwrap_or_else(|e| panic!("{name}: {e}: {title}"));
        assert!(
            seen["wide"].as_i64().is_some_and(|w| w <= 0),
            "{name} is wider than the window: {seen}"
        );
        assert_eq!(seen["broken"], 0, "{name}");
        assert!(
            seen["pictures"].as_i64()
                >= Some(i64::from(name.starts_with('b') && name != "bar.html")),
            "{name}: {seen}"
        );
        words.iter().for_each(|w| assert!(dom.contains(w), "{name} does not say {w}"));
        let pdf = dir.join("page.pdf");
        browser(&page, &["--no-pdf-header-footer", &format!("--print-to-pdf={}", pdf.display())]);
        let pdf = std::fs::read(&pdf).unwrap();
        let pdf = String::from_utf8_lossy(&pdf);
        // A4 in points, rounded as the browser does.
        assert!(
            pdf.contains("/MediaBox [0 0 594.95996 841.91998]")
                || pdf.contains("/MediaBox [0 0 595"),
            "{name}"
        );
    }
}
