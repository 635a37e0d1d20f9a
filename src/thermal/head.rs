//! The head's model `K0 = Σ a_i t_i`: least squares on sums of products.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::blocks::{BLOCKS, Blocks, correlation};
use super::sums::{Sums, with_constant};
use crate::error::{Error, Result};
use crate::fit::robust::range;
use crate::repeats;
use crate::table::Table;
use crate::uncertainty::k95;
use crate::units;

/// The most sensors the source's model uses.
pub const MOST_SENSORS: usize = 10;

/// When a constant is fitted beside the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Constant {
    /// Only if it is significant, with a warning
    Auto,
    /// Readings are rises above the cold state: never
    No,
    /// Always
    Yes,
}

/// How the head is fitted.
#[derive(Debug, Clone)]
pub struct Options {
    /// At most this many sensors (1 to 10); more in the file are selected from.
    pub max_sensors: usize,
    /// Select even where the file has no more than that.
    pub select: bool,
    /// Temperatures of the cold state, subtracted from every reading; empty: readings are rises already.
    pub cold_c: Vec<f64>,
    /// Whether a constant is fitted.
    pub constant: Constant,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_sensors: MOST_SENSORS,
            select: false,
            cold_c: Vec::new(),
            constant: Constant::Auto,
        }
    }
}

/// A head that never was colder than this gives temperatures, not rises, °C.
const ROOM_C: f64 = 10.0;

/// Readings of all sensors and the displacement they go with.
#[derive(Debug, Clone)]
pub struct Data {
    /// Rows of rises above the cold state, °C.
    pub(super) rises_c: Vec<Vec<f64>>,
    pub(super) displacement_mm: Vec<f64>,
    /// Where they are from.
    path: std::path::PathBuf,
    /// Whether the readings look like temperatures rather than rises: every sensor's are well above zero, and farther from it than
    /// from each other.
    pub(super) looks_absolute: bool,
    /// What a user should know of the file.
    warnings: Vec<String>,
}

impl Data {
    /// Reads `head_1_c..head_n_c,displacement_mm`.
    pub fn read(path: impl AsRef<std::path::Path>, cold_c: &[f64]) -> Result<Self> {
        let mut table = Table::read(path, &["displacement_mm"], &["head_*_c"])?;
        let mut warnings = Vec::new();
        repeats::measured_once(&mut table, &["displacement_mm"], &mut warnings);
        let sensors = sensor_columns(&table)?;
        if sensors.is_empty() {
            let reason = "has no head sensor column";
            return Err(Error::file(table.path(), reason, "add head_1_c, head_2_c, ..."));
        }
        if !cold_c.is_empty() && cold_c.len() != sensors.len() {
            return Err(Error::option(
                "--cold-c",
                format!("{} temperatures for {} sensors", cold_c.len(), sensors.len()),
                "give one for each head_N_c column, in that order",
            ));
        }
        let displacement_mm = table.column("displacement_mm")?;
        let mut rises_c = vec![Vec::with_capacity(sensors.len()); table.rows()];
        warnings.extend(units::errors("displacement_mm", &displacement_mm));
        let mut looks_absolute = cold_c.is_empty();
        for (i, name) in sensors.iter().enumerate() {
            let cold = cold_c.get(i).copied().unwrap_or(0.0);
            let column = table.column(name)?;
            warnings.extend(units::celsius(name, &column));
            let (low, high) = range(&column);
            looks_absolute &= low > ROOM_C && high - low < low;
            for (row, value) in rises_c.iter_mut().zip(column) {
                row.push(value - cold);
            }
        }
        let path = table.path().to_owned();
        Ok(Self { rises_c, displacement_mm, path, looks_absolute, warnings })
    }

    pub(super) fn sensors(&self) -> usize {
        self.rises_c[0].len()
    }
}

