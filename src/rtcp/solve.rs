//! From contact readings and the rod's centre to the head vector and the C axis, with uncertainty.
//!
//! With the nozzle at angle B its end face, a disc of rim radius ρ, touches the rod's generator
//! when the machine reads
//!
//! ```text
//! X = X_rod + s (D/2 + ρ |cos B|) + ΔX (1 - cos B) + R sin B,     s = sign(sin B)
//! ```
//!
//! Two touches, one on each side, give ΔX and R. At B = ±90° that is `X_B = (X1 + X2)/2`,
//! `ΔX = X_B - X_rod` and `R = (X1 - X2 - D)/2`. Uncertainty is propagated linearly (JCGM 100), that of B's angles to the second order
//! as well: `R` is seen by the cosine of B's error, by a second moment of `3/4 (f'' u²)²`. The rim of a nozzle that is not quite at ±90°
//! touches early by `ρ |sin ε|`, the same way on both sides, which enters by its second moment too.

use nalgebra::{SMatrix, SVector};

use crate::error::{Error, Result};
use crate::machine::{AxisEntry, Head, Machine, Table};
use crate::uncertainty::{Contribution, Measured, Verdict, budget};

/// How many standard deviations the check touch may be off: one false alarm in 370.
const CHECK_K: f64 = 3.0;

/// What was read at the machine; lengths in mm, angles in rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Readings {
    /// The centre the camera saw, in machine X, Y: the C axis, or at one C angle alone the rod.
    pub axis_center_mm: [Measured; 2],
    /// The C axis minus the centre seen, in X and Y alike.
    pub axis_from_seen_mm: Measured,
    /// The rod's centre minus the centre seen along X at the touches' C angle, as far as it is independent of that centre.
    pub rod_offset_mm: Measured,
    /// How that difference changes with an error of the centre seen in X and in Y: both are from the same captures.
    pub offset_follows: [f64; 2],
    /// The rod's diameter.
    pub diameter_mm: Measured,
    /// Machine X when the nozzle at `b1_rad` touches the rod.
    pub x1_mm: Measured,
    /// Machine X when the nozzle at `b2_rad` touches the rod's other side.
    pub x2_mm: Measured,
    /// Machine Z when the nozzle at B = 0 touches the table.
    pub z_table_mm: Measured,
    /// B at the first touch, usually 90°.
    pub b1_rad: f64,
    /// B at the second touch, usually -90°.
    pub b2_rad: f64,
    /// A third touch that checks the others: B and machine X.
    pub check_touch: Option<(f64, Measured)>,
    /// Standard uncertainty of B's zero, common to all touches.
    pub b_zero_u_rad: f64,
    /// Standard uncertainty of each B position.
    pub b_position_u_rad: f64,
    /// Radius of the nozzle's rim.
    pub nozzle_rim_radius_mm: f64,
}

/// The machine's numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Solved {
    /// Machine X where the B axis is over the rod.
    pub xb_mm: Measured,
    /// Machine Z where the nozzle touches the table; the table's surface.
    pub zb_mm: Measured,
    /// The C axis.
    pub xc_mm: Measured,
    /// The C axis.
    pub yc_mm: Measured,
    /// From the B axis to the optical axis, along X.
    pub delta_x_mm: Measured,
    /// From the B axis to the nozzle's end face.
    pub r_mm: Measured,
    /// Covariance of xb, zb, xc, yc, ΔX, R in mm².
    pub covariance_mm2: SMatrix<f64, 6, 6>,
    /// +1 where a positive B turns the nozzle towards -X, -1 where towards +X.
    pub b_sense: i32,
    /// The third touch, where there is one.
    pub check: Option<Check>,
    /// What contributes how much to the uncertainty of ΔX, R, xb and zb.
    pub budget: Vec<Contribution>,
}

/// A third touch compared with what the other two predict.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// B of the touch.
    pub b_rad: f64,
    /// What the machine read.
    pub measured_mm: f64,
    /// What the solution predicts.
    pub predicted_mm: f64,
    /// Measured - predicted.
    pub difference_mm: Measured,
    /// Three standard uncertainties of the difference.
    pub limit_mm: f64,
    /// `pass` where the difference is within that limit, else `fail`.
    pub verdict: Verdict,
}

/// Where uncertainty comes from, and which input quantities it enters through.
const SOURCES: [(&str, &[usize]); 10] = [
    ("C axis in X, from the camera", &[0]),
    ("C axis in Y, from the camera", &[1]),
    ("rod's centre seen from the C axis", &[2]),
    ("C axis seen from the rod's centre", &[15, 16]),
    ("rod's diameter", &[3]),
    ("touch X1", &[4]),
    ("touch X2", &[5]),
    ("touch on the table", &[6]),
    ("B zero", &[8, 12]),
    ("B positions at the touches", &[9, 10, 13, 14]),
];

