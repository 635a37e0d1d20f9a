//! Biases that make false concentricity: each is switched on in painted pictures, shown to move the plain way of measuring by
//! as much as theory says, and shown to be gone from what the program measures.

#[path = "../examples/accuracy/paint.rs"]
#[allow(dead_code)]
mod paint;

use nalgebra::{Matrix3, Vector2, Vector3};
use paint::{Canvas, Sensor};
use pivotsight::camera::{Calibration, Lens, Mapping};
use pivotsight::fit::{Circle, circle};
use pivotsight::frame::{Channel, Gray, Picture};
use pivotsight::measure::{CircleReport, burn, circles, rod};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const SIDE: usize = 700;
const MM_PER_PX: f64 = 0.01;
/// Hardly any noise: what is left is bias.
const QUIET: Sensor = Sensor { noise: 0.0005, gamma: 1.0, bits: 16 };

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(7)
}

fn scale() -> Calibration {
    let mapping = Mapping::Scale { mm_per_px: MM_PER_PX, rotation_deg: 0.0 };
    Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 }
}

/// Pixels as the plain scale maps them; v runs down.
fn plane(p: Vector2<f64>) -> Vector2<f64> {
    let middle = (SIDE as f64 - 1.0) / 2.0;
    Vector2::new(p.x - middle, middle - p.y) * MM_PER_PX
}

/// How much of a sample, three to a pixel's side, lies inside an edge at this distance from its middle.
fn cover(distance_px: f64) -> f64 {
    (0.5 - 3.0 * distance_px).clamp(0.0, 1.0)
}

/// A blurred disc of one level on another, lit by `light`.
fn disc(
    center: Vector2<f64>,
    radius: f64,
    blur_px: f64,
    [within, around]: [f64; 2],
    light: impl Fn(Vector2<f64>) -> f64,
) -> Canvas {
    let mut canvas = Canvas::new(SIDE, SIDE, 3, around);
    canvas.paint(|p, old| old + (within - old) * cover((p - center).norm() - radius));
    canvas.blur(blur_px);
    canvas.paint(|p, old| old * light(p));
    canvas
}

fn measured(picture: &Picture, calibration: &Calibration, diameter_mm: f64) -> CircleReport {
    let options = circles::Options { expect_mm: vec![diameter_mm], channel: Channel::default() };
    let report = circles::measure(picture, calibration, &options, "painted").unwrap().report;
    report.circles[0].circle.clone()
}

/// Where the plain ways see an edge.
#[derive(Clone, Copy)]
enum Plain {
    /// Middle of the levels at both ends of the ray.
    HalfLevel,
    /// One level for the whole picture.
    Level(f64),
    /// Steepest place.
    Steepest,
}

/// Rays from a place near the centre, interpolated, and the algebraic circle through what they cross: all in pixels.
fn plain(picture: &Picture, center: Vector2<f64>, radius: f64, reach: f64, how: Plain) -> Circle {
    let gray: Gray<f32> = picture.frame(Channel::Luminance).reduce(1);
    let value = |p: Vector2<f64>| {
        let (x, y) = (p.x.clamp(0.0, SIDE as f64 - 2.0), p.y.clamp(0.0, SIDE as f64 - 2.0));
        let (i, j) = (x as usize, y as usize);
        let (f, g) = (x - i as f64, y - j as f64);
        let at = |i: usize, j: usize| f64::from(gray.row(j)[i]) / 65535.0;
        (at(i, j) * (1.0 - f) + at(i + 1, j) * f) * (1.0 - g)
            + (at(i, j + 1) * (1.0 - f) + at(i + 1, j + 1) * f) * g
    };
    let points: Vec<Vector2<f64>> = (0..720)
        .filter_map(|k| {
            let (s, c) = (f64::from(k) * std::f64::consts::TAU / 720.0).sin_cos();
            let ray = Vector2::new(c, s);
            let steps = (8.0 * reach) as usize;
            let at = |i: usize| radius - reach + 2.0 * reach * i as f64 / steps as f64;
            let row: Vec<f64> = (0..=steps).map(|i| value(center + ray * at(i))).collect();
            let cross = |level: f64| {
                let i = row.windows(2).position(|w| (w[0] - level) * (w[1] - level) <= 0.0)?;
                let part = (row[i] - level) / (row[i] - row[i + 1]);
                Some(at(i) + part * (at(i + 1) - at(i)))
            };
            let edge = match how {
                Plain::HalfLevel => cross(0.5 * (row[0] + row[steps])),
                Plain::Level(level) => cross(level),
                Plain::Steepest => Some(steepest(&row, at(1) - at(0)) + at(0)),
            };
            edge.map(|r| center + ray * r)
        })
        .collect();
    circle::taubin(&points, &vec![1.0; points.len()]).unwrap()
}