/// `head_1_c` to `head_n_c` without a gap, of which there may be none.
pub fn sensor_columns(table: &Table) -> Result<Vec<String>> {
    let count =
        table.names().iter().filter(|n| n.starts_with("head_") && n.ends_with("_c")).count();
    let names: Vec<String> = (1..=count).map(|i| format!("head_{i}_c")).collect();
    match names.iter().find(|n| !table.has(n)) {
        Some(missing) => Err(Error::field(
            table.path(),
            None,
            format!("column '{missing}'"),
            "is missing: sensors are numbered from 1 without a gap",
            "rename the columns",
        )),
        None => Ok(names),
    }
}

/// Coefficients for one set of working sensors.
#[derive(Debug, Clone)]
pub struct Predictor {
    columns: Vec<usize>,
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
    noise_mm: f64,
    k95: f64,
}

impl Predictor {
    /// Displacement and the half-width of the 95 % interval for what it leaves, from readings and cold state.
    pub fn predict(&self, rise_c: impl Fn(usize) -> f64) -> (f64, f64) {
        let x = DVector::from_iterator(self.columns.len(), self.columns.iter().map(|&i| rise_c(i)));
        let variance = (&self.covariance * &x).dot(&x) + self.noise_mm.powi(2);
        (self.coefficients.dot(&x), self.k95 * variance.sqrt())
    }
}

/// One sensor's coefficient.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Coefficient {
    /// Number of the sensor, from 1.
    pub sensor: usize,
    /// Displacement for each degree of rise.
    pub mm_per_c: f64,
    /// Half-width of its 95 % interval.
    pub mm_per_c_u95: f64,
    /// Smallest and largest rise in the blocks.
    pub range_c: [f64; 2],
}

/// The fitted head.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// Sensors on the head, used or not.
    pub sensors: usize,
    /// Cold-state temperatures subtracted from readings; empty: readings are rises.
    pub cold_c: Vec<f64>,
    /// The sensors used.
    pub coefficients: Vec<Coefficient>,
    /// A constant, 0 where none is fitted.
    pub constant_mm: f64,
    /// Whether a constant is fitted.
    pub has_constant: bool,
    /// Standard deviation of what the model leaves.
    pub noise_mm: f64,
    /// Root mean square of the displacement, and of what the model leaves on its own data.
    pub before_rms_mm: f64,
    /// See `before_rms_mm`.
    pub after_rms_mm: f64,
    /// The same on blocks of rows the fit (and the selection) had not seen.
    pub held_out_rms_mm: f64,
    /// Correlation of consecutive residuals; the intervals are widened for it.
    pub residual_correlation: f64,
    /// What least squares needs when a sensor dies.
    pub sums: Sums,
}

impl Head {
    /// The model for the sensors that work; `None` if they cannot tell the displacement.
    pub fn predictor(&self, works: impl Fn(usize) -> bool) -> Option<Predictor> {
        let mut columns: Vec<usize> =
            self.coefficients.iter().map(|c| c.sensor - 1).filter(|&i| works(i)).collect();
        if columns.is_empty() {
            return None;
        }
        if self.has_constant {
            columns.push(self.sensors);
        }
        let solved = self.sums.solve(&columns)?;
        let dof = (self.sums.effective_rows - columns.len() as f64).max(1.0);
        // What is left scatters by s; the coefficients' covariance knows the repeated rows through the dof.
        let rows = self.sums.at(self.sensors, self.sensors);
        let s2 = solved.left / (rows * dof / self.sums.effective_rows);
        let widen = rows / self.sums.effective_rows;
        Some(Predictor {
            covariance: solved.inverse * (s2 * widen),
            coefficients: solved.coefficients,
            noise_mm: s2.sqrt(),
            k95: k95(dof),
            columns,
        })
    }
}

