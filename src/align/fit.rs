//! Touches of a blank's end face and sides → tilt A, B, height and centre, with uncertainty.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::fit::robust::range;
use crate::input;
use crate::machine::Motion;
use crate::plot::{Figure, Panel};
use crate::repeats;
use crate::table::Table;
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

/// How the blank lies. Angles level the blank: `Ry(B) Rx(A)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Alignment {
    pub a_deg: f64,
    pub a_u95_deg: f64,
    pub b_deg: f64,
    pub b_u95_deg: f64,
    /// Height of the levelled face above the ideal one.
    pub dz_mm: f64,
    pub dz_u95_mm: f64,
    /// Midpoints of the side touches; `null` without them.
    pub center_mm: Option<[f64; 2]>,
    pub center_u95_mm: Option<[f64; 2]>,
    /// Mean height of the side touches.
    pub center_z_mm: f64,
    pub z_ideal_mm: f64,
    pub center_ideal_mm: [f64; 2],
    pub c_deg: f64,
    /// Standard uncertainty of a touch, and the face's form (rms residual).
    pub touch_u_mm: f64,
    pub face_rms_mm: f64,
    pub face_points: usize,
}

/// Touches by kind.
#[derive(Debug, Clone, Default)]
pub struct Touches {
    face: Vec<Vector3<f64>>,
    sides: [Vec<Vector3<f64>>; 2],
    /// What a user should know of the file.
    warnings: Vec<String>,
}

impl Touches {
    /// Reads `kind,x_mm,y_mm,z_mm`.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_table(&Table::read(path, &["kind", "x_mm", "y_mm", "z_mm"], &[])?)
    }

    /// As [`Touches::read`], from a table.
    pub fn from_table(table: &Table) -> Result<Self> {
        let mut touches = Self::default();
        for row in repeats::rows_once(table, &mut touches.warnings) {
            let p = Vector3::new(
                table.number(row, "x_mm")?,
                table.number(row, "y_mm")?,
                table.number(row, "z_mm")?,
            );
            let list = match table.text(row, "kind") {
                "face" => &mut touches.face,
                "side_x" => &mut touches.sides[0],
                "side_y" => &mut touches.sides[1],
                other => {
                    let reason = format!("'{other}' is not known");
                    return Err(table.error(row, "kind", reason, "write face, side_x or side_y"));
                }
            };
            list.push(p);
        }
        if touches.face.len() < 3 {
            let reason = format!("has {} face points", touches.face.len());
            return Err(Error::file(
                table.path(),
                reason,
                "touch the end face at three points or more",
            ));
        }
        for (side, name) in touches.sides.iter().zip(["side_x", "side_y"]) {
            if side.len() == 1 {
                let fix = "touch both opposite sides";
                return Err(Error::file(table.path(), format!("has one {name} point"), fix));
            }
        }
        Ok(touches)
    }

    /// Standard uncertainty of a touch by its last digit alone: readings that agree to it tell no more.
    fn rounding_mm(&self) -> f64 {
        let face = self.face.iter().map(|p| p.z);
        let sides = self.sides.iter().enumerate().flat_map(|(i, s)| s.iter().map(move |p| p[i]));
        let readings: Vec<f64> = face.chain(sides).collect();
        let whole = |steps: f64| (steps - steps.round()).abs() < 1e-4;
        let rounded = |step: &f64| readings.iter().all(|v| whole(v / step));
        COARSE_STEPS_MM.iter().find(|step| rounded(step)).map_or(0.0, |step| step / 12.0f64.sqrt())
    }
}

/// Last digits that readings may have been rounded to. Coarser ones are of round numbers, not of a probe.
const COARSE_STEPS_MM: [f64; 3] = [0.01, 0.001, 0.0001];

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

/// `Ry(B) Rx(A)`.
fn leveller(a_rad: f64, b_rad: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), b_rad)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), a_rad)
}

