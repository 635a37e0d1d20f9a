//! Checks of a machine file: what no machine can have, with the field's name and what to write instead.

use crate::machine::axis::AxisName;
use crate::machine::data_kind::DataKind;
use crate::machine::file::{AxisEntry, Effect, Head, Machine};

/// Field, what is wrong with it, and what to do.
type Check = std::result::Result<(), (String, String, &'static str)>;

/// What a stand-off is.
pub(crate) const FOCUS: &str =
    "give the distance from the nozzle's end face down to the focus, in mm";

impl Machine {
    /// The first thing in the file that cannot be.
    pub(super) fn check(&self) -> Check {
        if self.schema != 1 {
            return Err((
                "schema".into(),
                format!("is {}, this program reads 1", self.schema),
                "use a matching version",
            ));
        }
        sense("c_sense".into(), self.c_sense)?;
        if self.c_sense != 1 && !self.table_order().contains('C') {
            return Err((
                "c_sense".into(),
                "is for a C axis in the table, and this machine has none".into(),
                "leave it out, or give the axis' sense in [axes.C]",
            ));
        }
        let Head { delta_x_mm, r_mm, standoff_mm } = self.head;
        finite("head", &[delta_x_mm, r_mm, standoff_mm])?;
        if r_mm < 0.0 {
            let reason = format!("is {r_mm}: the nozzle would be above the B axis");
            return Err((
                "head.r_mm".into(),
                reason,
                "give the distance from the B axis down to the nozzle",
            ));
        }
        if r_mm > 0.0 && r_mm + standoff_mm <= 0.0 {
            let reason = format!("is {standoff_mm}: the focus would be above the B axis");
            return Err(("head.standoff_mm".into(), reason, FOCUS));
        }
        finite("table", self.table_point().as_slice())?;
        if let Some(target) = &self.target {
            finite("target.position_mm", &target.position_mm)?;
        }
        self.axes.iter().try_for_each(|(name, entry)| self.check_axis(name, entry))?;
        self.effects.iter().try_for_each(check_effect)
    }

    /// The part of the order that carries the work.
    fn table_order(&self) -> &str {
        self.kinematics.order.split('b').next().unwrap_or("")
    }

    /// One axis' entry, and whether its name is one.
    fn check_axis(&self, name: &str, entry: &AxisEntry) -> Check {
        let axis = name.chars().next().filter(|_| name.len() == 1).and_then(AxisName::from_letter);
        let Some(axis) = axis else {
            return Err((format!("axes.{name}"), "is no axis".into(), "use one of X Y Z A B C"));
        };
        self.check_entry(axis, entry)?;
        if let Some(point) = entry.point_mm {
            finite(&format!("axes.{name}.point_mm"), &point)?;
        }
        if let Some(value) = entry.sense {
            sense(format!("axes.{name}.sense"), value)?;
        }
        Ok(())
    }

    fn check_entry(&self, axis: AxisName, entry: &AxisEntry) -> Check {
        let misplaced = |key: &str, fix: &'static str| {
            Err((format!("axes.{axis}.{key}"), "does not belong here".into(), fix))
        };
        if axis.is_rotary() && entry.limits_mm.is_some() {
            return misplaced("limits_mm", "give a rotary axis' limits as limits_deg");
        }
        if !axis.is_rotary()
            && (entry.limits_deg.is_some() || entry.point_mm.is_some() || entry.sense.is_some())
        {
            return misplaced(
                "limits_deg, point_mm or sense",
                "a linear axis takes direction and limits_mm",
            );
        }
        let table_c = axis == AxisName::C && self.table_order().contains('C');
        if table_c && entry.sense.is_some() {
            return misplaced("sense", "give c_sense at the top of the file instead");
        }
        for limits in [entry.limits_mm, entry.limits_deg].into_iter().flatten() {
            if limits[0].is_nan() || limits[1].is_nan() || limits[0] >= limits[1] {
                return Err((
                    format!("axes.{axis}: limits"),
                    format!("{limits:?} are not in rising order"),
                    "write [least, largest]",
                ));
            }
        }
        Ok(())
    }
}

fn sense(field: String, value: i32) -> Check {
    match value {
        1 | -1 => Ok(()),
        other => Err((field, format!("is {other}"), "write 1 or -1")),
    }
}

fn finite(field: &str, values: &[f64]) -> Check {
    if values.iter().all(|v| v.is_finite() && v.abs() < 1e6) {
        return Ok(());
    }
    let reason = format!("{values:?} is not a length in mm");
    Err((field.to_owned(), reason, "give finite numbers in mm"))
}

fn check_effect(effect: &Effect) -> Check {
    if let Some((key, _)) = effect.parameters.iter().find(|(_, v)| !v.is_finite()) {
        return Err((
            format!("effects '{}': {key}", effect.name),
            "is not finite".into(),
            "give a number",
        ));
    }
    let unsure = |(_, u): &(&String, &f64)| !(u.is_finite() && **u >= 0.0);
    if let Some((key, u)) = effect.parameters_u95.iter().find(unsure) {
        return Err((
            format!("effects '{}': parameters_u95 {key}", effect.name),
            format!("is {u}"),
            "give the half-width of the 95 % interval, zero or more",
        ));
    }
    if let Some(kind) = effect.kind.as_ref().filter(|k| !DataKind::has(k)) {
        return Err((
            format!("effects '{}': kind", effect.name),
            format!("is '{kind}', no kind of data"),
            DataKind::FIX,
        ));
    }
    Ok(())
}
