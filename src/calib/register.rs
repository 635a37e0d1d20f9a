//! Where a piece of one picture is in another, to a small part of a pixel: least squares on the pixels themselves (Lucas
//! and Kanade 1981), brightness and contrast free.

use nalgebra::{Matrix4, Vector2, Vector4};

use crate::frame::Gray;

/// Correlation with the reference below which it is not the same thing.
const LEAST_CORRELATION: f64 = 0.6;

/// A piece of the reference picture: values at places about its own.
#[derive(Debug, Clone)]
pub struct Patch {
    points: Vec<(Vector2<f64>, f64)>,
    reach: f64,
}

impl Patch {
    /// Cuts it out at `place`; `offsets` that lie outside the picture are left out.
    pub fn cut(image: &Gray<f32>, place: Vector2<f64>, offsets: Vec<Vector2<f64>>) -> Self {
        let reach = offsets.iter().map(Vector2::norm).fold(0.0, f64::max);
        let points =
            offsets.into_iter().filter_map(|d| Some((d, cubic(image, place + d)?.0))).collect();
        Self { points, reach }
    }

    /// The same values at the places that `shape` gives for its own.
    pub fn reshaped(&self, shape: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Self {
        let points: Vec<_> = self.points.iter().map(|&(d, t)| (shape(d), t)).collect();
        let reach = points.iter().map(|(d, _)| d.norm()).fold(0.0, f64::max);
        Self { points, reach }
    }

    /// Its place in another picture near `rough`, and the standard uncertainty that the pixels' noise leaves. `None` where it is
    /// not within `most_px`, or where less than half of it is in the picture.
    pub fn register(
        &self,
        image: &Gray<f32>,
        rough: Vector2<f64>,
        most_px: f64,
    ) -> Option<(Vector2<f64>, f64)> {
        let mut place = rough;
        let (mut gain, mut offset) = (1.0, 0.0);
        let mut last = None;
        for _ in 0..40 {
            let mut normal = Matrix4::<f64>::zeros();
            let mut right = Vector4::zeros();
            let (mut squares, mut n) = (0.0, 0.0);
            let (mut sums, mut products) = ([0.0; 2], [0.0; 3]);
            for &(d, t) in &self.points {
                let Some((value, slope)) = cubic(image, place + d) else { continue };
                let residual = value - gain * t - offset;
                let row = Vector4::new(slope.x, slope.y, -t, -1.0);
                normal += row * row.transpose();
                right += row * residual;
                squares += residual * residual;
                n += 1.0;
                sums = [sums[0] + t, sums[1] + value];
                products =
                    [products[0] + t * t, products[1] + value * value, products[2] + t * value];
            }
            if n < 0.5 * self.points.len() as f64 || n < 16.0 {
                return None;
            }
            let inverse = normal.try_inverse()?;
            let step = -(inverse * right);
            // A step never leaves the piece's own neighbourhood.
            let shift = Vector2::new(step[0], step[1]).cap_magnitude(0.25 * self.reach);
            place += shift;
            gain += step[2];
            offset += step[3];
            if (place - rough).norm() > most_px {
                return None;
            }
            let covariance = products[2] - sums[0] * sums[1] / n;
            let spread = |i: usize| products[i] - sums[i] * sums[i] / n;
            let correlation = covariance / (spread(0) * spread(1)).sqrt();
            let variance = squares / (n - 4.0) * 0.5 * (inverse[(0, 0)] + inverse[(1, 1)]);
            last = Some((correlation, variance.max(0.0).sqrt()));
            if shift.norm() < 1e-4 {
                break;
            }
        }
        let (correlation, u) = last?;
        (correlation > LEAST_CORRELATION).then_some((place, u))
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
