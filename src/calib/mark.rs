//! One small mark seen in several pictures, each taken at another machine position.
//!
//! Nothing is assumed of the mark but that it differs from what is round it. Blobs (difference of Gaussians, Lindeberg
//! 1998) are candidates; the mark is the one that moves as the machine does, up to one scale, turn and handedness.
//! Then its patch is registered in every picture by least squares (Lucas and Kanade 1981), brightness free.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use rayon::prelude::*;

use crate::find::blur;
use crate::frame::{Frame, Gray};

/// The reduced picture's longer side, about.
const SIDE_PX: usize = 640;
/// Blob candidates kept of each picture.
const CANDIDATES: usize = 12;
/// How far a candidate may be from where an undistorted, untilted camera would see it: share of the frame's side.
const STRAY: f64 = 0.03;
/// Correlation with the reference patch below which a registration is no sighting of the mark.
const LEAST_CORRELATION: f64 = 0.6;

/// The mark in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Its place.
    pub pixel: Vector2<f64>,
    /// Standard uncertainty of the registration from the pixels' noise, px.
    pub u_px: f64,
}

/// A spot that differs from its surroundings.
#[derive(Debug, Clone, Copy)]
struct Blob {
    center: Vector2<f64>,
    /// Standard deviation of the Gaussian that fits it, px of the full picture.
    sd: f64,
    /// Signed strength, counts.
    strength: f64,
}

/// Finds the one mark that moves with the machine: `None` for a picture that does not show it, or for all of them
/// where no mark is consistent. `positions_mm` are the machine's X and Y.
pub fn find(frames: &[Frame], positions_mm: &[Vector2<f64>]) -> Vec<Option<Sighting>> {
    let nothing = vec![None; frames.len()];
    let blobs: Vec<Vec<Blob>> = frames.par_iter().map(blobs).collect();
    let side = frames.iter().map(|f| f.width().max(f.height())).max().unwrap_or(0) as f64;
    let Some(chosen) = consistent(&blobs, positions_mm, STRAY * side) else { return nothing };
    register_all(frames, &chosen)
}

/// Registers a mark whose rough place is known in every picture that shows it.
fn register_all(frames: &[Frame], chosen: &[Option<Blob>]) -> Vec<Option<Sighting>> {
    // The sighting nearest to its frame's middle is whole and least oblique: it is the reference.
    let off = |i: usize, b: &Blob| {
        let middle = Vector2::new(frames[i].width() as f64, frames[i].height() as f64) / 2.0;
        (b.center - middle).norm()
    };
    let seen = chosen.iter().enumerate().filter_map(|(i, b)| b.map(|b| (i, b)));
    let Some((reference, blob)) = seen.min_by(|a, b| off(a.0, &a.1).total_cmp(&off(b.0, &b.1)))
    else {
        return vec![None; frames.len()];
    };
    let factor = ((blob.sd / 12.0) as usize).max(1);
    let patch = Patch::cut(
        &frames[reference].reduce(factor),
        reduced(blob.center, factor),
        blob.sd / factor as f64,
    );
    frames
        .par_iter()
        .zip(chosen)
        .map(|(frame, blob)| {
            let rough = reduced((*blob)?.center, factor);
            let (place, u) = patch.register(&frame.reduce(factor), rough)?;
            let k = factor as f64;
            Some(Sighting { pixel: place * k + Vector2::repeat((k - 1.0) / 2.0), u_px: u * k })
        })
        .collect()
}

fn reduced(p: Vector2<f64>, factor: usize) -> Vector2<f64> {
    let k = factor as f64;
    (p - Vector2::repeat((k - 1.0) / 2.0)) / k
}

/// The strongest blobs of a picture, strongest first.
fn blobs(frame: &Frame) -> Vec<Blob> {
    let factor = frame.width().max(frame.height()).div_ceil(SIDE_PX).max(1);
    let base = frame.reduce(factor);
    let scales: Vec<f64> = (0..7).map(|k| 1.2 * 1.6f64.powi(k)).collect();
    let blurred: Vec<Gray<f32>> = scales.iter().map(|&s| blur(&base, s)).collect();
    let layers: Vec<Vec<f32>> = blurred
        .windows(2)
        .map(|w| w[1].data.iter().zip(&w[0].data).map(|(a, b)| b - a).collect())
        .collect();
    let (w, h) = (base.width, base.height);
    let mut found: Vec<Blob> = Vec::new();
    for (k, layer) in layers.iter().enumerate() {
        let margin = (scales[k].ceil() as usize).max(1);
        for y in margin..h.saturating_sub(margin) {
            for x in margin..w.saturating_sub(margin) {
                let at = y * w + x;
                let v = layer[at].abs();
                let near = [
                    at - 1,
                    at + 1,
                    at - w,
                    at + w,
                    at - w - 1,
                    at - w + 1,
                    at + w - 1,
                    at + w + 1,
                ];
                let top = near.iter().all(|&n| layer[n].abs() <= v)
                    && (k == 0 || layers[k - 1][at].abs() <= v)
                    && layers.get(k + 1).is_none_or(|l| l[at].abs() <= v);
                if top && v > 0.0 {
                    let f = factor as f64;
                    found.push(Blob {
                        center: Vector2::new(x as f64, y as f64) * f
                            + Vector2::repeat((f - 1.0) / 2.0),
                        sd: f * (scales[k] * scales[k + 1]).sqrt(),
                        strength: f64::from(layer[at]),
                    });
                }
            }
        }
    }
    found.sort_by(|a, b| b.strength.abs().total_cmp(&a.strength.abs()));
    let mut kept: Vec<Blob> = Vec::new();
    for b in found {
        if kept.len() == CANDIDATES {
            break;
        }
        if kept.iter().all(|o| (o.center - b.center).norm() > 0.7 * o.sd.max(b.sd)) {
            kept.push(b);
        }
    }
    kept
}

