//! The edge of a small mark on a textured surface, all round at once.
//!
//! A sector's profile alone cannot tell a line of brushed metal that runs along the edge from the edge. Its neighbours can, and the
//! surface on both sides: lines go on. So the picture about the mark is whitened by the texture's own power
//! ([`Texture`]), and the shifts of all places round the contour are found together by least squares. Their covariance
//! says what the texture leaves unknown.

use nalgebra::{DMatrix, DVector};

use crate::edge::shape::Shape;
use crate::edge::texture::Texture;
use crate::edge::window::{Block, Window};
use crate::edge::{Contour, Located};
use crate::fit::robust::{median, scatter};
use crate::frame::{Frame, MOST_JOINED};

/// Most softnesses of a radius: the edge of a larger mark is long enough to know by itself.
const SMALL: f64 = 16.0;
/// Blocks of pixels a softness.
const FINENESS: f64 = 2.0;
/// Softnesses from its middle where an edge has ended.
const ENDS: f64 = 1.5;
/// Softnesses either side that are looked at, and the least of that in pixels.
const WIDE: f64 = 8.0;
const LEAST_PX: f64 = 8.0;
/// Softnesses from its middle between which an edge's slope fades away.
const FADED: std::ops::Range<f64> = 2.0..3.0;
/// How often the profile is smoothed for that.
const SMOOTH: usize = 4;
/// Standard deviations of the texture beyond which a block is dirt.
const DIRT: f64 = 4.0;
/// Blocks of a side of the edge that tell its level.
const LEAST_BLOCKS: usize = 24;
/// Columns for what is not known of the light: level and slope inside and outside.
const LIGHT: usize = 6;

/// The edge at some places round a contour.
pub struct Together {
    /// Polar angle of each.
    pub angle_rad: Vec<f64>,
    /// Distance of the edge from the contour along its normal.
    pub distance_px: Vec<f64>,
    /// Covariance of the distances from the texture.
    pub covariance_px2: DMatrix<f64>,
}

/// Finds the edge near a closed contour that it was fitted to (`located` says how it looks there), looking as far as `sides_px` inside
/// and outside. `None` where the mark is too large or the surface has nothing to teach.
pub fn together(
    frame: &Frame,
    contour: &Contour,
    located: &Located,
    sides_px: (f64, f64),
    glare: Option<f32>,
) -> Option<Together> {
    let softness = located.step.softness_px;
    let wide = (WIDE * softness).max(LEAST_PX);
    let sides_px = (sides_px.0.min(wide), sides_px.1.min(wide));
    let half = contour.max_radius_px() + sides_px.1;
    let factor = (softness / FINENESS).floor().clamp(1.0, MOST_JOINED as f64);
    if !contour.closed || contour.mean_radius_px() > SMALL * softness {
        return None;
    }
    let window = Window::read(frame, factor as usize, contour.origin_px, half)?;
    let places = (contour.length_px() / (2.0 * factor).max(1.4 * softness)) as usize;
    let places = places.clamp(12, 36);
    let alive = alive(located, contour, places);
    let mut blocks = window.blocks(contour, places, glare, sides_px, &alive);
    let surface = Surface::new(&window, &mut blocks, located)?;
    let texture = Texture::learn(&surface.bare, &surface.is_bare)?;
    let columns = whitened(&texture, &surface.columns(&blocks, places));
    solve(&columns, contour, &alive, softness.max(1.0))
}

/// Which of the places round the contour show the edge, as its sectors have told.
fn alive(located: &Located, contour: &Contour, places: usize) -> Vec<bool> {
    let (mut good, mut all) = (vec![0usize; places], vec![0usize; places]);
    for p in &located.points {
        let turn = (p.angle_rad - contour.start_rad).rem_euclid(std::f64::consts::TAU);
        let at = (turn / std::f64::consts::TAU * places as f64).round() as usize % places;
        all[at] += 1;
        good[at] += usize::from(p.usable);
    }
    good.iter().zip(&all).map(|(g, a)| 2 * g >= *a).collect()
}

/// The blocks' differences from the common profile, in standard deviations of the texture there.
struct Surface {
    /// The differences; 0 where a block does not count.
    left: DMatrix<f64>,
    /// The same where there is no edge, and 1 there.
    bare: DMatrix<f64>,
    is_bare: DMatrix<f64>,
    /// The common profile's slope a pixel and its outer side's share, each in standard deviations.
    slope: DMatrix<f64>,
    sides: DMatrix<[f64; 2]>,
}

