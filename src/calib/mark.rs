//! One small mark seen in several pictures, each taken at another machine position.
//!
//! Nothing is assumed of the mark but that it differs from what is round it. Blobs (difference of Gaussians, Lindeberg
//! 1998) are candidates; the mark is the one that moves as the machine does, up to one scale, turn and handedness.
//! Then its patch is registered in every picture (Lucas and Kanade 1981), brightness free. Once the mapping
//! is roughly known it is registered again, shaped as each picture's place in the frame shows it: tilt and distortion stretch a
//! mark, and sharp edges that do not lie on each other leave its place free between them.

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use crate::calib::register::Patch;
use crate::camera::View;
use crate::find::blur;
use crate::frame::{Frame, Gray};

/// The reduced picture's longer side, about.
const SIDE_PX: usize = 640;
/// Blurs whose differences show blobs: the largest find a mark that fills a fifth of the frame's longer side.
const SCALES: i32 = 9;
/// Blob candidates kept of each picture.
const CANDIDATES: usize = 12;
/// How far a candidate may be from where an undistorted, untilted camera would see it: share of the frame's side.
const STRAY: f64 = 0.03;

/// Pairs of pictures, the farthest apart first, each of which is tried to tell scale and turn.
const PAIRS: usize = 12;

/// A spot that differs from its surroundings.
#[derive(Debug, Clone, Copy)]
struct Blob {
    center: Vector2<f64>,
    /// Standard deviation of the Gaussian that fits it, px of the full picture.
    sd: f64,
    /// Signed strength, counts.
    strength: f64,
}

/// The mark as one picture shows it.
#[derive(Debug, Clone)]
pub struct Mark {
    /// Its pixels in the picture nearest to whose middle it is seen, reduced by `factor`.
    patch: Patch,
    factor: usize,
    /// Its place there, px of the full picture.
    pixel: Vector2<f64>,
    /// How far it may be from where it is expected, px of the reduced picture.
    most_px: f64,
}

/// Finds the one mark that moves with the machine: `None` where no mark is consistent. `positions_mm` are the machine's X and
/// Y.
pub fn find(frames: &[Frame], positions_mm: &[Vector2<f64>]) -> Option<(Mark, Sightings)> {
    let blobs: Vec<Vec<Blob>> = frames.par_iter().map(blobs).collect();
    let side = frames.iter().map(|f| f.width().max(f.height())).max().unwrap_or(0) as f64;
    let chosen = consistent(&blobs, positions_mm, STRAY * side)?;
    let mark = Mark::of(frames, &chosen)?;
    let rough: Vec<_> = chosen.iter().map(|b| b.map(|b| b.center)).collect();
    let sightings = mark.register(frames, &rough, |_| mark.patch.clone());
    Some((mark, sightings))
}

/// Where a mark is in each picture, px: `None` for one that does not show it.
pub type Sightings = Vec<Option<Vector2<f64>>>;

impl Mark {
    /// Cuts it out of the picture where it is nearest to the middle: there it is whole and least oblique.
    fn of(frames: &[Frame], chosen: &[Option<Blob>]) -> Option<Self> {
        let off = |i: usize, b: &Blob| {
            let middle = Vector2::new(frames[i].width() as f64, frames[i].height() as f64) / 2.0;
            (b.center - middle).norm()
        };
        let seen = chosen.iter().enumerate().filter_map(|(i, b)| b.map(|b| (i, b)));
        let (reference, blob) = seen.min_by(|a, b| off(a.0, &a.1).total_cmp(&off(b.0, &b.1)))?;
        let factor = ((blob.sd / 12.0) as usize).max(1);
        let sd = blob.sd / factor as f64;
        let half = (3.5 * sd + 3.0).ceil() as i64;
        let square = (-half..=half)
            .flat_map(|y| (-half..=half).map(move |x| Vector2::new(x as f64, y as f64)));
        // Whole pixels, so that the reference is not interpolated; any fixed point of the mark does as its place.
        let place = reduced(blob.center, factor).map(f64::round);
        let patch = Patch::cut(&frames[reference].reduce(factor), place, square.collect());
        Some(Self { patch, factor, pixel: full(place, factor), most_px: 2.0 * half as f64 })
    }

    /// Its places again, its shape in each picture being what `view` says.
    pub fn again(&self, frames: &[Frame], before: &Sightings, view: &View) -> Sightings {
        let k = self.factor as f64;
        let own = view.to_plane(self.pixel);
        self.register(frames, before, |at| {
            let here = view.to_plane(at);
            self.patch.reshaped(|d| {
                (view.to_pixel(here + view.to_plane(self.pixel + d * k) - own) - at) / k
            })
        })
    }

    fn register(
        &self,
        frames: &[Frame],
        rough: &[Option<Vector2<f64>>],
        shaped: impl Fn(Vector2<f64>) -> Patch + Sync,
    ) -> Sightings {
        frames
            .par_iter()
            .zip(rough)
            .map(|(frame, rough)| {
                let rough = (*rough)?;
                let (frame, from) = (frame.reduce(self.factor), reduced(rough, self.factor));
                let place = shaped(rough).register(&frame, from, self.most_px)?;
                Some(full(place, self.factor))
            })
            .collect()
    }
}

/// Pixels of the full picture from those of a reduced one.
fn full(p: Vector2<f64>, factor: usize) -> Vector2<f64> {
    let k = factor as f64;
    p * k + Vector2::repeat((k - 1.0) / 2.0)
}

fn reduced(p: Vector2<f64>, factor: usize) -> Vector2<f64> {
    let k = factor as f64;
    (p - Vector2::repeat((k - 1.0) / 2.0)) / k
}

/// The strongest blobs of a picture, strongest first.
fn blobs(frame: &Frame) -> Vec<Blob> {
    let factor = frame.width().max(frame.height()).div_ceil(SIDE_PX).max(1);
    let base = frame.reduce(factor);
    let scales: Vec<f64> = (0..SCALES).map(|k| 1.2 * 1.6f64.powi(k)).collect();
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
    // A mistyped position is far from all others: no picture spoils more than two pairs.
    let mut often = vec![0; n];
    pairs.retain(|&(_, i, j)| {
        let keep = often[i] < 2 && often[j] < 2;
        if keep {
            (often[i], often[j]) = (often[i] + 1, often[j] + 1);
        }
        keep
    });
    // Three sightings at least: two always agree.
    let (mut best_rank, mut best) = ((2, f64::INFINITY), None);
    for &(_, i, j) in pairs.iter().take(PAIRS) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mistyped_position_does_not_hide_the_mark() {
        let mut positions: Vec<Vector2<f64>> = [(0.0, 0.0), (2.0, 0.0), (-2.0, 0.3), (0.1, 1.5)]
            .into_iter()
            .chain([(0.0, -1.5), (2.0, 1.4), (-2.0, -1.4), (1.9, -1.5), (-2.1, 1.5)])
            .map(|(x, y)| Vector2::new(x, y))
            .collect();
        let seen: Vec<Vec<Blob>> = positions
            .iter()
            .map(|p| Vector2::new(400.0 - 100.0 * p.x, 300.0 + 100.0 * p.y))
            .map(|center| vec![Blob { center, sd: 10.0, strength: 50.0 }])
            .collect();
        positions[4].x += 10.0;
        positions[6].y -= 20.0;
        let found = consistent(&seen, &positions, 20.0).unwrap();
        let missing: Vec<usize> = (0..9).filter(|&i| found[i].is_none()).collect();
        assert_eq!(missing, [4, 6]);
    }
}
