//! Touches of a blank's end face and sides → tilt A, B, height and centre, with uncertainty.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};

use super::alignment::{Alignment, leveller};
use super::touches::Touches;
use crate::error::{Error, Result, above_zero};
use crate::fit::robust::range;
use crate::uncertainty::{K95, distance, k95, rounding_mm, scatters_more};

/// Standard uncertainty of a touch where neither the data nor the user tells it.
const ASSUMED_TOUCH_MM: f64 = 0.002;
/// Degrees of freedom below which touches may agree by chance.
const FEW: f64 = 3.0;
/// A probe that repeats to less is not believed on the word of few touches.
const LEAST_OF_FEW_MM: f64 = 0.0005;
/// Opposite sides lie farther apart than this part of what the end face was touched over.
const ONE_SIDE: f64 = 0.05;

/// Lengths in mm and angles in degrees lie below.
const MOST: f64 = 1e6;

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
            if !(v.is_finite() && v.abs() < MOST) {
                return Err(Error::option(option, "is beyond any machine", "give mm or degrees"));
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

/// Faces that are touched are flatter than this, standard deviation.
const ROUGH_MM: f64 = 0.2;

/// Fits the blank's position; warnings go to `warnings`.
pub fn fit(touches: &Touches, options: &Options, warnings: &mut Vec<String>) -> Result<Alignment> {
    options.check()?;
    warnings.extend(touches.warnings.iter().cloned());
    let lie = solve(touches, options)?;
    let touch = touch(touches, options, lie.left_mm2, warnings);
    let best = lie.values;
    let u95 = u95(touches, options, best, &touch)?;
    let touched = touches.sides.iter().all(|s| !s.is_empty());
    if !touched {
        let missing = match touches.sides.each_ref().map(Vec::is_empty) {
            [false, _] => "without side_y touches those of side_x are not used and",
            [_, false] => "without side_x touches those of side_y are not used and",
            _ => "without side_x and side_y touches",
        };
        warnings.push(format!("{missing} the blank's axis is taken to be where it should be"));
    }
    let turns = Matrix2::from_diagonal(&Vector2::new(u95[0], u95[1]).map(|u| (u / K95).powi(2)));
    let (_, tilt_u95) = distance(Vector2::new(best[0], best[1]), turns, f64::INFINITY);
    Ok(Alignment {
        tilt_deg: (best[0].cos() * best[1].cos()).acos().to_degrees(),
        tilt_u95_deg: tilt_u95.to_degrees(),
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
        touch_u_mm: touch.u_mm,
        face_rms_mm: (lie.left_mm2 / touches.face.len() as f64).sqrt(),
        face_points: touches.face.len(),
    })
}

/// How touches scatter about what they should lie on.
#[derive(Clone, Copy)]
struct Scatter {
    sd_mm: f64,
    dof: f64,
}

impl Scatter {
    fn of(left_mm2: f64, dof: usize) -> Option<Self> {
        (dof > 0).then(|| Self { sd_mm: (left_mm2 / dof as f64).sqrt(), dof: dof as f64 })
    }

    fn u95_mm(self) -> f64 {
        k95(self.dof) * self.sd_mm
    }
}

/// How the touches of the sides scatter: opposite sides are parallel planes, turned as they like.
fn sides_scatter(touches: &Touches) -> Option<Scatter> {
    let (mut left_mm2, mut dof) = (0.0, 0);
    for (i, side) in touches.sides.iter().enumerate().filter(|(_, s)| s.len() > 2) {
        let (low, high) = range(&side.iter().map(|p| p[i]).collect::<Vec<_>>());
        let middle = side.iter().sum::<Vector3<f64>>() / side.len() as f64;
        let mut design = DMatrix::zeros(side.len(), 4);
        for (k, p) in side.iter().enumerate() {
            design[(k, usize::from(p[i] < 0.5 * (low + high)))] = 1.0;
            design[(k, 2)] = p[1 - i] - middle[1 - i];
            design[(k, 3)] = p.z - middle.z;
        }
        let read = DVector::from_iterator(side.len(), side.iter().map(|p| p[i] - middle[i]));
        // Touches at one height, or in one line, tell no turn.
        let svd = design.clone().svd(true, true);
        let least = 1e-6 * svd.singular_values.max();
        let Ok(fitted) = svd.solve(&read, least) else { continue };
        left_mm2 += (&read - design * fitted).norm_squared();
        dof += side.len() - svd.rank(least).min(side.len());
    }
    Scatter::of(left_mm2, dof)
}

/// Half-widths of the 95 % intervals of a touch.
struct Touch {
    /// Its standard uncertainty, as given or as the face's points scatter.
    u_mm: f64,
    face_u95_mm: f64,
    sides_u95_mm: f64,
    /// Of the last digit, which touches that read the same have in common; none where the probe scatters over it.
    digit_u95_mm: f64,
}

fn touch(touches: &Touches, options: &Options, left_mm2: f64, warnings: &mut Vec<String>) -> Touch {
    let face = Scatter::of(left_mm2, touches.face.len().saturating_sub(3));
    if let Some(Scatter { sd_mm, .. }) = face.filter(|face| face.sd_mm > ROUGH_MM) {
        warnings.push(format!(
            "the face's touches lie {sd_mm:.3} mm (standard deviation) off their plane: a reading, its sign or its unit may be wrong; look at the \
             farthest before the path is moved"
        ));
    }
    let sides = sides_scatter(touches);
    if let Some(u_mm) = options.touch_u_mm {
        for (what, scatter) in [("face", face), ("sides", sides)] {
            let Some(Scatter { sd_mm, dof }) = scatter else { continue };
            if scatters_more(sd_mm, dof, u_mm) {
                warnings.push(format!(
                    "the touches of the {what} scatter by {sd_mm:.4} mm, more than --touch-u-mm says: the intervals do not hold \
                     its form, or the probe is less certain"
                ));
            }
        }
        return Touch {
            u_mm,
            face_u95_mm: K95 * u_mm,
            sides_u95_mm: K95 * u_mm,
            digit_u95_mm: 0.0,
        };
    }
    let least_mm = rounding_mm(&touches.readings_mm());
    // Half a digit of scatter makes roundings as good as independent.
    let scatters = face.is_some_and(|s| s.sd_mm > 3f64.sqrt() * least_mm);
    let digit_u95_mm = if scatters { 0.0 } else { K95 * least_mm };
    let known = |s: Scatter| {
        let few_mm = if s.dof < FEW { LEAST_OF_FEW_MM } else { 0.0 };
        Scatter { sd_mm: s.sd_mm.max(least_mm).max(few_mm), ..s }
    };
    let (u_mm, face_u95_mm) = match face.map(known) {
        Some(face) => (face.sd_mm, face.u95_mm()),
        None => {
            warnings.push(format!(
                "three face points tell nothing of their own uncertainty: {ASSUMED_TOUCH_MM} mm is assumed; give --touch-u-mm \
                 or touch more points"
            ));
            (ASSUMED_TOUCH_MM, K95 * ASSUMED_TOUCH_MM)
        }
    };
    // Sides may be rougher than the face; that they look smoother is not believed.
    let tell = |s: &Scatter| s.dof >= FEW || scatters_more(s.sd_mm, s.dof, u_mm);
    let own_mm = sides.filter(tell).map_or(0.0, Scatter::u95_mm);
    Touch { u_mm, face_u95_mm, sides_u95_mm: face_u95_mm.max(own_mm), digit_u95_mm }
}

/// Touches that err together, and the half-width of that: each by itself, and those that read the same by their digit.
fn together(readings_mm: &[f64], own_u95_mm: f64, digit_u95_mm: f64) -> Vec<(Vec<usize>, f64)> {
    let mut order: Vec<usize> = (0..readings_mm.len()).collect();
    let own = order.iter().map(|&i| (vec![i], own_u95_mm)).collect::<Vec<_>>();
    order.sort_by(|&i, &k| readings_mm[i].total_cmp(&readings_mm[k]));
    let alike = order.chunk_by(|&i, &k| readings_mm[i] == readings_mm[k]);
    let alike = alike.filter(|group| group.len() > 1 && digit_u95_mm > 0.0);
    own.into_iter().chain(alike.map(|group| (group.to_vec(), digit_u95_mm))).collect()
}

/// Half-widths of the 95 % intervals of the values that [`solve`] finds: each touch is uncertain along its own direction, and as effects are
/// small, differences tell the derivatives.
fn u95(touches: &Touches, options: &Options, best: [f64; 5], touch: &Touch) -> Result<[f64; 5]> {
    const STEP_MM: f64 = 1e-3;
    let mut squared = [0.0; 5];
    let mut add = |moved: &Touches, u95_mm: f64| -> Result<()> {
        let other = solve(moved, options)?.values;
        squared
            .iter_mut()
            .zip(other)
            .zip(best)
            .for_each(|((v, o), b)| *v += ((o - b) / STEP_MM * u95_mm).powi(2));
        Ok(())
    };
    let read: Vec<f64> = touches.face.iter().map(|p| p.z).collect();
    for (group, u95_mm) in together(&read, touch.face_u95_mm, touch.digit_u95_mm) {
        let mut moved = touches.clone();
        group.iter().for_each(|&i| moved.face[i].z += STEP_MM);
        add(&moved, u95_mm)?;
    }
    for axis in 0..2 {
        let read: Vec<f64> = touches.sides[axis].iter().map(|p| p[axis]).collect();
        for (group, u95_mm) in together(&read, touch.sides_u95_mm, touch.digit_u95_mm) {
            let mut moved = touches.clone();
            group.iter().for_each(|&i| moved.sides[axis][i][axis] += STEP_MM);
            add(&moved, u95_mm)?;
        }
    }
    Ok(squared.map(f64::sqrt))
}
