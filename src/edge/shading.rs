//! Takes the light's slope out of a band: across a soft edge it would shift the edge towards the darker side.
//!
//! A linear shading multiplies everything by 1 + g·d. The levels well inside and well outside the edge, each on its own,
//! tell g: two means and one slope are fitted to their logarithms. Of a closed contour that is enough. An arc bends too little
//! to show well how light goes on across it, and a chamfer lit from one side looks like light that does: what each side of it tells is kept
//! apart, for whoever sees several arcs in the same light.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

use crate::edge::{Contour, Profiles};
use crate::fit::circle::tukey;
use crate::fit::robust::{range, scatter};

/// A slope under this many of its own standard deviations is not taken out.
const SURE: f64 = 4.0;

/// Scatter of the logarithms of neighbouring sectors' levels below which one side is trusted no more than the other.
const EVEN: f64 = 0.005;

/// One level of one sector: place, side, logarithm and how much that scatters on its side.
struct Level {
    row: Vector4<f64>,
    log: f64,
    sd: f64,
}

impl Level {
    fn is_inside(&self) -> bool {
        self.row[0] > 0.0
    }
}

/// The light's slope, a part of itself per pixel.
#[derive(Debug, Clone, Copy)]
pub struct Slope {
    /// In the picture's u and v.
    pub per_px: Vector2<f64>,
    /// Its covariance.
    pub covariance: Matrix2<f64>,
}

impl Slope {
    /// Whether there is one beyond chance.
    pub fn is_sure(&self) -> bool {
        self.per_px.norm_squared() > SURE * SURE * 0.5 * self.covariance.trace()
    }
}

/// What the levels beside a contour tell of the light.
pub struct Levels {
    levels: Vec<Level>,
}

impl Levels {
    /// Reads the levels inside and outside the edge.
    pub fn of(profiles: &Profiles, contour: &Contour, softness_px: f64) -> Self {
        let mut levels = levels(profiles, contour, 2.5 * softness_px);
        for inside in [true, false] {
            learn_scatter(&mut levels, inside);
        }
        Self { levels }
    }

    /// The slope that both sides have.
    pub fn slope(&self) -> Option<Slope> {
        slope(&self.levels.iter().collect::<Vec<_>>(), 24)
    }

    /// The slope as the inside tells it, and the outside.
    pub fn by_side(&self) -> [Option<Slope>; 2] {
        [true, false].map(|inside| {
            let side: Vec<&Level> =
                self.levels.iter().filter(|l| l.is_inside() == inside).collect();
            slope(&side, 12)
        })
    }
}

/// Divides a slope out of the profiles: the light is as it is in the contour's middle.
pub fn flatten(profiles: &mut Profiles, contour: &Contour, slope_per_px: Vector2<f64>) {
    let middle = middle(profiles, contour);
    divide(profiles, |_, angle_rad| {
        move |distance_px| {
            let at = contour.point(angle_rad, distance_px);
            (1.0 + slope_per_px.dot(&(at - middle))).max(0.2)
        }
    });
}

/// The same with light that is known at each place, in any unit: along a profile it is as smooth as a parabola.
pub fn even_out(profiles: &mut Profiles, contour: &Contour, light: impl Fn(Vector2<f64>) -> f64) {
    let usual = light(middle(profiles, contour));
    divide(profiles, |seen, angle_rad| {
        let (first, last) = range(seen);
        let half = (0.5 * (last - first)).max(0.5);
        let center = 0.5 * (first + last);
        let at = |t: f64| light(contour.point(angle_rad, center + t * half)) / usual;
        let [low, mid, high] = [-1.0, 0.0, 1.0].map(at);
        let (slope, bend) = (0.5 * (high - low), 0.5 * (high + low) - mid);
        move |distance_px| {
            let t = (distance_px - center) / half;
            mid + t * (slope + t * bend)
        }
    });
}

