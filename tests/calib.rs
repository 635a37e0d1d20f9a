//! What calibrating promises: the plane, the laser and the check, end to end on rendered pictures with known truth.

#[path = "common/json.rs"]
mod json;
#[path = "common/schema.rs"]
mod schema;

use std::path::Path;

use json::run;
use nalgebra::Vector2;
use pivotsight::camera::Calibration;
use pivotsight::render::{BurnScene, burn};
use schema::unlike_its_schema;
use serde_json::Value;

/// A camera that is tilted, turned and distorted; it sees a disc with a brighter heart on bare metal.
const CAMERA: &str = "
[camera]
width_px = 800
height_px = 600
pixel_mm = 0.016
focal_px = 1760.0
axis_shift_px = [6.0, -4.0]
distortion = [-0.06, 0.02, 0.0, 0.0, 0.0]
tilt_deg = [1.2, -0.8]
roll_deg = 2.0
";

/// Photographs a disc at `place_mm` of the plane.
fn photograph(path: &Path, place_mm: Vector2<f64>, radius_mm: f64, seed: u64) -> Calibration {
    let text = format!(
        "schema = 1\nkind = 'burn'\n{CAMERA}\n[ring]\ncenter_mm = [{}, {}]\nradius_mm = {radius_mm}\ninner_ratio = 0.0\n\
         level = 0.25\n[spot]\noffset_mm = [0.0, 0.0]\nradius_mm = 0.08\nlevel = 0.7\n",
        place_mm.x, place_mm.y
    );
    let file = path.with_extension("toml");
    std::fs::write(&file, text).unwrap();
    // One camera for all: everything of it is fixed.
    let made = burn::render(&BurnScene::read(&file).unwrap(), seed).unwrap();
    made.picture.write_png(path).unwrap();
    made.camera.calibration
}

const MARK: Vector2<f64> = Vector2::new(113.4, -41.7);

/// A plus-shaped round of positions about the mark, and its captures table written by `line`.
fn captures(
    folder: &Path,
    radius_mm: f64,
    line: impl Fn(&str, Vector2<f64>) -> String,
) -> (Calibration, String) {
    let places: [(f64, f64); 9] = [
        (0.1, 0.2),
        (4.6, 0.3),
        (-4.7, -0.2),
        (0.3, 3.4),
        (-0.1, -3.5),
        (4.2, 3.1),
        (-4.3, -3.0),
        (4.0, -3.2),
        (-4.4, 3.3),
    ];
    let mut table = String::from("image,x_mm,y_mm\n");
    let mut truth = None;
    for (i, (x, y)) in places.into_iter().enumerate() {
        let name = format!("mark-{i}.png");
        let position = MARK - Vector2::new(x, y);
        truth = Some(photograph(&folder.join(&name), Vector2::new(x, y), radius_mm, 10 + i as u64));
        table.push_str(&line(&name, position));
    }
    let path = folder.join("captures.csv");
    std::fs::write(&path, table).unwrap();
    (truth.unwrap(), path.display().to_string())
}

fn number(json: &Value, path: &str) -> f64 {
    json.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path} in {json:#}"))
}