impl Surface {
    /// Compares; takes dirt out of `blocks`.
    fn new(
        window: &Window,
        blocks: &mut DMatrix<Option<Block>>,
        located: &Located,
    ) -> Option<Self> {
        let size = blocks.nrows();
        let shape = Shape::of(&located.template);
        // What is left of texture in the common profile must not pass for edge.
        let mut smooth = located.template.clone();
        smooth.smooth(SMOOTH);
        let smooth = Shape::of(&smooth);
        let step = located.step;
        let ends = (ENDS * step.softness_px).max(window.factor);
        let nothing = || DMatrix::<f64>::zeros(size, size);
        let (mut left, mut slope, mut sides) =
            (nothing(), nothing(), DMatrix::from_element(size, size, [0.0; 2]));
        let counted: Vec<(usize, Block)> =
            blocks.iter().enumerate().filter_map(|(i, b)| b.map(|b| (i, b))).collect();
        for &(i, b) in &counted {
            let value = shape.at(step.distance_px + b.distance_px);
            let outer = ((value.profile - step.inner) / step.contrast()).clamp(0.0, 1.0);
            left[i] = window.values[i] - value.profile;
            let away = b.distance_px.abs() / step.softness_px;
            let near = ((FADED.end - away) / (FADED.end - FADED.start)).clamp(0.0, 1.0);
            slope[i] = near * smooth.at(step.distance_px + b.distance_px).slope;
            sides[i] = [1.0 - outer, outer];
        }
        let of_side = |sign: f64| {
            let there = counted.iter().filter(|(_, b)| sign * b.distance_px > ends);
            level_and_spread(there.map(|(i, _)| left[*i]).collect())
        };
        let outside = of_side(1.0)?;
        let inside = of_side(-1.0).unwrap_or(outside);
        let least = 1e-3 * step.contrast().abs();
        let mut dirty = DMatrix::from_element(size, size, false);
        for (i, _) in counted {
            let [a, b] = sides[i];
            let level = a * inside.0 + b * outside.0;
            let spread = (a * inside.1.powi(2) + b * outside.1.powi(2)).sqrt().max(least);
            left[i] = (left[i] - level) / spread;
            slope[i] /= spread;
            sides[i] = [a / spread, b / spread];
            // At the edge itself it may lie elsewhere.
            dirty[i] = left[i].abs() > DIRT + (slope[i] * step.softness_px).abs();
        }
        let (mut bare, mut is_bare) = (nothing(), nothing());
        for i in 0..size * size {
            // Dirt has an edge of its own.
            let near = |v: usize| v.saturating_sub(1)..(v + 2).min(size);
            let clean = !near(i % size).any(|x| near(i / size).any(|y| dirty[(x, y)]));
            match blocks[i].filter(|_| clean) {
                Some(b) if b.distance_px.abs() > ends => (bare[i], is_bare[i]) = (left[i], 1.0),
                Some(_) => {}
                None => (blocks[i], left[i]) = (None, 0.0),
            }
        }
        Some(Self { left, bare, is_bare, slope, sides })
    }

    /// Columns of the least squares: a shift of each place, the light, and last what they are to explain.
    fn columns(self, blocks: &DMatrix<Option<Block>>, places: usize) -> Vec<DMatrix<f64>> {
        let size = blocks.nrows();
        let mut columns = vec![DMatrix::<f64>::zeros(size, size); places + LIGHT];
        for (i, b) in blocks.iter().enumerate() {
            let Some(b) = b else { continue };
            for (place, share) in b.places {
                columns[place][i] = -share * self.slope[i];
            }
            let light = [1.0, b.off.x, b.off.y];
            let each = self.sides[i].into_iter().flat_map(|side| light.map(|l| side * l));
            columns[places..].iter_mut().zip(each).for_each(|(column, v)| column[i] = v);
        }
        columns.push(self.left);
        columns
    }
}

/// Median and robust standard deviation; `None` of a short list.
fn level_and_spread(mut list: Vec<f64>) -> Option<(f64, f64)> {
    if list.len() < LEAST_BLOCKS {
        return None;
    }
    let level = median(&mut list);
    list.iter_mut().for_each(|v| *v = (*v - level).abs());
    Some((level, scatter(&mut list)))
}

/// All columns whitened, one beside the other.
fn whitened(texture: &Texture, columns: &[DMatrix<f64>]) -> DMatrix<f64> {
    let nothing = DMatrix::zeros(columns[0].nrows(), columns[0].ncols());
    let mut values = Vec::new();
    for pair in columns.chunks(2) {
        let (a, b) = texture.whiten(&pair[0], pair.get(1).unwrap_or(&nothing));
        values.extend(a);
        if pair.len() == 2 {
            values.extend(b);
        }
    }
    DMatrix::from_vec(values.len() / columns.len(), columns.len(), values)
}

