//! Where a piece of one picture is in another, to a small part of a pixel: from the pixels themselves (Lucas and Kanade 1981),
//! brightness, its slope and contrast free.

use nalgebra::{Matrix6, Vector2, Vector6};

use crate::find::blur;
use crate::frame::Gray;

/// Correlation with the reference below which it is not the same thing.
const LEAST_CORRELATION: f64 = 0.6;

/// Blur of the reference from which its slopes are taken, as a part of its reach: enough to lose the pixels' noise, not the mark's flanks.
const BLUR: f64 = 0.06;
const LEAST_BLUR_PX: f64 = 0.8;
const MOST_BLUR_PX: f64 = 2.5;

/// A piece of the reference picture about its own place.
#[derive(Debug, Clone)]
pub struct Patch {
    points: Vec<Point>,
    reach: f64,
}

#[derive(Debug, Clone, Copy)]
struct Point {
    offset: Vector2<f64>,
    value: f64,
    /// Of the blurred reference: value and slope.
    smooth: f64,
    slope: Vector2<f64>,
}

impl Patch {
    /// Cuts it out at `place`; `offsets` that lie outside the picture are left out.
    pub fn cut(image: &Gray<f32>, place: Vector2<f64>, offsets: Vec<Vector2<f64>>) -> Self {
        let reach = offsets.iter().map(Vector2::norm).fold(0.0, f64::max);
        let smooth = blur(image, (BLUR * reach).clamp(LEAST_BLUR_PX, MOST_BLUR_PX));
        let point = |offset: Vector2<f64>| {
            let (value, _) = cubic(image, place + offset)?;
            let (smooth, slope) = cubic(&smooth, place + offset)?;
            Some(Point { offset, value, smooth, slope })
        };
        Self { points: offsets.into_iter().filter_map(point).collect(), reach }
    }