#[test]
fn the_machine_is_the_ruler_of_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let (truth, table) =
        captures(folder.path(), 0.25, |name, p| format!("{name},{},{}\n", p.x, p.y));
    let calib = folder.path().join("found.toml");
    let lens = folder.path().join("lens.toml");
    std::fs::write(&lens, truth.to_toml()).unwrap();
    let (json, code, _) = run(&[
        "calib",
        "plane",
        &table,
        "--lens",
        lens.to_str().unwrap(),
        "--write-calib",
        calib.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(0), "{json:#}");
    assert_eq!(unlike_its_schema(&json), [""; 0]);
    assert_eq!(json["orientation"], "upright");
    let view = truth.view(800, 600).unwrap();
    let scale = view.mm_per_px(view.axis_px());
    let truth_scale = scale.determinant().abs().sqrt();
    assert!(
        (number(&json, "/mm_per_px") - truth_scale).abs() < 2.0 * number(&json, "/mm_per_px_u95")
    );
    assert!((number(&json, "/mm_per_px") / truth_scale - 1.0).abs() < 2e-4);
    for (k, truth) in [1.2, -0.8].into_iter().enumerate() {
        let (v, u) = (
            number(&json, &format!("/tilt_deg/{k}")),
            number(&json, &format!("/tilt_u95_deg/{k}")),
        );
        assert!((v - truth).abs() < 2.0 * u && u < 0.2, "tilt {v} ± {u}, truth {truth}");
    }
    // Every place of the frame, seen from the camera axis.
    let found = Calibration::read(&calib).unwrap().view(800, 600).unwrap();
    let u95 = number(&json, "/field_u95_mm");
    assert!(u95 < 0.008, "{u95}");
    for (u, v) in [(0.0, 0.0), (799.0, 0.0), (0.0, 599.0), (799.0, 599.0), (200.0, 450.0)] {
        let p = Vector2::new(u, v);
        let off = (found.to_plane(p) - view.to_plane(p)).norm();
        assert!(off < 1.5 * u95, "at {u}, {v}: off by {off} of {u95}");
    }
    // The calibration just made holds, and one with a wrong scale does not.
    let tolerance = ["--tolerance-mm", "0.02"];
    let good = ["calib", "check", &table, "--calib", calib.to_str().unwrap()];
    let (json, code, _) = run(&[&good[..], &tolerance].concat());
    assert_eq!((json["verdict"].as_str(), code), (Some("pass"), Some(0)), "{json:#}");
    // One slipped position is left out and told.
    let rows = std::fs::read_to_string(&table).unwrap();
    let last = rows.lines().last().unwrap();
    let (name, at) = last.split_once(',').unwrap();
    let (x, y) = at.split_once(',').unwrap();
    let slipped = format!("{name},{},{y}", x.parse::<f64>().unwrap() + 0.1);
    std::fs::write(&table, rows.replace(last, &slipped)).unwrap();
    let (json, code, _) = run(&[&good[..], &tolerance].concat());
    assert_eq!((json["verdict"].as_str(), code), (Some("pass"), Some(0)), "{json:#}");
    assert_eq!(json["captures_used"], 8, "{json:#}");
    assert!(json["warnings"][0].as_str().unwrap().contains(name), "{json:#}");
    // Positions written down wrongly all over are told as what they are, and a picture without the mark is named.
    let told = |line: &dyn Fn(usize, &str, f64, f64) -> String| {
        let mut wrong = String::from("image,x_mm,y_mm\n");
        for (i, row) in rows.lines().skip(1).enumerate() {
            let cells: Vec<&str> = row.split(',').collect();
            wrong += &line(i, cells[0], cells[1].parse().unwrap(), cells[2].parse().unwrap());
        }
        std::fs::write(&table, wrong).unwrap();
        run(&good).0["warnings"].to_string()
    };
    let said = told(&|_, name, x, y| format!("{name},{y},{x}\n"));
    assert!(said.contains("swapped"), "{said}");
    let said = told(&|_, name, x, y| format!("{name},{},{}\n", 1e-3 * x, 1e-3 * y));
    assert!(said.contains("metres"), "{said}");
    let said = told(&|i, name, x, y| format!("{name},{},{y}\n", if i == 4 { x + 3.0 } else { x }));
    assert!(said.contains("mark-4.png: left out"), "{said}");
    std::fs::write(&table, rows).unwrap();
    let text = std::fs::read_to_string(&calib).unwrap();
    let fx: f64 = text.lines().find_map(|l| l.strip_prefix("fx_px = ")).unwrap().parse().unwrap();
    let wrong = text.replace(&format!("fx_px = {fx:?}"), &format!("fx_px = {:?}", fx * 0.98));
    std::fs::write(&calib, wrong).unwrap();
    let (json, code, _) = run(&[&good[..], &tolerance].concat());
    assert_eq!((json["verdict"].as_str(), code), (Some("fail"), Some(1)), "{json:#}");
}

