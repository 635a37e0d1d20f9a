//! Captures that could be taken of a rod: where, and what of its rim the picture would show.

use std::f64::consts::TAU;

use nalgebra::Vector2;

use super::Rod;

/// So many directions, evenly spread round a turn.
fn round(count: usize) -> impl Iterator<Item = Vector2<f64>> {
    (0..count).map(move |k| {
        let (s, c) = (TAU * k as f64 / count as f64).sin_cos();
        Vector2::new(c, s)
    })
}

impl Rod {
    /// Directions from the pole in which a capture from this place sees the rim, evenly spread: a few dozen at most.
    pub(super) fn seen(&self, place: Vector2<f64>, radius: f64) -> Vec<Vector2<f64>> {
        /// Directions looked in.
        const ROUND: usize = 240;
        /// Points kept of a capture.
        const POINTS: usize = 24;
        let inside = |at: f64, size: usize| (0.0..size as f64).contains(&at);
        let is_seen = |ray: &Vector2<f64>| {
            let offset = self.pole + ray * radius - place;
            let px = self.view.to_pixel(offset);
            // A lens that is described far beyond its frame may fold back into it.
            let is_there = (self.view.to_plane(px) - offset).norm() < 1e-3 * radius;
            is_there && inside(px.x, self.view.width_px()) && inside(px.y, self.view.height_px())
        };
        let all: Vec<Vector2<f64>> = round(ROUND).filter(is_seen).collect();
        all.iter().step_by(all.len().div_ceil(POINTS).max(1)).copied().collect()
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
        let plan = rod.proposals();
        let planned = rod.with_plan(&plan);
        let mut points = vec![0; 12 + plan.len()];
        planned.layout().groups.iter().for_each(|g| points[*g] += 1);
        assert!(plan.len() > 50 && points.iter().all(|n| *n >= 8), "{points:?}");
        assert!(planned.layout().values.len() < 9 * 12 + 25 * plan.len());
    }
}
