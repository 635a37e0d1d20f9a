//! What `solve` hands back: the control's numbers with uncertainty, limits, and what typing them in changes.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;

use super::solve::Solved;
use super::{InControl, Limit, Session, deviation};
use crate::error::{Error, Result};
use crate::machine::{FOCUS, Machine};
use crate::uncertainty::{Contribution, Measured, Verdict};

/// B angles at which a change of the control's values is shown.
const SHOWN_DEG: [f64; 6] = [-90.0, -45.0, -30.0, 30.0, 45.0, 90.0];

/// The result of `solve`. `*_u95_mm` are half-widths of 95 % intervals.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Solution {
    /// Machine X where the B axis is over the rod.
    pub xb_mm: f64,
    /// Of `xb_mm`.
    pub xb_u95_mm: f64,
    /// Machine Z where the nozzle touches the table.
    pub zb_mm: f64,
    /// Of `zb_mm`.
    pub zb_u95_mm: f64,
    /// The C axis' machine X.
    pub xc_mm: f64,
    /// Of `xc_mm`.
    pub xc_u95_mm: f64,
    /// The C axis' machine Y.
    pub yc_mm: f64,
    /// Of `yc_mm`.
    pub yc_u95_mm: f64,
    /// From the B axis to the optical axis, along X.
    pub delta_x_mm: f64,
    /// Of `delta_x_mm`.
    pub delta_x_u95_mm: f64,
    /// From the B axis to the nozzle's end face.
    pub r_mm: f64,
    /// Of `r_mm`.
    pub r_u95_mm: f64,
    /// From the B axis to the focus.
    pub r_focus_mm: f64,
    /// Of `r_focus_mm`.
    pub r_focus_u95_mm: f64,
    /// Tool side, pivot to nozzle.
    pub i1_mm: [f64; 3],
    /// Nozzle to pivot.
    pub i2_mm: [f64; 3],
    /// Machine reference to C axis.
    pub i3_mm: [f64; 3],
    /// Back again.
    pub i4_mm: [f64; 3],
    /// +1 where a positive B turns the nozzle towards -X, -1 where towards +X.
    pub b_sense: i32,
    /// The worst of the limits and the check touch, where any was checked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// Limits of the method, and whether they are kept.
    pub limits: Vec<Limit>,
    /// The third touch against what the others predict.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub check_touch: Option<CheckTouch>,
    /// What typing the values in changes, where the present ones are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change: Option<Change>,
    /// What contributes how much to the uncertainty.
    pub budget: Vec<Contribution>,
}

/// The third touch.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct CheckTouch {
    /// The head's angle at the touch.
    pub b_deg: f64,
    /// Machine X of the touch.
    pub measured_mm: f64,
    /// What the two other touches say it should be.
    pub predicted_mm: f64,
    /// Measured minus predicted.
    pub difference_mm: f64,
    /// Half-width of its 95 % interval.
    pub difference_u95_mm: f64,
    /// Largest difference that passes: three standard uncertainties, a micrometre at least.
    pub limit_mm: f64,
    /// Whether they agree.
    pub verdict: Verdict,
}

/// What typing the new values into the control changes.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Change {
    /// Value by value, as far as it is told what the control holds.
    pub values: Vec<Replaced>,
    /// How far the tool point goes astray with the present values, seen from B = 0.
    pub removes: Vec<Astray>,
}

/// A value now and then.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Replaced {
    /// The value's name, which ends in its unit.
    pub name: &'static str,
    /// What the control holds.
    pub now: f64,
    /// What to type in.
    pub new: f64,
    /// New minus now.
    pub change: f64,
}

/// The tool point's error at one B.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Astray {
    /// The head's angle.
    pub b_deg: f64,
    /// Along machine X.
    pub dx_mm: f64,
    /// Along machine Y.
    pub dy_mm: f64,
    /// Along machine Z.
    pub dz_mm: f64,
}

