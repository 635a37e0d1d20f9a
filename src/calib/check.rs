//! Whether a calibration still holds: a known diameter, or a mark at known machine positions, measured again.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use serde::Serialize;

use crate::calib::mark;
use crate::calib::plane::odd_one_out;
use crate::camera::Calibration;
use crate::error::{Error, Result, above_zero};
use crate::fit::least_squares;
use crate::frame::{Channel, Frame, Picture};
use crate::measure::circles;
use crate::measure::rod::Capture;
use crate::uncertainty::{Verdict, k95};

/// A calibration is never so far off; a mistake of this kind never fits worse.
const MISTAKEN: f64 = 0.1;

/// A circle of known diameter in one picture.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct DiameterReport {
    /// The picture.
    pub image: String,
    /// What was measured.
    pub diameter_mm: f64,
    /// Measured minus known.
    pub deviation_mm: f64,
    /// Half-width of its 95 % interval, that of the known diameter included.
    pub deviation_u95_mm: f64,
    /// Whether the limit is kept.
    pub verdict: Verdict,
}

/// Measures the object of known diameter.
pub fn diameter(
    picture: &Picture,
    calibration: &Calibration,
    known_mm: f64,
    known_u95_mm: f64,
    tolerance_mm: f64,
    subject: &str,
) -> Result<DiameterReport> {
    above_zero("--diameter-mm", known_mm, "give the known diameter in mm")?;
    let options = circles::Options { expect_mm: vec![known_mm], channel: Channel::Auto };
    let seen = circles::measure(picture, &calibration.as_exact(), &options, subject)
        .map_err(|e| e.of_option("--diameter-mm"))?
        .report;
    let Some(circle) = seen.circles.first().map(|c| &c.circle) else {
        return Err(Error::measure(subject, "shows no such circle", "check the diameter"));
    };
    let deviation_mm = circle.diameter_mm - known_mm;
    let deviation_u95_mm = circle.diameter_u95_mm.hypot(known_u95_mm);
    Ok(DiameterReport {
        image: subject.to_owned(),
        diameter_mm: circle.diameter_mm,
        deviation_mm,
        deviation_u95_mm,
        verdict: Verdict::of(deviation_mm.abs(), deviation_u95_mm, tolerance_mm),
    })
}

/// How far the plane has changed, as a mark at known machine positions shows it.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct PlaneReport {
    /// Pictures in which the mark was found.
    pub captures_used: usize,
    /// What the calibration says a length is, over what it is, minus one.
    pub scale_error_percent: f64,
    /// Half-width of its 95 % interval.
    pub scale_error_u95_percent: f64,
    /// Turn of what the calibration says against the machine.
    pub rotation_error_deg: f64,
    /// Half-width of its 95 % interval.
    pub rotation_error_u95_deg: f64,
    /// Largest error of a place in the frame, seen from the camera axis.
    pub field_error_mm: f64,
    /// Half-width of its 95 % interval.
    pub field_error_u95_mm: f64,
    /// Root mean square of the residuals that scale, turn and shear do not explain.
    pub residual_rms_mm: f64,
    /// Whether `field_error_mm` keeps the limit.
    pub verdict: Verdict,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// Compares the calibration with the machine: `H(p) + P` is the mark's place for every capture, if it holds. An affine
