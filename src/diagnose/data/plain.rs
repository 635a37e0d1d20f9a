//! `ballbar`, `thermal` and `burn` data: one or two values a row over plain columns.

mod planned;

use nalgebra::Vector3;

use crate::diagnose::data::columns::Columns;
use crate::diagnose::data::other_path::OtherPath;
use crate::diagnose::data::{
    ballbar, extend_time, extend_times, known_effects, need_head_b_table_c, pace_s, sites, thermal,
};
use crate::diagnose::effects::{self, Library};
use crate::diagnose::experiment::{
    Active, Direction, EffectInfo, Experiment, Layout, Parameter, PlannedCapture, Variable,
};
use crate::error::Result;
use crate::fit::robust::median;
use crate::machine::{DataKind, Machine};
use crate::table::Table;
use crate::thermal::head::sensor_columns;
use crate::units;

/// What sets one kind of data over plain columns apart.
struct Sort {
    kind: DataKind,
    outputs: &'static [&'static str],
    /// Column of the axis or path that a row is of; none of burns.
    series: &'static str,
    /// Columns that a planned capture may set, what changes slowest first.
    planned: &'static [&'static str],
    /// Those of them that it may set otherwise than they ever were.
    widened: &'static [&'static str],
    library: fn(&Columns) -> Library<Columns, Vector3<f64>>,
    /// Prediction of one row's outputs: data, nuisances, row, the effects' errors.
    predict: fn(&Columns, &[f64], usize, Vector3<f64>) -> [f64; 2],
}

const BURN: Sort = Sort {
    kind: DataKind::Burn,
    outputs: &["dx_mm", "dy_mm"],
    series: "",
    planned: &["height_mm", "power_w", "b_deg"],
    widened: &["height_mm", "power_w"],
    library: effects::burn::library,
    predict: |_, _, _, e| [e.x, e.y],
};
const THERMAL: Sort = Sort {
    kind: DataKind::Thermal,
    outputs: &["error_mm"],
    series: "axis",
    // A screw warms up once, and all positions are measured meanwhile.
    planned: &["t_s", "screw_c", "position_mm"],
    widened: &[],
    library: effects::thermal::library,
    predict: thermal::predict,
};
const BALLBAR: Sort = Sort {
    kind: DataKind::Ballbar,
    outputs: &["length_mm"],
    series: "path",
    planned: &["dir", "b_deg"],
    widened: &[],
    library: effects::ballbar::library,
    predict: ballbar::predict,
};

/// An experiment over plain columns.
pub struct PlainExperiment {
    sort: &'static Sort,
    data: Columns,
    library: Library<Columns, Vector3<f64>>,
    known: Vec<Active>,
    layout: Layout,
    nuisances: Vec<Parameter>,
}

/// Columns of burn test offsets: needed and possible.
pub const BURN_COLUMNS: (&[&str], &[&str]) =
    (&["height_mm", "power_w", "b_deg"], &["dx_mm", "dy_mm", "t_s", "temp_c"]);
/// Columns of thermal errors.
pub const THERMAL_COLUMNS: (&[&str], &[&str]) =
    (&["t_s", "axis", "position_mm", "screw_c"], &["error_mm", "head_*_c", "ambient_c"]);
/// Columns of ball bar lengths.
pub const BALLBAR_COLUMNS: (&[&str], &[&str]) =
    (&["b_deg"], &["length_mm", "x_mm", "z_mm", "path", "dir", "t_s", "temp_c"]);

impl PlainExperiment {
    /// From a table of burn test offsets.
    pub fn burn_table(
        table: &Table,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        let data = Columns::read(table, &["height_mm", "power_w", "b_deg", "t_s", "temp_c"], "")?;
        warnings.extend(units::swept_angles("b_deg", data.get("b_deg")));
        warnings.extend(units::celsius("temp_c", data.get("temp_c")));
        if let Some(row) = data.get("height_mm").iter().position(|h| *h < 0.0) {
            let fix =
                "give the height of the nozzle above the plate, at which the ring was burnt, in mm";
            return Err(table.error(row, "height_mm", "is below zero", fix));
        }
        let highest = data.get("height_mm").iter().copied().fold(0.0, f64::max);
        warnings.extend(units::height("column 'height_mm'", highest));
        Self::new(&BURN, table, data, Vec::new(), machine, warnings)
    }

