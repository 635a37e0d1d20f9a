//! Reads every pixel of a band along a contour once and sorts it into profiles: one a sector, over the
//! distance from the contour.

use crate::edge::{Contour, Side, wrap};
use crate::frame::{Frame, Gray, MOST_JOINED, Pixel};

/// The band to read.
#[derive(Debug, Clone, Copy)]
pub struct Band {
    /// How far inside the contour it begins (positive).
    pub inside_px: f64,
    /// How far outside the contour it ends.
    pub outside_px: f64,
    /// Width of a bin of distance.
    pub bin_px: f64,
    /// Number of sectors along the contour.
    pub sectors: usize,
}

/// Profiles over distance, one a sector.
#[derive(Debug, Clone)]
pub struct Profiles {
    /// The band that was read.
    pub band: Band,
    /// Bins a profile.
    pub bins: usize,
    /// Polar angle of each sector's middle.
    pub angle_rad: Vec<f64>,
    /// Pixels in each bin, sector by sector.
    pub count: Vec<f32>,
    /// Mean value of those pixels.
    pub value: Vec<f32>,
    /// Mean distance of those pixels from the contour, outside positive.
    pub distance_px: Vec<f32>,
    /// The highest pixel value in the band.
    pub top: f32,
    /// The side that is clipped and has been taken out.
    pub hidden: Option<Side>,
}

/// Where more of the sectors are clipped it is the picture's own background, not a glare.
pub(super) const BACKGROUND: f64 = 0.85;

/// Values at which cameras of 8 to 16 bits clip, 10 and 12 bits in the high bits of 16 included.
const CLIPS: [f32; 8] = [255.0, 1023.0, 4095.0, 16383.0, 65472.0, 65520.0, 65532.0, 65535.0];

impl Profiles {
    /// The value at which the camera clips, where any pixel of the band is there.
    pub fn clip(&self) -> Option<f32> {
        CLIPS.iter().any(|c| (self.top - c).abs() <= 1e-4 * c).then_some(self.top)
    }

    /// Takes out what light has clipped: bins at the top value, with a margin, where some sectors are not.
    pub fn mask_glare(&mut self) {
        const MARGIN: usize = 3;
        let Some(top) = self.clip() else { return };
        let clipped = |i: usize| self.count[i] > 0.0 && self.value[i] >= top * (1.0 - 1e-4);
        let (bins, sectors) = (self.bins, self.sectors());
        let mut masked = vec![false; self.count.len()];
        for b in 0..bins {
            let column = || (0..sectors).map(|s| s * bins + b);
            let seen = column().filter(|&i| self.count[i] > 0.0).count();
            let lost: Vec<usize> = column().filter(|&i| clipped(i)).collect();
            if (lost.len() as f64) < BACKGROUND * seen as f64 {
                for i in lost {
                    let from = b.saturating_sub(MARGIN);
                    let to = (b + MARGIN).min(bins - 1);
                    masked[i - (b - from)..=i + (to - b)].fill(true);
                }
            }
        }
        for (count, _) in self.count.iter_mut().zip(&masked).filter(|(_, m)| **m) {
            *count = 0.0;
        }
    }

    /// The range of `sector`'s bins in the flat lists.
    pub fn range(&self, sector: usize) -> std::ops::Range<usize> {
        sector * self.bins..(sector + 1) * self.bins
    }

    /// Number of sectors.
    pub fn sectors(&self) -> usize {
        self.angle_rad.len()
    }

    /// The same with pairs of neighbouring sectors joined.
    pub fn halved(&self) -> Self {
        let sectors = self.sectors() / 2;
        let bins = self.bins;
        let mut joined = Self {
            band: Band { sectors, ..self.band },
            bins,
            angle_rad: (0..sectors)
                .map(|s| 0.5 * (self.angle_rad[2 * s] + self.angle_rad[2 * s + 1]))
                .collect(),
            count: vec![0.0; sectors * bins],
            value: vec![0.0; sectors * bins],
            distance_px: vec![0.0; sectors * bins],
            top: self.top,
            hidden: self.hidden,
        };
        for s in 0..sectors {
            for b in 0..bins {
                let (i, j, k) = (2 * s * bins + b, (2 * s + 1) * bins + b, s * bins + b);
                let count = self.count[i] + self.count[j];
                if count > 0.0 {
                    joined.count[k] = count;
                    joined.value[k] =
                        (self.count[i] * self.value[i] + self.count[j] * self.value[j]) / count;
                    joined.distance_px[k] = (self.count[i] * self.distance_px[i]
                        + self.count[j] * self.distance_px[j])
                        / count;
                }
            }
        }
        joined
    }