/// The least squares. `None` where it leads farther than `most_px`, where the slopes mean nothing.
fn solve(
    columns: &DMatrix<f64>,
    contour: &Contour,
    alive: &[bool],
    most_px: f64,
) -> Option<Together> {
    let products = columns.tr_mul(columns);
    let places = alive.len();
    let n = places + LIGHT;
    // A place that hardly any block lies at has nothing to say.
    let most = (0..places).map(|i| products[(i, i)]).fold(0.0, f64::max);
    let told = |i: &usize| products[(*i, *i)] > if *i < places { 0.05 * most } else { 0.0 };
    let used: Vec<usize> = (0..n).filter(told).collect();
    let normal = products.select_rows(&used).select_columns(&used);
    let right = DVector::from_fn(used.len(), |i, _| products[(used[i], n)]);
    let inverse = normal.cholesky()?.inverse();
    let found = &inverse * right;
    let kept: Vec<usize> =
        (0..used.len()).filter(|&i| used[i] < places && alive[used[i]]).collect();
    let astray = kept.iter().filter(|&&i| found[i].abs() > most_px).count();
    if kept.len() < 8 || 4 * astray > kept.len() {
        return None;
    }
    let step = std::f64::consts::TAU / places as f64;
    Some(Together {
        angle_rad: kept.iter().map(|&i| contour.start_rad + step * used[i] as f64).collect(),
        distance_px: kept.iter().map(|&i| found[i]).collect(),
        covariance_px2: inverse.select_rows(&kept).select_columns(&kept),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Calibration, Mapping};
    use crate::edge::{Band, LocateOptions, locate, scan};
    use crate::fit::Circle;
    use crate::fit::circle::robust;
    use crate::frame::Gray;
    use nalgebra::Vector2;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const SIDE: usize = 240;
    const SOFT_PX: f64 = 6.0;
    const RADIUS_PX: f64 = 45.0;

    /// A soft dark spot on metal brushed along x: its lines are 4 px wide and 60 px long.
    fn brushed(center: Vector2<f64>, seed: u64) -> Frame {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut lines = vec![0.0; SIDE * SIDE];
        let mut slow: Vec<f64> = (0..SIDE + 16).map(|_| normal()).collect();
        for x in 0..SIDE {
            slow.iter_mut().for_each(|v| *v = 0.984 * *v + 0.18 * normal());
            for y in 0..SIDE {
                lines[y * SIDE + x] = slow[y..y + 4].iter().sum::<f64>() / 2.0;
            }
        }
        let data = (0..SIDE * SIDE).map(|i| {
            let p = Vector2::new((i % SIDE) as f64, (i / SIDE) as f64);
            let dark = 0.5 / (1.0 + (1.7 * ((p - center).norm() - RADIUS_PX) / SOFT_PX).exp());
            let value = 30000.0 * (1.0 - dark) * (1.0 + 0.08 * lines[i]) + 150.0 * normal();
            value.round().clamp(0.0, 65535.0) as u16
        });
        Frame::Sixteen(Gray { width: SIDE, height: SIDE, data: data.collect() })
    }

    /// Free of the texture the centre is nearer than from profiles alone, and the stated covariance is that of its errors.
    #[test]
    fn brushed_metal_is_seen_through() {
        let mapping = Mapping::Scale { mm_per_px: 1.0, rotation_deg: 0.0 };
        let calibration = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
        let view = calibration.view(SIDE, SIDE).unwrap();
        let (mut alone, mut joint, mut ratio) = (0.0, 0.0, 0.0);
        let runs = 24;
        for seed in 0..runs {
            let truth = Vector2::new(119.3 + 0.1 * seed as f64, 120.6);
            let frame = brushed(truth, seed);
            let contour = Contour::of_circle(&view, view.to_plane(truth), RADIUS_PX).unwrap();
            let band = Band { inside_px: 42.0, outside_px: 50.0, bin_px: 1.5, sectors: 48 };
            let profiles = scan(&frame, 2, &contour, band);
            let located = locate(&profiles, true, LocateOptions::default()).unwrap();
            assert!(located.textured);
            let points: Vec<Vector2<f64>> =
                located.points.iter().map(|p| contour.point(p.angle_rad, p.distance_px)).collect();
            let circle = robust(&points, &vec![1.0; points.len()], None, 0.1).unwrap().circle;
            alone += (circle.center - truth).norm_squared();
            let Circle { center, radius } = circle;
            let fitted = Contour::of_circle(&view, view.to_plane(center), radius).unwrap();
            let edge = together(&frame, &fitted, &located, (42.0, 70.0), None).unwrap();
            let n = edge.angle_rad.len();
            let design = DMatrix::from_fn(n, 3, |i, c| match c {
                0 => edge.angle_rad[i].cos(),
                1 => edge.angle_rad[i].sin(),
                _ => 1.0,
            });
            let weights = edge.covariance_px2.clone().try_inverse().unwrap();
            let covariance = (design.tr_mul(&weights) * &design).try_inverse().unwrap();
            let step =
                &covariance * design.tr_mul(&(&weights * DVector::from_vec(edge.distance_px)));
            let off = center + Vector2::new(step[0], step[1]) - truth;
            joint += off.norm_squared();
            ratio += off.norm_squared() / (covariance[(0, 0)] + covariance[(1, 1)]);
        }
        let n = runs as f64;
        let (alone, joint, ratio) = ((alone / n).sqrt(), (joint / n).sqrt(), ratio / n);
        assert!(joint < 0.75 * alone, "{joint} px, from profiles alone {alone} px");
        assert!((0.5..2.0).contains(&ratio), "errors over stated ones, squared: {ratio}");
    }
}
