//! Edges about a centre that is known: at which radii is the mean slope of all directions steepest?

use crate::find::rays::{CIRCLES, RAYS, Rays};

impl Rays {
    /// Slopes as a part of the steepest, radii and senses where the mean slope of all directions is steepest: the rays' centre is the
    /// edges'. Between two of one sense it is clearly less steep than on either: a soft edge has ripples.
    pub(super) fn crests(&self, near: f64, far: f64) -> Vec<(f64, f64, f64)> {
        /// Of the steepest slope.
        const LEAST: f64 = 0.1;
        /// Of a crest's height.
        const CLEAR: f64 = 0.2;
        /// In standard errors of the mean.
        const SURE: f64 = 4.0;
        let mean = |slopes: &[f32; RAYS]| {
            let (mut sum, mut squares, mut n) = (0.0f64, 0.0f64, 0.0f64);
            for v in slopes.iter().filter(|v| !v.is_nan()).map(|v| f64::from(*v)) {
                (sum, squares, n) = (sum + v, squares + v * v, n + 1.0);
            }
            if n < 0.15 * RAYS as f64 {
                return (0.0, 0.0);
            }
            let mean = sum / n;
            (mean, ((squares / n - mean * mean).max(0.0) / n).sqrt())
        };
        let (means, errors): (Vec<f64>, Vec<f64>) = self.slope.iter().map(mean).unzip();
        let inside = |r: &usize| (near..=far).contains(&(*r as f64));
        let steepest = (0..means.len()).filter(inside).map(|r| means[r].abs()).fold(0.0, f64::max);
        let means = &means;
        let along = |r: usize| move |i: usize| means[i] * means[r].signum();
        let stands_clear = |r: usize| {
            let along = along(r);
            let height = along(r);
            // How far down it goes before it comes up higher.
            let dip = |way: &mut dyn Iterator<Item = usize>| {
                let mut lowest = height;
                for i in way {
                    if along(i) > height {
                        return lowest;
                    }
                    lowest = lowest.min(along(i));
                }
                f64::NEG_INFINITY
            };
            let saddle = dip(&mut (0..r).rev()).max(dip(&mut (r + 1..means.len())));
            height - saddle > (CLEAR * height).max(SURE * errors[r])
        };
        let mut list: Vec<(f64, f64, f64)> = (1..means.len() - 1)
            .filter(inside)
            .filter(|&r| {
                let along = along(r);
                means[r].abs() > LEAST * steepest
                    && along(r) >= along(r - 1)
                    && along(r) > along(r + 1)
                    && stands_clear(r)
            })
            .map(|r| (means[r].abs() / steepest, r as f64, means[r].signum()))
            .collect();
        list.sort_by(|a, b| b.0.total_cmp(&a.0));
        list.truncate(CIRCLES);
        list
    }
}
