//! Circles that `burn` takes for no ring and no spot.

mod painter;

use nalgebra::Vector2;
use painter::burn::{BURNT, PLATE, burn, measure, off_mm};
use painter::picture;

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

/// One of many specks on a plate is no spot because it lies on something round; alone it may be one.
#[test]
fn a_speck_among_others_like_it_is_no_spot() {
    let disc = Vector2::new(318.3, 241.6);
    let strewn = [(22.4, 14.1), (-118.0, 62.0), (96.0, -90.0), (140.0, 31.0), (-64.0, -121.0)];
    let specks = |count: usize| {
        let at: Vec<_> = strewn[..count].iter().map(|(x, y)| disc + Vector2::new(*x, *y)).collect();
        measure(&picture(|p| {
            let speck = at.iter().any(|s| (p - s).norm() < 5.0);
            match ((p - disc).norm() < 70.0, speck) {
                (_, true) => 0.4 * BURNT,
                (true, false) => 1.4 * PLATE,
                (false, false) => PLATE,
            }
        }))
    };
    assert!(specks(1).is_ok());
    let found = specks(strewn.len()).map(|m| m.report.spot.diameter_mm);
    assert!(found.is_err(), "{found:?}");
}

/// What a lamp out of focus leaves on the bare plate within an annulus does not tell how large it is: no spot.
#[test]
fn a_blurred_lamp_within_an_annulus_is_no_spot() {
    let center = Vector2::new(318.3, 241.6);
    let inside = |r_px: f64, soft_px: f64, p: Vector2<f64>| {
        1.0 / (1.0 + (1.7 * (p.norm() - r_px) / soft_px).exp())
    };
    for (radius_px, soft_px, at) in
        [(36.0, 15.0, [60.0, 20.0]), (40.0, 18.0, [-50.0, 45.0]), (36.0, 18.0, [40.0, -55.0])]
    {
        let lamp = center + Vector2::from(at);
        let seen = picture(|p| {
            let around = [[0.0, 0.0], [150.0, -60.0], [-120.0, -150.0], [90.0, 120.0]];
            let lamps: f64 = around
                .iter()
                .map(|d| inside(radius_px, soft_px, p - lamp - Vector2::from(*d)))
                .sum();
            let uneven =
                (0.031 * p.x + 0.017 * p.y + 1.0).sin() * (0.019 * p.y - 0.011 * p.x).sin();
            let ring = inside(150.0, 3.0, p - center) - inside(110.0, 3.0, p - center);
            (70.0 + 80.0 * lamps + 20.0 * uneven) * (1.0 - 0.75 * ring)
        });
        let found = measure(&seen).map(|m| (m.report.spot.center_px, m.report.spot.diameter_mm));
        assert!(found.is_err(), "{radius_px} {soft_px}: {found:?}");
    }
}