/// The blob of each picture that belongs to the mark on which most pictures agree.
fn consistent(
    blobs: &[Vec<Blob>],
    positions: &[Vector2<f64>],
    stray: f64,
) -> Option<Vec<Option<Blob>>> {
    let n = positions.len();
    let mut pairs: Vec<(f64, usize, usize)> = (0..n)
        .flat_map(|j| (0..j).map(move |i| (i, j)))
        .map(|(i, j)| ((positions[i] - positions[j]).norm(), i, j))
        .collect();
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    // Three sightings at least: two always agree.
    let (mut best_rank, mut best) = ((2, f64::INFINITY), None);
    for &(_, i, j) in pairs.iter().take(6) {
        // The mark moves against the machine.
        let moved = positions[i] - positions[j];
        for a in &blobs[i] {
            for b in blobs[j]
                .iter()
                .filter(|b| alike(a, b) && (b.center - a.center).norm() > 3.0 * stray)
            {
                for handed in [1.0, -1.0] {
                    let Some(to_px) = similarity(moved, b.center - a.center, handed) else {
                        continue;
                    };
                    let mut distance = 0.0;
                    let chosen: Vec<Option<Blob>> = (0..n)
                        .map(|k| {
                            let wanted = a.center + to_px * (positions[i] - positions[k]);
                            let off = |b: &Blob| (b.center - wanted).norm();
                            let near = blobs[k].iter().filter(|b| alike(a, b) && off(b) < stray);
                            let hit = near.min_by(|p, q| off(p).total_cmp(&off(q))).copied();
                            distance += hit.map_or(0.0, |b| off(&b));
                            hit
                        })
                        .collect();
                    let count = chosen.iter().flatten().count();
                    // Of equally many sightings the stronger mark, a little the straighter one.
                    let strength: f64 = chosen.iter().flatten().map(|b| b.strength.abs()).sum();
                    let rank = (count, strength / (1.0 + distance / (count as f64 * 0.3 * stray)));
                    if rank > best_rank {
                        (best_rank, best) = (rank, Some(chosen));
                    }
                }
            }
        }
    }
    best
}

/// Whether two blobs may be one mark in two pictures.
fn alike(a: &Blob, b: &Blob) -> bool {
    a.strength.signum() == b.strength.signum()
        && (0.55..1.8).contains(&(a.sd / b.sd))
        && (0.4..2.5).contains(&(a.strength / b.strength))
}

/// mm → px: the turn and scale, with a reflection where `handed` is -1, that takes one vector to another.
fn similarity(from: Vector2<f64>, to: Vector2<f64>, handed: f64) -> Option<Matrix2<f64>> {
    let squared = from.norm_squared();
    if squared == 0.0 {
        return None;
    }
    // v down: an upright camera has a reflection in its matrix.
    let flip = Matrix2::new(1.0, 0.0, 0.0, -handed);
    let f = flip * from;
    let (c, s) = (f.dot(&to) / squared, f.perp(&to) / squared);
    Some(Matrix2::new(c, -s, s, c) * flip)
}

/// The reference picture of the mark: values on whole-pixel steps about its place.
struct Patch {
    half: i64,
    values: Vec<f64>,
}

impl Patch {
    /// Cuts it out; any fixed point of the mark does as its place.
    fn cut(image: &Gray<f32>, center: Vector2<f64>, sd: f64) -> Self {
        // Whole pixels, so that the reference is not interpolated.
        let center = center.map(f64::round);
        let half = (3.5 * sd + 3.0).ceil() as i64;
        let values =
            offsets(half).map(|d| cubic(image, center + d).map_or(f64::NAN, |v| v.0)).collect();
        Self { half, values }
    }

    /// The place of the mark in another picture, and the standard uncertainty that the pixels' noise leaves.
    fn register(&self, image: &Gray<f32>, rough: Vector2<f64>) -> Option<(Vector2<f64>, f64)> {
        let mut place = rough;
        let (mut gain, mut offset) = (1.0, 0.0);
        let mut last = None;
        for _ in 0..40 {
            let mut normal = Matrix4::<f64>::zeros();
            let mut right = Vector4::zeros();
            let (mut squares, mut n) = (0.0, 0.0);
            let (mut sums, mut products) = ([0.0; 2], [0.0; 3]);
            for (d, &t) in offsets(self.half).zip(&self.values) {
                let Some((value, slope)) = cubic(image, place + d) else { continue };
                if t.is_nan() {
                    continue;
                }
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
            if n < 0.5 * self.values.len() as f64 {
                return None;
            }
            let inverse = normal.try_inverse()?;
            let step = -(inverse * right);
            // A patch is never farther off than its own size.
            let shift = Vector2::new(step[0], step[1]).cap_magnitude(0.25 * self.half as f64);
            place += shift;
            gain += step[2];
            offset += step[3];
            if (place - rough).norm() > 2.0 * self.half as f64 {
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

fn offsets(half: i64) -> impl Iterator<Item = Vector2<f64>> {
    (-half..=half).flat_map(move |y| (-half..=half).map(move |x| Vector2::new(x as f64, y as f64)))
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
            v += wx[i] * f64::from(row[i]);
            s += dx[i] * f64::from(row[i]);
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
