//! Which circles `burn` takes for ring and spot, and what it refuses to take for them.

use nalgebra::Vector2;
use pivotsight::camera::{Calibration, Mapping};
use pivotsight::error::Result;
use pivotsight::measure::burn::{self, Measured, Options};

mod painter;
use painter::{colour_picture, picture};
use pivotsight::frame::{Channel, Picture};

const PLATE: f64 = 170.0;
const BURNT: f64 = 60.0;

/// A burnt annulus about the picture's middle with a spot beside its centre, radii in pixels of 0.02 mm; no spot where its radius is 0.
fn burn(outer_px: f64, inner_px: f64, spot_px: f64, offset_px: Vector2<f64>) -> Result<Measured> {
    let center = Vector2::new(318.3, 241.6);
    let seen = picture(|p| {
        let r = (p - center).norm();
        let spot = (p - center - offset_px).norm() < spot_px;
        if spot || (inner_px..outer_px).contains(&r) { BURNT } else { PLATE }
    });
    measure(&seen)
}

fn measure(seen: &Picture) -> Result<Measured> {
    let mapping = Mapping::Scale { mm_per_px: 0.02, rotation_deg: 0.0 };
    let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    burn::measure(seen, &calibration, &Options::default(), "painted")
}

fn off_mm(found: &Measured, offset_px: Vector2<f64>) -> f64 {
    let [dx, dy] = found.report.offset.offset_mm;
    // Y of the plane points up.
    (Vector2::new(dx, -dy) - 0.02 * offset_px).norm()
}

/// Circles that touch ring and spot in turn are as many as one likes: they are no marks beside which the spot has no surface left.
#[test]
fn a_clear_spot_in_a_fine_ring_is_measured() {
    for (outer_px, inner_px, spot_px) in
        [(154.6, 128.8, 40.45), (152.9, 125.7, 23.4), (140.0, 112.0, 33.0), (168.0, 138.0, 41.0)]
    {
        for offset_px in [Vector2::new(0.4, -0.3), Vector2::new(-2.1, 0.7), Vector2::new(3.3, 2.2)]
        {
            let found = burn(outer_px, inner_px, spot_px, offset_px).unwrap();
            let off_mm = off_mm(&found, offset_px);
            assert!(off_mm < 0.0005, "{outer_px} {inner_px} {spot_px}: off by {off_mm}");
        }
    }
}

/// A spot may be nearly half as large as its ring; where there is none nothing is taken for it.
#[test]
fn a_large_spot_is_measured() {
    for offset_px in [Vector2::new(0.4, -0.3), Vector2::new(-1.1, 0.7), Vector2::new(2.3, 1.2)] {
        let off_mm = off_mm(&burn(150.0, 120.0, 65.0, offset_px).unwrap(), offset_px);
        assert!(off_mm < 0.0005, "{offset_px}: off by {off_mm}");
    }
    let error = burn(150.0, 120.0, 0.0, Vector2::zeros());
    assert!(error.is_err(), "{:?}", error.map(|m| m.report.spot.diameter_mm));
}

/// The grooves about the middle of a turned plate are circles, too.
#[test]
fn the_middle_of_a_turned_plate_is_no_second_burn() {
    let (burn, middle) = (Vector2::new(400.3, 300.2), Vector2::new(110.0, 90.0));
    let offset_px = Vector2::new(1.3, -0.8);
    let seen = picture(|p| {
        let r = (p - burn).norm();
        let burnt = (80.0..130.0).contains(&r) || (p - burn - offset_px).norm() < 30.0;
        let groove = 3.0 * ((p - middle).norm() / 1.9).sin();
        if burnt { BURNT } else { PLATE + groove }
    });
    let off_mm = off_mm(&measure(&seen).unwrap(), offset_px);
    assert!(off_mm < 0.001, "off by {off_mm}");
}