/// error of `H` is fitted to what differs.
pub fn plane(
    captures: &[Capture],
    calibration: &Calibration,
    tolerance_mm: f64,
) -> Result<PlaneReport> {
    let frames = captures
        .iter()
        .map(|c| Ok(calibration.linear(Picture::read(&c.path)?.into_frame(Channel::Auto))))
        .collect::<Result<Vec<Frame>>>()?;
    let Some((w, h)) = frames.first().map(|f| (f.width(), f.height())) else {
        return Err(Error::measure("the check", "has no captures", "give some"));
    };
    let views = frames
        .iter()
        .map(|f| calibration.view(f.width(), f.height()))
        .collect::<Result<Vec<_>>>()?;
    let positions: Vec<Vector2<f64>> = captures.iter().map(|c| c.position_mm).collect();
    let sightings = match mark::find(&frames, &positions) {
        Some((mark, rough)) => mark.again(&frames, &rough, &views[0]),
        None => vec![None; frames.len()],
    };
    let places = |i: usize| Some((views[i].to_plane(sightings[i]?), positions[i]));
    let mut used: Vec<usize> = (0..captures.len()).filter(|&i| sightings[i].is_some()).collect();
    let mut warnings: Vec<String> = (0..captures.len())
        .filter(|&i| sightings[i].is_none())
        .map(|i| format!("{}: left out, the mark is not where the other captures say (position mistyped, or not in the picture?)", captures[i].image))
        .collect();
    let of = |used: &[usize]| -> Vec<(Vector2<f64>, Vector2<f64>)> {
        used.iter().filter_map(|&i| places(i)).collect()
    };
    if let Some(odd) = odd_one_out(&used, |rest| Some(Affine::fit(&of(rest))?.variance())) {
        warnings.push(format!(
            "{}: left out, it does not fit the others (position mistyped, or the mark slipped?)",
            captures[odd].image
        ));
        used.retain(|&i| i != odd);
    }
    let seen = of(&used);
    let few = || {
        Error::measure(
            "captures",
            format!("the mark was found in {} of {} pictures", seen.len(), captures.len()),
            "photograph one clear mark from five machine positions or more, spread in X and Y",
        )
    };
    if seen.len() < 4 {
        return Err(few());
    }
    let Some(fit) = Affine::fit(&seen) else { return Err(few()) };
    warnings.extend(mistake(&fit.beta));
    let Affine { inverse, beta, squares, dof } = &fit;
    let factor = k95(*dof) * fit.variance().sqrt();
    let combine = |weights: [f64; 4]| {
        let g = DVector::from_fn(6, |i, _| if i < 2 { 0.0 } else { weights[i - 2] });
        (g.dot(beta), factor * g.dot(&(inverse * &g)).max(0.0).sqrt())
    };
    let (scale, scale_u) = combine([0.5, 0.0, 0.0, 0.5]);
    let (turn, turn_u) = combine([0.0, -0.5, 0.5, 0.0]);
    let (right, low) = (w as f64 - 1.0, h as f64 - 1.0);
    let (field_error_mm, field_error_u95_mm) = [(0.0, 0.0), (right, 0.0), (0.0, low), (right, low)]
        .iter()
        .map(|&(u, v)| views[0].to_plane(Vector2::new(u, v)))
        .map(|q| {
            let (x, ux) = combine([q.x, q.y, 0.0, 0.0]);
            let (y, uy) = combine([0.0, 0.0, q.x, q.y]);
            (x.hypot(y), ux.hypot(uy))
        })
        .fold((0.0, 0.0), |m: (f64, f64), e| if e.0 > m.0 { e } else { m });
    Ok(PlaneReport {
        captures_used: seen.len(),
        scale_error_percent: 100.0 * scale,
        scale_error_u95_percent: 100.0 * scale_u,
        rotation_error_deg: turn.to_degrees(),
        rotation_error_u95_deg: turn_u.to_degrees(),
        field_error_mm,
        field_error_u95_mm,
        residual_rms_mm: (squares / seen.len() as f64).sqrt(),
        verdict: Verdict::of(field_error_mm, field_error_u95_mm, tolerance_mm),
        warnings,
    })
}

/// How the positions were written down, where the mark moved as it would then. Of `p` the machine moves by `(E - 1) p`.
fn mistake(beta: &DVector<f64>) -> Option<String> {
    let moves = Matrix2::new(1.0 - beta[2], -beta[3], -beta[4], 1.0 - beta[5]);
    let unit = |factor: f64| Matrix2::identity() * factor;
    [
        (Matrix2::new(0.0, 1.0, 1.0, 0.0), "x_mm and y_mm are swapped"),
        (Matrix2::new(-1.0, 0.0, 0.0, 1.0), "x_mm has the wrong sign"),
        (Matrix2::new(1.0, 0.0, 0.0, -1.0), "y_mm has the wrong sign"),
        (
            unit(-1.0),
            "x_mm and y_mm have the wrong sign (they say where the head is over the table)",
        ),
        (unit(1e-3), "x_mm and y_mm are in metres"),
        (unit(1.0 / 25.4), "x_mm and y_mm are in inches"),
        (unit(1e3), "x_mm and y_mm are in micrometres"),
    ]
    .into_iter()
    .find(|(then, _)| (moves - then).norm() < MISTAKEN * then.norm())
    .map(|(_, what)| format!("the mark moves as if {what}: correct the table if so"))
}

/// What `p + P` says of the affine error `E`, with `H(p) = (1 + E)(M - P)`: regressed on 1 and `p`, to first order in `E`.
struct Affine {
    inverse: DMatrix<f64>,
    beta: DVector<f64>,
    squares: f64,
    dof: f64,
}

impl Affine {
    /// `None` where the places do not determine it.
    fn fit(seen: &[(Vector2<f64>, Vector2<f64>)]) -> Option<Self> {
        if seen.len() < 4 {
            return None;
        }
        let rows = 2 * seen.len();
        let design = DMatrix::from_fn(rows, 6, |r, c| {
            let p = seen[r / 2].0;
            let own = [[1.0, 0.0, p.x, p.y, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, p.x, p.y]];
            own[r % 2][c]
        });
        let y = DVector::from_fn(rows, |r, _| (seen[r / 2].0 + seen[r / 2].1)[r % 2]);
        let (inverse, rank) = least_squares::covariance(&design, 1e-7);
        let beta = &inverse * design.tr_mul(&y);
        let squares = (&y - &design * &beta).norm_squared();
        (rank == 6).then_some(Self { inverse, beta, squares, dof: (rows - 6) as f64 })
    }

    fn variance(&self) -> f64 {
        self.squares / self.dof
    }
}
