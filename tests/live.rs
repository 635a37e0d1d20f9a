//! What the live camera promises: guiding from a folder or an MJPEG stream, honest counts, and nothing stored is lost.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use nalgebra::Vector2;
use pivotsight::live::Shot;
use pivotsight::live::store::{Position, Store};
use pivotsight::render::{BurnScene, burn};
use serde_json::Value;

/// A round mark of 5 mm in a frame of 2 megapixels, `place` from the camera axis; each seed has its own noise.
fn frames(folder: &Path, place: Vector2<f64>, count: u64) -> Vec<Vec<u8>> {
    let text = format!(
        "schema = 1\nkind = 'burn'\n[camera]\nwidth_px = 1632\nheight_px = 1224\npixel_mm = 0.008\n\
         tilt_deg = [0.8, -0.5]\n[ring]\ncenter_mm = [{}, {}]\nradius_mm = 2.5\ninner_ratio = 0.0\nlevel = 0.25\n\
         [spot]\noffset_mm = [0.0, 0.0]\nradius_mm = 0.4\nlevel = 0.3\n",
        place.x, place.y
    );
    let scene = folder.join("scene.toml");
    std::fs::write(&scene, text).unwrap();
    let scene = BurnScene::read(&scene).unwrap();
    (0..count)
        .map(|seed| {
            let made = burn::render(&scene, seed).unwrap();
            std::fs::write(folder.join("calib.toml"), made.camera.calibration.to_toml()).unwrap();
            let gray: Vec<u8> = made.picture.values.iter().map(|v| *v as u8).collect();
            // Colour, as cameras send it.
            let rgb: Vec<u8> = gray.iter().flat_map(|g| [*g, *g, g.saturating_sub(6)]).collect();
            let mut jpeg = Vec::new();
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 90)
                .encode(&rgb, 1632, 1224, image::ExtendedColorType::Rgb8)
                .unwrap();
            jpeg
        })
        .collect()
}

/// What the server does with a connection: for the n-th frame, how long to wait before it, or to hang up.
type Script = fn(connection: usize, frame: usize) -> Option<Duration>;

/// Serves frames over and over on the loopback address; gives the URL and how far it is: 1000 a connection, 1 a frame.
fn serve(frames: Vec<Vec<u8>>, with_length: bool, script: Script) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/stream", listener.local_addr().unwrap());
    let progress = Arc::new(AtomicUsize::new(0));
    let theirs = Arc::clone(&progress);
    std::thread::spawn(move || {
        for (number, socket) in listener.incoming().enumerate() {
            let told = |frame: usize| {
                theirs.store(1000 * number + frame, Ordering::SeqCst);
                script(number, frame)
            };
            let _ = talk(socket.unwrap(), &frames, with_length, told);
        }
    });
    (url, progress)
}

fn talk(
    mut socket: TcpStream,
    frames: &[Vec<u8>],
    with_length: bool,
    script: impl Fn(usize) -> Option<Duration>,
) -> std::io::Result<()> {
    let mut request = [0u8; 1000];
    let _ = socket.read(&mut request)?;
    socket.write_all(
        b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=--frame\r\n\r\n",
    )?;
    for n in 0.. {
        let Some(wait) = script(n) else { return Ok(()) };
        std::thread::sleep(wait);
        let jpeg = &frames[n % frames.len()];
        let length =
            if with_length { format!("Content-Length: {}\r\n", jpeg.len()) } else { String::new() };
        socket
            .write_all(format!("--frame\r\nContent-Type: image/jpeg\r\n{length}\r\n").as_bytes())?;
        socket.write_all(jpeg)?;
        socket.write_all(b"\r\n")?;
    }
    Ok(())
}

fn program(args: &[&str]) -> Command {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("pivotsight"));
    // One core: pictures are measured by one thread.
    command.args(args).args(["--format", "json"]).env("RAYON_NUM_THREADS", "1");
    command
}