/// Nor are they a spot where the ring lies about them, with a spot of its own that cannot be told or with none.
#[test]
fn the_middle_of_a_turned_plate_within_a_ring_is_no_spot() {
    let (center, middle) = (Vector2::new(318.3, 241.6), Vector2::new(282.0, 229.0));
    for (depth, pitch_px) in [(8.0, 1.9), (14.0, 2.6), (20.0, 1.5)] {
        let seen = picture(|p| {
            let burnt = (110.0..140.0).contains(&(p - center).norm());
            let groove = depth * ((p - middle).norm() / pitch_px).sin();
            if burnt { BURNT } else { PLATE + groove }
        });
        let found = measure(&seen).map(|m| (m.report.spot.center_px, m.report.spot.diameter_mm));
        assert!(found.is_err(), "{depth} {pitch_px}: {found:?}");
    }
}

/// A circle that is scribed about a pale burn is sharper than it, and is not its ring; one within a ring is no spot.
#[test]
fn scribed_circles_are_neither_ring_nor_spot() {
    let (center, offset_px) = (Vector2::new(318.3, 241.6), Vector2::new(2.3, -1.4));
    let scribed = |at: Vector2<f64>, radius: f64, ring: f64, spot: f64| {
        measure(&picture(|p| {
            let (r, line) = ((p - center).norm(), ((p - at).norm() - radius).abs() < 1.1);
            match ((p - center - offset_px).norm() < 24.0, line) {
                (true, _) => spot,
                (false, true) => 0.6 * PLATE,
                (false, false) if (100.0..140.0).contains(&r) => ring,
                (false, false) => PLATE,
            }
        }))
    };
    for apart in [Vector2::new(9.0, -6.0), Vector2::new(1.0, 2.0)] {
        let found = scribed(center + apart, 190.0, 0.88 * PLATE, BURNT).unwrap();
        let (off_mm, diameter_mm) = (off_mm(&found, offset_px), found.report.ring.diameter_mm);
        assert!(off_mm < 0.001 && (diameter_mm - 5.6).abs() < 0.02, "{off_mm} {diameter_mm}");
    }
    let inside = scribed(center + Vector2::new(4.0, 3.0), 62.0, BURNT, PLATE);
    assert!(inside.is_err(), "{:?}", inside.map(|m| m.report.spot.diameter_mm));
}

/// Where the bare plate is seen inside an annulus, a large mark lighter than it is no inner edge; nor is one far off a disc's centre.
#[test]
fn a_large_light_spot_is_measured() {
    let center = Vector2::new(318.3, 241.6);
    for (inner_px, offset_px, size_px) in [
        (120.0, Vector2::new(1.1, -0.7), 46.0),
        (120.0, Vector2::new(0.2, 0.3), 60.0),
        (0.0, Vector2::new(24.0, -18.0), 56.0),
    ] {
        let found = measure(&picture(|p| {
            let ring = (inner_px..150.0).contains(&(p - center).norm());
            match ((p - center - offset_px).norm() < size_px, ring) {
                (true, true) => 0.5 * PLATE,
                (true, false) => 1.25 * PLATE,
                (false, true) => BURNT,
                (false, false) => PLATE,
            }
        }));
        let off_mm = off_mm(&found.unwrap(), offset_px);
        assert!(off_mm < 0.001, "{inner_px} {size_px}: off by {off_mm}");
    }
}

#[test]
fn the_inner_edge_of_a_wide_annulus_is_no_spot() {
    for part in [0.34, 0.4, 0.45] {
        let offset_px = Vector2::new(2.3, -1.4);
        let found = burn(150.0, part * 150.0, 18.0, offset_px).unwrap();
        let off_mm = off_mm(&found, offset_px);
        assert!(off_mm < 0.0005, "{part}: off by {off_mm}");
        let error = burn(150.0, part * 150.0, 0.0, offset_px).map(|m| m.report.spot.diameter_mm);
        assert!(error.is_err(), "{part}: {error:?}");
    }
}

