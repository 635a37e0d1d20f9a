//! From a session file to the numbers to solve: checks, defaults, results of other files.

use std::path::Path;

use nalgebra::{Matrix2, Vector2};

use crate::error::{Error, Result};
use crate::machine::{Head, Machine, Table};
use crate::rtcp::results::BurnResult;
use crate::rtcp::session::{InControl, Limit, Session};
use crate::rtcp::session_file::{Burn, Control, File, Touch};
use crate::rtcp::session_rod::RodSeen;
use crate::rtcp::solve::Readings;
use crate::uncertainty::{K95, Measured, distance};
use crate::units;

/// Standard uncertainty taken for a length whose own is not given, mm.
pub(super) const DEFAULT_U_MM: f64 = 0.005;

/// A standard uncertainty of B's zero beyond this is a slip: the head would stand visibly askew.
const MOST_B_ZERO_U_DEG: f64 = 5.0;

/// Turns the file into numbers, noting what had to be assumed.
pub(super) struct Reader<'a> {
    pub(super) path: &'a Path,
    pub(super) warnings: Vec<String>,
    /// The rod's run-out, where pictures at several table angles show it.
    pub(super) run_out: Option<Measured>,
}

/// What S2 calls it.
const RUN_OUT: &str = "rod run-out over a turn of C";

impl<'a> Reader<'a> {
    pub(super) fn new(path: &'a Path) -> Self {
        Self { path, warnings: Vec::new(), run_out: None }
    }

    pub(super) fn session(&mut self, file: File) -> Result<Session> {
        if let Some(schema) = file.schema.filter(|&s| s != 1) {
            let reason = format!("is {schema}, this program reads 1");
            return Err(self.wrong("schema", reason, "use a matching version"));
        }
        if file.c_sense.abs() != 1 {
            return Err(self.wrong("c_sense", format!("is {}", file.c_sense), "write 1 or -1"));
        }
        let (mut limits, mut unchecked) = (Vec::new(), Vec::new());
        let b_zero_u_rad = self.b_zero(file.burn.as_ref(), &file.touch, &mut limits)?;
        let indicator = file.checks.indicator_u_mm;
        self.uncertainty("checks.tolerance_mm", file.checks.tolerance_mm)?;
        self.warnings.extend(units::limit("checks.tolerance_mm", file.checks.tolerance_mm));
        self.warnings.extend(units::standoff("head.standoff_mm", file.head.standoff_mm));
        for (what, key, value) in [
            ("rod parallel to Z", "checks.rod_parallel_mm", file.checks.rod_parallel_mm),
            (RUN_OUT, "checks.rod_runout_mm", file.checks.rod_runout_mm),
        ] {
            if let Some(value) = value {
                let value = Measured {
                    value: self.uncertainty(key, value)?,
                    u: self.uncertainty("checks.indicator_u_mm", indicator)?,
                };
                limits.push(Limit::new("S2", what, value, file.checks.tolerance_mm));
            } else {
                unchecked.push(what);
            }
        }
        let readings = self.readings(&file, b_zero_u_rad)?;
        if let Some(seen) = self.run_out.filter(|_| unchecked.contains(&RUN_OUT)) {
            unchecked.retain(|what| *what != RUN_OUT);
            limits.push(Limit::new("S2", RUN_OUT, seen, file.checks.tolerance_mm));
        }
        let not_checked = |what| format!("S2: {what} is not in [checks]: not checked");
        self.warnings.extend(unchecked.into_iter().map(not_checked));
        if file.head.standoff_mm == 0.0 {
            self.warnings.push(
                "head.standoff_mm is zero or not given: R + stand-off is the distance to the nozzle's face, not to the focus".into(),
            );
        }
        let standoff_mm = Measured {
            value: self.length("head.standoff_mm", file.head.standoff_mm)?,
            u: self.uncertainty("head.standoff_u_mm", file.head.standoff_u_mm)?,
        };
        let control = file.control.as_ref().map(|c| self.control(c, file.c_sense)).transpose()?;
        Ok(Session {
            name: file.name,
            c_sense: file.c_sense,
            readings,
            standoff_mm,
            limits,
            control,
            warnings: Vec::new(),
            files: Vec::new(),
        })
    }

