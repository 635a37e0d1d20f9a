//! A compensation curve between measured angles: linear, held at the ends or closed over the turn, on an even grid.

use super::{Direction, Report};
use crate::error::{Error, Result};

/// Most points written to a table.
const MAX_POINTS: usize = 5000;

/// Angles and values of one direction, by rising angle.
#[derive(Debug, Clone)]
pub struct Curve {
    points: Vec<(f64, f64)>,
    modulo: bool,
}

impl Curve {
    /// The new table of one direction; `None` where the sweep has no such rows.
    pub fn of(report: &Report, dir: Option<Direction>) -> Option<Self> {
        let points: Vec<_> = report
            .rows
            .iter()
            .filter(|r| r.dir == dir)
            .map(|r| (r.angle_deg, r.comp_new_deg))
            .collect();
        (!points.is_empty()).then_some(Self { points, modulo: report.modulo })
    }

    /// An open curve through points of rising angle, at least one.
    pub(super) fn through(points: Vec<(f64, f64)>) -> Self {
        Self { points, modulo: false }
    }

    /// The value at any angle.
    pub fn at(&self, angle_deg: f64) -> f64 {
        let last = self.points.len() - 1;
        let mut angle = angle_deg;
        if self.modulo {
            angle = angle.rem_euclid(360.0);
            // The seam: from the last point over 360° to the first.
            let (first_angle, first) = self.points[0];
            let (last_angle, value) = self.points[last];
            if angle < first_angle || angle > last_angle {
                let gap = first_angle + 360.0 - last_angle;
                let along = (angle - last_angle).rem_euclid(360.0);
                return value + (first - value) * if gap > 0.0 { along / gap } else { 0.0 };
            }
        }
        let next = self.points.partition_point(|p| p.0 < angle);
        if next == 0 {
            return self.points[0].1;
        }
        if next > last {
            return self.points[last].1;
        }
        let (a, b) = (self.points[next - 1], self.points[next]);
        a.1 + (b.1 - a.1) * (angle - a.0) / (b.0 - a.0)
    }

    /// The even grid a control's table needs: `step_deg` or the smallest measured step, over the measured
    /// range or the whole turn.
    pub fn grid(&self, step_deg: Option<f64>) -> Result<Vec<f64>> {
        let smallest =
            self.points.windows(2).map(|w| w[1].0 - w[0].0).fold(f64::INFINITY, f64::min);
        let step = step_deg.unwrap_or(smallest);
        // Without a step of the user's own it is the measured angles that do not fit.
        let (from, given) = match step_deg {
            Some(_) => ("--step-deg", format!("{step}°")),
            None => {
                ("angle_deg", format!("the smallest step between the measured angles, {step:.6}°,"))
            }
        };
        let alone = self.points.len() < 2 && !self.modulo;
        if alone || !(step.is_finite() && step > 0.0) {
            return Err(Error::option(
                from,
                "the sweep has no two angles to take a step from, or the step is not above 0",
                "measure more angles or give --step-deg",
            ));
        }
        let (low, high) = if self.modulo {
            (0.0, 360.0)
        } else {
            (self.points[0].0, self.points[self.points.len() - 1].0)
        };
        let count = (high - low) / step;
        if count > MAX_POINTS as f64 {
            return Err(Error::option(
                from,
                format!("{given} gives more than {MAX_POINTS} table points"),
                "give a larger --step-deg",
            ));
        }
        let steps = count.round() as usize;
        if (count - steps as f64).abs() > 1e-6 * count {
            return Err(Error::option(
                from,
                format!("{given} does not divide the range {low}° to {high}°"),
                "give a --step-deg that does: values between the measured angles are interpolated",
            ));
        }
        Ok((0..=steps).map(|i| low + (high - low) * i as f64 / steps as f64).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endless_axis_is_closed_over_the_seam() {
        let curve = Curve { points: vec![(10.0, 1.0), (350.0, 3.0)], modulo: true };
        assert_eq!(curve.at(0.0), 2.0);
        assert_eq!(curve.at(360.0), 2.0);
        assert_eq!(curve.at(-5.0), 2.5);
        let open = Curve { points: vec![(10.0, 1.0), (350.0, 3.0)], modulo: false };
        assert_eq!((open.at(0.0), open.at(400.0)), (1.0, 3.0));
    }
}