/// A nut's outline and a dot within it, or a screw's socket within its head, are no burn.
#[test]
fn polygons_are_neither_rings_nor_spots() {
    let center = Vector2::new(318.3, 241.6);
    let polygon = |d: Vector2<f64>, corners: f64| {
        let side = std::f64::consts::TAU / corners;
        let turn = (d.y.atan2(d.x) + 0.2).rem_euclid(side) - 0.5 * side;
        d.norm() * turn.cos()
    };
    let dot = Vector2::new(4.0, -3.0);
    for corners in [5.0, 6.0, 7.0, 8.0] {
        let nut = measure(&picture(|p| {
            let d = p - center;
            if polygon(d, corners) < 140.0 && (d - dot).norm() > 25.0 { BURNT } else { PLATE }
        }));
        assert!(nut.is_err(), "{corners}: {:?}", nut.map(|m| m.report.ring.diameter_mm));
    }
    let screw = measure(&picture(|p| {
        let d = p - center;
        match (d.norm() < 150.0, polygon(d, 6.0) < 45.0) {
            (_, true) => 20.0,
            (true, false) => BURNT,
            (false, false) => PLATE,
        }
    }));
    assert!(screw.is_err(), "{:?}", screw.map(|m| m.report.spot.diameter_mm));
}

/// Rings of ripples about one centre: any two of them could be taken for ring and spot.
#[test]
fn ripples_are_no_burn() {
    let center = Vector2::new(318.3, 241.6);
    for (length_px, reach_px) in [(40.0, 400.0), (60.0, 250.0), (80.0, 300.0)] {
        let rippled = measure(&picture(|p| {
            let r = (p - center).norm();
            let wave = 1.0 - (std::f64::consts::TAU * r / length_px).cos();
            PLATE * (1.0 - 0.25 * wave * (-r / reach_px).exp())
        }));
        assert!(rippled.is_err(), "{length_px}: {:?}", rippled.map(|m| m.report.ring.diameter_mm));
    }
}

/// A burn is seen well in one channel, and in the others hardly better than the tint around it, whose bands lie elsewhere in each.
#[test]
fn the_channel_that_shows_the_burn_is_believed_not_the_one_that_shows_tint() {
    let (center, tinted) = (Vector2::new(318.3, 241.6), Vector2::new(318.7, 241.3));
    let offset_px = Vector2::new(2.3, -1.4);
    let found = measure(&colour_picture(|p, channel| {
        let d = p - center;
        let depth = [0.12, 0.6, 0.15][channel];
        let out = (p - tinted).norm() - 130.0;
        let band = 1.0 - (std::f64::consts::TAU * out / [15.0, 18.0, 21.0][channel]).cos();
        let tint = if out > 0.0 { 0.1 * band * (-out / 30.0).exp() } else { 0.0 };
        let inside = |r: f64| 1.0 / (1.0 + (r / 2.0).exp());
        let plate = PLATE * (1.0 - tint);
        let burnt = plate * (1.0 - depth * inside(d.norm() - 130.0));
        burnt + (20.0 - burnt) * inside((d - offset_px).norm() - 22.0)
    }))
    .unwrap();
    let channel = found.report.channel;
    assert!(!matches!(channel, Channel::Red | Channel::Blue), "{channel:?}");
    let off = off_mm(&found, offset_px);
    assert!(off < 0.004, "off by {off} mm");
}

/// Where the burn has a gap its light spot is as bright as the plate: both end there, and both are measured.
#[test]
fn a_gap_hides_ring_and_spot_alike() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(1.3, -0.8);
    // Directions and half widths.
    let one: &[(f64, f64)] = &[(0.7, 1.1)];
    let three: &[(f64, f64)] = &[(0.3, 0.35), (2.2, 0.3), (4.4, 0.4)];
    for gaps in [one, three] {
        let found = measure(&picture(|p| {
            let d = p - center;
            let is_gap = |(turn, half): &(f64, f64)| {
                let away = (d.y.atan2(d.x) - turn).rem_euclid(std::f64::consts::TAU);
                away.min(std::f64::consts::TAU - away) < *half
            };
            let spot = (d - offset_px).norm() < 28.0;
            let burnt = d.norm() < 140.0 && !spot && !gaps.iter().any(is_gap);
            if burnt { BURNT } else { PLATE }
        }))
        .unwrap();
        let off_mm = off_mm(&found, offset_px);
        let u95_mm = found.report.offset.distance_u95_mm;
        assert!(off_mm < u95_mm && u95_mm < 0.003, "{gaps:?}: off by {off_mm} ± {u95_mm}");
    }
}