    /// From a table of thermal errors.
    pub fn thermal_table(
        table: &Table,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        let mut data =
            Columns::read(table, &["t_s", "position_mm", "screw_c", "ambient_c"], "axis")?;
        warnings.extend(units::celsius("screw_c", data.get("screw_c")));
        warnings.extend(units::travel("position_mm", data.get("position_mm")));
        for name in sensor_columns(table)? {
            let column = table.column(&name)?;
            warnings.extend(units::celsius(&name, &column));
            let t = data.get("t_s");
            let first = (0..t.len()).min_by(|a, b| t[*a].total_cmp(&t[*b])).unwrap_or(0);
            // Rises above the cold state; columns that begin well above zero hold temperatures. What never changes is no constant of the errors.
            let still = table.has("error_mm") && column.iter().all(|v| *v == column[first]);
            if still {
                warnings.push(format!("{name} never changes: it tells nothing of the head"));
            }
            let cold = if still || column[first].abs() > 5.0 { column[first] } else { 0.0 };
            data.head_c.push(column.iter().map(|v| v - cold).collect());
        }
        let measured = table.optional_column("error_mm")?.unwrap_or_default();
        let nuisances = thermal::prepare(&mut data, &measured, warnings);
        Self::new(&THERMAL, table, data, nuisances, machine, warnings)
    }

    /// From a table of ball bar lengths.
    pub fn ballbar_table(
        table: &Table,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        need_head_b_table_c(DataKind::Ballbar, machine, false)?;
        let mut data =
            Columns::read(table, &["b_deg", "x_mm", "z_mm", "dir", "t_s", "temp_c"], "path")?;
        warnings.extend(units::swept_angles("b_deg", data.get("b_deg")));
        warnings.extend(units::celsius("temp_c", data.get("temp_c")));
        table.check_directions("dir", data.get("dir"), warnings)?;
        data.head = machine.head_vector();
        let measured = table.optional_column("length_mm")?.unwrap_or_default();
        if !measured.is_empty() {
            warnings.extend(units::bar("column 'length_mm'", median(&mut measured.clone())));
        }
        let nuisances = ballbar::prepare(&mut data, &measured, warnings);
        Self::new(&BALLBAR, table, data, nuisances, machine, warnings)
    }

    fn new(
        sort: &'static Sort,
        table: &Table,
        data: Columns,
        nuisances: Vec<Parameter>,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        let rows = table.rows();
        let mut measured = Vec::new();
        for name in sort.outputs {
            let column = table.optional_column(name)?.unwrap_or_else(|| vec![0.0; rows]);
            if sort.kind != DataKind::Ballbar {
                warnings.extend(units::errors(name, &column));
            }
            measured.push(column);
        }
        let library = (sort.library)(&data);
        let known = known_effects(&library, machine, warnings)?;
        let layout = layout(&data, sort, &measured);
        Ok(Self { sort, data, library, known, layout, nuisances })
    }
}

fn layout(data: &Columns, sort: &Sort, measured: &[Vec<f64>]) -> Layout {
    let outputs = sort.outputs;
    let (rows, k) = (measured[0].len(), outputs.len());
    let spread = |c: &[f64]| (0..rows * k).map(|i| c[i / k]).collect::<Vec<f64>>();
    let mut variables: Vec<Variable> = data
        .numbers
        .iter()
        .map(|(name, c)| Variable {
            name,
            values: spread(c),
            angle: *name == "b_deg",
            within: false,
        })
        .collect();
    if let Some(first) = data.head_c.first() {
        variables.push(Variable {
            name: "head_1_c",
            values: spread(first),
            angle: false,
            within: false,
        });
    }
    let mut directions = Direction::side_by_side(outputs, rows);
    if sort.kind == DataKind::Thermal {
        // Every axis is a machine of its own: what has no name may be one's alone.
        let on = |axis: usize| -> Vec<f64> {
            data.series.iter().map(|s| f64::from(u8::from(*s == axis))).collect()
        };
        let axes = data.series_names.iter().enumerate();
        directions.extend(axes.map(|(axis, name)| Direction::part(outputs[0], name, on(axis))));
    }
    let series: Vec<f64> = data.series.iter().map(|s| *s as f64).collect();
    let mut keys: Vec<&[f64]> = vec![&series];
    // Time and temperature pass by, and a place is one from whichever side it is reached; everything else makes the place. Where the
    // head's temperatures count, only what is read again at once is read at one place.
    let passes = |name: &str| ["t_s", "temp_c", "screw_c", "ambient_c", "dir"].contains(&name);
    let all = !data.head_c.is_empty();
    let columns = data.numbers.iter().filter(|(name, _)| all || !passes(name));
    keys.extend(columns.map(|(_, c)| c.as_slice()).chain(data.head_c.iter().map(Vec::as_slice)));
    let sites = sites(&keys, rows);
    // A ball bar reads on its way, one value after another.
    let chain = |output: usize| (0..rows).map(|row| (row * k + output, row as f64)).collect();
    let chains = match sort.kind {
        DataKind::Ballbar => (0..k).map(chain).collect(),
        _ => Vec::new(),
    };
    Layout {
        values: (0..rows * k).map(|i| measured[i % k][i / k]).collect(),
        groups: (0..rows * k).map(|i| i / k).collect(),
        sites,
        classes: (0..rows * k).map(|i| i % k).collect(),
        directions,
        variables,
        chains,
        random: Vec::new(),
        rim_deg: Vec::new(),
    }
}