    /// How well B's zero is known, from the burn test or as given.
    fn b_zero(
        &mut self,
        burn: Option<&Burn>,
        touch: &Touch,
        limits: &mut Vec<Limit>,
    ) -> Result<f64> {
        let mut from_burn = None;
        if let Some(burn) = burn {
            let (offset, covariance) = self.burn_offset(burn)?;
            let (value, u95) = distance(offset, covariance, f64::INFINITY);
            let value = Measured { value, u: u95 / K95 };
            self.uncertainty("burn.tolerance_mm", burn.tolerance_mm)?;
            self.warnings.extend(units::limit("burn.tolerance_mm", burn.tolerance_mm));
            limits.push(Limit::new(
                "S1",
                "concentricity of ring and spot",
                value,
                burn.tolerance_mm,
            ));
            let height = burn.ring_height_mm - burn.spot_height_mm;
            if !(height.is_finite() && height > 0.0) {
                let fix = "give ring_height_mm above spot_height_mm, in mm";
                return Err(self.wrong("burn", "the ring is not burnt higher than the spot", fix));
            }
            self.warnings.extend(units::height("burn.ring_height_mm", burn.ring_height_mm));
            if !(1.0..=5.0).contains(&burn.spot_height_mm) {
                self.warnings.push(format!(
                    "S1: the spot was burnt at {} mm, the method asks for 1 to 5 mm",
                    burn.spot_height_mm
                ));
            }
            // What is left of the tilt is not corrected, so it counts as uncertainty.
            from_burn = Some((offset.x.hypot(covariance[(0, 0)].sqrt()) / height).atan());
        }
        match (touch.b_zero_u_deg, from_burn) {
            (Some(u), _) => {
                let u = self.uncertainty("touch.b_zero_u_deg", u)?;
                if u > MOST_B_ZERO_U_DEG {
                    let fix =
                        "set B to zero by a burn test first, or correct the number (in degrees)";
                    return Err(self.wrong(
                        "touch.b_zero_u_deg",
                        format!("is {u}: such a B zero is not known"),
                        fix,
                    ));
                }
                Ok(u.to_radians())
            }
            (None, Some(u)) => Ok(u),
            (None, None) => {
                self.warnings.push(
                    "S1: no [burn] and no touch.b_zero_u_deg: B's zero is taken as good to 0.01 mm in 47 mm".into(),
                );
                // Anywhere within the limit alike.
                Ok((0.01_f64 / 47.0).atan() / 3f64.sqrt())
            }
        }
    }

    /// Offset and its covariance, mm and mm².
    fn burn_offset(&mut self, burn: &Burn) -> Result<(Vector2<f64>, Matrix2<f64>)> {
        let (offset, u, correlation) = match (&burn.result, burn.offset_mm) {
            (Some(file), None) => {
                let result = BurnResult::read(&self.beside(file), &mut self.warnings)?;
                let correlation = result.offset_cov_mm2.map_or(0.0, |[[xx, xy], [_, yy]]| {
                    if xx * yy > 0.0 { (xy / (xx * yy).sqrt()).clamp(-1.0, 1.0) } else { 0.0 }
                });
                (result.offset_mm, result.offset_u95_mm.map(|u| u / K95), correlation)
            }
            (None, Some(offset)) => {
                let u = match burn.offset_u_mm {
                    Some(u) => u.pair(),
                    None => {
                        self.assumed("burn.offset");
                        [DEFAULT_U_MM; 2]
                    }
                };
                (offset, u, 0.0)
            }
            _ => {
                let reason = "needs either result or offset_mm";
                return Err(self.wrong(
                    "burn",
                    reason,
                    "give result = \"burn.json\" or offset_mm = [x, y]",
                ));
            }
        };
        for i in 0..2 {
            self.length("burn.offset_mm", offset[i])?;
            self.uncertainty("burn.offset_u_mm", u[i])?;
        }
        let xy = correlation * u[0] * u[1];
        Ok((offset.into(), Matrix2::new(u[0] * u[0], xy, xy, u[1] * u[1])))
    }

