//! The rod's rim from points that were aimed at by hand: crosshair or probe on the rim, the machine's X and Y read off, no pictures.

use nalgebra::{DMatrix, DVector, Vector2};

use super::axis::{IN_PLACE, Known};
use super::captures::table_angles;
use super::finish::{ONE_ANGLE, centers, find_axis, rod_centers, take_nominal};
use super::{Options, Report};
use crate::camera::Laser;
use crate::error::{Error, Result};
use crate::fit::circle::taubin;
use crate::fit::least_squares::{self, Solution};
use crate::table::Table;
use crate::uncertainty::{self, K95, budget, k95, scatters_more};
use crate::{repeats, units};

/// How surely a rim is aimed at where nothing tells it, mm.
const USUAL_AIM_MM: f64 = 0.01;
/// Degrees of freedom from which the points' own scatter tells it, and those that what is usual counts for below.
const LEAST_DOF: f64 = 3.0;
const USUAL_DOF: f64 = 2.0;

/// A point of the rim in machine coordinates.
#[derive(Debug, Clone, Copy)]
pub struct RimPoint {
    /// The machine's X and Y with the aim on the rim.
    pub position_mm: Vector2<f64>,
    /// Table angle.
    pub c_deg: f64,
}

/// The columns of a table of points: required, optional.
pub(super) const COLUMNS: (&[&str], &[&str]) = (&["x_mm", "y_mm"], &["c_deg"]);

/// The points of a table. Rows that stand twice count once, with a warning.
pub(super) fn from_table(mut table: Table, warnings: &mut Vec<String>) -> Result<Vec<RimPoint>> {
    let rows = repeats::rows_once(&table, warnings);
    table.keep(&rows);
    let (x, y) = (table.column("x_mm")?, table.column("y_mm")?);
    let c = table.optional_column("c_deg")?.unwrap_or_else(|| vec![0.0; x.len()]);
    warnings.extend(units::angles("c_deg", &c));
    let point = |i: usize| RimPoint { position_mm: Vector2::new(x[i], y[i]), c_deg: c[i] };
    Ok((0..x.len()).map(point).collect())
}

/// The rod from at least three points of its rim at each table angle; `aim_u_mm` is the standard uncertainty of one.
///
/// # Errors
/// Fewer points, or points on too short an arc to tell a circle.
pub fn measure_points(
    points: &[RimPoint],
    aim_u_mm: Option<f64>,
    laser: Option<&Laser>,
    options: &Options,
) -> Result<Report> {
    super::check(options)?;
    let (c_deg, angle_of) = table_angles(points.iter().map(|p| p.c_deg));
    let mut warnings = Vec::new();
    let solved = circles(points, &c_deg, &angle_of)?;
    let (aim_mm, dof) = aim(&solved, aim_u_mm, &mut warnings);
    let n = solved.parameters.len();
    let mut rod = Known {
        values: solved.parameters.clone(),
        covariance: &solved.covariance * (aim_mm * aim_mm),
        gain: DMatrix::identity(n, n),
    };
    let mut axis = match c_deg.len() {
        1 => None,
        angles => {
            let seen = centers(&rod, angles);
            find_axis(&rod, &seen, &c_deg, options, IN_PLACE[1], &mut warnings)?
        }
    };
    if let Some(axis) = &axis {
        rod.take_radius(&axis.known);
    }
    let mut all = vec![&mut rod];
    all.extend(axis.as_mut().map(|axis| &mut axis.known));
    let nominal = take_nominal(&mut all, options, &mut warnings);
    let k = k95(dof);
    let rod_centers = rod_centers(&rod, axis.as_ref(), &c_deg, dof);
    let (axis_center_mm, axis_center_u95_mm) = match &axis {
        Some(axis) => {
            let u95 =
                |i| k95(axis.dof_of(i).min(dof)) * axis.known.covariance[(i, i)].max(0.0).sqrt();
            (axis.known.pair(0).into(), [0, 1].map(u95))
        }
        None => {
            warnings.push(ONE_ANGLE.to_owned());
            (rod_centers[0].center_mm, rod_centers[0].center_u95_mm)
        }
    };
    warnings.extend(units::rod("the rod's diameter", 2.0 * rod.radius()));
    let diameter_u95_mm = 2.0 * k * rod.radius_variance().max(0.0).sqrt();
    let [x, y] = axis_center_u95_mm;
    let source = nominal.map_or("aiming at the rim", |_| "aiming at the rim, nominal diameter");
    let mut parts = budget("axis_center_mm", [(source, (0.5 * (x * x + y * y)).sqrt() / K95)]);
    parts.extend(budget("diameter_mm", [(source, diameter_u95_mm / K95)]));
    let eccentricity = axis.as_ref().map(|a| {
        let (length, u95) = (a.known.pair(2).norm(), a.known.pair_covariance(2));
        (length, uncertainty::distance(a.known.pair(2), u95, dof).1)
    });
    let mut report = Report {
        rod_centers,
        axis_center_mm,
        axis_center_u95_mm,
        eccentricity_mm: eccentricity.map(|e| e.0),
        eccentricity_u95_mm: eccentricity.map(|e| e.1),
        axis_separated: axis.is_some(),
        diameter_mm: 2.0 * rod.radius(),
        diameter_u95_mm,
        form_rms_mm: (solved.chi2() / points.len() as f64).sqrt(),
        position_scatter_mm: 0.0,
        captures: Vec::new(),
        budget: parts,
        warnings,
    };
    if let Some(laser) = laser {
        report.refer_to_laser(laser);
    }
    Ok(report)
}