impl Solution {
    /// The result of a session.
    pub fn new(session: &Session, solved: &Solved, machine: &Machine) -> Result<Self> {
        let [i1_mm, i2_mm, i3_mm, i4_mm] = solved.vectors_mm();
        let focus = Measured {
            value: solved.r_mm.value + session.standoff_mm.value,
            u: solved.r_mm.u.hypot(session.standoff_mm.u),
        };
        if focus.value <= 0.0 {
            let reason = format!(
                "is {}, R {:.1} mm: the focus would be above the B axis",
                session.standoff_mm.value, solved.r_mm.value
            );
            return Err(Error::measure("head.standoff_mm", reason, FOCUS));
        }
        let mut now = session.control.clone();
        if let Some(now) = now.as_mut().filter(|now| !now.from_file) {
            solved.turn(&mut now.machine);
        }
        let check_touch = solved.check.map(|c| CheckTouch {
            b_deg: c.b_rad.to_degrees(),
            measured_mm: c.measured_mm,
            predicted_mm: c.predicted_mm,
            difference_mm: c.difference_mm.value,
            difference_u95_mm: c.difference_mm.u95(),
            limit_mm: c.limit_mm,
            verdict: c.verdict,
        });
        let touched = check_touch.as_ref().map(|c| c.verdict);
        let verdicts = session.limits.iter().map(|l| l.verdict).chain(touched);
        Ok(Self {
            xb_mm: solved.xb_mm.value,
            xb_u95_mm: solved.xb_mm.u95(),
            zb_mm: solved.zb_mm.value,
            zb_u95_mm: solved.zb_mm.u95(),
            xc_mm: solved.xc_mm.value,
            xc_u95_mm: solved.xc_mm.u95(),
            yc_mm: solved.yc_mm.value,
            yc_u95_mm: solved.yc_mm.u95(),
            delta_x_mm: solved.delta_x_mm.value,
            delta_x_u95_mm: solved.delta_x_mm.u95(),
            r_mm: solved.r_mm.value,
            r_u95_mm: solved.r_mm.u95(),
            r_focus_mm: focus.value,
            r_focus_u95_mm: focus.u95(),
            i1_mm,
            i2_mm,
            i3_mm,
            i4_mm,
            b_sense: solved.b_sense,
            verdict: Verdict::worst(verdicts),
            limits: session.limits.clone(),
            check_touch,
            change: now.map(|now| Change::of(&now, machine)).transpose()?,
            budget: solved.budget.clone(),
        })
    }
}

impl Change {
    fn of(InControl { machine: now, untold, .. }: &InControl, new: &Machine) -> Result<Self> {
        let values = [
            ("delta_x_mm", now.head.delta_x_mm, new.head.delta_x_mm),
            ("r_mm", now.head.r_mm, new.head.r_mm),
            ("xc_mm", now.table.xc_mm, new.table.xc_mm),
            ("yc_mm", now.table.yc_mm, new.table.yc_mm),
            ("zc_mm", now.table.zc_mm, new.table.zc_mm),
        ]
        .into_iter()
        .filter(|(name, ..)| !untold.contains(name))
        .map(|(name, now, new)| Replaced { name, now, new, change: new - now })
        .collect();
        // The stand-off is the cutting process', not the machine's: the same on both sides.
        let mut now = now.clone();
        now.head.standoff_mm = new.head.standoff_mm;
        let (control, real) = (now.chain()?, new.chain()?);
        let at =
            |b_deg: f64| deviation(&control, &real, &Vector3::zeros(), [b_deg.to_radians(), 0.0]);
        let removes = SHOWN_DEG.iter().map(|&b_deg| {
            let d = at(b_deg) - at(0.0);
            Astray { b_deg, dx_mm: d.x, dy_mm: d.y, dz_mm: d.z }
        });
        Ok(Self { values, removes: removes.collect() })
    }
}