/// The top of the parabola through the slopes near the steepest place.
fn steepest(row: &[f64], step: f64) -> f64 {
    let wide = (row.len() / 12).max(4);
    let slope: Vec<f64> =
        (wide..row.len() - wide).map(|i| (row[i + wide] - row[i - wide]).abs()).collect();
    let top = (wide..slope.len() - wide).max_by(|&a, &b| slope[a].total_cmp(&slope[b])).unwrap();
    let (mut x2, mut x4, mut y, mut xy, mut x2y) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (i, s) in slope[top - wide..=top + wide].iter().enumerate() {
        let x = i as f64 - wide as f64;
        (x2, x4, y, xy, x2y) = (x2 + x * x, x4 + x.powi(4), y + s, xy + x * s, x2y + x * x * s);
    }
    let n = 2.0 * wide as f64 + 1.0;
    let curve = (n * x2y - x2 * y) / (n * x4 - x2 * x2);
    (top as f64 - 0.5 * xy / x2 / curve + wide as f64) * step
}

/// The plain way is off by `bias`, the program by no more than `rest` of it.
fn gone(what: &str, bias: f64, plain: f64, program: f64, rest: f64) {
    println!("{what}: theory {bias:.4}, plain way {plain:.4}, program {program:.5}");
    assert!((plain / bias - 1.0).abs() < 0.25, "{what}: the plain way shows {plain}, not {bias}");
    assert!(program.abs() < rest * bias.abs(), "{what}: {program} is left of {bias}");
}

/// The middle of a circle's image is not the image of its middle: r² sinθ cosθ / Z.
#[test]
fn perspective() {
    let (f_px, distance_mm, tilt) = (3000.0, 30.0, 5f64.to_radians());
    let middle = (SIDE as f64 - 1.0) / 2.0;
    let to_plane = |p: Vector2<f64>| {
        let (x, y) = ((p.x - middle) / f_px, (p.y - middle) / f_px);
        let up = -y * distance_mm / (tilt.cos() + y * tilt.sin());
        Vector2::new(x * (distance_mm + up * tilt.sin()), up)
    };
    let (center, radius) = (Vector2::new(0.21, -0.13), 2.6);
    let mut canvas = Canvas::new(SIDE, SIDE, 3, 0.7);
    canvas.paint(|p, old| {
        let d = ((to_plane(p) - center).norm() - radius) / MM_PER_PX;
        old - 0.5 * cover(d)
    });
    canvas.blur(1.0);
    let picture = canvas.picture(QUIET, &mut rng());
    let to_image = Matrix3::from_columns(&[
        Vector3::x(),
        Vector3::new(0.0, -tilt.cos(), tilt.sin()),
        Vector3::new(0.0, 0.0, distance_mm),
    ]);
    let lens = lens(f_px, 0.0);
    let homography_mm = to_image.try_inverse().unwrap();
    let calibration = Calibration {
        name: String::new(),
        mapping: Mapping::Pinhole { lens, homography_mm, covariance: None, mirrored: false },
        laser: None,
        gamma: 1.0,
    };
    let found = measured(&picture, &calibration, 2.0 * radius);
    let view = calibration.view(SIDE, SIDE).unwrap();
    let near = view.to_pixel(center);
    let ellipse = plain(&picture, near, radius / MM_PER_PX, 25.0, Plain::HalfLevel);
    gone(
        "perspective, mm",
        radius * radius * tilt.sin() * tilt.cos() / distance_mm,
        (to_plane(ellipse.center) - center).norm(),
        (Vector2::from(found.center_mm) - center).norm(),
        0.01,
    );
}

