//! Touches of a blank's end face and sides → tilt A, B, height and centre, with uncertainty.

use nalgebra::{Matrix3, Vector3};

use super::alignment::{Alignment, leveller};
use super::touches::Touches;
use crate::error::{Error, Result, above_zero};
use crate::fit::robust::range;
use crate::uncertainty::{K95, k95};

/// Standard uncertainty of a touch where neither the data nor the user tells it.
const ASSUMED_TOUCH_MM: f64 = 0.002;
/// Opposite sides lie farther apart than this part of what the end face was touched over.
const ONE_SIDE: f64 = 0.05;

/// What is known beside the touches.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options {
    /// Height of the face in the programming frame.
    pub z_ideal_mm: f64,
    /// The blank's axis in the programming frame.
    pub center_ideal_mm: [f64; 2],
    /// Turn of the path about the blank's axis.
    pub c_deg: f64,
    /// Standard uncertainty of a touch; `None`: from the face's residuals.
    pub touch_u_mm: Option<f64>,
}

impl Options {
    fn check(&self) -> Result<()> {
        let [ox, oy] = self.center_ideal_mm;
        for (option, v) in [
            ("--z-ideal-mm", self.z_ideal_mm),
            ("--center-ideal-mm", ox),
            ("--center-ideal-mm", oy),
            ("--c-deg", self.c_deg),
        ] {
            if !v.is_finite() {
                return Err(Error::option(option, "is not finite", "give a number"));
            }
        }
        let fix = "give the standard uncertainty of a touch in mm";
        self.touch_u_mm.map_or(Ok(()), |u| above_zero("--touch-u-mm", u, fix))
    }
}

/// A blank's position from touches without uncertainty.
struct Lie {
    /// A, B, dz, centre x, y.
    values: [f64; 5],
    /// Height at which the centre is told.
    center_z_mm: f64,
    /// The face's sum of squared residuals.
    left_mm2: f64,
}

fn solve(touches: &Touches, options: &Options) -> Result<Lie> {
    let n = touches.face.len() as f64;
    let middle = touches.face.iter().sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> =
        touches.face.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let [least, second, largest] = order;
    let fail = |reason: &str, fix: &str| Err(Error::measure("end face", reason, fix));
    if eigen.eigenvalues[second] < 1e-4 * eigen.eigenvalues[largest]
        || eigen.eigenvalues[largest] < 1e-6
    {
        return fail("the face points lie on a line", "touch points that span a triangle");
    }
    let mut normal = eigen.eigenvectors.column(least).into_owned();
    if normal.z < 0.0 {
        normal = -normal;
    }
    if normal.z < 0.7 {
        return fail(
            "is tilted by more than 45°",
            "check the columns: z is along the face's normal",
        );
    }
    let a = normal.y.atan2(normal.z);
    let b = (-normal.x).atan2(normal.y * a.sin() + normal.z * a.cos());
    let level = leveller(a, b);
    let dz = (level * middle).z - options.z_ideal_mm;
    // Midpoints of the sides touched, by axis.
    let mut middles = Vec::new();
    for (i, side) in touches.sides.iter().enumerate().filter(|(_, s)| !s.is_empty()) {
        let along = |list: &[Vector3<f64>]| range(&list.iter().map(|p| p[i]).collect::<Vec<_>>());
        let (low, high) = along(side);
        let (first, last) = along(&touches.face);
        if high - low < (ONE_SIDE * (last - first)).max(1e-3) {
            let name = if i == 0 { "side_x" } else { "side_y" };
            return Err(Error::measure(
                name,
                format!(
                    "all touches are on one side: {:.3} mm apart, where the end face was touched over {:.1} mm",
                    high - low,
                    last - first
                ),
                "touch the opposite side too",
            ));
        }
        let split = 0.5 * (low + high);
        let mean = |v: Vec<&Vector3<f64>>| v.iter().copied().sum::<Vector3<f64>>() / v.len() as f64;
        let (left, right): (Vec<_>, Vec<_>) = side.iter().partition(|p| p[i] < split);
        middles.push((i, 0.5 * (mean(left) + mean(right))));
    }
    // Sides touched at different heights are brought to one along the tilted axis.
    let mut center = options.center_ideal_mm;
    let center_z_mm = if middles.is_empty() {
        options.z_ideal_mm
    } else {
        middles.iter().map(|(_, m)| m.z).sum::<f64>() / middles.len() as f64
    };
    let axis = level.inverse() * Vector3::z();
    for (i, m) in middles {
        center[i] = m[i] + axis[i] / axis.z * (center_z_mm - m.z);
    }
    Ok(Lie {
        values: [a, b, dz, center[0], center[1]],
        center_z_mm,
        left_mm2: eigen.eigenvalues[least].max(0.0),
    })
}