/// A mark a fifth of the frame's height across: distortion shapes it so much that its first places tell the plane only roughly.
#[test]
fn a_large_mark_is_as_good_a_ruler() {
    let folder = tempfile::tempdir().unwrap();
    let row = |name: &str, p: Vector2<f64>| format!("{name},{},{}\n", p.x, p.y);
    let (truth, table) = captures(folder.path(), 0.95, row);
    let lens = folder.path().join("lens.toml");
    std::fs::write(&lens, truth.to_toml()).unwrap();
    let (json, code, words) = run(&["calib", "plane", &table, "--lens", lens.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{words}");
    let view = truth.view(800, 600).unwrap();
    let ppm = 1e6 * (number(&json, "/mm_per_px") / view.pixel_mm_at(view.axis_px()) - 1.0);
    let u95_ppm = 1e6 * number(&json, "/mm_per_px_u95") / number(&json, "/mm_per_px");
    assert!(ppm.abs() < 1.5 * u95_ppm && u95_ppm < 60.0, "{ppm} of {u95_ppm} ppm");
}

#[test]
fn wrong_signs_swapped_axes_and_wrong_rows_are_said() {
    let folder = tempfile::tempdir().unwrap();
    type Line = fn(&str, Vector2<f64>) -> String;
    let cases: [(Line, &str, &str); 4] = [
        (|n, p| format!("{n},{},{}\n", -p.x, p.y), "mirrored", "x_mm has the wrong sign"),
        (|n, p| format!("{n},{},{}\n", p.x, -p.y), "mirrored", "y_mm has the wrong sign"),
        (|n, p| format!("{n},{},{}\n", p.y, p.x), "mirrored", "swapped"),
        (|n, p| format!("{n},{},{}\n", -p.x, -p.y), "turned", "both have the wrong sign"),
    ];
    let (_, table) = captures(folder.path(), 0.25, |name, p| format!("{name},{},{}\n", p.x, p.y));
    let right = std::fs::read_to_string(&table).unwrap();
    for (line, orientation, words) in cases {
        let mut text = String::from("image,x_mm,y_mm\n");
        for row in right.lines().skip(1) {
            let cells: Vec<&str> = row.split(',').collect();
            let p = Vector2::new(cells[1].parse().unwrap(), cells[2].parse().unwrap());
            text.push_str(&line(cells[0], p));
        }
        std::fs::write(&table, text).unwrap();
        let calib = folder.path().join("no.toml");
        let (json, code, _) =
            run(&["calib", "plane", &table, "--write-calib", calib.to_str().unwrap()]);
        assert_eq!(json["orientation"], orientation, "{json:#}");
        assert!(json["warnings"].to_string().contains(words), "{json:#}");
        let mirrored = orientation == "mirrored";
        assert_eq!((code, calib.exists()), (Some(i32::from(mirrored)), !mirrored));
        if mirrored {
            let own = folder.path().join("mirrored.toml");
            run(&["calib", "plane", &table, "--mirrored", "--write-calib", own.to_str().unwrap()]);
            assert!(std::fs::read_to_string(own).unwrap().contains("mirrored = true"));
        }
    }
    // One mistyped row is named and left out; too few positions are refused.
    std::fs::write(&table, right.replace("mark-3.png,113.1", "mark-3.png,113.6")).unwrap();
    let (json, code, _) = run(&["calib", "plane", &table]);
    assert_eq!(code, Some(0));
    assert!(json["warnings"].to_string().contains("mark-3.png: left out"), "{json:#}");
    let few: String = right.lines().take(5).map(|l| format!("{l}\n")).collect();
    std::fs::write(&table, few).unwrap();
    assert_eq!(run(&["calib", "plane", &table]).1, Some(2));
}

/// The loop that settles the sign: a simulated machine whose camera axis lies `-offset` from the laser axis burns and
/// photographs; the offset found brings the laser onto a mark that the camera sees.
#[test]
fn the_laser_lands_on_what_the_camera_saw() {
    let folder = tempfile::tempdir().unwrap();
    let offset = Vector2::new(12.35, -3.8); // laser axis seen from the camera axis
    // Machine coordinates say where the laser axis is, so the camera axis is at P - offset.
    let seen_at = |mark: Vector2<f64>, machine: Vector2<f64>| mark - (machine - offset);
    let mut table = String::from("image,burn_x_mm,burn_y_mm,x_mm,y_mm\n");
    let mut truth = None;
    for (i, (dx, dy)) in [(0.4, 0.3), (-1.1, 0.9), (1.6, -1.2)].into_iter().enumerate() {
        let burnt = Vector2::new(50.0 + 4.0 * i as f64, 20.0);
        let machine = burnt + offset + Vector2::new(dx, dy);
        let name = format!("burn-{i}.png");
        truth = Some(photograph(
            &folder.path().join(&name),
            seen_at(burnt, machine),
            0.7,
            40 + i as u64,
        ));
        table.push_str(&format!("{name},{},{},{},{}\n", burnt.x, burnt.y, machine.x, machine.y));
    }
    let burns = folder.path().join("burns.csv");
    std::fs::write(&burns, table).unwrap();
    let calib = folder.path().join("calib.toml");
    std::fs::write(&calib, truth.unwrap().to_toml()).unwrap();
    let calib = calib.to_str().unwrap();
    let (json, code, _) = run(&[
        "calib",
        "laser",
        burns.to_str().unwrap(),
        "--calib",
        calib,
        "--diameter-mm",
        "1.4",
        "--write-calib",
        calib,
    ]);
    assert_eq!(code, Some(0), "{json:#}");
    assert_eq!(unlike_its_schema(&json), [""; 0]);
    for k in 0..2 {
        let off = (number(&json, &format!("/offset_mm/{k}")) - offset[k]).abs();
        let u95 = number(&json, &format!("/offset_u95_mm/{k}"));
        assert!(off < 1.5 * u95 && u95 < 0.01, "off by {off} of {u95}");
    }
    // One burn mistyped: its row is named, and nothing is written.
    let text = std::fs::read_to_string(&burns).unwrap();
    let wrong = folder.path().join("wrong.csv");
    std::fs::write(&wrong, text.replace("burn-1.png,54,", "burn-1.png,45,")).unwrap();
    let wrong = wrong.to_str().unwrap();
    let args = ["calib", "laser", wrong, "--calib", calib, "--diameter-mm", "1.4"];
    let (_, code, said) = run(&args);
    assert_eq!(code, Some(2));
    assert!(said.contains("wrong.csv: line 3: burn-1.png") && said.contains("burn_x_mm"), "{said}");
    // A picture that is not there: its row is named.
    std::fs::write(wrong, text.replace("burn-1.png", "burn-9.png")).unwrap();
    let (_, code, said) = run(&args);
    assert_eq!(code, Some(2));
    assert!(
        said.contains("wrong.csv: line 3: ") && said.contains("burn-9.png: cannot read"),
        "{said}"
    );
    // The other way round: where must the machine go to fire at a mark that the camera sees?
    let mark = Vector2::new(77.0, 9.0);
    let machine = mark + offset + Vector2::new(-0.7, 1.3);
    let picture = folder.path().join("target.png");
    photograph(&picture, seen_at(mark, machine), 0.7, 60);
    let (json, _, _) =
        run(&["circles", picture.to_str().unwrap(), "--calib", calib, "--expect-mm", "1.4"]);
    let place = Vector2::new(
        number(&json, "/circles/0/center_mm/0"),
        number(&json, "/circles/0/center_mm/1"),
    );
    let laser = Calibration::read(calib).unwrap().laser;
    let there = pivotsight::calib::laser::machine_mm(machine, place, laser.as_ref());
    assert!((there - mark).norm() < 0.005, "the laser would miss by {} mm", (there - mark).norm());
}

/// `rod` reports machine coordinates: with a laser offset, where the laser axis would be over the rod.
#[test]
fn the_rod_is_found_where_the_laser_would_be_over_it() {
    let source = Path::new("images/rod-typical");
    let folder = tempfile::tempdir().unwrap();
    let offset = [3.0, -2.0];
    let calib = folder.path().join("calib.toml");
    let text = std::fs::read_to_string(source.join("calib.toml")).unwrap();
    std::fs::write(
        &calib,
        format!("{text}\n[laser]\noffset_mm = [3.0, -2.0]\noffset_u95_mm = [0.01, 0.02]\n"),
    )
    .unwrap();
    // With the laser `offset` from the camera axis the control shows that much more for the same picture.
    let rows = std::fs::read_to_string(source.join("rod-0001.csv")).unwrap();
    let mut table = String::new();
    for (i, row) in rows.lines().enumerate() {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        if i > 0 {
            cells[0] = std::fs::canonicalize(source.join(&cells[0])).unwrap().display().to_string();
            for k in 0..2 {
                cells[1 + k] = (cells[1 + k].parse::<f64>().unwrap() + offset[k]).to_string();
            }
        }
        table.push_str(&(cells.join(",") + "\n"));
    }
    let captures = folder.path().join("captures.csv");
    std::fs::write(&captures, table).unwrap();
    let plain = source.join("rod-0001.csv");
    let plain_calib = source.join("calib.toml");
    let (without, _, _) =
        run(&["rod", plain.to_str().unwrap(), "--calib", plain_calib.to_str().unwrap()]);
    let (with, ..) = run(&["rod", captures.to_str().unwrap(), "--calib", calib.to_str().unwrap()]);
    for k in 0..2 {
        let path = format!("/axis_center_mm/{k}");
        let away = number(&with, &path) - number(&without, &path);
        assert!(away.abs() < 1e-3, "{away}");
        assert!(number(&with, &format!("/axis_center_u95_mm/{k}")) >= [0.01, 0.02][k]);
    }
    let largest = &with["budget"][0];
    assert_eq!(largest["source"], "laser offset", "{largest}");
}