fn lens(f_px: f64, k1: f64) -> Lens {
    Lens {
        width_px: SIDE as u32,
        height_px: SIDE as u32,
        fx_px: f_px,
        fy_px: f_px,
        cx_px: (SIDE as f64 - 1.0) / 2.0,
        cy_px: (SIDE as f64 - 1.0) / 2.0,
        distortion: [k1, 0.0, 0.0, 0.0, 0.0],
    }
}

/// A lens that shrinks the outside moves the middle of what it shrinks: 3 k1 d R².
#[test]
fn lens_distortion() {
    let (f_px, k1, radius) = (3000.0, -0.25, 180.0);
    let lens = lens(f_px, k1);
    let off = Vector2::new(110.0, -75.0);
    // Undistorted pixels of a distorted one, by repeated substitution.
    let ideal = |p: Vector2<f64>| {
        let seen = p - Vector2::new(lens.cx_px, lens.cy_px);
        (0..30).fold(seen, |at, _| seen / (1.0 + k1 * (at / f_px).norm_squared()))
    };
    let mut canvas = Canvas::new(SIDE, SIDE, 3, 0.2);
    canvas.paint(|p, old| old + 0.6 * cover((ideal(p) - off).norm() - radius));
    canvas.blur(1.0);
    let picture = canvas.picture(QUIET, &mut rng());
    let homography_mm =
        Matrix3::from_diagonal(&Vector3::new(f_px * MM_PER_PX, -f_px * MM_PER_PX, 1.0));
    let mapping =
        Mapping::Pinhole { lens: lens.clone(), homography_mm, covariance: None, mirrored: false };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let found = measured(&picture, &calibration, 2.0 * radius * MM_PER_PX);
    let truth = Vector2::new(off.x, -off.y) * MM_PER_PX;
    let start = Vector2::new(lens.cx_px, lens.cy_px) + off;
    let in_px = plain(&picture, start, radius, 12.0, Plain::HalfLevel);
    gone(
        "k1, px",
        (3.0 * k1 * off.norm() * radius * radius / (f_px * f_px)).abs(),
        (ideal(in_px.center) - off).norm(),
        (Vector2::from(found.center_mm) - truth).norm() / MM_PER_PX,
        0.02,
    );
}

/// A blurred rim's middle level lies σ²/2R inside it.
#[test]
fn blur_of_a_curved_edge() {
    for (radius, blur) in [(25.0, 3.0), (60.0, 4.0), (100.0, 6.0)] {
        let center = Vector2::new(349.8, 350.3);
        let picture = disc(center, radius, blur, [0.15, 0.75], |_| 1.0).picture(QUIET, &mut rng());
        let found = measured(&picture, &scale(), 2.0 * radius * MM_PER_PX);
        let seen = plain(&picture, center, radius, 5.0 * blur, Plain::HalfLevel);
        gone(
            &format!("radius {radius} px blurred by {blur} px"),
            blur * blur / (2.0 * radius),
            radius - seen.radius,
            0.5 * found.diameter_mm / MM_PER_PX - radius,
            0.1,
        );
    }
}

