//! The centre averaged over frames: how many count, and whether it has moved meanwhile.

use nalgebra::Vector2;

use crate::measure::ring::Ring;
use crate::uncertainty::{K95, k95};

/// The running mean of the centres since the last move.
#[derive(Debug, Clone, Default)]
pub(super) struct Average {
    /// Frames.
    pub(super) n: usize,
    pub(super) mean: Vector2<f64>,
    squares: Vector2<f64>,
    /// The last centre, and the sum of the squared steps from each to the next.
    last: Vector2<f64>,
    steps: Vector2<f64>,
    own: Vector2<f64>,
}

/// Frames that the scatter is told from, and that a result needs.
pub const LEAST_FRAMES: usize = 3;

/// How many standard deviations steps must be too small for the scatter before the centre is said to creep.
const CREEPS: f64 = 3.0;

impl Average {
    /// Takes in a frame's centre; `true` where it has moved and the average began anew.
    pub(super) fn add(&mut self, ring: &Ring, least_mm: f64) -> bool {
        let center = ring.circle.center;
        let scatter = if self.n > 2 {
            (self.squares / (self.n - 1) as f64).map(f64::sqrt)
        } else {
            Vector2::zeros()
        };
        let moved = self.n > 0
            && ((center - self.mean).norm() > 6.0 * scatter.norm() + least_mm || self.creeps());
        if moved {
            *self = Self::default();
        }
        self.n += 1;
        let n = self.n as f64;
        let before = center - self.mean;
        self.mean += before / n;
        self.squares += before.component_mul(&(center - self.mean));
        if self.n > 1 {
            self.steps += (center - self.last).map(|d| d * d);
        }
        self.last = center;
        let factor = k95(ring.dof);
        let own = Vector2::new(ring.covariance[(0, 0)], ring.covariance[(1, 1)]);
        self.own += (own * factor * factor - self.own) / n;
        moved
    }

    /// How far the frames follow one another instead of scattering about the mean: 0 for independent ones, 1 for a slow drift.
    fn follow(steps: f64, squares: f64) -> f64 {
        if squares > 0.0 { 1.0 - 0.5 * steps / squares } else { 0.0 }
    }

    /// Whether the centre moves by less from frame to frame than it strays from the mean (von Neumann 1941; the standard
    /// deviation is that of independent frames, Young 1941).
    fn creeps(&self) -> bool {
        let n = self.n as f64;
        let sd = ((n - 2.0) / (n * n - 1.0)).sqrt();
        self.n > 3 && Self::follow(self.steps.sum(), self.squares.sum()) > CREEPS * sd
    }

    /// Half-widths of the mean's 95 % intervals.
    pub(super) fn u95(&self) -> Vector2<f64> {
        let n = self.n as f64;
        if self.n < LEAST_FRAMES {
            // Two frames may differ because the centre has moved: it is where the later one says.
            return self.own.zip_map(&self.steps, |own, s| (own.max(0.0) + 0.25 * s).sqrt());
        }
        let factor = k95(n - 1.0);
        Vector2::from_fn(|i, _| {
            let (own, s) = (self.own[i], self.squares[i] / (n - 1.0));
            // Frames that follow one another count as fewer.
            let follow = Self::follow(self.steps[i], self.squares[i]).clamp(0.0, 0.99);
            let fewer = (1.0 + follow) / (1.0 - follow);
            // What of a frame's uncertainty does not show as scatter is the same in every frame; a tenth of it at least,
            // since what shows as scatter is itself not known well.
            ((own - K95 * K95 * s).max(0.1 * own) + factor * factor * s * fewer / n).sqrt()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// A circle of which only the centre and its variance matter.
    fn ring(x: f64, y: f64) -> Ring {
        Ring {
            circle: crate::fit::Circle { center: Vector2::new(x, y), radius: 1.0 },
            covariance: Matrix3::identity() * 1e-8,
            dof: f64::INFINITY,
            fitted_sd_mm: 1e-4,
            center_px: Vector2::zeros(),
            form_rms_mm: 0.0,
            form_from_texture_mm: 0.0,
            edge_points: 100,
            gain: 1.0,
            other_mm: None,
            arc_coverage: 1.0,
            contrast: 50.0,
            noise: 1.0,
            softness_px: 2.0,
            blur_mm: 0.0,
            clipped_inside: false,
            clipped_outside: false,
            wander: Default::default(),
            trace: Vec::new(),
            residuals: Vec::new(),
        }
    }

    /// Scatter that repeats, of about 1.
    fn noise(i: usize) -> f64 {
        let n = |k: f64| (k * (i as f64 + 0.7)).sin() * 43758.5453 % 1.0;
        n(12.9898) + n(78.233) + n(37.719)
    }

    #[test]
    fn a_creeping_centre_begins_the_average_anew_and_one_that_stays_does_not() {
        let anew = |creep_mm: f64| {
            let mut average = Average::default();
            let mut count = 0;
            for i in 0..60 {
                let at = creep_mm * i as f64;
                count += usize::from(
                    average.add(&ring(at + 1e-4 * noise(i), 1e-4 * noise(i + 500)), 0.005),
                );
                let lag = (average.mean.x - at).abs();
                assert!(lag < 2.0 * average.u95().x, "{i}: {lag} {}", average.u95().x);
            }
            count
        };
        assert_eq!(anew(0.0), 0);
        assert!(anew(0.001) > 3);
    }
}