    /// Distance of a bin's middle.
    pub fn bin_middle_px(&self, bin: usize) -> f64 {
        -self.band.inside_px + (bin as f64 + 0.5) * self.band.bin_px
    }
}

/// Reads a band of a frame, reduced by `factor` (see [`Gray::reduce`]) where the edge is soft enough for that; contour and
/// band are in pixels of the full frame.
pub fn scan(frame: &Frame, factor: usize, contour: &Contour, band: Band) -> Profiles {
    match frame {
        Frame::Eight(g) => scan_pixels(g, factor, contour, band),
        Frame::Sixteen(g) => scan_pixels(g, factor, contour, band),
    }
}

fn scan_pixels<T: Pixel>(
    image: &Gray<T>,
    factor: usize,
    contour: &Contour,
    band: Band,
) -> Profiles {
    let factor = factor.clamp(1, MOST_JOINED);
    let bins = (((band.inside_px + band.outside_px) / band.bin_px).ceil() as usize).max(1);
    let mut cells = vec![Cell::default(); bins * band.sectors];
    let mut top = f32::NEG_INFINITY;
    let k = factor as f64;
    let middle = (k - 1.0) / 2.0;
    let (ox, oy) = (contour.origin_px.x, contour.origin_px.y);
    let outer = contour.max_radius_px() + band.outside_px;
    let inner = (contour.min_radius_px() - band.inside_px).max(0.0);
    let sector_scale = band.sectors as f64 / contour.span_rad;
    let sector_at = |angle: f64| {
        let inside = angle < contour.span_rad;
        inside.then(|| ((angle * sector_scale) as usize).min(band.sectors - 1))
    };
    let bin_scale = 1.0 / band.bin_px;
    let (width, height) = (image.width / factor, image.height / factor);
    let (mut columns, mut pixels) = (Vec::new(), Vec::new());
    // Far from the centre the angle changes evenly over some pixels.
    let even = ((inner / (EVEN * k)) as usize).clamp(1, MOST_EVEN);
    let rows = row_range(oy - outer, oy + outer, k, middle, height);
    for j in rows {
        let dy = j as f64 * k + middle - oy;
        let reach = (outer * outer - dy * dy).max(0.0).sqrt();
        let hole = (inner * inner - dy * dy).max(0.0).sqrt();
        let spans = if hole > 0.0 {
            [(-reach, -hole), (hole, reach)]
        } else {
            [(-reach, reach), (1.0, 0.0)]
        };
        for (from, to) in spans {
            if from > to {
                continue;
            }
            let columns_read = row_range(ox + from, ox + to, k, middle, width);
            pixels.clear();
            image.blocks(factor, j, columns_read.clone(), &mut columns, &mut pixels);
            let mut dx = columns_read.start as f64 * k + middle - ox;
            let mut here = Place::of(contour, dx, dy);
            for part in pixels.chunks(even) {
                let next = Place::of(contour, dx + k * part.len() as f64, dy);
                let share = 1.0 / part.len() as f64;
                let turn = share * wrap(next.angle - here.angle);
                let grow = share * (next.radius - here.radius);
                // Of all at once, in the band or not: the processor takes several roots at a time.
                let mut distances = [0.0; MOST_EVEN];
                for (i, distance) in distances[..part.len()].iter_mut().enumerate() {
                    let (i, x) = (i as f64, dx + k * i as f64);
                    *distance = ((x * x + dy * dy).sqrt() - here.radius - i * grow) * here.cos;
                }
                // Most parts lie in one sector.
                let end = here.angle + (part.len() - 1) as f64 * turn;
                let first = sector_at(here.angle);
                let one = end >= 0.0 && first == sector_at(end);
                for (i, (&pixel, &distance)) in part.iter().zip(&distances).enumerate() {
                    let bin = (distance + band.inside_px) * bin_scale;
                    if bin < 0.0 || bin >= bins as f64 {
                        continue;
                    }
                    let own = || sector_at(positive(here.angle + i as f64 * turn));
                    let Some(sector) = (if one { first } else { own() }) else { continue };
                    cells[sector * bins + bin as usize].add(pixel, distance as f32);
                    top = top.max(pixel);
                }
                dx += k * part.len() as f64;
                here = next;
            }
        }
    }
    let mean = |sum: usize| -> Vec<f32> {
        cells.iter().map(|c| if c.0[0] > 0.0 { c.0[sum] / c.0[0] } else { 0.0 }).collect()
    };
    let step = contour.span_rad / band.sectors as f64;
    let angle_rad =
        (0..band.sectors).map(|s| contour.start_rad + (s as f64 + 0.5) * step).collect();
    Profiles {
        band,
        bins,
        angle_rad,
        count: cells.iter().map(|c| c.0[0]).collect(),
        value: mean(1),
        distance_px: mean(2),
        top,
        hidden: None,
    }
}