/// Of a small soft disc in a noisy picture no more can be known (Cramer-Rao) than is found, and the radius is not biased.
#[test]
fn noise_alone_limits_a_clean_disc() {
    const EXPOSURES: u32 = 60;
    let (radius, blur, contrast, noise) = (20.0, 4.0, 0.3, 0.012);
    let centers = [(349.8, 350.3), (350.0, 349.5), (349.6, 349.7), (350.4, 350.1)];
    let (mut squares, mut larger) = (0.0, 0.0);
    for (i, (x, y)) in centers.into_iter().enumerate() {
        let center = Vector2::new(x, y);
        let canvas = disc(center, radius, blur, [0.6, 0.6 - contrast], |_| 1.0);
        let mut rng = ChaCha8Rng::seed_from_u64(i as u64);
        for _ in 0..EXPOSURES {
            let picture = canvas.picture(Sensor { noise, gamma: 1.0, bits: 8 }, &mut rng);
            let found = measured(&picture, &scale(), 2.0 * radius * MM_PER_PX);
            squares += (Vector2::from(found.center_mm) - plane(center)).norm_squared();
            larger += 0.5 * found.diameter_mm / MM_PER_PX - radius;
        }
    }
    let n = f64::from(EXPOSURES) * centers.len() as f64;
    let (rms, larger) = ((squares / (2.0 * n)).sqrt() / MM_PER_PX, larger / n);
    let bound = noise / contrast * (2.0 * blur / (std::f64::consts::PI.sqrt() * radius)).sqrt();
    println!("rms {rms:.5} px, bound {bound:.5} px, radius off by {larger:+.5} px");
    assert!(rms < 1.2 * bound, "rms {rms} px, bound {bound} px");
    assert!(larger.abs() < 0.3 * bound, "radius off by {larger} px, bound {bound} px");
}

/// A blurred rim on arcs of a rod whose diameter is known: what the radius lacks goes into the centre.
#[test]
fn blur_of_a_known_rods_arcs() {
    let (radius, blur) = (150.0, 7.0);
    let radius_mm = radius * MM_PER_PX;
    // Three captures look at 20° each of one side of the rim.
    let (mut captures, mut frames) = (Vec::new(), Vec::new());
    let truth = Vector2::new(0.113, -0.078);
    for (i, deg) in [-32f64, 0.0, 32.0].into_iter().enumerate() {
        let (s, c) = deg.to_radians().sin_cos();
        let position_mm = Vector2::new(c, s) * radius_mm;
        let mut canvas = Canvas::new(120, 120, 3, 0.15);
        let at = |p: Vector2<f64>| position_mm + Vector2::new(p.x - 59.5, 59.5 - p.y) * MM_PER_PX;
        canvas.paint(|p, old| old + 0.6 * cover(((at(p) - truth).norm() - radius_mm) / MM_PER_PX));
        canvas.blur(blur);
        let picture = canvas.picture(QUIET, &mut rng());
        frames.push((picture.into_frame(Channel::Luminance), scale().view(120, 120).unwrap()));
        captures.push(rod::Capture::in_memory(i.to_string(), position_mm, 0.0));
    }
    let options = rod::Options {
        diameter_mm: Some(2.0 * radius_mm),
        diameter_u_mm: 1e-6,
        ..rod::Options::default()
    };
    let report = rod::measure_frames(&captures, &frames, &options).unwrap().report;
    let error = (Vector2::from(report.axis_center_mm) - truth).norm() / MM_PER_PX;
    // With the radius held too large by σ²/2R an arc's centre moves by as much and a little more.
    let bias = blur * blur / (2.0 * radius);
    println!("arcs: theory {bias:.3} px, program {error:.4} px");
    assert!(error < 0.1 * bias, "{error} px of {bias} px are left");
}

/// Light that rises across a soft edge moves its steepest place by 2γσ².
#[test]
fn shading() {
    // The logarithm of a level that is black is all noise.
    shaded(&[[0.05, 0.7], [0.3, 0.7], [0.7, 0.0]]);
}

fn shaded(pairs: &[[f64; 2]]) {
    let (blur, slope) = (10.0, 0.001);
    let center = Vector2::new(349.7, 350.4);
    for &levels in pairs {
        let lit = |p: Vector2<f64>| 1.0 + slope * (p.x - center.x);
        let picture = disc(center, 150.0, blur, levels, lit).picture(QUIET, &mut rng());
        let found = measured(&picture, &scale(), 300.0 * MM_PER_PX);
        let seen = plain(&picture, center, 150.0, 4.0 * blur, Plain::Steepest);
        let bias = 2.0 * slope * blur * blur;
        let error = Vector2::from(found.center_mm) - plane(center);
        gone(
            &format!("shading {levels:?}, px"),
            bias,
            (seen.center - center).norm(),
            error.norm() / MM_PER_PX,
            0.1,
        );
    }
}

