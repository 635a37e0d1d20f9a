//! Where the rod is, roughly: edges of all captures, in machine coordinates, vote for one centre together.

use nalgebra::Vector2;

use crate::camera::View;
use crate::find::{self, Look};
use crate::fit::Circle;
use crate::frame::{Frame, Gray};

/// Share of a capture's gradients that vote.
const STRONGEST: f64 = 0.05;
/// Most voters of a capture at each scale: fewer lose the rim beside the chamfer now and then.
const VOTERS: usize = 4000;
/// Most voters of all captures for the centre, before it is known better.
const CENTER_VOTERS: usize = 16000;
/// Scales at which they are looked for: no rim is softer.
const SCALES: usize = 2;
/// Cells along the longer side of the voting grid.
const CELLS: f64 = 420.0;

/// A gradient seen in a capture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Voter {
    /// Place in the plane of the capture, plus the machine's position.
    place_mm: Vector2<f64>,
    /// Unit direction of the gradient in the plane.
    along: Vector2<f64>,
    capture: usize,
}

impl Voter {
    /// Centres of the circles of some radius whose rim it may be of.
    pub(super) fn centers(&self, radius_mm: f64) -> [Vector2<f64>; 2] {
        [1.0, -1.0].map(|sign| self.place_mm + sign * radius_mm * self.along)
    }

    /// Direction from a centre to it.
    pub(super) fn toward(&self, center: Vector2<f64>) -> Vector2<f64> {
        (self.place_mm - center).normalize()
    }

    /// How far outside a circle it lies. `None` where it is no edge along that.
    pub(super) fn off_mm(&self, circle: Circle) -> Option<f64> {
        const ALONG: f64 = 0.12;
        let is_along = self.along.perp(&self.toward(circle.center)).abs() < ALONG;
        is_along.then(|| circle.distance(self.place_mm))
    }
}

/// The voters of one capture.
pub(super) fn voters(
    frame: &Frame,
    view: &View,
    position_mm: Vector2<f64>,
    capture: usize,
) -> Vec<Voter> {
    let look = Look::new(frame, SCALES);
    let mut list = Vec::new();
    for scale in 0..SCALES {
        list.extend(voters_at(&look, scale, view, position_mm, capture));
    }
    list
}

fn voters_at(
    look: &Look,
    scale: usize,
    view: &View,
    position: Vector2<f64>,
    capture: usize,
) -> Vec<Voter> {
    let (blur, image) = &look.scales[scale];
    let (columns, rows) = (1..image.width.max(1) - 1, 1..image.height.max(1) - 1);
    let mut sizes = Vec::with_capacity(columns.len() * rows.len());
    for y in rows.clone() {
        let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
        let across = row[2..].iter().zip(row);
        let down = below[1..].iter().zip(&above[1..]);
        sizes.extend(across.zip(down).map(|((right, left), (low, high))| {
            let (dx, dy) = (right - left, low - high);
            (dx * dx + dy * dy).sqrt()
        }));
    }
    if sizes.is_empty() {
        return Vec::new();
    }
    let keep = ((sizes.len() as f64 * STRONGEST) as usize).max(50).min(sizes.len() - 1);
    // Numbers of one sign are ordered as their bits are, which compare faster.
    let mut bits: Vec<u32> = sizes.iter().map(|s| s.to_bits()).collect();
    let at = bits.len() - keep;
    let strong = f32::from_bits(*bits.select_nth_unstable(at).1);
    let least = strong.max(1.5 * look.noise as f32 / (blur * blur) as f32);
    let seen: Vec<usize> = (0..sizes.len()).filter(|&i| sizes[i] >= least).collect();
    let step = seen.len().div_ceil(VOTERS).max(1);
    seen.iter()
        .step_by(step)
        .map(|&i| {
            let (x, y) = (1 + i % columns.len(), 1 + i / columns.len());
            let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
            let (dx, dy) = (row[x + 1] - row[x - 1], below[x] - above[x]);
            let pixel = look.full(Vector2::new(x as f64, y as f64));
            let place = view.to_plane(pixel);
            // A gradient is a covector: it maps with the inverse transpose.
            let g = view.px_per_mm(place).transpose() * Vector2::new(f64::from(dx), f64::from(dy));
            Voter { place_mm: place + position, along: g.normalize(), capture }
        })
        .filter(|v| v.along.iter().all(|a| a.is_finite()))
        .collect()
}

/// The rim on which most edges of all captures agree. `radius_mm` bounds it.
pub(super) fn rim(voters: &[Voter], captures: usize, radius_mm: (f64, f64)) -> Option<Circle> {
    let mut center = center(voters, captures, radius_mm)?;
    let cell = 0.002 * radius_mm.1.min(40.0);
    let edges = radii(voters, captures, center, radius_mm, 6.0 * cell, 0.1);
    let strongest = edges.iter().max_by(|a, b| a.1.total_cmp(&b.1))?.0;
    // The centre is good to a few cells of the grid; edges sharpen as it is improved.
    let reach = (1.0 + 6.0 * cell).max(0.12 * strongest);
    let near: Vec<Voter> = radial(voters, center, (strongest - reach, strongest + reach), 0.12);
    // A wider look needs fewer.
    for (cells, every) in [(6.0, 4), (3.0, 2), (1.5, 1), (0.8, 1)] {
        let some: Vec<Voter> = near.iter().step_by(every).copied().collect();
        center = sharpest(&some, captures, center, cells * cell);
    }
    let width = (0.8 * cell).max(0.015);
    let edges = radii(&near, captures, center, (strongest - reach, strongest + reach), width, 0.06);
    let strongest = edges.iter().map(|e| e.1).fold(0.0, f64::max);
    // The rod is the outermost edge.
    let real = edges.iter().filter(|e| e.1 > 0.2 * strongest);
    let radius = real.map(|e| e.0).fold(0.0, f64::max);
    Some(Circle { center, radius })
}

