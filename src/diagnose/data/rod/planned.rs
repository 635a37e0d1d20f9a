//! Captures that could be taken of a rod: where, and what of its rim the picture would show.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use nalgebra::Vector2;

use super::{COLUMNS, Rod};
use crate::camera::{Calibration, View};
use crate::error::{Error, Result};
use crate::table::Table;

/// So many directions, evenly spread round a turn.
fn round(count: usize) -> impl Iterator<Item = Vector2<f64>> {
    (0..count).map(move |k| {
        let (s, c) = (TAU * k as f64 / count as f64).sin_cos();
        Vector2::new(c, s)
    })
}

/// Directions from `pole` in which a capture from `place` sees the rim, evenly spread: a few dozen at most.
fn seen(view: &View, pole: Vector2<f64>, radius: f64, place: Vector2<f64>) -> Vec<Vector2<f64>> {
    /// Directions looked in.
    const ROUND: usize = 240;
    /// Points kept of a capture.
    const POINTS: usize = 24;
    let inside = |at: f64, size: usize| (-0.5..=size as f64 - 0.5).contains(&at);
    let is_seen = |ray: &Vector2<f64>| {
        let offset = pole + ray * radius - place;
        let px = view.to_pixel(offset);
        // A lens that is described far beyond its frame may fold back into it.
        let is_there = (view.to_plane(px) - offset).norm() < 1e-3 * radius;
        is_there && inside(px.x, view.width_px()) && inside(px.y, view.height_px())
    };
    let all: Vec<Vector2<f64>> = round(ROUND).filter(is_seen).collect();
    all.iter().step_by(all.len().div_ceil(POINTS).max(1)).copied().collect()
}

/// A plan of captures, a row each, as the edge points that they would show of a rod on the C axis.
///
/// # Errors
/// A calibration that does not know the frame's size; a capture that would not see the rim.
pub fn edge_points(
    plan: &Table,
    calibration: &Calibration,
    centre: Vector2<f64>,
    diameter_mm: f64,
) -> Result<Table> {
    let (width, height) = calibration.lens_size().ok_or_else(|| {
        Error::option(
            "--calib",
            "is a plain scale, which does not say how large the pictures are: what of the rim they show is not known",
            "calibrate the camera with its lens ('pivotsight calib camera'), or give a plan with edge points (u_px, v_px)",
        )
    })?;
    let view = calibration.view(width, height)?;
    let kept = COLUMNS.1.iter().copied().filter(|name| plan.has(name));
    let names: Vec<&str> = ["x_mm", "y_mm"].into_iter().chain(kept).collect();
    let mut csv = format!("capture,{},u_px,v_px\n", names.join(","));
    for row in 0..plan.rows() {
        let place = Vector2::new(plan.number(row, "x_mm")?, plan.number(row, "y_mm")?);
        let rays = seen(&view, centre, 0.5 * diameter_mm, place);
        if rays.is_empty() {
            return Err(plan.error(
                row,
                "x_mm",
                format!(
                    "from ({}, {}) mm the camera does not see the rim of a rod of {diameter_mm} mm at ({}, {}) mm",
                    place.x, place.y, centre.x, centre.y
                ),
                "check the place, --diameter-mm and the model's [table] xc_mm, yc_mm",
            ));
        }
        let settings = names.iter().map(|name| plan.text(row, name)).collect::<Vec<_>>().join(",");
        for ray in rays {
            let px = view.to_pixel(centre + ray * (0.5 * diameter_mm) - place);
            // Writing to a string cannot fail.
            let _ = writeln!(csv, "{},{settings},{},{}", row + 1, px.x, px.y);
        }
    }
    Table::parse(plan.path(), csv, &[], &["*"])
}

impl Rod {
    /// Directions from the pole in which a capture from this place sees the rim.
    pub(super) fn seen(&self, place: Vector2<f64>, radius: f64) -> Vec<Vector2<f64>> {
        seen(&self.view, self.pole, radius, place)
    }

    /// Places of planned captures: about the rod where the picture holds its whole rim, else along the rim, which is to be seen in the
    /// middle of the frame and towards its sides.
    pub(super) fn planned_places(&self, radius: f64) -> Vec<Vector2<f64>> {
        /// Directions in which the rim is looked at.
        const DIRECTIONS: usize = 8;
        /// Where it lies in the frame, in parts of its height.
        const HEIGHTS: [f64; 3] = [-0.3, 0.0, 0.3];
        let height_mm = self.view.pixel_mm() * self.view.height_px() as f64;
        if 2.0 * radius < height_mm {
            let reach = Vector2::new(0, 1).map(|axis| 0.5 * self.travel_mm(axis).max(1.0));
            let steps = [-1.0, 0.0, 1.0];
            let grid = steps.iter().flat_map(|x| steps.map(|y| Vector2::new(*x, y)));
            return grid.map(|step| self.pole + step.component_mul(&reach)).collect();
        }
        let places = round(DIRECTIONS).flat_map(|towards| {
            HEIGHTS.map(|part| self.pole + towards * (radius + part * height_mm))
        });
        places.collect()
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use crate::camera::Calibration;
    use crate::diagnose::data::rod::{COLUMNS, RodExperiment};
    use crate::diagnose::experiment::Experiment;
    use crate::table::Table;

    /// Short arcs of a rod larger than the frame: wherever a capture is proposed, it sees the rim.
    #[test]
    fn proposals_show_the_rim_of_a_rod_that_no_frame_holds() {
        let mut csv = String::from("capture,x_mm,y_mm,c_deg,u_px,v_px\n");
        for k in 0..12 {
            let around = f64::from(k) * 30.0;
            let at = |deg: f64| [12.0 * deg.to_radians().cos(), 12.0 * deg.to_radians().sin()];
            let [x, y] = at(around);
            for p in 0..9 {
                let [ex, ey] = at(around + f64::from(p) - 4.0);
                let (u, v) = (799.5 + (ex - x) / 0.005, 599.5 - (ey - y) / 0.005);
                writeln!(csv, "{k},{},{},{around},{u:.3},{v:.3}", 40.0 + x, y - 70.0).unwrap();
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let [data, calib] = ["data.csv", "calib.toml"].map(|name| folder.path().join(name));
        std::fs::write(&data, csv).unwrap();
        let camera = "schema = 1\nname = 'c'\n[camera]\nwidth_px = 1600\nheight_px = 1200\nfx_px = 4000.0\nfy_px = 4000.0\n\
                      cx_px = 799.5\ncy_px = 599.5\ndistortion = [0.05, 0.0, 0.0, 0.0, 0.0]\n[plane]\n\
                      homography_mm = [[20.0, 0.0, 0.0], [0.0, -20.0, 0.0], [0.0, 0.0, 1.0]]\n";
        std::fs::write(&calib, camera).unwrap();
        let table = Table::read(&data, COLUMNS.0, COLUMNS.1).unwrap();
        let calibration = Calibration::read(&calib).unwrap();
        let rod = RodExperiment::from_table(&table, &calibration, None, &mut Vec::new()).unwrap();
        let plan = rod.proposals().swap_remove(0);
        let planned = rod.with_plan(&plan);
        let mut points = vec![0; 12 + plan.len()];
        planned.layout().groups.iter().for_each(|g| points[*g] += 1);
        assert!(plan.len() > 50 && points.iter().all(|n| *n >= 8), "{points:?}");
        assert!(planned.layout().values.len() < 9 * 12 + 25 * plan.len());
    }
}