/// Fits the head's model; warnings go to `warnings`.
pub fn fit(data: &Data, options: &Options, warnings: &mut Vec<String>) -> Result<Head> {
    warnings.extend(data.warnings.iter().cloned());
    if !(1..=MOST_SENSORS).contains(&options.max_sensors) {
        return Err(Error::option("--max-sensors", "is out of range", "give 1 to 10"));
    }
    let fail = |reason: String, fix: String| {
        Error::measure(format!("{}: head", data.path.display()), reason, fix)
    };
    let (rows, sensors) = (data.displacement_mm.len(), data.sensors());
    let live = live_sensors(data, warnings);
    if live.is_empty() {
        return Err(fail(
            "no sensor changes".to_owned(),
            "warm the head up while recording".to_owned(),
        ));
    }
    let selects = options.select || live.len() > options.max_sensors;
    let need = 3 * BLOCKS.max(if selects { 1 } else { live.len() + 1 });
    if rows < need {
        return Err(fail(
            format!("{rows} rows are too few for {} sensors", live.len()),
            format!("record at least {need}"),
        ));
    }
    let most = selects.then_some(options.max_sensors);
    let blocks = Blocks::new(data, live, most);
    let constant = match options.constant {
        Constant::Yes => true,
        Constant::No => false,
        Constant::Auto => blocks.needs_constant(warnings),
    };
    let mut total = blocks.total();
    let chosen = blocks.chosen(constant);
    if chosen.len() == 1 {
        warnings.push(
            "the head's displacement rests on one sensor: what it does not feel is not corrected, and a fault of it is not noticed (two to ten are usual)"
                .into(),
        );
    }
    let columns = with_constant(chosen.clone(), sensors, constant);
    let solved = total.solve(&columns).ok_or_else(|| {
        fail(
            "the sensors rise and fall together: their coefficients cannot be told apart"
                .to_owned(),
            "use --select, or record heating and cooling of different parts".to_owned(),
        )
    })?;
    let (widen, rho) = correlation(data, &columns, &solved.coefficients);
    total.effective_rows = rows as f64 / widen;
    let y = total.displacement_column();
    let mut head = Head {
        sensors,
        cold_c: options.cold_c.clone(),
        coefficients: Vec::new(),
        constant_mm: if constant { solved.coefficients[columns.len() - 1] } else { 0.0 },
        has_constant: constant,
        noise_mm: 0.0,
        before_rms_mm: (total.at(y, y) / rows as f64).sqrt(),
        after_rms_mm: (solved.left / rows as f64).sqrt(),
        held_out_rms_mm: (blocks.held_out(constant) / rows as f64).sqrt(),
        residual_correlation: rho,
        sums: total,
    };
    let coefficient = |(a, &i): (usize, &usize)| Coefficient {
        sensor: i + 1,
        mm_per_c: solved.coefficients[a],
        mm_per_c_u95: 0.0,
        range_c: range(&data.rises_c.iter().map(|r| r[i]).collect::<Vec<_>>()).into(),
    };
    head.coefficients = chosen.iter().enumerate().map(coefficient).collect();
    if let Some(p) = head.predictor(|_| true) {
        head.noise_mm = p.noise_mm;
        for (a, c) in head.coefficients.iter_mut().enumerate() {
            c.mm_per_c_u95 = p.k95 * p.covariance[(a, a)].sqrt();
        }
    }
    if head.held_out_rms_mm > 2.0 * head.after_rms_mm {
        warnings.push(format!(
            "the head model leaves {:.4} mm on rows it had not seen but {:.4} mm on its own: record more warm-up and \
             cool-down, or use fewer sensors",
            head.held_out_rms_mm, head.after_rms_mm
        ));
    }
    Ok(head)
}

/// Sensors that change; of the others `warnings` tell.
fn live_sensors(data: &Data, warnings: &mut Vec<String>) -> Vec<usize> {
    let moves = |&i: &usize| {
        let first = data.rises_c[0][i];
        let moves = data.rises_c.iter().any(|r| (r[i] - first).abs() > 1e-9);
        if !moves {
            warnings.push(format!("head sensor {} never changes: dead, left out", i + 1));
        }
        moves
    };
    (0..data.sensors()).filter(moves).collect()
}