/// Bands of tint about a soft burn, a few pixels off its centre, draw its edge towards their own: the interval says so.
#[test]
fn bands_beyond_a_soft_ring_widen_its_interval() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(2.3, -1.4);
    let at = |tinted: Vector2<f64>, amplitude: f64| {
        let found = measure(&picture(|p| {
            let inside = |r: f64, soft_px: f64| 1.0 / (1.0 + (1.7 * r / soft_px).exp());
            let out = (p - center - tinted).norm() - 110.0;
            let band = 1.0 - (std::f64::consts::TAU * out / 44.0).cos();
            let tint = if out > 0.0 { amplitude * band * (-out / 60.0).exp() } else { 0.0 };
            let plate = PLATE * (1.0 - tint);
            let burnt = plate + (BURNT - plate) * inside((p - center).norm() - 110.0, 5.0);
            burnt + (20.0 - burnt) * inside((p - center - offset_px).norm() - 22.0, 3.0)
        }))
        .unwrap();
        (off_mm(&found, offset_px), found.report.offset.distance_u95_mm)
    };
    for tinted in [Vector2::new(2.1, -1.7), Vector2::new(5.0, -4.0)] {
        for amplitude in [0.05, 0.1] {
            let (off_mm, u95_mm) = at(tinted, amplitude);
            assert!(off_mm < u95_mm, "{tinted} {amplitude}: off by {off_mm} ± {u95_mm}");
        }
    }
}

/// On a smooth plate a tint that fades away from the rim, stronger on one side, is told from the rim there.
#[test]
fn a_tint_on_one_side_of_a_smooth_ring_does_not_move_it() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(1.3, -0.8);
    for (side, soft_px) in [(0.4f64, 2.4), (2.0, 2.8), (4.4, 3.2)] {
        let found = measure(&picture(|p| {
            let inside = |r: f64, soft_px: f64| 1.0 / (1.0 + (1.7 * r / soft_px).exp());
            let d = p - center;
            let out = d.norm() - 150.0;
            let stronger = 1.0 + 0.5 * (d.y.atan2(d.x) - side).cos();
            let plate = PLATE * (1.0 - 0.06 * stronger * (-out.max(0.0) / 11.0).exp());
            let burnt = plate + (BURNT - plate) * inside(out, soft_px);
            burnt + (20.0 - burnt) * inside((d - offset_px).norm() - 30.0, 1.5)
        }))
        .unwrap();
        let off_mm = off_mm(&found, offset_px);
        let u95_mm = found.report.offset.distance_u95_mm;
        // A twentieth of a pixel; taken for edge the tint moves it by three times as much.
        assert!(off_mm < u95_mm && off_mm < 0.001, "{side}: off by {off_mm} ± {u95_mm}");
    }
}

/// A fainter circle about ripples is no burn either.
#[test]
fn a_halo_about_ripples_is_no_burn() {
    let center = Vector2::new(318.3, 241.6);
    let found = measure(&picture(|p| match (p - center).norm() {
        r @ ..115.0 if (r % 28.0) < 14.0 => BURNT,
        ..170.0 => PLATE - 30.0,
        _ => PLATE,
    }));
    assert!(found.is_err(), "{:?}", found.map(|m| m.report.ring.diameter_mm));
}

/// A spot may lie on an annulus' inner edge, lighter than the plate or darker than the burn.
#[test]
fn a_spot_on_the_inner_edge_of_an_annulus_is_measured() {
    let center = Vector2::new(318.3, 241.6);
    for (level, offset_px) in
        [(230.0, Vector2::new(88.4, -70.2)), (20.0, Vector2::new(-40.7, 98.3))]
    {
        let found = measure(&picture(|p| {
            let d = p - center;
            let is_spot = (d - offset_px).norm() < 24.0;
            let is_burnt = (105.0..150.0).contains(&d.norm());
            if is_spot {
                level
            } else if is_burnt {
                BURNT
            } else {
                PLATE
            }
        }))
        .unwrap();
        let (off_mm, u95_mm) = (off_mm(&found, offset_px), found.report.offset.distance_u95_mm);
        assert!(off_mm < u95_mm && u95_mm < 0.01, "{level}: off by {off_mm} ± {u95_mm}");
    }
}