/// Fits the blank's position; warnings go to `warnings`.
pub fn fit(touches: &Touches, options: &Options, warnings: &mut Vec<String>) -> Result<Alignment> {
    let [ox, oy] = options.center_ideal_mm;
    for (option, v) in [
        ("--z-ideal-mm", options.z_ideal_mm),
        ("--center-ideal-mm", ox),
        ("--center-ideal-mm", oy),
        ("--c-deg", options.c_deg),
    ] {
        if !v.is_finite() {
            return Err(Error::option(option, "is not finite", "give a number"));
        }
    }
    if options.touch_u_mm.is_some_and(|u| !(u.is_finite() && u > 0.0)) {
        return Err(Error::option(
            "--touch-u-mm",
            "is not above 0",
            "give the standard uncertainty of a touch in mm",
        ));
    }
    warnings.extend(touches.warnings.iter().cloned());
    let Lie { values: best, center_z_mm, left_mm2: left } = solve(touches, options)?;
    let dof = touches.face.len() as f64 - 3.0;
    let (u, k) = match options.touch_u_mm {
        Some(u) => (u, K95),
        None if dof >= 1.0 => ((left / dof).sqrt().max(touches.rounding_mm()), k95(dof)),
        None => {
            warnings.push(format!(
                "three face points tell nothing of their own uncertainty: {ASSUMED_TOUCH_MM} mm is assumed; give --touch-u-mm \
                 or touch more points"
            ));
            (ASSUMED_TOUCH_MM, K95)
        }
    };
    if options.touch_u_mm.is_some_and(|u| dof >= 1.0 && (left / dof).sqrt() > 3.0 * u) {
        warnings.push("the face is less flat than the touches are uncertain: its form is not in the intervals".into());
    }
    // Each touch is uncertain along its own direction; effects are small, so differences tell the derivatives.
    let step = 1e-3;
    let mut variance = [0.0; 5];
    let mut add = |moved: &Touches| -> Result<()> {
        let other = solve(moved, options)?.values;
        variance
            .iter_mut()
            .zip(other)
            .zip(best)
            .for_each(|((v, o), b)| *v += ((o - b) / step * u).powi(2));
        Ok(())
    };
    for i in 0..touches.face.len() {
        let mut moved = touches.clone();
        moved.face[i].z += step;
        add(&moved)?;
    }
    for axis in 0..2 {
        for i in 0..touches.sides[axis].len() {
            let mut moved = touches.clone();
            moved.sides[axis][i][axis] += step;
            add(&moved)?;
        }
    }
    let u95 = variance.map(|v| k * v.sqrt());
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
        center_z_mm,
        z_ideal_mm: options.z_ideal_mm,
        center_ideal_mm: options.center_ideal_mm,
        c_deg: options.c_deg,
        touch_u_mm: u,
        face_rms_mm: (left / touches.face.len() as f64).sqrt(),
        face_points: touches.face.len(),
    })
}

impl Alignment {
    /// Reads the JSON result of `align`.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let text = input::text(path, input::MOST_SETTINGS)?;
        let fail =
            |reason: String| Error::file(path, reason, "give the result of `align --format json`");
        let mut json: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(&text).map_err(|e| fail(format!("is no JSON object ({e})")))?;
        if json.get("schema").and_then(|s| s.as_str()) != Some("pivotsight.align/1") {
            return Err(fail("is no alignment".into()));
        }
        json.retain(|k, _| {
            !["schema", "version", "input", "warnings"].contains(&k.as_str())
                && !k.starts_with("x_")
                && !k.starts_with("x-")
        });
        let alignment: Self =
            serde_json::from_value(json.into()).map_err(|e| fail(e.to_string()))?;
        if alignment.a_deg.abs() > 45.0 || alignment.b_deg.abs() > 45.0 {
            return Err(fail("tilts the blank by more than 45°".into()));
        }
        Ok(alignment)
    }

    /// From the programmed path to the path on the blank: `p' = (Ry(B) Rx(A))⁻¹ (o + Rz(C) (p - o) + t)`, where `o` is the ideal
    /// axis and `t` brings axis and face of the levelled blank to where they are.
    pub fn motion(&self) -> Motion {
        let level = leveller(self.a_deg.to_radians(), self.b_deg.to_radians());
        let [ox, oy] = self.center_ideal_mm;
        let axis = match self.center_mm {
            Some([x, y]) => level * Vector3::new(x, y, self.center_z_mm),
            None => Vector3::new(ox, oy, 0.0),
        };
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), self.c_deg.to_radians());
        let ideal = Vector3::new(ox, oy, 0.0);
        let t = Vector3::new(axis.x, axis.y, self.dz_mm) - turn * ideal;
        let back = level.inverse();
        Motion::from_parts(Translation3::from(back * t), back * turn)
    }

    /// A map of the touches and the face's residuals.
    pub fn figure(&self, touches: &Touches) -> Figure {
        let level = leveller(self.a_deg.to_radians(), self.b_deg.to_radians());
        let height = self.dz_mm + self.z_ideal_mm;
        let residuals: Vec<_> = touches
            .face
            .iter()
            .enumerate()
            .map(|(i, p)| (i as f64 + 1.0, (level * p).z - height, K95 * self.touch_u_mm))
            .collect();
        let flat =
            |points: &[Vector3<f64>]| -> Vec<_> { points.iter().map(|p| (p.x, p.y)).collect() };
        let sides: Vec<Vector3<f64>> = touches.sides.concat();
        let map = Panel::new("x, mm", "y, mm").title("Touches").equal_scale();
        let map = map.points("face", &flat(&touches.face)).points("sides", &flat(&sides));
        let map = match self.center_mm {
            Some([x, y]) => map.points("centre", &[(x, y)]),
            None => map,
        };
        let face = Panel::new("face point", "height over the plane, mm").title("Face, levelled");
        Figure::new("Blank")
            .columns(2)
            .panel(map)
            .panel(face.points_with_bars("±95 % of a touch", &residuals))
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let mut out = format!(
            "A {:+.5}° ±{:.5}°, B {:+.5}° ±{:.5}° level the blank; its face is {:+.4} ±{:.4} mm above the ideal\n",
            self.a_deg, self.a_u95_deg, self.b_deg, self.b_u95_deg, self.dz_mm, self.dz_u95_mm
        );
        if let Some(([x, y], [ux, uy])) = self.center_mm.zip(self.center_u95_mm) {
            out.push_str(&format!("centre X {x:+.4} ±{ux:.4} mm, Y {y:+.4} ±{uy:.4} mm\n"));
        }
        out.push_str(&format!(
            "{} face points, flat to {:.4} mm rms\n",
            self.face_points, self.face_rms_mm
        ));
        out
    }
}