/// Contrast that differs round the circle moves what a single level cuts, most on one side.
#[test]
fn uneven_contrast() {
    let (center, radius, blur) = (Vector2::new(350.2, 349.6), 180.0, 2.5);
    let picture = uneven(center, radius, blur).picture(QUIET, &mut rng());
    let found = measured(&picture, &scale(), 2.0 * radius * MM_PER_PX);
    let seen = plain(&picture, center, radius, 12.0, Plain::Level(0.4));
    let bias = (seen.center - center).norm();
    let error = (Vector2::from(found.center_mm) - plane(center)).norm() / MM_PER_PX;
    println!("uneven contrast: plain way {bias:.4} px, program {error:.5} px");
    assert!(bias > 0.3 && error < 0.02 * bias, "{error} of {bias}");
}

/// A disc of 0.2 on a plate that shines 0.5 on the left and 0.9 on the right.
fn uneven(center: Vector2<f64>, radius: f64, blur: f64) -> Canvas {
    let mut canvas = Canvas::new(SIDE, SIDE, 3, 0.0);
    canvas.paint(|p, _| {
        let plate = 0.7 + 0.2 * ((p.x - center.x) / 150.0).tanh();
        plate + (0.2 - plate) * cover((p - center).norm() - radius)
    });
    canvas.blur(blur);
    canvas
}

/// A curved sensor scale moves the middle level, more where the contrast is larger.
#[test]
fn gamma() {
    let (center, radius, blur) = (Vector2::new(350.2, 349.6), 180.0, 2.5);
    let canvas = uneven(center, radius, blur);
    // What the same surface shows where counts are light: its shading has a shift of its own.
    let [curved, light] = [2.2, 1.0].map(|gamma| {
        let picture = canvas.picture(Sensor { gamma, ..QUIET }, &mut rng());
        let found = measured(&picture, &Calibration { gamma, ..scale() }, 2.0 * radius * MM_PER_PX);
        (plain(&picture, center, radius, 12.0, Plain::HalfLevel), found)
    });
    let moved = (curved.0.center - light.0.center).norm();
    let grown = (curved.0.radius - light.0.radius).abs();
    let left = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) / MM_PER_PX;
    let error = left(curved.1.center_mm, light.1.center_mm);
    let wide = 0.5 * (curved.1.diameter_mm - light.1.diameter_mm).abs() / MM_PER_PX;
    println!("gamma: centre, plain way {moved:.4} px, program {error:.5} px");
    println!("gamma: radius, plain way {grown:.4} px, program {wide:.5} px");
    assert!(moved > 0.05 && error < 0.1 * moved, "{error} of {moved}");
    assert!(grown > 0.5 && wide < 0.1 * grown, "{wide} of {grown}");
    let off = (0.5 * curved.1.diameter_mm / MM_PER_PX - radius).abs();
    assert!(off < 0.1 * grown, "{off} of {grown}");
}

/// A plate that is too bright on one side cuts the upper part of the edge off there.
#[test]
fn saturation() {
    let (center, radius, blur) = (Vector2::new(350.2, 349.6), 180.0, 2.5);
    let lit = |p: Vector2<f64>| 1.0 + 0.8 / (1.0 + (-(p.x - center.x) / 20.0).exp());
    let picture = disc(center, radius, blur, [0.1, 0.8], lit).picture(QUIET, &mut rng());
    let found = measured(&picture, &scale(), 2.0 * radius * MM_PER_PX);
    let seen = plain(&picture, center, radius, 12.0, Plain::HalfLevel);
    let bias = (seen.center - center).norm();
    let error = (Vector2::from(found.center_mm) - plane(center)).norm() / MM_PER_PX;
    println!("saturation: plain way {bias:.4} px, program {error:.5} px");
    assert!(bias > 0.1 && error < 0.1 * bias, "{error} of {bias}");
}

