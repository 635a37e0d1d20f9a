//! `rtcp` data: deviation vectors over B, C, direction, time, temperature.

use nalgebra::{Rotation3, Vector3};

use crate::diagnose::data::{after_a_rest, extend_times, need, need_head_b_table_c, show, sites};
use crate::diagnose::effects::Library;
use crate::diagnose::effects::rtcp::library;
use crate::diagnose::effects::rtcp_pose::PoseError;
use crate::diagnose::experiment::{
    Active, Direction, EffectInfo, Experiment, Layout, Parameter, PlannedCapture, Untestable,
    Variable,
};
use crate::error::{Error, Result};
use crate::machine::{DataKind, Machine};
use crate::table::Table;
use crate::units;

/// The nominal machine, as far as RTCP goes.
#[derive(Debug, Clone)]
pub struct Geometry {
    /// From the B axis to the tool point at B = 0.
    pub head: Vector3<f64>,
    /// The C axis at the table's surface.
    pub centre: Vector3<f64>,
    /// Sense of B: 1 where a positive B turns the nozzle towards -X.
    pub b_sense: f64,
    /// Sense of C.
    pub c_sense: f64,
    /// The target in the table frame.
    pub target: Vector3<f64>,
}

/// The columns of an `rtcp` file with the nominal machine.
#[derive(Debug, Clone)]
pub struct Rtcp {
    /// The nominal machine.
    pub geometry: Geometry,
    /// B of each row.
    pub b_deg: Vec<f64>,
    /// C of each row.
    pub c_deg: Vec<f64>,
    /// Optional columns; empty where missing.
    pub dir_b: Vec<f64>,
    /// Direction from which C came.
    pub dir_c: Vec<f64>,
    /// Time.
    pub t_s: Vec<f64>,
    /// Temperature.
    pub temp_c: Vec<f64>,
    /// Machine coordinates commanded: given, or from the nominal machine.
    pub commanded: Vec<Vector3<f64>>,
}