/// Fits the blank's position; warnings go to `warnings`.
pub fn fit(touches: &Touches, options: &Options, warnings: &mut Vec<String>) -> Result<Alignment> {
    options.check()?;
    warnings.extend(touches.warnings.iter().cloned());
    let lie = solve(touches, options)?;
    let (u_mm, k) = touch_uncertainty(touches, options, lie.left_mm2, warnings);
    let best = lie.values;
    let u95 = standard_uncertainties(touches, options, best, u_mm)?.map(|u| k * u);
    let touched = touches.sides.iter().all(|s| !s.is_empty());
    if !touched {
        let missing = match touches.sides.each_ref().map(Vec::is_empty) {
            [false, _] => "without side_y touches those of side_x are not used and",
            [_, false] => "without side_x touches those of side_y are not used and",
            _ => "without side_x and side_y touches",
        };
        warnings.push(format!("{missing} the blank's axis is taken to be where it should be"));
    }
    Ok(Alignment {
        a_deg: best[0].to_degrees(),
        a_u95_deg: u95[0].to_degrees(),
        b_deg: best[1].to_degrees(),
        b_u95_deg: u95[1].to_degrees(),
        dz_mm: best[2],
        dz_u95_mm: u95[2],
        center_mm: touched.then_some([best[3], best[4]]),
        center_u95_mm: touched.then_some([u95[3], u95[4]]),
        center_z_mm: lie.center_z_mm,
        z_ideal_mm: options.z_ideal_mm,
        center_ideal_mm: options.center_ideal_mm,
        c_deg: options.c_deg,
        touch_u_mm: u_mm,
        face_rms_mm: (lie.left_mm2 / touches.face.len() as f64).sqrt(),
        face_points: touches.face.len(),
    })
}

/// Standard uncertainty of a touch, as given or as the face's points scatter, and its coverage factor for 95 %.
fn touch_uncertainty(
    touches: &Touches,
    options: &Options,
    left_mm2: f64,
    warnings: &mut Vec<String>,
) -> (f64, f64) {
    let dof = touches.face.len() as f64 - 3.0;
    let scatter_mm = (dof >= 1.0).then(|| (left_mm2 / dof).sqrt());
    match (options.touch_u_mm, scatter_mm) {
        (Some(u), scatter) => {
            if scatter.is_some_and(|s| s > 3.0 * u) {
                warnings.push("the face is less flat than the touches are uncertain: its form is not in the intervals".into());
            }
            (u, K95)
        }
        (None, Some(scatter)) => (scatter.max(touches.rounding_mm()), k95(dof)),
        (None, None) => {
            warnings.push(format!(
                "three face points tell nothing of their own uncertainty: {ASSUMED_TOUCH_MM} mm is assumed; give --touch-u-mm \
                 or touch more points"
            ));
            (ASSUMED_TOUCH_MM, K95)
        }
    }
}

/// Standard uncertainties of the values that [`solve`] finds: each touch is uncertain along its own direction, and as effects are
/// small, differences tell the derivatives.
fn standard_uncertainties(
    touches: &Touches,
    options: &Options,
    best: [f64; 5],
    u_mm: f64,
) -> Result<[f64; 5]> {
    const STEP_MM: f64 = 1e-3;
    let mut variance = [0.0; 5];
    let mut add = |moved: &Touches| -> Result<()> {
        let other = solve(moved, options)?.values;
        variance
            .iter_mut()
            .zip(other)
            .zip(best)
            .for_each(|((v, o), b)| *v += ((o - b) / STEP_MM * u_mm).powi(2));
        Ok(())
    };
    for i in 0..touches.face.len() {
        let mut moved = touches.clone();
        moved.face[i].z += STEP_MM;
        add(&moved)?;
    }
    for axis in 0..2 {
        for i in 0..touches.sides[axis].len() {
            let mut moved = touches.clone();
            moved.sides[axis][i][axis] += STEP_MM;
            add(&moved)?;
        }
    }
    Ok(variance.map(f64::sqrt))
}