impl Experiment for PlainExperiment {
    fn kind(&self) -> DataKind {
        self.sort.kind
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
        let all = [self.known.as_slice(), active].concat();
        let rows = self.data.series.len();
        let errors = self.library.errors(&self.data, rows, &all);
        let k = self.sort.outputs.len();
        errors
            .iter()
            .enumerate()
            .flat_map(|(row, e)| {
                (self.sort.predict)(&self.data, nuisances, row, *e).into_iter().take(k)
            })
            .collect()
    }

    fn predicted_columns(&self, predicted: &[f64]) -> Vec<(&'static str, Vec<f64>)> {
        let k = self.sort.outputs.len();
        let column = |o: usize| predicted.iter().skip(o).step_by(k).copied().collect();
        self.sort.outputs.iter().enumerate().map(|(o, name)| (*name, column(o))).collect()
    }

    fn proposals(&self) -> Vec<Vec<PlannedCapture>> {
        // Each axis or path within what it was measured over itself.
        let names = &self.data.series_names;
        let alone = names.len() < 2;
        let mut list: Vec<PlannedCapture> =
            (0..names.len().max(1)).flat_map(|series| self.proposals_of(series, alone)).collect();
        list.sort_by(PlannedCapture::by_time);
        vec![list]
    }

    fn other_sweep(&self) -> Vec<PlannedCapture> {
        OtherPath::of(&self.data).map_or_else(Vec::new, |other| other.sweep(&self.data))
    }

    fn with_plan(&self, plan: &[PlannedCapture]) -> Box<dyn Experiment> {
        let (mut data, mut nuisances) = (self.data.clone(), self.nuisances.clone());
        let other = OtherPath::of(&self.data);
        let step_s = pace_s(data.get("t_s")) / plan.len().max(1) as f64;
        for capture in plan {
            let planned = capture.name(self.sort.series);
            let of = |data: &Columns| {
                data.series_names.iter().position(|name| planned == Some(name.as_str()))
            };
            if let (Some(other), Some(_), None) = (&other, planned, of(&data)) {
                other.join(&mut data, &mut nuisances);
            }
            let series = of(&data).unwrap_or(0);
            for (name, column) in &mut data.numbers {
                match *name {
                    // Burns are taken one by one; a path and a warm-up last as long as the plan.
                    "t_s" if self.sort.series.is_empty() => {}
                    "t_s" => match (capture.number("t_s"), column.last()) {
                        // Of captures that are planned for the same time a few will be taken.
                        (Some(t_s), Some(last)) => column.push(t_s.max(last + step_s)),
                        _ => extend_time(column),
                    },
                    // X and Z stay linked to B, as the ball bar's own path has them.
                    "x_mm" | "z_mm" => {
                        let b_deg = capture.or_last("b_deg", &[0.0]);
                        let [x_mm, z_mm] = ballbar::next_place(&self.data, series, b_deg);
                        column.push(match (*name, capture.number(name)) {
                            ("x_mm", planned) => planned.unwrap_or(x_mm),
                            (_, planned) => planned.map_or(z_mm, |z| self.data.z_sense * z),
                        });
                    }
                    name => capture.extend(name, column),
                }
            }
            data.series.push(series);
            for sensor in &mut data.head_c {
                sensor.push(sensor.last().copied().unwrap_or(0.0));
            }
        }
        if self.sort.series.is_empty()
            && let Some(t_s) = data.numbers.get_mut("t_s")
        {
            extend_times(t_s, plan);
        }
        let zeros = vec![vec![0.0; data.series.len()]; self.sort.outputs.len()];
        let layout = layout(&data, self.sort, &zeros);
        let library = (self.sort.library)(&self.data);
        let known = self.known.clone();
        Box::new(Self { data, library, known, layout, nuisances, sort: self.sort })
    }
}