impl Rtcp {
    fn columns(&self) -> [(&'static str, &[f64]); 6] {
        [
            ("b_deg", &self.b_deg),
            ("c_deg", &self.c_deg),
            ("dir_b", &self.dir_b),
            ("dir_c", &self.dir_c),
            ("t_s", &self.t_s),
            ("temp_c", &self.temp_c),
        ]
    }

    /// Why an effect that needs these columns cannot be tested.
    pub fn needs(&self, names: &[&str]) -> Option<Untestable> {
        need(&self.columns(), names)
    }

    /// Why an effect cannot be tested that shows wherever this column is not zero, though it may never change.
    pub fn shows(&self, name: &str) -> Option<Untestable> {
        show(&self.columns(), name)
    }

    /// First time.
    pub fn start_s(&self) -> f64 {
        self.t_s.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Length of the run, s.
    pub fn duration_s(&self) -> f64 {
        if self.t_s.is_empty() {
            return 0.0;
        }
        self.t_s.iter().copied().fold(f64::NEG_INFINITY, f64::max) - self.start_s()
    }

    /// Temperature of the earliest row.
    pub fn first_temp_c(&self) -> f64 {
        let first = (0..self.t_s.len()).min_by(|a, b| self.t_s[*a].total_cmp(&self.t_s[*b]));
        self.temp_c.get(first.unwrap_or(0)).copied().unwrap_or(20.0)
    }
}

/// An `rtcp` experiment.
pub struct RtcpExperiment {
    data: Rtcp,
    library: Library<Rtcp, PoseError>,
    known: Vec<Active>,
    layout: Layout,
    nuisances: Vec<Parameter>,
}

/// Columns of `rtcp` data: needed and possible. Without `d` columns (a plan) the deviations are zero.
pub const COLUMNS: (&[&str], &[&str]) = (
    &["b_deg", "c_deg"],
    &["dx_mm", "dy_mm", "dz_mm", "dir_b", "dir_c", "t_s", "temp_c", "x_mm", "y_mm", "z_mm"],
);

impl RtcpExperiment {
    /// From a table of [`COLUMNS`].
    pub fn from_table(
        table: &Table,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        need_head_b_table_c(DataKind::Rtcp, machine, true)?;
        let (b_deg, c_deg) = (table.column("b_deg")?, table.column("c_deg")?);
        let rows = table.rows();
        warnings.extend(units::swept_angles("b_deg", &b_deg));
        warnings.extend(units::swept_angles("c_deg", &c_deg));
        let column = |name: &str| table.optional_column(name).map(Option::unwrap_or_default);
        let (dir_b, dir_c) = (column("dir_b")?, column("dir_c")?);
        table.check_directions("dir_b", &dir_b, warnings)?;
        table.check_directions("dir_c", &dir_c, warnings)?;
        warnings.extend(machine.without_target());
        let geometry = Geometry {
            head: machine.head_vector(),
            centre: machine.table_point(),
            b_sense: machine.b_sense(),
            c_sense: f64::from(machine.c_sense),
            target: machine.target.map_or_else(Vector3::zeros, |t| t.position_mm.into()),
        };
        let place = [column("x_mm")?, column("y_mm")?, column("z_mm")?];
        let given = place.iter().all(|c| !c.is_empty());
        let names = ["x_mm", "y_mm", "z_mm"].into_iter().zip(&place);
        if let Some((name, _)) = names.clone().find(|(_, c)| c.is_empty())
            && names.clone().any(|(_, c)| !c.is_empty())
        {
            return Err(Error::field(
                table.path(),
                None,
                format!("column '{name}'"),
                "is missing beside the other two",
                "give x_mm, y_mm and z_mm, or none of them",
            ));
        }
        let commanded = (0..rows)
            .map(|r| {
                if given {
                    Vector3::from_fn(|i, _| place[i][r])
                } else {
                    nominal(&geometry, b_deg[r], c_deg[r])
                }
            })
            .collect();
        let data = Rtcp {
            geometry,
            b_deg,
            c_deg,
            dir_b,
            dir_c,
            t_s: column("t_s")?,
            temp_c: column("temp_c")?,
            commanded,
        };
        warnings.extend(units::celsius("temp_c", &data.temp_c));
        let mut measured = Vec::with_capacity(3 * rows);
        for name in ["dx_mm", "dy_mm", "dz_mm"] {
            let d = column(name)?;
            warnings.extend(units::errors(name, &d));
            measured.push(if d.is_empty() { vec![0.0; rows] } else { d });
        }
        let layout = layout(&data, &measured, given);
        let library = library(&data);
        let known = super::known_effects(&library, machine, warnings)?;
        let nuisances = ["target_x_mm", "target_y_mm", "target_z_mm"]
            .map(|n| Parameter::linear(n, 0.05))
            .to_vec();
        Ok(Self { data, library, known, layout, nuisances })
    }
}

/// Adds what the effects in an `rtcp` experiment's machine file show to the deviations `d`, row by row.
pub fn add_effects(experiment: &dyn Experiment, d: &mut [Vector3<f64>]) {
    let added = experiment.predict(&[0.0; 3], &[]);
    for (d, added) in d.iter_mut().zip(added.chunks_exact(3)) {
        *d += Vector3::from_column_slice(added);
    }
}

/// `(X, Y, Z) = T(C) - (v(B) - v0)`.
fn nominal(g: &Geometry, b_deg: f64, c_deg: f64) -> Vector3<f64> {
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), g.c_sense * c_deg.to_radians());
    let swing = Rotation3::from_axis_angle(&Vector3::y_axis(), g.b_sense * b_deg.to_radians());
    g.centre + turn * g.target - (swing * g.head - g.head)
}

