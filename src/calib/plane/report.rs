//! What a plane's mapping says: scale, turn, tilt, how well the captures agree, and what a user should know.

use nalgebra::{DVector, Matrix2, Vector2};
use serde::Serialize;

use crate::calib::homography::{Fit, homography, map};
use crate::calib::plane::known::{Known, field_u95_mm};
use crate::calib::unseen_lens::unseen_lens;
use crate::camera::{Lens, View};
use crate::measure::rod::Capture;

/// Pixels that are so much higher than wide are remarked on.
const ODD_ASPECT: f64 = 0.01;

/// How the camera is mounted, as far as the picture and the positions say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Orientation {
    /// The picture's u axis points within 45° of machine X.
    Upright,
    /// It points elsewhere.
    Turned,
    /// The picture is a mirror image of the machine's plane.
    Mirrored,
}

/// How one capture fits.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct CaptureReport {
    /// The picture.
    pub image: String,
    /// Machine X.
    pub x_mm: f64,
    /// Machine Y.
    pub y_mm: f64,
    /// The mark's place in the picture; null where it was not found.
    pub mark_px: Option<[f64; 2]>,
    /// Where the mapping sees the mark minus where the machine says it is.
    pub residual_mm: Option<[f64; 2]>,
    /// Whether the mapping rests on this capture.
    pub used: bool,
}

/// The plane's mapping and what is known of it.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// Size of a pixel in the plane where the camera axis meets it.
    pub mm_per_px: f64,
    /// Half-width of its 95 % interval.
    pub mm_per_px_u95: f64,
    /// Direction of the picture's u axis in the plane, counter-clockwise from machine X.
    pub rotation_deg: f64,
    /// Half-width of its 95 % interval.
    pub rotation_u95_deg: f64,
    /// Tilt of the plane about the camera's u and v axes; null without a lens file.
    pub tilt_deg: Option<[f64; 2]>,
    /// Half-widths of their 95 % intervals.
    pub tilt_u95_deg: Option<[f64; 2]>,
    /// Height over width of a pixel in the plane, minus one.
    pub aspect: f64,
    /// Half-width of its 95 % interval.
    pub aspect_u95: f64,
    /// Departure of the pixel's sides from a right angle.
    pub shear_deg: f64,
    /// Half-width of its 95 % interval.
    pub shear_u95_deg: f64,
    /// How the camera is mounted.
    pub orientation: Orientation,
    /// Root mean square of the residuals' lengths.
    pub residual_rms_mm: f64,
    /// Largest half-width of the 95 % interval of a place in the frame, seen from the camera axis.
    pub field_u95_mm: f64,
    /// Undistorted normalised image → plane.
    pub homography_mm: [[f64; 3]; 3],
    /// Every capture.
    pub captures: Vec<CaptureReport>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// Of the captures that were `used`.
