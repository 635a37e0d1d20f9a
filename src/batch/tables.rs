//! The finished batch as CSV and Parquet, streamed from its JSON lines: memory does not grow with the batch.

use std::collections::HashMap;
use std::io::{BufWriter, Write};
use std::path::Path;

use serde_json::Value;

use crate::error::{Error, Result};
use crate::output::{csv_record, flatten, write_streamed};
use crate::parquet::{Cell, Kind, Writer};

/// The columns of all rows, in the order they first appear, and what each holds.
#[derive(Debug, Default)]
pub struct Columns {
    names: Vec<String>,
    index: HashMap<String, usize>,
    kinds: Vec<Option<Kind>>,
}

impl Columns {
    /// Takes a row's columns in.
    pub fn add(&mut self, row: &Value) {
        for (name, value) in flatten(row) {
            let i = *self.index.entry(name).or_insert_with_key(|name| {
                self.names.push(name.clone());
                self.kinds.push(None);
                self.names.len() - 1
            });
            let Some(kind) = kind(value) else { continue };
            self.kinds[i] = Some(match self.kinds[i] {
                None => kind,
                Some(old) if old == kind => kind,
                Some(Kind::Integer | Kind::Double)
                    if kind != Kind::Text && kind != Kind::Boolean =>
                {
                    Kind::Double
                }
                Some(_) => Kind::Text,
            });
        }
    }

    /// Writes the rows as CSV.
    pub fn write_csv(&self, path: &Path, rows: impl Iterator<Item = Result<Value>>) -> Result<()> {
        write_streamed(path, |file| {
            let mut writer = csv::Writer::from_writer(BufWriter::new(file));
            let failed = |e: csv::Error| Error::io(path, "write", e.into());
            writer.write_record(&self.names).map_err(failed)?;
            for row in rows {
                writer.write_record(csv_record(&self.names, &flatten(&row?))).map_err(failed)?;
            }
            writer.flush().map_err(|e| Error::io(path, "write", e))
        })
    }

    /// Writes the rows as Parquet. A column of whole numbers is INT64, of numbers DOUBLE, else text.
    pub fn write_parquet(
        &self,
        path: &Path,
        rows: impl Iterator<Item = Result<Value>>,
    ) -> Result<()> {
        let failed = |e| Error::io(path, "write", e);
        let kinds: Vec<Kind> = self.kinds.iter().map(|k| k.unwrap_or(Kind::Text)).collect();
        let columns = self.names.iter().cloned().zip(kinds.iter().copied()).collect();
        write_streamed(path, |file| {
            let mut writer = Writer::new(BufWriter::new(file), columns).map_err(failed)?;
            for row in rows {
                let row = row?;
                let mut cells = vec![None; kinds.len()];
                for (name, value) in flatten(&row) {
                    if let Some(&i) = self.index.get(&name) {
                        cells[i] = cell(value, kinds[i]);
                    }
                }
                writer.row(cells).map_err(failed)?;
            }
            writer.finish().and_then(|mut sink| sink.flush()).map_err(failed)
        })
    }
}

fn kind(value: &Value) -> Option<Kind> {
    match value {
        Value::Bool(_) => Some(Kind::Boolean),
        Value::Number(n) if n.is_i64() => Some(Kind::Integer),
        Value::Number(_) => Some(Kind::Double),
        Value::String(_) => Some(Kind::Text),
        _ => None,
    }
}

fn cell(value: &Value, kind: Kind) -> Option<Cell> {
    match (value, kind) {
        (Value::Null | Value::Array(_) | Value::Object(_), _) => None,
        (Value::Bool(b), Kind::Boolean) => Some(Cell::Boolean(*b)),
        (Value::Number(n), Kind::Integer) => n.as_i64().map(Cell::Integer),
        (Value::Number(n), Kind::Double) => n.as_f64().map(Cell::Double),
        (Value::String(text), _) => Some(Cell::Text(text.clone())),
        (other, _) => Some(Cell::Text(other.to_string())),
    }
}
