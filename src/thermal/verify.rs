//! A whole table of readings corrected at once, and, where the error was measured too, what is left of it.

use std::path::Path;

use serde::Serialize;

use super::compensate::{Compensator, Request};
use super::head::sensor_columns;
use crate::error::Result;
use crate::plot::{Figure, Panel};
use crate::table::Table;
use crate::units;

/// One row of the table with its correction.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Row {
    /// The axis.
    pub axis: String,
    /// Its position.
    pub position_mm: f64,
    /// To be added to the position; `None` where it cannot be told.
    pub correction_mm: Option<f64>,
    /// Half-width of the 95 % interval for what is left.
    pub correction_u95_mm: Option<f64>,
    /// The measured error, where the table has it.
    pub error_mm: Option<f64>,
    /// Measured error plus correction.
    pub left_mm: Option<f64>,
    /// What was wrong with the reading.
    pub flags: Vec<String>,
}

/// All rows.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// Root mean square of the measured error, and of what is left.
    pub before_rms_mm: Option<f64>,
    /// See `before_rms_mm`.
    pub after_rms_mm: Option<f64>,
    /// In the order of the table.
    pub rows: Vec<Row>,
}

/// Corrects `axis,position_mm,screw_c,head_*_c` with optional `error_mm` and `t_s`; empty cells are dead sensors.
pub fn correct(compensator: &mut Compensator, path: &Path) -> Result<Report> {
    let table =
        Table::read(path, &["axis", "position_mm"], &["screw_c", "error_mm", "t_s", "head_*_c"])?;
    let head = sensor_columns(&table)?;
    compensator.accepts(&table, head.len())?;
    let errors = table.optional_column("error_mm")?;
    let maybe = |row: usize, name: &str| -> Result<Option<f64>> {
        if table.text(row, name).is_empty() { Ok(None) } else { table.number(row, name).map(Some) }
    };
    let mut rows = Vec::with_capacity(table.rows());
    for row in 0..table.rows() {
        let axis = table.text(row, "axis").to_ascii_lowercase();
        let mut request = Request::default();
        let position_mm = table.number(row, "position_mm")?;
        request.position_mm.insert(axis.clone(), position_mm);
        request.screw_c.insert(axis.clone(), maybe(row, "screw_c")?);
        request.head_c = head.iter().map(|name| maybe(row, name)).collect::<Result<_>>()?;
        let answer = compensator.answer(&request);
        let correction_mm = answer.correction_mm.get(&axis).copied().flatten();
        let error_mm = errors.as_ref().map(|e| e[row]);
        rows.push(Row {
            correction_u95_mm: answer.correction_u95_mm.get(&axis).copied(),
            left_mm: error_mm.zip(correction_mm).map(|(e, c)| e + c),
            axis,
            position_mm,
            correction_mm,
            error_mm,
            flags: answer.flags,
        });
    }
    let rms = |values: Vec<f64>| {
        let n = values.len() as f64;
        (n > 0.0).then(|| (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt())
    };
    let corrected = || rows.iter().filter(|r| r.left_mm.is_some());
    Ok(Report {
        before_rms_mm: rms(corrected().filter_map(|r| r.error_mm).collect()),
        after_rms_mm: rms(corrected().filter_map(|r| r.left_mm).collect()),
        rows,
    })
}

impl Report {
    /// What speaks against the table or the model.
    pub fn doubts(&self) -> Vec<String> {
        let rms = self.before_rms_mm.zip(self.after_rms_mm);
        let worse = rms.filter(|(before, after)| after > before).map(|(before, after)| {
            format!(
                "the corrections make the errors larger, {before:.4} -> {after:.4} mm rms: error_mm may have its sign turned or be in micrometres, position_mm \
                 in metres, or the model is another machine's"
            )
        });
        let without =
            self.rows.iter().filter(|r| r.error_mm.is_some() && r.left_mm.is_none()).count();
        let without = (without > 0).then(|| {
            format!("{without} of {} measured rows have no correction (their flags say why) and are in neither rms", self.rows.len())
        });
        let errors: Vec<f64> = self.rows.iter().filter_map(|r| r.error_mm).collect();
        let places: Vec<f64> = self.rows.iter().map(|r| r.position_mm).collect();
        let units = units::errors("error_mm", &errors)
            .into_iter()
            .chain(units::travel("position_mm", &places));
        worse.into_iter().chain(without).chain(units).collect()
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let mut out = String::from(
            "axis  position mm  correction mm    ±95 %   measured mm    left mm  flags\n",
        );
        let cell = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:+.4}"));
        for r in &self.rows {
            out.push_str(&format!(
                "{:4} {:12.3} {:>14} {:>8} {:>13} {:>10}  {}\n",
                r.axis,
                r.position_mm,
                cell(r.correction_mm),
                r.correction_u95_mm.map_or("-".into(), |u| format!("{u:.4}")),
                cell(r.error_mm),
                cell(r.left_mm),
                r.flags.join(" ")
            ));
        }
        if let Some((before, after)) = self.before_rms_mm.zip(self.after_rms_mm) {
            out.push_str(&format!("\nrms {before:.4} mm before, {after:.4} mm after\n"));
        }
        out
    }

    /// Measured error and what is left, row by row.
    pub fn figure(&self) -> Figure {
        let pick = |f: fn(&Row) -> Option<f64>| -> Vec<(f64, f64)> {
            self.rows
                .iter()
                .enumerate()
                .filter_map(|(i, r)| f(r).map(|v| (i as f64 + 1.0, v)))
                .collect()
        };
        let left: Vec<_> = self
            .rows
            .iter()
            .enumerate()
            .filter_map(|(i, r)| Some((i as f64 + 1.0, r.left_mm?, r.correction_u95_mm?)))
            .collect();
        Figure::new("Thermal error before and after compensation").panel(
            Panel::new("row", "error, mm")
                .line("measured", &pick(|r| r.error_mm))
                .points_with_bars("left, ±95 % expected", &left),
        )
    }
}