    fn readings(&mut self, file: &File, b_zero_u_rad: f64) -> Result<Readings> {
        let touch = &file.touch;
        let rod = self.rod(&file.rod, (touch.c_deg, file.c_sense), &file.checks)?;
        let RodSeen { axis_center_mm, axis_from_seen_mm, .. } = rod;
        let rim = touch.nozzle_rim_radius_mm.unwrap_or_else(|| {
            self.warnings.push(
                "touch.nozzle_rim_radius_mm is not given: a nozzle not square to the rod is taken to touch with its middle"
                    .into(),
            );
            0.0
        });
        let check_touch = match touch.x45_mm {
            Some(x) => {
                let b = self.angle("touch.b45_deg", touch.b45_deg)?;
                Some((b, self.given("touch.x45", Some(x), touch.x45_u_mm)?))
            }
            None => None,
        };
        Ok(Readings {
            axis_center_mm,
            axis_from_seen_mm,
            rod_offset_mm: rod.rod_offset_mm,
            offset_follows: rod.offset_follows,
            diameter_mm: rod.diameter_mm,
            x1_mm: self.given("touch.x1", Some(touch.x1_mm), touch.x1_u_mm)?,
            x2_mm: self.given("touch.x2", Some(touch.x2_mm), touch.x2_u_mm)?,
            z_table_mm: self.given("touch.z_table", Some(touch.z_table_mm), touch.z_table_u_mm)?,
            b1_rad: self.angle("touch.b1_deg", touch.b1_deg)?,
            b2_rad: self.angle("touch.b2_deg", touch.b2_deg)?,
            check_touch,
            b_zero_u_rad,
            b_position_u_rad: self
                .uncertainty("touch.b_position_u_deg", touch.b_position_u_deg)?
                .to_radians(),
            nozzle_rim_radius_mm: self.uncertainty("touch.nozzle_rim_radius_mm", rim)?,
        })
    }

    /// The machine as the control holds it now.
    fn control(&mut self, control: &Control, c_sense: i32) -> Result<InControl> {
        let Control { machine: file, delta_x_mm, r_mm, xc_mm, yc_mm, zc_mm } = control;
        let mut machine = match file {
            Some(file) => Machine::read(self.beside(file))?,
            None if r_mm.is_none() || delta_x_mm.is_none() => {
                let fix = "give machine = \"old.toml\" or delta_x_mm and r_mm";
                return Err(self.wrong("control", "does not hold both delta_x_mm and r_mm", fix));
            }
            None => {
                Machine { c_sense, ..Machine::head_b_table_c(Head::default(), Table::default()) }
            }
        };
        let mut untold = Vec::new();
        for (name, place, value) in [
            ("delta_x_mm", &mut machine.head.delta_x_mm, delta_x_mm),
            ("r_mm", &mut machine.head.r_mm, r_mm),
            ("xc_mm", &mut machine.table.xc_mm, xc_mm),
            ("yc_mm", &mut machine.table.yc_mm, yc_mm),
            ("zc_mm", &mut machine.table.zc_mm, zc_mm),
        ] {
            match value {
                Some(value) => *place = self.length(&format!("control.{name}"), *value)?,
                None if file.is_none() => untold.push(name),
                None => {}
            }
        }
        self.warnings.extend(machine.doubts());
        Ok(InControl { machine, untold, from_file: file.is_some() })
    }

    pub(super) fn given(
        &mut self,
        key: &str,
        value: Option<f64>,
        u: Option<f64>,
    ) -> Result<Measured> {
        let value = self.length(&format!("{key}_mm"), value.unwrap_or(f64::NAN))?;
        let u = u.unwrap_or_else(|| {
            self.assumed(key);
            DEFAULT_U_MM
        });
        let key = format!("{key}_u_mm");
        self.warnings.extend(units::uncertainty(&key, u));
        Ok(Measured { value, u: self.uncertainty(&key, u)? })
    }

    pub(super) fn assumed(&mut self, key: &str) {
        self.warnings.push(format!("{key}_u_mm is not given: {DEFAULT_U_MM} mm is taken"));
    }

    pub(super) fn length(&self, key: &str, value: f64) -> Result<f64> {
        let usable = value.is_finite() && value.abs() < 1e6;
        let fail = || self.wrong(key, format!("is {value}"), "give a finite length in mm");
        usable.then_some(value).ok_or_else(fail)
    }

    pub(super) fn uncertainty(&self, key: &str, value: f64) -> Result<f64> {
        let fail = || self.wrong(key, format!("is {value}"), "give a finite number, zero or more");
        (value.is_finite() && value >= 0.0).then_some(value).ok_or_else(fail)
    }

    fn angle(&self, key: &str, value: f64) -> Result<f64> {
        let fail = || self.wrong(key, format!("is {value}"), "give an angle in degrees");
        (value.is_finite() && value.abs() <= 180.0).then_some(value.to_radians()).ok_or_else(fail)
    }

    pub(super) fn wrong(&self, key: &str, reason: impl Into<String>, fix: &str) -> Error {
        Error::field(self.path, None, key, reason, fix)
    }

    /// A path in the file is seen from the file's folder.
    pub(super) fn beside(&self, file: &Path) -> std::path::PathBuf {
        self.path.parent().map_or_else(|| file.to_owned(), |folder| folder.join(file))
    }
}