/// A background that is clipped all round, lit from one side behind the clip: the middle of what is seen lies nearer to the foot of the flank where
/// the light is stronger, outwards for a hole and inwards for a disc.
#[test]
fn light_behind_the_clip() {
    let (center, radius, blur) = (Vector2::new(350.2, 349.6), 180.0, 2.5);
    let lit = |p: Vector2<f64>| 1.0 + 0.05 * (p.x - center.x + 0.5 * (p.y - center.y)) / radius;
    for levels in [[0.1, 1.12], [1.12, 0.1]] {
        let picture = disc(center, radius, blur, levels, lit).picture(QUIET, &mut rng());
        let found = measured(&picture, &scale(), 2.0 * radius * MM_PER_PX);
        let seen = plain(&picture, center, radius, 12.0, Plain::HalfLevel);
        let bias = (seen.center - center).norm();
        let error = (Vector2::from(found.center_mm) - plane(center)).norm() / MM_PER_PX;
        let smaller = (seen.radius - radius).abs();
        let off = (0.5 * found.diameter_mm / MM_PER_PX - radius).abs();
        println!("clipped {levels:?}: plain way {bias:.4} px, program {error:.5} px");
        println!("clipped {levels:?}: radius, plain way {smaller:.4} px, program {off:.5} px");
        assert!(bias > 0.1 && error < 0.15 * bias, "{error} of {bias}");
        assert!(smaller > 0.2 && off < 0.1 * smaller, "{off} of {smaller}");
    }
}

/// A ring may be a line hardly wider than its own softness: blurred until noise is gone, its outer edge nearly is too. The
/// ring is still the outer edge, not the stronger-looking inner one.
#[test]
fn a_ring_that_is_a_narrow_line() {
    let (center, radius) = (Vector2::new(352.3, 347.4), 250.0);
    let noisy = Sensor { noise: 0.02, ..QUIET };
    for sd in [3.0, 3.5, 4.0, 4.5, 5.5, 8.0] {
        let outer = radius + 1.1774 * sd;
        let mut canvas = Canvas::new(SIDE, SIDE, 3, 0.7);
        canvas.paint(|p, old| {
            let from_line = ((p - center).norm() - radius) / sd;
            let spot = cover((p - center).norm() - 40.0);
            (old - 0.5 * (-0.5 * from_line * from_line).exp()) * (1.0 - spot) + 0.1 * spot
        });
        canvas.blur(1.0);
        let picture = canvas.picture(noisy, &mut rng());
        let found = burn::measure(&picture, &scale(), &burn::Options::default(), "painted");
        let ring = found.unwrap().report.ring;
        let error_px = 0.5 * ring.diameter_mm / MM_PER_PX - outer;
        println!("line of {sd} px: radius off by {error_px:.3} px");
        assert!(error_px.abs() < 0.3 * sd, "{error_px} px of a line of {sd} px");
        assert!((Vector2::from(ring.center_mm) - plane(center)).norm() < 0.2 * MM_PER_PX);
    }
}

/// (0, 0) is the middle of the first pixel: places in a picture and in the same one turned by 180° add up to the last
/// pixel's, for sharp edges and for soft ones, which are read from a reduced picture.
#[test]
fn pixel_centres() {
    for blur in [1.0, 10.0] {
        let center = Vector2::new(331.3, 362.9);
        let canvas = disc(center, 150.0, blur, [0.2, 0.7], |_| 1.0);
        let upright = canvas.pgm(QUIET, &mut rng());
        let (header, pixels) = upright.split_at(upright.len() - 2 * SIDE * SIDE);
        let mut turned = header.to_vec();
        turned.extend(pixels.chunks_exact(2).rev().flatten());
        let [a, b] = [upright, turned].map(|file| {
            let picture = Picture::decode("painted", &file).unwrap();
            Vector2::from(measured(&picture, &scale(), 3.0).center_px)
        });
        let last = SIDE as f64 - 1.0;
        assert!((a - center).norm() < 0.01, "{a} is not at {center}");
        assert!((a + b - Vector2::repeat(last)).norm() < 0.003, "{a} and {b}");
    }
}
