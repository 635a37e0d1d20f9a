//! A plain caliper that starts at the truth: what a picture allows simply, with nothing to find and nothing to doubt.

use nalgebra::{Matrix3, Vector2, Vector3};
use pivotsight::frame::Frame;

use super::optics::Camera;

/// Points whose contrast is less than this part of the median, or of the other sign, are no edge.
const LEAST_CONTRAST: f64 = 0.5;

/// Where an edge is sought: about a circle, within a distance of it, in directions of the plane.
pub struct Search {
    pub centre_mm: Vector2<f64>,
    pub radius_mm: f64,
    /// The profile goes this far in and out; the last third at each end gives the levels.
    pub reach_mm: f64,
    pub step_mm: f64,
}

/// Edge points at half level, with the contrast of each.
pub fn points(
    frame: &Frame,
    camera: &Camera,
    search: &Search,
    ways: impl Iterator<Item = f64>,
) -> Vec<Vector2<f64>> {
    let found: Vec<(Vector2<f64>, f64)> = ways
        .filter_map(|way| {
            let along = Vector2::new(way.cos(), way.sin());
            let place = |out_mm: f64| search.centre_mm + along * (search.radius_mm + out_mm);
            let steps = (search.reach_mm / search.step_mm).ceil() as i32;
            let offsets: Vec<f64> =
                (-steps..=steps).map(|k| f64::from(k) * search.step_mm).collect();
            let sample = |out_mm: &f64| gray(frame, camera.to_pixel(place(*out_mm)));
            let profile: Vec<f64> = offsets.iter().map(sample).collect::<Option<_>>()?;
            let end = profile.len() / 6;
            let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
            let (inside, outside) = (mean(&profile[..end]), mean(&profile[profile.len() - end..]));
            let half = 0.5 * (inside + outside);
            let crossing = (1..profile.len())
                .filter(|k| (profile[k - 1] - half) * (profile[*k] - half) <= 0.0)
                .filter(|k| profile[k - 1] != profile[*k])
                .map(|k| {
                    let part = (half - profile[k - 1]) / (profile[k] - profile[k - 1]);
                    offsets[k - 1] + part * search.step_mm
                })
                .min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
            Some((place(crossing), outside - inside))
        })
        .collect();
    let mut contrasts: Vec<f64> = found.iter().map(|f| f.1).collect();
    contrasts.sort_by(f64::total_cmp);
    let usual = contrasts.get(contrasts.len() / 2).copied().unwrap_or(0.0);
    found.into_iter().filter(|f| f.1 / usual > LEAST_CONTRAST).map(|f| f.0).collect()
}

/// The circle through the points, those beyond three standard deviations left out.
pub fn centre_mm(search: &Search, points: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let mut circle = Vector3::new(search.centre_mm.x, search.centre_mm.y, search.radius_mm);
    let mut most = f64::INFINITY;
    for _ in 0..12 {
        let (mut normal, mut right, mut square, mut count) =
            (Matrix3::zeros(), Vector3::zeros(), 0.0, 0);
        for point in points {
            let d = point - circle.xy();
            let miss = d.norm() - circle.z;
            if miss.abs() > most {
                continue;
            }
            let row = Vector3::new(d.x / d.norm(), d.y / d.norm(), 1.0);
            normal += row * row.transpose();
            right += row * miss;
            square += miss * miss;
            count += 1;
        }
        circle += normal.try_inverse()? * right;
        most = 3.0 * (square / f64::from(count.max(4) - 3)).sqrt() + 1e-9;
    }
    Some(circle.xy())
}

/// Bilinear; nothing outside the frame.
fn gray(frame: &Frame, pixel: Vector2<f64>) -> Option<f64> {
    if pixel.x < 0.0 || pixel.y < 0.0 {
        return None;
    }
    let (u, v) = (pixel.x as usize, pixel.y as usize);
    if u + 1 >= frame.width() || v + 1 >= frame.height() {
        return None;
    }
    let (a, b) = (pixel.x.fract(), pixel.y.fract());
    let at = |u: usize, v: usize| match frame {
        Frame::Eight(g) => f64::from(g.row(v)[u]),
        Frame::Sixteen(g) => f64::from(g.row(v)[u]),
    };
    let row = |v: usize| at(u, v) * (1.0 - a) + at(u + 1, v) * a;
    Some(row(v) * (1.0 - b) + row(v + 1) * b)
}