fn run(args: &[&str]) -> (Value, Option<i32>, String) {
    let out = program(args).output().unwrap();
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    let json = serde_json::from_slice(&out.stdout).unwrap_or(Value::Null);
    (json, out.status.code(), words)
}

fn number(json: &Value, path: &str) -> f64 {
    json.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path} in {json:#}"))
}

const PLACE: Vector2<f64> = Vector2::new(0.731, -0.462);

/// An uncertainty that is never reached.
const NEVER: &str = "1e-7";

/// A folder of pictures to be looked at, and the calibration beside it.
struct Pictures {
    folder: tempfile::TempDir,
}

impl Pictures {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("pictures")).unwrap();
        Self { folder }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn picture(&self, name: &str) -> PathBuf {
        self.path().join("pictures").join(name)
    }

    /// Guides from it to that uncertainty, mm.
    fn center(&self, u95: &str, more: &[&str]) -> (Value, Option<i32>, String) {
        let (pictures, calib) = (self.path().join("pictures"), self.path().join("calib.toml"));
        let (pictures, calib) = (pictures.to_str().unwrap(), calib.to_str().unwrap());
        let mut all = vec!["center", pictures, "--calib", calib, "--u95-mm", u95];
        all.extend(more);
        run(&all)
    }
}

#[test]
fn a_stream_guides_and_its_frames_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let frames = frames(folder.path(), PLACE, 4);
    let calib = folder.path().join("calib.toml");
    let text = std::fs::read_to_string(&calib).unwrap();
    std::fs::write(&calib, format!("{text}\n[laser]\noffset_mm = [10.0, 0.0]\n")).unwrap();
    // 40 frames a second with lengths, then without.
    for with_length in [true, false] {
        let (url, _) = serve(frames.clone(), with_length, |_, _| Some(Duration::from_millis(25)));
        let overlay = folder.path().join("seen.png");
        // An uncertainty that is never reached, so that the time is used up.
        let (json, code, words) = run(&[
            "center",
            &url,
            "--calib",
            calib.to_str().unwrap(),
            "--diameter-mm",
            "5",
            "--u95-mm",
            "0.000001",
            "--timeout-s",
            "4",
            "--overlay",
            overlay.to_str().unwrap(),
        ]);
        assert_eq!(code, Some(1), "{words}");
        for k in 0..2 {
            let off = (number(&json, &format!("/offset_mm/{k}")) - PLACE[k]).abs();
            let u95 = number(&json, &format!("/offset_u95_mm/{k}"));
            assert!(off < 1.5 * u95 + 1e-4 && u95 < 0.002, "off by {off} of {u95}");
        }
        assert_eq!(json["move_mm"], json["offset_mm"]);
        assert!(
            (number(&json, "/move_laser_mm/0") - (number(&json, "/move_mm/0") - 10.0)).abs() < 1e-9
        );
        // The fixture's calibration says nothing of how well its laser offset is known.
        assert_eq!(json["move_laser_u95_mm"], json["offset_u95_mm"]);
        let seen = number(&json, "/frames_seen");
        let dropped = number(&json, "/dropped");
        assert!(
            number(&json, "/received") >= seen + dropped
                && number(&json, "/received") <= seen + dropped + 1.0
        );
        // How many depends on what else the machine does.
        let rate = number(&json, "/frames_per_s");
        println!("{rate:.1} frames/s, {dropped} dropped of {}", json["received"]);
        assert!(std::fs::read(&overlay).unwrap().starts_with(b"\x89PNG"));
        if let Ok(kept) = std::env::var("PIVOTSIGHT_KEEP") {
            std::fs::copy(&overlay, Path::new(&kept).join("center.png")).unwrap();
        }
    }
}