    /// The same values at the places that `shape` gives for its own.
    pub fn reshaped(&self, shape: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Self {
        let points = self.points.iter().map(|p| Point { offset: shape(p.offset), ..*p });
        let points: Vec<Point> = points.collect();
        let reach = points.iter().map(|p| p.offset.norm()).fold(0.0, f64::max);
        Self { points, reach }
    }

    /// Its place in another picture near `rough`. `None` where it is not within `most_px`, or where less than half of it is in the
    /// picture.
    ///
    /// What is left between the pictures is weighed by the slopes of the reference alone: those of the picture share its noise, which an
    /// interpolation between pixels makes smaller, and so would draw the place to where the noise is least. Light slopes otherwise elsewhere
    /// in the frame: with its slope held, marks would be drawn towards the brighter side, all of them towards the middle.
    pub fn register(
        &self,
        image: &Gray<f32>,
        rough: Vector2<f64>,
        most_px: f64,
    ) -> Option<Vector2<f64>> {
        let mut place = rough;
        let (mut gain, mut offset, mut slant) = (1.0, 0.0, Vector2::zeros());
        let mut correlation = 0.0;
        for _ in 0..40 {
            let mut change = Matrix6::<f64>::zeros();
            let mut left = Vector6::zeros();
            let mut n = 0.0;
            let (mut sums, mut products) = ([0.0; 2], [0.0; 3]);
            for &Point { offset: d, value: t, smooth, slope: own } in &self.points {
                let Some((value, slope)) = cubic(image, place + d) else { continue };
                // Light is a factor: it makes the mark's own contrast slope, too.
                let light = 1.0 + slant.dot(&d);
                let even = gain * t + offset;
                let (by_x, by_y) = (-d.x * even, -d.y * even);
                let weight = Vector6::new(own.x, own.y, -smooth, -1.0, by_x, by_y);
                change += weight
                    * Vector6::new(slope.x, slope.y, -t * light, -light, by_x, by_y).transpose();
                left += weight * (value - even * light);
                n += 1.0;
                sums = [sums[0] + t, sums[1] + value];
                products =
                    [products[0] + t * t, products[1] + value * value, products[2] + t * value];
            }
            if n < 0.5 * self.points.len() as f64 || n < 16.0 {
                return None;
            }
            let step = -(change.try_inverse()? * left);
            // A step never leaves the piece's own neighbourhood.
            let shift = Vector2::new(step[0], step[1]).cap_magnitude(0.25 * self.reach);
            place += shift;
            gain += step[2];
            offset += step[3];
            slant += Vector2::new(step[4], step[5]);
            if (place - rough).norm() > most_px {
                return None;
            }
            let covariance = products[2] - sums[0] * sums[1] / n;
            let spread = |i: usize| products[i] - sums[i] * sums[i] / n;
            correlation = covariance / (spread(0) * spread(1)).sqrt();
            if shift.norm() < 1e-4 {
                break;
            }
        }
        (correlation > LEAST_CORRELATION).then_some(place)
    }
}

/// Value and slope by Keys' cubic convolution; `None` near the border.
fn cubic(image: &Gray<f32>, p: Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
    let (x, y) = (p.x.floor(), p.y.floor());
    if !(x >= 1.0 && y >= 1.0 && x + 3.0 <= image.width as f64 && y + 3.0 <= image.height as f64) {
        return None;
    }
    let (wx, dx) = keys(p.x - x);
    let (wy, dy) = keys(p.y - y);
    let (mut value, mut slope) = (0.0, Vector2::zeros());
    for j in 0..4 {
        let row = &image.row(y as usize + j - 1)[x as usize - 1..x as usize + 3];
        let (mut v, mut s) = (0.0, 0.0);
        for i in 0..4 {
            let pixel = f64::from(row[i]);
            v += wx[i] * pixel;
            s += dx[i] * pixel;
        }
        value += wy[j] * v;
        slope += Vector2::new(wy[j] * s, dy[j] * v);
    }
    Some((value, slope))
}

/// Weights of the four neighbours and their derivatives, a = -1/2 (Keys 1981).
fn keys(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [
            0.5 * (-t + 2.0 * t2 - t3),
            0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
            0.5 * (t + 4.0 * t2 - 3.0 * t3),
            0.5 * (-t2 + t3),
        ],
        [
            0.5 * (-1.0 + 4.0 * t - 3.0 * t2),
            0.5 * (-10.0 * t + 9.0 * t2),
            0.5 * (1.0 + 8.0 * t - 9.0 * t2),
            0.5 * (-2.0 * t + 3.0 * t2),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A mark of 60 counts in noise of 3: errors as small as the noise lets them be, wherever between pixels it lies.
    #[test]
    fn noise_does_not_draw_a_mark_to_where_it_is_interpolated_most() {
        const RADIUS_PX: f64 = 8.0;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
        let mut seen = |center: Vector2<f64>| {
            let mut image = Gray { width: 96, height: 96, data: vec![0.0f32; 96 * 96] };
            for (i, value) in image.data.iter_mut().enumerate() {
                let p = Vector2::new((i % 96) as f64, (i / 96) as f64);
                let noise: f64 = StandardNormal.sample(&mut rng);
                let inside = 0.5 - 0.5 * ((p - center).norm() - RADIUS_PX).tanh();
                *value = (120.0 + 60.0 * inside + 3.0 * noise) as f32;
            }
            image
        };
        let middle = Vector2::repeat(48.0);
        let square = (-24..=24)
            .flat_map(|y| (-24..=24).map(move |x| Vector2::new(f64::from(x), f64::from(y))));
        let patch = Patch::cut(&seen(middle), middle, square.collect());
        let errors: Vec<Vector2<f64>> = (0..100)
            .map(|i| {
                let t = 0.1 * f64::from(i % 10);
                let at = middle + Vector2::new(t, 1.0 - 0.7 * t);
                patch.register(&seen(at), middle, 5.0).unwrap() - at
            })
            .collect();
        // What the reference's own noise does is the same in all.
        let mean = errors.iter().sum::<Vector2<f64>>() / 100.0;
        let rms = (errors.iter().map(|e| (e - mean).norm_squared()).sum::<f64>() / 200.0).sqrt();
        // Noise over the root of the sum of squared slopes: 60²/2 sech⁴ over a rim of 2πR, half of it each way.
        let bound = 3.0 / (900.0 * 4.0 / 3.0 * std::f64::consts::PI * RADIUS_PX).sqrt();
        assert!(rms < 1.5 * bound && mean.norm() < 5.0 * bound, "{rms} {bound} {mean}");
    }
}