/// A lamp seen in the plate is a soft bump of light, whether it clips or not: beside a burn's spot, or alone in its ring, it is none.
#[test]
fn a_glare_is_no_spot() {
    let center = Vector2::new(318.3, 241.6);
    let (offset_px, glare) = (Vector2::new(2.3, -1.4), Vector2::new(52.0, -38.0));
    for brightness in [100.0, 160.0, 400.0] {
        let at = |spot_px: f64| {
            measure(&picture(|p| {
                let d = p - center;
                let light = brightness * (-((d - glare).norm() / 24.0).powi(2)).exp();
                let level = match (d.norm() < 140.0, (d - offset_px).norm() < spot_px) {
                    (_, true) => 20.0,
                    (true, false) => BURNT,
                    (false, false) => PLATE,
                };
                level + light
            }))
        };
        let error = at(0.0).map(|m| m.report.spot.diameter_mm);
        assert!(error.is_err(), "{brightness}: {error:?}");
        let off_mm = off_mm(&at(22.0).unwrap(), offset_px);
        assert!(off_mm < 0.001, "{brightness}: off by {off_mm}");
    }
}

/// A lamp's soft, clipped reflection with its lens in it, and a printed target, have circles within circles.
#[test]
fn lamps_and_targets_are_no_burns() {
    let center = Vector2::new(318.3, 241.6);
    let lamp = measure(&picture(|p| {
        let inside = |r: f64| 1.0 / (1.0 + (1.7 * r / 10.0).exp());
        let d = (p - center).norm();
        PLATE - 60.0 + 300.0 * inside(d - 140.0)
            - 180.0 * inside((d - 70.0).abs() - 6.0)
            - 200.0 * inside(d - 30.0)
    }));
    assert!(lamp.is_err(), "{:?}", lamp.map(|m| m.report.ring.diameter_mm));
    let target = measure(&picture(|p| {
        let d = p - center;
        let line = |r: f64| (d.norm() - r).abs() < 5.0;
        let cross = d.x.abs().min(d.y.abs()) < 4.0 && d.norm() < 190.0;
        if line(140.0) || line(45.0) || cross { BURNT } else { PLATE }
    }));
    assert!(target.is_err(), "{:?}", target.map(|m| m.report.ring.diameter_mm));
}

/// A spot may be a fiftieth of its ring: it is looked for from nearer. One of several dots is no spot, nor is one of several balls.
#[test]
fn a_tiny_spot_is_measured_where_it_is_the_only_one() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(6.3, -4.4);
    let dotted = |others: &[(f64, f64)], dot_px: f64| {
        measure(&picture(|p| {
            let d = p - center;
            let dots = others.iter().map(|(x, y)| Vector2::new(*x, *y));
            let is_dot = dots.chain([offset_px]).any(|dot| (d - dot).norm() < dot_px);
            match (is_dot, d.norm() < 190.0) {
                (true, _) => 15.0,
                (false, true) => BURNT + 50.0,
                (false, false) => PLATE,
            }
        }))
    };
    for dot_px in [4.6, 6.0, 8.5] {
        let off_mm = off_mm(&dotted(&[], dot_px).unwrap(), offset_px);
        assert!(off_mm < 0.001, "{dot_px}: off by {off_mm}");
    }
    let spatter = dotted(&[(-30.0, 8.0), (9.0, 33.0), (21.0, -36.0)], 5.0);
    assert!(spatter.is_err(), "{:?}", spatter.map(|m| m.report.spot.center_px));
    let balls = dotted(&[(-80.0, 0.0), (40.0, 78.0), (48.0, -76.0), (85.0, 3.0)], 22.0);
    assert!(balls.is_err(), "{:?}", balls.map(|m| m.report.spot.center_px));
}

