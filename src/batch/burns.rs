//! Burns whose heights, powers and head angles a manifest tells: data for `pivotsight diagnose burn`.

use serde_json::{Map, Value};

use crate::error::{Error, Result};
use crate::measure::burn;
use crate::table::Table;
use crate::units;

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
    told.into_iter().map(|name| Ok((name.to_owned(), known(table, row, name)?.into()))).collect()
}

/// A cell that a burn can have.
fn known(table: &Table, row: usize, name: &str) -> Result<f64> {
    let value = table.number(row, name)?;
    let fix = match name {
        "height_mm" => "give how much higher the ring was burnt than the spot, in mm",
        "power_w" => "give the power the ring was burnt with, in W",
        _ => return Ok(value),
    };
    if value > 0.0 {
        return Ok(value);
    }
    Err(table.error(row, name, format!("{value} is not a number above 0"), fix))
}

/// How much higher the ring was burnt than the spot, where the manifest tells.
fn height_mm(burnt: &Burnt) -> Option<f64> {
    burnt.get("height_mm")?.as_f64()
}

/// A job's options at the height that the manifest tells of one burn: it knows better than the job, which holds for all.
pub(super) fn at_height(job: &burn::Options, burnt: &Burnt) -> burn::Options {
    let ring_height_mm =
        height_mm(burnt).map_or(job.ring_height_mm, |height| job.spot_height_mm + height);
    burn::Options { ring_height_mm, ..job.clone() }
}

/// A height of a manifest's row that looks as if it were in another unit.
pub(super) fn doubt(table: &Table, row: usize, burnt: &Burnt) -> Option<String> {
    let place = format!("{}:{}: column 'height_mm'", table.path().display(), table.line(row));
    units::height(&place, height_mm(burnt)?)
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
