//! Every gradient votes along its own line; the centres of circles collect the votes.

use nalgebra::Vector2;

use crate::find::look::{FRACTION, Look, blur, fixed};
use crate::find::{Candidate, Options};
use crate::frame::Gray;

/// The strongest share of the gradients at each scale that votes.
const STRONGEST: f64 = 0.12;

/// Most of them that vote.
const VOTERS: usize = 6000;

/// Gradients so many softnesses from a known edge that point so much as its own (cosine) are the edge's.
const BESIDE: f64 = 2.5;
const ALONG: f64 = 0.9;

/// Likely centres in reduced pixels, best first: with all edges voting, and then without the known ones.
pub(super) fn centers(look: &Look, options: Options) -> Vec<Vector2<f64>> {
    let mut found = vec![Vec::new(); if options.known.is_empty() { 1 } else { 2 }];
    for (scale, image) in &look.scales {
        let place = options
            .near
            .map(|(p, r)| (look.reduced(p), (r + options.most_radius_px) / look.factor as f64));
        // Neighbouring gradients of a blurred picture say the same.
        let stride = (0.6 * scale).ceil() as usize;
        let mut gradients = gradients(image, stride, place);
        for (pass, found) in found.iter_mut().enumerate() {
            if pass == 1 {
                let known: Vec<Edge> =
                    options.known.iter().map(|c| Edge::new(c, look, *scale)).collect();
                gradients.retain(|g| !known.iter().any(|edge| edge.has(g)));
            }
            found.extend(peaks_of(&gradients, look, *scale, options));
        }
    }
    let mut kept = Vec::new();
    for mut found in found {
        if let Some((place, reach)) = options.near {
            let (place, reach) = (look.reduced(place), reach / look.factor as f64);
            found.retain(|(_, p)| (p - place).norm() <= reach);
            found.insert(0, (f32::INFINITY, place));
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let likely = apart(found.into_iter().map(|(_, p)| p));
        kept.extend(likely.into_iter().take(2 * options.centers));
    }
    apart(kept)
}

/// Where the lines of gradients at one scale meet, in reduced pixels, and how clearly.
fn peaks_of(
    gradients: &[Gradient],
    look: &Look,
    scale: f64,
    options: Options,
) -> Vec<(f32, Vector2<f64>)> {
    let (w, h) = look.size();
    let k = look.factor as f64;
    let (near, far) = (options.least_radius_px / k, options.most_radius_px / k);
    // Centres may lie outside the frame by a third of its size; of a narrow strip by no more than its circles reach.
    let third = w.max(h) / 3;
    let pad = if third > w.min(h) { third.min(far.ceil() as usize + 1) } else { third };
    // Lines meet less sharply for soft edges.
    let side = (1.5 + 0.5 * scale).round() as usize;
    let cells = 1.0 / side as f64;
    let cell = side as f32;
    let whole = [(w + 2 * pad) / side + 1, (h + 2 * pad) / side + 1];
    let (meet, about) = ((1.0 + 0.5 * scale) * cells, (6.0 + 3.0 * scale) * cells);
    let least = threshold(gradients, look.noise / scale.powi(2));
    // Where no line leads there is no peak: what votes may reach, and what is needed about it.
    let reached = options.near.map(|(p, r)| {
        let reach = (r / k + 2.0 * far) * cells + 3.0 * meet + 3.0f64.sqrt() * about + 4.0;
        ((look.reduced(p) + Vector2::repeat(pad as f64 + 0.5)) * cells, reach)
    });
    let mut votes = Votes::new(whole, reached);
    let strong: Vec<&Gradient> = gradients.iter().filter(|g| g.size >= least).collect();
    for g in strong.iter().step_by(strong.len().div_ceil(VOTERS).max(1)) {
        // Strong edges count more, but not by their full strength: a lamp is no better circle than a burn.
        let weight = (g.size / least).sqrt().min(2.0);
        let (dx, dy) = (g.dx / g.size, g.dy / g.size);
        for sign in [1.0f32, -1.0] {
            let (sx, sy) = (sign * dx, sign * dy);
            let r = near.max(1.0) as f32;
            let x = (g.x as f32 + pad as f32 + r * sx + 0.5) / cell;
            let y = (g.y as f32 + pad as f32 + r * sy + 0.5) / cell;
            // A line's votes spread with distance: what meets at a far centre counts as much as near.
            let steps = ((far - near) as f32 / cell) as usize + 1;
            votes.add(Vector2::new(x, y), Vector2::new(sx, sy), steps, weight);
        }
    }
    let peaked = above_surroundings(&blur(&votes.cells, meet), about);
    let corner = votes.corner.map(|c| c as f64);
    let middle = Vector2::repeat(pad as f64 + 0.5);
    let mut list = peaks(&peaked, options.centers, 5.0 * cells);
    for (_, p) in &mut list {
        *p = (*p + corner + Vector2::repeat(0.5)) * side as f64 - middle;
    }
    list
}

/// Those that are not one with an earlier one.
fn apart(centers: impl IntoIterator<Item = Vector2<f64>>) -> Vec<Vector2<f64>> {
    let mut kept: Vec<Vector2<f64>> = Vec::new();
    for p in centers {
        if kept.iter().all(|q| (p - q).norm() > 2.5) {
            kept.push(p);
        }
    }
    kept
}

/// How far each cell's votes lie above the mean of the cells about it, over that mean's root. `sd` is the standard deviation of
/// the square it is taken over, each way.
fn above_surroundings(votes: &Gray<f32>, sd: f64) -> Gray<f32> {
    let (w, h) = (votes.width, votes.height);
    let half = (3.0f64.sqrt() * sd).round() as usize;
    // Sums of all cells above and left of each corner.
    let mut sums = vec![0.0f64; (w + 1) * (h + 1)];
    for y in 0..h {
        let mut row = 0.0;
        for x in 0..w {
            row += f64::from(votes.data[y * w + x]);
            sums[(y + 1) * (w + 1) + x + 1] = sums[y * (w + 1) + x + 1] + row;
        }
    }
    let mut data = Vec::with_capacity(w * h);
    for y in 0..h {
        let (top, low) = (y.saturating_sub(half), (y + half + 1).min(h));
        let (above, below) = (&sums[top * (w + 1)..], &sums[low * (w + 1)..]);
        let row = votes.row(y);
        let over = |mean: f32, v: f32| (v - mean) / (mean + 1.0).sqrt();
        let beside = |x: usize| {
            let (left, right) = (x.saturating_sub(half), (x + half + 1).min(w));
            let sum = below[right] - below[left] - above[right] + above[left];
            over(sum as f32 / ((low - top) * (right - left)) as f32, row[x])
        };
        // Clear of both ends all are alike.
        let (first, last) = (half.min(w), w.saturating_sub(half).max(half.min(w)));
        data.extend((0..first).map(beside));
        let count = ((low - top) * (2 * half + 1)) as f32;
        let (wide, inner) = (2 * half + 1, last - first);
        if inner > 0 {
            let (b, a) = (&below[..inner + wide], &above[..inner + wide]);
            let lefts = b[..inner].iter().zip(&a[..inner]);
            let rights = b[wide..].iter().zip(&a[wide..]);
            data.extend(lefts.zip(rights).zip(&row[first..last]).map(
                |(((below_left, above_left), (below_right, above_right)), v)| {
                    let sum = below_right - below_left - above_right + above_left;
                    over(sum as f32 / count, *v)
                },
            ));
        }
        data.extend((last..w).map(beside));
    }
    Gray { width: w, height: h, data }
}

/// Adds `weight` to the cells that a line comes through, at most `steps` of them, while it is inside; places in cells.
pub(crate) fn vote(
    votes: &mut Gray<f32>,
    start: Vector2<f32>,
    along: Vector2<f32>,
    steps: usize,
    weight: f32,
) {
    let whole = [votes.width, votes.height];
    add(votes, whole, Vector2::zeros(), (start, along), steps, weight);
}

/// Cells of a part of the frame.
struct Votes {
    cells: Gray<f32>,
    /// Columns and rows of the whole frame, and those before the part's.
    whole: [usize; 2],
    corner: Vector2<usize>,
}

impl Votes {
    /// Of the whole frame, or of what lies within a distance of a place, each way.
    fn new(whole: [usize; 2], within: Option<(Vector2<f64>, f64)>) -> Self {
        let span = |i: usize| match within {
            Some((p, r)) => {
                let limit = |v: f64| v.clamp(0.0, whole[i] as f64) as usize;
                let first = limit(p[i] - r).min(whole[i].saturating_sub(3));
                first..limit(p[i] + r + 1.0).max(first + 3).min(whole[i])
            }
            None => 0..whole[i],
        };
        let (columns, rows) = (span(0), span(1));
        let (width, height) = (columns.len(), rows.len());
        let cells = Gray { width, height, data: vec![0.0f32; width * height] };
        Self { cells, whole, corner: Vector2::new(columns.start, rows.start) }
    }

    /// See [`vote`]; places in the whole frame's cells.
    fn add(&mut self, start: Vector2<f32>, along: Vector2<f32>, steps: usize, weight: f32) {
        add(&mut self.cells, self.whole, self.corner, (start, along), steps, weight);
    }
}

fn add(
    cells: &mut Gray<f32>,
    whole: [usize; 2],
    corner: Vector2<usize>,
    (start, along): (Vector2<f32>, Vector2<f32>),
    steps: usize,
    weight: f32,
) {
    let inside =
        within(start.x, along.x, whole[0] as f32).min(within(start.y, along.y, whole[1] as f32));
    // In whole numbers of a part of a cell: a line's cells are found by adding.
    let fixed = |place: Vector2<f32>| (fixed(f64::from(place.x)), fixed(f64::from(place.y)));
    let ((u, v), (along_u, along_v)) = (fixed(start), fixed(along));
    let (mut u, mut v) = (u - ((corner.x as i32) << FRACTION), v - ((corner.y as i32) << FRACTION));
    for _ in 0..steps.min(inside) {
        let at = (v >> FRACTION) * cells.width as i32 + (u >> FRACTION);
        // Rounding may lead a line's end over the border.
        if let Some(cell) = cells.data.get_mut(at as usize) {
            *cell += weight;
        }
        u += along_u;
        v += along_v;
    }
}

/// Steps of a line from `start`, each by `step`, that stay in 0..`size`.
fn within(start: f32, step: f32, size: f32) -> usize {
    if !(0.0..size).contains(&start) {
        return 0;
    }
    let end = if step > 0.0 { size } else { 0.0 };
    // One more than whole steps to the end: the first is at the start. Along a border there is no end.
    ((end - start) / step).abs().min(1e6) as usize + 1
}

struct Gradient {
    x: usize,
    y: usize,
    dx: f32,
    dy: f32,
    size: f32,
}

/// A known edge in reduced pixels, seen through a blur.
struct Edge {
    center: Vector2<f64>,
    radius: f64,
    sense: f64,
    width: f64,
}

impl Edge {
    fn new(c: &Candidate, look: &Look, blur: f64) -> Self {
        let k = look.factor as f64;
        Self {
            center: look.reduced(c.circle.center),
            radius: c.circle.radius / k,
            sense: c.step.signum(),
            width: BESIDE * (c.softness_px / k).hypot(blur) + c.scatter_px / k,
        }
    }

    /// Whether a gradient is one of its own.
    fn has(&self, g: &Gradient) -> bool {
        let from = Vector2::new(g.x as f64, g.y as f64) - self.center;
        let apart = from.norm();
        let along = from.x * f64::from(g.dx) + from.y * f64::from(g.dy);
        (apart - self.radius).abs() < self.width
            && along * self.sense > ALONG * apart * f64::from(g.size)
    }
}

/// Gradients at every `stride`th pixel each way, every other of them left out as on a chessboard.
fn gradients(
    image: &Gray<f32>,
    stride: usize,
    within: Option<(Vector2<f64>, f64)>,
) -> Vec<Gradient> {
    let mut list = Vec::with_capacity(image.data.len() / (2 * stride * stride));
    for y in (1..image.height.saturating_sub(1)).step_by(stride) {
        let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
        // Of a row the part within reach.
        let (least, most) = match within {
            Some((p, r)) => {
                let half2 = r * r - (y as f64 - p.y).powi(2);
                if half2 < 0.0 {
                    continue;
                }
                ((p.x - half2.sqrt()).ceil().max(0.0) as usize, (p.x + half2.sqrt()).max(-1.0))
            }
            None => (0, f64::INFINITY),
        };
        let end = (image.width - 1).min((most + 1.0) as usize);
        let parity = 1 + (y / stride % 2) * stride;
        let first = parity + least.saturating_sub(parity).div_ceil(2 * stride) * 2 * stride;
        for x in (first..end).step_by(2 * stride) {
            let (dx, dy) = (row[x + 1] - row[x - 1], below[x] - above[x]);
            let size = (dx * dx + dy * dy).sqrt();
            list.push(Gradient { x, y, dx, dy, size });
        }
    }
    list
}

/// The size that the strongest share reaches, but no less than clear of the noise.
fn threshold(gradients: &[Gradient], noise: f64) -> f32 {
    // Numbers of one sign are ordered as their bits are, which compare faster.
    let mut sizes: Vec<u32> = gradients.iter().map(|g| g.size.to_bits()).collect();
    if sizes.is_empty() {
        return f32::INFINITY;
    }
    let at = ((sizes.len() as f64 * (1.0 - STRONGEST)) as usize).min(sizes.len() - 1);
    let strong = f32::from_bits(*sizes.select_nth_unstable(at).1);
    strong.max(1.5 * noise as f32).max(1e-6)
}

/// Local maxima, highest first, no two within a few pixels.
fn peaks(image: &Gray<f32>, count: usize, apart: f64) -> Vec<(f32, Vector2<f64>)> {
    let mut list = Vec::new();
    let w = image.width;
    if w < 3 {
        return list;
    }
    let mut highest = vec![false; w - 2];
    for y in 1..image.height - 1 {
        let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
        let (before, after) = (&row[..w - 2], &row[2..]);
        let (above, row, below) = (&above[1..w - 1], &row[1..w - 1], &below[1..w - 1]);
        for (x, highest) in highest.iter_mut().enumerate() {
            let v = row[x];
            *highest =
                (v > 0.0) & (v >= before[x]) & (v > after[x]) & (v >= above[x]) & (v > below[x]);
        }
        for (x, _) in highest.iter().enumerate().filter(|(_, highest)| **highest) {
            list.push((row[x], Vector2::new((x + 1) as f64, y as f64)));
        }
    }
    list.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<(f32, Vector2<f64>)> = Vec::new();
    for (v, p) in list {
        if kept.len() == count {
            break;
        }
        if kept.iter().all(|(_, q)| (p - q).norm() > apart) {
            kept.push((v, p));
        }
    }
    kept
}
