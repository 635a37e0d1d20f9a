//! What one capture shows near a circle: the steps of brightness of its sectors, at every distance.

use nalgebra::Vector2;

use crate::camera::View;
use crate::edge::{Band, Contour, Profiles, scan};
use crate::fit::Circle;
use crate::frame::Frame;

/// How far outside and inside edges are looked for: wider than any chamfer.
const OUTSIDE_MM: f64 = 1.2;
const INSIDE_MM: f64 = 0.8;
/// Sectors along each arc.
const SECTORS: usize = 32;
/// Blocks of pixels across a bin, about: they say as much as pixels.
const BLOCKS: f64 = 1.4;
/// Bins on either side of a step.
const STEP: usize = 3;
/// One sector's step counts for this many standard deviations at most: dirt and glare must not speak for all.
const LOUDEST: f32 = 10.0;

/// The steps of brightness of one capture.
pub(super) struct Sight {
    /// Index of the capture's table angle.
    pub(super) angle: usize,
    /// How far inside the circle its bins begin, and how many there are.
    pub(super) inside_mm: f64,
    pub(super) bins: usize,
    /// Direction of each sector from the centre.
    toward: Vec<Vector2<f64>>,
    /// Step at each bin of each sector, counts; in its standard deviation, turned down where it is loud; and that smeared for a first look.
    counts: Vec<f32>,
    sharp: Vec<f32>,
    smeared: Vec<f32>,
}

impl Sight {
    pub(super) fn new(
        frame: &Frame,
        view: &View,
        about: Circle,
        [pixel_mm, bin_mm]: [f64; 2],
        angle: usize,
    ) -> Option<Self> {
        let contour = Contour::of_circle(view, about.center, about.radius)?;
        let inside_px = INSIDE_MM.min(0.5 * about.radius) / pixel_mm;
        let bin_px = bin_mm / pixel_mm;
        let band = Band { inside_px, outside_px: OUTSIDE_MM / pixel_mm, bin_px, sectors: SECTORS };
        let profiles = scan(frame, (bin_px / BLOCKS) as usize, &contour, band);
        let toward = profiles
            .angle_rad
            .iter()
            .map(|&a| (view.to_plane(contour.point(a, 0.0)) - about.center).normalize())
            .collect();
        let bins = profiles.bins;
        let counts = steps(&profiles);
        let sharp = turned_down(counts.clone(), bins);
        let smeared = sharp.chunks(bins).flat_map(smear).collect();
        let inside_mm = inside_px * pixel_mm;
        (sharp.iter().any(|s| *s != 0.0)).then_some(Self {
            angle,
            inside_mm,
            bins,
            toward,
            counts,
            sharp,
            smeared,
        })
    }

    /// Step of brightness across a circle about the shifted centre, for every radius, counts.
    pub(super) fn step(&self, shift: Vector2<f64>, bin_mm: f64, out: &mut [f32]) {
        self.add(&self.counts, shift, bin_mm, out);
        let scale = 1.0 / self.toward.len() as f32;
        out.iter_mut().for_each(|o| *o *= scale);
    }

    /// How clearly a circle about the shifted centre is an edge of this capture, for every radius: the mean of the
    /// sectors' steps, in standard errors.
    pub(super) fn evidence(&self, shift: Vector2<f64>, fine: bool, bin_mm: f64, out: &mut [f32]) {
        self.add(if fine { &self.sharp } else { &self.smeared }, shift, bin_mm, out);
        let scale = 1.0 / (self.toward.len() as f32).sqrt();
        out.iter_mut().for_each(|o| *o *= scale);
    }

    /// Sums of the sectors' steps about the shifted centre.
    fn add(&self, steps: &[f32], shift: Vector2<f64>, bin_mm: f64, out: &mut [f32]) {
        out.fill(0.0);
        for (row, toward) in steps.chunks(self.bins).zip(&self.toward) {
            let offset = nearest(toward.dot(&shift) / bin_mm);
            let (from, to) = (offset.max(0) as usize, (-offset).max(0) as usize);
            for (o, s) in out.iter_mut().skip(to).zip(row.iter().skip(from)) {
                *o += s;
            }
        }
    }
}

/// As `round`, several times as fast.
fn nearest(x: f64) -> isize {
    (x + 0.5f64.copysign(x)) as isize
}

/// Step across every bin of every sector, counts.
fn steps(profiles: &Profiles) -> Vec<f32> {
    let bins = profiles.bins;
    let mut list = vec![0.0f32; profiles.count.len()];
    for s in 0..profiles.sectors() {
        let row = profiles.range(s);
        let (count, value) = (&profiles.count[row.clone()], &profiles.value[row.clone()]);
        let side = |range: std::ops::Range<usize>| {
            let n: f32 = count[range.clone()].iter().sum();
            let sum: f32 = range.map(|i| count[i] * value[i]).sum();
            (n > 0.0).then(|| sum / n)
        };
        for b in STEP..bins.saturating_sub(STEP) {
            if let (Some(out), Some(inn)) = (side(b + 1..b + 1 + STEP), side(b - STEP..b)) {
                list[row.start + b] = out - inn;
            }
        }
    }
    list
}

/// Steps in standard deviations of all of a capture's. What is louder than it may be is turned down with all about it: cut off, a
/// clear rim and a clear chamfer's edge near it would be one broad step.
fn turned_down(mut list: Vec<f32>, bins: usize) -> Vec<f32> {
    let mut sizes: Vec<f32> = list.iter().map(|s| s.abs()).filter(|s| *s > 0.0).collect();
    if sizes.is_empty() {
        return list;
    }
    let (middle, high) = (sizes.len() / 2, sizes.len() * 99 / 100);
    let typical = 1.48 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
    let strong = *sizes.select_nth_unstable_by(high, f32::total_cmp).1;
    // A picture without noise still has no edges of a two-hundredth of its contrast.
    let scale = typical.max(0.005 * strong);
    list.iter_mut().for_each(|s| *s /= scale);
    let mut quiet = Vec::with_capacity(list.len());
    for row in list.chunks(bins) {
        quiet.extend((0..bins).map(|b| {
            let near = &row[b.saturating_sub(STEP)..(b + STEP + 1).min(bins)];
            let loudest = near.iter().fold(LOUDEST, |most, s| most.max(s.abs()));
            row[b] * LOUDEST / loudest
        }));
    }
    quiet
}

/// Mean over five bins.
fn smear(row: &[f32]) -> Vec<f32> {
    (0..row.len())
        .map(|i| {
            let near = &row[i.saturating_sub(2)..(i + 3).min(row.len())];
            near.iter().sum::<f32>() / near.len() as f32
        })
        .collect()
}