fn layout(data: &Rtcp, measured: &[Vec<f64>], given: bool) -> Layout {
    let rows = data.b_deg.len();
    // Observations in the order row, output.
    let spread = |column: &[f64]| column.iter().flat_map(|v| [*v; 3]).collect::<Vec<f64>>();
    let mut variables = Vec::new();
    let mut add = |name: &'static str, column: &[f64], angle: bool| {
        if !column.is_empty() {
            variables.push(Variable { name, values: spread(column), angle, within: false });
        }
    };
    add("b_deg", &data.b_deg, true);
    add("c_deg", &data.c_deg, true);
    add("t_s", &data.t_s, false);
    add("temp_c", &data.temp_c, false);
    add("dir_b", &data.dir_b, false);
    add("dir_c", &data.dir_c, false);
    if given {
        for (i, name) in ["x_mm", "y_mm", "z_mm"].into_iter().enumerate() {
            let column: Vec<f64> = data.commanded.iter().map(|p| p[i]).collect();
            add(name, &column, false);
        }
    }
    let directions = Direction::side_by_side(&["dx_mm", "dy_mm", "dz_mm"], rows);
    Layout {
        values: (0..3 * rows).map(|i| measured[i % 3][i / 3]).collect(),
        groups: (0..3 * rows).map(|i| i / 3).collect(),
        sites: sites(&[&data.b_deg, &data.c_deg], rows),
        classes: (0..3 * rows).map(|i| i % 3).collect(),
        directions,
        variables,
        chains: Vec::new(),
        random: Vec::new(),
        rim_deg: Vec::new(),
    }
}

impl Experiment for RtcpExperiment {
    fn kind(&self) -> DataKind {
        DataKind::Rtcp
    }

    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn nuisances(&self) -> &[Parameter] {
        &self.nuisances
    }

    fn effects(&self) -> &[EffectInfo] {
        &self.library.infos
    }

    fn predict(&self, nuisances: &[f64], active: &[Active]) -> Vec<f64> {
        let rows = self.data.b_deg.len();
        let all = [self.known.as_slice(), active].concat();
        let errors = self.library.errors(&self.data, rows, &all);
        let shift = Vector3::from_column_slice(&nuisances[..3]);
        errors
            .iter()
            .enumerate()
            .flat_map(|(row, e)| <[f64; 3]>::from(e.deviation(&self.data, row, shift)))
            .collect()
    }

    fn predicted_columns(&self, predicted: &[f64]) -> Vec<(&'static str, Vec<f64>)> {
        let column = |k: usize| predicted.iter().skip(k).step_by(3).copied().collect();
        vec![("dx_mm", column(0)), ("dy_mm", column(1)), ("dz_mm", column(2))]
    }

    fn proposals(&self) -> Vec<Vec<PlannedCapture>> {
        let mut now = Vec::new();
        for b in 0..13 {
            for c in 0..7 {
                let side = |n: i32| if n % 2 == 0 { 1.0 } else { -1.0 };
                // C angles that no small harmonic repeats on.
                let mut capture = PlannedCapture::default()
                    .with("b_deg", f64::from(b) * 15.0 - 90.0)
                    .with("c_deg", f64::from(c * 83 % 360));
                for (name, column, way) in [
                    ("dir_b", &self.data.dir_b, side(b + c)),
                    ("dir_c", &self.data.dir_c, side(b + c / 2)),
                ] {
                    if !column.is_empty() {
                        capture = capture.with(name, way);
                    }
                }
                now.push(capture);
            }
        }
        let later = after_a_rest(&now, &self.data.t_s, &self.data.temp_c);
        vec![now, later]
    }

    fn with_plan(&self, plan: &[PlannedCapture]) -> Box<dyn Experiment> {
        let mut data = self.data.clone();
        let geometry = &self.data.geometry;
        for capture in plan {
            let b = capture.or_last("b_deg", &data.b_deg);
            let c = capture.or_last("c_deg", &data.c_deg);
            data.commanded.push(nominal(geometry, b, c));
            data.b_deg.push(b);
            data.c_deg.push(c);
            capture.extend("dir_b", &mut data.dir_b);
            capture.extend("dir_c", &mut data.dir_c);
            capture.extend("temp_c", &mut data.temp_c);
        }
        extend_times(&mut data.t_s, plan);
        let zeros = vec![vec![0.0; data.b_deg.len()]; 3];
        let layout = layout(&data, &zeros, false);
        // The library stays the run's own: its forms and their order are what the model refers to.
        let library = library(&self.data);
        let (known, nuisances) = (self.known.clone(), self.nuisances.clone());
        Box::new(Self { data, library, known, layout, nuisances })
    }
}
