//! What each capture's edge, and the nominal diameter, contribute to the uncertainty of the axis and the diameter.

use nalgebra::DMatrix;

use crate::fit::correlated::{Fit, groups};
use crate::uncertainty::{Contribution, K95, budget};

/// What the budget is made from.
pub(super) struct Sources<'f> {
    /// The joint fit: centre x, y of every table angle, then the radius.
    pub fit: &'f Fit,
    /// The arc of each row of the fit; rows of one arc stand together.
    pub groups: &'f [usize],
    /// The picture of each arc.
    pub images: Vec<&'f str>,
    /// From the fit's coefficients to the axis and the radius (3 × (2n + 1)).
    pub gain: DMatrix<f64>,
    /// Weight and standard uncertainty of the nominal radius, where it is used.
    pub nominal: Option<(f64, f64)>,
    /// Standard uncertainty of where on a rim's profile its edge is, the same in all pictures.
    pub rim_mm: f64,
    /// Standard uncertainty, each axis, of what the light's slope does to all centres.
    pub light_mm: f64,
    /// How far each of the plane's independent errors moves the fit's coefficients, a column each.
    pub plane: &'f DMatrix<f64>,
    /// Standard uncertainty, each axis, of what turning lines out of centre do.
    pub lines_mm: f64,
}

impl Sources<'_> {
    /// The budgets, scaled to the half-widths that the result states.
    pub fn budget(&self, axis_u95_mm: [f64; 2], diameter_u95_mm: f64) -> Vec<Contribution> {
        let (nominal_weight, nominal_u_mm) = self.nominal.unwrap_or((0.0, 0.0));
        let (mut axis, mut diameter) = (Vec::new(), Vec::new());
        for (rows, noise) in groups(self.groups).into_iter().zip(&self.fit.row_covariance) {
            let (start, count) = (rows.start, rows.len());
            let image = self.images[self.groups[start]];
            let influence = &self.gain * self.fit.influence.columns(start, count);
            let part = (&influence * noise * influence.transpose()).diagonal();
            let source = format!("edge in {image}");
            axis.push((source.clone(), (0.5 * (part[0] + part[1])).max(0.0).sqrt()));
            diameter.push((source, 2.0 * part[2].max(0.0).sqrt()));
        }
        let by_plane = &self.gain * self.plane;
        let plane = |row: usize| by_plane.row(row).norm_squared();
        axis.push(("calibration".to_owned(), (0.5 * (plane(0) + plane(1))).sqrt()));
        diameter.push(("calibration".to_owned(), 2.0 * plane(2).sqrt()));
        axis.push(("light's slope".to_owned(), self.light_mm));
        axis.push(("turning lines".to_owned(), self.lines_mm));
        diameter.push(("the rim's profile".to_owned(), 2.0 * (1.0 - nominal_weight) * self.rim_mm));
        diameter.push(("nominal diameter".to_owned(), 2.0 * nominal_weight * nominal_u_mm));
        let [x, y] = axis_u95_mm;
        let mut list = scaled("axis_center_mm", axis, (0.5 * (x * x + y * y)).sqrt() / K95);
        list.extend(scaled("diameter_mm", diameter, diameter_u95_mm / K95));
        list
    }
}

/// The fit's grid of correlations and its coverage factors widen all parts alike.
fn scaled(of: &str, parts: Vec<(String, f64)>, total: f64) -> Vec<Contribution> {
    let sum: f64 = parts.iter().map(|p| p.1 * p.1).sum();
    let factor = if sum > 0.0 { total / sum.sqrt() } else { 0.0 };
    budget(of, parts.into_iter().map(|(source, u)| (source, factor * u)))
}
