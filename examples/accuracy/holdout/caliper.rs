//! A plain caliper that starts at the truth: what a picture allows simply, with nothing to find and nothing to doubt.

use nalgebra::{DMatrix, DVector, Vector2};
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

/// An edge point at half level, with its contrast.
pub struct Point {
    pub place_mm: Vector2<f64>,
    pub contrast: f64,
}

/// Edge points in the directions `ways`, as far as they are in the frame.
pub fn points(
    frame: &Frame,
    camera: &Camera,
    search: &Search,
    ways: impl Iterator<Item = f64>,
) -> Vec<Point> {
    ways.filter_map(|way| {
        let along = Vector2::new(way.cos(), way.sin());
        let place = |out_mm: f64| search.centre_mm + along * (search.radius_mm + out_mm);
        let steps = (search.reach_mm / search.step_mm).ceil() as i32;
        let offsets: Vec<f64> = (-steps..=steps).map(|k| f64::from(k) * search.step_mm).collect();
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
        Some(Point { place_mm: place(crossing), contrast: outside - inside })
    })
    .collect()
}

/// Leaves out what has hardly any contrast, or the other way round.
pub fn keep_clear<T>(points: &mut Vec<T>, contrast: impl Fn(&T) -> f64) {
    let mut contrasts: Vec<f64> = points.iter().map(&contrast).collect();
    contrasts.sort_by(f64::total_cmp);
    let usual = contrasts.get(contrasts.len() / 2).copied().unwrap_or(0.0);
    points.retain(|p| contrast(p) / usual > LEAST_CONTRAST);
}

/// Least squares, what misses by more than three standard deviations left out. `row` gives a point's miss at the present parameters
/// and its derivatives (of the model).
pub fn fit<T>(
    points: &[T],
    mut at: DVector<f64>,
    row: impl Fn(&DVector<f64>, &T) -> (DVector<f64>, f64),
) -> Option<DVector<f64>> {
    let many = at.len();
    let mut most = f64::INFINITY;
    for _ in 0..12 {
        let (mut normal, mut right) = (DMatrix::zeros(many, many), DVector::zeros(many));
        let (mut square, mut count) = (0.0, 0);
        for point in points {
            let (slopes, miss) = row(&at, point);
            if miss.abs() <= most {
                normal += &slopes * slopes.transpose();
                right += slopes * miss;
                square += miss * miss;
                count += 1;
            }
        }
        at += normal.cholesky()?.solve(&right);
        most = 3.0 * (square / (count as f64 - many as f64).max(1.0)).sqrt() + 1e-9;
    }
    Some(at)
}

/// The centre of the circle through the points about a search's circle.
pub fn centre_mm(search: &Search, mut points: Vec<Point>) -> Option<Vector2<f64>> {
    keep_clear(&mut points, |p| p.contrast);
    let start =
        DVector::from_column_slice(&[search.centre_mm.x, search.centre_mm.y, search.radius_mm]);
    let circle = fit(&points, start, |circle, point| {
        let d = point.place_mm - Vector2::new(circle[0], circle[1]);
        let r = d.norm();
        (DVector::from_column_slice(&[d.x / r, d.y / r, 1.0]), r - circle[2])
    })?;
    Some(Vector2::new(circle[0], circle[1]))
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