#[test]
fn a_frame_of_another_size_is_named_and_left_out() {
    let pictures = Pictures::new();
    for (i, jpeg) in frames(pictures.path(), PLACE, 3).iter().enumerate() {
        std::fs::write(pictures.picture(&format!("{i}.jpg")), jpeg).unwrap();
    }
    let odd = image::GrayImage::from_pixel(64, 48, image::Luma([90]));
    odd.save(pictures.picture("1-odd.png")).unwrap();
    let (json, _, words) = pictures.center(NEVER, &[]);
    assert!(words.contains("1-odd.png has 64×48 px"), "{words}");
    assert_eq!((number(&json, "/frames_seen"), number(&json, "/frames_used")), (4.0, 3.0));
}

#[test]
fn copies_of_one_frame_are_told() {
    let pictures = Pictures::new();
    let jpeg = &frames(pictures.path(), PLACE, 1)[0];
    for i in 0..5 {
        std::fs::write(pictures.picture(&format!("{i}.jpg")), jpeg).unwrap();
    }
    let (_, code, words) = pictures.center("0.01", &[]);
    assert!(code == Some(0) && words.matches("is the camera running?").count() == 1, "{words}");
}

/// Frames that are averaged do not keep the error of one of them.
#[test]
fn an_average_is_as_good_as_it_says() {
    let mut squares = 0.0;
    for (x, y) in [(0.137, -0.411), (-0.352, 0.244), (0.488, 0.069)] {
        let pictures = Pictures::new();
        let text = format!(
            "schema = 1\nkind = 'burn'\n[camera]\nwidth_px = 640\nheight_px = 480\npixel_mm = 0.008\n[ring]\n\
             center_mm = [{x}, {y}]\nradius_mm = 1.1\ninner_ratio = 0.0\nlevel = 0.25\n\
             [spot]\noffset_mm = [0.0, 0.0]\nradius_mm = 0.2\nlevel = 0.3\n"
        );
        std::fs::write(pictures.path().join("scene.toml"), text).unwrap();
        let scene = BurnScene::read(pictures.path().join("scene.toml")).unwrap();
        for seed in 0..12 {
            let made = burn::render(&scene, seed).unwrap();
            made.picture.write_png(pictures.picture(&format!("{seed:02}.png"))).unwrap();
            let calib = pictures.path().join("calib.toml");
            std::fs::write(calib, made.camera.calibration.to_toml()).unwrap();
        }
        let (json, _, words) = pictures.center(NEVER, &[]);
        assert_eq!(number(&json, "/frames_used"), 12.0, "{words}");
        for (k, truth) in [x, y].into_iter().enumerate() {
            let off_mm = number(&json, &format!("/offset_mm/{k}")) - truth;
            let u95_mm = number(&json, &format!("/offset_u95_mm/{k}"));
            assert!(off_mm.abs() < 1.5 * u95_mm, "{off_mm} ± {u95_mm}");
            squares += off_mm * off_mm / 6.0;
        }
    }
    let rms_um = 1e3 * squares.sqrt();
    println!("averages of 12 frames: {rms_um:.4} µm rms");
    assert!(rms_um < 0.015, "{rms_um} µm");
}

