//! Burns of all kinds that `burn` measures: which of their circles are ring and spot, and how well both are known.

mod painter;

use nalgebra::Vector2;
use painter::burn::{BURNT, PLATE, burn, measure, off_mm};
use painter::{colour_picture, picture};
use pivotsight::frame::Channel;

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

/// Light that falls off over a plate without texture is neither a ring nor a second burn, and moves none: a lens's vignette, a lamp beside.
#[test]
fn a_burn_on_a_smooth_plate_is_measured_in_uneven_light() {
    let (center, lens) = (Vector2::new(301.3, 251.6), Vector2::new(320.0, 240.0));
    let light = |p: Vector2<f64>, corner: f64, slope: f64| {
        let falls = 1.0 - corner * ((p - lens).norm() / 400.0).powi(2);
        falls.powi(2) * (1.0 + slope * (0.8 * p.x - 0.6 * p.y) / 400.0)
    };
    for (k, (corner, slope)) in
        [(0.05, 0.0), (0.15, 0.1), (0.2, 0.0), (0.3, 0.2), (0.0, 0.3)].into_iter().enumerate()
    {
        for (inner_px, depth) in [(0.0, 0.15), (0.0, 0.35), (100.0, 0.15), (100.0, 0.35)] {
            let offset_px = Vector2::new(7.4 * k as f64, -21.3 + 9.1 * k as f64);
            let seen = picture(|p| {
                let inside = |r_px: f64, soft_px: f64, p: Vector2<f64>| {
                    1.0 / (1.0 + (1.7 * (p.norm() - r_px) / soft_px).exp())
                };
                let hole = if inner_px > 0.0 { inside(inner_px, 5.0, p - center) } else { 0.0 };
                let ring = inside(130.0, 5.0, p - center) - hole;
                let spot = inside(13.0, 1.0, p - center - offset_px);
                light(p, corner, slope) * PLATE * (1.0 - depth * ring) * (1.0 - 0.5 * spot)
            });
            let found = measure(&seen).unwrap();
            let [x_mm, y_mm] = found.report.offset.offset_u95_mm;
            let (off_mm, u95_mm) = (off_mm(&found, offset_px), x_mm.hypot(y_mm));
            let case = format!("light {corner} {slope}, ring {inner_px} {depth}");
            assert!(off_mm < u95_mm && u95_mm < 0.006, "{case}: off by {off_mm} of {u95_mm}");
        }
    }
}

/// Light that the bottom of a dark spot throws back, off its middle, is brighter than the spot is dark: the spot is what is measured.
#[test]
fn a_glint_in_a_spot_is_not_the_spot() {
    let center = Vector2::new(318.3, 241.6);
    let offset_px = Vector2::new(-13.4, 9.7);
    let inside = |r_px: f64, soft_px: f64, p: Vector2<f64>| {
        1.0 / (1.0 + (1.7 * (p.norm() - r_px) / soft_px).exp())
    };
    for (glint_px, at_px) in [(10.0, [9.0, -6.0]), (13.0, [3.0, 10.0]), (8.0, [-14.0, 0.0])] {
        let glint_at = center + offset_px + Vector2::from(at_px);
        let found = measure(&picture(|p| {
            let ring = inside(150.0, 4.0, p - center);
            let spot = inside(28.0, 1.5, p - center - offset_px);
            let glint = inside(glint_px, 1.0, p - glint_at);
            PLATE * (1.0 - 0.6 * ring) * (1.0 - 0.6 * spot) + 110.0 * glint
        }))
        .unwrap();
        let [x_mm, y_mm] = found.report.offset.offset_u95_mm;
        let (off_mm, u95_mm) = (off_mm(&found, offset_px), x_mm.hypot(y_mm));
        assert!(off_mm < u95_mm && off_mm < 0.01, "{glint_px}: off by {off_mm} of {u95_mm}");
    }
}
