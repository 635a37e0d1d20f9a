//! The length of the bar on the machine model, with errors in it.

use nalgebra::{DMatrix, Vector3};

use super::path::{Path, Pose, Setup};
use crate::error::Result;
use crate::machine::{Chain, Head, LocationError, Machine, Table};

/// The six errors of the source, with the unit they are given in.
pub const ERRORS: [(&str, &str); 6] =
    [("X0B", "mm"), ("Z0B", "mm"), ("A0B", "deg"), ("C0B", "deg"), ("A0Z", "deg"), ("B0Z", "deg")];

/// Sizes of the six errors in the order of [`ERRORS`], mm and rad.
pub type Errors = [f64; 6];

/// One point of a path.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// Where the axes are.
    pub pose: Pose,
    /// Index of the path, for nuisances of its own.
    pub path: usize,
    /// Base cup off the plane of motion.
    pub cup_y_mm: f64,
    /// Which way the axes went: 1 or -1, or 0 where nobody says.
    pub dir: f64,
}

impl Point {
    /// A path's poses as points.
    pub fn of(path: &Path, index: usize, poses: &[Pose]) -> Vec<Self> {
        poses
            .iter()
            .map(|&pose| Self { pose, path: index, cup_y_mm: path.cup_y_mm, dir: 0.0 })
            .collect()
    }
}

/// The machine at zero has its tool ball at the origin and the B axis above it.
pub struct Bar {
    nominal: Chain,
    kinds: [LocationError; 6],
    setup: Setup,
}

impl Bar {
    /// The machine of a set-up.
    pub fn new(setup: &Setup) -> Result<Self> {
        setup.validate()?;
        let head = Head { r_mm: setup.pivot_mm, ..Head::default() };
        let nominal = Machine::head_b_table_c(head, Table::default()).chain()?;
        let mut kinds = Vec::with_capacity(6);
        for (name, _) in ERRORS {
            kinds.push(name.parse()?);
        }
        let kinds = [kinds[0], kinds[1], kinds[2], kinds[3], kinds[4], kinds[5]];
        Ok(Self { nominal, kinds, setup: *setup })
    }

    /// Lengths of the bar at all points. `nuisance` gives the base cup's shift and the bar's excess for a path.
    pub fn lengths(
        &self,
        points: &[Point],
        errors: &Errors,
        nuisance: impl Fn(usize) -> (Vector3<f64>, f64),
    ) -> Result<Vec<f64>> {
        let mut chain = self.nominal.clone();
        for (&kind, &amount) in self.kinds.iter().zip(errors) {
            if amount != 0.0 {
                chain.add_location_error(kind, amount)?;
            }
        }
        // The base cup under the B axis, seen from the tool ball at zero.
        let below = self.setup.pivot_mm - self.setup.below_mm;
        Ok(points
            .iter()
            .map(|p| {
                let (shift, longer) = nuisance(p.path);
                let cup = Vector3::new(0.0, p.cup_y_mm, below) + shift;
                let q = [p.pose.x_mm, 0.0, p.pose.up_mm, p.pose.b_rad, 0.0];
                (chain.tool(&q).translation.vector - cup).norm() - longer
            })
            .collect())
    }

    /// Lengths with a known cup and bar.
    pub fn known(&self, points: &[Point], errors: &Errors) -> Result<Vec<f64>> {
        self.lengths(points, errors, |_| (Vector3::zeros(), 0.0))
    }

    /// Change of length (mm) for each error, tilts scaled by the pivot length so that all columns are mm for mm.
    pub fn sensitivity(&self, points: &[Point]) -> Result<DMatrix<f64>> {
        let scale = self.scale();
        let mut matrix = DMatrix::zeros(points.len(), 6);
        for (j, s) in scale.iter().enumerate() {
            // Central differences: their error is of third order in 0.01 mm, below 1e-9.
            let at = |step: f64| {
                let mut errors = [0.0; 6];
                errors[j] = step * s;
                self.known(points, &errors)
            };
            let (up, down) = (at(0.01)?, at(-0.01)?);
            for (i, (u, d)) in up.iter().zip(&down).enumerate() {
                matrix[(i, j)] = (u - d) / 0.02;
            }
        }
        Ok(matrix)
    }

    /// How far the tool ball moves for each radian of B, mm.
    pub(super) fn scale_b_mm(&self) -> f64 {
        self.setup.pivot_mm
    }

    /// Size of each error that moves the tool ball by about 1 mm.
    pub fn scale(&self) -> Errors {
        ERRORS.map(|(_, unit)| if unit == "mm" { 1.0 } else { 1.0 / self.setup.pivot_mm })
    }
}

/// From internal mm and rad to the unit of [`ERRORS`].
pub fn to_unit(index: usize, value: f64) -> f64 {
    if ERRORS[index].1 == "mm" { value } else { value.to_degrees() }
}