/// Pixels over which the angle changes evenly, at most, and how many times farther away the centre must be.
const MOST_EVEN: usize = 16;
const EVEN: f64 = 24.0;

/// What falls into one bin of one sector: pixels, the sums of their values and distances, and nothing, as the processor adds four at
/// once.
#[derive(Clone, Copy, Default)]
struct Cell([f32; 4]);

impl Cell {
    #[inline]
    fn add(&mut self, value: f32, distance_px: f32) {
        let pixel = [1.0, value, distance_px, 0.0];
        self.0.iter_mut().zip(pixel).for_each(|(sum, v)| *sum += v);
    }
}

/// Where a pixel lies: angle from the contour's start in 0..2π, radius and normal's cosine of the contour there.
struct Place {
    angle: f64,
    radius: f64,
    cos: f64,
}

impl Place {
    #[inline]
    fn of(contour: &Contour, dx: f64, dy: f64) -> Self {
        let angle = positive(atan2(dy, dx) - contour.start_rad);
        let (radius, cos) = contour.at(angle);
        Self { angle, radius, cos }
    }
}

/// An angle brought into 0..2π from not far outside.
#[inline]
fn positive(mut angle: f64) -> f64 {
    while angle < 0.0 {
        angle += std::f64::consts::TAU;
    }
    while angle >= std::f64::consts::TAU {
        angle -= std::f64::consts::TAU;
    }
    angle
}

/// Indices of reduced pixels whose middles lie between two full-picture coordinates.
fn row_range(from: f64, to: f64, k: f64, middle: f64, size: usize) -> std::ops::Range<usize> {
    let first = ((from - middle) / k).ceil().clamp(0.0, size as f64) as usize;
    let last = (((to - middle) / k).floor() + 1.0).clamp(0.0, size as f64) as usize;
    first..last.max(first)
}

/// atan2 to 2e-6 rad: enough to look up a contour's radius, several times faster than the exact one.
#[inline]
fn atan2(y: f64, x: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax > ay { (ay, ax) } else { (ax, ay) };
    if large == 0.0 {
        return 0.0;
    }
    let t = small / large;
    let s = t * t;
    // Minimax polynomial for atan on [0, 1] (Abramowitz & Stegun 4.4.49 refined).
    let mut a = t
        * (0.999_999_335_5
            + s * (-0.333_298_560_2
                + s * (0.199_465_559_9
                    + s * (-0.139_085_335_1
                        + s * (0.096_420_044_1
                            + s * (-0.055_909_886_1
                                + s * (0.021_861_229_2 - s * 0.004_054_058)))))));
    if ay > ax {
        a = std::f64::consts::FRAC_PI_2 - a;
    }
    if x < 0.0 {
        a = std::f64::consts::PI - a;
    }
    if y < 0.0 { -a } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_arctangent_is_close() {
        for i in 0..1000 {
            let t = f64::from(i) * 0.00629 - std::f64::consts::PI;
            assert!((atan2(t.sin(), t.cos()) - t.sin().atan2(t.cos())).abs() < 2e-6, "{t}");
        }
    }
}