/// Voters whose gradient points along the radius, within a range of radii.
fn radial(
    voters: &[Voter],
    center: Vector2<f64>,
    (near, far): (f64, f64),
    tolerance: f64,
) -> Vec<Voter> {
    voters
        .iter()
        .filter(|v| {
            let q = v.place_mm - center;
            let r = q.norm();
            r > near && r < far && (v.along.perp(&q) / r).abs() < tolerance
        })
        .copied()
        .collect()
}

/// The centre about which the edges gather at the sharpest radii, found from a few `width`s away.
fn sharpest(voters: &[Voter], captures: usize, start: Vector2<f64>, width: f64) -> Vector2<f64> {
    let mut each = vec![0.0f64; captures];
    voters.iter().for_each(|v| each[v.capture] += 1.0);
    let mut counts: Vec<f64> = Vec::new();
    let mut sharpness = |center: Vector2<f64>| -> f64 {
        let radii: Vec<f64> = voters.iter().map(|v| (v.place_mm - center).norm()).collect();
        let first = radii.iter().copied().fold(f64::INFINITY, f64::min);
        counts.clear();
        for (r, v) in radii.iter().zip(voters) {
            let x = (r - first) / width;
            let i = x as usize;
            let f = x - i as f64;
            if counts.len() < i + 2 {
                counts.resize(i + 2, 0.0);
            }
            let weight = 1.0 / each[v.capture].max(50.0);
            counts[i] += weight * (1.0 - f);
            counts[i + 1] += weight * f;
        }
        counts.iter().map(|c| c * c).sum()
    };
    let (mut best, mut value) = (start, sharpness(start));
    for step in [2.0 * width, width, 0.5 * width] {
        for _ in 0..12 {
            let around = (0..8).map(|i| {
                let (s, c) = (std::f64::consts::FRAC_PI_4 * f64::from(i)).sin_cos();
                best + step * Vector2::new(c, s)
            });
            let next = around.map(|p| (sharpness(p), p)).max_by(|a, b| a.0.total_cmp(&b.0));
            match next {
                Some((v, p)) if v > value => (value, best) = (v, p),
                _ => break,
            }
        }
    }
    best
}

fn center(voters: &[Voter], captures: usize, (near, far): (f64, f64)) -> Option<Vector2<f64>> {
    let (mut lo, mut hi) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for v in voters {
        lo = lo.inf(&v.place_mm);
        hi = hi.sup(&v.place_mm);
    }
    if voters.len() < 30 {
        return None;
    }
    let mut each = vec![0.0f32; captures];
    voters.iter().for_each(|v| each[v.capture] += 1.0);
    // A few captures of one side see the centre outside of them all.
    let alone = each.iter().filter(|n| **n > 0.0).count() == 1;
    let margin = if captures < 3 || alone { far } else { 0.3 * (hi - lo).max() };
    lo -= Vector2::repeat(margin);
    hi += Vector2::repeat(margin);
    let cell = (hi - lo).max() / CELLS;
    let (w, h) = (((hi.x - lo.x) / cell) as usize + 1, ((hi.y - lo.y) / cell) as usize + 1);
    let mut votes = Gray { width: w, height: h, data: vec![0.0f32; w * h] };
    let steps = ((far - near) / cell) as usize;
    for v in voters.iter().step_by(voters.len().div_ceil(CENTER_VOTERS)) {
        for sign in [1.0, -1.0] {
            let start = (v.place_mm + v.along * sign * near - lo) / cell;
            let (start, along) = (start.cast(), (sign * v.along).cast());
            find::vote(&mut votes, start, along, steps, 1.0 / each[v.capture]);
        }
    }
    let smooth = find::blur(&votes, 2.0);
    let at = (0..smooth.data.len()).max_by(|&a, &b| smooth.data[a].total_cmp(&smooth.data[b]))?;
    Some(lo + Vector2::new((at % w) as f64 + 0.5, (at / w) as f64 + 0.5) * cell)
}

/// Radii at which radial edges gather, with their weight: the mean over the captures of each one's share.
fn radii(
    voters: &[Voter],
    captures: usize,
    center: Vector2<f64>,
    (near, far): (f64, f64),
    width: f64,
    tolerance: f64,
) -> Vec<(f64, f64)> {
    let bins = ((far - near) / width).ceil().clamp(1.0, 1e6) as usize + 2;
    let mut counts = vec![0.0f64; bins];
    let mut each = vec![0.0f64; captures];
    let radial: Vec<(f64, usize)> = voters
        .iter()
        .filter_map(|v| {
            let q = v.place_mm - center;
            let r = q.norm();
            (r > near && r < far && (v.along.perp(&q) / r).abs() < tolerance)
                .then_some((r, v.capture))
        })
        .collect();
    radial.iter().for_each(|(_, c)| each[*c] += 1.0);
    for (r, c) in &radial {
        let bin = ((r - near) / width) as usize + 1;
        counts[bin.min(bins - 1)] += 1.0 / each[*c].max(50.0);
    }
    let smooth = |i: usize| counts[i - 1] + 2.0 * counts[i] + counts[i + 1];
    let mut peaks = Vec::new();
    for i in 2..bins.saturating_sub(2) {
        let v = smooth(i);
        if v > smooth(i - 1) && v >= smooth(i + 1) && v > 0.0 {
            let shift = (counts[i + 1] - counts[i - 1]) / v;
            peaks.push((near + (i as f64 - 0.5 + shift) * width, v));
        }
    }
    peaks
}