/// A pale soft ring in a cloudy plate, whose clouds move its edge, is measured with the interval that this leaves.
#[test]
fn a_ring_that_clouds_move_is_measured_as_well_as_it_tells() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(3.3, 2.4);
    for seed in [0.3, 1.7, 2.9] {
        let found = measure(&picture(|p| {
            let cloud = |k: i32| {
                let turn = seed + 2.4 * f64::from(k);
                let across = p.x * turn.cos() + p.y * turn.sin();
                (std::f64::consts::TAU * across / (60.0 + 9.0 * f64::from(k)) + seed * turn).sin()
            };
            let plate = PLATE + 2.2 * (0..6).map(cloud).sum::<f64>();
            let inside = |out: f64, soft_px: f64| 1.0 / (1.0 + (1.7 * out / soft_px).exp());
            let burnt = plate - 25.0 * inside((p - center).norm() - 140.0, 12.0);
            burnt + (20.0 - burnt) * inside((p - center - offset_px).norm() - 22.0, 2.0)
        }))
        .unwrap();
        let (off_mm, u95_mm) = (off_mm(&found, offset_px), found.report.offset.distance_u95_mm);
        println!("{seed}: {off_mm:.4} ± {u95_mm:.4} mm");
        assert!(off_mm < u95_mm && u95_mm < 0.4, "{seed}: {off_mm} ± {u95_mm}");
    }
}

/// A small spot away from the ring's centre is measured where it is burnt and alone, on an annulus' inner edge too; one of several is spatter.
#[test]
fn a_small_spot_far_out_is_measured_where_it_is_alone() {
    let center = Vector2::new(318.3, 241.6);
    let dotted = |inner_px: f64, dots: &[(f64, f64)], dot_px: f64| {
        measure(&picture(|p| {
            let d = p - center;
            let is_dot = dots.iter().any(|(x, y)| (d - Vector2::new(*x, *y)).norm() < dot_px);
            match (is_dot, (inner_px..190.0).contains(&d.norm())) {
                (true, _) => 15.0,
                (false, true) => BURNT + 40.0,
                (false, false) => PLATE,
            }
        }))
    };
    for (inner_px, at, dot_px) in
        [(0.0, (66.3, -44.4), 10.0), (150.0, (-128.6, 30.2), 10.5), (150.0, (131.0, 49.0), 8.0)]
    {
        let off_mm = off_mm(&dotted(inner_px, &[at], dot_px).unwrap(), Vector2::new(at.0, at.1));
        assert!(off_mm < 0.002, "{at:?}, {dot_px}: off by {off_mm}");
    }
    let spatter = dotted(0.0, &[(66.3, -44.4), (-70.0, 52.0), (20.0, 93.0)], 10.0);
    assert!(spatter.is_err(), "{:?}", spatter.map(|m| m.report.spot.center_px));
}

/// A burn whose zones are bands is one where its own edge is the clearest and the last, and its spot is no band. A dark spot in a light
/// burn is no glare.
#[test]
fn a_banded_burn_is_no_ripple_and_its_spot_no_band() {
    let center = Vector2::new(318.3, 241.6);
    for (dark, offset_px) in [(120.0, Vector2::new(62.0, 14.0)), (110.0, Vector2::new(4.0, -3.0))] {
        let found = measure(&picture(|p| {
            let r = (p - center).norm();
            let bands = 12.0 * (std::f64::consts::TAU * r / 48.0).cos();
            match ((p - center - offset_px).norm() < 18.0, r < 190.0) {
                (true, _) => dark,
                (false, true) => 208.0 + bands,
                (false, false) => 150.0,
            }
        }))
        .unwrap();
        assert!(off_mm(&found, offset_px) < 0.003, "{:?}", found.report.spot.center_px);
    }
}

/// A pale arc far from anything, with a ragged blotch in it, has too much against it; the centre in pixels is that in mm.
#[test]
fn what_is_faint_partial_and_far_off_all_at_once_is_no_burn() {
    let center = Vector2::new(318.3, 241.6);
    let found = measure(&picture(|p| {
        let d = p - center;
        let arc = d.norm() < 190.0 && d.y.atan2(d.x).abs() < 1.7;
        let blotch =
            (d - Vector2::new(115.0, 20.0)).norm() < 17.0 + 2.5 * (3.0 * d.y.atan2(d.x)).sin();
        let grain = 9.0 * ((0.9 * p.x).sin() * (0.8 * p.y).cos() + (1.3 * p.x + 0.7 * p.y).sin());
        PLATE + grain - if arc { 9.0 } else { 0.0 } - if blotch { 14.0 } else { 0.0 }
    }));
    assert!(found.is_err(), "{:?}", found.map(|m| m.report.spot.center_px));
}

