//! The law that all points of a screw follow, and how far its slopes lie off it.

use nalgebra::{DMatrix, DVector};

use crate::fit::least_squares;
use crate::fit::tails::ln_f_tail;
use crate::thermal::lines::{Line, Point};

/// p-value under which slopes are taken to lie off the law, and under which that is said.
const OFF_P: f64 = 0.05;
/// See [`OFF_P`].
const SURELY_OFF_P: f64 = 0.01;

/// `error = k (T - T0) (P - P0)` (+ a free offset for each run) over all points.
pub(super) struct Law<'a> {
    pub(super) points: &'a [Point],
    pub(super) runs: &'a [Vec<Point>],
    pub(super) noise: f64,
    pub(super) t0: Option<f64>,
    pub(super) p0: Option<f64>,
    pub(super) free_offsets: bool,
}

pub(super) struct LawSolution {
    pub(super) parameters: [f64; 3],
    pub(super) covariance: [[f64; 3]; 3],
    pub(super) chi2: f64,
    pub(super) rank: usize,
}

impl Law<'_> {
    pub(super) fn solve(&self, start: [f64; 3]) -> LawSolution {
        let free: Vec<usize> = [true, self.t0.is_none(), self.p0.is_none()]
            .iter()
            .enumerate()
            .filter(|(_, f)| **f)
            .map(|(i, _)| i)
            .collect();
        let offsets = if self.free_offsets { self.runs.len() } else { 0 };
        let rows: Vec<(usize, Point)> = self
            .runs
            .iter()
            .enumerate()
            .flat_map(|(r, run)| run.iter().map(move |p| (r, *p)))
            .collect();
        let unpack = |v: &DVector<f64>| {
            let mut all = start;
            free.iter().enumerate().for_each(|(a, &i)| all[i] = v[a]);
            all
        };
        let mut first = DVector::zeros(free.len() + offsets);
        free.iter().enumerate().for_each(|(a, &i)| first[a] = start[i]);
        let solution = least_squares::solve(first, least_squares::Options::default(), |v| {
            let [k, t0, p0] = unpack(v);
            let mut residuals = DVector::zeros(self.points.len());
            let mut jacobian = DMatrix::zeros(self.points.len(), v.len());
            for (row, (run, point)) in rows.iter().enumerate() {
                let (t, p) = (point.screw_c - t0, point.position_mm - p0);
                let mut model = k * t * p;
                let gradient = [t * p, -k * p, -k * t];
                free.iter()
                    .enumerate()
                    .for_each(|(a, &i)| jacobian[(row, a)] = gradient[i] / self.noise);
                if offsets > 0 {
                    model += v[free.len() + run];
                    jacobian[(row, free.len() + run)] = 1.0 / self.noise;
                }
                residuals[row] = (model - point.error_mm) / self.noise;
            }
            (residuals, || jacobian)
        });
        let mut covariance = [[0.0; 3]; 3];
        for (a, &i) in free.iter().enumerate() {
            for (b, &j) in free.iter().enumerate() {
                covariance[i][j] = solution.covariance[(a, b)];
            }
        }
        LawSolution {
            parameters: unpack(&solution.parameters),
            covariance,
            chi2: solution.chi2(),
            rank: solution.rank,
        }
    }
}

/// How far the slopes lie off the law.
pub(super) struct Misfit {
    /// Times their uncertainty, 1 or more (Birge's ratio).
    pub(super) ratio: f64,
    /// Degrees of freedom behind that: few where it is the slopes that tell it.
    pub(super) dof: f64,
    /// Whether chance can be ruled out.
    pub(super) significant: bool,
}

impl Misfit {
    /// Each slope counts once, however many positions are behind it: a run's thermometer is off for all of them.
    pub(super) fn of(
        slopes: &[Line],
        law: impl Fn(&Line) -> f64,
        noise: f64,
        t0_given: bool,
        dof: f64,
    ) -> Self {
        let free = slopes.len() as f64 - if t0_given { 1.0 } else { 2.0 };
        if free < 1.0 {
            return Self { ratio: 1.0, dof, significant: false };
        }
        let square: f64 =
            slopes.iter().map(|l| ((l.slope - law(l)) / (noise * l.slope_factor)).powi(2)).sum();
        let variance = (square / free).max(1.0);
        let ln_p = ln_f_tail(variance, free, dof);
        if ln_p >= OFF_P.ln() {
            return Self { ratio: 1.0, dof, significant: false };
        }
        // Welch-Satterthwaite: the noise is known from all rows, what comes on top from the slopes alone.
        let (noise_part, own_part) = (1.0 / dof, (variance - 1.0).powi(2) / free);
        Self {
            ratio: variance.sqrt(),
            dof: (variance.powi(2) / (noise_part + own_part)).max(1.0),
            significant: ln_p < SURELY_OFF_P.ln(),
        }
    }
}