/// Divides the light out of the profiles: `along` makes it, of a distance, for a profile's distances and angle.
fn divide<L: Fn(f64) -> f64>(profiles: &mut Profiles, along: impl Fn(&[f64], f64) -> L) {
    let mut seen = Vec::new();
    for s in 0..profiles.sectors() {
        let places = profiles.range(s).filter(|i| profiles.count[*i] > 0.0);
        seen.clear();
        seen.extend(places.map(|i| f64::from(profiles.distance_px[i])));
        if seen.is_empty() {
            continue;
        }
        let light = along(&seen, profiles.angle_rad[s]);
        for i in profiles.range(s) {
            if profiles.count[i] > 0.0 {
                profiles.value[i] /= light(f64::from(profiles.distance_px[i])) as f32;
            }
        }
    }
}

/// The middle of a contour's places.
fn middle(profiles: &Profiles, contour: &Contour) -> Vector2<f64> {
    let places = profiles.angle_rad.iter().map(|angle| contour.point(*angle, 0.0));
    places.sum::<Vector2<f64>>() / profiles.sectors().max(1) as f64
}

/// How much one side's levels scatter from sector to sector: near black their logarithms are mostly noise.
fn learn_scatter(levels: &mut [Level], inside: bool) {
    let of_side = |l: &Level| l.is_inside() == inside;
    let logs: Vec<f64> = levels.iter().filter(|l| of_side(l)).map(|l| l.log).collect();
    let mut steps: Vec<f64> = logs.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    if steps.is_empty() {
        return;
    }
    let sd = (scatter(&mut steps) / std::f64::consts::SQRT_2).max(EVEN);
    levels.iter_mut().filter(|l| of_side(l)).for_each(|l| l.sd = sd);
}

/// Mean levels of each sector beyond `clear_px` either side of the contour.
fn levels(profiles: &Profiles, contour: &Contour, clear_px: f64) -> Vec<Level> {
    let mut list = Vec::new();
    for s in 0..profiles.sectors() {
        for side in [-1.0, 1.0] {
            let (mut count, mut sum, mut distance) = (0.0, 0.0, 0.0);
            for i in profiles.range(s) {
                let d = f64::from(profiles.distance_px[i]);
                let n = f64::from(profiles.count[i]);
                if n > 0.0 && d * side > clear_px {
                    count += n;
                    sum += n * f64::from(profiles.value[i]);
                    distance += n * d;
                }
            }
            if count >= 4.0 && sum > 0.0 {
                let at = contour.point(profiles.angle_rad[s], distance / count);
                let place = at - contour.origin_px;
                let inside = f64::from(u8::from(side < 0.0));
                let row = Vector4::new(inside, 1.0 - inside, place.x, place.y);
                list.push(Level { row, log: (sum / count).ln(), sd: EVEN });
            }
        }
    }
    list
}

/// The slope of these levels, if they are so many.
fn slope(levels: &[&Level], least: usize) -> Option<Slope> {
    if levels.len() < least {
        return None;
    }
    let mut weights = vec![1.0; levels.len()];
    let mut result = None;
    for _ in 0..6 {
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for (l, w) in levels.iter().zip(&weights) {
            let w = w * (EVEN / l.sd).powi(2);
            normal += l.row * l.row.transpose() * w;
            right += l.row * (w * l.log);
        }
        // One side may be missing altogether.
        normal[(0, 0)] += 1e-6;
        normal[(1, 1)] += 1e-6;
        let inverse = normal.try_inverse()?;
        let fitted = inverse * right;
        let residual = |l: &Level| (l.log - l.row.dot(&fitted)) * (EVEN / l.sd);
        let mut sizes: Vec<f64> = levels.iter().map(|l| residual(l).abs()).collect();
        let sd = scatter(&mut sizes);
        if sd <= 0.0 {
            return None;
        }
        weights = levels.iter().map(|l| tukey(residual(l) / sd)).collect();
        result = Some((Vector2::new(fitted[2], fitted[3]), inverse, sd));
    }
    let (per_px, inverse, sd) = result?;
    // Neighbouring sectors share their texture: about as many independent levels as a quarter of them.
    let covariance = inverse.fixed_view::<2, 2>(2, 2) * (2.0 * sd).powi(2);
    Some(Slope { per_px, covariance })
}