pub(super) fn report(
    captures: &[Capture],
    sightings: &[Option<Vector2<f64>>],
    used: &[usize],
    known: &Known,
    known_lens: bool,
    mut warnings: Vec<String>,
) -> Report {
    let (fit, lens) = (known.fit, known.lens);
    let normal = lens.normalised();
    // d(plane) / d(pixel) at the principal point.
    let axis = |lens: &Lens, p: &DVector<f64>| {
        Matrix2::new(p[0] / lens.fx_px, p[1] / lens.fy_px, p[2] / lens.fx_px, p[3] / lens.fy_px)
    };
    let turn = |m: &Matrix2<f64>| m[(1, 0)].atan2(m[(0, 0)]);
    let (mm_per_px, mm_per_px_u95) = known.value(|l, p| axis(l, p).determinant().abs().sqrt());
    let at_axis = axis(lens, &fit.p);
    let start = turn(&at_axis);
    let (swing, rotation_u95) = known.value(|l, p| {
        let away = turn(&axis(l, p)) - start;
        away.sin().atan2(away.cos())
    });
    let (aspect, aspect_u95) =
        known.value(|l, p| axis(l, p).column(1).norm() / axis(l, p).column(0).norm() - 1.0);
    let (shear, shear_u95) = known.value(|l, p| {
        let m = axis(l, p);
        -(m.column(0).dot(&m.column(1)) / (m.column(0).norm() * m.column(1).norm())).asin()
    });
    let tilt = known_lens.then(|| [0, 1].map(|i| known.value(|_, p| tilt_rad(p)[i])));
    let rotation_deg = (start + swing).to_degrees();
    let orientation = if at_axis.determinant() > 0.0 {
        Orientation::Mirrored
    } else if rotation_deg.abs() > 45.0 {
        Orientation::Turned
    } else {
        Orientation::Upright
    };
    warnings.extend(reading(orientation, &at_axis));
    let rows = capture_reports(captures, sightings, used, fit, &normal);
    let squares: f64 = rows
        .iter()
        .filter(|r| r.used)
        .filter_map(|r| r.residual_mm)
        .map(|[x, y]| x * x + y * y)
        .sum();
    let mut field_u95_mm = field_u95_mm(known);
    let residual_rms_mm = (squares / used.len() as f64).sqrt();
    if residual_rms_mm > mm_per_px {
        warnings.push(format!(
            "the captures disagree by {:.1} px rms: several positions are mistyped, the machine was not where it said, or the lens is another's",
            residual_rms_mm / mm_per_px
        ));
    }
    if aspect.abs() > (3.0 * aspect_u95).max(ODD_ASPECT) {
        warnings.push(format!(
            "pixels would be {:+.1} % higher than wide, as hardly any camera's are: is one axis' scale or unit another than the other's?",
            100.0 * aspect
        ));
    }
    warnings.extend(spread(sightings, used, lens));
    if !known_lens {
        let places = used.iter().filter_map(|&i| Some((sightings[i]?, captures[i].position_mm)));
        let (u95, warning) = without_lens(lens, &places.collect::<Vec<_>>(), fit, field_u95_mm);
        field_u95_mm = u95;
        warnings.push(warning);
    }
    let h = fit.homography();
    Report {
        mm_per_px,
        mm_per_px_u95,
        rotation_deg,
        rotation_u95_deg: rotation_u95.to_degrees(),
        tilt_deg: tilt.map(|t| t.map(|(v, _)| v.to_degrees())),
        tilt_u95_deg: tilt.map(|t| t.map(|(_, u)| u.to_degrees())),
        aspect,
        aspect_u95,
        shear_deg: shear.to_degrees(),
        shear_u95_deg: shear_u95.to_degrees(),
        orientation,
        residual_rms_mm,
        field_u95_mm,
        homography_mm: std::array::from_fn(|r| std::array::from_fn(|c| h[(r, c)])),
        captures: rows,
        warnings,
    }
}

/// What each capture says of the fit.
fn capture_reports(
    captures: &[Capture],
    sightings: &[Option<Vector2<f64>>],
    used: &[usize],
    fit: &Fit,
    normal: &View,
) -> Vec<CaptureReport> {
    let mark = Vector2::new(fit.p[6], fit.p[7]);
    let of = |(i, c): (usize, &Capture)| CaptureReport {
        image: c.image.clone(),
        x_mm: c.position_mm.x,
        y_mm: c.position_mm.y,
        mark_px: sightings[i].map(Into::into),
        residual_mm: sightings[i]
            .map(|s| (map(&fit.p, normal.to_plane(s)) + c.position_mm - mark).into()),
        used: used.contains(&i),
    };
    captures.iter().enumerate().map(of).collect()
}