/// The heat leaves a halo about the spot, fainter than it and as uneven as the plate: the spot is what is measured.
#[test]
fn a_spot_is_measured_within_its_halo() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(31.4, -12.7);
    let found = measure(&picture(|p| {
        let r = (p - center - offset_px).norm();
        let grain = |a: f64, b: f64| (a * p.x + b * p.y).sin();
        let plate = PLATE + 7.0 * (grain(0.21, 0.13) + grain(-0.1, 0.27) + grain(0.07, -0.19));
        let halo = 1.0 - 0.42 * (-(r - 9.0).max(0.0) / 12.0).exp();
        let edge = (150.0..190.0).contains(&(p - center).norm());
        match (edge, r < 9.0) {
            (true, _) => BURNT,
            (false, true) => 25.0,
            (false, false) => plate * halo,
        }
    }))
    .unwrap();
    let off_mm = off_mm(&found, offset_px);
    assert!(off_mm < 0.01, "off by {off_mm}, {} mm wide", found.report.spot.diameter_mm);
}

/// Where the light falls off there is a circle at any radius about it: it is no ring of a lone spot.
#[test]
fn the_light_about_a_lone_spot_is_no_ring() {
    for (light, spot) in [((430.0, 300.0), (350.0, 220.0)), ((300.0, 200.0), (260.0, 260.0))] {
        let from = |p: Vector2<f64>, (x, y): (f64, f64)| (p - Vector2::new(x, y)).norm();
        let found = measure(&picture(|p| {
            let lit = 200.0 * (-(from(p, light) / 420.0).powi(2)).exp();
            if from(p, spot) < 26.0 { 0.2 * lit } else { lit }
        }));
        assert!(found.is_err(), "{:?}", found.map(|m| m.report.ring.diameter_mm));
    }
}

/// A light annulus that clips is a burn on anodised metal: a lamp's reflection is softer.
#[test]
fn an_overexposed_light_annulus_is_no_lamp() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(12.3, 7.1);
    let rise = |x: f64| 1.0 / (1.0 + (-x / 3.0).exp());
    let found = measure(&picture(|p| {
        let r = (p - center).norm();
        let annulus = rise(r - 120.0) * rise(175.0 - r);
        let spot = rise(14.0 - (p - center - offset_px).norm());
        130.0 + 260.0 * annulus - 70.0 * spot
    }))
    .unwrap();
    let [x, y] = found.report.offset.offset_u95_mm;
    let off_mm = off_mm(&found, offset_px);
    assert!(off_mm < x.hypot(y) && off_mm < 0.02, "off by {off_mm}");
}

#[test]
fn a_chip_in_a_drilled_hole_is_no_spot_where_a_burn_has_one() {
    let offset_px = Vector2::new(2.0, -1.0);
    let inside = |p: Vector2<f64>, x: f64, y: f64, radius: f64, soft: f64| {
        0.5 - 0.5 * (((p - Vector2::new(x, y)).norm() - radius) / soft).tanh()
    };
    // The burn's edges are soft, the hole's and its burr's are sharp: they are found first.
    let seen = picture(|p| {
        let annulus =
            inside(p, 230.0, 250.0, 120.0, 8.0) * (1.0 - inside(p, 230.0, 250.0, 70.0, 8.0));
        let burnt = 150.0 - 90.0 * annulus;
        let level = burnt + (50.0 - burnt) * inside(p, 232.0, 249.0, 28.0, 4.0);
        let off = |x: f64, y: f64| (p - Vector2::new(x, y)).norm();
        match off(540.0, 120.0) {
            _ if off(515.0, 100.0) < 5.0 => 150.0,
            hole if hole < 70.0 => 20.0,
            burr if burr < 78.0 => 190.0,
            _ => level,
        }
    });
    let found = measure(&seen).unwrap();
    assert!(off_mm(&found, offset_px) < 1e-3, "{:?}", found.report.offset.offset_mm);
}
