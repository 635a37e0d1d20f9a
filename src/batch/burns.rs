//! Burns whose heights, powers and head angles a manifest tells: data for `pivotsight diagnose burn`.

use serde_json::{Map, Value};

use crate::error::{Error, Result};
use crate::table::Table;

/// The table of such burns in a batch's folder.
pub(super) const FILE: &str = "burns.csv";

/// How a burn was made, as a manifest tells it: needed together, and possible besides.
const NEEDED: [&str; 3] = ["height_mm", "power_w", "b_deg"];
const POSSIBLE: [&str; 2] = ["t_s", "temp_c"];

/// How one burn was made, by column; empty where the manifest does not tell.
pub(super) type Burnt = Map<String, Value>;

/// The columns of a manifest that tell it.
pub(super) fn columns() -> impl Iterator<Item = &'static str> {
    NEEDED.into_iter().chain(POSSIBLE)
}

/// How the burn of a manifest's row was made.
pub(super) fn made(table: &Table, row: usize) -> Result<Burnt> {
    let told: Vec<&str> = columns().filter(|name| table.has(name)).collect();
    if told.is_empty() {
        return Ok(Burnt::new());
    }
    if let Some(name) = NEEDED.iter().find(|name| !table.has(name)) {
        let fix = "give height_mm, power_w and b_deg of every burn, or none of them";
        return Err(Error::field(
            table.path(),
            None,
            format!("column '{name}'"),
            "is missing",
            fix,
        ));
    }
    told.into_iter().map(|name| Ok((name.to_owned(), table.number(row, name)?.into()))).collect()
}

/// A row of the table: how a burn was made, what was measured of it, and its picture. `None` where one of them is not known.
pub(super) fn row(name: &str, burnt: &Burnt, result: &Value) -> Option<Value> {
    let offset = &result["offset_mm"];
    let known = !burnt.is_empty() && offset[0].is_number() && offset[1].is_number();
    known.then(|| {
        let mut row = burnt.clone();
        row.insert("dx_mm".into(), offset[0].clone());
        row.insert("dy_mm".into(), offset[1].clone());
        row.insert("x_image".into(), name.into());
        Value::Object(row)
    })
}