#[test]
fn a_folder_is_read_picture_by_picture_and_none_is_dropped() {
    let pictures = Pictures::new();
    for (i, jpeg) in frames(pictures.path(), PLACE, 6).iter().enumerate() {
        let bytes = if i == 2 { &jpeg[..jpeg.len() / 3] } else { &jpeg[..] };
        // Named as a batch would take it too; what it is, its content says.
        let ending = ["png", "jpg", "jpg", "jpg", "jpg", "ppm"][i];
        std::fs::write(pictures.picture(&format!("{i}.{ending}")), bytes).unwrap();
    }
    std::fs::write(pictures.picture(".6.jpg"), "half a copy").unwrap();
    let store = pictures.path().join("store");
    let stored = ["--store", store.to_str().unwrap(), "--at", "100,-20.5"];
    let (json, code, words) = pictures.center(NEVER, &stored);
    assert_eq!(code, Some(1), "{words}");
    let count = |key: &str| json[key].as_u64().unwrap();
    assert_eq!(
        (count("frames_seen"), count("frames_failed"), count("dropped")),
        (6, 1, 0),
        "{json:#}"
    );
    assert!((number(&json, "/center_machine_mm/0") - (100.0 + PLACE.x)).abs() < 0.001);
    assert_eq!(
        std::fs::read_to_string(store.join("captures.csv")).unwrap(),
        "image,x_mm,y_mm,c_deg\ncapture-0001.jpg,100,-20.5,0\n"
    );
    // Enough is enough: three frames that agree end it.
    let (json, code, _) = pictures.center("0.01", &[]);
    assert_eq!((code, json["frames_seen"].as_u64()), (Some(0), Some(4)), "{json:#}");
    assert!(json["verdict"].is_null(), "nothing is judged without a tolerance: {json:#}");
    // What is seen is never drawn over a picture that is looked at.
    let own = pictures.picture("0.png");
    let before = std::fs::read(&own).unwrap();
    let (_, code, words) = pictures.center(NEVER, &["--overlay", own.to_str().unwrap()]);
    assert!(code == Some(2) && words.contains("--overlay") && words.contains("0.png"), "{words}");
    assert_eq!(std::fs::read(&own).unwrap(), before);
    let (_, code, words) = pictures.center(NEVER, &["--overlay", "seen.jpg"]);
    assert!(code == Some(2) && words.contains("ends in .png"), "{words}");
}

#[test]
fn positions_without_a_picture_are_told_and_a_folder_is_not_stored_into_itself() {
    let folder = tempfile::tempdir().unwrap();
    let (shots, store) = (folder.path().join("shots"), folder.path().join("store"));
    let positions = folder.path().join("positions.csv");
    std::fs::create_dir(&shots).unwrap();
    for (i, jpeg) in frames(folder.path(), PLACE, 2).iter().enumerate() {
        std::fs::write(shots.join(format!("{i}.jpg")), jpeg).unwrap();
    }
    let capture = |into: &Path, table: &str| {
        std::fs::write(&positions, table).unwrap();
        let [shots, into, at] = [&shots, into, &positions].map(|p| p.to_str().unwrap());
        run(&["capture", shots, "--store", into, "--positions", at])
    };
    // What is refused makes no folder.
    let (_, code, said) = capture(&store, "x_mm,y_mm\n1,nan\n");
    assert!(code == Some(2) && said.contains("positions.csv:2") && !store.exists(), "{said}");
    let (_, code, said) = capture(&shots, "x_mm,y_mm\n1,2\n");
    assert!(code == Some(2) && said.contains("--store"), "{said}");
    let (json, code, said) = capture(&store, "x_mm,y_mm\n1,2\n3,4\n5,6\n");
    assert_eq!((code, json["results"].as_array().unwrap().len()), (Some(3), 2), "{said}");
    assert!(json["warnings"][0].as_str().unwrap().contains("the last 1 of 3"), "{json}");
    // An editor left the last line open, and another session adds rows meanwhile: no row is lost.
    let manifest = store.join("captures.csv");
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.trim_end()).unwrap();
    let shot = || Shot::Encoded(std::fs::read(shots.join("0.jpg")).unwrap(), None);
    let at = Position { x_mm: 7.0, y_mm: 8.0, c_deg: 0.0 };
    let (mut one, mut two) = (Store::open(&store).unwrap(), Store::open(&store).unwrap());
    one.add(&shot(), at).unwrap();
    two.add(&shot(), at).unwrap();
    one.add(&shot(), at).unwrap();
    let rows: Vec<String> =
        std::fs::read_to_string(&manifest).unwrap().lines().skip(1).map(str::to_owned).collect();
    assert_eq!(rows.len(), 5, "{rows:?}");
    assert_eq!(rows[1..3], ["capture-0002.jpg,3,4,0", "capture-0003.jpg,7,8,0"]);
    // At the very same time too.
    #[cfg(unix)]
    {
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let mut session = Store::open(&store).unwrap();
                    (0..10).for_each(|_| drop(session.add(&shot(), at).unwrap()));
                });
            }
        });
        let text = std::fs::read_to_string(&manifest).unwrap();
        let images: std::collections::HashSet<_> =
            text.lines().skip(1).map(|l| l.split(',').next()).collect();
        assert_eq!((images.len(), text.lines().count()), (45, 46));
    }
}

