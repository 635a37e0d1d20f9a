//! From files to an experiment, for `diagnose` and `simulate` alike.

use std::path::PathBuf;

use crate::camera::Calibration;
use crate::diagnose::data::of_model;
use crate::diagnose::data::plain::{self, PlainExperiment};
use crate::diagnose::data::rod::{self, RodExperiment, planned};
use crate::diagnose::data::rtcp::{self, RtcpExperiment};
use crate::diagnose::experiment::Experiment;
use crate::diagnose::own;
use crate::error::{Error, Result, above_zero};
use crate::machine::{self, DataKind, Head, Machine};
use crate::repeats;
use crate::table::Table;

/// Where an experiment comes from.
#[derive(Debug, Clone)]
pub struct Source {
    /// The kind of data.
    pub kind: DataKind,
    /// The data file.
    pub data: PathBuf,
    /// The machine file; needed for `rtcp` and `ballbar`.
    pub model: Option<PathBuf>,
    /// The calibration file; needed for `rod`.
    pub calib: Option<PathBuf>,
    /// Effects of the user's own.
    pub effects: Option<PathBuf>,
    /// The rod's diameter, where the data are a plan of captures without edge points.
    pub diameter_mm: Option<f64>,
    /// Whether the rows were measured: then they have all readings, and copies of rows are left out, which tell nothing. A plan may lack the one and
    /// want the other.
    pub measured: bool,
}

impl Source {
    /// The machine file, or an empty machine where none is given and none is needed.
    pub fn machine(&self) -> Result<Machine> {
        match &self.model {
            Some(path) if self.kind.needs_head() => Machine::read(path),
            Some(path) => Machine::read_without_head(path),
            None if self.kind.needs_head() => Err(Error::option(
                "--model",
                "is missing: the prediction needs the machine's geometry",
                "give the machine.toml that the control's numbers stand in",
            )),
            None => Ok(Machine::head_b_table_c(Head::default(), machine::Table::default())),
        }
    }

    /// Reads everything.
    pub fn load(&self, warnings: &mut Vec<String>) -> Result<Box<dyn Experiment>> {
        let machine = self.machine()?;
        warnings.extend(machine.doubts());
        let kind = self.kind.name();
        let of_file = self.effects.as_ref().map(|path| own::read(path, kind)).transpose()?;
        let mut entries = of_file.unwrap_or_default();
        let mut of_machine = own::of_machine(&machine, kind);
        of_machine.retain(|e| !entries.iter().any(|o| o.name == e.name));
        entries.extend(of_machine);
        let path = self.effects.as_ref().or(self.model.as_ref()).unwrap_or(&self.data);
        own::around(&machine, path, entries, warnings, |rest, warnings| {
            let model = self.model.as_deref().unwrap_or(&self.data);
            self.library(rest, warnings).map_err(|e| of_model(e, model))
        })
    }

    /// The data file; a plan of a rod's captures as the edge points that they would show.
    ///
    /// # Errors
    /// Files that cannot be read, columns that are missing, a plan that does not say what of the rod is seen.
    pub fn table(&self, warnings: &mut Vec<String>) -> Result<Table> {
        if let Some(planned) = self.planned_rod()? {
            return Ok(planned);
        }
        let (required, optional) = match self.kind {
            DataKind::Rtcp => rtcp::COLUMNS,
            DataKind::Rod => rod::COLUMNS,
            DataKind::Ballbar => plain::BALLBAR_COLUMNS,
            DataKind::Thermal => plain::THERMAL_COLUMNS,
            DataKind::Burn => plain::BURN_COLUMNS,
        };
        let readings: &[&str] = match self.kind {
            DataKind::Rtcp => &["dx_mm", "dy_mm", "dz_mm"],
            DataKind::Rod => &["u_px", "v_px"],
            DataKind::Ballbar => &["length_mm"],
            DataKind::Thermal => &["error_mm"],
            DataKind::Burn => &["dx_mm", "dy_mm"],
        };
        let mut table = Table::read(&self.data, required, optional)?;
        if self.measured {
            // Some of the outputs alone would make another answer; none of them are a plan's, as will be said.
            let there = readings.iter().filter(|name| table.has(name)).count();
            if (1..readings.len()).contains(&there) {
                let all = [required, readings].concat();
                table = Table::read(&self.data, &all, optional)?;
            }
            repeats::measured_once(&mut table, readings, warnings);
        }
        Ok(table)
    }

    /// A plan of a rod's captures as the edge points that they would show; `None` where the data have points or are no rod's.
    fn planned_rod(&self) -> Result<Option<Table>> {
        let option = |reason: &str, fix: &str| Err(Error::option("--diameter-mm", reason, fix));
        match self.diameter_mm {
            None if self.measured || self.kind != DataKind::Rod => return Ok(None),
            Some(_) if self.kind != DataKind::Rod => {
                return option("is a rod's", "leave it out, it is for rod");
            }
            _ => {}
        }
        let plan = Table::read(&self.data, rod::PLAN_COLUMNS.0, rod::PLAN_COLUMNS.1)?;
        let diameter_mm = match (self.measured || plan.has("u_px"), self.diameter_mm) {
            (true, None) => return Ok(None),
            (true, Some(_)) => {
                let fix =
                    "leave it out: it is for a plan without edge points (--plan-only, simulate)";
                return option("is told by the edge points", fix);
            }
            (false, None) => {
                let reason = "is missing: the plan has no edge points (u_px, v_px)";
                return option(reason, "give the rod's nominal diameter in mm");
            }
            (false, Some(diameter_mm)) => diameter_mm,
        };
        above_zero("--diameter-mm", diameter_mm, "give the rod's nominal diameter in mm")?;
        if self.model.is_none() {
            return Err(Error::option(
                "--model",
                "is missing: a plan without edge points does not say where the rod stands",
                "give the machine file, whose [table] xc_mm, yc_mm are the C axis",
            ));
        }
        let centre = self.machine()?.table_point().xy();
        planned::edge_points(&plan, &self.calibration()?, centre, diameter_mm).map(Some)
    }

    fn calibration(&self) -> Result<Calibration> {
        let calib = self.calib.as_ref().ok_or_else(|| {
            Error::option(
                "--calib",
                "is missing: edge points are in pixels",
                "give the camera's calibration file",
            )
        })?;
        Calibration::read(calib)
    }

    /// The experiment with the library alone.
    fn library(
        &self,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Box<dyn Experiment>> {
        let table = self.table(warnings)?;
        Ok(match self.kind {
            DataKind::Rtcp => Box::new(RtcpExperiment::from_table(&table, machine, warnings)?),
            DataKind::Rod => {
                let calibration = self.calibration()?;
                Box::new(RodExperiment::from_table(&table, &calibration, Some(machine), warnings)?)
            }
            DataKind::Ballbar => {
                Box::new(PlainExperiment::ballbar_table(&table, machine, warnings)?)
            }
            DataKind::Thermal => {
                Box::new(PlainExperiment::thermal_table(&table, machine, warnings)?)
            }
            DataKind::Burn => Box::new(PlainExperiment::burn_table(&table, machine, warnings)?),
        })
    }
}