/// The circles through the points of every table angle, of one radius, by least squares: centres, then the radius.
fn circles(points: &[RimPoint], c_deg: &[f64], angle_of: &[usize]) -> Result<Solution> {
    let angles = c_deg.len();
    let mut start = DVector::zeros(2 * angles + 1);
    for (a, c) in c_deg.iter().enumerate() {
        let own = points.iter().zip(angle_of).filter(|(_, of)| **of == a);
        let own: Vec<Vector2<f64>> = own.map(|(p, _)| p.position_mm).collect();
        let circle = taubin(&own, &vec![1.0; own.len()]).ok_or_else(|| {
            Error::measure(
                format!("C = {c}°"),
                format!("{} points of the rim make no circle", own.len()),
                "aim at three points at least, well apart all round",
            )
        })?;
        start.fixed_rows_mut::<2>(2 * a).copy_from(&circle.center);
        start[2 * angles] += circle.radius / angles as f64;
    }
    let solved = least_squares::solve(start, least_squares::Options::default(), |v| {
        let mut left = DVector::zeros(points.len());
        let mut jacobian = DMatrix::zeros(points.len(), v.len());
        for (row, (p, a)) in points.iter().zip(angle_of).enumerate() {
            let away: Vector2<f64> = p.position_mm - v.fixed_rows::<2>(2 * a);
            let distance = away.norm().max(f64::MIN_POSITIVE);
            left[row] = distance - v[2 * angles];
            let toward = away / -distance;
            jacobian[(row, 2 * a)] = toward.x;
            jacobian[(row, 2 * a + 1)] = toward.y;
            jacobian[(row, 2 * angles)] = -1.0;
        }
        (left, || jacobian)
    });
    if solved.rank < solved.parameters.len() || !solved.converged {
        let fix = "aim at points well apart all round the rim";
        return Err(Error::measure("the points", "tell no circle", fix));
    }
    Ok(solved)
}