/// Starts the program with pipes.
fn start(args: &[&str]) -> Child {
    program(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn a_stream_that_stalls_or_dies_is_reported_and_nothing_stored_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let frames = frames(folder.path(), PLACE, 2);
    // The first connection dies after five frames, the second stalls after five, the third lives.
    let (url, progress) = serve(frames, true, |connection, frame| match (connection, frame) {
        (0, 5) => None,
        (1, 5) => Some(Duration::from_millis(3000)),
        _ => Some(Duration::from_millis(30)),
    });
    let store = folder.path().join("store");
    let mut child = start(&["capture", &url, "--store", store.to_str().unwrap()]);
    let mut typed = child.stdin.take().unwrap();
    writeln!(typed, "10 20").unwrap();
    let patience = Instant::now();
    while progress.load(Ordering::SeqCst) < 1005 {
        assert!(patience.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(10));
    }
    // The first connection is gone by now, and the second has just stalled: this picture has to wait.
    std::thread::sleep(Duration::from_millis(300));
    writeln!(typed, "nonsense").unwrap();
    writeln!(typed, "11 -20.5 90").unwrap();
    writeln!(typed).unwrap();
    drop(typed);
    let out = child.wait_with_output().unwrap();
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success(), "{words}");
    assert!(words.contains("LOST") && words.contains("the source is back"), "{words}");
    assert!(
        words.contains("STALLED: no frame for 1.") || words.contains("STALLED: no frame for 2.0"),
        "{words}"
    );
    assert!(words.contains("'nonsense' is not X Y"), "{words}");
    let manifest = std::fs::read_to_string(store.join("captures.csv")).unwrap();
    assert_eq!(
        manifest,
        "image,x_mm,y_mm,c_deg\ncapture-0001.jpg,10,20,0\ncapture-0002.jpg,11,-20.5,90\n"
    );
    // A killed session keeps what it has, and the folder is continued.
    let mut child = start(&["capture", &url, "--store", store.to_str().unwrap()]);
    writeln!(child.stdin.as_mut().unwrap(), "12 20").unwrap();
    let third: PathBuf = store.join("capture-0003.jpg");
    let patience = Instant::now();
    while !std::fs::read_to_string(store.join("captures.csv")).unwrap().contains("0003") {
        assert!(patience.elapsed() < Duration::from_secs(10));
        std::thread::sleep(Duration::from_millis(50));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let captures =
        pivotsight::measure::rod::read_captures(store.join("captures.csv"), &mut Vec::new())
            .unwrap();
    assert_eq!(captures.len(), 3);
    for c in captures {
        pivotsight::frame::Picture::read(&c.path).unwrap();
    }
    assert!(third.exists());
}

/// A rim larger than the frame: every capture of a rod alone says where its centre is, with the diameter known.
#[test]
fn an_arc_of_a_known_rim_is_enough() {
    let source = Path::new("images/rod-typical");
    let rows = std::fs::read_to_string(source.join("rod-0001.csv")).unwrap();
    let truth: Value =
        serde_json::from_slice(&std::fs::read(source.join("rod-0001.truth.json")).unwrap())
            .unwrap();
    let calib = source.join("calib.toml");
    for row in rows.lines().skip(1).step_by(2) {
        let cells: Vec<&str> = row.split(',').collect();
        let folder = tempfile::tempdir().unwrap();
        for i in 0..3 {
            std::fs::copy(source.join(cells[0]), folder.path().join(format!("{i}.png"))).unwrap();
        }
        let (json, code, words) = run(&[
            "center",
            folder.path().to_str().unwrap(),
            "--calib",
            calib.to_str().unwrap(),
            "--diameter-mm",
            "18.32",
            "--u95-mm",
            "0.05",
            "--at",
            &format!("{},{}", cells[1], cells[2]),
        ]);
        assert_eq!(code, Some(0), "{words}");
        for k in 0..2 {
            let off = number(&json, &format!("/center_machine_mm/{k}"))
                - number(&truth, &format!("/axis_center_mm/{k}"));
            let u95 = number(&json, &format!("/offset_u95_mm/{k}"));
            assert!(off.abs() < 2.0 * u95 + 0.01, "{row}: off by {off} of {u95}");
        }
    }
}

/// Where the mark has left the frame a nut or the brushed metal is not taken for it.
#[test]
fn what_is_no_circle_is_not_followed() {
    let pictures = Pictures::new();
    let center = Vector2::new(300.0, 250.0);
    let disc = |p: Vector2<f64>| (p - center).norm() < 90.0;
    let nut = |p: Vector2<f64>| {
        (0..6).all(|k| {
            let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos();
            (p - center).dot(&Vector2::new(c, s)) < 85.0
        })
    };
    type Shape<'a> = &'a dyn Fn(Vector2<f64>) -> bool;
    let shapes: [Shape; 4] = [&disc, &nut, &|_| false, &disc];
    for (i, shape) in shapes.iter().enumerate() {
        let picture = image::GrayImage::from_fn(640, 480, |u, v| {
            let p = Vector2::new(f64::from(u), f64::from(v));
            // Lines as brushing leaves them.
            let line = (0.31 * p.y + 0.06 * p.x).sin() + (0.83 * p.y - 0.11 * p.x + 1.0).sin();
            let level = if shape(p) { 60.0 } else { 150.0 + 8.0 * line };
            image::Luma([level as u8])
        });
        picture.save(pictures.picture(&format!("{i}.png"))).unwrap();
    }
    let calib = "schema = 1\nname = 'quick'\n[scale]\nmm_per_px = 0.01\n";
    std::fs::write(pictures.path().join("calib.toml"), calib).unwrap();
    for more in [&[][..], &["--diameter-mm", "1.8"]] {
        let (json, _, words) = pictures.center(NEVER, more);
        let count = |key: &str| json[key].as_u64().unwrap();
        assert_eq!((count("frames_seen"), count("frames_failed")), (4, 2), "{words}");
        assert!((number(&json, "/diameter_mm") - 1.8).abs() < 0.005, "{json:#}");
    }
}

#[test]
fn sources_that_cannot_be_are_refused_at_once() {
    for (source, words) in [
        ("http://", "no address"),
        ("rtsp://camera/1", "is not read"),
        ("no-such-folder", "does not exist"),
    ] {
        let (_, code, said) = run(&["center", source, "--calib", "calib/scale.toml"]);
        assert!(code == Some(2) && said.contains(words), "{source}: {said}");
    }
    // A host that is there but does not answer with a stream ends with the time, and says why.
    let (_, code, said) =
        run(&["center", "http://127.0.0.1:9/", "--calib", "calib/scale.toml", "--timeout-s", "2"]);
    assert!(code == Some(2) && said.contains("LOST") && said.contains("no connection"), "{said}");
}

#[cfg(not(feature = "opencv"))]
#[test]
fn cameras_and_video_files_need_opencv() {
    for source in ["0", "Cargo.toml"] {
        let (_, code, said) = run(&["center", source, "--calib", "calib/scale.toml"]);
        assert!(code == Some(2) && said.contains("libopencv-dev"), "{said}");
    }
}
