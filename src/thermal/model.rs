//! The model file: what `fit` found, in JSON, and what `compensate` reads.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{head, screw};
use crate::earlier::Earlier;
use crate::error::{Error, Result};
use crate::plot::{Figure, Panel};

/// Head and screws together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// The cutting head, where it was calibrated.
    pub head: Option<head::Head>,
    /// Axes the head's displacement acts on; empty: all, as the source has it.
    pub head_axes: Vec<String>,
    /// The screws.
    pub screws: Vec<screw::Screw>,
}

/// Fits what there is data for; warnings go to `warnings`.
pub fn fit(
    head: Option<(&head::Data, &head::Options)>,
    screws: Option<(&screw::Data, &screw::Options)>,
    head_axes: Vec<String>,
    warnings: &mut Vec<String>,
) -> Result<Model> {
    let head = head.map(|(data, options)| head::fit(data, options, warnings)).transpose()?;
    let screws = screws.map(|(data, options)| screw::fit(data, options, warnings)).transpose()?;
    let screws = screws.unwrap_or_default();
    let known = |a: &String| screws.iter().any(|s| s.axis == *a);
    if let Some(name) = head_axes.iter().find(|a| !screws.is_empty() && !known(a)) {
        return Err(Error::option(
            "--head-axes",
            format!("there is no axis '{name}' in the data"),
            "correct the name",
        ));
    }
    Ok(Model { head, head_axes, screws })
}

impl Model {
    /// Reads a model file: the JSON result of `thermal fit`.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let file = Earlier {
            path: path.as_ref(),
            command: "thermal-fit",
            fix: "give the file that `thermal fit --out` wrote",
        };
        let model: Self = file.result()?;
        if let Some(head) = &model.head {
            let numbered = head.coefficients.iter().all(|c| (1..=head.sensors).contains(&c.sensor));
            if !numbered || !head.sums.valid(head.sensors) {
                return Err(file.wrong("the head's sensors and sums do not fit together"));
            }
        }
        for s in &model.screws {
            let [low, high] = s.range_mm;
            if !(s.t_max_c > s.t0_c && high >= low && s.noise_mm >= 0.0 && s.dof > 0.0) {
                return Err(file.wrong(format!(
                    "axis '{}': t_max_c must lie above t0_c, range_mm must rise, noise_mm and dof must not be negative",
                    s.axis
                )));
            }
        }
        Ok(model)
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let mut out = String::new();
        if let Some(h) = &self.head {
            out.push_str("head: displacement = sum of\n  sensor     mm/°C        ±95 %      calibrated rise °C\n");
            for c in &h.coefficients {
                out.push_str(&format!(
                    "  {:6} {:+9.6} {:12.6}      {:.1} to {:.1}\n",
                    c.sensor, c.mm_per_c, c.mm_per_c_u95, c.range_c[0], c.range_c[1]
                ));
            }
            if h.has_constant {
                out.push_str(&format!("  and a constant of {:+.5} mm\n", h.constant_mm));
            }
            out.push_str(&format!(
                "  {} of {} sensors; rms {:.4} mm before, {:.4} mm after, {:.4} mm on rows not seen\n",
                h.coefficients.len(),
                h.sensors,
                h.before_rms_mm,
                h.after_rms_mm,
                h.held_out_rms_mm
            ));
        }
        for s in &self.screws {
            out.push_str(&format!(
                "axis {}: T0 {:.2} ±{:.2} °C, T_max {:.2} °C, Tk_max {:+.3} ±{:.3} µm/m, P0 {:.1} ±{:.1} mm; \
                 rms {:.4} mm before, {:.4} mm after\n",
                s.axis,
                s.t0_c,
                s.t0_u95_c,
                s.t_max_c,
                s.tk_max_um_per_m,
                s.tk_max_u95_um_per_m,
                s.p0_mm,
                s.p0_u95_mm,
                s.before_rms_mm,
                s.after_rms_mm
            ));
            for l in &s.slopes {
                out.push_str(&format!(
                    "  {:6.2} °C: {:+9.3} ±{:.3} µm/m\n",
                    l.screw_c, l.slope_um_per_m, l.slope_u95_um_per_m
                ));
            }
        }
        out
    }

    /// The slopes against temperature with the law through them.
    pub fn figure(&self) -> Figure {
        let mut panel = Panel::new("screw temperature, °C", "slope of the position error, µm/m");
        for s in &self.screws {
            let dots: Vec<_> = s
                .slopes
                .iter()
                .map(|l| (l.screw_c, l.slope_um_per_m, l.slope_u95_um_per_m))
                .collect();
            panel = panel
                .points_with_bars(format!("{}, ±95 %", s.axis), &dots)
                .line(format!("{} law", s.axis), &[(s.t0_c, 0.0), (s.t_max_c, s.tk_max_um_per_m)]);
        }
        Figure::new("Screw slopes").panel(panel)
    }
}
