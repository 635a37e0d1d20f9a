//! Which edge `circles` takes for a circle of the expected diameter, and what it refuses to take for one.

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::Result;
use pivotsight::frame::Picture;
use pivotsight::measure::circles::{self, Measured, Options};

mod painter;
use painter::picture;

/// A circle of an expected diameter at 0.01 mm a pixel.
fn circle(picture: &Picture, expect_mm: f64) -> Result<Measured> {
    let mapping = Mapping::Scale { mm_per_px: 0.01, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let options = Options { expect_mm: vec![expect_mm], channel: Default::default() };
    circles::measure(picture, &calibration, &options, "painted")
}

fn center() -> Vector2<f64> {
    Vector2::new(311.3, 246.8)
}

/// Strips of any length are looked at, however little is left of their width once they are reduced.
#[test]
fn a_narrow_strip_shows_no_circle_and_breaks_nothing() {
    for (width, height) in [(16, 7150), (7150, 16), (40, 20_000)] {
        let grain = |u, v| image::Luma([(60 + (u * 37 + v * 11) % 101) as u8]);
        let strip = painter::opened(image::GrayImage::from_fn(width, height, grain));
        for expect_mm in [0.1, 2.0, 90.0] {
            assert!(circle(&strip, expect_mm).is_err());
        }
    }
}

/// A hole and its chamfer are two circles: which of them is meant, the expected diameter says.
#[test]
fn of_a_hole_and_its_chamfer_the_expected_one_is_measured() {
    // The last hole is hidden from afar by its wider chamfer's far stronger edge.
    for (hole_px, chamfer_px) in [(128.0, 138.0), (150.0, 163.0), (165.0, 184.0)] {
        let seen = picture(|p| match (p - center()).norm() {
            r if r < hole_px => 20.0,
            r if r < chamfer_px => 70.0,
            _ => 170.0,
        });
        for radius_px in [hole_px, chamfer_px] {
            let found = circle(&seen, 0.02 * radius_px).unwrap().report.circles[0].circle.clone();
            let off_mm = found.diameter_mm - 0.02 * radius_px;
            assert!(off_mm.abs() < 0.002, "{hole_px} {chamfer_px}: {radius_px} off by {off_mm}");
        }
    }
}

/// Light from one side shows the hole's own edge on one side and its chamfer's on the other: no circle is drawn through both.
#[test]
fn of_a_chamfer_lit_from_one_side_one_edge_is_measured() {
    let (hole_px, chamfer_px) = (140.0, 156.0);
    let seen = picture(|p| {
        let from = p - center();
        // The chamfer is as bright as the face where it looks to the light, and as dark as the hole where it looks away.
        let lit = 95.0 + 75.0 * (3.0 * from.x / from.norm()).tanh();
        match from.norm() {
            r if r < hole_px => 20.0,
            r if r < chamfer_px => lit,
            _ => 170.0,
        }
    });
    for radius_px in [hole_px, chamfer_px] {
        let report = circle(&seen, 0.02 * radius_px).unwrap().report;
        let found = &report.circles[0].circle;
        let off_mm = found.diameter_mm - 0.02 * radius_px;
        let off_px = (Vector2::from(found.center_px) - center()).norm();
        println!("{radius_px}: {off_mm:.4} ± {:.4} mm, {off_px:.3} px", found.diameter_u95_mm);
        assert!(
            off_mm.abs() < 0.01 && off_px < 0.5,
            "{radius_px}: off by {off_mm} mm, {off_px} px"
        );
        assert!(
            report.warnings.iter().any(|w| w.contains("from one side")),
            "{:?}",
            report.warnings
        );
    }
}

/// Of several holes of one size any may be meant: the others are named.
#[test]
fn other_circles_of_the_expected_size_are_told() {
    let holes = [(-140.0, -90.0), (150.0, -60.0), (-20.0, 140.0)]
        .map(|(x, y)| center() + Vector2::new(x, y));
    let seen = |count: usize| {
        picture(|p| {
            let inside = holes[..count].iter().any(|hole| (p - hole).norm() < 40.0);
            if inside { 30.0 } else { 160.0 }
        })
    };
    let told = circle(&seen(3), 0.8).unwrap().report.warnings;
    assert!(told.iter().any(|w| w.contains("3 circles")), "{told:?}");
    assert_eq!(circle(&seen(1), 0.8).unwrap().report.warnings, Vec::<String>::new());
}

/// A circle of a few pixels is not lost in the reduced picture.
#[test]
fn a_small_circle_is_measured() {
    let seen = picture(|p| if (p - center()).norm() < 7.0 { 120.0 } else { 90.0 });
    let found = circle(&seen, 0.02 * 6.8).unwrap().report.circles[0].circle.clone();
    assert!((found.diameter_mm - 0.14).abs() < 0.002, "{}", found.diameter_mm);
    let px = Vector2::from(found.center_px) - center();
    assert!(px.norm() < 0.1, "{px}");
}

/// The ripples of a soft edge are no edges of their own, near as one may be to the expected diameter.
#[test]
fn a_soft_edge_is_one_edge() {
    let seen = picture(|p| {
        let out_px = (p - center()).norm() - 92.0;
        12.0 + 40.0 / (1.0 + (-out_px / 3.5).exp())
    });
    for expected_px in [88.0, 90.0, 92.0, 96.0] {
        let found = circle(&seen, 0.02 * expected_px).unwrap().report.circles[0].circle.clone();
        let off_mm = found.diameter_mm - 1.84;
        assert!(off_mm.abs() < 0.004, "{expected_px}: off by {off_mm}");
    }
}

/// Where bands of heat tint lie beyond a soft edge, the first of them may lie within it and lean: the centre is less sure. Beyond a sharp
/// edge it would be seen.
#[test]
fn bands_of_tint_make_a_soft_edges_place_less_sure() {
    let u95_mm = |soft_px: f64, band: f64| {
        let seen = picture(|p| {
            let r_px = (p - center()).norm();
            let edge = |at_px: f64| 1.0 / (1.0 + ((at_px - r_px) / soft_px).exp());
            60.0 + 100.0 * edge(110.0) - band * (edge(128.0) - edge(140.0))
        });
        circle(&seen, 2.2).unwrap().report.circles[0].circle.center_u95_mm[0]
    };
    assert!(u95_mm(3.5, 12.0) > 3.0 * u95_mm(3.5, 0.0));
    assert!(u95_mm(0.7, 12.0) < 1.2 * u95_mm(0.7, 0.0));
}

/// What wanders about a circle more than an edge does is told.
#[test]
fn an_edge_that_is_not_round_is_told() {
    let oval = |lobe: f64| {
        picture(|p| {
            let d = p - center();
            let radius_px = 150.0 * (1.0 + lobe * (2.0 * d.y.atan2(d.x)).cos());
            if d.norm() < radius_px { 40.0 } else { 180.0 }
        })
    };
    let told = |lobe| {
        let report = circle(&oval(lobe), 3.0).unwrap().report;
        report.warnings.iter().any(|w| w.contains("check that it is round"))
    };
    assert!(told(0.03));
    assert!(!told(0.005));
}

/// Hexagons, ellipses' ends and a dark background's noise are no circles.
#[test]
fn what_is_no_circle_is_refused() {
    let hexagon = |p: Vector2<f64>| {
        (0..6).all(|k| {
            let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_3 + 0.2).sin_cos();
            (p - center()).dot(&Vector2::new(c, s)) < 120.0
        })
    };
    let ellipse = |p: Vector2<f64>| {
        let d = p - center();
        (d.x / 170.0).powi(2) + (d.y / 60.0).powi(2) < 1.0
    };
    let square = |p: Vector2<f64>| (p - center()).amax() < 110.0;
    type Shape<'a> = (&'a str, &'a dyn Fn(Vector2<f64>) -> bool);
    let shapes: [Shape; 4] = [
        ("hexagon", &hexagon),
        ("ellipse", &ellipse),
        ("square", &square),
        ("nothing", &|_| false),
    ];
    for (name, shape) in shapes {
        let seen = picture(|p| if shape(p) { 140.0 } else { 30.0 });
        for radius_px in [50.0, 80.0, 110.0, 127.0, 160.0, 220.0] {
            if let Ok(found) = circle(&seen, 0.02 * radius_px) {
                panic!("{name} for a radius of {radius_px} px: {:?}", found.report.circles[0]);
            }
        }
    }
    // Flat but for a dot and noise, which happens to look a little like a circle of 160 px: by three standard deviations.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/dot-in-noise.png");
    assert!(circle(&Picture::read(path).unwrap(), 3.2).is_err());
}