/// The standard uncertainty of a point, and its degrees of freedom: as told, as the points scatter, or as is usual.
fn aim(solved: &Solution, told_mm: Option<f64>, warnings: &mut Vec<String>) -> (f64, f64) {
    let dof = solved.dof() as f64;
    let seen_mm = (solved.chi2() / dof.max(1.0)).sqrt();
    match told_mm {
        Some(told_mm) => {
            if dof > 0.0 && scatters_more(seen_mm, dof, told_mm) {
                warnings.push(format!(
                    "the points scatter by {seen_mm:.4} mm about the rim, more than --aim-u-mm says: the interval is too narrow"
                ));
            }
            (told_mm, f64::INFINITY)
        }
        None if dof >= LEAST_DOF && seen_mm > 0.0 => (seen_mm, dof),
        // Few tell it badly: what is usual counts as some more of them.
        None if dof > 0.0 => {
            let squares = USUAL_DOF * USUAL_AIM_MM.powi(2) + dof * seen_mm * seen_mm;
            let aim_mm = (squares / (USUAL_DOF + dof)).sqrt();
            warnings.push(format!(
                "few points tell how surely the rim was aimed at: with {USUAL_AIM_MM} mm, which is usual, {aim_mm:.4} mm is taken; give more, or --aim-u-mm"
            ));
            (aim_mm, USUAL_DOF + dof)
        }
        None => {
            warnings.push(format!(
                "nothing tells how surely the rim was aimed at: {USUAL_AIM_MM} mm is taken; give --aim-u-mm, or more points"
            ));
            (USUAL_AIM_MM, f64::INFINITY)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Aims that scatter by 5 µm, told or not, at one table angle and at several, all round and over a part: the truth is within what is stated.
    #[test]
    fn the_axis_is_within_its_interval() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let axis = Vector2::new(412.3, -87.6);
        for (angles, count, span_deg, told, nominal) in [
            (1, 3, 360.0, Some(0.005), None),
            (1, 8, 360.0, None, None),
            (1, 3, 150.0, Some(0.005), Some(20.0)),
            (4, 4, 360.0, None, None),
            (3, 3, 360.0, Some(0.005), Some(20.0)),
            (1, 5, 360.0, None, None),
            (3, 3, 360.0, None, None),
        ] {
            let eccentric = if angles > 1 { 0.05 } else { 0.0 };
            let options =
                Options { diameter_mm: nominal, diameter_u_mm: 0.001, ..Options::default() };
            let (mut within, mut all) = (0, 0);
            for _ in 0..200 {
                let mut points = Vec::new();
                for a in 0..angles {
                    let c_deg = 360.0 / f64::from(angles) * f64::from(a) + 7.0;
                    let (s, c) = (c_deg + 20.0).to_radians().sin_cos();
                    let center = axis + eccentric * Vector2::new(c, s);
                    for i in 0..count {
                        let at = span_deg / f64::from(count) * f64::from(i);
                        let (s, c) = at.to_radians().sin_cos();
                        let noise = 0.005 * Vector2::new(normal(), normal());
                        let position_mm = center + 10.0 * Vector2::new(c, s) + noise;
                        points.push(RimPoint { position_mm, c_deg });
                    }
                }
                let report = measure_points(&points, told, None, &options).unwrap();
                for k in 0..2 {
                    let off = report.axis_center_mm[k] - axis[k];
                    within += usize::from(off.abs() <= report.axis_center_u95_mm[k]);
                    all += 1;
                }
                assert_eq!(report.axis_separated, angles > 1);
            }
            let share = f64::from(within as u32) / f64::from(all);
            assert!((0.92..=1.0).contains(&share), "{angles} angles, {count} points: {share}");
        }
    }

    #[test]
    fn too_few_points_and_points_on_a_line_are_refused() {
        let at = |x: f64, y: f64| RimPoint { position_mm: Vector2::new(x, y), c_deg: 0.0 };
        let refused = |points: &[RimPoint]| {
            measure_points(points, None, None, &Options::default()).unwrap_err().to_string()
        };
        assert!(refused(&[at(0.0, 0.0), at(1.0, 0.0)]).contains("three points at least"));
        refused(&[at(0.0, 0.0), at(1.0, 0.0), at(2.0, 0.0)]);
    }
}
