//! A ball bar path that the data lack, over the cup where it stands: X moves with B where Z did, or the other way round.

use nalgebra::Vector3;

use crate::ballbar::{Kind, Path};
use crate::diagnose::data::ballbar::{of_cup, turned};
use crate::diagnose::data::columns::Columns;
use crate::diagnose::data::cups::Cup;
use crate::diagnose::data::evenly;
use crate::diagnose::experiment::{Parameter, PlannedCapture, Setting};
use crate::fit::robust::range;

/// A path beside those of the data.
#[derive(Debug, Clone)]
pub struct OtherPath {
    kind: Kind,
    head: Vector3<f64>,
    cup: Cup,
    /// Which way the data count Z: up 1, down -1.
    z_sense: f64,
}

impl OtherPath {
    /// With X moving where only Z did, or the other way round; none where both have.
    pub fn of(data: &Columns) -> Option<Self> {
        let first = data.cups.first()?;
        let moves = |name: &str| {
            (0..data.cups.len()).any(|path| !data.stands_still(name, &data.rows_of(path)))
        };
        let kind = match (moves("x_mm"), moves("z_mm")) {
            (false, true) => Kind::Xb,
            (true, false) => Kind::Zb,
            _ => return None,
        };
        Some(Self { kind, head: data.head, cup: *first, z_sense: data.z_sense })
    }

    fn name(&self) -> String {
        Path { kind: self.kind, cup_y_mm: self.cup.place_mm.y.round(), ..Path::SOURCE }.name()
    }

    /// A sweep of it over the angles of the data, as far as the bar reaches; there and back where the data go both ways.
    pub fn sweep(&self, data: &Columns) -> Vec<PlannedCapture> {
        /// Rows each way: as many as the data have, within this.
        const ROWS: (usize, usize) = (31, 181);
        let (low, high) = range(data.get("b_deg"));
        let dirs: &[Option<f64>] = match data.get("dir") {
            [] => &[None],
            _ => &[Some(1.0), Some(-1.0)],
        };
        let rows = data.series.len() / (dirs.len() * data.cups.len());
        let angles = evenly(low, high, rows.clamp(ROWS.0, ROWS.1));
        let one_way = |dir: &Option<f64>| {
            let mut list: Vec<PlannedCapture> =
                angles.iter().filter_map(|b_deg| self.capture(*b_deg, *dir)).collect();
            if *dir == Some(-1.0) {
                list.reverse();
            }
            list
        };
        dirs.iter().flat_map(one_way).collect()
    }

    /// The capture at an angle; none where the bar reaches its end.
    fn capture(&self, b_deg: f64, dir: Option<f64>) -> Option<PlannedCapture> {
        let [x_mm, z_mm] = self.place(b_deg)?;
        let mut capture = PlannedCapture::default()
            .with("b_deg", b_deg)
            .with("x_mm", x_mm)
            .with("z_mm", self.z_sense * z_mm);
        capture.0.insert("path", Setting::Name(self.name()));
        Some(match dir {
            Some(dir) => capture.with("dir", dir),
            None => capture,
        })
    }

    /// X and Z (upwards) at a B angle, as `ballbar plan` has them; none where the bar reaches its end.
    fn place(&self, b_deg: f64) -> Option<[f64; 2]> {
        /// The axis that moves is this part of the bar's length from the cup at least.
        const LEAST: f64 = 0.25;
        let from_cup = turned(b_deg.to_radians(), self.head) - self.cup.place_mm;
        let reach = |across_mm: f64| {
            let across_mm2 = across_mm.powi(2) + self.cup.place_mm.y.powi(2);
            let along_mm = (self.cup.bar_mm.powi(2) - across_mm2).max(0.0).sqrt();
            (along_mm > LEAST * self.cup.bar_mm).then_some(along_mm)
        };
        match self.kind {
            Kind::Xb => {
                let z_mm = self.cup.place_mm.z + 1.25 * self.head.norm();
                Some([reach(from_cup.z + z_mm)? - from_cup.x, z_mm])
            }
            Kind::Zb => {
                let x_mm = self.cup.place_mm.x - self.head.x;
                Some([x_mm, reach(from_cup.x + x_mm)? - from_cup.z])
            }
        }
    }

    /// Adds the path to the data; its cup may have been put down anew.
    pub fn join(&self, data: &mut Columns, nuisances: &mut Vec<Parameter>) {
        nuisances.extend(of_cup(&self.cup, &self.name()));
        data.cups.push(self.cup);
        data.series_names.push(self.name());
        // Z has its column in any case; without one X stood at zero.
        let rows = data.series.len();
        data.numbers.entry("x_mm").or_insert_with(|| vec![0.0; rows]);
    }
}
