//! What a session file says of the rod, and the result of `rod` that it may name.

use std::path::Path;

use crate::error::Result;
use crate::rtcp::results::{OffAxis, RodResult};
use crate::rtcp::session_file::{Checks, OneOrTwo, Rod};
use crate::rtcp::session_reader::{DEFAULT_U_MM, Reader};
use crate::uncertainty::{K95, Measured};
use crate::units;

/// What is known of the rod.
pub(super) struct RodSeen {
    pub axis_center_mm: [Measured; 2],
    pub axis_from_seen_mm: Measured,
    pub rod_offset_mm: Measured,
    pub offset_follows: [f64; 2],
    pub diameter_mm: Measured,
}

/// The centre that was seen or is given, and what is told with it.
struct Centre {
    mm: [f64; 2],
    u_mm: [f64; 2],
    /// Whether it is the rod's and not the C axis.
    is_rods: bool,
    /// The rod's centre off it along X during the touches, where that is known.
    offset: Option<OffAxis>,
    eccentricity_mm: Option<f64>,
    diameter_mm: Option<Measured>,
}

impl Reader<'_> {
    /// The C axis, the rod's centre off it along X during the touches, and the rod's diameter.
    pub(super) fn rod(
        &mut self,
        rod: &Rod,
        touches: (Option<f64>, i32),
        checks: &Checks,
    ) -> Result<RodSeen> {
        let eccentricity_mm = match rod.eccentricity_mm {
            Some(e) => Some(self.uncertainty("rod.eccentricity_mm", e)?),
            None => None,
        };
        let centre = match (&rod.result, rod.center_mm) {
            (Some(file), None) => self.seen(file, eccentricity_mm, touches, checks)?,
            (None, Some(mm)) => Centre {
                mm,
                u_mm: rod.center_u_mm.map(OneOrTwo::pair).unwrap_or_else(|| {
                    self.assumed("rod.center");
                    [DEFAULT_U_MM; 2]
                }),
                // A centre with an eccentricity beside it is the rod's.
                is_rods: eccentricity_mm.is_some(),
                offset: None,
                eccentricity_mm,
                diameter_mm: None,
            },
            _ => {
                let reason = "needs either result or center_mm";
                return Err(self.wrong(
                    "rod",
                    reason,
                    "give result = \"rod.json\" or center_mm = [x, y]",
                ));
            }
        };
        let mut axis = [Measured::default(); 2];
        for (i, axis) in axis.iter_mut().enumerate() {
            axis.value = self.length("rod.center_mm", centre.mm[i])?;
            axis.u = self.uncertainty("rod.center_u_mm", centre.u_mm[i])?;
        }
        let diameter_mm = self.diameter(rod, centre.diameter_mm)?;
        let is_rods = centre.is_rods;
        let e = centre.eccentricity_mm.or(checks.rod_runout_mm.map(|r| r / 2.0));
        let e = e.unwrap_or_else(|| self.allowed_eccentricity(is_rods, checks));
        // Where its angle is not known a rod's centre may lie anywhere on its small circle.
        let anywhere = Measured { value: 0.0, u: e / std::f64::consts::SQRT_2 };
        // From one place on that circle to another.
        let turned = Measured { value: 0.0, u: e };
        let unseen = || OffAxis::alone(if is_rods { turned } else { anywhere });
        let OffAxis { offset_mm: rod_offset_mm, follows: offset_follows } =
            centre.offset.unwrap_or_else(unseen);
        Ok(RodSeen {
            axis_center_mm: axis,
            axis_from_seen_mm: if is_rods { anywhere } else { Measured::default() },
            rod_offset_mm,
            offset_follows,
            diameter_mm,
        })
    }

    /// What the pictures show of it.
    fn seen(
        &mut self,
        file: &Path,
        given_mm: Option<f64>,
        (touch_c_deg, c_sense): (Option<f64>, i32),
        checks: &Checks,
    ) -> Result<Centre> {
        let result = RodResult::read(&self.beside(file))?;
        self.warnings.extend(result.warnings.iter().map(|w| format!("S2, rod: {w}")));
        self.warnings.extend(runs_out(&result, checks));
        let offset = touch_c_deg.and_then(|c| result.offset_at(c, c_sense));
        if let (Some(c), None) = (touch_c_deg, offset) {
            self.warnings.push(format!(
                "S2, rod: it was not seen at touch.c_deg = {c} and what was seen does not tell where it stood: its eccentricity counts as uncertainty"
            ));
        }
        let mut eccentricity_mm = given_mm;
        if result.rod_centers.len() > 1 {
            eccentricity_mm = given_mm.or(result.eccentricity_mm);
            self.run_out = result.run_out();
            if touch_c_deg.is_none() && self.run_out.is_some_and(|r| r.value > checks.tolerance_mm)
            {
                self.warnings.push(
                    "touch.c_deg is not given: where the rod stood during the touches is not known, and all its eccentricity is in ΔX's interval"
                        .into(),
                );
            }
        }
        Ok(Centre {
            mm: result.axis_center_mm,
            u_mm: result.axis_center_u95_mm.pair().map(|u| u / K95),
            is_rods: result.is_rods(),
            offset,
            eccentricity_mm,
            diameter_mm: result.diameter_mm.map(|value| Measured {
                value,
                u: result.diameter_u95_mm.map_or(DEFAULT_U_MM, |u| u / K95),
            }),
        })
    }

    /// The rod's diameter: as given, else as the camera measured it.
    fn diameter(&mut self, rod: &Rod, seen: Option<Measured>) -> Result<Measured> {
        let given = match rod.diameter_mm {
            Some(_) => Some(self.given("rod.diameter", rod.diameter_mm, rod.diameter_u_mm)?),
            None => None,
        };
        if let (Some(given), Some(seen)) = (given, seen)
            && (seen.value - given.value).abs() > 3.0 * seen.u.hypot(given.u)
        {
            self.warnings.push(format!(
                "the camera measures a diameter of {:.4} mm, diameter_mm says {:.4} mm: is it the same rod?",
                seen.value, given.value
            ));
        }
        let diameter = given.or(seen);
        let Some(diameter) = diameter.filter(|d| d.value > 0.0) else {
            let reason = diameter.map_or("is missing".to_owned(), |d| format!("is {}", d.value));
            return Err(self.wrong("rod.diameter_mm", reason, "give the rod's diameter in mm"));
        };
        self.warnings.extend(units::rod("rod.diameter_mm", diameter.value));
        Ok(diameter)
    }

    /// How eccentric a rod may be to the C axis of which nothing tells it.
    fn allowed_eccentricity(&mut self, is_rods: bool, checks: &Checks) -> f64 {
        if !is_rods {
            return 0.0;
        }
        let allowed = checks.tolerance_mm / 2.0;
        self.warnings.push(format!(
            "S2, rod: nothing tells how eccentric it is to the C axis: {allowed} mm is taken, half the run-out that is allowed; \
             see it at two C angles or more, or give checks.rod_runout_mm"
        ));
        allowed
    }
}

/// What the pictures say against the run-out that was read: they see half of it as eccentricity.
fn runs_out(seen: &RodResult, checks: &Checks) -> Option<String> {
    let (run_out, read) = (seen.run_out()?, checks.rod_runout_mm?);
    let apart = (run_out.value - read).abs();
    (apart > K95 * run_out.u.hypot(checks.indicator_u_mm)).then(|| {
        format!(
            "S2, rod: the pictures see a run-out of {:.4} ± {:.4} mm, checks.rod_runout_mm says {read} mm: was it the same rod, clamped alike?",
            run_out.value,
            run_out.u95()
        )
    })
}