/// The corners' interval where the lens is not known, and what to say of it.
fn without_lens(
    lens: &Lens,
    places: &[(Vector2<f64>, Vector2<f64>)],
    fit: &Fit,
    field_u95_mm: f64,
) -> (f64, String) {
    let bent = unseen_lens(lens, places, fit);
    let corners = match &bent {
        Some(bent) => format!("by {:.4} mm there, as far as the positions tell", bent.seen_mm),
        None => "by what these few positions do not tell".into(),
    };
    // What is known to be wrong and not corrected adds to what is unsure (GUM, F.2.4.5).
    let u95 = bent.map_or(field_u95_mm, |b| b.seen_mm + field_u95_mm.hypot(b.u95_mm));
    let warning = format!(
        "no lens file: the tilt cannot be told, and the lens is taken as free of distortion, which puts the corners wrong {corners} (calib camera makes one)"
    );
    (u95, warning)
}

/// Tilt of the plane about the camera's u and then v axis: the plane's normal is `Ry(v)·Rx(u)·z`.
fn tilt_rad(p: &DVector<f64>) -> [f64; 2] {
    let Some(g) = homography(p).try_inverse() else { return [0.0; 2] };
    let n = g.column(0).cross(&g.column(1)).normalize();
    let n = if n.z < 0.0 { -n } else { n };
    [(-n.y).asin(), n.x.atan2(n.z)]
}

/// What the orientation means to a person who typed the positions and mounted the camera.
fn reading(orientation: Orientation, j: &Matrix2<f64>) -> Vec<String> {
    let turn = |m: Matrix2<f64>| {
        let deg = m[(1, 0)].atan2(m[(0, 0)]).to_degrees();
        // -0 and -180 read badly.
        let deg = (deg * 10.0).round() / 10.0 + 0.0;
        if deg <= -180.0 { deg + 360.0 } else { deg }
    };
    let (flip_x, flip_y) = (Matrix2::new(-1.0, 0.0, 0.0, 1.0), Matrix2::new(1.0, 0.0, 0.0, -1.0));
    let swap = Matrix2::new(0.0, 1.0, 1.0, 0.0);
    let mut list = Vec::new();
    match orientation {
        Orientation::Upright => {}
        Orientation::Turned if turn(*j).abs() > 135.0 => list.push(format!(
            "the picture is turned by {:.1}°: if the camera is mounted upright, x_mm and y_mm both have the wrong sign (they must say where the head is over the table, not where the table is)",
            turn(*j)
        )),
        Orientation::Turned => list.push(format!(
            "the picture is turned by {:.1}°; this is right only if the camera is mounted that way",
            turn(*j)
        )),
        Orientation::Mirrored => {
            let mut causes = [
                (turn(j * flip_x), "the camera's picture is mirrored left to right (a mirror or a setting of the driver)"),
                (turn(j * flip_y), "the camera's picture is mirrored top to bottom"),
                (turn(flip_x * j), "x_mm has the wrong sign"),
                (turn(flip_y * j), "y_mm has the wrong sign"),
                (turn(swap * j), "x_mm and y_mm are swapped"),
            ];
            causes.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
            let said: Vec<String> = causes
                .iter()
                .map(|(deg, cause)| format!("{cause} (the camera is then turned by {deg:.1}°)"))
                .collect();
            list.push(format!(
                "mirrored: the mark moves as in a mirror image. One of these is so, likeliest first for an upright camera: {}. If writing on the part reads normally in the picture, the camera is not the cause",
                said.join("; ")
            ));
        }
    }
    list
}

/// Says so where the mark was seen in a small part of the frame only.
fn spread(sightings: &[Option<Vector2<f64>>], used: &[usize], lens: &Lens) -> Option<String> {
    let places = || used.iter().filter_map(|&i| sightings[i]);
    let low = places().fold(Vector2::repeat(f64::INFINITY), |m, p| m.inf(&p));
    let high = places().fold(Vector2::repeat(f64::NEG_INFINITY), |m, p| m.sup(&p));
    let share = (high - low)
        .component_div(&Vector2::new(f64::from(lens.width_px), f64::from(lens.height_px)));
    (share.min() < 0.4).then(|| {
        format!(
            "the mark was seen over {:.0} % × {:.0} % of the frame only: outside, the mapping is extrapolated",
            100.0 * share.x,
            100.0 * share.y
        )
    })
}