/// What errors are about.
const SUBJECT: &str = "touch readings";

const INPUTS: usize = 17;
/// The inputs that are errors of B.
const ANGLES: std::ops::RangeInclusive<usize> = 8..=11;
const OUTPUTS: usize = 7;
type Inputs = SVector<f64, INPUTS>;

/// What a standard uncertainty of each input does to the outputs: its slope, and of angles the bend beside it.
struct Sensitivity {
    jacobian: SMatrix<f64, OUTPUTS, INPUTS>,
    curved: SMatrix<f64, OUTPUTS, INPUTS>,
}

/// Solves the readings.
pub fn solve(readings: &Readings) -> Result<Solved> {
    let r = readings;
    check_sides(r)?;
    let check = r.check_touch.unwrap_or((0.0, Measured::exact(0.0)));
    let (values, sds) = inputs(r, check.1);
    let evaluate = |sense: f64, values: &Inputs| outputs(r, sense, check.0, values);
    let Some((sense, best)) =
        [1.0, -1.0].map(|s| (s, evaluate(s, &values))).into_iter().find(|(_, o)| o[5] > 0.0)
    else {
        return Err(Error::measure(
            SUBJECT,
            format!(
                "|X1 - X2| = {:.3} mm is less than the rod's diameter {:.3} mm, so R would be negative",
                (r.x1_mm.value - r.x2_mm.value).abs(),
                r.diameter_mm.value
            ),
            "check x1_mm, x2_mm and diameter_mm (all in mm, machine coordinates)",
        ));
    };
    let Sensitivity { jacobian, curved } =
        sensitivity(&|v: &Inputs| evaluate(sense, v), &values, &sds);
    let covariance = jacobian * jacobian.transpose() + curved * curved.transpose();
    let measured = |i: usize| Measured { value: best[i], u: covariance[(i, i)].sqrt() };
    let check = r.check_touch.map(|(b_rad, x)| {
        let difference = measured(6);
        // A resolution of a micrometre keeps exact readings from failing on their last digit.
        let limit_mm = (CHECK_K * difference.u).max(1e-3);
        Check {
            b_rad,
            measured_mm: x.value,
            predicted_mm: x.value - difference.value,
            difference_mm: difference,
            limit_mm,
            verdict: Verdict::of(difference.value.abs(), 0.0, limit_mm),
        }
    });
    Ok(Solved {
        xb_mm: measured(0),
        zb_mm: measured(1),
        xc_mm: measured(2),
        yc_mm: measured(3),
        delta_x_mm: measured(4),
        r_mm: measured(5),
        covariance_mm2: covariance.fixed_view::<6, 6>(0, 0).into_owned(),
        b_sense: if sense > 0.0 { 1 } else { -1 },
        check,
        budget: [("delta_x_mm", 4), ("r_mm", 5), ("xb_mm", 0), ("zb_mm", 1)]
            .into_iter()
            .flat_map(|(of, i)| {
                let part = |inputs: &[usize]| {
                    let one = |&j: &usize| jacobian[(i, j)].powi(2) + curved[(i, j)].powi(2);
                    inputs.iter().map(one).sum::<f64>().sqrt()
                };
                budget(of, SOURCES.map(|(source, inputs)| (source, part(inputs))))
            })
            .collect(),
    })
}

/// Whether the two touches are on two sides of the rod, with the nozzle turned far enough.
fn check_sides(r: &Readings) -> Result<()> {
    for (name, b) in [("b1", r.b1_rad), ("b2", r.b2_rad)] {
        if b.sin().abs() < 0.5 {
            return Err(Error::measure(
                SUBJECT,
                format!("{name} = {:.3}° is too near 0° or 180° to find R", b.to_degrees()),
                "touch the rod's sides at B = 90° and B = -90°",
            ));
        }
    }
    if r.b1_rad.sin() * r.b2_rad.sin() > 0.0 {
        return Err(Error::measure(
            SUBJECT,
            "b1 and b2 turn the nozzle to the same side",
            "touch one side of the rod at B = 90° and the other at B = -90°",
        ));
    }
    Ok(())
}

fn sensitivity(
    evaluate: &dyn Fn(&Inputs) -> SVector<f64, OUTPUTS>,
    values: &Inputs,
    sds: &Inputs,
) -> Sensitivity {
    let best = evaluate(values);
    let mut jacobian = SMatrix::<f64, OUTPUTS, INPUTS>::zeros();
    let mut curved = jacobian;
    for i in 0..INPUTS {
        let step = 1e-5;
        let (mut up, mut down) = (*values, *values);
        up[i] += step;
        down[i] -= step;
        let (up, down) = (evaluate(&up), evaluate(&down));
        jacobian.set_column(i, &((up - down) * (sds[i] / (2.0 * step))));
        if ANGLES.contains(&i) {
            let bend = (up + down - 2.0 * best) * (sds[i] / step).powi(2);
            curved.set_column(i, &(bend * 0.75f64.sqrt()));
        }
    }
    Sensitivity { jacobian, curved }
}

/// The input quantities and their standard uncertainties.
fn inputs(r: &Readings, check: Measured) -> (Inputs, Inputs) {
    let rim = r.nozzle_rim_radius_mm;
    let (zero, position) = (r.b_zero_u_rad, r.b_position_u_rad);
    let measured = [
        r.axis_center_mm[0],
        r.axis_center_mm[1],
        r.rod_offset_mm,
        r.diameter_mm,
        r.x1_mm,
        r.x2_mm,
        r.z_table_mm,
        check,
        // Errors of B: of its zero, then of each touch's position.
        Measured { value: 0.0, u: zero },
        Measured { value: 0.0, u: position },
        Measured { value: 0.0, u: position },
        Measured { value: 0.0, u: position },
        // How much earlier the rim touches: with the zero, then with each side's position.
        Measured { value: 0.0, u: rim * zero },
        Measured { value: 0.0, u: rim * position },
        Measured { value: 0.0, u: rim * position },
        r.axis_from_seen_mm,
        r.axis_from_seen_mm,
    ];
    (Inputs::from_fn(|i, _| measured[i].value), Inputs::from_fn(|i, _| measured[i].u))
}

/// xb, zb, xc, yc, ΔX, R and the check touch's difference, for one sense of B.
fn outputs(r: &Readings, sense: f64, check_b: f64, v: &Inputs) -> SVector<f64, OUTPUTS> {
    let [gain_x, gain_y] = r.offset_follows;
    let [seen_x, seen_y] = r.axis_center_mm;
    let offset = v[2] + gain_x * (v[0] - seen_x.value) + gain_y * (v[1] - seen_y.value);
    let (xc, yc, diameter) = (v[0] + v[15], v[1] + v[16], v[3]);
    let rim = r.nozzle_rim_radius_mm;
    // Contact without the head vector's part; the rim's reach is taken at the angle told, its error
    // apart.
    let side = |b: f64, early: f64| {
        (sense * b.sin()).signum() * (diameter / 2.0 + rim * b.cos().abs() + early * b.sin().abs())
    };
    let row = |told: f64, error: f64| {
        let b = sense * (told + error);
        [1.0 - b.cos(), b.sin()]
    };
    let rod = v[0] + offset;
    let (zero, early) = (v[8], v[12]);
    let [a1, s1] = row(r.b1_rad, zero + v[9]);
    let [a2, s2] = row(r.b2_rad, zero + v[10]);
    let y1 = v[4] - rod - side(r.b1_rad, early + v[13]);
    let y2 = v[5] - rod - side(r.b2_rad, early + v[14]);
    let determinant = a1 * s2 - a2 * s1;
    let delta_x = (y1 * s2 - y2 * s1) / determinant;
    let length = (a1 * y2 - a2 * y1) / determinant;
    // The nozzle on the table at B = 0 + ε stands lower by its rim and higher by what the swing
    // lifts it.
    let e = sense * zero;
    let table = v[6] - early - delta_x * e.sin() + length * (1.0 - e.cos());
    let [ac, sc] = row(check_b, zero + v[11]);
    let predicted = rod + side(check_b, early) + delta_x * ac + length * sc;
    SVector::from([rod + delta_x, table, xc, yc, delta_x, length, v[7] - predicted])
}

impl Solved {
    /// I1 to I4 as the Siemens control names them: I2 = (-ΔX, 0, R) from nozzle to pivot, I1 = -I2,
    /// I3 to the C axis, I4 = -I3.
    pub fn vectors_mm(&self) -> [[f64; 3]; 4] {
        let i1 = [self.delta_x_mm.value, 0.0, -self.r_mm.value];
        let i3 = [self.xc_mm.value, self.yc_mm.value, self.zb_mm.value];
        // Adding zero turns -0 into 0.
        [i1, i1.map(|v| 0.0 - v), i3, i3.map(|v| 0.0 - v)]
    }

    /// Gives a machine the sense of B that was found.
    pub fn turn(&self, machine: &mut Machine) {
        if self.b_sense < 0 {
            let entry = AxisEntry { sense: Some(-1), ..AxisEntry::default() };
            machine.axes.insert("B".into(), entry);
        }
    }

    /// The machine these numbers describe.
    pub fn machine(&self, name: &str, c_sense: i32, standoff_mm: f64) -> Machine {
        let head = Head { delta_x_mm: self.delta_x_mm.value, r_mm: self.r_mm.value, standoff_mm };
        let table =
            Table { xc_mm: self.xc_mm.value, yc_mm: self.yc_mm.value, zc_mm: self.zb_mm.value };
        let mut machine = Machine::head_b_table_c(head, table);
        machine.name = name.into();
        machine.c_sense = c_sense;
        self.turn(&mut machine);
        machine
    }
}
